"""The pyramid: a triangle of spots found in the pair catalogue, confirmed by a fourth.

Mortari, Samaan, Bruccoleri & Junkins 2004, "The pyramid star identification technique", as Sarvi et al.
2014 ("Lost in space algorithm") use it: triads of spots in the smart order, k-vector range searches for
their sides, a triangle with the handedness of the spots, a fourth star whose three angles fit too. Where
Mortari wants the triangle to be the only one, every triangle that fits is given to the fourth star here:
with a wide tolerance (a lens whose distortion is not known) several always fit, and the fourth decides.
Every confirmed pyramid must then explain the rest of the image (verification.py), and no second attitude
may explain it too.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from ..catalogue.kvector import range_kernel
from ..catalogue.tables import StarTables
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
from .verification import (
    ANGLES_COMPUTED,
    CANDIDATES_MARKED,
    CATALOGUE_ANGLES,
    COUNT_NAMES,
    KVECTOR_HITS,
    KVECTOR_QUERIES,
    PAIRS_COMPARED,
    PYRAMIDS_TESTED,
    TRIADS_TESTED,
    TRIANGLES_TESTED,
    CountArray,
    exhausted_kernel,
    false_solutions_kernel,
    refine_kernel,
    separation_kernel,
    spread_kernel,
    verify_kernel,
    work_of,
)

_SOLVED, _NO_MATCH, _AMBIGUOUS, _WORK_LIMIT = range(4)
_REASONS = (Reason.NONE, Reason.NO_MATCH, Reason.AMBIGUOUS, Reason.WORK_LIMIT)
_NO_FIELD = np.zeros((0, 3))


def identify(
    spikes: Spikes, catalogue: StarTables, parameters: IdentificationParameters
) -> tuple[Identification, Work]:
    """Identify spots by the pyramid algorithm; see `IdentificationAlgorithm` for the contract."""
    usable, places = usable_spikes(spikes)
    b, measured_mag = usable.b_vectors, usable.magnitudes
    spots = len(usable)
    if spots < 4:
        return no_identification(len(spikes), Reason.TOO_FEW_STARS), Work()
    star_index = np.full(spots, -1, np.int32)
    q = np.zeros(4)
    counts = np.zeros(len(COUNT_NAMES), np.int64)
    stars, pair_catalogue = catalogue.catalogue, catalogue.pairs
    cells, kvector = stars.cells, pair_catalogue.kvector
    outcome, matched, expected, seen, chance = _pyramid_kernel(
        b,
        measured_mag,
        (
            stars.unit_vectors,
            stars.hp_mag,
            cells.band_height_rad,
            cells.band_first_cell,
            cells.cell_start,
            cells.cell_star,
        ),
        (
            pair_catalogue.cos_angle,
            pair_catalogue.brighter,
            pair_catalogue.dimmer,
            kvector.slope,
            kvector.offset,
            kvector.count_below,
        ),
        parameters.tolerance_rad,
        parameters.max_spots,
        parameters.min_stars,
        _NO_FIELD if parameters.field_normals is None else np.ascontiguousarray(parameters.field_normals),
        parameters.least_seen_share,
        parameters.magnitude_tolerance,
        parameters.most_false_solutions,
        parameters.certain_false_solutions,
        parameters.max_triads,
        parameters.max_pairs_compared,
        parameters.work_limit,
        star_index,
        q,
        counts,
    )
    work = work_of(counts)
    if outcome != _SOLVED:
        return no_identification(len(spikes), _REASONS[outcome]), work
    found = Identification(star_index, int(matched), Reason.NONE, q, float(chance), int(expected), int(seen))
    return for_all_spikes(found, places, len(spikes)), work


@numba.njit(cache=True, nogil=True)
def _side_kernel(
    i: int,
    j: int,
    b: FloatArray,
    tolerance_rad: float,
    pairs: tuple[FloatArray, IntArray, IntArray, float, float, IntArray],
    first: IntArray,
    end: IntArray,
    lowest: FloatArray,
    highest: FloatArray,
    counts: CountArray,
) -> None:
    """Angle of spots i, j and the range of catalogue pairs that fit it, computed once and kept."""
    if first[i, j] >= 0:
        return
    cos_angle, _, _, slope, offset, count_below = pairs
    dx = b[i, 0] - b[j, 0]
    dy = b[i, 1] - b[j, 1]
    dz = b[i, 2] - b[j, 2]
    angle = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(dx * dx + dy * dy + dz * dz)))
    low = math.cos(min(math.pi, angle + tolerance_rad))
    high = math.cos(max(0.0, angle - tolerance_rad))
    start, stop, _ = range_kernel(cos_angle, slope, offset, count_below, low, high)
    counts[ANGLES_COMPUTED] += 1
    counts[KVECTOR_QUERIES] += 1
    counts[KVECTOR_HITS] += stop - start
    first[i, j] = first[j, i] = start
    end[i, j] = end[j, i] = stop
    lowest[i, j] = lowest[j, i] = low
    highest[i, j] = highest[j, i] = high


@numba.njit(cache=True, nogil=True)
def _fourth_kernel(
    spots: int,
    tried: tuple[int, int, int],
    stars: tuple[int, int, int],
    b: FloatArray,
    tolerance_rad: float,
    unit_vectors: FloatArray,
    pairs: tuple[FloatArray, IntArray, IntArray, float, float, IntArray],
    first: IntArray,
    end: IntArray,
    lowest: FloatArray,
    highest: FloatArray,
    counts: CountArray,
) -> tuple[int, int]:
    """(spot, star) that makes the triangle a pyramid, all three angles within the tolerance; or (-1, -1)."""
    _, brighter, dimmer, _, _, _ = pairs
    i, j, k = tried
    star_i, star_j, star_k = stars
    for spot in range(spots):
        if spot in (i, j, k):
            continue
        _side_kernel(i, spot, b, tolerance_rad, pairs, first, end, lowest, highest, counts)
        _side_kernel(j, spot, b, tolerance_rad, pairs, first, end, lowest, highest, counts)
        _side_kernel(k, spot, b, tolerance_rad, pairs, first, end, lowest, highest, counts)
        counts[PYRAMIDS_TESTED] += 1
        # The shortest of the three lists is searched for the triangle's star; the other two angles are
        # computed.
        one, star_one = i, star_i
        if end[j, spot] - first[j, spot] < end[one, spot] - first[one, spot]:
            one, star_one = j, star_j
        if end[k, spot] - first[k, spot] < end[one, spot] - first[one, spot]:
            one, star_one = k, star_k
        counts[PAIRS_COMPARED] += end[one, spot] - first[one, spot]
        for place in range(first[one, spot], end[one, spot]):
            if brighter[place] == star_one:
                star = dimmer[place]
            elif dimmer[place] == star_one:
                star = brighter[place]
            else:
                continue
            if star in (star_i, star_j, star_k):
                continue
            fits = True
            for corner in range(3):
                base = tried[corner]
                other = stars[corner]
                if base == one:
                    continue
                counts[CATALOGUE_ANGLES] += 1
                cosine = (
                    unit_vectors[star, 0] * unit_vectors[other, 0]
                    + unit_vectors[star, 1] * unit_vectors[other, 1]
                    + unit_vectors[star, 2] * unit_vectors[other, 2]
                )
                if cosine < lowest[base, spot] or cosine > highest[base, spot]:
                    fits = False
                    break
            if fits:
                return spot, star
    return -1, -1


@numba.njit(cache=True, nogil=True)
def _volume(u: FloatArray, i: int, j: int, k: int) -> float:
    """Triple product u_i . (u_j x u_k): its sign is the triangle's handedness."""
    volume: float = (
        u[i, 0] * (u[j, 1] * u[k, 2] - u[j, 2] * u[k, 1])
        + u[i, 1] * (u[j, 2] * u[k, 0] - u[j, 0] * u[k, 2])
        + u[i, 2] * (u[j, 0] * u[k, 1] - u[j, 1] * u[k, 0])
    )
    return volume


@numba.njit(cache=True, nogil=True)
def _pyramid_kernel(
    b: FloatArray,
    magnitudes: FloatArray,
    stars: tuple[FloatArray, npt.NDArray[np.float32], float, IntArray, IntArray, IntArray],
    pairs: tuple[FloatArray, IntArray, IntArray, float, float, IntArray],
    tolerance_rad: float,
    max_spots: int,
    min_stars: int,
    normals: FloatArray,
    least_seen_share: float,
    magnitude_tolerance: float,
    most_false_solutions: float,
    certain_false_solutions: float,
    max_triads: int,
    max_pairs_compared: int,
    work_limit: FloatArray,
    star_index: IntArray,
    q: FloatArray,
    counts: CountArray,
) -> tuple[int, int, int, int, float]:
    """(outcome, matched, expected, seen, false solutions); the solution in star_index[n] and q[4]."""
    unit_vectors, hp_mag, band_height_rad, band_first_cell, cell_start, cell_star = stars
    _, brighter, dimmer, _, _, _ = pairs
    all_spots = len(b)
    spots = min(all_spots, max_spots)
    spread = spread_kernel(b, all_spots)
    first = np.full((spots, spots), -1, np.int32)
    end = np.full((spots, spots), -1, np.int32)
    lowest = np.empty((spots, spots))
    highest = np.empty((spots, spots))
    # Mark table: chain[head[s]] .. lists the partners of star s among the pairs that fit one side.
    head = np.full(len(unit_vectors), -1, np.int32)
    partner = np.empty(1024, np.int32)
    chain = np.empty(1024, np.int32)
    trial_index = np.empty(all_spots, np.int32)
    trial_q = np.empty(4)
    best_matched = best_expected = best_seen = 0
    best_chance = math.inf
    limited = False
    for dj in range(1, spots - 1):
        for dk in range(1, spots - dj):
            for i in range(spots - dj - dk):
                j = i + dj
                k = j + dk
                if (
                    counts[TRIADS_TESTED] >= max_triads
                    or counts[PAIRS_COMPARED] >= max_pairs_compared
                    or exhausted_kernel(counts, work_limit)
                ):
                    limited = True
                    break
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
                entry = 0
                for place in range(first[apex, left], end[apex, left]):
                    one = brighter[place]
                    other = dimmer[place]
                    partner[entry] = other
                    chain[entry] = head[one]
                    head[one] = entry
                    partner[entry + 1] = one
                    chain[entry + 1] = head[other]
                    head[other] = entry + 1
                    entry += 2
                counts[CANDIDATES_MARKED] += 2 * entries
                counts[PAIRS_COMPARED] += end[apex, right] - first[apex, right]
                volume = _volume(b, apex, left, right)
                longest = math.acos(min(1.0, min(lowest[i, j], min(lowest[i, k], lowest[j, k]))))
                # A triangle so flat that the tolerance can turn it over has no handedness.
                flat = 2.0 * tolerance_rad * longest
                certain = False
                for place in range(first[apex, right], end[apex, right]):
                    for turned in range(2):
                        star_apex = brighter[place] if turned == 0 else dimmer[place]
                        star_right = dimmer[place] if turned == 0 else brighter[place]
                        entry = head[star_apex]
                        while entry >= 0:
                            star_left = partner[entry]
                            entry = chain[entry]
                            if star_left == star_right:
                                continue
                            counts[TRIANGLES_TESTED] += 1
                            cosine = (
                                unit_vectors[star_left, 0] * unit_vectors[star_right, 0]
                                + unit_vectors[star_left, 1] * unit_vectors[star_right, 1]
                                + unit_vectors[star_left, 2] * unit_vectors[star_right, 2]
                            )
                            if cosine < lowest[left, right] or cosine > highest[left, right]:
                                continue
                            mirror = _volume(unit_vectors, star_apex, star_left, star_right)
                            if volume * mirror < 0.0 and min(abs(volume), abs(mirror)) > flat:
                                continue
                            if (
                                best_matched > 0
                                and star_index[apex] == star_apex
                                and star_index[left] == star_left
                                and star_index[right] == star_right
                            ):
                                continue  # the solution already found, once more
                            fourth, star_fourth = _fourth_kernel(
                                spots,
                                (apex, left, right),
                                (star_apex, star_left, star_right),
                                b,
                                tolerance_rad,
                                unit_vectors,
                                pairs,
                                first,
                                end,
                                lowest,
                                highest,
                                counts,
                            )
                            if fourth < 0:
                                continue
                            for spot in range(all_spots):
                                trial_index[spot] = -1
                            trial_index[apex] = star_apex
                            trial_index[left] = star_left
                            trial_index[right] = star_right
                            trial_index[fourth] = star_fourth
                            refine_kernel(b, unit_vectors, trial_index, trial_q, counts)
                            matched, expected, seen = verify_kernel(
                                b,
                                magnitudes,
                                trial_q,
                                unit_vectors,
                                hp_mag,
                                band_height_rad,
                                band_first_cell,
                                cell_start,
                                cell_star,
                                separation_kernel(pairs[0]),
                                tolerance_rad,
                                min_stars,
                                normals,
                                least_seen_share,
                                magnitude_tolerance,
                                trial_index,
                                counts,
                            )
                            if matched == 0:
                                continue
                            chance = false_solutions_kernel(
                                len(unit_vectors), all_spots, matched, spread, tolerance_rad
                            )
                            if chance > most_false_solutions:
                                continue
                            if best_matched > 0:
                                same = True
                                for spot in range(all_spots):
                                    if trial_index[spot] >= 0 and star_index[spot] >= 0:
                                        same = same and trial_index[spot] == star_index[spot]
                                turn = (
                                    q[0] * trial_q[0]
                                    + q[1] * trial_q[1]
                                    + q[2] * trial_q[2]
                                    + q[3] * trial_q[3]
                                )
                                # 1 - |turn| = (angle / 2)^2 / 2; a roll may differ by the tolerance over
                                # the spread
                                angle = 2.0 * math.sqrt(max(0.0, 2.0 * (1.0 - abs(turn))))
                                same = same and angle < 4.0 * tolerance_rad / min(1.0, max(spread, 0.01))
                                # A rival stands unless one of the two is certain.
                                if not same and min(chance, best_chance) > certain_false_solutions:
                                    return _AMBIGUOUS, 0, 0, 0, math.inf
                                if chance >= best_chance:
                                    continue
                            best_matched, best_expected, best_seen = matched, expected, seen
                            best_chance = chance
                            for spot in range(all_spots):
                                star_index[spot] = trial_index[spot]
                            for m in range(4):
                                q[m] = trial_q[m]
                            if chance <= certain_false_solutions:
                                certain = True
                                break
                        if certain:
                            break
                    if certain:
                        break
                for place in range(first[apex, left], end[apex, left]):
                    head[brighter[place]] = -1
                    head[dimmer[place]] = -1
                counts[CANDIDATES_MARKED] += entries
                if certain:
                    return _SOLVED, best_matched, best_expected, best_seen, best_chance
            if limited:
                break
        if limited:
            break
    if best_matched > 0:
        return _SOLVED, best_matched, best_expected, best_seen, best_chance
    return (_WORK_LIMIT if limited else _NO_MATCH), 0, 0, 0, math.inf
