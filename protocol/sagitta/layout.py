"""Layouts of little-endian numbers: what stands in the arguments and data of the messages."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any

from ..errors import LocalProtocolError

__all__ = ["Element", "Field", "Kind", "Layout", "Repeated"]


class Kind(Enum):
    """How a number stands on the line: its letter of :mod:`struct`."""

    U8 = "B"
    U16 = "H"
    I16 = "h"
    U32 = "I"
    U64 = "Q"
    F32 = "f"

    @property
    def octets(self) -> int:
        """Bytes of one number."""
        return struct.calcsize("<" + self.value)

    @property
    def limits(self) -> tuple[int, int]:
        """Smallest and largest whole number."""
        bits = 8 * self.octets
        if self is Kind.I16:
            return -(1 << bits - 1), (1 << bits - 1) - 1
        return 0, (1 << bits) - 1


@dataclass(frozen=True)
class Field:
    """One number, or ``count`` of them in a row. ``default``: one for all, or one for each."""

    name: str
    kind: Kind
    meaning: str = ""
    unit: str = ""
    count: int = 1
    default: float | tuple[float, ...] = 0

    @property
    def octets(self) -> int:
        """Bytes of all of them."""
        return self.count * self.kind.octets

    @property
    def defaults(self) -> tuple[float, ...]:
        """The default of each."""
        return self.default if isinstance(self.default, tuple) else (self.default,) * self.count


@dataclass(frozen=True)
class Repeated:
    """A group of fields, ``count`` times one after the other."""

    name: str
    count: int
    fields: tuple[Field, ...]
    meaning: str = ""

    @property
    def octets(self) -> int:
        """Bytes of all of them."""
        return self.count * sum(field.octets for field in self.fields)


Element = Field | Repeated


def _number(message: str, path: str, kind: Kind, value: Any) -> float | int:
    """``value`` as it can be packed."""
    if kind is Kind.F32:
        allowed = "a finite number of a 32-bit float"
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise LocalProtocolError(message, path, value, allowed)
        try:
            struct.pack("<f", value)
        except (OverflowError, struct.error):  # of a float, of a whole number
            raise LocalProtocolError(message, path, value, allowed) from None
        if not math.isfinite(value):
            raise LocalProtocolError(message, path, value, allowed)
        return float(value)
    lowest, highest = kind.limits
    if isinstance(value, bool) or not isinstance(value, int) or not lowest <= value <= highest:
        raise LocalProtocolError(message, path, value, f"a whole number from {lowest} to {highest}")
    return value


def _packed(message: str, path: str, element: Field, values: Mapping[str, Any]) -> bytes:
    given = values.get(element.name)
    numbers: Sequence[Any]
    if given is None:
        numbers = [value if element.kind is Kind.F32 else int(value) for value in element.defaults]
    elif element.count == 1:
        numbers = [given]
    elif isinstance(given, (list, tuple)) and len(given) == element.count:
        numbers = given
    else:
        raise LocalProtocolError(message, path, given, f"a list of {element.count} numbers")
    checked = [_number(message, path, element.kind, value) for value in numbers]
    return struct.pack(f"<{element.count}{element.kind.value}", *checked)


@dataclass(frozen=True)
class Layout:
    """Elements one after the other, without gaps."""

    elements: tuple[Element, ...]

    @cached_property
    def octets(self) -> int:
        """Bytes of the whole."""
        return sum(element.octets for element in self.elements)

    @property
    def defaults(self) -> bytes:
        """The octets of all defaults."""
        return self.pack("defaults", {})

    def pack(self, message: str, values: Mapping[str, Any]) -> bytes:
        """The octets of values by name; what is not given has its default. A field of several numbers takes
        a list, a group a list of tables.

        Raises:
            LocalProtocolError: names ``message``, the field and what is allowed.
        """
        known = [element.name for element in self.elements]
        for name in values:
            if name not in known:
                raise LocalProtocolError(
                    message, name, values[name], f"the fields {', '.join(known)}" if known else "no fields"
                )
        parts = []
        for element in self.elements:
            if isinstance(element, Field):
                parts.append(_packed(message, element.name, element, values))
                continue
            rows = values.get(element.name, [{}] * element.count)
            if not isinstance(rows, (list, tuple)) or len(rows) != element.count:
                raise LocalProtocolError(message, element.name, rows, f"a list of {element.count} tables")
            for number, row in enumerate(rows):
                path = f"{element.name}[{number}]"
                if not isinstance(row, Mapping):
                    raise LocalProtocolError(message, path, row, "a table")
                parts += [_packed(message, f"{path}.{field.name}", field, row) for field in element.fields]
        return b"".join(parts)

    def unpack(self, data: bytes) -> dict[str, Any] | None:
        """Values by name, as :meth:`pack` takes them (floats may be infinite or not numbers); None when the
        length is wrong.
        """
        if len(data) != self.octets:
            return None
        values: dict[str, Any] = {}
        place = 0
        for element in self.elements:
            if isinstance(element, Field):
                values[element.name] = _unpacked(element, data, place)
                place += element.octets
                continue
            rows = []
            for _ in range(element.count):
                row = {}
                for field in element.fields:
                    row[field.name] = _unpacked(field, data, place)
                    place += field.octets
                rows.append(row)
            values[element.name] = rows
        return values


def _unpacked(field: Field, data: bytes, place: int) -> Any:
    numbers = struct.unpack_from(f"<{field.count}{field.kind.value}", data, place)
    return numbers[0] if field.count == 1 else list(numbers)
