"""A frame's light by brute force: many instants, a point spread by scipy's erf at each, row by row.

Shares no code with the renderer but the camera's projection, which has tests of its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from st_emulator.world import quaternion
from st_emulator.world.camera import CameraModel
from st_emulator.world.trajectory import Trajectory

Array = NDArray[np.float64]


def shares(n: int, centre: Array, sigma: float) -> Array:
    """[instants, n]: of a Gaussian at each centre, on each of n pixels of one axis."""
    edges = (np.arange(n + 1) - 0.5 - centre[:, np.newaxis]) / (sigma * np.sqrt(2.0))
    return np.asarray(0.5 * np.diff(erf(edges), axis=1))


def integrated(
    camera: CameraModel,
    trajectory: Trajectory,
    direction: Array,
    electrons_s: float,
    start_ns: int,
    exposure_ns: int,
    row_starts_ns: NDArray[np.int64],
    samples: int = 10_000,
) -> Array:
    """Mean electrons [height, width] of one star, by the middles of ``samples`` equal parts of the time."""
    lasts_ns = exposure_ns + int(row_starts_ns[-1])
    at_ns = (np.arange(samples) + 0.5) * lasts_ns / samples
    attitudes = trajectory.q_icrs_to_sensor(start_ns + at_ns.astype(np.int64))
    x_px, y_px, _ = camera.project(quaternion.rotate(attitudes, direction))
    across = shares(camera.width_px, x_px, camera.psf_sigma_px)
    down = shares(camera.height_px, y_px, camera.psf_sigma_px)
    part_s = lasts_ns / samples * 1e-9
    # how much of each part of the time each row is exposed
    begin, end = at_ns - lasts_ns / samples / 2, at_ns + lasts_ns / samples / 2
    starts = row_starts_ns[np.newaxis, :].astype(np.float64)
    overlap = np.minimum(end[:, np.newaxis], starts + exposure_ns) - np.maximum(begin[:, np.newaxis], starts)
    open_share = np.clip(overlap, 0.0, None) * (samples / lasts_ns)
    return np.asarray(electrons_s * part_s * (down * open_share).T @ across)


class Shaking:
    """A trajectory that adds a vibration about the sensor's axes to another one, from a time on."""

    def __init__(self, base: Trajectory, amplitude_rad: Array, frequency_hz: float, from_ns: int = 0) -> None:
        self.base, self.amplitude_rad, self.frequency_hz = base, amplitude_rad, frequency_hz
        self.from_ns = from_ns

    def q_icrs_to_sensor(self, t_ns: int | NDArray[np.int64]) -> Array:
        t_s = np.maximum(np.asarray(t_ns, dtype=np.float64) - self.from_ns, 0.0) * 1e-9
        angle = np.sin(2.0 * np.pi * self.frequency_hz * t_s)[..., np.newaxis] * self.amplitude_rad
        turned = quaternion.from_rotation_vector(angle)
        return quaternion.canonical(quaternion.multiply(turned, self.base.q_icrs_to_sensor(t_ns)))

    def rate_sensor(self, t_ns: int | NDArray[np.int64]) -> Array:
        return self.base.rate_sensor(t_ns)

    def position_km(self, t_ns: int | NDArray[np.int64]) -> None:
        return None

    def velocity_km_s(self, t_ns: int | NDArray[np.int64]) -> None:
        return None
