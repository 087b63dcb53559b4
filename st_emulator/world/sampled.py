"""A trajectory given by samples: truth that somebody else owns (an outside simulator, a file).

Samples come in the order of time; asked for an instant before the first or beyond the last one it raises
`BeyondTruthError` instead of a guess. What lies between two samples depends on these two alone, so it does
not matter when a later one is given:

- attitude, with rates at both ends: ``q(s) = exp(phi(s)) q_0``, where the rotation vector ``phi`` is the
  cubic of Hermite that meets the attitude and the rate at both ends (its end slopes follow from the rates by
  the inverse of the rotation vector's kinematics; Shuster, "A Survey of Attitude Representations",
  J. Astronaut. Sci. 41 (1993), section on the rotation vector). The rate is the exact derivative of this
  attitude. The error falls with the fourth power of the step;
- attitude without rates: a turn at a constant rate by the shortest way (slerp), whose rate it then is;
- position with velocity: the cubic of Hermite in each axis; without: a straight line and its slope. Velocity
  without position: a straight line;
- direction of the Sun: a turn at a constant rate by the shortest way.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import quaternion
from .trajectory import Instants

Array = NDArray[np.float64]
Vector = tuple[float, float, float]

DIRECTIONS = ("q_icrs_to_sensor", "sun_direction")
_SMALL_RAD = 1e-4
_LONGEST_TURN_RAD = math.pi


class BeyondTruthError(Exception):
    """The truth is asked for an instant that no samples enclose.

    ``asked_ns``: the instant; ``first_ns``, ``last_ns``: of the samples, None where there are none.
    """

    def __init__(self, asked_ns: int, first_ns: int | None, last_ns: int | None, why: str = "") -> None:
        self.asked_ns, self.first_ns, self.last_ns = asked_ns, first_ns, last_ns
        known = (
            "no sample is given yet"
            if first_ns is None or last_ns is None
            else f"samples reach from {first_ns * 1e-9:.9g} s to {last_ns * 1e-9:.9g} s"
        )
        super().__init__(
            f"the true attitude is not known at {asked_ns * 1e-9:.9g} s{why}: {known}; between samples it is "
            "interpolated, beyond them nothing is guessed"
        )


@dataclass(frozen=True)
class TruthSample:
    """What is true at one instant.

    t_ns: virtual time, negative before power-on. q_icrs_to_sensor: attitude [x, y, z, w], of any length and
    sign. rate_rad_s: of the sensor relative to ICRS, sensor axes. position_km, velocity_km_s: geocentric,
    ICRS axes. sun_direction: from the observer to the Sun, ICRS axes, of any length; it takes the place of
    the ephemeris's.
    """

    t_ns: int
    q_icrs_to_sensor: tuple[float, float, float, float]
    rate_rad_s: Vector | None = None
    position_km: Vector | None = None
    velocity_km_s: Vector | None = None
    sun_direction: Vector | None = None

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> TruthSample:
        """Of a table with these names (a journal's line, a message). Raises ValueError naming what is
        wrong."""
        names = [item.name for item in fields(cls)]
        if not isinstance(values, Mapping):
            raise ValueError(f"found {values!r:.60}; allowed is a table with {', '.join(names)}")
        for name in values:
            if name not in names:
                raise ValueError(f"{name}: is not a known item; allowed are {', '.join(names)}")
        if "t_ns" not in values or "q_icrs_to_sensor" not in values:
            raise ValueError("t_ns and q_icrs_to_sensor: are needed in each sample")
        return cls(**values)

    def __post_init__(self) -> None:
        """Raises ValueError for values that are no sample. Sequences and arrays become tuples."""
        if not isinstance(self.t_ns, int) or isinstance(self.t_ns, bool) or not abs(self.t_ns) < 2**63:
            raise ValueError(f"t_ns: found {self.t_ns!r:.60}; allowed is a whole number of nanoseconds")
        for item in fields(self)[1:]:
            value = getattr(self, item.name)
            if value is None and item.name != "q_icrs_to_sensor":
                continue
            vector = _numbers(item.name, value, 4 if item.name == "q_icrs_to_sensor" else 3)
            if item.name in DIRECTIONS and not 1e-100 < math.hypot(*vector) < 1e100:
                raise ValueError(f"{item.name}: found {list(vector)}; allowed are numbers not all zero")
            object.__setattr__(self, item.name, vector)

    def as_dict(self) -> dict[str, Any]:
        """What is given of it, with numbers and lists alone."""
        given = {item.name: getattr(self, item.name) for item in fields(self)}
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in given.items()
            if value is not None
        }


def _numbers(name: str, value: Any, count: int) -> Any:
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple) and len(value) == count:
        plain = [float(item) for item in value if isinstance(item, int | float | np.floating)]
        if len(plain) == count and all(math.isfinite(item) for item in plain):
            return tuple(plain)
    raise ValueError(f"{name}: found {value!r:.60}; allowed are {count} finite numbers")


@dataclass(frozen=True)
class _Interval:
    """Two neighbouring samples, ready to be interpolated; ``q_end`` etc. hold at ``start_ns + length_ns``."""

    start_ns: int
    length_ns: int
    first: TruthSample
    last: TruthSample


class SampledTrajectory:
    """Truth by samples, see the module. All samples give the same items as the first one.

    Who watches it says from when on samples are still needed; without a watcher it keeps every sample until
    `forget_before` lets the old ones go.
    """

    def __init__(self, samples: Iterable[TruthSample] = ()) -> None:
        self._times: list[int] = []
        self._samples: list[TruthSample] = []
        self._watchers: list[tuple[Callable[[TruthSample], None], Callable[[], int]]] = []
        self._forgot = False
        for sample in samples:
            self.add(sample)

    # -- giving it

    def add(self, sample: TruthSample) -> None:
        """The next sample. Raises ValueError for one that is not later than the last, gives other items than
        the first, or lies too far from the last to say which way it turned.
        """
        if self._samples:
            self._require_next(self._samples[-1], sample)
        self._times.append(sample.t_ns)
        self._samples.append(sample)
        for on_sample, _ in self._watchers:
            on_sample(sample)
        if self._watchers:
            self.forget_before(min(needed_from_ns() for _, needed_from_ns in self._watchers))

    def set_attitude(
        self,
        t_ns: int,
        q_icrs_to_sensor: Any,
        rate_rad_s: Any = None,
        *,
        position_km: Any = None,
        velocity_km_s: Any = None,
        sun_direction: Any = None,
    ) -> None:
        """`add` a sample of these values (sequences or arrays)."""
        self.add(TruthSample(t_ns, q_icrs_to_sensor, rate_rad_s, position_km, velocity_km_s, sun_direction))

    @staticmethod
    def _require_next(before: TruthSample, sample: TruthSample) -> None:
        if sample.t_ns <= before.t_ns:
            raise ValueError(
                f"t_ns: found {sample.t_ns}; allowed are times after that of the sample before, {before.t_ns}"
            )
        items, expected = set(sample.as_dict()), set(before.as_dict())
        if items != expected:
            raise ValueError(
                f"the sample at {sample.t_ns} ns gives {', '.join(sorted(items))}; allowed are the items of "
                f"the samples before: {', '.join(sorted(expected))}"
            )
        if sample.rate_rad_s is not None and before.rate_rad_s is not None:
            mean = 0.5 * (math.hypot(*sample.rate_rad_s) + math.hypot(*before.rate_rad_s))
            turn = mean * (sample.t_ns - before.t_ns) * 1e-9
            if turn >= _LONGEST_TURN_RAD:
                raise ValueError(
                    f"the samples at {before.t_ns} ns and {sample.t_ns} ns are {math.degrees(turn):.0f} deg "
                    "apart by their rates; allowed is under 180 deg: give samples more often"
                )

    def watch(self, on_sample: Callable[[TruthSample], None], needed_from_ns: Callable[[], int]) -> None:
        """Tell of each sample from now on, as it is given (a journal is made of it). What is older than all
        watchers need is forgotten.
        """
        self._watchers.append((on_sample, needed_from_ns))

    def forget_before(self, t_ns: int) -> None:
        """Let go of the samples that no instant from ``t_ns`` on needs."""
        unneeded = bisect_right(self._times, t_ns) - 1
        if unneeded > 0:
            del self._times[:unneeded], self._samples[:unneeded]
            self._forgot = True

    @property
    def samples(self) -> tuple[TruthSample, ...]:
        """Those that are kept, in the order of time."""
        return tuple(self._samples)

    @property
    def first_ns(self) -> int | None:
        return self._times[0] if self._times else None

    @property
    def last_ns(self) -> int | None:
        return self._times[-1] if self._times else None

    def require(self, from_ns: int, to_ns: int) -> None:
        """Raise `BeyondTruthError` where the truth from ``from_ns`` to ``to_ns`` is not all known."""
        if not self._times or from_ns < self._times[0]:
            raise BeyondTruthError(
                from_ns, self.first_ns, self.last_ns, " any more" if self._forgot and self._times else ""
            )
        if to_ns > self._times[-1]:
            raise BeyondTruthError(to_ns, self.first_ns, self.last_ns)

    # -- asking it

    def q_icrs_to_sensor(self, t_ns: Instants) -> Array:
        return self._evaluate(t_ns, 4, lambda interval, s: _attitude(interval, s)[0])

    def rate_sensor(self, t_ns: Instants) -> Array:
        return self._evaluate(t_ns, 3, lambda interval, s: _attitude(interval, s)[1])

    def position_km(self, t_ns: Instants) -> Array | None:
        if not self._gives("position_km", t_ns):
            return None
        return self._evaluate(t_ns, 3, lambda interval, s: _place(interval, s)[0])

    def velocity_km_s(self, t_ns: Instants) -> Array | None:
        if self._gives("position_km", t_ns):
            return self._evaluate(t_ns, 3, lambda interval, s: _place(interval, s)[1])
        if self._gives("velocity_km_s", t_ns):
            return self._evaluate(t_ns, 3, _velocity)
        return None

    def sun_direction(self, t_ns: Instants) -> Array | None:
        """Unit vector from the observer to the Sun, ICRS axes, float64[3] or [n, 3]; None where the samples
        do not give it."""
        if not self._gives("sun_direction", t_ns):
            return None
        return self._evaluate(t_ns, 3, _sun)

    def _gives(self, item: str, t_ns: Instants) -> bool:
        if not self._samples:
            raise BeyondTruthError(int(np.min(t_ns)), None, None)
        return getattr(self._samples[0], item) is not None

    def _evaluate(
        self, t_ns: Instants, width: int, interpolate: Callable[[_Interval, Array], Array]
    ) -> Array:
        instants = np.atleast_1d(np.asarray(t_ns, dtype=np.int64))
        earliest, latest = int(instants.min()), int(instants.max())
        self.require(earliest, latest)
        # the samples round the instants asked for, the last of them at or after the latest
        begin = bisect_right(self._times, earliest) - 1
        end = max(bisect_left(self._times, latest), begin)
        which = np.searchsorted(np.array(self._times[begin : end + 1]), instants, side="right") - 1
        which = np.minimum(which + begin, max(end - 1, begin))
        out = np.empty((instants.shape[0], width))
        for number in np.unique(which):
            chosen = which == number
            interval = self._interval(int(number))
            elapsed = instants[chosen] - interval.start_ns
            out[chosen] = interpolate(interval, elapsed / max(interval.length_ns, 1))
        return out if np.ndim(t_ns) else out[0]

    def _interval(self, number: int) -> _Interval:
        """From a sample to the next one; the last sample alone is an interval of no length."""
        first = self._samples[number]
        last = self._samples[min(number + 1, len(self._samples) - 1)]
        return _Interval(first.t_ns, last.t_ns - first.t_ns, first, last)


# -- between two samples; s: float64[n], 0 at the first, 1 at the last of them


def _attitude(interval: _Interval, s: Array) -> tuple[Array, Array]:
    """(attitudes [n, 4], rates [n, 3])."""
    q_0 = quaternion.canonical(interval.first.q_icrs_to_sensor)
    rate_0, rate_1 = interval.first.rate_rad_s, interval.last.rate_rad_s
    length_s = interval.length_ns * 1e-9
    if length_s == 0.0:
        rate = np.zeros(3) if rate_0 is None else np.array(rate_0)
        return np.tile(q_0, (len(s), 1)), np.tile(rate, (len(s), 1))
    turn = quaternion.to_rotation_vector(
        quaternion.multiply(interval.last.q_icrs_to_sensor, quaternion.conjugate(q_0))
    )
    s = s[:, np.newaxis]
    if rate_0 is None or rate_1 is None:
        rotation, slope = s * turn, np.broadcast_to(turn / length_s, (len(s), 3))
    else:
        start = np.array(rate_0) * length_s
        end = _slope_of(turn, np.array(rate_1)) * length_s
        rotation, slope = _hermite(np.zeros(3), turn, start, end, s)
        slope = slope / length_s
    attitudes = quaternion.canonical(quaternion.multiply(quaternion.from_rotation_vector(rotation), q_0))
    return attitudes, _rate_of(rotation, slope)


def _place(interval: _Interval, s: Array) -> tuple[Array, Array]:
    """(positions [n, 3], velocities [n, 3])."""
    p_0, p_1 = np.array(interval.first.position_km), np.array(interval.last.position_km)
    v_0, v_1 = interval.first.velocity_km_s, interval.last.velocity_km_s
    length_s = interval.length_ns * 1e-9
    if length_s == 0.0:
        velocity = np.zeros(3) if v_0 is None else np.array(v_0)
        return np.tile(p_0, (len(s), 1)), np.tile(velocity, (len(s), 1))
    s = s[:, np.newaxis]
    if v_0 is None or v_1 is None:
        return p_0 + s * (p_1 - p_0), np.tile((p_1 - p_0) / length_s, (len(s), 1))
    place, slope = _hermite(p_0, p_1, np.array(v_0) * length_s, np.array(v_1) * length_s, s)
    return place, slope / length_s


def _velocity(interval: _Interval, s: Array) -> Array:
    v_0, v_1 = np.array(interval.first.velocity_km_s), np.array(interval.last.velocity_km_s)
    return np.asarray(v_0 + s[:, np.newaxis] * (v_1 - v_0))


def _sun(interval: _Interval, s: Array) -> Array:
    a, b = (np.array(sample.sun_direction) for sample in (interval.first, interval.last))
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    angle = 2.0 * math.atan2(float(np.linalg.norm(a - b)), float(np.linalg.norm(a + b)))
    s = s[:, np.newaxis]
    if angle < _SMALL_RAD:
        direction = a + s * (b - a)
    else:
        direction = np.sin((1.0 - s) * angle) * a + np.sin(s * angle) * b
    return np.asarray(direction / np.linalg.norm(direction, axis=-1, keepdims=True))


def _hermite(p_0: Array, p_1: Array, m_0: Array, m_1: Array, s: Array) -> tuple[Array, Array]:
    """The cubic with values p and slopes m at 0 and 1, and its slope."""
    a, b = 2.0 * (p_0 - p_1) + m_0 + m_1, 3.0 * (p_1 - p_0) - 2.0 * m_0 - m_1
    return ((a * s + b) * s + m_0) * s + p_0, (3.0 * a * s + 2.0 * b) * s + m_0


def _rate_of(rotation: Array, slope: Array) -> Array:
    """Rate in the turned frame's axes of a rotation vector [n, 3] that changes by ``slope``.

    ``omega = phi' - (1 - cos a) / a^2 phi x phi' + (a - sin a) / a^3 phi x (phi x phi')`` with a = |phi|.
    """
    angle = np.linalg.norm(rotation, axis=-1, keepdims=True)
    safe = np.where(angle < _SMALL_RAD, 1.0, angle)
    first = np.where(angle < _SMALL_RAD, 0.5 - angle**2 / 24.0, (1.0 - np.cos(angle)) / safe**2)
    second = np.where(angle < _SMALL_RAD, 1.0 / 6.0 - angle**2 / 120.0, (angle - np.sin(angle)) / safe**3)
    across = np.cross(rotation, slope)
    return np.asarray(slope - first * across + second * np.cross(rotation, across))


def _slope_of(rotation: Array, rate: Array) -> Array:
    """The inverse of `_rate_of` for one rotation vector of under half a turn or so."""
    angle = float(np.linalg.norm(rotation))
    if angle < _SMALL_RAD:
        factor = 1.0 / 12.0 + angle**2 / 720.0
    else:
        factor = 1.0 / angle**2 - 1.0 / (2.0 * angle * math.tan(0.5 * angle))
    across = np.cross(rotation, rate)
    return np.asarray(rate + 0.5 * across + factor * np.cross(rotation, across))
