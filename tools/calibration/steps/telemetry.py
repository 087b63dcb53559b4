"""Packets out and telecommands in on the ARM, compared byte by byte with what the emulator's codec gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from dataclasses import fields as fields_of
from typing import Any

import numpy as np

from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.protocol import CucTime, RequestId
from st_emulator.protocol.pus.packets import MAX_TELEMETRY_BYTES
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
from tools.calibration.struct_layout import layout_of, place_struct, read_structs, reserve_structs

__all__ = ["STEPS", "TelemetryStep", "own_records"]

MOST_TELECOMMANDS = 16  # of a round
TRIANGLE = ("xx", "xy", "xz", "yy", "yz", "zz")  # of a covariance, in the order of the packet


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
        found = reserve_structs(self.machine, "st_telecommand", MOST_TELECOMMANDS)
        decoder = reserve_structs(self.machine, "st_slip_decoder")
        number = self.call(
            "st_telecommands", decoder, self.placed(line), len(line), apid, found, MOST_TELECOMMANDS
        )
        received = read_structs(self.machine, "st_telecommand", found, number)
        return tuple(_received(telecommand) for telecommand in received)

    def send(self, packet: Packet) -> bytes:
        """The packet's bytes on the line."""
        definition = REGISTRY.by_name(packet.name)
        header = packet.header
        out = self.machine.reserve(MAX_TELEMETRY_BYTES)
        placed = place_struct(
            self.machine,
            "st_telemetry_header",
            apid=header["apid"],
            sequence_count=header["sequence_count"],
            service=definition.service,
            subservice=definition.subservice,
            message_count=header["message_count"],
            destination_id=header["destination_id"],
            time_status=header["time_status"],
            time_coarse=header["time"].coarse,
            time_fine=header["time"].fine,
        )
        length = self._build(packet, placed, out)
        line = self.machine.reserve(2 * length + 2)
        count = self.call("st_slip_encode", out, length, line)
        return self.read(line, count)

    def _build(self, packet: Packet, header: int, out: int) -> int:
        fields = packet.fields
        if packet.name == "attitude_report":
            return self.call("st_attitude_packet", header, self._report(fields), out)
        if packet.name in VERIFICATIONS:
            request = RequestId.from_fields(fields["request_id"]).as_bytes()
            return self.call("st_verification_packet", header, self.placed(request), out)
        if packet.image is None:
            raise ValueError(f"there is no kernel for {packet.name}")
        stored = place_struct(
            self.machine,
            "st_stored_image",
            header=self.placed(packet.image.header),
            header_bytes=len(packet.image.header),
            pixels=self.pixels(packet.image),
        )
        part = (fields["transaction_id"], fields["part_number"], stored)
        return self.call("st_image_packet", header, *part, packet.offset, packet.copied_bytes, out)

    def _report(self, fields: Mapping[str, Any]) -> int:
        """An st_attitude_report. Members that are called as a field of the packet have that field's value."""
        time: CucTime = fields["mid_exposure_time"]
        members = layout_of(self.machine, "st_attitude_report").members
        return place_struct(
            self.machine,
            "st_attitude_report",
            q=[fields[f"q_{axis}"] for axis in "xyzw"],
            covariance_rad2=[fields[f"covariance_{axes}"] for axes in TRIANGLE],
            rate_rad_s=[fields[f"rate_{axis}"] for axis in "xyz"],
            rate_covariance_rad2_s2=[fields[f"rate_covariance_{axes}"] for axes in TRIANGLE],
            mid_exposure_coarse=time.coarse,
            mid_exposure_fine=time.fine,
            **{name: fields[name] for name in members if name in fields},
        )

    def pixels(self, image: StoredImage) -> int:
        """Where the pixels are; a part's read may end within the last one."""
        return self.machine.place(image.pixels)


def _received(telecommand: np.void) -> ReceivedTelecommand:
    """Of a malformed one only why and how long it was."""
    told = fields_of(ReceivedTelecommand)
    names = [item.name for item in (told if telecommand["reason"] == 0 else told[:2])]
    return ReceivedTelecommand(**{name: int(telecommand[name]) for name in names})


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
