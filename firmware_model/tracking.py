"""Tracking: windows where the last attitude puts the stars, and their verification by a pivot star.

The six steps of Sarvi et al. 2014 ("Tracking sequence"): neighbours of the pivot from the catalogue; those
that can be in the image, by the last attitude and the four planes of the field, each with a window; a new
image; centroids inside the windows only; the angles between the pivot and each other found star against the
catalogue; attitude. No rate is given, and none is used to place a window, but where a unit asks for it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numba
import numpy as np
import numpy.typing as npt

from .aberration import apparent_kernel
from .attitude import matrix_kernel, quaternion_product
from .catalogue.star_catalogue import StarCatalogue
from .geometry import CameraGeometry
from .star_rate import EXPECTED_CHANGE_RAD_S2
from .work import Work

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]


@dataclass(frozen=True)
class TrackingParameters:
    """What tracking needs to know.

    rate_rad_s: omega, the largest rate that the windows allow for, about any axis.
    tolerance_rad: largest error of the angle between the pivot and another star, and of a star against the
        attitude.
    min_stars: an attitude needs so many verified stars, the pivot among them.
    max_missed: consecutive frames without attitude after which tracking is lost is one more than this.
    max_windows: so many of the brightest predicted stars get a window.
    star_radius_px: radius of a star's image at rest, with what the centroid needs round it.
    magnitude_tolerance: largest error of the difference in magnitude between a star and the pivot. ASSUMED:
        2.0; a measured magnitude may be 0.7 off (Zhang et al. 2014), a saturated star more.
    rate_margin: a rate is too high above (1 + rate_margin) omega. ASSUMED: 0.25, half-way from omega, where
        tracking must hold, to 1.5 omega, where it must not, so that noise decides neither.
    windows_by_rate: windows stand where the last rate puts the stars, as wide as that rate is uncertain.
    """

    rate_rad_s: float
    tolerance_rad: float
    min_stars: int = 3
    max_missed: int = 2
    max_windows: int = 25
    star_radius_px: float = 4.0
    magnitude_tolerance: float = 2.0
    rate_margin: float = 0.25
    windows_by_rate: bool = False

    def __post_init__(self) -> None:
        if not self.rate_rad_s > 0.0:
            raise ValueError(f"rate_rad_s {self.rate_rad_s} is not positive")
        if not 0.0 < self.tolerance_rad < 0.1:
            raise ValueError(f"tolerance_rad {self.tolerance_rad} is not between 0 and 0.1")
        if self.min_stars < 2 or self.max_windows < self.min_stars or self.max_missed < 0:
            raise ValueError("tracking needs 2 stars at least, as many windows, and max_missed of 0 or more")


@dataclass(frozen=True)
class TrackingPlan:
    """The stars that the next image should show, brightest first, and the windows to look for them in.

    star: int32[n], rows of the catalogue; reference: float64[n, 3], their apparent directions (ICRS).
    x_px, y_px: float64[n], where the last attitude puts them.
    window: int32[n], window of each star.
    rects: int32[m, 4], windows x0, y0, x1, y1 (half-open, inside the image), none touching another.
    half_width_px: half-width of the window of a single star, from the pixel nearest to it.
    """

    star: IntArray
    reference: FloatArray
    x_px: FloatArray
    y_px: FloatArray
    window: IntArray
    rects: IntArray
    half_width_px: int

    def stars_in_windows(self) -> IntArray:
        """int32[m], number of predicted stars in each window."""
        return np.bincount(self.window, minlength=len(self.rects)).astype(np.int32)


@lru_cache(maxsize=16)
def _optics(geometry: CameraGeometry) -> tuple[float, float]:
    """(eps in px/deg, half of the field's diagonal in rad): the same for every frame."""
    return geometry.pixels_per_degree, geometry.half_diagonal_rad


def window_half_width_px(
    parameters: TrackingParameters, geometry: CameraGeometry, interval_s: float, exposure_s: float
) -> int:
    """Half-width of a detection window: ceil(omega dt eps) + ceil(star radius), px.

    Sarvi et al. 2014, (1)-(2), do not say whether omega t_samp eps is the full width or half of it, nor
    which eps.
    ASSUMED: the half-width, rounded up, plus the radius of the star's image, since a full width would hold
        motion up to omega / 2 only; eps by geometry; dt from the last valid attitude, so that a lost frame
        widens the windows. The star's radius is that of its image at rest plus half of its streak at omega
        during the exposure.
    """
    eps, _ = _optics(geometry)
    speed_px_s = math.degrees(parameters.rate_rad_s) * eps
    return math.ceil(speed_px_s * interval_s) + math.ceil(
        parameters.star_radius_px + 0.5 * speed_px_s * exposure_s
    )


def ahead_by_rate(
    q_icrs_to_sensor: FloatArray,
    rate_rad_s: FloatArray,
    covariance_rad2_s2: FloatArray,
    parameters: TrackingParameters,
    geometry: CameraGeometry,
    interval_s: float,
    readout_s: float,
    exposure_s: float,
) -> tuple[FloatArray, TrackingParameters]:
    """The attitude that the last rate leads to, and parameters for windows about the stars there.

    rate_rad_s, covariance_rad2_s2: the mean rate up to the attitude. The windows' omega is three sigmas of it
    and what it may have changed by since. ASSUMED: EXPECTED_CHANGE_RAD_S2 for one interval. The star's radius
    is that at rest, half of its streak by the rate itself, and what the rows' times put it off under a
    rolling shutter, readout_s from the first to the last. Where that would be no less than omega, or the
    windows no smaller, they are those of omega round the last attitude.
    """
    sigma = math.sqrt(float(np.trace(covariance_rad2_s2)))
    unsure = 3.0 * sigma + EXPECTED_CHANGE_RAD_S2 * interval_s
    eps, _ = _optics(geometry)
    speed_px_s = math.degrees(math.sqrt(float(rate_rad_s @ rate_rad_s))) * eps
    radius_px = parameters.star_radius_px + 0.5 * speed_px_s * (exposure_s + readout_s)
    shrunk = replace(parameters, rate_rad_s=unsure, star_radius_px=radius_px)
    wide = window_half_width_px(parameters, geometry, interval_s, exposure_s)
    if unsure >= parameters.rate_rad_s or wide <= window_half_width_px(
        shrunk, geometry, interval_s, exposure_s
    ):
        return q_icrs_to_sensor, parameters
    angle = rate_rad_s * interval_s
    size = math.sqrt(float(angle @ angle))
    scale = 0.5 if size < 1e-9 else math.sin(0.5 * size) / size
    turn = np.append(angle * scale, math.cos(0.5 * size))
    return quaternion_product(turn, q_icrs_to_sensor), shrunk


def plan_windows(
    q_icrs_to_sensor: FloatArray,
    pivot_star: int,
    catalogue: StarCatalogue,
    geometry: CameraGeometry,
    parameters: TrackingParameters,
    interval_s: float,
    exposure_s: float,
    velocity_over_c: FloatArray,
) -> tuple[TrackingPlan, Work]:
    """Steps 1 and 2: the stars that can be in the image and their windows.

    q_icrs_to_sensor: the last valid attitude; pivot_star: catalogue row of its pivot, or -1 to take the
        neighbours of the boresight instead (an attitude that was sent to the unit has no pivot);
        interval_s: time since that attitude; velocity_over_c[3]: of the observer, zeros without aberration.
        Windows are clipped at the image's edges, and windows that overlap or touch become their bounding
        box.
    """
    _, half_diagonal = _optics(geometry)
    matrix = np.empty((3, 3))
    matrix_kernel(q_icrs_to_sensor, matrix)
    if pivot_star >= 0:
        neighbours, read = catalogue.stars_near(
            catalogue.unit_vectors[pivot_star], 2.0 * half_diagonal + 1e-3
        )
    else:
        neighbours, read = catalogue.stars_near(matrix[2], half_diagonal + 1e-3)
    reference = np.empty((len(neighbours), 3))
    apparent_kernel(catalogue.unit_vectors, neighbours, velocity_over_c, reference)
    sensor = reference @ matrix.T
    inside = np.flatnonzero(geometry.in_field(sensor))
    x, y, _ = geometry.project(sensor[inside])
    seen = geometry.in_image(x, y)
    inside, x, y = inside[seen], x[seen], y[seen]
    order = np.argsort(catalogue.hp_mag[neighbours[inside]], kind="stable")[: parameters.max_windows]
    chosen, x, y = inside[order], x[order], y[order]
    half = window_half_width_px(parameters, geometry, interval_s, exposure_s)
    rects = np.empty((len(chosen), 4), np.int32)
    window = np.empty(len(chosen), np.int32)
    windows, compared = _merge_windows_kernel(
        x, y, half, geometry.width_px, geometry.height_px, rects, window
    )
    work = Work(
        {
            "neighbours_read": read,
            "predicted_stars_tested": len(neighbours),
            "predicted_stars_projected": len(inside),
            "windows_planned": compared,
            "tracking_plans": 1,
            "aberrated_stars": len(neighbours) if velocity_over_c.any() else 0,
        }
    )
    return TrackingPlan(neighbours[chosen], reference[chosen], x, y, window, rects[:windows], half), work


@numba.njit(nogil=True)
def _merge_windows_kernel(
    x: FloatArray, y: FloatArray, half: int, width: int, height: int, rects: IntArray, window: IntArray
) -> tuple[int, int]:
    """Write the merged windows to rects[:m] and each star's window; returns (m, windows compared).

    A merged window may meet further ones: it is compared again until none meet.
    """
    windows = 0
    compared = 0
    for star in range(len(x)):
        column = math.floor(x[star] + 0.5)
        row = math.floor(y[star] + 0.5)
        x0 = max(column - half, 0)
        y0 = max(row - half, 0)
        x1 = min(column + half + 1, width)
        y1 = min(row + half + 1, height)
        window[star] = windows
        other = 0
        while other < windows:
            compared += 1
            if x0 > rects[other, 2] or rects[other, 0] > x1 or y0 > rects[other, 3] or rects[other, 1] > y1:
                other += 1
                continue
            x0 = min(x0, rects[other, 0])
            y0 = min(y0, rects[other, 1])
            x1 = max(x1, rects[other, 2])
            y1 = max(y1, rects[other, 3])
            # The other window is taken up: the last one fills its place, the growing one stays the newest.
            last = windows - 1
            for m in range(4):
                rects[other, m] = rects[last, m]
            for earlier in range(star + 1):
                if window[earlier] == other or window[earlier] == windows:
                    window[earlier] = last
                elif window[earlier] == last:
                    window[earlier] = other
            windows = last
            other = 0
        rects[windows, 0] = x0
        rects[windows, 1] = y0
        rects[windows, 2] = x1
        rects[windows, 3] = y1
        windows += 1
        compared += 1
    return windows, compared
