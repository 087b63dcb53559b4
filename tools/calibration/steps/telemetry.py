"""Packets out and telecommands in on the ARM, compared byte by byte with what the emulator's codec gives."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.protocol import CucTime, RequestId
from st_emulator.protocol.pus.packets import MAX_TELECOMMAND_BYTES, MAX_TELEMETRY_BYTES
from st_emulator.protocol.pus.registry import REGISTRY
from tools.arm_timing.machine import ArmMachine, Cost
from tools.calibration.steps.link_rounds import (
    VERIFICATIONS,
    LinkOutcome,
    LinkRound,
    Packet,
    ReceivedTelecommand,
    StoredImage,
    own_records,
)
from tools.calibration.steps.step import MismatchError, StageRun

__all__ = ["STEPS", "TelemetryStep", "own_records"]

MOST_TELECOMMANDS = 16  # of a round

_HEADER = struct.Struct("<9I")  # st_telemetry_header
_REPORT = struct.Struct("<17d17I4x")  # st_attitude_report
_IMAGE = struct.Struct("<IiI")  # st_stored_image
_DECODER_BYTES = MAX_TELECOMMAND_BYTES + 16  # st_slip_decoder
_TELECOMMAND = struct.Struct("<2i5I")  # st_telecommand
_DOUBLES = (
    *(f"q_{name}" for name in "xyzw"),
    *(f"covariance_{name}" for name in ("xx", "xy", "xz", "yy", "yz", "zz")),
    *(f"rate_{name}" for name in "xyz"),
    "residual_rms_arcsec",
    "background_dn",
    "noise_dn",
    "false_match_probability",
)
_WORDS = (
    "time_status",
    "mode",
    "valid",
    "reasons",
    "rate_valid",
    "spots_detected",
    "stars_identified",
    "windows",
    "window_half_width_px",
    "exposure_us",
    "cycles",
    "latency_us",
    "late",
    "frames_dropped_before",
)


@dataclass
class _Run:
    """Calls of one round on the machine, their costs added up."""

    machine: ArmMachine
    cost: Cost = field(default_factory=Cost)

    def call(self, symbol: str, *arguments: int) -> int:
        done = self.machine.call(symbol, *arguments)
        self.cost += done.cost
        return done.result

    def placed(self, data: bytes) -> int:
        return self.machine.place(np.frombuffer(data, np.uint8))

    def read(self, address: int, count: int) -> bytes:
        return self.machine.read(address, np.uint8, count).tobytes()

    def receive(self, line: bytes, apid: int) -> tuple[ReceivedTelecommand, ...]:
        found = self.machine.reserve(MOST_TELECOMMANDS * _TELECOMMAND.size)
        decoder = self.machine.reserve(_DECODER_BYTES)
        number = self.call(
            "st_telecommands", decoder, self.placed(line), len(line), apid, found, MOST_TELECOMMANDS
        )
        packed = self.read(found, number * _TELECOMMAND.size)
        return tuple(
            ReceivedTelecommand(*values) if values[0] == 0 else ReceivedTelecommand(*values[:2])
            for values in _TELECOMMAND.iter_unpack(packed)
        )

    def send(self, packet: Packet) -> bytes:
        """The packet's bytes on the line."""
        definition = REGISTRY.by_name(packet.name)
        header = packet.header
        packed = _HEADER.pack(
            header["apid"],
            header["sequence_count"],
            definition.service,
            definition.subservice,
            header["message_count"],
            header["destination_id"],
            header["time_status"],
            header["time"].coarse,
            header["time"].fine,
        )
        out = self.machine.reserve(MAX_TELEMETRY_BYTES)
        length = self._build(packet, self.placed(packed), out)
        line = self.machine.reserve(2 * length + 2)
        count = self.call("st_slip_encode", out, length, line)
        return self.read(line, count)

    def _build(self, packet: Packet, header: int, out: int) -> int:
        fields = packet.fields
        if packet.name == "attitude_report":
            return self.call("st_attitude_packet", header, self.placed(_packed_report(fields)), out)
        if packet.name in VERIFICATIONS:
            request = RequestId.from_fields(fields["request_id"]).as_bytes()
            return self.call("st_verification_packet", header, self.placed(request), out)
        if packet.image is None:
            raise ValueError(f"there is no kernel for {packet.name}")
        stored = _IMAGE.pack(
            self.placed(packet.image.header), len(packet.image.header), self.pixels(packet.image)
        )
        part = (fields["transaction_id"], fields["part_number"], self.placed(stored))
        return self.call("st_image_packet", header, *part, packet.offset, packet.copied_bytes, out)

    def pixels(self, image: StoredImage) -> int:
        """Where the pixels are; a part's read may end within the last one."""
        return self.machine.place(image.pixels)


def _packed_report(fields: Mapping[str, Any]) -> bytes:
    time: CucTime = fields["mid_exposure_time"]
    return _REPORT.pack(
        *(fields[name] for name in _DOUBLES),
        fields["frame_index"],
        time.coarse,
        time.fine,
        *(fields[name] for name in _WORDS),
    )


class TelemetryStep:
    """A round of the link; all bytes are the same as the emulator's codec gives.

    The caches start empty. ASSUMED: between two rounds a frame has gone through them, its pixels through the
    one, the code of the other stages through the other.
    """

    name = "telemetry"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        task: LinkRound = record.arguments["round"]
        run = _Run(machine)
        machine.flush_caches()
        telecommands = run.receive(task.line, task.apid) if task.line else ()
        line = b"".join(run.send(packet) for packet in task.packets)
        crc = None
        if task.kept is not None:
            crc = run.call("st_crc16_pixels", run.pixels(task.kept), len(task.kept.pixels))
        machine.release()
        _compare(LinkOutcome(telecommands, line, crc), record.result)
        return [StageRun(self.name, "telemetry", run.cost, record.work)]


def _compare(found: LinkOutcome, expected: LinkOutcome) -> None:
    for name in ("telecommands", "line", "crc"):
        ours, theirs = getattr(found, name), getattr(expected, name)
        if ours != theirs:
            raise MismatchError(f"telemetry: {name} {ours!r}, {theirs!r} in Python")


STEPS = (TelemetryStep(),)
