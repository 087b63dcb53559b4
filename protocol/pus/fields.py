"""Field metadata and the construct layouts built from it.

A message is described once, as a list of elements: :class:`Field` (one number, time or request identity),
:class:`Data` (octets), :class:`Repeated` (a count and that many items) and :class:`Switched` (contents that
depend on the value of an earlier field). From this list come the construct layout (bytes <-> values), the
checks of what is to be sent or was received, and the tables of the interface control document.
"""

from __future__ import annotations

import io
import math
import operator
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum, IntFlag
from typing import Any

import construct

from .enumerations import MEANINGS
from .field_types import FLOAT32_MAX, FieldError, FieldProblem, FieldType, FieldViolation, as_float32
from .packets import REQUEST_ID_BITS, CucTime, RequestId


class UnknownIdentifier(construct.ConstructError):
    """While parsing: the value that selects a layout has no layout."""


class _Unidentified(construct.Construct):
    """Contents of an unknown identifier: an error when parsed; octets as given when built (to provoke that
    error).
    """

    def __init__(self, selector: str) -> None:
        super().__init__()
        self.selector = selector

    def _parse(self, stream: Any, context: Any, path: str) -> Any:
        raise UnknownIdentifier(f"{self.selector} {context[self.selector]} is not known")

    def _build(self, obj: Any, stream: Any, context: Any, path: str) -> Any:
        stream.write(obj)
        return obj


Choices = type[IntEnum] | type[IntFlag]


@dataclass(frozen=True)
class Field:
    """One value. Limits are inclusive; None is the limit of the type. ``choices``: an enumeration that
    names every allowed value (IntEnum) or bit (IntFlag). ``identifier`` marks a value whose unknown values
    are reported as UNKNOWN_ID instead of OUT_OF_RANGE.

    In a 32-bit float a limit means its nearest 32-bit value, so that a limit itself may be sent.
    """

    name: str
    type: FieldType
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    meaning: str = ""
    choices: Choices | None = None
    identifier: bool = False

    @property
    def layout(self) -> construct.Construct:
        """Its construct."""
        return self.type.layout

    @property
    def size_bytes(self) -> int | None:
        """Its size."""
        return self.type.size_bytes

    def allowed(self) -> str:
        """What may stand in the field, as text."""
        if self.type.kind == "time":
            return "a CucTime"
        if self.type.kind == "request_id":
            return "a RequestId or its dict"
        if self.choices is not None and issubclass(self.choices, IntEnum):
            return "one of " + ", ".join(f"{member.value} {member.name}" for member in self.choices)
        low, high = self.limits()
        if low == -math.inf and high == math.inf:
            return "any number"
        return f"{_number(low)}..{_number(high)}"

    def limits(self) -> tuple[float, float]:
        """Lowest and highest allowed value."""
        if self.type.kind == "integer":
            low: float = self.type.lowest if self.minimum is None else self.minimum
            high: float = self.type.highest if self.maximum is None else self.maximum
            return low, high
        return (
            -math.inf if self.minimum is None else self.minimum,
            math.inf if self.maximum is None else self.maximum,
        )

    def prepare(self, value: Any, path: str, strict: bool) -> Any:
        """``value`` as a plain Python value fit for the layout; FieldError when it is not allowed.

        Not ``strict``: only what the type itself cannot carry is refused.
        """
        kind = self.type.kind
        if kind == "integer":
            if type(value) is not int:
                value = self._plain_integer(value, path)
            low, high = self.type.lowest, self.type.highest
            if strict:
                if self.minimum is not None:
                    low = int(self.minimum)
                if self.maximum is not None:
                    high = int(self.maximum)
            if not low <= value <= high:
                raise self._error(value, path, FieldProblem.OUT_OF_RANGE)
            if strict and self.choices is not None and not self._is_choice(value):
                raise self._error(value, path, FieldProblem.OUT_OF_RANGE)
            return value
        if kind == "float":
            return self._plain_float(value, path, strict)
        if kind == "time":
            if not isinstance(value, CucTime):
                raise self._error(value, path, FieldProblem.WRONG_TYPE)
            return value
        return self._plain_request_id(value, path)

    def _error(self, value: Any, path: str, problem: FieldProblem) -> FieldError:
        if problem is FieldProblem.OUT_OF_RANGE and self.identifier:
            problem = FieldProblem.UNKNOWN_ID
        return FieldError(FieldViolation(path, value, self.allowed(), problem))

    def _is_choice(self, value: int) -> bool:
        assert self.choices is not None
        if issubclass(self.choices, IntFlag):
            return value & ~_all_bits(self.choices) == 0
        return value in self.choices._value2member_map_

    def _plain_integer(self, value: Any, path: str) -> int:
        if hasattr(value, "item"):  # a numpy scalar
            value = value.item()
        try:
            return int(operator.index(value))
        except TypeError:
            raise self._error(value, path, FieldProblem.WRONG_TYPE) from None

    def _plain_float(self, value: Any, path: str, strict: bool) -> float:
        if type(value) is not float:
            if isinstance(value, (str, bytes)):
                raise self._error(value, path, FieldProblem.WRONG_TYPE)
            try:
                value = float(value)
            except (TypeError, ValueError, OverflowError):
                raise self._error(value, path, FieldProblem.WRONG_TYPE) from None
        low, high = self.minimum, self.maximum
        if self.type.size_bytes == 4:
            if FLOAT32_MAX < abs(value) < math.inf:
                raise self._error(value, path, FieldProblem.OUT_OF_RANGE)
            if strict and (low is not None or high is not None):
                rounded = as_float32(value)
                if not (
                    (low is None or rounded >= as_float32(low))
                    and (high is None or rounded <= as_float32(high))
                ):
                    raise self._error(value, path, FieldProblem.OUT_OF_RANGE)
        elif strict and not ((low is None or value >= low) and (high is None or value <= high)):
            raise self._error(value, path, FieldProblem.OUT_OF_RANGE)
        return float(value)

    def _plain_request_id(self, value: Any, path: str) -> RequestId:
        if isinstance(value, RequestId):
            return value
        if not isinstance(value, Mapping) or set(value) != set(REQUEST_ID_BITS):
            raise self._error(value, path, FieldProblem.WRONG_TYPE)
        for name, bits in REQUEST_ID_BITS.items():
            part = value[name]
            if not isinstance(part, int) or not 0 <= part < 1 << bits:
                raise FieldError(
                    FieldViolation(f"{path}.{name}", part, f"0..{(1 << bits) - 1}", FieldProblem.OUT_OF_RANGE)
                )
        return RequestId.from_fields(value)


def _all_bits(flags: type[IntFlag]) -> int:
    bits = 0
    for member in flags:
        bits |= member.value
    return bits


def _number(value: float) -> str:
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        value = int(value)
    return f"{value}"


@dataclass(frozen=True)
class Data:
    """Octets: with their number in front (``count``) or, without ``count``, up to the end of the packet."""

    name: str
    minimum: int
    maximum: int
    meaning: str
    count: FieldType | None = None

    @property
    def layout(self) -> construct.Construct:
        """Its construct."""
        if self.count is None:
            return construct.GreedyBytes
        return construct.Prefixed(self.count.layout, construct.GreedyBytes)

    @property
    def size_bytes(self) -> int | None:
        """None: it varies."""
        return None

    def allowed(self) -> str:
        """What may stand in the field, as text."""
        return f"{self.minimum}..{self.maximum} octets"

    def prepare(self, value: Any, path: str, strict: bool) -> bytes:
        """``value`` as bytes; FieldError when it is too long or no octets at all."""
        if not isinstance(value, (bytes, bytearray, memoryview)):
            raise FieldError(FieldViolation(path, value, self.allowed(), FieldProblem.WRONG_TYPE))
        octets = bytes(value)
        highest = self.maximum if strict else (self.count.highest if self.count else 1 << 16)
        if len(octets) > highest or (strict and len(octets) < self.minimum):
            raise FieldError(
                FieldViolation(path, f"{len(octets)} octets", self.allowed(), FieldProblem.OUT_OF_RANGE)
            )
        return octets


@dataclass(frozen=True)
class Repeated:
    """A count (``u8``) and that many items. One unnamed-item element: a list of values; several: a list of
    dicts.
    """

    name: str
    items: tuple[Element, ...]
    minimum: int
    maximum: int
    meaning: str

    @property
    def group(self) -> FieldGroup:
        """Its items as a group."""
        return FieldGroup(self.items)

    @property
    def single(self) -> bool:
        """Whether an item is one plain value."""
        return len(self.items) == 1

    @property
    def layout(self) -> construct.Construct:
        """Its construct."""
        item = self.items[0].layout if self.single else FieldGroup(self.items).layout
        return construct.PrefixedArray(construct.Int8ub, item)

    @property
    def size_bytes(self) -> int | None:
        """None: it varies."""
        return None

    def allowed(self) -> str:
        """What may stand in the field, as text."""
        return f"{self.minimum}..{self.maximum} items"

    def prepare(self, value: Any, path: str, strict: bool) -> list[Any]:
        """``value`` as a list of plain values; FieldError for the first wrong item."""
        if isinstance(value, (str, bytes, Mapping)) or not hasattr(value, "__iter__"):
            raise FieldError(
                FieldViolation(path, value, "a list of " + self.allowed(), FieldProblem.WRONG_TYPE)
            )
        items = list(value)
        low, high = (self.minimum, self.maximum) if strict else (0, 255)
        if not low <= len(items) <= high:
            raise FieldError(
                FieldViolation(path, f"{len(items)} items", self.allowed(), FieldProblem.OUT_OF_RANGE)
            )
        if self.single:
            element = self.items[0]
            assert not isinstance(element, Switched)
            return [element.prepare(item, f"{path}[{n}]", strict) for n, item in enumerate(items)]
        group = FieldGroup(self.items)
        return [group.prepare(item, f"{path}[{n}].", strict) for n, item in enumerate(items)]


@dataclass(frozen=True)
class Case:
    """What a Switched element holds for one value of its selector: one value (``single``) or a group of
    fields.
    """

    title: str
    fields: tuple[Element, ...]
    single: bool = False

    @property
    def layout(self) -> construct.Construct:
        """Its construct."""
        return self.fields[0].layout if self.single else FieldGroup(self.fields).layout


@dataclass(frozen=True)
class Switched:
    """Contents that depend on the value of the earlier field ``on`` of the same group."""

    name: str
    on: str
    cases: Mapping[int, Case]
    meaning: str

    @property
    def layout(self) -> construct.Construct:
        """Its construct."""
        on = self.on
        return construct.Switch(
            lambda context: context[on],
            {number: case.layout for number, case in self.cases.items()},
            default=_Unidentified(on),
        )

    @property
    def size_bytes(self) -> int | None:
        """None: it varies."""
        return None

    def prepare(self, values: Mapping[str, Any], path: str, strict: bool, selector: int) -> Any:
        """The contents in ``values``, the group's, as the case of ``selector`` needs them.

        FieldError when they do not fit; contents without any field may be left out. Not ``strict``: octets
        for an unknown ``selector``.
        """
        value = values.get(self.name)
        case = self.cases.get(selector)
        if case is None:
            if not strict and isinstance(value, (bytes, bytearray)):
                return bytes(value)
            known = ", ".join(f"{number} {entry.title}" for number, entry in self.cases.items())
            raise FieldError(
                FieldViolation(path + self.on, selector, f"one of {known}", FieldProblem.UNKNOWN_ID)
            )
        if not case.single:
            return FieldGroup(case.fields).prepare(
                {} if value is None else value, f"{path}{self.name}.", strict
            )
        element = case.fields[0]
        assert isinstance(element, Field)
        if self.name not in values:
            raise FieldError(FieldViolation(path + self.name, None, element.allowed(), FieldProblem.MISSING))
        return element.prepare(value, path + self.name, strict)


Element = Field | Data | Repeated | Switched


@dataclass(frozen=True)
class FieldGroup:
    """Elements one after the other: a dict in Python, a construct Struct on the wire."""

    elements: tuple[Element, ...]

    @property
    def layout(self) -> construct.Construct:
        """The construct of the whole group."""
        return construct.Struct(*(element.name / element.layout for element in self.elements))

    @property
    def size_bytes(self) -> int | None:
        """Its size, None when it varies."""
        total = 0
        for element in self.elements:
            if element.size_bytes is None:
                return None
            total += element.size_bytes
        return total

    def prepare(self, values: Any, path: str, strict: bool) -> dict[str, Any]:
        """``values`` as a plain dict fit for the layout; FieldError for the first value that is not allowed.

        Switched contents without any field may be left out.
        """
        if not isinstance(values, Mapping):
            raise FieldError(
                FieldViolation(path.rstrip(".") or "fields", values, "a dict", FieldProblem.WRONG_TYPE)
            )
        prepared: dict[str, Any] = {}
        for element in self.elements:
            name = element.name
            if isinstance(element, Switched):
                prepared[name] = element.prepare(values, path, strict, prepared[element.on])
            elif name in values:
                prepared[name] = element.prepare(values[name], path + name, strict)
            else:
                allowed = element.allowed()
                raise FieldError(FieldViolation(path + name, None, allowed, FieldProblem.MISSING))
        if len(values) > len(prepared) or any(name not in prepared for name in values):
            known = [element.name for element in self.elements]
            extra = next(name for name in values if name not in prepared)
            allowed = "only " + ", ".join(known) if known else "no fields"
            raise FieldError(
                FieldViolation(f"{path}{extra}", values[extra], allowed, FieldProblem.UNEXPECTED)
            )
        return prepared


class DataLayout:
    """The application or source data of a message: a FieldGroup with its construct built once.

    ``earlier_ends``: elements, all before them of fixed size, behind which data may end as well, as they did
    before the message grew. Such data are read, never built.
    """

    def __init__(self, elements: tuple[Element, ...], earlier_ends: tuple[str, ...] = ()) -> None:
        self.group = FieldGroup(elements)
        self.construct = self.group.layout
        names = [element.name for element in elements]
        self._earlier: dict[int | None, DataLayout] = {}
        for name in earlier_ends:
            earlier = DataLayout(elements[: names.index(name) + 1])
            self._earlier[earlier.group.size_bytes] = earlier

    def build(self, values: Mapping[str, Any], strict: bool = True) -> bytes:
        """The bytes of ``values``; FieldError when they are not allowed."""
        return bytes(self.construct.build(self.group.prepare(values, "", strict)))

    def parse(self, data: bytes) -> dict[str, Any]:
        """The plain values of ``data``; construct.ConstructError when the layout does not use it up
        exactly. Data that end where they did earlier have no values for what was added behind.
        """
        earlier = self._earlier.get(len(data))
        if earlier is not None:
            return earlier.parse(data)
        stream = io.BytesIO(data)
        values = self.construct.parse_stream(stream)
        left = len(data) - stream.tell()
        if left:
            raise construct.ConstructError(f"{left} bytes too many")
        return _plain_dict(values)

    def violation(self, values: Mapping[str, Any]) -> FieldViolation | None:
        """The first thing in decoded ``values`` that is not allowed, None when all is well."""
        for earlier in self._earlier.values():
            if values.keys() == {element.name for element in earlier.group.elements}:
                return earlier.violation(values)
        try:
            self.group.prepare(values, "", True)
        except FieldError as error:
            return error.violation
        return None


def _plain(value: Any) -> Any:
    if isinstance(value, construct.ListContainer):
        return [_plain(item) for item in value]
    if isinstance(value, construct.Container):
        return _plain_dict(value)
    return value


def _plain_dict(values: construct.Container) -> dict[str, Any]:
    return {name: _plain(value) for name, value in values.items() if name != "_io"}


def meaning_of(member: Enum) -> str:
    """The meaning of an enumeration member, for the tables of the interface document."""
    return MEANINGS.get(member, "")
