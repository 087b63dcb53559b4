"""The unit that a test talks to: the same on whatever link and in whatever time it is."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..bench.supervision import Supervised
from .errors import leave_out

if TYPE_CHECKING:
    from ..links import Link
    from ..obc import Attitude, Obc
    from ..units.profile import UnitProfile
    from .expectations import Expectations

ARCSEC_PER_RAD = 180 * 3600 / math.pi


@dataclass(frozen=True)
class Truth:
    """What is true of a unit at one time: ``time_ns`` virtual, from its power-on; ``q_icrs_to_sensor``
    (x, y, z, w), v_sensor = A(q) v_icrs; ``rate_rad_s`` relative to ICRS in sensor axes; the same attitude as
    right ascension, declination and roll.
    """

    time_ns: int
    q_icrs_to_sensor: tuple[float, float, float, float]
    rate_rad_s: tuple[float, float, float]
    ra_deg: float
    dec_deg: float
    roll_deg: float

    def error_arcsec(self, measured: Sequence[float] | Mapping[str, Any] | Attitude) -> float:
        """The angle between this attitude and a measured one: a quaternion (x, y, z, w), the fields of an
        attitude report, or an :class:`~st_emulator.obc.attitude.Attitude`.
        """
        if isinstance(measured, Mapping):
            parts = [float(measured[f"q_{axis}"]) for axis in "xyzw"]
        else:
            quaternion: Any = getattr(measured, "q_icrs_to_sensor", measured)
            parts = [float(part) for part in quaternion]
        x, y, z, w = parts
        a, b, c, d = self.q_icrs_to_sensor
        # The vector part of the quaternion between them: exact where they are close, unlike their product.
        between = (
            d * x - a * w - b * z + c * y,
            d * y - b * w - c * x + a * z,
            d * z - c * w - a * y + b * x,
        )
        product = a * x + b * y + c * z + d * w
        return 2 * math.atan2(math.hypot(*between), abs(product)) * ARCSEC_PER_RAD


class UnitFaults:
    """Faults of a unit, live. See ``st-emulator faults`` for those that there are."""

    def __init__(self, supervised: Supervised) -> None:
        self._supervised = supervised

    def inject(self, kind: str | Mapping[str, Any], **settings: Any) -> int:
        """Let a fault begin now, or when its ``start_s`` (from power-on) says: by its kind and settings, as a
        table of a scenario's ``[[faults]]``. Its number.
        """
        fault = dict(kind) if isinstance(kind, Mapping) else {"kind": kind}
        return self._supervised.inject(fault | settings)

    def clear(self, number: int | None = None) -> None:
        """End a fault; None: all that act."""
        numbers = [fault["number"] for fault in self.active()] if number is None else [number]
        for one in numbers:
            self._supervised.clear(one)

    def active(self) -> list[dict[str, Any]]:
        """The faults that act now: number, kind, settings."""
        return list(self._supervised.active())


class StarTracker(ABC):
    """A unit under test.

    ``name``: of the unit's file. ``profile``: the unit's figures. ``link``: where an OBC finds it, as
    ``--link`` of ``st-emulator obc`` takes it (in memory: nothing a program could open). ``node``: on a CAN
    bus. ``journal``: the file of its raw bytes; None: nobody keeps one.
    """

    supervised: Supervised

    def __init__(self, profile: UnitProfile, link: str, node: int | None, bench: Expectations) -> None:
        self.name = profile.name
        self.profile = profile
        self.link = link
        self.node = node
        self.journal: Path | None = None
        self._bench = bench
        self._obc: Obc | None = None
        self._line: Link | None = None

    @property
    def device(self) -> str:
        """What a program of an OBC opens: the path of the pseudo-terminal or serial port, the name of the CAN
        interface.
        """
        return self.link.partition(":")[2].rpartition("/")[2] if self.on_can else self.link.partition(":")[2]

    @property
    def on_can(self) -> bool:
        """Whether it is on a CAN bus."""
        return self.link.startswith("can:") or self.link.startswith("memory:can")

    @property
    def mode(self) -> str:
        """The name of its mode, such as TRACKING."""
        return self.supervised.mode()

    def truth(self, frame_index: int | None = None) -> Truth:
        """What is true of the unit now, or at the middle of the exposure of a frame that it has processed."""
        found = self.supervised.truth(frame_index)
        x, y, z, w = found["q_icrs_to_sensor"]
        a, b, c = found["rate_rad_s"]
        return Truth(
            found["time_ns"], (x, y, z, w), (a, b, c), found["ra_deg"], found["dec_deg"], found["roll_deg"]
        )

    @property
    def faults(self) -> UnitFaults:
        """Its faults: inject, clear, active."""
        return UnitFaults(self.supervised)

    def run(self, seconds: float) -> None:
        """Let so much time pass, for it and all that is on its bench."""
        self._bench.run(seconds)

    def power_on(self) -> None:
        """Let power come on; it boots."""
        self.supervised.power(True)

    def power_off(self) -> None:
        """Cut the power: it falls silent at once."""
        self.supervised.power(False)

    @property
    def obc(self) -> Obc:
        """An OBC (:class:`st_emulator.obc.Obc`) on the other end of its link, made when first asked for."""
        if self._obc is None:
            if self.profile.wire.dialect != "pus":
                raise TypeError(
                    f"unit {self.name} speaks {self.profile.wire.dialect}: the OBC simulator speaks pus "
                    "alone; use star_tracker.line for raw octets, or an OBC of your own"
                )
            if self._line is not None:
                raise TypeError(f"unit {self.name}: its line is in use; either .line or .obc, not both")
            self._obc = self._make_obc()
        return self._obc

    @property
    def joined(self) -> Obc | None:
        """The OBC, if one has been asked for."""
        return self._obc

    @property
    def line(self) -> Link:
        """The other end of its link, for octets (records of frames on a CAN bus) of your own: ``write`` them,
        let time ``run``, ``read`` what has come.
        """
        if self._line is None:
            if self._obc is not None:
                raise TypeError(f"unit {self.name}: its OBC has the line; either .line or .obc, not both")
            self._line = self._make_line()
        return self._line

    def boot(self) -> None:
        """Let time go on until it has booted, or what its faults let of that."""
        limit_s = 2 * self.profile.timing.boot_ms / 1000 + 1
        self._bench.run_until(lambda: self.mode != "BOOT", limit_s)

    @abstractmethod
    def _make_obc(self) -> Obc: ...

    @abstractmethod
    def _make_line(self) -> Link: ...

    def close(self) -> None:
        """Nothing of it is left afterwards."""
        if self._obc is not None:
            self._obc.close()
        if self._line is not None:
            self._line.close()


class _NotThere:
    """Who supervises a unit of hardware: nobody, and a test that asks is left out."""

    def now_ns(self) -> int:
        leave_out("a look inside")

    def mode(self) -> str:
        leave_out("a look inside")

    def truth(self, frame_index: int | None) -> dict[str, Any]:
        leave_out("a truth")

    def inject(self, fault: Mapping[str, Any]) -> int:
        leave_out("a fault")

    def clear(self, number: int) -> None:
        leave_out("a fault")

    def active(self) -> list[Any]:
        leave_out("a fault")

    def power(self, on: bool) -> None:
        leave_out("a power switch")

    def flush(self) -> None:
        """Nothing is held back."""


class PresentStarTracker(StarTracker):
    """A unit that is there already: hardware, or one that somebody else runs. Its telemetry tells its mode.

    ``recording``: a folder that its OBC records into; None: it does not.
    """

    def __init__(
        self, profile: UnitProfile, link: str, node: int | None, bench: Expectations, recording: Path | None
    ) -> None:
        super().__init__(profile, link, node, bench)
        self.supervised = _NotThere()
        self._unit = profile.origin or profile.name
        self._recording = recording

    @property
    def mode(self) -> str:
        """As its telemetry tells; without an OBC of ours nobody hears that."""
        if self._obc is None:
            return self.supervised.mode()
        return self._obc.mode().name if self._obc.unit.mode is None else self._obc.unit.mode.name

    def boot(self) -> None:
        """Bring it to where a unit is that has just booted: by a reset."""
        self.obc.reset("COLD")

    def _make_obc(self) -> Obc:
        from ..obc import Obc

        self.journal = self._recording
        return Obc.connect(self.link, unit=self._unit, node=self.node, record=self._recording)

    def _make_line(self) -> Link:
        from ..links import open_link

        return open_link(self.link, "obc", self.profile.wire.baud, self.name, self.profile.can.bitrate)
