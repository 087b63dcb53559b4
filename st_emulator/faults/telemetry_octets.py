"""Telemetry messages changed behind the unit's back: fields that stand in them, and their check sums anew."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Callable
from typing import Final

from ..protocol.pus.fields import Field
from ..protocol.pus.packets import (
    MIN_TELEMETRY_BYTES,
    PACKET_ERROR_CONTROL_BYTES,
    PRIMARY_HEADER_BYTES,
    TELEMETRY_SECONDARY_HEADER_BYTES,
    PacketHeader,
    crc16_ccitt,
)
from ..protocol.pus.registry import REGISTRY
from ..protocol.sagitta.frames import (
    HASH_BYTES,
    HASH_SEED,
    TELEMETRY_HEADER_BYTES,
    MessageType,
)
from ..protocol.sagitta.telemetry import TelemetryId
from ..protocol.sagitta.xxh32 import xxh32

ATTITUDE: Final = REGISTRY.by_name("attitude_report")
_SERVICE_OFFSET: Final = PRIMARY_HEADER_BYTES + 1

_SAGITTA_TELEMETRY: Final = (MessageType.TELEMETRY, MessageType.ASYNCHRONOUS_TELEMETRY)
_SAGITTA_COUNTER: Final = struct.Struct("<I")
_SAGITTA_COUNTER_OFFSET: Final = 4
_SAGITTA_TIME: Final = struct.Struct("<Q")
_SAGITTA_TIME_OFFSET: Final = 8
_MOST_TIME_US: Final = (1 << 64) - 1
_SAGITTA_QUATERNION: Final = "wxyz"

# -- PUS


def pus_sequence_count(packet: bytes) -> int | None:
    """That of a telemetry packet; None: it is none."""
    return PacketHeader.from_bytes(packet).sequence_count if _is_packet(packet) else None


def with_pus_sequence_count(packet: bytes, count: int) -> bytes:
    """The packet with another sequence count."""
    header = dataclasses.replace(PacketHeader.from_bytes(packet), sequence_count=count)
    return _controlled(header.as_bytes() + packet[PRIMARY_HEADER_BYTES:-PACKET_ERROR_CONTROL_BYTES])


def with_pus_nan(packet: bytes, axes: str) -> bytes:
    """An attitude report whose components ``axes`` are no numbers; any other packet as it is."""
    if not _is_packet(packet):
        return packet
    kind = tuple(packet[_SERVICE_OFFSET : _SERVICE_OFFSET + 2])
    if kind != (ATTITUDE.service, ATTITUDE.subservice):
        return packet
    changed = bytearray(packet[:-PACKET_ERROR_CONTROL_BYTES])
    for axis in axes:
        struct.pack_into(">d", changed, _attitude_offset(f"q_{axis}"), float("nan"))
    return _controlled(bytes(changed))


def _is_packet(packet: bytes) -> bool:
    return len(packet) >= MIN_TELEMETRY_BYTES and crc16_ccitt(packet) == 0


def _controlled(body: bytes) -> bytes:
    return body + crc16_ccitt(body).to_bytes(PACKET_ERROR_CONTROL_BYTES, "big")


def _attitude_offset(name: str) -> int:
    offset = PRIMARY_HEADER_BYTES + TELEMETRY_SECONDARY_HEADER_BYTES
    for field in ATTITUDE.fields:
        assert isinstance(field, Field)
        if field.name == name:
            return offset
        offset += field.type.size_bytes
    raise KeyError(name)


# -- sagitta


def sagitta_counter(body: bytes) -> int | None:
    """The counter of telemetry; None: the frame has none."""
    if not _is_telemetry(body):
        return None
    counter: int = _SAGITTA_COUNTER.unpack_from(body, _SAGITTA_COUNTER_OFFSET)[0]
    return counter


def with_sagitta_counter(body: bytes, counter: int) -> bytes:
    """Telemetry with another counter."""
    return _changed(body, lambda octets: _SAGITTA_COUNTER.pack_into(octets, _SAGITTA_COUNTER_OFFSET, counter))


def with_sagitta_time(body: bytes, shift_us: int) -> bytes:
    """A solution whose time is another by so much, 0 at the least; any other frame as it is."""
    if not _is_solution(body):
        return body
    (time_us,) = _SAGITTA_TIME.unpack_from(body, _SAGITTA_TIME_OFFSET)
    shifted_us = min(max(time_us + shift_us, 0), _MOST_TIME_US)
    return _changed(body, lambda octets: _SAGITTA_TIME.pack_into(octets, _SAGITTA_TIME_OFFSET, shifted_us))


def with_sagitta_nan(body: bytes, axes: str) -> bytes:
    """A solution whose attitude has components that are no numbers; any other frame as it is."""
    if not _is_solution(body):
        return body

    def change(octets: bytearray) -> None:
        for axis in axes:
            offset = TELEMETRY_HEADER_BYTES + 4 * _SAGITTA_QUATERNION.index(axis)
            struct.pack_into("<f", octets, offset, float("nan"))

    return _changed(body, change)


def _is_telemetry(body: bytes) -> bool:
    if len(body) < TELEMETRY_HEADER_BYTES + HASH_BYTES or body[1] not in _SAGITTA_TELEMETRY:
        return False
    found = int.from_bytes(body[-HASH_BYTES:], "little")
    return found == xxh32(body[:-HASH_BYTES], HASH_SEED)


def _is_solution(body: bytes) -> bool:
    return _is_telemetry(body) and body[2] == TelemetryId.SOLUTION and len(body) >= 4 * TELEMETRY_HEADER_BYTES


def _changed(body: bytes, change: Callable[[bytearray], object]) -> bytes:
    octets = bytearray(body[:-HASH_BYTES])
    change(octets)
    return bytes(octets) + xxh32(bytes(octets), HASH_SEED).to_bytes(HASH_BYTES, "little")
