"""Which spot of the windows is which predicted star: step 5 of Sarvi et al. 2014, by a pivot star."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from .catalogue.star_catalogue import StarCatalogue
from .image.spots import WindowSpots
from .tracking import TrackingParameters, TrackingPlan
from .work import Work

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]


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
