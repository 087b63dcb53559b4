"""A circular orbit about the Earth, with the sensor mounted on a nadir-pointing spacecraft."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import quaternion
from .trajectory import Instants, seconds

Array = NDArray[np.float64]

EARTH_RADIUS_KM = 6378.137  # equatorial, WGS 84
EARTH_MU_KM3_S2 = 398600.4418  # WGS 84 / EGM96


class OrbitTrajectory:
    """Circular Kepler orbit; the spacecraft holds the orbital frame, the sensor a fixed (or spinning)
    mounting on it.

    Orbital frame O, as in Fasano et al. (2013): 1 along the velocity, 2 against the angular momentum, 3 to
    nadir. It turns at -n about its axis 2, n = sqrt(mu / a^3). ASSUMED: the elements refer to the ICRS axes
    (0.14 deg off the equator of date), no perturbation of any kind: the orbit only has to give believable
    rates, velocities and occultations.
    """

    def __init__(
        self,
        *,
        radius_km: float,
        inclination_rad: float,
        raan_rad: float,
        argument_rad: float,
        q_orbital_to_sensor: ArrayLike,
        spin_rad_s: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        self._radius_km = float(radius_km)
        self._mean_motion = np.sqrt(EARTH_MU_KM3_S2 / radius_km**3)
        node = np.array([np.cos(raan_rad), np.sin(raan_rad), 0.0])
        normal = np.array(
            [
                np.sin(inclination_rad) * np.sin(raan_rad),
                -np.sin(inclination_rad) * np.cos(raan_rad),
                np.cos(inclination_rad),
            ]
        )
        self.node, self.normal = node, normal
        across = np.cross(normal, node)
        self._outward = np.cos(argument_rad) * node + np.sin(argument_rad) * across
        self._forward = np.cos(argument_rad) * across - np.sin(argument_rad) * node
        self._q_start = quaternion.from_matrix(np.stack((self._forward, -normal, -self._outward)))
        self._q_mount = quaternion.canonical(q_orbital_to_sensor)
        self._spin = np.array(spin_rad_s, dtype=np.float64)

    node: Array
    """Unit vector to the ascending node, ICRS."""
    normal: Array
    """Unit vector along the angular momentum, ICRS."""

    @property
    def mean_motion_rad_s(self) -> float:
        return float(self._mean_motion)

    def _turn(self, elapsed: Array) -> Array:
        return quaternion.from_rotation_vector(elapsed[..., np.newaxis] * self._spin)

    def q_icrs_to_sensor(self, t_ns: Instants) -> Array:
        elapsed = seconds(t_ns)
        orbital = quaternion.from_rotation_vector(
            elapsed[..., np.newaxis] * np.array([0.0, -self._mean_motion, 0.0])
        )
        mounted = quaternion.multiply(self._turn(elapsed), self._q_mount)
        return quaternion.canonical(quaternion.multiply(mounted, quaternion.multiply(orbital, self._q_start)))

    def rate_sensor(self, t_ns: Instants) -> Array:
        mounted = quaternion.multiply(self._turn(seconds(t_ns)), self._q_mount)
        return quaternion.rotate(mounted, [0.0, -self._mean_motion, 0.0]) + self._spin

    def position_km(self, t_ns: Instants) -> Array | None:
        angle = self._mean_motion * seconds(t_ns)[..., np.newaxis]
        return np.asarray(self._radius_km * (np.cos(angle) * self._outward + np.sin(angle) * self._forward))

    def velocity_km_s(self, t_ns: Instants) -> Array | None:
        angle = self._mean_motion * seconds(t_ns)[..., np.newaxis]
        speed = self._radius_km * self._mean_motion
        return np.asarray(speed * (np.cos(angle) * self._forward - np.sin(angle) * self._outward))


def orbit(
    *,
    altitude_km: float,
    inclination_deg: float = 0.0,
    raan_deg: float = 0.0,
    argument_deg: float = 0.0,
    boresight: ArrayLike = (0.0, 0.0, -1.0),
    roll_deg: float = 0.0,
    spin_deg_s: ArrayLike = (0.0, 0.0, 0.0),
) -> OrbitTrajectory:
    """Circular orbit; argument_deg is the argument of latitude at virtual time 0.

    boresight: its direction in the orbital frame (1 velocity, 2 against the angular momentum, 3 nadir), by
    default the zenith. With roll 0 the sensor's +X lies as near to the velocity as the boresight allows (to
    nadir for a boresight along the velocity); a positive roll turns the sensor by that angle about its
    boresight. spin_deg_s: a constant extra rate in sensor axes, on top of the orbital one.
    """
    if not 100.0 <= altitude_km <= 400_000.0:
        raise ValueError(f"altitude_km is {altitude_km}; allowed is 100 to 400000")
    spin = np.radians(np.array(spin_deg_s, dtype=np.float64))
    if spin.shape != (3,) or not np.all(np.isfinite(spin)):
        raise ValueError(f"spin_deg_s has to be three finite numbers, not {spin_deg_s!r}")
    return OrbitTrajectory(
        radius_km=EARTH_RADIUS_KM + altitude_km,
        inclination_rad=float(np.radians(inclination_deg)),
        raan_rad=float(np.radians(raan_deg)),
        argument_rad=float(np.radians(argument_deg)),
        q_orbital_to_sensor=mounting(boresight, roll_deg),
        spin_rad_s=spin,
    )


def mounting(boresight: ArrayLike, roll_deg: float) -> Array:
    """Quaternion from a spacecraft's frame to the sensor whose boresight lies along ``boresight`` in it; the
    turn about it as `orbit` says. Raises ValueError for a boresight that is none.
    """
    z_axis = np.array(boresight, dtype=np.float64)
    if z_axis.shape != (3,) or not np.all(np.isfinite(z_axis)) or not np.any(z_axis):
        raise ValueError(f"boresight has to be three finite numbers, not all zero, not {boresight!r}")
    z_axis = z_axis / np.linalg.norm(z_axis)
    reference = np.array([1.0, 0.0, 0.0]) if abs(z_axis[0]) < 0.999 else np.array([0.0, 0.0, 1.0])
    x_axis = reference - z_axis * (reference @ z_axis)
    x_axis = x_axis / np.linalg.norm(x_axis)
    unrolled = quaternion.from_matrix(np.stack((x_axis, np.cross(z_axis, x_axis), z_axis)))
    rolled = quaternion.from_rotation_vector(np.radians([0.0, 0.0, roll_deg]))
    return quaternion.multiply(rolled, unrolled)
