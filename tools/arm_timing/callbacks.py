"""What the simulator calls at each instruction and data access, compiled.

All in one file: numba compiles a function anew when its own file has changed, not another it calls.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import carray, cfunc, types
from numba.extending import intrinsic

# Places in the state, an array of int64.
INSTRUCTIONS = 0
MOST_INSTRUCTIONS = 1  # the run is stopped at so many
STOP_FUNCTION = 2  # address of the simulator's function that stops it
STOPPED = 3  # why: 0 not, or one of the reasons below
PC = 4
STATE_LENGTH = 64

RUNAWAY = 1


@intrinsic  # type: ignore[untyped-decorator]
def _call(context: Any, function: Any, engine: Any) -> Any:
    """Call int f(void *) at an address."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.IntType(32), [pointer])
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), [arguments[1]])

    return types.int32(types.int64, types.voidptr), generate


@cfunc(types.void(types.voidptr, types.uint64, types.uint32, types.voidptr), cache=True)
def on_instruction(engine, address, size, user_data):
    """uc_cb_hookcode_t: before each instruction."""
    state = carray(user_data, (STATE_LENGTH,), types.int64)
    state[PC] = address
    if state[INSTRUCTIONS] >= state[MOST_INSTRUCTIONS]:
        if state[STOPPED] == 0:
            state[STOPPED] = RUNAWAY
        _call(state[STOP_FUNCTION], engine)
        return
    state[INSTRUCTIONS] += 1
