"""The interface document's chapters on frames and messages, from the tables that the codec uses."""

from __future__ import annotations

from collections.abc import Iterable

from ..exporters.markdown import table
from ..framing import END, ESC, ESC_END, ESC_ESC
from .frames import (
    ADDRESS,
    HASH_BYTES,
    HASH_SEED,
    HEADER_BYTES,
    MOST_REQUEST_BYTES,
    STATUS_MEANINGS,
    TELEMETRY_HEADER_BYTES,
    MessageType,
    RefusedFrame,
)
from .layout import Element, Field, Layout
from .parameters import PARAMETER_TABLE
from .telemetry import ACTION_TABLE, STRATEGY_MEANINGS, TELEMETRY_TABLE

__all__ = ["message_chapters"]

_HEADINGS = ("Byte", "Field", "Type", "Unit", "Meaning")

_LAYOUTS = (
    (MessageType.SET_PARAMETER, "OBC", "set parameter", "arguments"),
    (MessageType.READ_PARAMETER, "OBC", "read parameter", ""),
    (MessageType.REQUEST_TELEMETRY, "OBC", "request telemetry", ""),
    (MessageType.ACTION, "OBC", "action", "arguments"),
    (MessageType.SET_PARAMETER_REPLY, "unit", "reply to 00", "u8 status"),
    (MessageType.PARAMETER, "unit", "reply to 01", "arguments; **no status**"),
    (MessageType.TELEMETRY, "unit", "reply to 02", "u8 status, u32 counter, u64 time, data"),
    (MessageType.ACTION_REPLY, "unit", "reply to 03", "u8 status. ASSUMED: nothing behind it"),
    (MessageType.ASYNCHRONOUS_TELEMETRY, "unit", "subscribed telemetry", "as 82"),
)


def _fields(layout: Layout, first: int, *, defaults: bool) -> list[str]:
    """The byte table of a layout whose first byte is ``first``, counted from the address byte."""
    rows = []
    place = first
    for element in layout.elements:
        rows += [row for _, row in _rows(element, place, defaults)]
        place += element.octets
    headings = (*_HEADINGS, "Default") if defaults else _HEADINGS
    return table(headings, rows)


def _rows(element: Element, place: int, defaults: bool) -> Iterable[tuple[int, tuple[str, ...]]]:
    if isinstance(element, Field):
        yield place, _row(element, f"{place}", element.name, defaults)
        return
    size = element.octets // element.count
    if element.meaning:
        note = ("", f"`{element.name}`", f"{element.count} x {size} bytes", "", element.meaning)
        yield place, (*note, "") if defaults else note
    for field in element.fields:
        where = f"{place} + {size} n"
        yield place, _row(field, where, f"{element.name}[n].{field.name}", defaults, element.count)
        place += field.octets


def _row(field: Field, where: str, name: str, defaults: bool, repeated: int = 1) -> tuple[str, ...]:
    kind = field.kind.name.lower()
    if field.count > 1:
        kind = f"{field.count} x {kind}"
    meaning = field.meaning
    if repeated > 1:
        meaning = f"{meaning}; n = 0 to {repeated - 1}" if meaning else f"n = 0 to {repeated - 1}"
    row = (where, f"`{name}`", kind, field.unit, meaning)
    if not defaults:
        return row
    values = field.defaults
    same = len(set(values)) == 1
    return (*row, f"{values[0]:g}" if same else ", ".join(f"{value:g}" for value in values))


def message_chapters() -> list[str]:
    """The lines of the chapters: frames, parameters, actions, telemetry."""
    lines = [
        "## Frames",
        "",
        "All numbers are little-endian; `f32` is an IEEE 754 float, `u8` to `u64` count from 0, `i16` has a "
        "sign. Bytes count from the address byte, escapes undone; types and bytes of the framing are "
        "hexadecimal, ids decimal.",
        "",
        *table(
            ("Part", "Bytes", "Value"),
            (
                ("start", "1", f"{END:02X}"),
                ("address", "1", f"{ADDRESS:02X} (setting `address`)"),
                ("type", "1", "see below"),
                ("id", "1", "of the parameter, telemetry or action"),
                ("payload", "0 or more", "by type and id"),
                ("hash", f"{HASH_BYTES}", f"XXH32 with seed {HASH_SEED} of all from address to payload"),
                ("end", "1", f"{END:02X}"),
            ),
        ),
        f"Between start and end {END:02X} is sent as {ESC:02X} {ESC_END:02X}, and {ESC:02X} as "
        f"{ESC:02X} {ESC_ESC:02X}; the hash is of the bytes before that and is escaped as well. One "
        f"{END:02X} may end a frame and start the next. The unit sends a frame's bytes without gaps.",
        "",
        *table(
            ("Type", "From", "Meaning", f"Payload (from byte {HEADER_BYTES})"),
            ((f"{int(type_):02X}", sender, what, payload) for type_, sender, what, payload in _LAYOUTS),
        ),
        f"In 82 and 84 the status is byte 3, the counter bytes 4 to 7, the time bytes 8 to 15, and the data "
        f"begin at byte {TELEMETRY_HEADER_BYTES}.",
        "",
        "### Status",
        "",
        "0 and 1 are known, and that the others are errors. ASSUMED: which errors there are.",
        "",
        *table(
            ("Status", "Name", "Meaning"),
            ((int(s), s.name, meaning) for s, meaning in STATUS_MEANINGS.items()),
        ),
        "### What is no request",
        "",
        "ASSUMED: it is thrown away whole and not answered, for its type or id may be what is wrong. That is "
        "a frame with a wrong escape, and one that is",
        "",
        *(f"- {reason.value}" for reason in RefusedFrame),
        "",
        f"(a request has at most {MOST_REQUEST_BYTES} bytes with its hash, ASSUMED).",
        "",
        "## Parameters",
        "",
        "The arguments are the same in 00 and 81. Defaults are those that the known driver sends; a "
        "parameter that was not set reads as its default. ASSUMED: the unit's own values before that are not "
        "known.",
        "",
    ]
    for parameter in PARAMETER_TABLE:
        lines += [
            f"### {parameter.id} {parameter.name} ({parameter.arguments.octets} bytes)",
            "",
            f"Mapped: {parameter.mapping}." if parameter.mapping else "Stored and read back alone.",
            "",
            *_fields(parameter.arguments, HEADER_BYTES, defaults=True),
        ]
    lines += ["## Actions", ""]
    for action in ACTION_TABLE:
        lines += [
            f"### {int(action.id)} {action.name} ({action.arguments.octets} bytes)",
            "",
            action.meaning,
            "",
            *_fields(action.arguments, HEADER_BYTES, defaults=False),
        ]
    lines += ["## Telemetry", ""]
    for telemetry in TELEMETRY_TABLE:
        octets = TELEMETRY_HEADER_BYTES + telemetry.data.octets + HASH_BYTES
        lines += [
            f"### {int(telemetry.id)} {telemetry.name} ({octets} bytes with its hash)",
            "",
            telemetry.meaning,
            "",
            *_fields(telemetry.data, TELEMETRY_HEADER_BYTES, defaults=False),
        ]
    lines += [
        "### Strategy of a solution",
        "",
        *table(
            ("Strategy", "Name", "Meaning"),
            ((int(s), s.name, meaning) for s, meaning in STRATEGY_MEANINGS.items()),
        ),
    ]
    return lines
