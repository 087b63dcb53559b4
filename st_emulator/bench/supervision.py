"""What stands beside a unit: its true mode and attitude, its faults, its power. Never part of its wire.

Tests and simulators look and reach into a unit by it, in the same process or over a socket
(``drivers/lockstep_requests.py``): so what goes in and comes out are numbers, texts, lists and dictionaries
alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from ..errors import ConfigurationError
from ..firmware_model.modes import Mode
from ..world import quaternion
from .emulator import Emulator


class Supervised(Protocol):
    """A unit as its supervisor sees it, wherever it runs. Times are virtual ns since it was made."""

    def now_ns(self) -> int:
        """How long it has lived."""

    def mode(self) -> str:
        """The name of its mode."""

    def truth(self, frame_index: int | None) -> dict[str, Any]:
        """Time, attitude and rate: of now, or of the middle of a frame's exposure."""

    def inject(self, fault: Mapping[str, Any]) -> int:
        """Let a fault begin, as a table of a scenario's ``[[faults]]`` says; its number."""

    def clear(self, number: int) -> None:
        """End a fault."""

    def active(self) -> list[dict[str, Any]]:
        """The faults that act now: number, kind and what differs from the defaults."""

    def power(self, on: bool) -> None:
        """Let power come on, or cut it."""

    def flush(self) -> None:
        """Write out what its journal holds back."""


class Supervision:
    """A unit in this process."""

    def __init__(self, emulator: Emulator) -> None:
        self.emulator = emulator

    def now_ns(self) -> int:
        """How long it has lived."""
        return self.emulator.now_ns

    def mode(self) -> str:
        """The name of its mode."""
        return Mode(self.emulator.device.mode).name

    def truth(self, frame_index: int | None) -> dict[str, Any]:
        """Time (virtual ns), attitude (x, y, z, w; pointing in degrees) and rate (rad/s, sensor axes).

        Raises:
            ConfigurationError: no such frame, or the unit looks at recorded frames, of which nobody knows.
        """
        if self.emulator.scene is None:
            raise ConfigurationError("truth: the unit looks at recorded frames; allowed is a rendered sky")
        at_ns = (
            self.emulator.now_ns if frame_index is None else self.emulator.frame_times.middle_ns(frame_index)
        )
        trajectory = self.emulator.scene.trajectory
        q = trajectory.q_icrs_to_sensor(at_ns)
        ra_deg, dec_deg, roll_deg = quaternion.pointing_from_quaternion(q)
        return {
            "time_ns": at_ns,
            "q_icrs_to_sensor": [float(part) for part in q],
            "rate_rad_s": [float(part) for part in trajectory.rate_sensor(at_ns)],
            "ra_deg": float(ra_deg),
            "dec_deg": float(dec_deg),
            "roll_deg": float(roll_deg),
        }

    def inject(self, fault: Mapping[str, Any]) -> int:
        """Let a fault begin; its number."""
        return int(self.emulator.faults.inject(fault))

    def clear(self, number: int) -> None:
        """End a fault."""
        self.emulator.faults.clear(number)

    def active(self) -> list[dict[str, Any]]:
        """The faults that act now."""
        return [
            {"number": one.number, **one.settings.model_dump(mode="json", exclude_defaults=True)}
            for one in self.emulator.faults.active()
        ]

    def power(self, on: bool) -> None:
        """Let power come on, or cut it: what waits is lost, nothing is told."""
        self.emulator.power(on)

    def flush(self) -> None:
        """Write out what its journal holds back."""
        self.emulator.flush()
