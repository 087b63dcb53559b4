"""`expect FIELD OP VALUE`: what a script holds the unit to."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

from ..clock import NS_PER_S
from ..naming import field_text, member
from ..protocol.pus.enumerations import HousekeepingId, Mode
from ..protocol.pus.fields import Element, Field
from ..protocol.pus.housekeeping import HOUSEKEEPING_TABLE
from ..protocol.pus.parameters import PARAMETER_TABLE
from ..protocol.pus.registry import REGISTRY
from ..report import Check
from .attitude import Attitude
from .client import Obc
from .counters import CanCounters
from .cuc_time import seconds

OPERATORS: dict[str, Callable[[Any, Any], bool]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
FRESH_NS = NS_PER_S
"""An attitude report older than this is not what the unit says now."""
ATTITUDE_TIMEOUT_S = 2.0
POINTING = {"ra_deg": 0, "dec_deg": 1, "roll_deg": 2}
FORMS = "mode, attitude.FIELD, status.FIELD, link.FIELD, timing.FIELD, parameter.NAME or counters.NAME"


@dataclass(frozen=True)
class Quantity:
    """Something that can be asked of the unit: how it is called, read and written."""

    name: str
    unit: str
    element: Field | None
    read: Callable[[Obc], float | int]

    def text(self, value: float | int) -> str:
        """A value for a person."""
        return str(value) if self.element is None else field_text([self.element], self.element.name, value)

    def parse(self, text: str) -> float | int:
        """The value that a person wrote; ValueError says what is allowed."""
        if self.element is not None and self.element.choices is not None:
            return member(self.element.choices, text)
        try:
            return int(text, 0)
        except ValueError:
            pass
        try:
            return float(text)
        except ValueError:
            raise ValueError(f"{text!r} is no number") from None


@dataclass(frozen=True)
class Expectation:
    """One comparison."""

    quantity: Quantity
    operation: str
    target: float | int

    def check(self, obc: Obc) -> Check:
        """Ask the unit and compare."""
        value = self.quantity.read(obc)
        return Check(
            self.quantity.name,
            value,
            f"{self.operation} {self.quantity.text(self.target)}",
            self.quantity.unit,
            OPERATORS[self.operation](value, self.target),
        )


def parse_expectation(name: str, operation: str, target: str) -> Expectation:
    """From the three words; ValueError says what is wrong and what is allowed."""
    if operation not in OPERATORS:
        raise ValueError(f"{operation!r} is no comparison; allowed are {' '.join(OPERATORS)}")
    quantity = quantity_called(name)
    return Expectation(quantity, operation, quantity.parse(target))


def quantity_called(name: str) -> Quantity:
    """The quantity that a person means; ValueError lists what there is."""
    group, _, field_name = name.partition(".")
    if name == "mode":
        element = _field(HOUSEKEEPING_TABLE[0].fields, "mode")
        return Quantity(name, "", element, lambda obc: int(obc.mode()))
    if group == "attitude":
        return _attitude(name, field_name)
    if group == "parameter":
        by_name = {entry.name: entry for entry in PARAMETER_TABLE}
        _require(group, field_name, by_name)
        return Quantity(
            name, by_name[field_name].unit, None, lambda obc: obc.parameters([field_name])[field_name]
        )
    if group == "counters":
        _require(group, field_name, [entry.name for entry in fields(CanCounters)])
        return Quantity(name, "", None, lambda obc: _counter(obc, field_name))
    for structure in HOUSEKEEPING_TABLE:
        if group == structure.name.lower():
            _require(group, field_name, [element.name for element in structure.fields])
            element = _field(structure.fields, field_name)
            return Quantity(name, element.unit, element, _housekeeping(structure.id, field_name))
    raise ValueError(f"{name!r} is nothing to expect; allowed are {FORMS}")


def _counter(obc: Obc, name: str) -> int:
    counts = obc.counters.as_dict()
    if name not in counts:
        raise ValueError(f"{obc.link.name} is no CAN bus: it does not count {name}")
    return counts[name]


def _housekeeping(structure: HousekeepingId, field_name: str) -> Callable[[Obc], float | int]:
    def read(obc: Obc) -> float | int:
        value: float | int = obc.housekeeping(structure)[field_name]
        return value

    return read


def _attitude(name: str, field_name: str) -> Quantity:
    if field_name in POINTING:
        index = POINTING[field_name]
        return Quantity(name, "deg", None, lambda obc: _latest(obc).pointing_deg[index])
    elements = [
        element for element in REGISTRY.by_name("attitude_report").fields if isinstance(element, Field)
    ]
    _require("attitude", field_name, [element.name for element in elements] + list(POINTING))
    element = _field(elements, field_name)

    def read(obc: Obc) -> float | int:
        _latest(obc)
        told = obc.unit.latest["attitude_report"].fields
        if field_name not in told:
            raise ValueError(f"the unit is an older one: its attitude reports have no {field_name}")
        value = told[field_name]
        return seconds(value) if element.type.kind == "time" else value

    return Quantity(name, element.unit, element, read)


def _latest(obc: Obc) -> Attitude:
    """The attitude of now: the last report when it is fresh, else the next."""
    attitudes = obc.attitudes()
    if not attitudes or obc.now_ns() - attitudes[-1].received_ns > FRESH_NS:
        obc.next("attitude_report", ATTITUDE_TIMEOUT_S)
    return obc.attitudes()[-1]


def _field(elements: Sequence[Element], name: str) -> Field:
    return next(element for element in elements if isinstance(element, Field) and element.name == name)


def _require(group: str, name: str, known: Any) -> None:
    if name not in known:
        raise ValueError(f"{group} has no {name!r}; it has {', '.join(known)}")


def mode_text(mode: Mode | None) -> str:
    """The mode for a person."""
    return "unknown" if mode is None else mode.name
