"""A sequence of manoeuvres: holds, slews to a pointing, turns at a rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import quaternion
from .trajectory import Instants

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Hold:
    """Stay at rest for duration_s."""

    duration_s: float


@dataclass(frozen=True)
class SlewTo:
    """Turn to a pointing (degrees; roll as everywhere) about the one axis of the shortest rotation, rest to
    rest.

    The rate follows a versine: rate = (angle / duration) (1 - cos(2 pi t / duration)), so rate and
    acceleration are continuous; its peak is twice the mean.
    """

    ra_deg: float
    dec_deg: float
    roll_deg: float
    duration_s: float


@dataclass(frozen=True)
class RateAxis:
    """Turn about a fixed axis of the sensor at rate_deg_s (sensor axes x, y, z, deg/s) for duration_s.

    The rate grows from zero within the first ramp_s and falls to zero within the last ramp_s, each as half a
    versine; ramp_s = 0 steps it.
    """

    rate_deg_s: Sequence[float]
    duration_s: float
    ramp_s: float = 0.5


Segment = Hold | SlewTo | RateAxis


@dataclass(frozen=True)
class _Leg:
    """One segment made ready: the angle turned about a fixed axis as a function of the time since its
    start."""

    start_ns: int
    duration_ns: int
    q_start: Array
    axis: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    angle_rad: float = 0.0  # versine: the angle of the whole leg
    rate_rad_s: float = 0.0  # trapezoid: the rate of the flat part
    ramp_s: float = 0.0

    def turned(self, elapsed_s: Array) -> tuple[Array, Array]:
        """(angle in rad, rate in rad/s) after elapsed_s."""
        duration = self.duration_ns * 1e-9
        t = np.clip(elapsed_s, 0.0, duration)
        if self.angle_rad:
            phase = 2.0 * np.pi * t / duration
            return (
                self.angle_rad * (t / duration - np.sin(phase) / (2.0 * np.pi)),
                self.angle_rad / duration * (1.0 - np.cos(phase)),
            )
        ramp = self.ramp_s
        if ramp == 0.0:
            return self.rate_rad_s * t, np.full_like(t, self.rate_rad_s)
        up, down = np.minimum(t, ramp), np.maximum(t - (duration - ramp), 0.0)
        # half a versine up: integral of (1 - cos(pi s / ramp)) / 2; down: what is missing to the full rate
        gained = 0.5 * (up - ramp / np.pi * np.sin(np.pi * up / ramp))
        lost = 0.5 * (down - ramp / np.pi * np.sin(np.pi * down / ramp))
        flat = np.clip(t - ramp, 0.0, None)
        shape = 0.5 * (1.0 - np.cos(np.pi * up / ramp)) - 0.5 * (1.0 - np.cos(np.pi * down / ramp))
        return self.rate_rad_s * (gained + flat - lost), self.rate_rad_s * shape


class SlewTrajectory:
    """Segments one after another from start_ns; at rest at the start attitude before, at the last one
    after."""

    def __init__(self, q_start: ArrayLike, segments: Sequence[Segment], start_ns: int = 0) -> None:
        q = quaternion.canonical(q_start)
        at_ns = int(start_ns)
        legs: list[_Leg] = []
        for number, segment in enumerate(segments, start=1):
            leg = _make_leg(segment, at_ns, q, f"segment {number} ({type(segment).__name__})")
            legs.append(leg)
            at_ns += leg.duration_ns
            angle, _ = leg.turned(np.asarray(leg.duration_ns * 1e-9))
            q = quaternion.canonical(
                quaternion.multiply(quaternion.from_rotation_vector(angle * leg.axis), leg.q_start)
            )
        # the rest after the last segment; a leg of no duration never turns
        legs.append(_Leg(at_ns, 0, q))
        self._legs = legs
        self._starts = np.array([leg.start_ns for leg in legs], dtype=np.int64)

    @property
    def end_ns(self) -> int:
        """When the last segment ends."""
        return int(self._starts[-1])

    def _evaluate(self, t_ns: Instants) -> tuple[Array, Array]:
        instants = np.atleast_1d(np.asarray(t_ns, dtype=np.int64))
        which = np.maximum(np.searchsorted(self._starts, instants, side="right") - 1, 0)
        q = np.empty((instants.shape[0], 4))
        rate = np.zeros((instants.shape[0], 3))
        for number in np.unique(which):
            leg, chosen = self._legs[number], which == number
            elapsed_ns = instants[chosen] - leg.start_ns
            angle, speed = leg.turned(elapsed_ns * 1e-9) if leg.duration_ns else (np.zeros(1), np.zeros(1))
            speed = np.where(elapsed_ns >= 0, speed, 0.0)
            turned = quaternion.from_rotation_vector(angle[:, np.newaxis] * leg.axis)
            q[chosen] = quaternion.canonical(quaternion.multiply(turned, leg.q_start))
            rate[chosen] = speed[:, np.newaxis] * leg.axis
        return q, rate

    def q_icrs_to_sensor(self, t_ns: Instants) -> Array:
        q, _ = self._evaluate(t_ns)
        return q if np.ndim(t_ns) else q[0]

    def rate_sensor(self, t_ns: Instants) -> Array:
        _, rate = self._evaluate(t_ns)
        return rate if np.ndim(t_ns) else rate[0]

    def position_km(self, t_ns: Instants) -> Array | None:
        return None

    def velocity_km_s(self, t_ns: Instants) -> Array | None:
        return None


def _make_leg(segment: Segment, start_ns: int, q_start: Array, name: str) -> _Leg:
    if not (np.isfinite(segment.duration_s) and segment.duration_s > 0.0):
        raise ValueError(f"{name}: duration_s is {segment.duration_s}; it has to be positive")
    duration_ns = round(segment.duration_s * 1e9)
    if isinstance(segment, Hold):
        return _Leg(start_ns, duration_ns, q_start)
    if isinstance(segment, SlewTo):
        target = quaternion.quaternion_from_pointing(segment.ra_deg, segment.dec_deg, segment.roll_deg)
        rotation = quaternion.to_rotation_vector(quaternion.multiply(target, quaternion.conjugate(q_start)))
        angle = float(np.linalg.norm(rotation))
        if angle == 0.0:
            return _Leg(start_ns, duration_ns, q_start)
        return _Leg(start_ns, duration_ns, q_start, axis=rotation / angle, angle_rad=angle)
    rate = np.radians(np.array(segment.rate_deg_s, dtype=np.float64))
    if rate.shape != (3,) or not np.all(np.isfinite(rate)):
        raise ValueError(f"{name}: rate_deg_s has to be three finite numbers, not {segment.rate_deg_s!r}")
    if not 0.0 <= segment.ramp_s <= segment.duration_s / 2.0:
        raise ValueError(f"{name}: ramp_s is {segment.ramp_s}; allowed is 0 to half of duration_s")
    speed = float(np.linalg.norm(rate))
    if speed == 0.0:
        return _Leg(start_ns, duration_ns, q_start)
    return _Leg(
        start_ns, duration_ns, q_start, axis=rate / speed, rate_rad_s=speed, ramp_s=float(segment.ramp_s)
    )


def slew(
    *,
    ra_deg: float,
    dec_deg: float,
    roll_deg: float = 0.0,
    segments: Sequence[Segment],
    start_ns: int = 0,
) -> SlewTrajectory:
    """From a pointing (held until start_ns), through the segments, to rest. Raises ValueError naming a bad
    segment."""
    return SlewTrajectory(quaternion.quaternion_from_pointing(ra_deg, dec_deg, roll_deg), segments, start_ns)
