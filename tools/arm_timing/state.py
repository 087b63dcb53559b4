"""The callbacks' state: one array with counters, the table of instructions and the caches.

The caches are those of ARM926EJ-S (ARM DDI 0198D, chapter 4): four ways, lines of 32 bytes, filled by a read
miss only, written back when a dirty line is replaced. A write miss goes to the write buffer, which is taken
never to be full. Replacement is round-robin, one counter for each set (U: the manual leaves the counters
open), which a program chooses by the RR bit of CP15 register 1; after reset it is pseudo-random, which is not
modelled. There is no TLB.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from unicorn.arm_const import UC_ARM_REG_CPSR
from unicorn.unicorn_py3.unicorn import uclib

from . import callbacks as at
from .cost import Cost
from .decoding import WORDS, table_of
from .errors import ArmError
from .program import Program
from .timing_table import ROWS

LINE_BYTES = 1 << at.LINE_SHIFT
_MOST_CODE_BYTES = 64 << 20


@dataclass(frozen=True)
class Snapshot:
    """The counters at one moment."""

    values: npt.NDArray[np.int64]


class State:
    """Allocates the array and reads it."""

    def __init__(self, program: Program, caches_kib: Sequence[int]) -> None:
        self.caches_kib = tuple(caches_kib)
        if len(self.caches_kib) > at.MOST_SIZES:
            raise ValueError(f"{len(self.caches_kib)} cache sizes: at most {at.MOST_SIZES}")
        for kib in self.caches_kib:
            if kib < 1 or kib & kib - 1:
                raise ValueError(f"a cache of {kib} KiB: not a power of two")
        start, table = _table(program)
        sets = [(kib << 10) // (LINE_BYTES * at.WAYS) for kib in self.caches_kib]
        caches = 2 * sum(sets) * at.SET_LENGTH
        self.array = np.zeros(at.STATE_LENGTH + table.size + caches, np.int64)
        self.array[at.STATE_LENGTH : at.STATE_LENGTH + table.size] = table.reshape(-1)
        self._caches = self.array[at.STATE_LENGTH + table.size :].reshape(-1, at.SET_LENGTH)
        constants = {
            at.STOP_FUNCTION: _address_of(uclib.uc_emu_stop),
            at.READ_FUNCTION: _address_of(uclib.uc_reg_read),
            at.CPSR_NUMBER: UC_ARM_REG_CPSR,
            at.OWN_ADDRESS: self.array.ctypes.data,
            at.TABLE: at.STATE_LENGTH,
            at.CODE_START: start,
            at.CODE_WORDS: len(table),
            at.SIZES: len(sets),
        }
        for place, value in constants.items():
            self.array[place] = value
        first = 0
        self._data_sets: list[npt.NDArray[np.int64]] = []
        self._fetch_sets: list[npt.NDArray[np.int64]] = []
        for size, count in enumerate(sets):
            self.array[at.SET_MASK + size] = count - 1
            for kept, place in ((self._fetch_sets, at.FETCH_SETS), (self._data_sets, at.DATA_SETS)):
                self.array[place + size] = at.STATE_LENGTH + table.size + first * at.SET_LENGTH
                kept.append(self._caches[first : first + count])
                first += count
        self.flush()

    def flush(self) -> None:
        """Empty all caches; what is dirty is dropped, as memory has it already."""
        for sets in self._fetch_sets:
            sets[:] = 0
            sets[:, : at.WAYS] = at.EMPTY_FETCH
        for sets in self._data_sets:
            sets[:] = 0
            sets[:, : at.WAYS] = at.EMPTY_DATA
        self.array[at.FETCH_LINE] = self.array[at.DATA_LINE] = -1

    def invalidate(self, address: int, nbytes: int) -> None:
        """Take the lines of a piece of memory out of the data caches."""
        first, last = address >> at.LINE_SHIFT, address + nbytes - 1 >> at.LINE_SHIFT
        for sets in self._data_sets:
            lines = sets[:, : at.WAYS] >> 1
            sets[:, : at.WAYS][(lines >= first) & (lines <= last)] = at.EMPTY_DATA
        self.array[at.DATA_LINE] = -1

    def begin(self, most_instructions: int) -> Snapshot:
        """Before a run: nothing is in the pipeline; caches stay as they are."""
        state = self.array
        state[at.MOST_INSTRUCTIONS] = state[at.INSTRUCTIONS] + most_instructions
        state[[at.STOPPED, at.LATE, at.LATE_TWO, at.OPEN]] = 0
        return self.snapshot()

    def snapshot(self) -> Snapshot:
        """The counters now."""
        return Snapshot(self.array[: at.STATE_LENGTH].copy())

    def end(self, next_pc: int) -> None:
        """After a run: close what its last instruction left open."""
        state = self.array
        if state[at.OPEN] == at.MAYBE_JUMP:
            at.settle(state, bool(next_pc != state[at.PC] + 4))
        elif state[at.OPEN] == at.MAYBE_MEMORY:
            at.settle(state, bool(state[at.ACCESSED]))

    def cost_since(self, snapshot: Snapshot) -> Cost:
        """What was counted since a snapshot."""
        counts = self.array[: at.STATE_LENGTH] - snapshot.values
        rows = counts[at.ROW_COUNTS : at.ROW_COUNTS + len(ROWS)]
        return Cost(
            instructions=int(counts[at.INSTRUCTIONS]),
            core_cycles=int(counts[at.CYCLES]),
            fetch_fills=self._by_size(counts, at.FETCH_FILLS),
            data_fills=self._by_size(counts, at.DATA_FILLS),
            data_accesses=int(counts[at.ACCESSES]),
            fetches=int(counts[at.INSTRUCTIONS] + counts[at.FETCHES]),
            write_backs=self._by_size(counts, at.WRITE_BACKS),
            class_counts={row.name: int(count) for row, count in zip(ROWS, rows, strict=True) if count},
            interlock_cycles=int(counts[at.INTERLOCKS]),
        )

    def instructions_by_blocks(self, snapshot: Snapshot) -> int:
        """The second count of instructions since a snapshot."""
        return int(self.array[at.BLOCK_INSTRUCTIONS] - snapshot.values[at.BLOCK_INSTRUCTIONS])

    def _by_size(self, counts: npt.NDArray[np.int64], place: int) -> dict[int, int]:
        return {kib: int(counts[place + size]) for size, kib in enumerate(self.caches_kib)}


def _address_of(function: object) -> int:
    address = ctypes.cast(function, ctypes.c_void_p).value  # type: ignore[arg-type]
    assert address is not None
    return address


def _table(program: Program) -> tuple[int, npt.NDArray[np.int64]]:
    """(address of the first instruction, table) of all that a program may execute."""
    code = [part for part in program.segments if part.executable]
    if not code:
        raise ArmError(f"{program.path}: no executable segment")
    start = min(part.address for part in code) // 4 * 4
    end = max(part.address + len(part.contents) for part in code)
    if end - start > _MOST_CODE_BYTES:
        raise ArmError(f"{program.path}: code from 0x{start:08x} to 0x{end:08x}: too far apart")
    words = np.zeros((end - start + 3) // 4, "<u4")
    for part in code:
        offset = part.address - start
        words.view(np.uint8)[offset : offset + len(part.contents)] = np.frombuffer(part.contents, np.uint8)
    return start, table_of(words.tolist())


__all__ = ["LINE_BYTES", "WORDS", "Snapshot", "State"]
