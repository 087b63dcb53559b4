"""The interface document: complete, the same each time, and its byte places are those of the codec."""

from __future__ import annotations

import re
from typing import Any

import pytest

from hil_tests.protocol.message_strategies import smallest_fields
from st_emulator.protocol import (
    EVENTS,
    FUNCTIONS,
    HOUSEKEEPING,
    PARAMETERS,
    REGISTRY,
    CucTime,
    FailureCode,
    Field,
    MalformedReason,
    MessageDefinition,
    Switched,
    encode_telecommand,
    encode_telemetry,
)
from st_emulator.protocol.can.cyclic import (
    CAN_MESSAGES,
    IDENTIFIER_NAMES,
    CanIdentifiers,
    CanMessage,
    encode_can_message,
)
from st_emulator.protocol.exporters import interface_control_document
from st_emulator.protocol.pus import enumerations

TEXT = interface_control_document()
LINES = TEXT.splitlines()


def section(heading: str) -> list[str]:
    """The lines under a heading up to the next one."""
    start = LINES.index(heading) + 1
    end = next((n for n in range(start, len(LINES)) if LINES[n].startswith("#")), len(LINES))
    return LINES[start:end]


def rows(lines: list[str]) -> list[list[str]]:
    """The cells of the tables among lines, headings and rules left out."""
    found = [[cell.strip() for cell in line[1:-1].split("|")] for line in lines if line.startswith("| ")]
    return [row for row in found if row[0] not in ("Byte", "Event", "Function", "ID", "Value", "Bit", "Code")]


def test_it_is_the_same_each_time() -> None:
    assert interface_control_document() == TEXT
    assert TEXT.endswith("\n")
    assert not TEXT.endswith("\n\n")


def test_it_names_everything() -> None:
    for message in REGISTRY:
        assert f"### {message.label} {message.name}" in LINES
    for table, heading in ((EVENTS, "### Events"), (FUNCTIONS, "### Functions")):
        named = {(row[0], row[1]) for row in rows(section(heading))}
        assert {(str(number), entry.name) for number, entry in table.items()} <= named
    assert [row[1].strip("`") for row in rows(section("### Parameters"))] == [
        entry.name for entry in PARAMETERS.values()
    ]
    for code in FailureCode:
        assert [str(int(code)), code.name] in [row[:2] for row in rows(section("### Failure codes"))]
    told = {row[1] for row in rows(section("## 5 Reception of telecommands"))}
    assert told >= {reason.name for reason in MalformedReason} - {"NOT_TELEMETRY"}
    for kind in (
        enumerations.Mode,
        enumerations.Reason,
        enumerations.SelfTest,
        enumerations.TimeStatus,
        enumerations.CanState,
        enumerations.TransferFailure,
    ):
        assert [row[1] for row in rows(section(f"### {kind.__name__}"))] == [member.name for member in kind]


def test_every_link_leads_somewhere() -> None:
    anchors = set()
    for line in LINES:
        if line.startswith("#"):
            title = line.lstrip("#").strip().lower()
            anchors.add(re.sub(r"[^\w\- ]", "", title).replace(" ", "-"))
    links = re.findall(r"\]\(#([^)]*)\)", TEXT)
    assert len(links) > 100
    assert set(links) <= anchors


def encode(message: MessageDefinition, fields: dict[str, Any]) -> bytes:
    if message.kind == "TC":
        return encode_telecommand(message.name, fields, apid=1, sequence_count=0)
    return encode_telemetry(
        message.name,
        fields,
        apid=1,
        sequence_count=0,
        message_count=0,
        destination_id=0,
        time=CucTime(0, 0),
        time_status=0,
    )


def other_value(field: Field, value: Any) -> Any:
    """An allowed value whose first byte on the wire differs from that of ``value``, the smallest one."""
    if field.type.kind == "time":
        return CucTime(0x01000000, 0)
    if field.type.kind == "request_id":
        return dict(value, version=1)
    if field.type.kind == "float":
        return field.maximum if field.maximum is not None else -1.0
    if field.choices is not None:
        return int(max(field.choices))
    return int(field.limits()[1])


def first_difference(one: bytes, other: bytes) -> int:
    return next(n for n in range(6, len(one)) if one[n] != other[n])


def places(lines: list[str], column: int = 0) -> dict[str, int]:
    """Field name to byte, of the rows whose place is a plain number."""
    return {row[column + 1].strip("`"): int(row[column]) for row in rows(lines) if row[column].isdigit()}


def check(
    message: MessageDefinition, fields: dict[str, Any], key: str | None, entries: Any, table: dict[str, int]
) -> None:
    """Change one value at a time; the first byte that changes is at most 3 behind the place in the table.

    Behind, because the leading bytes of a small enumeration in a wide field stay 0.
    """
    base = encode(message, fields)
    for field in entries:
        if key is None:
            changed = fields | {field.name: other_value(field, fields[field.name])}
        else:
            inner = fields[key]
            changed = fields | {key: inner | {field.name: other_value(field, inner[field.name])}}
        place = first_difference(base, encode(message, changed))
        assert table[field.name] <= place < table[field.name] + field.type.size_bytes, field.name


FIXED = [m for m in REGISTRY if m.data.group.size_bytes]


@pytest.mark.parametrize("message", FIXED, ids=lambda message: message.name)
def test_the_places_of_the_fields_of_a_message(message: MessageDefinition) -> None:
    table = places(section(f"### {message.label} {message.name}"))
    assert list(table) == [field.name for field in message.fields]
    check(message, smallest_fields(message), None, message.fields, table)


@pytest.mark.parametrize("entry", HOUSEKEEPING.values(), ids=lambda entry: entry.name)
def test_the_places_of_housekeeping_values(entry: Any) -> None:
    message = REGISTRY.by_name("hk_report")
    table = places(section(f"#### Structure {int(entry.id)} {entry.name}"))
    fields = {"structure_id": int(entry.id), "values": values_of(message, int(entry.id))}
    check(message, fields, "values", entry.fields, table)


def values_of(message: MessageDefinition, selector: int) -> dict[str, Any]:
    switched = message.fields[1]
    assert isinstance(switched, Switched)
    case = switched.cases[selector]
    probe = MessageDefinition("TM", 0, 0, "probe", "", "", "", case.fields)
    return smallest_fields(probe)


def grouped(heading: str) -> dict[str, dict[str, int]]:
    """Places of the fields of each event or function, by its name."""
    found: dict[str, dict[str, int]] = {}
    name = ""
    for row in rows(section(heading)):
        if len(row) == 7:
            name = row[0].split(" ")[-1] or name
            if row[1].isdigit():
                found.setdefault(name, {})[row[2].strip("`")] = int(row[1])
    return found


@pytest.mark.parametrize("entry", [e for e in EVENTS.values() if e.fields], ids=lambda entry: entry.name)
def test_the_places_of_event_data(entry: Any) -> None:
    message = REGISTRY.by_name(entry.message_name)
    fields = {"event_id": int(entry.id), "data": values_of(message, int(entry.id))}
    check(message, fields, "data", entry.fields, grouped("### Events")[entry.name])


@pytest.mark.parametrize("entry", [e for e in FUNCTIONS.values() if e.fields], ids=lambda entry: entry.name)
def test_the_places_of_arguments(entry: Any) -> None:
    message = REGISTRY.by_name("function")
    fields = {"function_id": int(entry.id), "arguments": values_of(message, int(entry.id))}
    check(message, fields, "arguments", entry.fields, grouped("### Functions")[entry.name])


@pytest.mark.parametrize("message", CAN_MESSAGES, ids=lambda message: message.name)
def test_the_bits_of_a_can_frame(message: CanMessage) -> None:
    """The places in the table, one after the other, hold each signal's bits and nothing else."""
    names = {signal.name: 0 for signal in message.carried}
    table = rows(section(f"#### Frame {message.name}"))
    assert [row[1].strip("`") for row in table] == [signal.name for signal in message.signals]
    ends = 0
    for row, signal in zip(table, message.signals, strict=True):
        first, last = bits_of(row[0])
        assert (first, last - first + 1) == (ends, int(row[2][1:])), row
        ends = last + 1
        if signal.name in names:
            number = int.from_bytes(encode_can_message(message.name, names | {signal.name: LARGE}), "big")
            ones = f"{number:0{8 * message.size_bytes}b}"
            # The highest number of the type: all ones, but for the sign of a signed one.
            expected = "1" * signal.bits if row[2][0] == "u" else "0" + "1" * (signal.bits - 1)
            assert ones[first : last + 1] == expected, row
            assert ones.count("1") == expected.count("1"), row
    assert ends == 8 * message.size_bytes


LARGE = 1e30


def bits_of(place: str) -> tuple[int, int]:
    """The first and the last bit of a place such as `2`, `4..7`, `2 bit 0` or `1 bit 2 .. 3 bit 3`."""
    numbers = [int(number) for number in re.findall("[0-9]+", place)]
    match re.sub("[0-9]+", "n", place):
        case "n":
            return 8 * numbers[0], 8 * numbers[0] + 7
        case "n..n":
            return 8 * numbers[0], 8 * numbers[1] + 7
        case "n bit n":
            return 8 * numbers[0] + numbers[1], 8 * numbers[0] + numbers[1]
        case "n bits n..n":
            return 8 * numbers[0] + numbers[1], 8 * numbers[0] + numbers[2]
        case "n bit n .. n bit n":
            return 8 * numbers[0] + numbers[1], 8 * numbers[2] + numbers[3]
    raise AssertionError(place)


def test_the_identifiers_on_the_can_bus() -> None:
    found = {row[0].strip("`"): row[1:] for row in rows(section("### Identifiers"))}
    own = {}
    for extended, column in ((False, 1), (True, 2)):
        for name, row in found.items():
            if name != "Name":
                base, _, node = row[column].partition(" + ")
                own[name] = int(base, 16) + (10 if node else 0)
        identifiers = CanIdentifiers(10, extended)
        assert own == {name: identifiers.identifier(name) for name in IDENTIFIER_NAMES}
    assert {name for name, row in found.items() if row[0] == "OBC"} == {
        "sync",
        "time_at_sync",
        "telecommand",
    }


def test_what_the_caller_adds_is_in_it() -> None:
    text = interface_control_document(
        unit_notes="Unit X has APID 7.\n",
        mode_table=[("Mode", "Event", "Next"), ("BOOT", "BOOT_DONE", "STANDBY")],
        modelled="Not modelled: radiation.",
    )
    lines = text.splitlines()
    assert "Unit X has APID 7." in lines
    assert "1. [Units](#1-units)" in lines
    assert re.search(r"\| BOOT +\| BOOT_DONE +\| STANDBY \|", text)
    assert "Not modelled: radiation." in lines
    assert "Not stated in this edition." not in lines
    assert TEXT.count("Not stated in this edition.") == 2
