"""A spacecraft on an orbit that points at something: the Earth's centre, a place, a star, the Sun.

The pointing frame P: axis 3 towards what is pointed at; axis 2 as near as that allows to the direction
against the orbit's angular momentum (so a nadir pointing is the orbital frame); axis 1 completes them. The
sensor is mounted in P as `orbit.orbit` mounts it in the orbital frame.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import quaternion, time_scales
from .orbit import OrbitTrajectory, mounting
from .trajectory import EarthFixedTrajectory, Instants, earth_fixed

Array = NDArray[np.float64]
Direction = Callable[[NDArray[np.int64]], Array]
"""Unit vectors float64[n, 3], ICRS, at instants [n]."""

# Nearer to the orbit's normal than this the turn about the line of sight is not defined.
_LEAST_SINE = 1e-6
_RATE_STEP_NS = 1_000_000


class PointingTrajectory:
    """The orbit's place, and an attitude that follows a direction; it answers for any instant.

    The rate is the central difference of the attitude over 2 ms, good to about 1e-11 rad/s.
    """

    def __init__(self, place: OrbitTrajectory, direction: Direction, q_pointing_to_sensor: ArrayLike) -> None:
        self._place = place
        self._direction = direction
        self._q_mount = quaternion.canonical(q_pointing_to_sensor)

    def q_icrs_to_sensor(self, t_ns: Instants) -> Array:
        instants = np.atleast_1d(np.asarray(t_ns, dtype=np.int64))
        z_axis = self._direction(instants)
        x_axis = np.cross(-self._place.normal, z_axis)
        length = np.linalg.norm(x_axis, axis=-1, keepdims=True)
        # along the normal: a direction that is as good as any
        x_axis = np.where(length > _LEAST_SINE, x_axis / np.maximum(length, _LEAST_SINE), self._place.node)
        y_axis = np.cross(z_axis, x_axis)
        y_axis = y_axis / np.linalg.norm(y_axis, axis=-1, keepdims=True)
        frames = np.stack((np.cross(y_axis, z_axis), y_axis, z_axis), axis=-2)
        pointing = np.array([quaternion.from_matrix(frame) for frame in frames])
        q = quaternion.canonical(quaternion.multiply(self._q_mount, pointing))
        return q if np.ndim(t_ns) else q[0]

    def rate_sensor(self, t_ns: Instants) -> Array:
        after = self.q_icrs_to_sensor(t_ns + _RATE_STEP_NS)
        before = self.q_icrs_to_sensor(t_ns - _RATE_STEP_NS)
        turned = quaternion.to_rotation_vector(quaternion.multiply(after, quaternion.conjugate(before)))
        return np.asarray(turned / (2e-9 * _RATE_STEP_NS))

    def position_km(self, t_ns: Instants) -> Array | None:
        return self._place.position_km(t_ns)

    def velocity_km_s(self, t_ns: Instants) -> Array | None:
        return self._place.velocity_km_s(t_ns)


def nadir_pointing(
    place: OrbitTrajectory, *, boresight: ArrayLike = (0.0, 0.0, 1.0), roll_deg: float = 0.0
) -> PointingTrajectory:
    """Axis 3 to the Earth's centre, by default the sensor's boresight with it."""
    return PointingTrajectory(
        place, lambda t_ns: _unit(-_required(place.position_km(t_ns))), mounting(boresight, roll_deg)
    )


def star_pointing(
    place: OrbitTrajectory,
    direction: ArrayLike,
    *,
    boresight: ArrayLike = (0.0, 0.0, 1.0),
    roll_deg: float = 0.0,
) -> PointingTrajectory:
    """Axis 3 along a direction of the sky (ICRS vector of any length); at rest to the stars."""
    towards = _unit(np.array(direction, dtype=np.float64))
    return PointingTrajectory(
        place, lambda t_ns: np.tile(towards, (len(t_ns), 1)), mounting(boresight, roll_deg)
    )


def place_pointing(
    place: OrbitTrajectory,
    *,
    latitude_deg: float,
    longitude_deg: float,
    height_m: float,
    start_tai_ns: int,
    boresight: ArrayLike = (0.0, 0.0, 1.0),
    roll_deg: float = 0.0,
) -> PointingTrajectory:
    """Axis 3 to a place on the turning Earth (geodetic, WGS 84), also through the Earth when it is behind."""
    site: EarthFixedTrajectory = earth_fixed(
        ra_deg=0.0,
        dec_deg=0.0,
        start_tai_ns=start_tai_ns,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        height_m=height_m,
    )

    def direction(t_ns: NDArray[np.int64]) -> Array:
        return _unit(_required(site.position_km(t_ns)) - _required(place.position_km(t_ns)))

    return PointingTrajectory(place, direction, mounting(boresight, roll_deg))


def sun_pointing(
    place: OrbitTrajectory,
    *,
    start_tai_ns: int,
    boresight: ArrayLike = (0.0, 0.0, 1.0),
    roll_deg: float = 0.0,
) -> PointingTrajectory:
    """Axis 3 to the Sun's centre (where it is, without light time and aberration: 20 arcsec)."""

    def direction(t_ns: NDArray[np.int64]) -> Array:
        earth = np.array([time_scales.earth_position_velocity(start_tai_ns + int(t))[0] for t in t_ns])
        return _unit(-earth - _required(place.position_km(t_ns)))

    return PointingTrajectory(place, direction, mounting(boresight, roll_deg))


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _required(vectors: Array | None) -> Array:
    assert vectors is not None  # an orbit has a place
    return vectors
