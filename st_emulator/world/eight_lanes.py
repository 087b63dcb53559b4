"""Eight neighbouring float32 at a time, for compiled kernels.

The compiler turns long loops into such operations by itself, but not loops over eight. Each lane is one
multiplication and one addition, both rounded, as in a loop: the same on every machine.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 8
_EIGHT = ir.VectorType(ir.FloatType(), LANES)


def _place(context: Any, builder: Any, kind: Any, array: Any, at: Any) -> Any:
    proxy: Any = cgutils.create_struct_proxy
    data = proxy(kind)(context, builder, value=array).data
    return builder.bitcast(builder.gep(data, [at]), _EIGHT.as_pointer())


def _eight_of(builder: Any, number: Any) -> Any:
    one = builder.insert_element(ir.Constant(_EIGHT, ir.Undefined), number, ir.Constant(ir.IntType(32), 0))
    lanes = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(one, ir.Constant(_EIGHT, ir.Undefined), lanes)


@intrinsic
def _add_scaled(typing: Any, to: Any, at: Any, amount: Any, shares: Any, first: Any) -> Any:
    """to[at : at + 8] += amount * shares[first : first + 8]; contiguous float32[n], no bounds are checked."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args
        goal = _place(context, builder, kinds[0], arguments[0], arguments[1])
        parts = builder.load(_place(context, builder, kinds[3], arguments[3], arguments[4]), align=4)
        more = builder.fmul(_eight_of(builder, arguments[2]), parts)
        builder.store(builder.fadd(builder.load(goal, align=4), more), goal, align=4)
        return context.get_dummy_value()

    return types.void(to, types.int64, types.float32, shares, types.int64), generate


@intrinsic
def _between(typing: Any, table: Any, here: Any, after: Any, part: Any, out: Any, at: Any) -> Any:
    """out[at + i] = table[here + i] + part * (table[after + i] - table[here + i]), i below 8; as above."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args
        a = builder.load(_place(context, builder, kinds[0], arguments[0], arguments[1]), align=4)
        b = builder.load(_place(context, builder, kinds[0], arguments[0], arguments[2]), align=4)
        more = builder.fmul(_eight_of(builder, arguments[3]), builder.fsub(b, a))
        goal = _place(context, builder, kinds[4], arguments[4], arguments[5])
        builder.store(builder.fadd(a, more), goal, align=4)
        return context.get_dummy_value()

    return types.void(table, types.int64, types.int64, types.float32, out, types.int64), generate


# as kernels call them, without the first argument, which the compiler gives
add_scaled: Any = _add_scaled
between: Any = _between
