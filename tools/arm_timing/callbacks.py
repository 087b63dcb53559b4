"""What the simulator calls at each instruction, block and data access, compiled.

All in one file, constants apart: numba compiles a function anew when its own file has changed, not another it
calls; `timing_table` and `decoding` reach it as data. The timing is a state machine over instructions as they
come, so that interlocks hold across blocks, calls and returns alike:

- LATE and LATE_TWO are masks of registers that the next instruction would wait for, by one or two cycles,
  apart for operands of the execute stage, for data to store and for addends.
- After an instruction that took one cycle, waits of two are waits of one; after two cycles none is left.
- What cannot be known before a conditional instruction is over (a branch by where it went, a load or store by
  whether memory was accessed) stays open until the next instruction. For other conditional instructions of
  more than one cycle the flags are looked at.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import carray, cfunc, njit, types
from numba.extending import intrinsic

# Places in the state, an array of int64.
INSTRUCTIONS = 0
MOST_INSTRUCTIONS = 1  # the run is stopped at so many
STOP_FUNCTION, READ_FUNCTION = 2, 3  # addresses of the simulator's uc_emu_stop and uc_reg_read
STOPPED = 4  # why: 0 not, or one of the reasons below
STOPPED_AT = 5  # the address that was the reason
PC = 6  # of the last instruction
OWN_ADDRESS = 7  # of this array
REGISTER_BUFFER = 8  # a register read
CPSR_NUMBER = 9  # the simulator's number of that register
TABLE = 10  # where in this array the table of instructions starts
CODE_START, CODE_WORDS = 11, 12  # what the table covers
CYCLES, INTERLOCKS, FETCHES, ACCESSES = 13, 14, 15, 16
LATE, LATE_TWO = 17, 18
OPEN, OPEN_ENTRY = 19, 20  # kind and table entry of the instruction before, if its cost is still open
ACCESSED = 21  # whether memory was accessed since the last instruction
FETCH_LINE = 22  # line of the last instruction
DATA_LINE, DATA_LINE_DIRTY = (
    23,
    24,
)  # last line accessed, -1 unless in all caches; whether dirty in all of them
BLOCK_INSTRUCTIONS = 25  # counted by blocks
SIZES = 26  # how many cache sizes
MOST_SIZES = 8
SET_MASK = 32  # from here, by size
FETCH_SETS, DATA_SETS = 40, 48  # where in this array
FETCH_FILLS, DATA_FILLS, WRITE_BACKS = 56, 64, 72
ROW_COUNTS = 80  # instructions by row of the timing table
STATE_LENGTH = 160  # the table and the caches follow

# One set of a cache: its ways' lines, the way to be replaced next, and unused words up to a line of the host.
WAYS = 4
NEXT_WAY = 4
SET_LENGTH = 8
EMPTY_FETCH, EMPTY_DATA = -1, -2  # lines of data are doubled, plus one if dirty
LINE_SHIFT = 5  # 32 bytes

RUNAWAY, THUMB, NO_TIMING, NOT_CODE, UNALIGNED = range(1, 6)

# As in `decoding` (a test holds it).
PLAIN, JUMP, MAYBE_JUMP, MAYBE_MEMORY, MAYBE_OTHER, MAYBE_ALU, UNKNOWN = range(7)
_REFILL_FETCHES = 2
_MEMORY_WRITE = 17  # UC_MEM_WRITE


@intrinsic  # type: ignore[untyped-decorator]
def _stop(context: Any, function: Any, engine: Any) -> Any:
    """uc_emu_stop, by its address."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(ir.IntType(32), [ir.IntType(8).as_pointer()])
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), [arguments[1]])

    return types.int32(types.int64, types.voidptr), generate


@intrinsic  # type: ignore[untyped-decorator]
def _read_register(context: Any, function: Any, engine: Any, number: Any, buffer: Any) -> Any:
    """uc_reg_read, by its address, into a word at an address."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.IntType(32), [pointer, ir.IntType(32), pointer])
        function, engine, number, buffer = arguments
        number = builder.trunc(number, ir.IntType(32))
        target = builder.inttoptr(function, kind.as_pointer())
        return builder.call(target, [engine, number, builder.inttoptr(buffer, pointer)])

    return types.int32(types.int64, types.voidptr, types.int64, types.int64), generate


@njit
def _holds(condition, cpsr):
    """Whether a condition holds (ARM DDI 0100, A3.2)."""
    negative, zero = cpsr >> 31 & 1, cpsr >> 30 & 1
    carry, overflow = cpsr >> 29 & 1, cpsr >> 28 & 1
    base = condition >> 1
    if base == 0:
        holds = zero == 1
    elif base == 1:
        holds = carry == 1
    elif base == 2:
        holds = negative == 1
    elif base == 3:
        holds = overflow == 1
    elif base == 4:
        holds = carry == 1 and zero == 0
    elif base == 5:
        holds = negative == overflow
    elif base == 6:
        holds = zero == 0 and negative == overflow
    else:
        return True
    return holds != (condition & 1 == 1)


@njit
def _executes(state, engine, rest):
    """Whether the instruction that is about to be executed passes its condition."""
    buffer = state[OWN_ADDRESS] + 8 * REGISTER_BUFFER
    _read_register(state[READ_FUNCTION], engine, state[CPSR_NUMBER], buffer)
    return _holds(rest >> 56 & 15, state[REGISTER_BUFFER] & 0xFFFF_FFFF)


@njit
def _halt(state, engine, reason, address):
    if state[STOPPED] == 0:
        state[STOPPED] = reason
        state[STOPPED_AT] = address
    _stop(state[STOP_FUNCTION], engine)


@njit(cache=True)
def settle(state, executed):
    """Close what was left open of the instruction before."""
    kind, entry = state[OPEN], state[OPEN_ENTRY]
    state[OPEN] = PLAIN
    if not executed:
        return
    rest = state[entry + 2]
    cycles = rest >> 32 & 255
    state[CYCLES] += cycles - 1  # one it had when it was met
    if kind == MAYBE_JUMP:
        state[FETCHES] += _REFILL_FETCHES
        state[LATE] = 0
        state[LATE_TWO] = 0
        return
    kept = 0 if cycles > 1 else state[LATE] & ~(rest >> 16)
    state[LATE] = kept & 0xFFFF | state[entry + 1]
    state[LATE_TWO] = rest & 0xFFFF


@njit
def _fetch(state, line):
    """A line of instructions is entered."""
    state[FETCH_LINE] = line
    for size in range(state[SIZES]):
        entry = state[FETCH_SETS + size] + (line & state[SET_MASK + size]) * SET_LENGTH
        if (
            state[entry] == line
            or state[entry + 1] == line
            or state[entry + 2] == line
            or state[entry + 3] == line
        ):
            continue
        way = state[entry + NEXT_WAY]
        state[entry + way] = line
        state[entry + NEXT_WAY] = way + 1 & WAYS - 1
        state[FETCH_FILLS + size] += 1


@njit
def _access(state, line, write):
    """A line of data is accessed, another than the last or in another way."""
    present = dirty = True  # in all caches, after this access
    for size in range(state[SIZES]):
        entry = state[DATA_SETS + size] + (line & state[SET_MASK + size]) * SET_LENGTH
        hit = -1
        for way in range(WAYS):
            if state[entry + way] >> 1 == line:
                hit = way
        if hit >= 0 and write:
            state[entry + hit] |= 1
        elif hit >= 0:
            dirty = dirty and state[entry + hit] & 1 == 1
        elif write:
            present = False  # to the write buffer: no line is filled
        else:
            dirty = False
            way = state[entry + NEXT_WAY]
            old = state[entry + way]
            if old >= 0:
                state[WRITE_BACKS + size] += old & 1
            state[entry + way] = line << 1
            state[entry + NEXT_WAY] = way + 1 & WAYS - 1
            state[DATA_FILLS + size] += 1
    state[DATA_LINE] = line if present else -1
    state[DATA_LINE_DIRTY] = dirty


@cfunc(types.void(types.voidptr, types.uint64, types.uint32, types.voidptr), cache=True)
def on_instruction(engine, address, size, user_data):
    """uc_cb_hookcode_t: before each instruction."""
    state = carray(user_data, (STATE_LENGTH,), types.int64)
    pc = types.int64(address)
    if state[OPEN] != PLAIN:
        settle(state, pc != state[PC] + 4 if state[OPEN] == MAYBE_JUMP else state[ACCESSED] != 0)
    state[PC] = pc
    if state[INSTRUCTIONS] >= state[MOST_INSTRUCTIONS]:
        _halt(state, engine, RUNAWAY, pc)
        return
    index = pc - state[CODE_START] >> 2
    if size != 4 or index < 0 or index >= state[CODE_WORDS]:
        _halt(state, engine, THUMB if size == 2 else NOT_CODE, pc)
        return
    entry = state[TABLE] + 4 * index
    reads, late, rest = state[entry], state[entry + 1], state[entry + 2]
    kind = rest >> 48 & 255
    if kind == UNKNOWN:
        _halt(state, engine, NO_TIMING, pc)
        return
    state[INSTRUCTIONS] += 1
    state[ROW_COUNTS + (rest >> 40 & 255)] += 1
    if pc >> LINE_SHIFT != state[FETCH_LINE]:
        _fetch(state, pc >> LINE_SHIFT)

    waits_two = state[LATE_TWO]
    wait = 0
    if state[LATE] & reads:
        wait = 2 if waits_two & reads & 0xFFFF else 1
        state[INTERLOCKS] += wait
    cycles = 1
    writes = rest >> 16 & 0xFFFF
    executed = True
    if kind in (MAYBE_JUMP, MAYBE_MEMORY):
        state[OPEN] = kind
        state[OPEN_ENTRY] = entry
        state[ACCESSED] = 0
        executed = False
    elif kind == MAYBE_OTHER or (kind == MAYBE_ALU and waits_two & writes):
        executed = _executes(state, engine, rest)
    if executed:
        cycles = rest >> 32 & 255
        if kind == JUMP or (kind == MAYBE_OTHER and writes >> 15):
            state[FETCHES] += _REFILL_FETCHES
        waits_two &= ~writes
    else:
        late = 0
        rest = 0
    state[LATE] = late if wait + cycles > 1 else waits_two | late
    state[LATE_TWO] = rest & 0xFFFF
    state[CYCLES] += wait + cycles


@cfunc(types.void(types.voidptr, types.uint64, types.uint32, types.voidptr), cache=True)
def on_block(engine, address, size, user_data):
    """uc_cb_hookcode_t: before each block, for a second count of instructions."""
    state = carray(user_data, (STATE_LENGTH,), types.int64)
    state[BLOCK_INSTRUCTIONS] += size >> 2


@cfunc(
    types.void(types.voidptr, types.int32, types.uint64, types.int32, types.int64, types.voidptr), cache=True
)
def on_access(engine, kind, address, size, value, user_data):
    """uc_cb_hookmem_t: before each access to data."""
    state = carray(user_data, (STATE_LENGTH,), types.int64)
    state[ACCESSED] = 1
    state[ACCESSES] += size + 3 >> 2
    place = types.int64(address)
    if place & size - 1:
        _halt(state, engine, UNALIGNED, place)
        return
    line = place >> LINE_SHIFT
    write = kind == _MEMORY_WRITE
    if line != state[DATA_LINE] or (write and not state[DATA_LINE_DIRTY]):
        _access(state, line, write)
