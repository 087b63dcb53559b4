"""The pyramid: a triangle of spots found in the pair catalogue, confirmed by a fourth.

Mortari, Samaan, Bruccoleri & Junkins 2004, "The pyramid star identification technique", as Sarvi et al.
2014 ("Lost in space algorithm") use it: triads of spots in the smart order, k-vector range searches for
their sides, a triangle with the handedness of the spots, a fourth star whose three angles fit too. Where
Mortari wants the triangle to be the only one, every triangle that fits is given to the fourth star here:
with a wide tolerance (a lens whose distortion is not known) several always fit, and the fourth decides.
Every confirmed pyramid must then explain the rest of the image (verification.py), and no second attitude
may explain it too (solutions.py). Images of three or four spots only have no fourth to spare: there every
triangle is judged, and one alone is UNCONFIRMED.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from ..catalogue.kvector import range_kernel
from ..catalogue.sky_cells import stars_in_cone_kernel
from ..catalogue.tables import PairArrays, StarArrays, StarTables, pair_arrays, star_arrays
from ..reasons import Reason
from ..work import Work
from .interface import (
    FloatArray,
    Identification,
    IdentificationParameters,
    IntArray,
    Spikes,
    for_all_spikes,
    no_identification,
    usable_spikes,
)
from .solutions import (
    CONFIRMED,
    LIMIT,
    MATCHED,
    MOST_TRIANGLE_SPOTS,
    NOTHING,
    TRIANGLE,
    Limits,
    Solutions,
    best_identification,
    judge_kernel,
    limits_of,
    no_solutions,
    volume_kernel,
)
from .verification import (
    ANGLES_COMPUTED,
    CANDIDATES_MARKED,
    CATALOGUE_ANGLES,
    CONE_STARS,
    CONES_SEARCHED,
    FOURTHS_COMPARED,
    KVECTOR_HITS,
    KVECTOR_QUERIES,
    MARKS_SCATTERED,
    PAIRS_COMPARED,
    PAIRS_JOINED,
    PYRAMIDS_TESTED,
    THIRD_SIDES,
    TRIADS_JOINED,
    TRIADS_TESTED,
    TRIANGLES_TESTED,
    CountArray,
    exhausted_kernel,
    first_counts,
    scattered_kernel,
    spread_kernel,
    work_of,
)

_FEWEST = 3
_MOST_ENTRIES = 1 << 30  # entries of the mark table are numbered on and on; here the numbers start again


def identify(
    spikes: Spikes, catalogue: StarTables, parameters: IdentificationParameters
) -> tuple[Identification, Work]:
    """Identify spots by the pyramid algorithm; see `IdentificationAlgorithm` for the contract."""
    usable, places = usable_spikes(spikes)
    spots = len(usable)
    counts = first_counts(len(spikes))
    if spots < _FEWEST:
        return no_identification(len(spikes), Reason.TOO_FEW_STARS), work_of(counts)
    solutions = no_solutions(spots)
    outcome = _pyramid_kernel(
        usable.b_vectors,
        usable.magnitudes,
        star_arrays(catalogue.catalogue),
        pair_arrays(catalogue.pairs),
        limits_of(parameters, catalogue.pairs),
        (int(parameters.max_spots), int(parameters.max_triads), int(parameters.max_pairs_compared)),
        solutions,
        counts,
    )
    _count_scattered_kernel(len(catalogue.catalogue), counts)
    found = best_identification(outcome, spots, solutions)
    return for_all_spikes(found, places, len(spikes)), work_of(counts)


@numba.njit(nogil=True)
def _bounds_kernel(
    i: int,
    j: int,
    b: FloatArray,
    tolerance_rad: float,
    lowest: FloatArray,
    highest: FloatArray,
    counts: CountArray,
) -> None:
    """Cosines of the angle of spots i, j with the tolerance added and taken off, computed once and kept."""
    if lowest[i, j] <= 1.0:
        return
    dx = b[i, 0] - b[j, 0]
    dy = b[i, 1] - b[j, 1]
    dz = b[i, 2] - b[j, 2]
    angle = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(dx * dx + dy * dy + dz * dz)))
    counts[ANGLES_COMPUTED] += 1
    lowest[i, j] = lowest[j, i] = math.cos(min(math.pi, angle + tolerance_rad))
    highest[i, j] = highest[j, i] = math.cos(max(0.0, angle - tolerance_rad))


@numba.njit(nogil=True)
def _side_kernel(
    i: int,
    j: int,
    b: FloatArray,
    tolerance_rad: float,
    pairs: PairArrays,
    first: IntArray,
    end: IntArray,
    lowest: FloatArray,
    highest: FloatArray,
    counts: CountArray,
) -> None:
    """The range of catalogue pairs that fit the angle of spots i, j, looked up once and kept."""
    if first[i, j] >= 0:
        return
    _bounds_kernel(i, j, b, tolerance_rad, lowest, highest, counts)
    cos_angle, _, _, slope, offset, count_below = pairs
    start, stop, _ = range_kernel(cos_angle, slope, offset, count_below, lowest[i, j], highest[i, j])
    counts[KVECTOR_QUERIES] += 1
    counts[KVECTOR_HITS] += stop - start
    first[i, j] = first[j, i] = start
    end[i, j] = end[j, i] = stop


@numba.njit(nogil=True)
def _fourth_kernel(
    spots: int,
    tried: tuple[int, int, int],
    named: tuple[int, int, int],
    b: FloatArray,
    tolerance_rad: float,
    stars: StarArrays,
    lowest: FloatArray,
    highest: FloatArray,
    found: IntArray,
    counts: CountArray,
) -> tuple[int, int]:
    """(spot, star) that makes the triangle a pyramid, all three angles within the tolerance; or (-1, -1).

    The first such spot. The stars as far from the triangle's first one as any spot may be are taken from the
    sky grid, once for all spots; the pair list would have to be searched for each.
    """
    unit_vectors, _, band_height_rad, band_first_cell, cell_start, cell_star = stars
    i, j, k = tried
    star_i, star_j, star_k = named
    least = 1.0
    for spot in range(spots):
        if spot != i:
            _bounds_kernel(i, spot, b, tolerance_rad, lowest, highest, counts)
            least = min(least, lowest[i, spot])
    near, tested = stars_in_cone_kernel(
        unit_vectors,
        band_height_rad,
        band_first_cell,
        cell_start,
        cell_star,
        unit_vectors[star_i, 0],
        unit_vectors[star_i, 1],
        unit_vectors[star_i, 2],
        math.acos(max(-1.0, least)),
        found,
    )
    counts[CONES_SEARCHED] += 1
    counts[CATALOGUE_ANGLES] += tested
    counts[CONE_STARS] += tested
    fourth = spots
    star_fourth = -1
    for place in range(near):
        star = found[place]
        if star in (star_i, star_j, star_k):
            continue
        cosine = (
            unit_vectors[star, 0] * unit_vectors[star_i, 0]
            + unit_vectors[star, 1] * unit_vectors[star_i, 1]
            + unit_vectors[star, 2] * unit_vectors[star_i, 2]
        )
        counts[PAIRS_COMPARED] += fourth
        counts[FOURTHS_COMPARED] += fourth
        for spot in range(fourth):
            if cosine < lowest[i, spot] or cosine > highest[i, spot] or spot in (i, j, k):
                continue
            counts[PYRAMIDS_TESTED] += 1
            fits = True
            for corner in range(1, 3):
                base = tried[corner]
                other = named[corner]
                _bounds_kernel(base, spot, b, tolerance_rad, lowest, highest, counts)
                counts[CATALOGUE_ANGLES] += 1
                angle_cosine = (
                    unit_vectors[star, 0] * unit_vectors[other, 0]
                    + unit_vectors[star, 1] * unit_vectors[other, 1]
                    + unit_vectors[star, 2] * unit_vectors[other, 2]
                )
                if angle_cosine < lowest[base, spot] or angle_cosine > highest[base, spot]:
                    fits = False
                    break
            if fits:
                fourth = spot
                star_fourth = star
                break
    if star_fourth < 0:
        return -1, -1
    return fourth, star_fourth


@numba.njit(nogil=True)
def _count_scattered_kernel(stars: int, counts: CountArray) -> None:
    """Of all marks so far those not at hand: one for each star of a marked pair, two for each pair joined."""
    marks = counts[CANDIDATES_MARKED] // 2 + 2 * counts[PAIRS_JOINED]
    counts[MARKS_SCATTERED] = scattered_kernel(marks, stars)


@numba.njit(nogil=True)
def _pyramid_kernel(
    b: FloatArray,
    magnitudes: FloatArray,
    stars: StarArrays,
    pairs: PairArrays,
    limits: Limits,
    most: tuple[int, int, int],
    solutions: Solutions,
    counts: CountArray,
) -> int:
    """How the search ends (NOTHING, CERTAIN, RIVAL or LIMIT, see solutions.py); what it found in `solutions`.

    most: max_spots, max_triads, max_pairs_compared.
    """
    unit_vectors = stars[0]
    _, brighter, dimmer, _, _, _ = pairs
    tolerance_rad = limits[0]
    work_limit = limits[8]
    max_spots, max_triads, max_pairs_compared = most
    star_index, _, numbers, _ = solutions
    all_spots = len(b)
    spots = min(all_spots, max_spots)
    spread = spread_kernel(b, all_spots)
    first = np.full((spots, spots), -1, np.int32)
    end = np.full((spots, spots), -1, np.int32)
    lowest = np.full((spots, spots), 2.0)  # not a cosine: not known yet
    highest = np.empty((spots, spots))
    found = np.empty(len(unit_vectors), np.int32)
    # Mark table: chain[head[s] - base] .. lists the partners of star s among the pairs that fit one side.
    # What is numbered below base is of an earlier triad, so nothing needs to be cleared.
    head = np.full(len(unit_vectors), -1, np.int32)
    partner = np.empty(1024, np.int32)
    chain = np.empty(1024, np.int32)
    base = 0
    trial_index = np.empty(all_spots, np.int32)
    trial_q = np.empty(4)
    for dj in range(1, spots - 1):
        for dk in range(1, spots - dj):
            for i in range(spots - dj - dk):
                j = i + dj
                k = j + dk
                _count_scattered_kernel(len(head), counts)
                if (
                    counts[TRIADS_TESTED] >= max_triads
                    or counts[PAIRS_COMPARED] >= max_pairs_compared
                    or exhausted_kernel(counts, work_limit)
                ):
                    return LIMIT
                counts[TRIADS_TESTED] += 1
                _side_kernel(i, j, b, tolerance_rad, pairs, first, end, lowest, highest, counts)
                _side_kernel(i, k, b, tolerance_rad, pairs, first, end, lowest, highest, counts)
                _side_kernel(j, k, b, tolerance_rad, pairs, first, end, lowest, highest, counts)
                # The two sides with the fewest pairs are joined at their common spot, the apex; the third
                # is computed.
                n_ij = end[i, j] - first[i, j]
                n_ik = end[i, k] - first[i, k]
                n_jk = end[j, k] - first[j, k]
                if n_ij == 0 or n_ik == 0 or n_jk == 0:
                    continue
                apex, left, right = i, j, k
                if n_ij >= n_ik and n_ij >= n_jk:
                    apex, left, right = k, i, j
                elif n_ik >= n_ij and n_ik >= n_jk:
                    apex, left, right = j, i, k
                entries = 2 * (end[apex, left] - first[apex, left])
                if entries > len(partner):
                    partner = np.empty(2 * entries, np.int32)
                    chain = np.empty(2 * entries, np.int32)
                if base > _MOST_ENTRIES:
                    base = 0
                    head[:] = -1
                    counts[CANDIDATES_MARKED] += len(head)
                entry = 0
                for place in range(first[apex, left], end[apex, left]):
                    one = brighter[place]
                    other = dimmer[place]
                    partner[entry] = other
                    chain[entry] = head[one]
                    head[one] = base + entry
                    partner[entry + 1] = one
                    chain[entry + 1] = head[other]
                    head[other] = base + entry + 1
                    entry += 2
                counts[TRIADS_JOINED] += 1
                counts[CANDIDATES_MARKED] += 2 * entries
                counts[PAIRS_COMPARED] += end[apex, right] - first[apex, right]
                volume = volume_kernel(b, apex, left, right)
                longest = math.acos(min(1.0, min(lowest[i, j], min(lowest[i, k], lowest[j, k]))))
                # A triangle so flat that the tolerance can turn it over has no handedness.
                flat = 2.0 * tolerance_rad * longest
                for place in range(first[apex, right], end[apex, right]):
                    counts[PAIRS_JOINED] += 1
                    for turned in range(2):
                        star_apex = brighter[place] if turned == 0 else dimmer[place]
                        star_right = dimmer[place] if turned == 0 else brighter[place]
                        following = head[star_apex]
                        while following >= base:
                            entry = following - base
                            following = chain[entry]
                            star_left = partner[entry]
                            if star_left == star_right:
                                continue
                            counts[TRIANGLES_TESTED] += 1
                            counts[THIRD_SIDES] += 1
                            cosine = (
                                unit_vectors[star_left, 0] * unit_vectors[star_right, 0]
                                + unit_vectors[star_left, 1] * unit_vectors[star_right, 1]
                                + unit_vectors[star_left, 2] * unit_vectors[star_right, 2]
                            )
                            if cosine < lowest[left, right] or cosine > highest[left, right]:
                                continue
                            mirror = volume_kernel(unit_vectors, star_apex, star_left, star_right)
                            if volume * mirror < 0.0 and min(abs(volume), abs(mirror)) > flat:
                                continue
                            known = False
                            for kept in (CONFIRMED, TRIANGLE):
                                known = known or (
                                    numbers[kept, MATCHED] > 0
                                    and star_index[kept, apex] == star_apex
                                    and star_index[kept, left] == star_left
                                    and star_index[kept, right] == star_right
                                )
                            if known:
                                continue
                            if exhausted_kernel(counts, work_limit):
                                return LIMIT
                            for spot in range(all_spots):
                                trial_index[spot] = -1
                            trial_index[apex] = star_apex
                            trial_index[left] = star_left
                            trial_index[right] = star_right
                            if all_spots > MOST_TRIANGLE_SPOTS:
                                fourth, star_fourth = _fourth_kernel(
                                    spots,
                                    (apex, left, right),
                                    (star_apex, star_left, star_right),
                                    b,
                                    tolerance_rad,
                                    stars,
                                    lowest,
                                    highest,
                                    found,
                                    counts,
                                )
                                if fourth < 0:
                                    continue
                                trial_index[fourth] = star_fourth
                            judged = judge_kernel(
                                b,
                                magnitudes,
                                spread,
                                stars,
                                limits,
                                trial_index,
                                trial_q,
                                solutions,
                                counts,
                            )
                            if judged != NOTHING:
                                return judged
                base += entries
    return NOTHING
