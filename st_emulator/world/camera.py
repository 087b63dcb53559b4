"""The true camera: optics and detector, as the renderer needs them."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CameraModel:
    """Optics and detector of one unit. Every figure comes from the unit's file.

    Geometry: pixel coordinates x = column, y = row, integers at pixel centres; sensor frame +Z boresight, +X
    to increasing column, +Y to increasing row. A direction (X, Y, Z) falls on x_px = cx_px + focal_px xd,
    y_px = cy_px + focal_px yd with (xd, yd) the Brown-Conrady distortion of (x, y) = (X/Z, Y/Z) (Brown,
    "Close-Range Camera Calibration" (1971)): r2 = x^2 + y^2, xd = x (1 + k1 r2 + k2 r2^2) + 2 p1 x y + p2 (r2
    + 2 x^2), yd = y (1 + k1 r2 + k2 r2^2) + p1 (r2 + 2 y^2) + 2 p2 x y. The principal point is the image's
    middle unless given.

    Signal: a star of magnitude Hp gives electrons_per_s_mag0 x 10^(-0.4 Hp) electrons a second, spread as a
    circular Gaussian of psf_sigma_px integrated over each pixel. A pixel further collects stray_electrons_s
    (and what Sun, Moon and Earth scatter), all of it times its own response, Gaussian about 1 with the
    standard deviation prnu; and dark current, Gaussian about dark_electrons_s with the relative standard
    deviation dark_nonuniformity (never below 0). A fraction hot_pixel_fraction of the pixels has an
    additional dark current, exponentially distributed with the mean hot_pixel_electrons_s (ASSUMED: the tails
    of dark-current histograms of irradiated detectors are near-exponential). Response, dark current and hot
    pixels are the detector's: they follow from the seed and the pixel alone.

    Read-out: charge is capped at full_well_electrons, Gaussian read_noise_electrons is added, and the number
    put out is floor(charge / electrons_per_dn + offset_dn + 1/2), clipped to 0 .. 2^bits - 1.

    Shutter: with rolling_readout_ns 0 all rows are exposed at once. Else row y of n is exposed from
    y rolling_readout_ns // n after the frame's start on, as long as every other. A frame's time is then that
    of the middle of its rows' exposures: half the exposure and half the last
    row's start after the frame's start.
    """

    width_px: int
    height_px: int
    focal_px: float
    psf_sigma_px: float
    electrons_per_s_mag0: float
    electrons_per_dn: float
    full_well_electrons: float
    read_noise_electrons: float
    bits: int = 12
    offset_dn: float = 0.0
    exposure_ns: int = 200_000_000
    rolling_readout_ns: int = 0
    dark_electrons_s: float = 0.0
    dark_nonuniformity: float = 0.0
    stray_electrons_s: float = 0.0
    prnu: float = 0.0
    hot_pixel_fraction: float = 0.0
    hot_pixel_electrons_s: float = 0.0
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    cx_px: float | None = None
    cy_px: float | None = None

    def __post_init__(self) -> None:
        if self.cx_px is None:
            object.__setattr__(self, "cx_px", (self.width_px - 1) / 2.0)
        if self.cy_px is None:
            object.__setattr__(self, "cy_px", (self.height_px - 1) / 2.0)
        for name, low, high in _LIMITS:
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name} is {value}; allowed is {low:g} to {high:g}")

    @property
    def principal_point_px(self) -> tuple[float, float]:
        """(cx_px, cy_px), resolved."""
        assert self.cx_px is not None
        assert self.cy_px is not None
        return self.cx_px, self.cy_px

    @property
    def row_starts_ns(self) -> NDArray[np.int64]:
        """When each row's exposure starts, from the frame's on, int64[height]; a global shutter: zeros."""
        return np.arange(self.height_px, dtype=np.int64) * self.rolling_readout_ns // self.height_px

    @property
    def last_row_start_ns(self) -> int:
        """When the last row's exposure starts, after the frame's start."""
        return (self.height_px - 1) * self.rolling_readout_ns // self.height_px

    @property
    def row_time_s(self) -> float:
        """From the start of a row to that of the next one; 0: a global shutter."""
        return self.rolling_readout_ns * 1e-9 / self.height_px

    @property
    def maximum_dn(self) -> int:
        return (1 << self.bits) - 1

    def without_noise(self) -> CameraModel:
        """The same optics and scaling without any noise, dark current, stray light, saturation or fixed
        pattern."""
        return dataclasses.replace(
            self,
            full_well_electrons=1e12,
            read_noise_electrons=0.0,
            dark_electrons_s=0.0,
            dark_nonuniformity=0.0,
            stray_electrons_s=0.0,
            prnu=0.0,
            hot_pixel_fraction=0.0,
            hot_pixel_electrons_s=0.0,
        )

    def project(self, vectors: ArrayLike) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Sensor-frame directions [..., 3] -> (x_px, y_px, ahead); coordinates mean nothing where ahead is
        False."""
        v = np.asarray(vectors, dtype=np.float64)
        ahead = v[..., 2] > 0.0
        z = np.where(ahead, v[..., 2], 1.0)
        xd, yd = self._distort(v[..., 0] / z, v[..., 1] / z)
        cx, cy = self.principal_point_px
        return cx + self.focal_px * xd, cy + self.focal_px * yd, ahead

    def unit_vectors(self, x_px: ArrayLike, y_px: ArrayLike) -> Array:
        """Pixel coordinates -> unit vectors [..., 3] in the sensor frame; the distortion is inverted
        iteratively."""
        cx, cy = self.principal_point_px
        xd = (np.asarray(x_px, dtype=np.float64) - cx) / self.focal_px
        yd = (np.asarray(y_px, dtype=np.float64) - cy) / self.focal_px
        x, y = xd.copy(), yd.copy()
        for _ in range(100):
            back_x, back_y = self._distort(x, y)
            step_x, step_y = xd - back_x, yd - back_y
            x, y = x + step_x, y + step_y
            if max(np.max(np.abs(step_x), initial=0.0), np.max(np.abs(step_y), initial=0.0)) < 1e-14:
                break
        v = np.stack((x, y, np.ones_like(x)), axis=-1)
        return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))

    def half_diagonal_rad(self) -> float:
        """The largest angle between the boresight and a point of the image's outline."""
        w, h = self.width_px - 0.5, self.height_px - 0.5
        along, down = np.linspace(-0.5, w, 9), np.linspace(-0.5, h, 9)
        x = np.concatenate((along, along, np.full(9, -0.5), np.full(9, w)))
        y = np.concatenate((np.full(9, -0.5), np.full(9, h), down, down))
        return float(np.arccos(np.min(self.unit_vectors(x, y)[:, 2])))

    def _distort(self, x: Array, y: Array) -> tuple[Array, Array]:
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * self.k2)
        return (
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )


_LIMITS: tuple[tuple[str, float, float], ...] = (
    ("width_px", 16, 8192),
    ("height_px", 16, 8192),
    ("focal_px", 10.0, 1e6),
    ("psf_sigma_px", 0.1, 20.0),
    ("electrons_per_s_mag0", 0.0, 1e15),
    ("electrons_per_dn", 1e-3, 1e6),
    ("full_well_electrons", 1.0, 1e15),
    ("read_noise_electrons", 0.0, 1e6),
    ("bits", 1, 16),
    ("offset_dn", 0.0, 65535.0),
    ("exposure_ns", 1, 3_600_000_000_000),
    ("rolling_readout_ns", 0, 3_600_000_000_000),
    ("dark_electrons_s", 0.0, 1e12),
    ("dark_nonuniformity", 0.0, 10.0),
    ("stray_electrons_s", 0.0, 1e12),
    ("prnu", 0.0, 1.0),
    ("hot_pixel_fraction", 0.0, 1.0),
    ("hot_pixel_electrons_s", 0.0, 1e12),
    ("k1", -1e3, 1e3),
    ("k2", -1e6, 1e6),
    ("p1", -1e3, 1e3),
    ("p2", -1e3, 1e3),
    ("cx_px", -1e5, 1e5),
    ("cy_px", -1e5, 1e5),
)
