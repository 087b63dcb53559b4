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
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from .aberration import apparent_kernel
from .attitude import matrix_kernel, quaternion_product
from .catalogue.star_catalogue import StarCatalogue
from .geometry import CameraGeometry
from .image.spots import WindowSpots
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


class _VerifyRoom(NamedTuple):
    """Room for the verification: st_verify_room of the C twin, whose spots are in a table by window."""

    trial: IntArray  # stars
    distance: FloatArray  # stars
    low: FloatArray  # stars: squares of chords that are within the tolerance of the pivot's and the star's
    high: FloatArray  # stars; below zero: not computed for this pivot
    chord: FloatArray  # spots: square of the chord to the pivot's spot; below zero: not computed
    owner: IntArray  # spots


class _Verification(NamedTuple):
    """Everything that a trial of one pivot looks at; the fields of plan and spots as arrays."""

    reference: FloatArray  # [stars, 3]
    hp_mag: npt.NDArray[np.float32]
    x_px: FloatArray
    y_px: FloatArray
    window: IntArray
    cos_half_tolerance: float  # of half the largest error of the angle between the pivot and a star
    sin_half_tolerance: float
    magnitude_tolerance: float
    b_vectors: FloatArray  # [spots, 3]
    spot_x_px: FloatArray
    spot_y_px: FloatArray
    spot_magnitude: FloatArray
    spot_window: IntArray
    room: _VerifyRoom


# The parts of the kernel are those of arm/tracking.c, under the same names.


@numba.njit(nogil=True)
def _chord_square(u: FloatArray, i: int, v: FloatArray, j: int) -> float:
    """Square of the chord between the unit vectors u[i] and v[j]: 4 sin^2 of half their angle."""
    dx = u[i, 0] - v[j, 0]
    dy = u[i, 1] - v[j, 1]
    dz = u[i, 2] - v[j, 2]
    square: float = dx * dx + dy * dy + dz * dz
    return square


@numba.njit(nogil=True)
def _chord_bounds(v: _Verification, pivot: int, star: int) -> tuple[float, float]:
    """Squares of the chords between which an angle is within the tolerance of that of two catalogue stars.

    An angle is within the tolerance t of the catalogue's angle a when its chord is between
    2 sin(a/2 -+ t/2) = c cos(t/2) -+ sqrt(4 - c^2) sin(t/2), c being the catalogue's chord.
    """
    square = _chord_square(v.reference, pivot, v.reference, star)
    middle = math.sqrt(square) * v.cos_half_tolerance
    reach = math.sqrt(4.0 - square) * v.sin_half_tolerance
    least = max(middle - reach, 0.0)
    return least * least, (middle + reach) * (middle + reach)


@numba.njit(nogil=True)
def _forget(square: FloatArray) -> None:
    """Forget the squares of chords: none is below zero."""
    for i in range(len(square)):
        square[i] = -1.0


@numba.njit(nogil=True)
def _try_pivot(v: _Verification, pivot: int, pivot_spot: int, counts: npt.NDArray[np.int64]) -> int:
    """Spots of the other stars when pivot_spot is the spot of pivot, to room.trial; how many verify with it.

    counts: as of ``_verify_kernel``, added to.
    """
    room = v.room
    shift_x = v.spot_x_px[pivot_spot] - v.x_px[pivot]
    shift_y = v.spot_y_px[pivot_spot] - v.y_px[pivot]
    verified = 1
    for star in range(len(room.trial)):
        room.trial[star] = -1
    for spot in range(len(room.owner)):
        room.owner[spot] = -1
    _forget(room.chord)
    room.trial[pivot] = pivot_spot
    room.owner[pivot_spot] = pivot
    for star in range(len(room.trial)):
        nearest = 1e300
        best = -1
        if star == pivot:
            continue
        for spot in range(len(room.owner)):
            if v.spot_window[spot] != v.window[star] or spot == pivot_spot:
                continue
            if room.high[star] < 0.0:
                room.low[star], room.high[star] = _chord_bounds(v, pivot, star)
                counts[3] += 1
            if room.chord[spot] < 0.0:
                room.chord[spot] = _chord_square(v.b_vectors, pivot_spot, v.b_vectors, spot)
                counts[0] += 1
            counts[4] += 1
            if not room.low[star] <= room.chord[spot] <= room.high[star]:
                continue
            difference = (v.spot_magnitude[spot] - v.spot_magnitude[pivot_spot]) - (
                v.hp_mag[star] - v.hp_mag[pivot]
            )
            if not abs(difference) <= v.magnitude_tolerance:
                continue
            counts[2] += 1
            dx = v.spot_x_px[spot] - v.x_px[star] - shift_x
            dy = v.spot_y_px[spot] - v.y_px[star] - shift_y
            distance = dx * dx + dy * dy
            if distance < nearest:
                nearest = distance
                best = spot
        if best < 0:
            continue
        room.trial[star] = best
        room.distance[star] = nearest
        rival = room.owner[best]
        if rival < 0:
            room.owner[best] = star
            verified += 1
        elif room.distance[rival] <= nearest:
            room.trial[star] = -1  # one spot for two stars: the nearer keeps it
        else:
            room.trial[rival] = -1
            room.owner[best] = star
    return verified


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

    counts[5], added to: angles verified, pivots tried, spots assigned, reference angles, angles compared.
    """
    stars = len(reference)
    spots = len(b)
    room = _VerifyRoom(
        np.empty(stars, np.int32),
        np.empty(stars),
        np.empty(stars),
        np.empty(stars),
        np.empty(spots),
        np.empty(spots, np.int32),
    )
    v = _Verification(
        reference,
        hp_mag,
        x,
        y,
        window,
        math.cos(0.5 * tolerance_rad),
        math.sin(0.5 * tolerance_rad),
        magnitude_tolerance,
        b,
        spot_x,
        spot_y,
        spot_mag,
        spot_window,
        room,
    )
    # Of the stars of one window as many could have a spot as it has spots.
    found = 0
    for star in range(stars):
        chosen[star] = -1
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
    for pivot in range(stars):
        _forget(room.high)
        for pivot_spot in range(spots):
            if spot_window[pivot_spot] != window[pivot]:
                continue
            counts[1] += 1
            number = _try_pivot(v, pivot, pivot_spot, counts)
            if number < enough:
                continue
            for star in range(stars):
                chosen[star] = room.trial[star]
            return pivot, number, found
    return -1, 0, found
