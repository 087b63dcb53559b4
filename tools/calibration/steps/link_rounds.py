"""Rounds of the link: what packets and telecommands ask of the processor between two frames.

No frame's trace has them. ``own_records`` makes them for the calibration: mostly the attitude report, now and
then telecommands with their reports, parts of an image, or an image to keep.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.link_work import (
    kept_image_work,
    line_work,
    packet_work,
    round_work,
    telecommand_work,
)
from st_emulator.firmware_model.work import Work
from st_emulator.protocol import (
    CucTime,
    FrameReceived,
    Malformed,
    RequestId,
    SlipDecoder,
    crc16_ccitt,
    encode_telecommand,
    encode_telemetry,
    parse_telecommand,
    slip_encode,
)
from st_emulator.protocol.pus.enumerations import MalformedReason
from st_emulator.protocol.pus.packets import MAX_TELECOMMAND_BYTES, error_controlled_bytes
from st_emulator.protocol.pus.services.large_data import encode_image_header

__all__ = [
    "APID",
    "VERIFICATIONS",
    "LinkOutcome",
    "LinkRound",
    "Packet",
    "ReceivedTelecommand",
    "StoredImage",
    "own_records",
    "record_of",
]

APID = 0x2A
VERIFICATIONS = ("acceptance_success", "start_success", "completion_success")
PART_BYTES = 1024  # as the unit's serial port cuts an image
_HEADERS_CHECKED = MalformedReason.BAD_PUS_VERSION  # what comes after is for the service to find


@dataclass(frozen=True)
class StoredImage:
    """An image kept for download: the header that goes out before it, and its pixels uint16[n]."""

    header: bytes
    pixels: npt.NDArray[np.uint16]

    def as_bytes(self) -> bytes:
        """As it goes out."""
        return self.header + self.pixels.astype(">u2").tobytes()


@dataclass(frozen=True)
class Packet:
    """A telemetry packet to build: the arguments of ``encode_telemetry``; of an image's part the image too,
    and where in it the part starts, in bytes.
    """

    name: str
    fields: Mapping[str, Any]
    header: Mapping[str, Any]
    image: StoredImage | None = None
    offset: int = 0

    def as_bytes(self) -> bytes:
        """The whole packet."""
        return encode_telemetry(self.name, self.fields, **self.header)

    @property
    def copied_bytes(self) -> int:
        return len(self.fields["data"]) if self.image is not None else 0


@dataclass(frozen=True)
class LinkRound:
    """What the link asks of the processor between two frames.

    line: bytes received; apid: of the unit. packets: to send. kept: an image whose CRC is computed.
    """

    line: bytes = b""
    apid: int = APID
    packets: Sequence[Packet] = ()
    kept: StoredImage | None = None


@dataclass(frozen=True)
class ReceivedTelecommand:
    """What came between two ENDs of the line. reason: 0 for a packet whose headers are right; length: of the
    packet, or of a discarded frame's bytes on the line.
    """

    reason: int
    length: int
    sequence_count: int = 0
    ack: int = 0
    service: int = 0
    subservice: int = 0
    source_id: int = 0


@dataclass(frozen=True)
class LinkOutcome:
    """telecommands: what the line held; line: what goes out; crc: of the image kept."""

    telecommands: tuple[ReceivedTelecommand, ...] = ()
    line: bytes = b""
    crc: int | None = None


def expected_telecommands(line: bytes, apid: int) -> tuple[ReceivedTelecommand, ...]:
    """What the emulator's receiver finds on a line, as far as the headers."""
    found = []
    for event in SlipDecoder(MAX_TELECOMMAND_BYTES).receive(line, 0):
        if not isinstance(event, FrameReceived):
            found.append(ReceivedTelecommand(int(event.reason.malformed_reason), event.length))
            continue
        raw = event.data
        packet = parse_telecommand(raw, apids={apid})
        if isinstance(packet, Malformed) and packet.reason <= _HEADERS_CHECKED:
            found.append(ReceivedTelecommand(int(packet.reason), len(raw)))
            continue
        sequence = int.from_bytes(raw[2:4], "big") & 0x3FFF
        source_id = int.from_bytes(raw[9:11], "big")
        found.append(ReceivedTelecommand(0, len(raw), sequence, raw[6] & 15, raw[7], raw[8], source_id))
    return tuple(found)


def record_of(task: LinkRound) -> StepRecord:
    """A round with what the emulator's codec makes of it, and its work."""
    received, sent = line_work(len(task.line)), Work()
    for frame in SlipDecoder(MAX_TELECOMMAND_BYTES).receive(task.line, 0):
        if isinstance(frame, FrameReceived):
            received += telecommand_work(error_controlled_bytes(frame.data))
    packets = [packet.as_bytes() for packet in task.packets]
    for packet, raw in zip(task.packets, packets, strict=True):
        sent += packet_work(len(raw), packet.copied_bytes)
    crc = None
    if task.kept is not None:
        crc = crc16_ccitt(task.kept.as_bytes()[len(task.kept.header) :])
        sent += kept_image_work(len(task.kept.pixels))
    outcome = LinkOutcome(
        expected_telecommands(task.line, task.apid), b"".join(map(slip_encode, packets)), crc
    )
    return StepRecord("telemetry", {"round": task}, outcome, round_work(sent, received))


def own_records(seed: int, n: int) -> list[StepRecord]:
    """``n`` rounds of the link with random contents, the same for the same seed."""
    rng = np.random.default_rng([seed, 13])
    return [record_of(_round(rng)) for _ in range(n)]


def _round(rng: np.random.Generator) -> LinkRound:
    line = slip_encode(_noise(rng)) if rng.random() < 0.2 else b""
    reports = int(rng.random() < 0.8)  # a unit can be told to send none
    packets = [Packet("attitude_report", attitude_fields(rng), packet_header(rng)) for _ in range(reports)]
    for _ in range(int(rng.integers(1, 4)) if not reports or rng.random() < 0.4 else 0):
        raw = random_telecommand(rng)
        line += slip_encode(raw)
        request = {"request_id": RequestId.from_packet(raw).as_fields()}
        for name in rng.choice(VERIFICATIONS, int(rng.integers(1, 3)), replace=False):
            packets.append(Packet(str(name), request, packet_header(rng)))
    if rng.random() < 0.3:
        packets += random_parts(rng, int(rng.integers(1, 5)))
    kept = random_image(rng, int(rng.integers(1, 5)) * 4096) if rng.random() < 0.15 else None
    return LinkRound(line, APID, tuple(packets), kept)


def _noise(rng: np.random.Generator) -> bytes:
    """A frame that is no packet: its length is wrong."""
    return bytes(6) + rng.bytes(int(rng.integers(20, 400)))


def packet_header(rng: np.random.Generator) -> dict[str, Any]:
    """What ``encode_telemetry`` takes beside name and fields."""
    return {
        "apid": APID,
        "sequence_count": int(rng.integers(1 << 14)),
        "message_count": int(rng.integers(1 << 16)),
        "destination_id": int(rng.integers(1 << 16)),
        "time": CucTime(int(rng.integers(1 << 32)), int(rng.integers(1 << 24))),
        "time_status": int(rng.integers(2)),
    }


def attitude_fields(rng: np.random.Generator) -> dict[str, Any]:
    """Of an attitude report as a frame may give it."""
    q = rng.normal(size=4)
    q *= np.copysign(1.0 / np.linalg.norm(q), q[3])
    return {
        **{f"q_{axis}": float(part) for axis, part in zip("xyzw", q, strict=True)},
        **{
            f"covariance_{name}": float(rng.normal(0, 1e-10)) for name in ("xx", "xy", "xz", "yy", "yz", "zz")
        },
        **{f"rate_{axis}": float(rng.normal(0, 0.01)) for axis in "xyz"},
        **{
            f"rate_covariance_{name}": float(rng.normal(0, 1e-9))
            for name in ("xx", "xy", "xz", "yy", "yz", "zz")
        },
        "residual_rms_arcsec": float(rng.uniform(0, 20)),
        "background_dn": float(rng.uniform(0, 300)),
        "noise_dn": float(rng.uniform(0.5, 20)),
        "false_match_probability": float(10.0 ** rng.uniform(-30, 0)),
        "frame_index": int(rng.integers(1 << 32)),
        "mid_exposure_time": CucTime(int(rng.integers(1 << 32)), int(rng.integers(1 << 24))),
        "time_status": int(rng.integers(2)),
        "mode": int(rng.integers(2, 4)),
        "valid": int(rng.integers(2)),
        "reasons": int(rng.integers(1 << 8)),
        "rate_valid": int(rng.integers(2)),
        "rate_covariance_valid": int(rng.integers(2)),
        "spots_detected": int(rng.integers(200)),
        "stars_identified": int(rng.integers(40)),
        "windows": int(rng.integers(25)),
        "window_half_width_px": int(rng.integers(20)),
        "exposure_us": int(rng.integers(1000, 250_000)),
        "cycles": int(rng.integers(1_000_000, 200_000_000)),
        "latency_us": int(rng.integers(50_000, 500_000)),
        "late": int(rng.integers(2)),
        "frames_dropped_before": int(rng.integers(3)),
    }


def random_telecommand(rng: np.random.Generator) -> bytes:
    """A packet of 13 to about 280 bytes."""
    name, fields = (
        ("ping", {}),
        ("set_time", {"time": CucTime(int(rng.integers(1 << 32)), int(rng.integers(1 << 24)))}),
        ("parameter_report", {"parameter_ids": [int(rng.integers(1, 15)) for _ in range(8)]}),
        ("memory_load", _load(rng.bytes(int(rng.integers(1, 257))))),
    )[int(rng.integers(4))]
    return encode_telecommand(
        name,
        fields,
        apid=APID,
        sequence_count=int(rng.integers(1 << 14)),
        source_id=int(rng.integers(1 << 16)),
        ack=int(rng.integers(16)),
    )


def _load(data: bytes) -> dict[str, Any]:
    return {"memory_id": 1, "start_address": 0, "data": data, "checksum": crc16_ccitt(data)}


def random_image(rng: np.random.Generator, pixels: int) -> StoredImage:
    """Pixels with their header."""
    values = rng.integers(0, 4096, pixels).astype(np.uint16)
    header = encode_image_header(
        {
            "frame_index": int(rng.integers(1 << 32)),
            "width": 64,
            "height": pixels // 64,
            "bits": 12,
            "reserved": 0,
            "time": CucTime(int(rng.integers(1 << 32)), 0),
            "exposure_us": 100_000,
            "crc": crc16_ccitt(values.astype(">u2").tobytes()),
        }
    )
    return StoredImage(header, values)


def random_parts(rng: np.random.Generator, parts: int) -> list[Packet]:
    """So many parts in a row of an image of a few more."""
    image = random_image(rng, 64 * int(rng.integers(40, 200)))
    whole = image.as_bytes()
    last = -(-len(whole) // PART_BYTES)
    first = int(rng.integers(1, max(last - parts, 1) + 1))
    return [image_part(rng, image, number, last) for number in range(first, min(first + parts, last + 1))]


def image_part(rng: np.random.Generator, image: StoredImage, number: int, last: int) -> Packet:
    """Part ``number`` of ``last``."""
    name = "image_last_part" if number == last else "image_first_part" if number == 1 else "image_part"
    offset = (number - 1) * PART_BYTES
    data = image.as_bytes()[offset : offset + PART_BYTES]
    fields = {"transaction_id": int(rng.integers(1 << 16)), "part_number": number, "data": data}
    return Packet(name, fields, packet_header(rng), image, offset)
