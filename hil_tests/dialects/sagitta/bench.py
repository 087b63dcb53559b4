"""A unit that speaks sagitta in virtual time, and the client on the other end of its line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hil_tests.dialects.sagitta import client
from hil_tests.dialects.sagitta.client import Frame
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.scenario import Scenario
from st_emulator.units.profile import UnitProfile, load_unit

MS = 1_000_000
BAUD = 115_200
OCTET_NS = 10 * 1_000_000_000 / BAUD
START_UNIX_US = 1_768_435_200_000_000  # 2026-01-15T00:00:00Z, where scenarios start


def line_ns(octets: int) -> int:
    """Time of so many octets on the line, ten bits each."""
    return octets * 10 * 1_000_000_000 // BAUD


def unit(name: str = "roja1", timing: dict[str, Any] | None = None, **settings: Any) -> UnitProfile:
    """A unit that speaks sagitta."""
    profile = load_unit(name)
    return profile.model_copy(
        update={
            "wire": profile.wire.model_copy(update={"dialect": "sagitta", "baud": BAUD}),
            "timing": profile.timing.model_copy(update=timing or {}),
            "dialects": {"sagitta": settings},
        }
    )


class Bench:
    """The unit and what it has sent.

    Args:
        profile: the unit.
        scenario: its world.
        arguments: further ones of the emulator.
    """

    def __init__(self, profile: UnitProfile, scenario: Scenario | None = None, **arguments: Any) -> None:
        self.groups: list[tuple[int, bytes]] = []
        self.frames: list[Frame] = []
        self._reader = client.Reader()
        self.emulator = Emulator(profile, scenario, transmit=self._transmitted, **arguments)
        self.device = self.emulator.device
        self.latency_ns = profile.timing.telecommand_latency_us * 1000

    def _transmitted(self, data: bytes, t_ns: int) -> None:
        self.groups.append((t_ns, data))
        self.frames += self._reader.take(t_ns, data, OCTET_NS)

    @property
    def now_ns(self) -> int:
        return self.emulator.now_ns

    def put(self, octets: bytes) -> None:
        self.emulator.receive(octets)

    def run(self, ms: float) -> list[Frame]:
        """Let time go on; the frames that came meanwhile."""
        number = len(self.frames)
        self.emulator.advance(self.emulator.now_ns + round(ms * MS))
        return self.frames[number:]

    def run_until(self, found: Callable[[], Any], limit_ms: float = 10_000) -> None:
        limit_ns = self.now_ns + round(limit_ms * MS)
        while not found():
            assert self.now_ns < limit_ns, "it did not come"
            self.run(5)

    def ask(self, type_: int, id_: int, arguments: bytes = b"", ms: float = 60) -> list[Frame]:
        """A request; replies (not subscribed telemetry) within the time after it."""
        self.put(client.request(type_, id_, arguments))
        return [frame for frame in self.run(ms) if frame.type != client.ASYNCHRONOUS]

    def one(self, type_: int, id_: int, arguments: bytes = b"", ms: float = 60) -> Frame:
        """The only reply to a request, of the type and id that belong to it."""
        (frame,) = self.ask(type_, id_, arguments, ms)
        assert (frame.type, frame.id) == (type_ | 0x80, id_)
        return frame

    def status(self, type_: int, id_: int, arguments: bytes = b"") -> int:
        """The status of the only reply; a reply to set and action is 8 bytes."""
        frame = self.one(type_, id_, arguments)
        assert len(frame.body) == 8
        return frame.status

    def telemetry(self, id_: int) -> Frame:
        """Telemetry asked for now; its length is right."""
        frame = self.one(client.REQUEST, id_)
        assert len(frame.body) == client.TELEMETRY_BODY_BYTES[id_]
        assert frame.status == 0
        return frame

    def solution(self) -> dict[str, Any]:
        return client.solution(self.telemetry(client.SOLUTION))

    def subscribe(self, *ids: int) -> None:
        assert self.status(client.SET, client.SUBSCRIPTION, client.subscription(*ids)) == 0

    def subscribed(self, id_: int, frames: list[Frame] | None = None) -> list[Frame]:
        """Subscribed telemetry among frames (all when None)."""
        of = self.frames if frames is None else frames
        return [frame for frame in of if frame.type == client.ASYNCHRONOUS and frame.id == id_]

    def to_loader(self) -> Bench:
        """Past the boot after power-on."""
        self.run(self.emulator.profile.timing.boot_ms + 5)
        return self

    def boot(self) -> Bench:
        """From power-on to the program, at rest on the line."""
        self.to_loader()
        assert self.status(client.ACTION, client.BOOT, b"\x01") == 0
        self.run(self.emulator.profile.timing.boot_ms + 5)
        return self

    def set_time(self) -> None:
        """The true time of the scenario, as a driver that counts the octets would."""
        arrival_ns = self.now_ns + line_ns(200)
        octets = self._set_time_octets(arrival_ns)
        arrival_ns = self.now_ns + line_ns(len(octets))
        octets = self._set_time_octets(arrival_ns)
        self.put(octets)
        self.run(2 * self.emulator.profile.timing.frame_period_ms)

    @staticmethod
    def _set_time_octets(arrival_ns: int) -> bytes:
        unix_us = START_UNIX_US + round(arrival_ns / 1000)
        return client.request(client.ACTION, client.SET_TIME, unix_us.to_bytes(8, "little"))


def make(name: str = "roja1", scenario: Scenario | None = None, **settings: Any) -> Bench:
    """A bench with the power just on."""
    return Bench(unit(name, **settings), scenario)


def at_rest(**settings: Any) -> Bench:
    """A unit whose program runs and looks at no frames: it costs no time."""
    return make(autonomous=False, **settings).boot()
