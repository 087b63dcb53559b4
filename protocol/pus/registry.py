"""Every message in one table, and the codec that walks it: messages <-> whole space packets.

Nothing that is received raises: what is no packet of this interface becomes a :class:`Malformed`. What is
to be sent is checked against the table first and raises :class:`LocalProtocolError` with the field and what
it allows.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any

import construct

from ..errors import LocalProtocolError
from .enumerations import MalformedReason
from .field_types import FieldError, FieldViolation
from .fields import UnknownIdentifier
from .headers import TELECOMMAND_SECONDARY_HEADER, TELEMETRY_SECONDARY_HEADER
from .messages import Kind, MessageDefinition, MessageRegistry
from .packets import (
    ACK_ACCEPTANCE,
    ACK_COMPLETION,
    MAX_TELECOMMAND_BYTES,
    MAX_TELEMETRY_BYTES,
    MIN_TELECOMMAND_BYTES,
    MIN_TELEMETRY_BYTES,
    PACKET_VERSION,
    PRIMARY_HEADER_BYTES,
    PUS_VERSION,
    TELECOMMAND_SECONDARY_HEADER_BYTES,
    TELEMETRY_SECONDARY_HEADER_BYTES,
    TYPE_TELECOMMAND,
    TYPE_TELEMETRY,
    UNSEGMENTED,
    CucTime,
    Malformed,
    PacketHeader,
    RequestId,
    Telecommand,
    Telemetry,
    crc16_ccitt,
    space_packet,
)
from .services import SERVICES

REGISTRY = MessageRegistry(SERVICES)
"""Every message of the interface."""


def encode_telecommand(
    name: str,
    fields: Mapping[str, Any] | None = None,
    *,
    apid: int,
    sequence_count: int,
    source_id: int = 0,
    ack: int = ACK_ACCEPTANCE | ACK_COMPLETION,
    strict: bool = True,
) -> bytes:
    """The whole packet of a telecommand, packet error control included.

    ``strict=False`` lets values out that their type can carry but the interface does not allow (ranges,
    unknown identifiers, the contents of which are then given as octets): to test how a unit refuses them.
    LocalProtocolError otherwise, naming message, field, value and what is allowed.
    """
    message = _defined(name, "TC")
    data = _build(message, {} if fields is None else fields, strict)
    return encode_raw_telecommand(
        message.service,
        message.subservice,
        data,
        apid=apid,
        sequence_count=sequence_count,
        source_id=source_id,
        ack=ack,
    )


def encode_raw_telecommand(
    service: int,
    subservice: int,
    data: bytes = b"",
    *,
    apid: int,
    sequence_count: int,
    source_id: int = 0,
    ack: int = ACK_ACCEPTANCE | ACK_COMPLETION,
) -> bytes:
    """A telecommand packet of any type with any application data, known to the interface or not."""
    header = TELECOMMAND_SECONDARY_HEADER.encode(
        pus_version=PUS_VERSION, ack=ack, service=service, subservice=subservice, source_id=source_id
    )
    return space_packet(TYPE_TELECOMMAND, apid, sequence_count, header + data)


def encode_telemetry(
    name: str,
    fields: Mapping[str, Any],
    *,
    apid: int,
    sequence_count: int,
    message_count: int,
    destination_id: int,
    time: CucTime,
    time_status: int,
) -> bytes:
    """The whole packet of a telemetry message, packet error control included.

    LocalProtocolError, naming message, field, value and what is allowed, when it cannot be built.
    """
    message = _defined(name, "TM")
    data = _build(message, fields, True)
    header = TELEMETRY_SECONDARY_HEADER.encode(
        pus_version=PUS_VERSION,
        time_status=time_status,
        service=message.service,
        subservice=message.subservice,
        message_count=message_count,
        destination_id=destination_id,
        time_coarse=time.coarse,
        time_fine=time.fine,
    )
    return space_packet(TYPE_TELEMETRY, apid, sequence_count, header + data)


def parse_telecommand(raw: bytes, *, apids: Container[int] | None = None) -> Telecommand | Malformed:
    """The telecommand of a packet. ``apids``: those of the receiver, None for any.

    Values are as they stand in the packet; whether they are in range says :func:`field_violation`.
    """
    raw = bytes(raw)
    header = _accepted_header(raw, TYPE_TELECOMMAND, apids)
    if isinstance(header, Malformed):
        return header
    start = PRIMARY_HEADER_BYTES + TELECOMMAND_SECONDARY_HEADER_BYTES
    second = TELECOMMAND_SECONDARY_HEADER.decode(raw[PRIMARY_HEADER_BYTES:start])
    found = _decoded("TC", raw, header, second, raw[start:-2])
    if isinstance(found, Malformed):
        return found
    message, fields = found
    return Telecommand(
        apid=header.apid,
        sequence_count=header.sequence_count,
        service=message.service,
        subservice=message.subservice,
        name=message.name,
        fields=fields,
        source_id=second["source_id"],
        ack=second["ack"],
        raw=raw,
    )


def parse_telemetry(raw: bytes) -> Telemetry | Malformed:
    """The telemetry message of a packet."""
    raw = bytes(raw)
    header = _accepted_header(raw, TYPE_TELEMETRY, None)
    if isinstance(header, Malformed):
        return header
    start = PRIMARY_HEADER_BYTES + TELEMETRY_SECONDARY_HEADER_BYTES
    second = TELEMETRY_SECONDARY_HEADER.decode(raw[PRIMARY_HEADER_BYTES:start])
    found = _decoded("TM", raw, header, second, raw[start:-2])
    if isinstance(found, Malformed):
        return found
    message, fields = found
    return Telemetry(
        apid=header.apid,
        sequence_count=header.sequence_count,
        service=message.service,
        subservice=message.subservice,
        name=message.name,
        fields=fields,
        message_count=second["message_count"],
        destination_id=second["destination_id"],
        time_status=second["time_status"],
        time=CucTime(second["time_coarse"], second["time_fine"]),
        raw=raw,
    )


def field_violation(packet: Telecommand | Telemetry) -> FieldViolation | None:
    """The first value of a decoded packet that is outside its range or not known, None when all is well.

    Its ``failure_code`` is the one to answer with.
    """
    kind: Kind = "TC" if isinstance(packet, Telecommand) else "TM"
    return _defined(packet.name, kind).data.violation(packet.fields)


def _defined(name: str, kind: Kind) -> MessageDefinition:
    message = REGISTRY.by_name(name) if name in REGISTRY else None
    if message is None or message.kind != kind:
        known = REGISTRY.telecommands() if kind == "TC" else REGISTRY.telemetry()
        names = ", ".join(entry.name for entry in known)
        raise LocalProtocolError(
            "telecommand" if kind == "TC" else "telemetry", "name", name, f"one of {names}"
        )
    return message


def _build(message: MessageDefinition, fields: Mapping[str, Any], strict: bool) -> bytes:
    try:
        return message.data.build(fields, strict)
    except FieldError as error:
        violation = error.violation
        raise LocalProtocolError(message.name, violation.field, violation.value, violation.allowed) from None


def _accepted_header(raw: bytes, packet_type: int, apids: Container[int] | None) -> PacketHeader | Malformed:
    """The primary header when the packet is whole, undamaged and for us.

    Lengths and error control come first: only then can the other fields be believed.
    """
    telecommand = packet_type == TYPE_TELECOMMAND
    least = MIN_TELECOMMAND_BYTES if telecommand else MIN_TELEMETRY_BYTES
    most = MAX_TELECOMMAND_BYTES if telecommand else MAX_TELEMETRY_BYTES
    size = len(raw)
    request_id = RequestId.from_packet(raw) if size >= 4 else None
    if size < PRIMARY_HEADER_BYTES:
        return Malformed(
            MalformedReason.TOO_SHORT, f"{size} bytes, a packet header has 6", raw, request_id=request_id
        )
    header = PacketHeader.from_bytes(raw)

    def malformed(reason: MalformedReason, detail: str) -> Malformed:
        return Malformed(reason, detail, raw, header, request_id)

    if size < least:
        return malformed(MalformedReason.TOO_SHORT, f"{size} bytes, the smallest packet has {least}")
    if size > most:
        return malformed(MalformedReason.TOO_LONG, f"{size} bytes, the largest packet has {most}")
    declared = PRIMARY_HEADER_BYTES + header.data_length + 1
    if size != declared:
        return malformed(MalformedReason.LENGTH_MISMATCH, f"{size} bytes, the header says {declared}")
    if crc16_ccitt(raw) != 0:
        received, expected = int.from_bytes(raw[-2:], "big"), crc16_ccitt(raw[:-2])
        return malformed(MalformedReason.BAD_CRC, f"received 0x{received:04X}, computed 0x{expected:04X}")
    if header.version != PACKET_VERSION:
        return malformed(MalformedReason.BAD_VERSION, f"packet version {header.version}, expected 0")
    if header.packet_type != packet_type:
        if telecommand:
            return malformed(MalformedReason.NOT_TELECOMMAND, "packet type 0 (telemetry), expected 1")
        return malformed(MalformedReason.NOT_TELEMETRY, "packet type 1 (telecommand), expected 0")
    if apids is not None and header.apid not in apids:
        return malformed(MalformedReason.UNKNOWN_APID, f"APID {header.apid}")
    if not header.secondary_header:
        return malformed(MalformedReason.NO_SECONDARY_HEADER, "secondary header flag 0, expected 1")
    if header.sequence_flags != UNSEGMENTED:
        return malformed(MalformedReason.SEGMENTED, f"sequence flags {header.sequence_flags}, expected 3")
    return header


def _decoded(
    kind: Kind, raw: bytes, header: PacketHeader, second: dict[str, int], data: bytes
) -> tuple[MessageDefinition, dict[str, Any]] | Malformed:
    def malformed(reason: MalformedReason, detail: str) -> Malformed:
        return Malformed(reason, detail, raw, header, RequestId.from_packet(raw))

    version, service, subservice = second["pus_version"], second["service"], second["subservice"]
    if version != PUS_VERSION:
        return malformed(MalformedReason.BAD_PUS_VERSION, f"PUS version {version}, expected {PUS_VERSION}")
    message = REGISTRY.by_type(kind, service, subservice)
    if message is None:
        if REGISTRY.has_service(kind, service):
            return malformed(MalformedReason.UNKNOWN_SUBSERVICE, f"{kind}[{service},{subservice}]")
        return malformed(MalformedReason.UNKNOWN_SERVICE, f"{kind}[{service},{subservice}]")
    try:
        return message, message.data.parse(data)
    except UnknownIdentifier as error:
        return malformed(MalformedReason.UNKNOWN_ID, f"{message.name}: {error}")
    except construct.ConstructError as error:
        lines = str(error).strip().splitlines() or [type(error).__name__]
        return malformed(
            MalformedReason.BAD_FIELDS, f"{message.name}, {len(data)} bytes of data: {lines[-1].strip()}"
        )
