"""A tumble that dies away."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import quaternion
from .trajectory import Instants, quaternion_from_pointing, seconds

Array = NDArray[np.float64]


class DetumblingTrajectory:
    """A rate about an axis that is fixed in the sensor and falls as ``exp(-t / time_constant)``, from virtual
    time 0 on; before it the initial rate holds. ASSUMED: exponential, as the magnetic control law that is
    proportional to the rate gives on average.
    """

    def __init__(self, q_start: ArrayLike, rate_rad_s: ArrayLike, time_constant_s: float) -> None:
        self._q_start = quaternion.canonical(q_start)
        self._rate = np.array(rate_rad_s, dtype=np.float64)
        self._time_constant_s = float(time_constant_s)

    def q_icrs_to_sensor(self, t_ns: Instants) -> Array:
        elapsed = seconds(t_ns)
        lasting = self._time_constant_s * -np.expm1(-np.maximum(elapsed, 0.0) / self._time_constant_s)
        turned = quaternion.from_rotation_vector(
            np.where(elapsed < 0.0, elapsed, lasting)[..., np.newaxis] * self._rate
        )
        return quaternion.canonical(quaternion.multiply(turned, self._q_start))

    def rate_sensor(self, t_ns: Instants) -> Array:
        left = np.exp(-np.maximum(seconds(t_ns), 0.0) / self._time_constant_s)
        return np.asarray(left[..., np.newaxis] * self._rate)

    def position_km(self, t_ns: Instants) -> Array | None:
        return None

    def velocity_km_s(self, t_ns: Instants) -> Array | None:
        return None


def detumbling(
    *, ra_deg: float, dec_deg: float, roll_deg: float, rate_deg_s: ArrayLike, time_constant_s: float
) -> DetumblingTrajectory:
    """From a pointing at virtual time 0 with a rate in sensor axes, deg/s, that dies away."""
    return DetumblingTrajectory(
        quaternion_from_pointing(ra_deg, dec_deg, roll_deg),
        np.radians(np.array(rate_deg_s, dtype=np.float64)),
        time_constant_s,
    )
