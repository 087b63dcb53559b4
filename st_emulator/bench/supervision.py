"""What stands beside a unit: its true mode and attitude, its faults, its power. Never part of its wire.

Tests look and reach into a unit by it, in the same process or over a descriptor
(``drivers/supervisor_socket.py``): so what goes in and comes out are numbers, texts, lists and dictionaries
alone.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from ..device.imaging import FrameRecord
from ..errors import ConfigurationError
from ..firmware_model.modes import Mode
from ..world import quaternion
from .emulator import Emulator

KEPT_FRAMES = 4096  # the truth of seventeen minutes at 4 Hz can be asked for


class FrameTimes:
    """When the processed frames were exposed; give :meth:`completed` to the emulator as ``on_completed``."""

    def __init__(self) -> None:
        self._middle_ns: OrderedDict[int, int] = OrderedDict()

    def completed(self, record: FrameRecord) -> None:
        """A frame's result counts from now on."""
        self._middle_ns[record.index] = record.mid_exposure_ns
        self._middle_ns.move_to_end(record.index)
        if len(self._middle_ns) > KEPT_FRAMES:
            self._middle_ns.popitem(last=False)

    def middle_ns(self, frame_index: int) -> int:
        """Virtual time of the middle of the exposure.

        Raises:
            ConfigurationError: the unit has not processed such a frame, or that is long ago.
        """
        if frame_index not in self._middle_ns:
            last = next(reversed(self._middle_ns), None)
            there = "it has processed none" if last is None else f"the last was {last}"
            raise ConfigurationError(f"frame {frame_index}: is none that the unit has processed; {there}")
        return self._middle_ns[frame_index]


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

    def power_on(self) -> None:
        """Let power come on."""

    def power_off(self) -> None:
        """Cut the power."""

    def flush(self) -> None:
        """Write out what its journal holds back."""


class Supervision:
    """A unit in this process."""

    def __init__(self, emulator: Emulator, times: FrameTimes) -> None:
        self.emulator = emulator
        self._times = times

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
        at_ns = self.emulator.now_ns if frame_index is None else self._times.middle_ns(frame_index)
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
            | {"kind": one.settings.kind}
            for one in self.emulator.faults.active()
        ]

    def power_on(self) -> None:
        """Let power come on."""
        self.emulator.power(True)

    def power_off(self) -> None:
        """Cut the power: what waits is lost, nothing is told."""
        self.emulator.power(False)

    def flush(self) -> None:
        """Write out what its journal holds back."""
        self.emulator.flush()


def answers_of(unit: Supervised) -> dict[str, Callable[..., Any]]:
    """What can be asked over a descriptor: by name, with the arguments by name."""
    return {
        "now_ns": unit.now_ns,
        "mode": unit.mode,
        "truth": unit.truth,
        "inject": unit.inject,
        "clear": unit.clear,
        "active": unit.active,
        "power_on": unit.power_on,
        "power_off": unit.power_off,
        "flush": unit.flush,
    }
