"""The wire by struct alone, nothing of the product: telecommands of the OBC, and what a journal holds.

From the tables of the interface document.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, Final

END, ESCAPE, ESCAPED_END, ESCAPED_ESCAPE = 0xC0, 0xDB, 0xDC, 0xDD
PRIMARY_OCTETS, SECONDARY_OCTETS, CHECK_OCTETS = 6, 14, 2


def _crc_of(octet: int) -> int:
    register = octet << 8
    for _ in range(8):
        register = (register << 1 ^ (0x1021 if register & 0x8000 else 0)) & 0xFFFF
    return register


CRC_TABLE: Final = [_crc_of(octet) for octet in range(256)]


def crc16(data: bytes) -> int:
    """ECSS-E-ST-70-41C annex B: x^16 + x^12 + x^5 + 1, preset to ones."""
    register = 0xFFFF
    for octet in data:
        register = register << 8 & 0xFFFF ^ CRC_TABLE[register >> 8 ^ octet]
    return register


def slip_frame(packet: bytes) -> bytes:
    """RFC 1055, END on both sides."""
    packet = packet.replace(bytes([ESCAPE]), bytes([ESCAPE, ESCAPED_ESCAPE]))
    packet = packet.replace(bytes([END]), bytes([ESCAPE, ESCAPED_END]))
    return bytes([END]) + packet + bytes([END])


def unescaped(frame: bytes) -> bytes | None:
    """What stood between two END octets; None when an escape makes no sense."""
    out, escaped = bytearray(), False
    for octet in frame:
        if escaped:
            if octet not in (ESCAPED_END, ESCAPED_ESCAPE):
                return None
            out.append(END if octet == ESCAPED_END else ESCAPE)
            escaped = False
        elif octet == ESCAPE:
            escaped = True
        else:
            out.append(octet)
    return None if escaped else bytes(out)


def kind_of(frame: bytes) -> tuple[int, int] | None:
    """(service, subservice) of the telemetry packet in a frame; None when it is none, or damaged."""
    packet = unescaped(frame)
    if packet is None or len(packet) < PRIMARY_OCTETS + SECONDARY_OCTETS + CHECK_OCTETS:
        return None
    word, _, length = struct.unpack(">HHH", packet[:PRIMARY_OCTETS])
    if word >> 11 & 3 != 1 or len(packet) != PRIMARY_OCTETS + length + 1:
        return None
    if crc16(packet[:-CHECK_OCTETS]) != int.from_bytes(packet[-CHECK_OCTETS:], "big"):
        return None
    return packet[PRIMARY_OCTETS + 1], packet[PRIMARY_OCTETS + 2]


def _list(key: str, code: str) -> Callable[[dict[str, Any]], bytes]:
    return lambda fields: struct.pack(f">B{len(fields[key])}{code}", len(fields[key]), *fields[key])


def _memory_load(fields: dict[str, Any]) -> bytes:
    data: bytes = fields["data"]
    head = struct.pack(">BIH", fields["memory_id"], fields["start_address"], len(data))
    return head + data + struct.pack(">H", crc16(data))


def _memory_area(fields: dict[str, Any]) -> bytes:
    return struct.pack(">BIH", fields["memory_id"], fields["start_address"], fields["length"])


#: Service, subservice and data of each telecommand that a long run sends. ``packed``: as it stands.
TELECOMMANDS: Final[dict[str, tuple[int, int, Callable[[dict[str, Any]], bytes]]]] = {
    "hk_one_shot": (3, 27, _list("structure_ids", "B")),
    "event_report_disabled": (5, 7, lambda fields: b""),
    "memory_load": (6, 2, _memory_load),
    "memory_dump": (6, 5, _memory_area),
    "memory_check": (6, 9, _memory_area),
    "function": (8, 1, lambda fields: bytes([fields["function_id"]]) + fields["packed"]),
    "set_time": (9, 128, lambda fields: struct.pack(">I", fields["seconds"]) + bytes(3)),
    "ping": (17, 1, lambda fields: b""),
    "parameter_report": (20, 1, _list("parameter_ids", "H")),
    "parameter_set": (20, 3, lambda fields: struct.pack(">BH", 1, fields["id"]) + fields["packed"]),
}


def telecommand(name: str, fields: dict[str, Any], *, apid: int, count: int, source: int) -> bytes:
    """A whole packet; all reports of its execution are asked for."""
    service, subservice, data = TELECOMMANDS[name]
    body = struct.pack(">BBBH", 0x2F, service, subservice, source) + data(fields)
    packet = struct.pack(">HHH", 0x1800 | apid, 0xC000 | count & 0x3FFF, len(body) + CHECK_OCTETS - 1) + body
    return packet + struct.pack(">H", crc16(packet))
