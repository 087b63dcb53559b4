"""The interface control document, in Markdown, generated from the registry and the tables it is built
from.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum, IntFlag

from ..framing import slip_encode
from ..pus import enumerations as enumeration
from ..pus.events import EVENT_TABLE
from ..pus.fields import FieldGroup, meaning_of
from ..pus.functions import FUNCTION_TABLE
from ..pus.headers import (
    PRIMARY_HEADER,
    REQUEST_ID_LAYOUT,
    TELECOMMAND_SECONDARY_HEADER,
    TELEMETRY_SECONDARY_HEADER,
)
from ..pus.housekeeping import HOUSEKEEPING_TABLE
from ..pus.messages import MessageDefinition, MessageRegistry, ServiceDefinition
from ..pus.packets import (
    MAX_TELECOMMAND_BYTES,
    MAX_TELEMETRY_BYTES,
    PACKET_ERROR_CONTROL_BYTES,
    PRIMARY_HEADER_BYTES,
    TELECOMMAND_SECONDARY_HEADER_BYTES,
    TELEMETRY_SECONDARY_HEADER_BYTES,
    CucTime,
)
from ..pus.parameters import PARAMETER_TABLE
from ..pus.registry import REGISTRY, encode_telecommand, encode_telemetry
from ..pus.services.large_data import IMAGE_HEADER_BYTES, IMAGE_HEADER_FIELDS
from .icd_can import can_chapter
from .markdown import FIELD_HEADINGS, IDENTIFIERS, field_row, fields_table, header_table, table
from .wording import (
    AFTER_RECEPTION,
    CONVENTIONS,
    INTRODUCTION,
    LINE,
    NOT_SAID,
    PACKETS,
    RECEPTION,
    TYPES,
    VERIFICATION,
)

_TC_DATA = PRIMARY_HEADER_BYTES + TELECOMMAND_SECONDARY_HEADER_BYTES
_TM_DATA = PRIMARY_HEADER_BYTES + TELEMETRY_SECONDARY_HEADER_BYTES

_ENUMERATIONS: tuple[type[IntEnum] | type[IntFlag], ...] = (
    enumeration.Mode,
    enumeration.Reason,
    enumeration.TimeStatus,
    enumeration.ResetCause,
    enumeration.ResetKind,
    enumeration.SelfTest,
    enumeration.FrameDropCause,
    enumeration.FaultCause,
    enumeration.StoreInvalidCause,
    enumeration.MemoryId,
    enumeration.MalformedReason,
    enumeration.FramingReason,
    enumeration.CanState,
    enumeration.TransferFailure,
)


def interface_control_document(
    registry: MessageRegistry = REGISTRY,
    *,
    unit_notes: str = "",
    mode_table: Sequence[Sequence[str]] = (),
    modelled: str = "",
    faults: str = "",
) -> str:
    """The whole document. The same arguments give the same text.

    ``unit_notes``: Markdown on the units at hand (APID, baud rate, defaults), or nothing. ``mode_table``:
    the rules of the modes, its first row the headings. ``modelled``: Markdown on what the emulated unit
    models and what it does not. ``faults``: Markdown on how it can be broken on purpose, or nothing.
    """
    lines = ["# Interface control document", "", *INTRODUCTION]
    sections: list[tuple[str, list[str]]] = [
        ("Line", list(LINE)),
        ("CAN bus", can_chapter()),
        ("Conventions", [*CONVENTIONS, *table(("Type", "Bytes", "What it is"), TYPES)]),
        ("Packets", _packets()),
        ("Reception of telecommands", _reception()),
        ("Verification of telecommands", _verification()),
        ("Messages", _overview(registry)),
        *((_service_title(service), _service(service)) for service in registry.services),
        ("Mode rules", _modes(mode_table)),
        ("Enumerations", _enumerations()),
        ("Example", _example()),
        ("What is modelled", [modelled.strip() or NOT_SAID, ""]),
    ]
    if faults.strip():
        sections.append(("Faults", [faults.strip(), ""]))
    if unit_notes.strip():
        sections.insert(0, ("Units", [unit_notes.strip(), ""]))
    for number, (title, _) in enumerate(sections, start=1):
        lines.append(f"{number}. [{title}](#{_anchor(f'{number} {title}')})")
    lines.append("")
    for number, (title, body) in enumerate(sections, start=1):
        lines += [f"## {number} {title}", "", *body]
    return "\n".join(lines).rstrip() + "\n"


def _anchor(title: str) -> str:
    """The anchor that GitHub gives a heading."""
    kept = (character for character in title.lower() if character.isalnum() or character in " -_")
    return "".join(kept).replace(" ", "-")


def _packets() -> list[str]:
    return [
        *PACKETS,
        "### Packet primary header",
        "",
        "CCSDS 133.0-B-2 clause 4.1.3.",
        "",
        *header_table(PRIMARY_HEADER, 0),
        "### Telecommand secondary header",
        "",
        "ECSS-E-ST-70-41C clause 7.4.4.1. Application data start at byte 11; the packet has at most "
        f"{MAX_TELECOMMAND_BYTES} bytes.",
        "",
        *header_table(TELECOMMAND_SECONDARY_HEADER, PRIMARY_HEADER_BYTES),
        "### Telemetry secondary header",
        "",
        "ECSS-E-ST-70-41C clause 7.4.3.1. Source data start at byte 20; the packet has at most "
        f"{MAX_TELEMETRY_BYTES} bytes.",
        "",
        *header_table(TELEMETRY_SECONDARY_HEADER, PRIMARY_HEADER_BYTES),
        "### Request ID",
        "",
        "ECSS-E-ST-70-41C clause 8.1.2.1: the first 4 bytes of the telecommand packet that is reported on.",
        "",
        *header_table(REQUEST_ID_LAYOUT, 0),
    ]


def _reception() -> list[str]:
    rows = [
        (int(reason), reason.name, meaning_of(reason), _told_by(reason))
        for reason in (*_framing_reasons(), *_packet_reasons())
    ]
    return [*RECEPTION, *table(("Reason", "Name", "Meaning", "Told by"), rows), *AFTER_RECEPTION]


def _framing_reasons() -> list[enumeration.MalformedReason]:
    return [reason.malformed_reason for reason in enumeration.FramingReason]


def _packet_reasons() -> list[enumeration.MalformedReason]:
    elsewhere = {enumeration.MalformedReason.NOT_TELEMETRY, *_framing_reasons()}
    return [reason for reason in enumeration.MalformedReason if reason not in elsewhere]


def _told_by(reason: enumeration.MalformedReason) -> str:
    code = reason.failure_code
    if code is enumeration.FailureCode.CRC:
        return "event TC_CRC_FAILED"
    if code in (enumeration.FailureCode.LENGTH, enumeration.FailureCode.HEADER):
        return "event TC_MALFORMED"
    report = "TM[1,10]" if code is enumeration.FailureCode.UNKNOWN_APID else "TM[1,2]"
    return f"{report} with failure code {code.name}"


def _verification() -> list[str]:
    rows = [(int(code), code.name, meaning_of(code)) for code in enumeration.FailureCode]
    return [*VERIFICATION, "### Failure codes", "", *table(("Code", "Name", "Meaning"), rows)]


def _overview(registry: MessageRegistry) -> list[str]:
    rows = [
        (
            message.label,
            f"[`{message.name}`](#{_anchor(_message_title(message))})",
            _data_size(message),
            message.title,
        )
        for message in registry
    ]
    return [
        "The name is the one by which the OBC side of this project, its logs and its tests call the message. "
        "Size: of the application or source data.",
        "",
        *table(("Type", "Name", "Bytes", "Title"), rows),
    ]


def _data_size(message: MessageDefinition) -> str:
    size = message.data.group.size_bytes
    return "varies" if size is None else str(size)


def _service_title(service: ServiceDefinition) -> str:
    return f"Service {service.number}: {service.title.lower()}"


def _message_title(message: MessageDefinition) -> str:
    return f"{message.label} {message.name}"


def _service(service: ServiceDefinition) -> list[str]:
    clause = f"ECSS-E-ST-70-41C clauses {service.clause.replace(', ', ' and ')}. " if service.clause else ""
    lines = [clause + service.description, ""]
    for message in service.messages:
        lines += _message(message)
    extra = {
        3: _housekeeping_structures,
        5: _event_table,
        8: _function_table,
        13: _image_header,
        20: _parameter_table,
    }.get(service.number)
    return lines + (extra() if extra else [])


def _message(message: MessageDefinition) -> list[str]:
    lines = [f"### {_message_title(message)}", "", f"**{message.title}.** {message.description}", ""]
    if message.clause:
        lines += [f"Source: ECSS-E-ST-70-41C clause {message.clause}.", ""]
    if message.tailoring:
        lines += [f"Tailoring: {message.tailoring}", ""]
    if message.kind == "TC":
        lines += [f"After acceptance: {message.verification or 'completion at once'}.", ""]
    if message.fields:
        where = {
            "hk_report": "see [structures](#housekeeping-structures)",
            "function": "see [functions](#functions)",
            "parameter_values": "see [parameters](#parameters)",
            "parameter_set": "see [parameters](#parameters)",
        }.get(message.name, "")
        if message.service == 5:
            where = "see [events](#events)"
        lines += fields_table(message.fields, _TC_DATA if message.kind == "TC" else _TM_DATA, where)
        lines += _earlier(message)
    else:
        lines += ["No data.", ""]
    return lines


def _earlier(message: MessageDefinition) -> list[str]:
    """What a unit of an earlier edition sends of a message that has grown."""
    around = (_TC_DATA if message.kind == "TC" else _TM_DATA) + PACKET_ERROR_CONTROL_BYTES
    names = [element.name for element in message.fields]
    lines = []
    for name in message.earlier_ends:
        size = FieldGroup(message.fields[: names.index(name) + 1]).size_bytes
        whole = message.data.group.size_bytes
        assert size is not None
        assert whole is not None
        lines += [
            f"The packet has {whole + around} bytes. Units of an earlier edition end it behind `{name}`, "
            f"with {size + around} bytes: fields are added at the end alone, none moves, and the length "
            "tells which are there.",
            "",
        ]
    return lines


def _housekeeping_structures() -> list[str]:
    lines = ["### Housekeeping structures", "", "Values of TM[3,25] from byte 21 on.", ""]
    for entry in HOUSEKEEPING_TABLE:
        size = sum(field.type.size_bytes for field in entry.fields)
        lines += [f"#### Structure {int(entry.id)} {entry.name}", ""]
        lines += [f"{entry.meaning[0].upper()}{entry.meaning[1:]}; {size} bytes.", ""]
        lines += fields_table(entry.fields, _TM_DATA + 1)
    return lines


def _event_table() -> list[str]:
    rows: list[tuple[object, ...]] = [
        (
            int(event.id),
            event.name,
            f"TM[5,{int(event.severity)}] {event.severity.name.lower()}",
            event.meaning,
        )
        for event in EVENT_TABLE
    ]
    lines = ["### Events", "", *table(("ID", "Name", "Report", "Meaning"), rows)]
    lines += ["Auxiliary data of the events, from byte 22 of the packet on:", ""]
    data_rows: list[tuple[str, ...]] = []
    for event in EVENT_TABLE:
        place = _TM_DATA + 2
        title = f"{int(event.id)} {event.name}"
        if not event.fields:
            data_rows.append((title, "", "none", "", "", "", ""))
        for field in event.fields:
            data_rows.append((title, *field_row(str(place), field)))
            place += field.type.size_bytes
            title = ""
    return [*lines, *table(("Event", *FIELD_HEADINGS), data_rows)]


def _function_table() -> list[str]:
    rows = [
        (int(function.id), function.name, function.verification, function.meaning)
        for function in FUNCTION_TABLE
    ]
    lines = ["### Functions", "", *table(("ID", "Name", "Reports after acceptance", "Meaning"), rows)]
    lines += ["Arguments of the functions, from byte 12 of the packet on; the others have none:", ""]
    data_rows: list[tuple[str, ...]] = []
    for function in FUNCTION_TABLE:
        place = _TC_DATA + 1
        title = f"{int(function.id)} {function.name}"
        for field in function.fields:
            data_rows.append((title, *field_row(str(place), field)))
            place += field.type.size_bytes
            title = ""
    return [*lines, *table(("Function", *FIELD_HEADINGS), data_rows)]


def _image_header() -> list[str]:
    return [
        "### Image header",
        "",
        f"The first {IMAGE_HEADER_BYTES} bytes of the image, bytes counted from its start. "
        "The pixels follow, width times height of them, 2 bytes each.",
        "",
        *fields_table(IMAGE_HEADER_FIELDS, 0),
    ]


def _parameter_table() -> list[str]:
    rows = [
        (
            int(entry.id),
            f"`{entry.name}`",
            entry.type.name,
            entry.unit,
            entry.field.allowed() + (", read-only" if entry.read_only else ""),
            entry.meaning,
        )
        for entry in PARAMETER_TABLE
    ]
    return [
        "### Parameters",
        "",
        "Defaults stand in the file of the unit. A limit of an f32 is its nearest 32-bit value.",
        "",
        *table(("ID", "Name", "Type", "Unit", "Range", "Meaning"), rows),
    ]


def _modes(mode_table: Sequence[Sequence[str]]) -> list[str]:
    if not mode_table:
        return [NOT_SAID, ""]
    return [
        "Nothing but these rules changes the mode.",
        "",
        *table(tuple(mode_table[0]), [tuple(row) for row in mode_table[1:]]),
    ]


def _enumerations() -> list[str]:
    links = ", ".join(f"[{title}](#{anchor})" for title, anchor in IDENTIFIERS.values())
    lines = [f"These have tables of their own: {links}.", ""]
    for kind in _ENUMERATIONS:
        flags = issubclass(kind, IntFlag)
        rows = [
            (f"0x{int(member):04X}" if flags else int(member), member.name, meaning_of(member))
            for member in kind
        ]
        lines += [f"### {kind.__name__}", "", " ".join((kind.__doc__ or "").split()), ""]
        lines += table(("Bit" if flags else "Value", "Name", "Meaning"), rows)
    return lines


def _example() -> list[str]:
    packet = encode_telecommand("ping", apid=100, sequence_count=0, source_id=1)
    report = encode_telemetry(
        "pong",
        {},
        apid=100,
        sequence_count=7,
        message_count=0,
        destination_id=1,
        time=CucTime(2_145_916_837, 0x800000),
        time_status=1,
    )
    return [
        "A ping of source 1 to APID 100, sequence count 0, asking for acceptance and completion reports, as "
        "it goes over the line:",
        "",
        "```",
        *_annotated(
            packet,
            (
                (2, "version 0, telecommand, secondary header, APID 100"),
                (2, "unsegmented, sequence count 0; the packet's C0 goes as DB DC"),
                (2, "6 + 1 bytes follow the primary header"),
                (1, "PUS version 2, acknowledge acceptance (8) and completion (1)"),
                (2, "service 17, subservice 1"),
                (2, "source ID 1"),
                (2, "packet error control"),
            ),
        ),
        "```",
        "",
        "And the pong:",
        "",
        "```",
        *_annotated(
            report,
            (
                (2, "version 0, telemetry, secondary header, APID 100"),
                (2, "unsegmented, sequence count 7; the packet's C0 goes as DB DC"),
                (2, "15 + 1 bytes follow the primary header"),
                (1, "PUS version 2, time reference status 1 (set)"),
                (2, "service 17, subservice 2"),
                (2, "message type counter 0"),
                (2, "destination ID 1"),
                (7, "2145916837.5 s of TAI since 1958-01-01"),
                (2, "packet error control"),
            ),
        ),
        "```",
        "",
    ]


def _annotated(packet: bytes, parts: Sequence[tuple[int, str]]) -> list[str]:
    """A line for each part of the packet, with the bytes that go over the line for it."""
    lines = [f"{'C0':<22}END"]
    place = 0
    for size, text in parts:
        sent = slip_encode(packet[place : place + size])[1:-1]
        lines.append(f"{sent.hex(' ').upper():<22}{text}")
        place += size
    assert place == len(packet), "the example's annotations do not cover its packet"
    return [*lines, f"{'C0':<22}END"]
