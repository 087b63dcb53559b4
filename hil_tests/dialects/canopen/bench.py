"""A unit that speaks canopen in virtual time, and the small master on the other end of its bus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hil_tests.dialects.canopen import client
from hil_tests.dialects.canopen.client import NODE, STATES, Attitude, SdoClient
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.scenario import Scenario
from st_emulator.units.profile import UnitProfile, load_unit
from st_emulator.wire.can.wiring import CanWiring

MS = 1_000_000
START_UNIX_S = 1_768_435_200  # 2026-01-15T00:00:00Z, the date of a scenario that does not say otherwise


def unit(name: str = "roja1", **settings: Any) -> UnitProfile:
    """The profile of a unit with the dialect's settings."""
    profile = load_unit(name)
    wire = profile.wire.model_copy(update={"dialect": "canopen"})
    return profile.model_copy(update={"wire": wire, "dialects": {"canopen": settings}})


@dataclass
class Bench:
    """``sent``: (time, identifier, data) of the unit's frames, of each of which ``hear`` is told as well.
    ``refusing``: the link takes none.
    """

    emulator: Emulator
    node: int = NODE
    sent: list[tuple[int, int, bytes]] = field(default_factory=list)
    refusing: bool = False
    hear: Callable[[int, int, bytes], None] = lambda t_ns, identifier, payload: None

    def transmitted(self, data: bytes, t_ns: int) -> int:
        if self.refusing:
            return 0
        for identifier, payload in client.frames(data):
            self.sent.append((t_ns, identifier, payload))
            self.hear(t_ns, identifier, payload)
        return len(data)

    @property
    def now_ms(self) -> float:
        return self.emulator.now_ns / MS

    def run(self, ms: float) -> None:
        self.emulator.advance(self.emulator.now_ns + round(ms * MS))

    def run_until(self, found: Callable[[], object], limit_ms: float = 5000) -> None:
        limit = self.now_ms + limit_ms
        while not found():
            assert self.now_ms < limit, "it did not come"
            self.run(1)

    def put(self, identifier: int, data: bytes = b"", **flags: bool) -> None:
        self.emulator.receive(client.record(identifier, data, **flags))

    def of(self, identifier: int) -> list[tuple[int, bytes]]:
        """(time, data) of the unit's frames of an identifier."""
        return [(t_ns, data) for t_ns, one, data in self.sent if one == identifier]

    @property
    def heartbeats(self) -> list[tuple[int, bytes]]:
        return self.of(0x700 + self.node)

    @property
    def emergencies(self) -> list[bytes]:
        return [data for _, data in self.of(0x80 + self.node)]

    @property
    def attitudes(self) -> list[Attitude]:
        return client.attitudes(self.sent, self.node)

    def forget(self) -> None:
        self.sent.clear()

    def exchange(self, request: bytes) -> list[bytes]:
        """A frame of SDO, and what the server says to it: all that comes without a gap of 2 ms."""
        start = len(self.sent)
        self.put(0x600 + self.node, request)
        answers: list[bytes] = []
        while True:
            self.run(2)
            now = [data for _, identifier, data in self.sent[start:] if identifier == 0x580 + self.node]
            if len(now) == len(answers):
                return now
            answers = now

    @property
    def sdo(self) -> SdoClient:
        return SdoClient(self.exchange)

    def nmt(self, command: str, node: int | None = None) -> None:
        self.put(0, bytes((client.NMT[command], self.node if node is None else node)))
        self.run(2)

    def boot(self) -> Bench:
        """Past the boot, nothing remembered."""
        self.run(self.emulator.profile.timing.boot_ms + 5)
        self.forget()
        return self

    @property
    def state(self) -> int:
        return self.sdo.number(0x4000)

    def ask_for(self, state: str) -> None:
        self.sdo.write(0x4000, 0, bytes((STATES[state],)))

    def set_time(self) -> None:
        """The date of the sky by RPDO 1, and a frame's start behind it, which brings it into force."""
        frame_ns = 130_000  # about what the frame takes: its last bit is the time it tells
        t_ns = self.emulator.now_ns + frame_ns
        self.put(0x181, client.scet(START_UNIX_S + t_ns // 10**9, t_ns % 10**9 // 1000))
        self.run(260)

    def errors_arcsec(self, found: list[Attitude]) -> list[float]:
        """The angle between the boresight that was told and the true one, of each attitude."""
        trajectory = self.emulator.scene.trajectory
        profile = self.emulator.profile
        period = profile.frame_period_ns
        readout = round((profile.timing.exposure_ms + profile.timing.readout_ms) * MS)
        errors = []
        for one in found:
            start = (one.t_ns - readout) // period * period
            true = trajectory.q_icrs_to_sensor(start + round(profile.timing.exposure_ms * MS / 2))
            a, b = boresight(np.array((one.i, one.j, one.k, one.real))), boresight(np.array(true))
            errors.append(float(np.degrees(np.linalg.norm(np.cross(a, b))) * 3600))
        return errors


def boresight(q: np.ndarray) -> np.ndarray:
    """+Z of the sensor in ICRS: v + 2 u x (u x v + w v), the inverse of what turns ICRS to the sensor."""
    q = q / np.linalg.norm(q)
    u, w, v = q[:3], q[3], np.array((0.0, 0.0, 1.0))
    return v + 2 * np.cross(u, np.cross(u, v) + w * v)


def make(name: str = "roja1", *, parameters: dict[str, Any] | None = None, **arguments: Any) -> Bench:
    """A bench with a fresh unit; what :class:`Emulator` does not know are settings of the dialect."""
    own = ("scenario", "seed", "store", "can", "disturbance", "journal", "truth", "frames", "timing")
    given = {key: arguments.pop(key) for key in own if key in arguments}
    profile = unit(name, **arguments)
    if "timing" in given:
        timing = profile.timing.model_copy(update=given.pop("timing"))
        profile = profile.model_copy(update={"timing": timing})
    if parameters:
        given["scenario"] = Scenario(parameters=parameters)
    wiring = given.pop("can", CanWiring())
    bench = Bench.__new__(Bench)
    emulator = Emulator(profile, can=wiring, transmit=lambda d, t: bench.transmitted(d, t), **given)
    node = wiring.node or arguments.get("node", NODE)
    Bench.__init__(bench, emulator, node)
    return bench
