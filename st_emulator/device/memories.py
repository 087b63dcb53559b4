"""The memories of service 6: a patch area in RAM, the non-volatile parameters (read only), the captured
image (read only).
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from ..dialects.pus.reception import RejectedError
from ..protocol.pus.enumerations import FailureCode, MemoryId

if TYPE_CHECKING:
    from .star_tracker import StarTracker

NON_VOLATILE_BYTES = 2048  # ASSUMED: room for every parameter as JSON text, the rest zero
RAM_BYTES = 65536  # ASSUMED: a patch area of 64 KiB


class Memories:
    """Reads and writes by memory identifier and address; every check is made before anything changes."""

    def __init__(self, unit: StarTracker) -> None:
        self._unit = unit
        self._ram = bytearray(RAM_BYTES)

    def reset(self) -> None:
        self._ram = bytearray(RAM_BYTES)

    def contents(self, memory_id: int) -> bytes | bytearray:
        """All bytes of a memory; refuses an unknown one and an image that was never captured."""
        if memory_id == MemoryId.RAM:
            return self._ram
        if memory_id == MemoryId.NON_VOLATILE:
            text = json.dumps(self._unit.parameters.stored_values(), sort_keys=True).encode()
            return text.ljust(NON_VOLATILE_BYTES, b"\0")
        if memory_id == MemoryId.IMAGE:
            if not self._unit.image_store.data:
                raise RejectedError(FailureCode.NO_IMAGE)
            return self._unit.image_store.data
        raise RejectedError(FailureCode.UNKNOWN_ID, memory_id)

    def read(self, memory_id: int, start: int, length: int) -> bytes:
        contents = self.contents(memory_id)
        if start + length > len(contents):
            raise RejectedError(FailureCode.ADDRESS, start)
        return bytes(contents[start : start + length])

    def check_writable(self, memory_id: int, start: int, length: int) -> None:
        if memory_id != MemoryId.RAM:
            self.contents(memory_id)
            raise RejectedError(FailureCode.READ_ONLY, memory_id)
        if start + length > RAM_BYTES:
            raise RejectedError(FailureCode.ADDRESS, start)

    def write(self, start: int, data: bytes) -> None:
        self._ram[start : start + len(data)] = data

    def test_ram(self) -> bool:
        """Write and read back two patterns, then restore the contents."""
        kept = bytes(self._ram)
        passed = True
        for pattern in (0x55, 0xAA):
            self._ram[:] = bytes([pattern]) * RAM_BYTES
            passed = passed and self._ram.count(pattern) == RAM_BYTES
        self._ram[:] = kept
        return passed
