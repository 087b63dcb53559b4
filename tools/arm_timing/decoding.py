"""ARM instructions as the timing callback wants them: who reads what, what is late, how long it takes.

Encodings: ARM Architecture Reference Manual, ARM DDI 0100, chapter A3, of ARMv5TE. What an ARM926EJ-S has not
(ARMv6 and later, coprocessors other than CP15) has no timing.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from .timing_table import ROW_NUMBERS, ROWS

PC = 15
ALWAYS = 14
_UNCONDITIONAL = 15

# How the callback finds out whether the instruction was executed, and what then follows.
PLAIN, JUMP, MAYBE_JUMP, MAYBE_MEMORY, MAYBE_OTHER, MAYBE_ALU, UNKNOWN = range(7)

# One instruction in the table: three words of 64 bits and one that is free.
WORDS = 4
STORE_SHIFT, ACCUMULATE_SHIFT = 16, 32  # of READS and LATE; execute-stage operands are below
READS = 0  # masks of registers: execute stage, stored, accumulated
LATE = 1  # masks of registers that such an operand waits one cycle for (or two)
REST = 2
WRITES_SHIFT, CYCLES_SHIFT, ROW_SHIFT, KIND_SHIFT, CONDITION_SHIFT = 16, 32, 40, 48, 56  # of REST
# The lowest 16 bits of REST: registers that an execute-stage operand waits two cycles for.

_ARITHMETIC = (2, 3, 4, 5, 6)  # SUB, RSB, ADD, ADC, SBC
_COMPARISONS = range(8, 12)  # TST, TEQ, CMP, CMN
_MOVES = (13, 15)  # MOV, MVN: no first operand


@dataclass(frozen=True)
class Decoded:
    """Registers as masks: bit n is rn."""

    row: str
    reads: int = 0
    stores: int = 0
    accumulates: int = 0
    writes: int = 0
    late: int = 0  # of what it writes, what has to be waited for
    registers: int = 0  # length of a list
    memory: bool = False

    @property
    def jumps(self) -> bool:
        return bool(self.writes >> PC & 1)

    @property
    def cycles(self) -> int:
        """When executed, with no interlock."""
        return ROWS[ROW_NUMBERS[self.row]].total(self.registers)


def _bit(register: int) -> int:
    return 1 << register


def _fields(word: int) -> tuple[int, int, int, int]:
    """Rn, Rd, Rs, Rm where most encodings have them."""
    return word >> 16 & 15, word >> 12 & 15, word >> 8 & 15, word & 15


@lru_cache(maxsize=1 << 16)
def decode(word: int) -> Decoded | None:
    """An instruction; None if ARM926EJ-S has none of that encoding. The condition is not looked at."""
    if word >> 28 == _UNCONDITIONAL:
        return _preload(word)
    kind = word >> 25 & 7
    if kind == 0 and word & 0x90 == 0x90:
        return _multiply_or_swap(word) if word & 0x60 == 0 else _extra_load_store(word)
    if kind < 2 and word & 0x0190_0000 == 0x0100_0000:
        return _miscellaneous(word)
    if kind < 2:
        return _data_processing(word)
    if kind < 4:
        return _load_store(word)
    if kind == 4:
        return _multiple(word)
    if kind == 5:
        return Decoded("branch", writes=_bit(PC) | (_bit(14) if word >> 24 & 1 else 0))
    return _coprocessor_or_interrupt(word)


def _preload(word: int) -> Decoded | None:
    if word & 0x0D70_F000 != 0x0550_F000 or (word >> 25 & 1 and word & 0x10):
        return None
    return Decoded("preload", reads=_bit(word >> 16 & 15) | (_bit(word & 15) if word >> 25 & 1 else 0))


def _multiply_or_swap(word: int) -> Decoded | None:
    high, low, second, first = _fields(word)  # here Rd (or RdHi) comes first, then Rn (or RdLo), Rs, Rm
    operation, flags = word >> 21 & 15, word >> 20 & 1
    reads = _bit(first) | _bit(second)
    suffix = "_flags" if flags else ""
    if operation in (0, 1):
        late = 0 if flags else _bit(high)
        addend = _bit(low) if operation else 0
        return Decoded("multiply" + suffix, reads, accumulates=addend, writes=_bit(high), late=late)
    if 4 <= operation <= 7:
        both = _bit(high) | _bit(low)
        late = 0 if flags else both
        addend = both if operation & 1 else 0
        return Decoded("multiply_long" + suffix, reads, accumulates=addend, writes=both, late=late)
    if word & 0x0FB0_0F00 == 0x0100_0000:
        row = "swap_byte" if word >> 22 & 1 else "swap_word"
        return Decoded(row, _bit(high), _bit(first), writes=_bit(low), late=_bit(low), memory=True)
    return None


def _extra_load_store(word: int) -> Decoded | None:
    """LDRH, STRH, LDRSB, LDRSH, LDRD, STRD."""
    base, data, _, offset = _fields(word)
    kind, load = word >> 5 & 3, word >> 20 & 1
    indexed_before, write_back = word >> 24 & 1, word >> 21 & 1
    if (not indexed_before and write_back) or data == PC:
        return None  # ARMv6T2; unpredictable
    reads = _bit(base) | (0 if word >> 22 & 1 else _bit(offset))
    writes = _bit(base) if write_back or not indexed_before else 0
    if load:
        return Decoded("load_narrow", reads, writes=writes | _bit(data), late=_bit(data), memory=True)
    if kind == 1:
        return Decoded("store", reads, _bit(data), writes=writes, memory=True)
    if data & 1 or data == 14:
        return None
    if kind == 3:
        return Decoded("store_double", reads, _bit(data), writes=writes, memory=True)
    pair = _bit(data) | _bit(data + 1)
    return Decoded("load_double", reads, writes=writes | pair, late=_bit(data + 1), memory=True)


def _miscellaneous(word: int) -> Decoded | None:
    """What has the encoding of a comparison that sets no flags."""
    if word >> 25 & 1:
        return _to_status(word, 0) if word >> 21 & 1 and word >> 16 & 15 else None
    high, low, _, first = _fields(word)
    kind, operation = word >> 4 & 15, word >> 21 & 3
    if kind & 9 == 8:
        return _halfword_multiply(word)
    if kind == 0:
        return _to_status(word, _bit(first)) if operation & 1 else Decoded("mrs", writes=_bit(low))
    if kind == 1 and operation == 3:
        return Decoded("clz", _bit(first), writes=_bit(low))
    if kind in (1, 3) and operation == 1:
        return Decoded("branch", _bit(first), writes=_bit(PC) | (_bit(14) if kind == 3 else 0))
    if kind == 5:
        return Decoded("saturating", _bit(high) | _bit(first), writes=_bit(low), late=_bit(low))
    return None  # BXJ, BKPT


def _to_status(word: int, reads: int) -> Decoded:
    only_flags = word >> 16 & 15 == 8 and not word >> 22 & 1
    return Decoded("msr_flags" if only_flags else "msr_control", reads)


def _halfword_multiply(word: int) -> Decoded:
    high, low, second, first = _fields(word)
    reads, operation = _bit(first) | _bit(second), word >> 21 & 3
    if operation == 2:
        both = _bit(high) | _bit(low)
        return Decoded("multiply_halfword_long", reads, accumulates=both, writes=both, late=both)
    adds = operation == 0 or (operation == 1 and not word >> 5 & 1)
    addend = _bit(low) if adds else 0
    return Decoded("multiply_halfword", reads, accumulates=addend, writes=_bit(high), late=_bit(high))


def _data_processing(word: int) -> Decoded:
    first, destination, distance, second = _fields(word)
    operation = word >> 21 & 15
    reads = 0 if operation in _MOVES else _bit(first)
    by_register = shifted = False
    if not word >> 25 & 1:
        reads |= _bit(second)
        by_register = bool(word & 0x10)
        shifted = bool(word & 0xFF0)
        if by_register:
            reads |= _bit(distance)
    if operation in _COMPARISONS:
        return Decoded("alu_register_shift" if by_register else "alu", reads)
    row = "alu_register_shift" if by_register else "alu"
    if destination == PC:
        plain = "alu_to_pc_arithmetic" if operation in _ARITHMETIC else "alu_to_pc_logical"
        row = "alu_to_pc_shifted" if shifted else plain
    return Decoded(row, reads, writes=_bit(destination))


def _load_store(word: int) -> Decoded | None:
    base, data, _, offset = _fields(word)
    by_register = word >> 25 & 1
    if by_register and word & 0x10:
        return None  # ARMv6 media instructions
    load, byte = word >> 20 & 1, word >> 22 & 1
    reads = _bit(base) | (_bit(offset) if by_register else 0)
    writes = _bit(base) if word >> 21 & 1 or not word >> 24 & 1 else 0
    scaled = "_scaled" if by_register and word & 0xFF0 else ""
    if not load:
        return Decoded("store" + scaled, reads, _bit(data), writes=writes, memory=True)
    if data == PC:
        return None if byte else Decoded("load_pc" + scaled, reads, writes=writes | _bit(PC), memory=True)
    row = ("load_narrow" if byte else "load_word") + scaled
    return Decoded(row, reads, writes=writes | _bit(data), late=_bit(data), memory=True)


def _multiple(word: int) -> Decoded | None:
    base, listed = word >> 16 & 15, word & 0xFFFF
    length = listed.bit_count()
    if not length:
        return None
    writes = _bit(base) if word >> 21 & 1 else 0
    if not word >> 20 & 1:
        first = listed & -listed
        return Decoded("store_multiple", _bit(base), first, writes=writes, registers=length, memory=True)
    if listed >> PC:
        row, late = "load_multiple_pc", 0
    else:
        row, late = "load_multiple", _bit(listed.bit_length() - 1) if length > 1 else 0
    return Decoded(row, _bit(base), writes=writes | listed, late=late, registers=length, memory=True)


def _coprocessor_or_interrupt(word: int) -> Decoded | None:
    if word >> 24 & 15 == 15:
        return Decoded("software_interrupt")
    if word >> 24 & 15 != 14 or not word & 0x10 or word >> 8 & 15 != 15:
        return None  # of coprocessors only MCR and MRC, and CP15 alone
    data = word >> 12 & 15
    if not word >> 20 & 1:
        return Decoded("coprocessor_write", stores=_bit(data))
    target = 0 if data == PC else _bit(data)  # into r15 it sets the flags
    return Decoded("coprocessor_read", writes=target, late=target)


def _kind(word: int, decoded: Decoded) -> int:
    if word >> 28 >= ALWAYS:
        return JUMP if decoded.jumps else PLAIN
    if decoded.row == "branch" and word >> 25 & 7 == 5 and word & 0xFF_FFFF == 0xFF_FFFF:
        return MAYBE_OTHER  # to the next instruction: where it goes does not tell whether it was taken
    if decoded.jumps:
        return MAYBE_JUMP
    if decoded.memory:
        return MAYBE_MEMORY
    return MAYBE_ALU if decoded.row in ("alu", "clz", "msr_flags") else MAYBE_OTHER


@lru_cache(maxsize=1 << 16)
def packed(word: int) -> tuple[int, int, int]:
    """READS, LATE and REST of an instruction."""
    decoded = decode(word)
    if decoded is None:
        return 0, 0, UNKNOWN << KIND_SHIFT
    number = ROW_NUMBERS[decoded.row]
    row = ROWS[number]
    reads = decoded.reads | decoded.stores << STORE_SHIFT | decoded.accumulates << ACCUMULATE_SHIFT
    late = (
        (decoded.late if row.use else 0)
        | (decoded.late if row.store else 0) << STORE_SHIFT
        | (decoded.late if row.accumulate else 0) << ACCUMULATE_SHIFT
    )
    rest = (
        (decoded.late if row.use > 1 else 0)
        | decoded.writes << WRITES_SHIFT
        | decoded.cycles << CYCLES_SHIFT
        | number << ROW_SHIFT
        | _kind(word, decoded) << KIND_SHIFT
        | (word >> 28) << CONDITION_SHIFT
    )
    return reads, late, rest


def table_of(words: Iterable[int]) -> npt.NDArray[np.int64]:
    """Instructions packed one after the other, WORDS words each."""
    return np.array([(*packed(int(word)), 0) for word in words], np.int64).reshape(-1, WORDS)
