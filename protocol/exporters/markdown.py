"""Markdown pieces of the interface document: tables and the byte tables of fields."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import IntFlag

from ..pus.fields import Choices, Data, Element, Field, FieldGroup, Repeated, Switched
from ..pus.headers import HeaderLayout

IDENTIFIERS = {
    "HousekeepingId": ("structures", "housekeeping-structures"),
    "EventId": ("events", "events"),
    "FunctionId": ("functions", "functions"),
    "ParameterId": ("parameters", "parameters"),
    "FailureCode": ("failure codes", "failure-codes"),
}
"""Enumerations that have a table of their own: what the link to it says, and where it goes."""

FIELD_HEADINGS = ("Byte", "Field", "Type", "Unit", "Range", "Meaning")


def table(headings: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    """The lines of a table, columns padded so that it can be read unrendered, and an empty line."""
    cells = [[str(cell).replace("|", "\\|") for cell in row] for row in (headings, *rows)]
    widths = [max(3, *(len(row[column]) for row in cells)) for column in range(len(headings))]
    # A long last column is not padded: it would only push spaces to the right.
    widths[-1] = max(3, len(cells[0][-1]))
    lines = [
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |"
        for row in cells
    ]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return [*lines, ""]


def bit_place(bit: int, bits: int) -> str:
    """Where a field of ``bits`` bits from ``bit`` on stands: bytes, and bits counted from the most
    significant.
    """
    last = bit + bits - 1
    if bit % 8 == 0 and bits % 8 == 0:
        return f"{bit // 8}" if bits == 8 else f"{bit // 8}..{last // 8}"
    if bit // 8 == last // 8:
        where = f"bit {bit % 8}" if bits == 1 else f"bits {bit % 8}..{last % 8}"
        return f"{bit // 8} {where}"
    return f"{bit // 8} bit {bit % 8} .. {last // 8} bit {last % 8}"


def header_table(layout: HeaderLayout, first_byte: int) -> list[str]:
    """The bit table of a header that starts at ``first_byte`` of the packet."""
    rows = []
    bit = 8 * first_byte
    for entry in layout.fields:
        rows.append((bit_place(bit, entry.bits), f"`{entry.name}`", entry.bits, entry.title, entry.value))
        bit += entry.bits
    return table(("Byte", "Field", "Bits", "Name in the standard", "Value"), rows)


def value_range_of(choices: Choices) -> str:
    """The range column of values that an enumeration names: a link to it."""
    name = choices.__name__
    title, anchor = IDENTIFIERS.get(name, (name, name.lower()))
    what = "bits of " if issubclass(choices, IntFlag) else ""
    return f"{what}[{title}](#{anchor})"


def value_range(field: Field) -> str:
    """The range column of a field: empty when the type says all."""
    if field.choices is not None:
        return value_range_of(field.choices)
    if field.minimum is None and field.maximum is None:
        return ""
    return field.allowed()


def field_row(place: str, field: Field, indent: str = "") -> tuple[str, ...]:
    """The row of one field."""
    kind = "[request ID](#request-id)" if field.type.kind == "request_id" else field.type.name
    return (place, f"{indent}`{field.name}`", kind, field.unit, value_range(field), field.meaning)


def fields_table(elements: Sequence[Element], first_byte: int, switched: str = "") -> list[str]:
    """The byte table of the data of a message; ``switched`` says where Switched contents are described."""
    rows: list[tuple[str, ...]] = []
    place = _Place(first_byte)
    for element in elements:
        if isinstance(element, Field):
            rows.append(field_row(place.text(), element))
            place.advance(element.type.size_bytes)
        elif isinstance(element, Data):
            if element.count is not None:
                rows.append(
                    (
                        place.text(),
                        f"`{element.name}` length n",
                        element.count.name,
                        "byte",
                        "",
                        "number of octets",
                    )
                )
                place.advance(element.count.size_bytes)
            rows.append((place.text(), f"`{element.name}`", "octets", "", element.allowed(), element.meaning))
            place.lengthen("n")
        elif isinstance(element, Repeated):
            rows.append(
                (place.text(), f"`{element.name}` count N", "u8", "", element.allowed(), element.meaning)
            )
            place.advance(1)
            rows.extend(_item_rows(element, place, switched))
            place.lengthen("items")
        else:
            rows.append(
                (
                    place.text(),
                    f"`{element.name}`",
                    "by " + f"`{element.on}`",
                    "",
                    "",
                    switched or element.meaning,
                )
            )
            place.lengthen("contents")
    return table(FIELD_HEADINGS, rows)


def _item_rows(element: Repeated, place: _Place, switched: str) -> list[tuple[str, ...]]:
    size = FieldGroup(element.items).size_bytes
    rows: list[tuple[str, ...]] = []
    offset = 0
    for item in element.items:
        where = (
            f"{place.start + offset}+{size if size > 1 else ''}i" if size is not None else f"item+{offset}"
        )
        if isinstance(item, Field):
            rows.append(field_row(where, item, "item i: "))
            offset += item.type.size_bytes
        else:
            assert isinstance(item, Switched)
            rows.append(
                (where, f"item i: `{item.name}`", f"by `{item.on}`", "", "", switched or item.meaning)
            )
    return rows


class _Place:
    """Where the next field starts: a number, and behind contents of varying length what to add to it."""

    def __init__(self, start: int) -> None:
        self.start = start
        self.behind = ""

    def text(self) -> str:
        return f"{self.start}{self.behind}"

    def advance(self, size: int) -> None:
        self.start += size

    def lengthen(self, what: str) -> None:
        self.behind += f"+{what}"
