"""CCSDS space packets, PUS-C secondary headers, CUC time and packet error control.

Sources: CCSDS 133.0-B-2 (space packet), ECSS-E-ST-70-41C clause 7.4 (packets) and annex B (packet error
control), CCSDS 301.0-B-4 clause 3.2 (CUC time). All numbers are big-endian; the bit layouts stand in
:mod:`headers`.
"""

from __future__ import annotations

import binascii
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..durations import NS_PER_S
from ..errors import LocalProtocolError
from .enumerations import MalformedReason
from .headers import (
    PRIMARY_HEADER,
    REQUEST_ID_LAYOUT,
    TELECOMMAND_SECONDARY_HEADER,
    TELEMETRY_SECONDARY_HEADER,
)

PRIMARY_HEADER_BYTES = PRIMARY_HEADER.size_bytes
TELECOMMAND_SECONDARY_HEADER_BYTES = TELECOMMAND_SECONDARY_HEADER.size_bytes
TELEMETRY_SECONDARY_HEADER_BYTES = TELEMETRY_SECONDARY_HEADER.size_bytes
PACKET_ERROR_CONTROL_BYTES = 2
MAX_TELECOMMAND_BYTES = 1024
MAX_TELEMETRY_BYTES = 4095
MIN_TELECOMMAND_BYTES = PRIMARY_HEADER_BYTES + TELECOMMAND_SECONDARY_HEADER_BYTES + PACKET_ERROR_CONTROL_BYTES
MIN_TELEMETRY_BYTES = PRIMARY_HEADER_BYTES + TELEMETRY_SECONDARY_HEADER_BYTES + PACKET_ERROR_CONTROL_BYTES

PACKET_VERSION = 0
PUS_VERSION = 2
TYPE_TELEMETRY = 0
TYPE_TELECOMMAND = 1
UNSEGMENTED = 0b11
IDLE_APID = 0x7FF
SEQUENCE_MODULO = 1 << 14

ACK_ACCEPTANCE = 0b1000
ACK_START = 0b0100
ACK_PROGRESS = 0b0010
ACK_COMPLETION = 0b0001

_FINE_PER_S = 1 << 24


def crc16_ccitt(data: bytes) -> int:
    """CRC-16 of ``data``: polynomial x^16 + x^12 + x^5 + 1, preset to ones, not reflected, not inverted.

    Over a packet with its error control field included it is 0. Source: ECSS-E-ST-70-41C annex B.1.
    """
    return binascii.crc_hqx(data, 0xFFFF)


@dataclass(frozen=True, order=True, slots=True)
class CucTime:
    """CCSDS unsegmented time: ``coarse`` TAI seconds since 1958-01-01, ``fine`` in 2^-24 s.

    4 + 3 bytes, P-field implicit (it would be 0x1F: epoch 1958, 4 coarse, 3 fine octets: 301.0-B-4
    clause 3.2.2).
    """

    coarse: int
    fine: int

    def __post_init__(self) -> None:
        if not 0 <= self.coarse < 1 << 32:
            raise LocalProtocolError("CucTime", "coarse", self.coarse, "0..4294967295")
        if not 0 <= self.fine < _FINE_PER_S:
            raise LocalProtocolError("CucTime", "fine", self.fine, "0..16777215")

    @classmethod
    def from_ns(cls, tai_ns: int) -> CucTime:
        """The last tick (59.6 ns) at or before ``tai_ns``, integer nanoseconds of TAI since 1958-01-01."""
        coarse, rest_ns = divmod(tai_ns, NS_PER_S)
        return cls(coarse, rest_ns * _FINE_PER_S // NS_PER_S)

    def to_ns(self) -> int:
        """Nanoseconds of TAI since 1958-01-01, rounded up, so that ``from_ns(t.to_ns()) == t``."""
        return self.coarse * NS_PER_S - (-self.fine * NS_PER_S // _FINE_PER_S)

    def as_bytes(self) -> bytes:
        """The 7 bytes of the T-field."""
        return self.coarse.to_bytes(4, "big") + self.fine.to_bytes(3, "big")

    @classmethod
    def from_bytes(cls, data: bytes) -> CucTime:
        """The time of the 7 bytes of a T-field."""
        if len(data) != 7:
            raise LocalProtocolError("CucTime", "data", data, "7 bytes")
        return cls(int.from_bytes(data[:4], "big"), int.from_bytes(data[4:], "big"))


@dataclass(frozen=True, slots=True)
class PacketHeader:
    """Space packet primary header (CCSDS 133.0-B-2 clause 4.1.3); ``data_length`` is the field: data bytes
    - 1.
    """

    version: int
    packet_type: int
    secondary_header: int
    apid: int
    sequence_flags: int
    sequence_count: int
    data_length: int

    @classmethod
    def from_bytes(cls, raw: bytes) -> PacketHeader:
        """The header of the first 6 bytes of ``raw``; ValueError when there are fewer."""
        if len(raw) < PRIMARY_HEADER_BYTES:
            raise ValueError(f"a packet header has {PRIMARY_HEADER_BYTES} bytes, got {len(raw)}")
        return cls(**PRIMARY_HEADER.decode(raw[:PRIMARY_HEADER_BYTES]))

    def as_bytes(self) -> bytes:
        """The 6 bytes."""
        return PRIMARY_HEADER.encode(
            version=self.version,
            packet_type=self.packet_type,
            secondary_header=self.secondary_header,
            apid=self.apid,
            sequence_flags=self.sequence_flags,
            sequence_count=self.sequence_count,
            data_length=self.data_length,
        )


@dataclass(frozen=True, slots=True)
class RequestId:
    """Identity of a telecommand in its verification reports: the first 4 bytes of its packet (PUS-C
    8.1.2.1).
    """

    version: int = PACKET_VERSION
    packet_type: int = TYPE_TELECOMMAND
    secondary_header: int = 1
    apid: int = 0
    sequence_flags: int = UNSEGMENTED
    sequence_count: int = 0

    @classmethod
    def from_packet(cls, raw: bytes) -> RequestId:
        """The identity of the packet that starts with ``raw`` (4 bytes or more, else ValueError)."""
        if len(raw) < 4:
            raise ValueError(f"a request ID needs 4 bytes, got {len(raw)}")
        return cls(**REQUEST_ID_LAYOUT.decode(raw[:4]))

    @classmethod
    def from_fields(cls, fields: Mapping[str, Any]) -> RequestId:
        """From the nested ``request_id`` dict of a decoded verification report."""
        return cls(**fields)

    def as_bytes(self) -> bytes:
        """The 4 bytes."""
        return REQUEST_ID_LAYOUT.encode(**self.as_fields())

    def as_fields(self) -> dict[str, int]:
        """As the nested ``request_id`` dict of a verification report."""
        return {name: getattr(self, name) for name in REQUEST_ID_BITS}


REQUEST_ID_BITS: dict[str, int] = {entry.name: entry.bits for entry in REQUEST_ID_LAYOUT.fields}


@dataclass(frozen=True)
class Telecommand:
    """A decoded telecommand. ``ack``: bits 8 acceptance, 4 start, 2 progress, 1 completion."""

    apid: int
    sequence_count: int
    service: int
    subservice: int
    name: str
    fields: dict[str, Any] = field(default_factory=dict)
    source_id: int = 0
    ack: int = ACK_ACCEPTANCE | ACK_COMPLETION
    raw: bytes = b""

    @property
    def request_id(self) -> RequestId:
        """Its identity in verification reports."""
        return RequestId(apid=self.apid, sequence_count=self.sequence_count)


@dataclass(frozen=True)
class Telemetry:
    """A decoded telemetry packet; ``time`` is the packet's time, ``time_status`` its time reference status
    (4 bit).
    """

    apid: int
    sequence_count: int
    service: int
    subservice: int
    name: str
    fields: dict[str, Any]
    message_count: int
    destination_id: int
    time_status: int
    time: CucTime
    raw: bytes = b""


@dataclass(frozen=True)
class Malformed:
    """Bytes that are no packet of this interface.

    ``header`` is there from 6 bytes on, ``request_id`` from 4 bytes on; when ``reason`` is BAD_CRC,
    TOO_SHORT or LENGTH_MISMATCH they are what the damaged bytes say and may be wrong.
    """

    reason: MalformedReason
    detail: str
    raw: bytes
    header: PacketHeader | None = None
    request_id: RequestId | None = None

    def _second(self, name: str) -> int:
        second = self.raw[PRIMARY_HEADER_BYTES : PRIMARY_HEADER_BYTES + TELECOMMAND_SECONDARY_HEADER_BYTES]
        if len(second) < TELECOMMAND_SECONDARY_HEADER_BYTES:
            return 0
        return TELECOMMAND_SECONDARY_HEADER.decode(second)[name]

    @property
    def service(self) -> int:
        """Of a telecommand, as its octets say; 0 when they are too few."""
        return self._second("service")

    @property
    def subservice(self) -> int:
        """Of a telecommand, as its octets say; 0 when they are too few."""
        return self._second("subservice")

    @property
    def source_id(self) -> int:
        """Of a telecommand, as its octets say; 0 when they are too few."""
        return self._second("source_id")


def error_controlled_bytes(raw: bytes) -> int:
    """Over how many octets a receiver computes the error control: all, or none where the packet is not as
    long as its own header says.
    """
    if len(raw) < PRIMARY_HEADER_BYTES:
        return 0
    declared = PRIMARY_HEADER_BYTES + PacketHeader.from_bytes(raw).data_length + 1
    return declared if len(raw) == declared else 0


def space_packet(packet_type: int, apid: int, sequence_count: int, data: bytes) -> bytes:
    """A whole space packet with secondary header flag set and unsegmented, its packet error control appended.

    ``data``: the secondary header and the user data. LocalProtocolError when a header field is out of range.
    """
    what = "telecommand packet" if packet_type == TYPE_TELECOMMAND else "telemetry packet"
    if apid == IDLE_APID:
        raise LocalProtocolError(what, "apid", apid, "0..2046 (2047 is for idle packets)")
    limit = MAX_TELECOMMAND_BYTES if packet_type == TYPE_TELECOMMAND else MAX_TELEMETRY_BYTES
    total = PRIMARY_HEADER_BYTES + len(data) + PACKET_ERROR_CONTROL_BYTES
    if total > limit:
        raise LocalProtocolError(what, "length", f"{total} bytes", f"at most {limit} bytes")
    header = PRIMARY_HEADER.encode(
        version=PACKET_VERSION,
        packet_type=packet_type,
        secondary_header=1,
        apid=apid,
        sequence_flags=UNSEGMENTED,
        sequence_count=sequence_count,
        data_length=len(data) + PACKET_ERROR_CONTROL_BYTES - 1,
    )
    packet = header + data
    return packet + crc16_ccitt(packet).to_bytes(2, "big")
