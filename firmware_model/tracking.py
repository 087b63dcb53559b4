"""Tracking: windows where the last attitude puts the stars, and their verification by a pivot star.

The six steps of Sarvi et al. 2014 ("Tracking sequence"): neighbours of the pivot from the catalogue; those
that can be in the image, by the last attitude and the four planes of the field, each with a window; a new
image; centroids inside the windows only; the angles between the pivot and each other found star against the
catalogue; attitude. No rate is given, and none is used to place a window.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np
import numpy.typing as npt

from .aberration import apparent_kernel
from .attitude import matrix_kernel
from .catalogue.star_catalogue import StarCatalogue
from .geometry import CameraGeometry
from .image.spots import WindowSpots
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
    """

    rate_rad_s: float
    tolerance_rad: float
    min_stars: int = 3
    max_missed: int = 2
    max_windows: int = 25
    star_radius_px: float = 4.0
    magnitude_tolerance: float = 2.0
    rate_margin: float = 0.25

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


@dataclass(frozen=True)
class Verification:
    """Which spot is which predicted star.

    spot: int32[n], for each star of the plan its spot, -1 where none is verified.
    pivot: place of the pivot in the plan, -1 when no star works as pivot.
    verified: number of stars with a spot; found: stars that could have one, by the spots in their windows.
    """

    spot: IntArray
    pivot: int
    verified: int
    found: int


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


def verify_by_pivot(
    plan: TrackingPlan,
    found: WindowSpots,
    b_vectors: FloatArray,
    catalogue: StarCatalogue,
    parameters: TrackingParameters,
) -> tuple[Verification, Work]:
    """Step 5: the angle between the pivot and each other found star against the catalogue.

    found: spots of the plan's windows; b_vectors[spots, 3]: their directions in the sensor frame. The
        brightest star whose window holds a spot is tried as pivot first; if too few others verify, the next
        becomes pivot. A spot counts for a star when it lies in the star's window, the angle to the pivot is
        within the tolerance of the catalogue's, and the difference in brightness too; of several the one
        nearest to where the pivot's own motion puts the star.
    ASSUMED: a pivot works when at least half of the stars that could have a spot verify with it (and
        min_stars in all): a false pivot that fits two false spots by chance is then passed over.
    """
    counts = np.zeros(5, np.int64)
    spot = np.empty(len(plan.star), np.int32)
    pivot, verified, stars_found = _verify_kernel(
        plan.reference,
        catalogue.hp_mag[plan.star],
        plan.x_px,
        plan.y_px,
        plan.window,
        b_vectors,
        found.spots.x_px,
        found.spots.y_px,
        found.spots.magnitude,
        found.window,
        parameters.tolerance_rad,
        parameters.magnitude_tolerance,
        parameters.min_stars,
        spot,
        counts,
    )
    work = Work(
        {
            "angles_verified": int(counts[0]),
            "pivots_tried": int(counts[1]),
            "spots_assigned": int(counts[2]),
            "reference_angles": int(counts[3]),
            "angles_compared": int(counts[4]),
            "verified_entries": len(plan.star) + len(plan.rects) + len(b_vectors),
        }
    )
    return Verification(spot, int(pivot), int(verified), int(stars_found)), work


@numba.njit(nogil=True)
def _chord_square(u: FloatArray, i: int, v: FloatArray, j: int) -> float:
    """Square of the chord between the unit vectors u[i] and v[j]: 4 sin^2 of half their angle."""
    dx = u[i, 0] - v[j, 0]
    dy = u[i, 1] - v[j, 1]
    dz = u[i, 2] - v[j, 2]
    square: float = dx * dx + dy * dy + dz * dz
    return square


@numba.njit(nogil=True)
def _verify_kernel(
    reference: FloatArray,
    hp_mag: npt.NDArray[np.float32],
    x: FloatArray,
    y: FloatArray,
    window: IntArray,
    b: FloatArray,
    spot_x: FloatArray,
    spot_y: FloatArray,
    spot_mag: FloatArray,
    spot_window: IntArray,
    tolerance_rad: float,
    magnitude_tolerance: float,
    min_stars: int,
    chosen: IntArray,
    counts: npt.NDArray[np.int64],
) -> tuple[int, int, int]:
    """(pivot, stars verified, stars that could be); the spot of each star in chosen[n].

    An angle is within the tolerance t of the catalogue's angle a when its chord is between
    2 sin(a/2 -+ t/2) = c cos(t/2) -+ sqrt(4 - c^2) sin(t/2), c being the catalogue's chord.
    """
    stars = len(reference)
    spots = len(b)
    trial = np.empty(stars, np.int32)
    owner = np.empty(max(spots, 1), np.int32)
    distance = np.empty(stars)
    low = np.empty(stars)
    high = np.empty(stars)  # below zero: not computed for this pivot
    chord = np.empty(max(spots, 1))  # square; below zero: not computed for this spot of the pivot
    for star in range(stars):
        chosen[star] = -1
    found = 0
    for star in range(stars):
        rank = 0
        for other in range(star):
            if window[other] == window[star]:
                rank += 1
        for spot in range(spots):
            if spot_window[spot] == window[star]:
                rank -= 1
        if rank < 0:
            found += 1
    if found < min_stars:
        return -1, 0, found
    enough = max(min_stars, (found + 1) // 2)
    cosine = math.cos(0.5 * tolerance_rad)
    sine = math.sin(0.5 * tolerance_rad)
    for pivot in range(stars):
        for star in range(stars):
            high[star] = -1.0
        for pivot_spot in range(spots):
            if spot_window[pivot_spot] != window[pivot]:
                continue
            counts[1] += 1
            shift_x = spot_x[pivot_spot] - x[pivot]
            shift_y = spot_y[pivot_spot] - y[pivot]
            for star in range(stars):
                trial[star] = -1
            for spot in range(spots):
                owner[spot] = -1
                chord[spot] = -1.0
            trial[pivot] = pivot_spot
            owner[pivot_spot] = pivot
            verified = 1
            for star in range(stars):
                if star == pivot:
                    continue
                nearest = 1e300
                for spot in range(spots):
                    if spot_window[spot] != window[star] or spot == pivot_spot:
                        continue
                    if high[star] < 0.0:
                        square = _chord_square(reference, pivot, reference, star)
                        middle = math.sqrt(square) * cosine
                        reach = math.sqrt(4.0 - square) * sine
                        low[star] = max(middle - reach, 0.0) ** 2
                        high[star] = (middle + reach) ** 2
                        counts[3] += 1
                    if chord[spot] < 0.0:
                        chord[spot] = _chord_square(b, pivot_spot, b, spot)
                        counts[0] += 1
                    counts[4] += 1
                    if not low[star] <= chord[spot] <= high[star]:
                        continue
                    difference = (spot_mag[spot] - spot_mag[pivot_spot]) - (hp_mag[star] - hp_mag[pivot])
                    if not abs(difference) <= magnitude_tolerance:
                        continue
                    counts[2] += 1
                    dx = spot_x[spot] - x[star] - shift_x
                    dy = spot_y[spot] - y[star] - shift_y
                    if dx * dx + dy * dy < nearest:
                        nearest = dx * dx + dy * dy
                        trial[star] = spot
                spot = trial[star]
                if spot < 0:
                    continue
                distance[star] = nearest
                verified += 1
                rival = owner[spot]
                if rival >= 0:
                    # One spot for two stars: the nearer keeps it.
                    loser = star if distance[rival] <= nearest else rival
                    trial[loser] = -1
                    verified -= 1
                    owner[spot] = rival if loser == star else star
                else:
                    owner[spot] = star
            if verified >= enough:
                for star in range(stars):
                    chosen[star] = trial[star]
                return pivot, verified, found
    return -1, 0, found
