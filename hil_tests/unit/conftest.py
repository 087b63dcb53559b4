"""A unit in virtual time on one side of a wire, a reference decoder made with struct alone on the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from hil_tests.vectors import reference_can_frames as cyclic
from hil_tests.vectors import reference_decoder as wire
from hil_tests.vectors.received import FUNCTION, Packet, Received
from hil_tests.vectors.reference_can import Peer, record
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.scenario import Scenario
from st_emulator.units.can_section import CanBases
from st_emulator.units.profile import UnitProfile, load_unit
from st_emulator.wire.can.wiring import CanWiring

MS = 1_000_000
SOURCE = 0x2A
MODE = {
    "BOOT": 0, "SELF_TEST": 1, "STANDBY": 2, "LOST_IN_SPACE": 3, "TRACKING": 4, "FAULT": 5, "OFF": 6,
    "RATE_ONLY": 7,
}  # fmt: skip
PARAMETER = {
    name: number
    for number, name in enumerate(
        (
            "exposure_us", "detection_sigma", "detection_min_pixels", "centroid_half_window_px",
            "magnitude_limit", "identification_tolerance_arcsec", "identification_max_spots",
            "tracking_rate_deg_s", "tracking_tolerance_arcsec", "tracking_min_stars", "tracking_max_missed",
            "blinded_background_dn", "aberration_correction", "velocity_x_km_s", "velocity_y_km_s",
            "velocity_z_km_s", "attitude_report", "autonomous_start", "pipelined", "clock_hz", "boot_count",
            "cache_kib", "line_fill",
        ),
        start=1,
    )
}  # fmt: skip
WIDE = {"identifier_bits": 29, "identifiers": CanBases()}


@dataclass
class Bench(Received):
    """The unit and what it has sent. Telecommands go out with counts of their own, all reports asked for."""

    emulator: Emulator
    packets: list[Packet] = field(default_factory=list)
    groups: list[tuple[int, bytes]] = field(default_factory=list)
    count: int = -1
    broken: list[bytes] | None = None  # a list takes frames that are no packets, which are errors else
    _line: bytes = b""

    def transmitted(self, data: bytes, t_ns: int) -> int | None:
        self.groups.append((t_ns, data))
        self._line += data
        whole = self._line.rfind(b"\xc0") + 1
        for frame in wire.slip_frames(self._line[:whole]):
            try:
                self.packets.append(Packet(t_ns, wire.decode_telemetry(frame)))
            except ValueError:
                if self.broken is None:
                    raise
                self.broken.append(frame)
        self._line = self._line[max(whole - 1, 0) :]
        return None

    @property
    def apid(self) -> int:
        return self.emulator.profile.apid

    @property
    def now_ms(self) -> float:
        return self.emulator.now_ns / MS

    def advance(self, until_ns: int) -> None:
        self.emulator.advance(until_ns)

    def run(self, ms: float) -> None:
        self.advance(self.emulator.now_ns + round(ms * MS))

    def run_to(self, ms: float) -> None:
        self.advance(round(ms * MS))

    def run_until(self, found: Callable[[], bool], limit_ms: float = 5000) -> None:
        limit = self.now_ms + limit_ms
        while not found():
            assert self.now_ms < limit, "it did not come"
            self.run(5)

    def forget(self) -> None:
        self.packets.clear()

    def put(self, data: bytes) -> None:
        self.emulator.receive(data)

    def put_packet(self, packet: bytes) -> None:
        self.put(wire.slip_frame(packet))

    def packet(
        self, name: str, fields: dict[str, Any] | None = None, *, ack: int = 15, **header: Any
    ) -> bytes:
        """A telecommand of this bench's source with the next sequence count."""
        self.count = header.pop("count", (self.count + 1) & 0x3FFF)
        header.setdefault("apid", self.apid)
        header.setdefault("source_id", SOURCE)
        return wire.encode_telecommand(name, fields or {}, sequence_count=self.count, ack=ack, **header)

    def send(self, name: str, fields: dict[str, Any] | None = None, **header: Any) -> int:
        """Put a telecommand on the line; returns its sequence count."""
        self.put_packet(self.packet(name, fields, **header))
        return self.count

    def function(self, name: str, arguments: dict[str, Any] | None = None, **header: Any) -> int:
        return self.send("function", {"function_id": FUNCTION[name], "arguments": arguments or {}}, **header)

    def housekeeping(self, structure: int) -> dict[str, Any]:
        """A structure, asked for now."""
        number = len(self.of("hk_report"))
        self.send("hk_one_shot", {"structure_ids": [structure]}, ack=0)
        self.run_until(lambda: len(self.of("hk_report")) > number)
        (values,) = [
            fields["values"]
            for fields in self.of("hk_report")[number:]
            if fields["structure_id"] == structure
        ]
        return values

    def set_parameters(self, **values: float) -> None:
        settings = [{"parameter_id": PARAMETER[name], "value": value} for name, value in values.items()]
        count = self.send("parameter_set", {"settings": settings})
        self.run(20)
        assert self.stages(count) == ["acceptance_success", "completion_success"]

    def parameter(self, name: str) -> float:
        number = len(self.of("parameter_values"))
        self.send("parameter_report", {"parameter_ids": [PARAMETER[name]]}, ack=0)
        self.run_until(lambda: len(self.of("parameter_values")) > number)
        return self.of("parameter_values")[number]["values"][0]["value"]

    def quiet(self) -> None:
        """No periodic housekeeping from now on."""
        self.send("hk_disable", {"structure_ids": [1]}, ack=0)
        self.run(10)
        self.forget()

    def boot(self) -> Bench:
        """Past the boot, housekeeping off, nothing on the line."""
        self.run(self.emulator.profile.timing.boot_ms + 20)
        self.quiet()
        return self

    def to_mode(self, mode: str) -> None:
        """From STANDBY to a mode; to RATE_ONLY where the frames lead there (``tumbling.tumble``)."""
        if mode == "SELF_TEST":
            self.function("START_SELF_TEST", ack=0)
            self.run(20)
        elif mode == "LOST_IN_SPACE":
            self.function("START_ACQUISITION", ack=0)
            self.run(10)
        elif mode in ("TRACKING", "RATE_ONLY"):
            self.function("START_ACQUISITION", ack=0)
            self.run_until(lambda: self.emulator.device.mode == MODE[mode])
        elif mode == "FAULT":
            from st_emulator.protocol.pus.enumerations import FaultCause

            self.emulator.device.enter_fault(FaultCause.COMMANDED)
        self.run(10)
        assert self.emulator.device.mode == MODE[mode]


@dataclass
class CanBench(Bench):
    """The unit on a CAN bus, an OBC made with struct alone on the other end of its transfers.

    ``refusing``: the link takes no frames; ``refused``: so many it did not take.
    """

    peer: Peer = field(default_factory=lambda: Peer(0x60A, 0x58A))
    refusing: bool = False
    refused: int = 0

    def transmitted(self, data: bytes, t_ns: int) -> int:
        if self.refusing:
            self.refused += 1
            return 0
        self.groups.append((t_ns, data))
        number = len(self.peer.packets)
        self.peer.take(data, t_ns)
        for at_ns, packet in self.peer.packets[number:]:
            try:
                self.packets.append(Packet(at_ns, wire.decode_telemetry(packet)))
            except ValueError:
                if self.broken is None:
                    raise
                self.broken.append(packet)
        return len(data)

    def advance(self, until_ns: int) -> None:
        """An OBC that answers at once: what it has to say goes onto the bus before time goes on."""
        while True:
            self.peer.tick(self.emulator.now_ns)
            while self.peer.outbox:
                self.emulator.receive(self.peer.outbox.popleft())
            due_ns = self.emulator.next_event_ns()
            if due_ns is None or due_ns > until_ns:
                break
            self.emulator.advance(due_ns)
        self.emulator.advance(until_ns)

    def put_packet(self, packet: bytes) -> None:
        self.peer.send(packet)

    @property
    def shift(self) -> int:
        """From identifiers of 11 bits to the unit's."""
        return 18 if self.peer.extended else 0

    def identifier(self, name: str) -> int:
        broadcast = name in ("sync", "time_at_sync")
        return (cyclic.BASES[name] << self.shift) + (0 if broadcast else self.peer.telecommand & 0x7F)

    def frames(self, name: str) -> list[tuple[int, dict[str, Any]]]:
        """(time, values) of the unit's frames of a kind, read by whole numbers and shifts."""
        wanted = self.identifier(name)
        return [
            (t_ns, cyclic.decode(name, payload))
            for t_ns, number, payload in self.peer.frames
            if number == wanted
        ]

    def put_frame(self, name: str, payload: bytes) -> None:
        """A frame of the OBC that is no part of a transfer, in its turn."""
        self.peer.outbox.append(record(self.identifier(name), payload, extended=self.peer.extended))

    def can(self) -> dict[str, int]:
        """Housekeeping structure CAN."""
        return self.housekeeping(4)

    def forget(self) -> None:
        super().forget()
        self.groups.clear()
        self.peer.frames.clear()
        self.peer.packets.clear()
        self.peer.asked.clear()
        self.peer.said.clear()


MakeBench = Callable[..., Bench]


def make(profile: UnitProfile | str = "roja1", **arguments: Any) -> Bench:
    """A bench with a fresh unit.

    ``parameters``: of the scenario; ``timing``, ``wire``, ``detection``, ``can_section``: figures of the
    unit file. ``can``: how it is wired to a CAN bus.
    """
    unit = load_unit(profile) if isinstance(profile, str) else profile
    for table in ("timing", "wire", "detection", "can_section"):
        figures = arguments.pop(table, {})
        table = table.removesuffix("_section")
        unit = unit.model_copy(update={table: getattr(unit, table).model_copy(update=figures)})
    if parameters := arguments.pop("parameters", None):
        arguments["scenario"] = Scenario(parameters=parameters)
    if "can" in arguments:
        kind: type[Bench] = CanBench
        node = arguments["can"].node or unit.can.node
        fd = arguments["can"].fd
        extended = unit.can.identifier_bits == 29
        shift = 18 if extended else 0
        own = {
            "peer": Peer(
                (0x600 << shift) + node, (0x580 << shift) + node, extended, frame_bytes=64 if fd else 8
            )
        }
    else:
        kind, own = Bench, {}
    bench = kind.__new__(kind)
    kind.__init__(bench, Emulator(unit, transmit=lambda d, t: bench.transmitted(d, t), **arguments), **own)
    return bench


@pytest.fixture
def new_bench() -> MakeBench:
    """Makes benches."""
    return make


def make_can(profile: UnitProfile | str = "roja1", **arguments: Any) -> CanBench:
    """A bench with a fresh unit on a CAN bus."""
    bench = make(profile, can=arguments.pop("can", CanWiring()), **arguments)
    assert isinstance(bench, CanBench)
    return bench


@pytest.fixture
def bench() -> Bench:
    """A unit in STANDBY with a quiet line."""
    return make().boot()


@pytest.fixture
def store_path(tmp_path: Path) -> Path:
    return tmp_path / "unit.parameters.json"
