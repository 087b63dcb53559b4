"""The simulated processor's memory, and what is placed in it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import ArmError
from .program import Segment

LINE_BYTES = 32
PAGE_BYTES = 4096
STACK_BYTES = 1 << 20
BEHIND_BYTES = 16 << 20  # after a part that is elsewhere: its own heap and stack
HEAP = 0x0100_0000  # at least: programs are linked lower


def aligned(value: int, unit: int) -> int:
    """The next multiple of a unit."""
    return -(-value // unit) * unit


class Memory:
    """RAM from address 0 up, and further pieces where a program has segments elsewhere.

    The page at 0 is there only if the program has something in it: a null pointer is an error. From the
    bottom: program, heap (placed and reserved pieces, freed together), pieces that are kept (growing down),
    the stack.
    """

    def __init__(self, segments: Iterable[Segment], nbytes: int) -> None:
        segments = tuple(segments)
        nbytes = aligned(nbytes, PAGE_BYTES)
        ram = np.zeros(nbytes, np.uint8)
        first = 0 if any(part.address < PAGE_BYTES for part in segments) else PAGE_BYTES
        self.regions: list[tuple[int, npt.NDArray[np.uint8]]] = [(first, ram[first:])]
        top = HEAP
        for part in segments:
            if part.address + part.nbytes <= nbytes - STACK_BYTES:
                top = max(top, part.address + part.nbytes)
            else:
                self._add_region(part)
        for part in segments:
            self.view(part.address, len(part.contents))[:] = np.frombuffer(part.contents, np.uint8)
        self._heap_bottom = self._heap = aligned(top, LINE_BYTES)
        self._kept_bottom = nbytes - STACK_BYTES
        self.stack_top, self.stack_lowest = nbytes - 64, nbytes - STACK_BYTES
        self._kept: dict[tuple[int, tuple[int, ...], str], tuple[int, npt.NDArray[Any]]] = {}
        if self._heap_bottom >= self._kept_bottom:
            raise ArmError(f"{nbytes >> 20} MiB of memory are too few: the program ends at 0x{top:08x}")

    @property
    def free(self) -> tuple[int, int]:
        """(first address, address after the last) of what is neither placed nor kept."""
        return self._heap, self._kept_bottom

    def _add_region(self, part: Segment) -> None:
        start = part.address // PAGE_BYTES * PAGE_BYTES
        end = aligned(part.address + part.nbytes, PAGE_BYTES) + BEHIND_BYTES
        if start < self.regions[0][0] + len(self.regions[0][1]):
            raise ArmError(f"the program's part at 0x{part.address:08x} does not fit into memory")
        for index, (other, contents) in enumerate(self.regions[1:], start=1):
            if start <= other + len(contents) and other <= end:
                start, end = min(start, other), max(end, other + len(contents))
                del self.regions[index]
                break
        if end > 1 << 32:
            raise ArmError(f"the program's part at 0x{part.address:08x} is too near the end of memory")
        self.regions.append((start, np.zeros(end - start, np.uint8)))

    def view(self, address: int, nbytes: int) -> npt.NDArray[np.uint8]:
        """The bytes themselves; ArmError where there is no memory."""
        for start, contents in self.regions:
            if start <= address and address + nbytes <= start + len(contents):
                return contents[address - start : address - start + nbytes]
        raise ArmError(f"no memory at 0x{address:08x} ({nbytes} bytes)")

    def reserve(self, nbytes: int) -> int:
        """Address of so many zeroed bytes on a new line; they live until `release`."""
        address = self._heap
        end = aligned(address + max(nbytes, 1), LINE_BYTES)
        if end > self._kept_bottom:
            raise ArmError(
                f"out of memory: {nbytes} bytes more than are left; release() or more memory_bytes"
            )
        self._heap = end
        self.view(address, nbytes)[:] = 0
        return address

    def keep(self, array: npt.NDArray[Any]) -> tuple[int, bool]:
        """(address, whether it is new there) of an array that stays; the same array is placed once."""
        key = (array.__array_interface__["data"][0], array.shape, array.dtype.str)
        if key in self._kept:
            return self._kept[key][0], False
        address = (self._kept_bottom - max(array.nbytes, 1)) // LINE_BYTES * LINE_BYTES
        if address < self._heap:
            raise ArmError(f"out of memory: {array.nbytes} bytes to keep are more than are left")
        self._kept_bottom = address
        self._kept[key] = (address, array)  # the array is held: its data pointer is not used again
        return address, True

    def release(self) -> None:
        """Free what was reserved."""
        self._heap = self._heap_bottom
