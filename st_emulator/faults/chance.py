"""Faults by chance: settings of any kind, drawn from what its model allows."""

from __future__ import annotations

import math
import random
from collections.abc import Iterable
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic.fields import FieldInfo

from .catalogue import FAULTS
from .fault import FaultKind, FaultSettings, Wire

OF_ALL = frozenset(FaultSettings.model_fields)
"""Settings that every fault has: its time, its probability and its seed."""

DECADES = 1.0  # a number is drawn so far from its default, either way
NEAR_ZERO = 1e-3  # of a range from 0 on, when there is no default to begin from
UNBOUNDED = 1e6


def kinds_of(wire: Wire, dialect: str, seams: Iterable[str] = ()) -> list[FaultKind]:
    """The kinds that a unit can have, of some seams or of all."""
    wanted = frozenset(seams)
    return [
        kind
        for kind in FAULTS.values()
        if wire in kind.wires
        and (kind.dialects is None or dialect in kind.dialects)
        and (not wanted or kind.seam in wanted)
    ]


def settings_by_chance(kind: FaultKind, chance: random.Random) -> dict[str, Any]:
    """A fault's table without times and seed. Settings that may not stand together are not always avoided:
    whoever puts the fault in is told so.
    """
    table: dict[str, Any] = {"kind": kind.name}
    for name, field in kind.settings.model_fields.items():
        if name in OF_ALL:
            continue
        if field.is_required() or chance.random() < 0.5:
            value = _value(field.annotation, field, chance)
            if value is not None:
                table[name] = value
    if chance.random() < 0.5:
        table["probability"] = round(10 ** chance.uniform(-3, 0), 6)
    return table


def _value(annotation: Any, field: FieldInfo, chance: random.Random) -> Any:
    """A value of a type within the field's limits; None: the default will do."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return chance.choice(arguments)
    if origin in (Union, UnionType):
        return _value(next(one for one in arguments if one is not NoneType), field, chance)
    if origin is not None and hasattr(annotation, "__metadata__"):  # Annotated within a union
        return _value(arguments[0], FieldInfo.from_annotation(annotation), chance)
    if annotation is bool:
        return chance.random() < 0.5
    if annotation is int:
        return _whole(field, chance)
    if annotation is float:
        return _number(field, chance)
    return None  # a list or a text has no scale to draw from


def _limits(field: FieldInfo) -> tuple[float, float]:
    low, high = -UNBOUNDED, UNBOUNDED
    for limit in field.metadata:  # of numbers; their type says no more than that they can be compared
        if isinstance(limit, Ge):
            low = float(limit.ge)  # type: ignore[arg-type]
        elif isinstance(limit, Gt):
            low = math.nextafter(float(limit.gt), math.inf)  # type: ignore[arg-type]
        elif isinstance(limit, Le):
            high = float(limit.le)  # type: ignore[arg-type]
        elif isinstance(limit, Lt):
            high = math.nextafter(float(limit.lt), -math.inf)  # type: ignore[arg-type]
    return low, high


def _number(field: FieldInfo, chance: random.Random) -> float:
    low, high = _limits(field)
    default = field.default if isinstance(field.default, int | float) else 0
    if default:
        value = default * 10 ** chance.uniform(-DECADES, DECADES)
        if low < 0 and chance.random() < 0.5:
            value = -value
    elif low >= 0 and high > 100:
        value = max(low, NEAR_ZERO) * (high / max(low, NEAR_ZERO)) ** chance.random()
    else:
        value = chance.uniform(low, high)
    return min(max(float(f"{value:.6g}"), low), high)


def _whole(field: FieldInfo, chance: random.Random) -> int:
    low, high = _limits(field)
    value = round(_number(field, chance))
    return min(max(value, math.ceil(low)), math.floor(high))
