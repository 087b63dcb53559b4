"""A demo without a screen: what an exchange does, says and checks."""

from __future__ import annotations

from st_emulator.bench.emulator import Emulator
from st_emulator.units.profile import UnitProfile


class Session:
    """A :class:`~st_emulator.dialects.dialect.DemoSession` with a fresh unit; ``checks``: (name, holds).
    ``deaf``: nothing reaches the unit."""

    def __init__(self, profile: UnitProfile, *, deaf: bool = False) -> None:
        self._deaf = deaf
        self.said: list[str] = []
        self.checks: list[tuple[str, bool]] = []
        self._sent: list[tuple[int, bytes]] = []
        self._emulator = Emulator(profile, transmit=lambda data, t_ns: self._sent.append((t_ns, data)))

    @property
    def profile(self) -> UnitProfile:
        return self._emulator.profile

    @property
    def now_ns(self) -> int:
        return self._emulator.now_ns

    def put(self, data: bytes) -> None:
        if not self._deaf:
            self._emulator.receive(data)

    def run(self, ms: float) -> list[tuple[int, bytes]]:
        self._emulator.advance(self.now_ns + round(ms * 1_000_000))
        sent, self._sent = self._sent, []
        return sent

    def true_quaternion(self, t_ns: int) -> tuple[float, float, float, float]:
        assert self._emulator.scene is not None
        x, y, z, w = self._emulator.scene.trajectory.q_icrs_to_sensor(t_ns)
        return (float(x), float(y), float(z), float(w))

    def say(self, text: str) -> None:
        self.said.append(text)

    def check(self, name: str, value: float, relation: str, target: float, unit: str) -> None:
        holds = {"==": value == target, "<=": value <= target, ">=": value >= target}[relation]
        self.checks.append((name, holds))
