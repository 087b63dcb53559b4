"""A unit that speaks nos3, in virtual time, and what it has sent."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hil_tests.dialects.nos3 import client
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.scenario import InertialTrajectory, Scenario, Sky
from st_emulator.units.profile import UnitProfile, load_unit

MS = 1_000_000
BYTE_NS = 10 * 1_000_000_000 / 115200
NO_ABERRATION = Sky(aberration=False)


def unit(name: str = "roja1", *, timing: dict[str, Any] | None = None, **settings: Any) -> UnitProfile:
    """A shipped unit with the dialect, its settings and figures of its timing."""
    profile = load_unit(name)
    return profile.model_copy(
        update={
            "wire": profile.wire.model_copy(update={"dialect": "nos3"}),
            "dialects": {"nos3": settings},
            "timing": profile.timing.model_copy(update=timing or {}),
        }
    )


@dataclass
class Bench:
    emulator: Emulator
    layout: str = "code"
    groups: list[tuple[int, bytes]] = field(default_factory=list)

    @property
    def now_ns(self) -> int:
        return self.emulator.now_ns

    @property
    def sent(self) -> bytes:
        return b"".join(group for _, group in self.groups)

    def run(self, ms: float) -> None:
        self.emulator.advance(self.now_ns + round(ms * MS))

    def run_to(self, ms: float) -> None:
        self.emulator.advance(round(ms * MS))

    def put(self, *pieces: bytes) -> None:
        for piece in pieces:
            self.emulator.receive(piece)

    def boot(self) -> Bench:
        self.run(self.emulator.profile.timing.boot_ms + 1)
        return self

    def take(self) -> bytes:
        """What has been sent since the last call."""
        sent = self.sent
        self.groups.clear()
        return sent

    def ask(self, name: str, payload: int = 0, *, wait_ms: float = 20) -> dict[str, int] | None:
        """One command on a quiet line; its reply, after its echo, and nothing else."""
        assert self.take() == b""
        command = client.command(name, payload, self.layout)
        self.put(command)
        self.run(wait_ms)
        decoder = client.Decoder(self.layout, bytearray(self.take()))
        (answer,) = decoder.answers([(name, command)])
        assert not decoder.octets
        return answer.reply

    def count(self) -> int:
        reply = self.ask("housekeeping")
        assert reply is not None
        return reply["count"]

    def data(self) -> dict[str, int]:
        reply = self.ask("data")
        assert reply is not None
        return reply

    def until_valid(self, within_ms: float = 4000) -> dict[str, int]:
        """Ask for data until they are valid."""
        end_ns = self.now_ns + within_ms * MS
        while True:
            data = self.data()
            if data["valid"]:
                return data
            assert self.now_ns < end_ns, "no attitude"
            self.run(30)

    def truth(self, t_ns: int | None = None) -> np.ndarray:
        """q_icrs_to_sensor (x, y, z, w) of the scene."""
        scene = self.emulator.scene
        assert scene is not None
        return np.asarray(scene.trajectory.q_icrs_to_sensor(self.now_ns if t_ns is None else t_ns))


def make(profile: UnitProfile | None = None, **arguments: Any) -> Bench:
    profile = profile or unit()
    layout = profile.dialects["nos3"].get("layout", "code")
    groups: list[tuple[int, bytes]] = []
    emulator = Emulator(profile, transmit=lambda data, t_ns: groups.append((t_ns, data)), **arguments)
    return Bench(emulator, layout, groups)


def idle(**settings: Any) -> Bench:
    """A unit past its boot that looks for no attitude: its frames cost nothing."""
    return make(unit(autonomous=False, **settings)).boot()


def sky(ra_deg: float = 83.0, dec_deg: float = -3.0, **arguments: Any) -> Scenario:
    """At rest, without aberration: the wire has no time to correct it by."""
    return Scenario(
        trajectory=InertialTrajectory(ra_deg=ra_deg, dec_deg=dec_deg, roll_deg=17.0),
        sky=NO_ABERRATION,
        **arguments,
    )


def cut(octets: bytes, cuts: Iterable[int]) -> list[bytes]:
    """``octets`` cut before each offset of ``cuts``."""
    places = [0, *sorted(cuts), len(octets)]
    return [octets[start:end] for start, end in itertools.pairwise(places)]
