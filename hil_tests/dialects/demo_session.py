"""A demo without a screen: what an exchange does, says and checks."""

from __future__ import annotations

from typing import Any

from st_emulator.bench.emulator import Emulator
from st_emulator.units.profile import UnitProfile


class Session:
    """A :class:`~st_emulator.dialects.dialect.DemoSession` with a fresh unit; ``checks``: by name, whether
    each always held.

    Args:
        profile: the unit.
        deaf: nothing reaches the unit.
        turned: the truth is told with its parts in another order.
        arguments: further ones of :class:`~st_emulator.bench.emulator.Emulator`.
    """

    def __init__(
        self, profile: UnitProfile, *, deaf: bool = False, turned: bool = False, **arguments: Any
    ) -> None:
        self._deaf = deaf
        self._turned = turned
        self.said: list[str] = []
        self.checks: dict[str, bool] = {}
        self._sent: list[tuple[int, bytes]] = []
        self.emulator = Emulator(
            profile, transmit=lambda data, t_ns: self._sent.append((t_ns, data)), **arguments
        )

    @property
    def profile(self) -> UnitProfile:
        return self.emulator.profile

    @property
    def now_ns(self) -> int:
        return self.emulator.now_ns

    def put(self, data: bytes) -> None:
        if not self._deaf:
            self.emulator.receive(data)

    def run(self, ms: float) -> list[tuple[int, bytes]]:
        self.emulator.advance(self.now_ns + round(ms * 1_000_000))
        sent, self._sent = self._sent, []
        return sent

    def true_quaternion(self, t_ns: int) -> tuple[float, float, float, float]:
        assert self.emulator.scene is not None
        x, y, z, w = (float(part) for part in self.emulator.scene.trajectory.q_icrs_to_sensor(t_ns))
        return (w, x, y, z) if self._turned else (x, y, z, w)

    def say(self, text: str) -> None:
        self.said.append(text)

    def check(self, name: str, value: float, relation: str, target: float, unit: str) -> None:
        holds = {"==": value == target, "<=": value <= target, ">=": value >= target}[relation]
        self.checks[name] = self.checks.get(name, True) and holds
