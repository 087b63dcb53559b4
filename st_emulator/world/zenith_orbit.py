"""The orbit of the optical-flow paper (Fasano et al. 2013, "F"): equatorial, the boresight at the zenith at
its start, turned besides.

F says that the sensor frame is the orbital frame turned by 180 deg about axis 1 and, in the same passage,
that Y_s is axis 2 and X_s, Z_s are opposite; only the second gives omega_2 = -0.06243 deg/s of its table 3,
so it is the one taken.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from . import quaternion
from .trajectory import Instants, seconds

Array = NDArray[np.float64]

ORBIT_RATE_DEG_S = 0.06243  # F section 4: 500 km, circular
TO_ZENITH = np.array([-0.5, 0.5, -0.5, 0.5])  # ICRS to a sensor whose X, Y, Z are its -Y, -Z, X


class ZenithOrbit:
    """The attitude of F: a circular equatorial orbit, boresight to the zenith, X against the velocity, Y
    south; turned besides at a constant rate about the sensor's axes. The Earth is behind.
    """

    def __init__(self, first_ra_deg: float, turn_deg_s: tuple[float, float, float]) -> None:
        self._first_rad = math.radians(first_ra_deg)
        self._turn_rad_s = np.radians(turn_deg_s)

    def q_icrs_to_sensor(self, t_ns: Instants) -> Array:
        """See ``Trajectory``."""
        t_s = seconds(t_ns)
        ra = self._first_rad + math.radians(ORBIT_RATE_DEG_S) * t_s
        about_pole = np.stack(
            [np.zeros_like(ra), np.zeros_like(ra), np.sin(0.5 * ra), np.cos(0.5 * ra)], axis=-1
        )
        base = quaternion.multiply(TO_ZENITH, about_pole)
        turned = quaternion.from_rotation_vector(t_s[..., np.newaxis] * self._turn_rad_s)
        return quaternion.canonical(quaternion.multiply(turned, base))

    def rate_sensor(self, t_ns: Instants) -> Array:
        """See ``Trajectory``."""
        turned = quaternion.from_rotation_vector(seconds(t_ns)[..., np.newaxis] * self._turn_rad_s)
        # the orbit's rate is about Z of ICRS, which is -Y of the frame that is not yet turned
        orbit = np.array([0.0, -math.radians(ORBIT_RATE_DEG_S), 0.0])
        return np.asarray(quaternion.rotate(turned, orbit) + self._turn_rad_s)

    def position_km(self, t_ns: Instants) -> Array | None:
        """None: at rates like these an aberration of 5 arcsec that turns with the orbit is nothing."""
        return None

    def velocity_km_s(self, t_ns: Instants) -> Array | None:
        """None, as the position."""
        return None
