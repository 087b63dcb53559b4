"""Frames of a turning camera, for streaks: each star drawn along its path, each row in its own time.

Written out plainly with scipy; of the firmware only the camera's figures. The camera is that of the paper on
rolling shutters (Schiattarella, Spiller and Curti 2020, tables 1 and 2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import erf

from hil_tests.firmware_model.synthetic_sky import matrix
from st_emulator.firmware_model.geometry import CameraGeometry

Array = NDArray[np.float64]
SIZE_PX = 1024
CAMERA = CameraGeometry(SIZE_PX, SIZE_PX, 52e3 / 18.0)
EXPOSURE_S = 0.2
ROW_TIME_S = EXPOSURE_S / SIZE_PX
ELECTRONS_PER_S_MAG0 = 7.3e6
ELECTRONS_PER_DN = 25.0
OFFSET_DN = 64.0
BACKGROUND_ELECTRONS = 6100.0
DARK_SPREAD_ELECTRONS, READ_NOISE_ELECTRONS = 5.0, 50.0
NOISE_DN = float(
    np.sqrt(BACKGROUND_ELECTRONS + DARK_SPREAD_ELECTRONS**2 + READ_NOISE_ELECTRONS**2) / ELECTRONS_PER_DN
)
TAU_PRE_DN = 500.0 / ELECTRONS_PER_DN
MAX_DN = 4095


def project(camera: CameraGeometry, vectors: Array) -> tuple[Array, Array]:
    """Columns and rows of directions in the sensor's frame (pinhole, written out)."""
    return (
        camera.cx_px + camera.focal_px * vectors[..., 0] / vectors[..., 2],
        camera.cy_px + camera.focal_px * vectors[..., 1] / vectors[..., 2],
    )


@dataclass(frozen=True)
class TurningCamera:
    """A camera that turns at a constant rate about an axis fixed in it.

    q: float64[4], q_icrs_to_sensor at time 0. rate_rad_s: float64[3], of the sensor relative to ICRS, in
    sensor axes. row_time_s: 0 for a global shutter. Frame k's first row begins its exposure at k period_s.
    """

    q: Array
    rate_rad_s: Array
    row_time_s: float = ROW_TIME_S
    period_s: float = EXPOSURE_S
    exposure_s: float = EXPOSURE_S
    camera: CameraGeometry = CAMERA
    psf_sigma_px: float = 0.75

    def attitude(self, t_s: float) -> Array:
        """q_icrs_to_sensor at a time: the body turns actively by the rate about its own axes."""
        return np.asarray(
            (Rotation.from_quat(self.q) * Rotation.from_rotvec(self.rate_rad_s * t_s)).as_quat()
        )

    def mid_s(self, frame: int) -> float:
        """The middle of the middle row's exposure."""
        return (
            frame * self.period_s
            + 0.5 * (self.camera.height_px - 1) * self.row_time_s
            + 0.5 * self.exposure_s
        )

    def places(self, vectors: Array, t_s: float) -> tuple[Array, Array]:
        """Columns and rows of ICRS directions float64[n, 3] at a time."""
        return project(self.camera, vectors @ matrix(self.attitude(t_s)).T)

    def signal(self, frame: int, vectors: Array, electrons_per_s: Array) -> Array:
        """Electrons of the stars in a frame, without noise, float64[rows, columns]."""
        rows, columns = self.camera.height_px, self.camera.width_px
        image = np.zeros((rows, columns))
        first_s = frame * self.period_s
        last_s = first_s + (rows - 1) * self.row_time_s + self.exposure_s
        for vector, rate in zip(vectors, electrons_per_s, strict=True):
            coarse = np.linspace(first_s, last_s, 33)
            x, y = self._path(vector, coarse)
            length = float(np.hypot(np.diff(x), np.diff(y)).sum())
            # no step over a fifth of a pixel
            steps = max(32, int(np.ceil(5.0 * length)))
            edges = np.linspace(first_s, last_s, steps + 1)
            x, y = self._path(vector, 0.5 * (edges[1:] + edges[:-1]))
            left, right = int(x.min()) - 6, int(x.max()) + 8
            top, bottom = int(y.min()) - 6, int(y.max()) + 8
            left, right, top, bottom = max(left, 0), min(right, columns), max(top, 0), min(bottom, rows)
            if left >= right or top >= bottom:
                continue
            row = np.arange(top, bottom)
            begin = first_s + row * self.row_time_s
            # share of each step that lies within the exposure of each row
            lit = np.minimum(edges[1:, None], begin + self.exposure_s) - np.maximum(edges[:-1, None], begin)
            across = self._share(np.arange(left, right), x)
            down = self._share(row, y) * np.maximum(lit, 0.0)
            image[top:bottom, left:right] += rate * (down.T @ across)
        return image

    def _path(self, vector: Array, t_s: Array) -> tuple[Array, Array]:
        at = Rotation.from_quat(self.q) * Rotation.from_rotvec(np.outer(t_s, self.rate_rad_s))
        return project(self.camera, at.inv().apply(vector))

    def _share(self, pixels: NDArray[np.int64], centres: Array) -> Array:
        scale = 1.0 / (self.psf_sigma_px * np.sqrt(2.0))
        low = (pixels[None, :] - 0.5 - centres[:, None]) * scale
        return np.asarray(0.5 * (erf(low + scale) - erf(low)))


def photograph(signal_electrons: Array, rng: np.random.Generator) -> NDArray[np.uint16]:
    """The paper's noise and our converter: uint16[rows, columns] DN."""
    electrons = rng.poisson(signal_electrons + (BACKGROUND_ELECTRONS - 100.0)).astype(np.float64)
    electrons += rng.normal(100.0, DARK_SPREAD_ELECTRONS, electrons.shape)
    electrons += rng.normal(0.0, READ_NOISE_ELECTRONS, electrons.shape)
    return np.clip(np.rint(electrons / ELECTRONS_PER_DN + OFFSET_DN), 0, MAX_DN).astype(np.uint16)


@dataclass(frozen=True)
class Stars:
    """Directions (ICRS) and magnitudes, brightest first."""

    vectors: Array
    magnitude: Array

    @property
    def electrons_per_s(self) -> Array:
        return np.asarray(ELECTRONS_PER_S_MAG0 * 10.0 ** (-0.4 * self.magnitude))


def stars_round(
    q: Array, rng: np.random.Generator, limit_mag: float = 6.5, half_angle_rad: float = 0.35
) -> Stars:
    """As many stars as the sky has to a magnitude (8,800 to 6.5 mag), evenly about a boresight."""
    share = 0.5 * (1.0 - np.cos(half_angle_rad))
    count = int(rng.poisson(8800 * 10 ** (0.5 * (limit_mag - 6.5)) * share))
    z = rng.uniform(np.cos(half_angle_rad), 1.0, count)
    phi = rng.uniform(0.0, 2.0 * np.pi, count)
    s = np.sqrt(1.0 - z * z)
    vectors = np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1) @ matrix(q)
    magnitude = np.sort(limit_mag + 2.0 * np.log10(rng.uniform(1e-4, 1.0, count)))
    return Stars(vectors, magnitude)
