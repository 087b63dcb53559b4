"""Where the sensor looks and where it is, as pure functions of virtual time.

A trajectory answers for any instant, past or future, in any order: nothing is integrated step by step, so
results never depend on the step. Instants are integer nanoseconds of virtual time, one or an array of them;
arrays of n instants give arrays with n rows. Angles enter in degrees, rates in deg/s; ``rate_sensor`` answers
in rad/s.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import erfa
import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import quaternion, time_scales
from .quaternion import pointing_from_quaternion, quaternion_from_pointing

__all__ = [
    "EARTH_RATE_RAD_S",
    "ConstantRateTrajectory",
    "EarthFixedTrajectory",
    "InertialTrajectory",
    "Instants",
    "Trajectory",
    "TrajectoryWithSun",
    "constant_rate",
    "earth_fixed",
    "inertial",
    "pointing_from_quaternion",
    "quaternion_from_pointing",
]

Array = NDArray[np.float64]
Instants = int | NDArray[np.int64]

# The Earth rotation angle grows by 2 pi x 1.00273781191135448 a UT1 day (IAU 2000 resolution B1.8;
# IERS Conventions (2010), equation 5.15): 0.0041780746 deg/s.
EARTH_RATE_RAD_S = 2.0 * np.pi * 1.00273781191135448 / 86400.0


@runtime_checkable
class Trajectory(Protocol):
    """What the renderer asks of a trajectory."""

    def q_icrs_to_sensor(self, t_ns: Instants) -> Array:
        """Attitude, float64[4] or [n, 4], see `quaternion`."""
        ...

    def rate_sensor(self, t_ns: Instants) -> Array:
        """Angular rate of the sensor relative to ICRS in sensor axes, rad/s, float64[3] or [n, 3]."""
        ...

    def position_km(self, t_ns: Instants) -> Array | None:
        """Geocentric position, ICRS axes, km, float64[3] or [n, 3]; None where the trajectory knows none."""
        ...

    def velocity_km_s(self, t_ns: Instants) -> Array | None:
        """Geocentric velocity, ICRS axes, km/s; None where the trajectory knows none."""
        ...


@runtime_checkable
class TrajectoryWithSun(Trajectory, Protocol):
    """A trajectory that also says where the Sun is."""

    def sun_direction(self, t_ns: Instants) -> Array | None:
        """Unit vector from the observer to the Sun, ICRS axes, float64[3] or [n, 3]; None: the ephemeris
        knows."""
        ...


def seconds(t_ns: Instants) -> Array:
    """Instants as float seconds, float64[] or [n]."""
    return np.asarray(np.asarray(t_ns, dtype=np.float64) * 1e-9)


class ConstantRateTrajectory:
    """A start attitude turned at a rate that is constant in sensor axes (so about an axis fixed in ICRS,
    too)."""

    turns_evenly = True  # as `exposure_path` asks

    def __init__(
        self, q_start: ArrayLike, rate_rad_s: ArrayLike = (0.0, 0.0, 0.0), start_ns: int = 0
    ) -> None:
        """q_start: q_icrs_to_sensor at start_ns. rate_rad_s: of the sensor relative to ICRS, sensor axes."""
        self._q_start = quaternion.canonical(q_start)
        self._rate = _vector("rate", rate_rad_s)
        self._start_ns = int(start_ns)

    def q_icrs_to_sensor(self, t_ns: Instants) -> Array:
        elapsed = seconds(t_ns - self._start_ns)
        turned = quaternion.from_rotation_vector(elapsed[..., np.newaxis] * self._rate)
        return quaternion.canonical(quaternion.multiply(turned, self._q_start))

    def rate_sensor(self, t_ns: Instants) -> Array:
        return np.broadcast_to(self._rate, (*np.shape(t_ns), 3)).copy()

    def position_km(self, t_ns: Instants) -> Array | None:
        return None

    def velocity_km_s(self, t_ns: Instants) -> Array | None:
        return None


class InertialTrajectory(ConstantRateTrajectory):
    """At rest among the stars."""

    def __init__(self, q_icrs_to_sensor: ArrayLike) -> None:
        super().__init__(q_icrs_to_sensor)


class EarthFixedTrajectory(ConstantRateTrajectory):
    """At rest on the turning Earth.

    The sensor turns with the Earth's rotation angle about the celestial intermediate pole of the start date,
    which is held fixed (precession moves it by 0.05 arcsec a day). ASSUMED: a UT1 day is 86400 SI s (they
    differ by under 3 ms). With a site it also has a position and a velocity: diurnal aberration is up to 0.32
    arcsec.
    """

    def __init__(
        self,
        q_start: ArrayLike,
        pole_icrs: ArrayLike = (0.0, 0.0, 1.0),
        site_km: ArrayLike | None = None,
    ) -> None:
        """q_start: q_icrs_to_sensor at virtual time 0. site_km: geocentric position then, ICRS axes."""
        pole = _vector("pole", pole_icrs)
        pole = pole / np.linalg.norm(pole)
        super().__init__(q_start, EARTH_RATE_RAD_S * quaternion.rotate(q_start, pole))
        self._pole = pole
        self._site = None if site_km is None else _vector("site", site_km)

    def position_km(self, t_ns: Instants) -> Array | None:
        if self._site is None:
            return None
        angle = EARTH_RATE_RAD_S * seconds(t_ns)[..., np.newaxis]
        across = np.cross(self._pole, self._site)
        along = self._pole * (self._pole @ self._site)
        return np.asarray(along + np.cos(angle) * (self._site - along) + np.sin(angle) * across)

    def velocity_km_s(self, t_ns: Instants) -> Array | None:
        position = self.position_km(t_ns)
        return None if position is None else np.cross(EARTH_RATE_RAD_S * self._pole, position)


def inertial(*, ra_deg: float, dec_deg: float, roll_deg: float = 0.0) -> InertialTrajectory:
    """Looks at one point of the sky for ever; roll is the position angle of the image's up direction."""
    return InertialTrajectory(quaternion_from_pointing(ra_deg, dec_deg, roll_deg))


def constant_rate(
    *, ra_deg: float, dec_deg: float, roll_deg: float = 0.0, rate_deg_s: ArrayLike, start_ns: int = 0
) -> ConstantRateTrajectory:
    """From a pointing at start_ns (and before it, backwards), at a constant rate about sensor axes x, y, z,
    deg/s."""
    rate = np.radians(_vector("rate_deg_s", rate_deg_s))
    return ConstantRateTrajectory(quaternion_from_pointing(ra_deg, dec_deg, roll_deg), rate, start_ns)


def earth_fixed(
    *,
    ra_deg: float,
    dec_deg: float,
    roll_deg: float = 0.0,
    start_tai_ns: int | None = None,
    latitude_deg: float | None = None,
    longitude_deg: float | None = None,
    height_m: float = 0.0,
) -> EarthFixedTrajectory:
    """Fixed to the Earth, looking at a point of the sky at virtual time 0.

    start_tai_ns (TAI ns since 1958 at virtual time 0) gives the pole of the date; without it the pole is that
    of ICRS. latitude_deg, longitude_deg (geodetic, WGS 84, east positive) and height_m give the observer's
    place; they need the date. The pointing is taken as it is: it need not be above the site's horizon.
    """
    q_start = quaternion_from_pointing(ra_deg, dec_deg, roll_deg)
    if start_tai_ns is None:
        if latitude_deg is not None or longitude_deg is not None:
            raise ValueError("a site on the Earth needs start_tai_ns")
        return EarthFixedTrajectory(q_start)
    icrs_to_intermediate = np.asarray(erfa.c2i06a(*time_scales.tt_jd(start_tai_ns)))
    pole = icrs_to_intermediate[2]
    if latitude_deg is None or longitude_deg is None:
        if latitude_deg is not longitude_deg:
            raise ValueError("a site on the Earth needs both latitude_deg and longitude_deg")
        return EarthFixedTrajectory(q_start, pole)
    if not -90.0 <= latitude_deg <= 90.0:
        raise ValueError(f"latitude_deg is {latitude_deg}; allowed is -90 to 90")
    # Polar motion (under 0.3 arcsec of direction, 10 m of place) is left out.
    itrs_km = erfa.gd2gc(1, np.radians(longitude_deg), np.radians(latitude_deg), height_m) / 1000.0
    rotation_angle = erfa.era00(*time_scales.ut1_jd(start_tai_ns))
    cosine, sine = np.cos(rotation_angle), np.sin(rotation_angle)
    intermediate_km = np.array(
        [cosine * itrs_km[0] - sine * itrs_km[1], sine * itrs_km[0] + cosine * itrs_km[1], itrs_km[2]]
    )
    return EarthFixedTrajectory(q_start, pole, icrs_to_intermediate.T @ intermediate_km)


def _vector(name: str, value: ArrayLike) -> Array:
    vector = np.array(value, dtype=np.float64)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise ValueError(f"{name} has to be three finite numbers, not {value!r}")
    return vector
