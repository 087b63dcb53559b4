"""The attitude report of a frame on its way out: bytes to build, and the time that they take on the line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..clock import NS_PER_S
from ..firmware_model.work import Work
from ..protocol.can.bits import frame_duration_ns
from ..protocol.can.cyclic import CAN_MESSAGES_BY_NAME
from ..protocol.can.frames import CanFrame
from ..protocol.framing import slip_encode
from ..protocol.pus.packets import CucTime
from ..protocol.pus.registry import REGISTRY, encode_telemetry
from ..wire.serial_line import BITS_PER_BYTE
from .subject import Subject

# SLIP escapes two of the 256 values of a byte.
SHARE_ESCAPED = 2 / 256


@dataclass(frozen=True)
class Transmission:
    """What a frame sends. serial_ns: the report in its SLIP frame at the unit's baud rate, with as many
    escapes as evenly spread bytes have. can_ns: the cyclic frames of a frame one after the other, stuffed as
    zeros are, on a bus that nobody else uses.
    """

    packet_bytes: int
    line_bytes: float
    serial_ns: int
    can_frames: int
    can_ns: int

    @property
    def work(self) -> Work:
        """Building the packet and its CRC."""
        return Work({"telemetry_bytes": self.packet_bytes, "crc_bytes": self.packet_bytes})


def transmission_of(subject: Subject) -> Transmission:
    """What each frame of the unit sends on a serial line, or on its CAN bus."""
    wire, can = subject.profile.wire, subject.profile.can
    packet_bytes = len(_empty_report()) if subject.parameters["attitude_report"] else 0
    frame_bytes = len(slip_encode(b"")) + packet_bytes if packet_bytes else 0
    line_bytes = frame_bytes + packet_bytes * SHARE_ESCAPED
    identifiers = can.identifier_table()
    sent = {
        "attitude_1": can.attitude_frames,
        "attitude_2": can.attitude_frames,
        "rates": can.rates_frames,
        "status": can.status_frames,
        "mid_exposure_time": can.time_frames,
    }
    frames = [
        CanFrame(
            identifiers.identifier(name),
            bytes(CAN_MESSAGES_BY_NAME[name].size_bytes),
            extended=can.extended,
        )
        for name, interval in sent.items()
        if interval > 0
    ]
    return Transmission(
        packet_bytes,
        line_bytes,
        round(line_bytes * BITS_PER_BYTE * NS_PER_S / wire.baud),
        len(frames),
        sum(frame_duration_ns(frame, can.bitrate, can.data_bitrate) for frame in frames),
    )


def _empty_report() -> bytes:
    """The packet of an attitude report: its length does not depend on what it says."""
    time = CucTime(0, 0)
    fields: Mapping[str, Any] = {
        field.name: time if field.name == "mid_exposure_time" else 0
        for field in REGISTRY.by_name("attitude_report").fields
        if hasattr(field, "name")
    }
    return encode_telemetry(
        "attitude_report",
        fields,
        apid=1,
        sequence_count=0,
        message_count=0,
        destination_id=0,
        time=time,
        time_status=0,
    )
