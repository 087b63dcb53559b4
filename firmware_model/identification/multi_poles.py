"""Improved multi-poles: every spike in turn is the pole, and two poles must agree.

Schiattarella, Spiller & Curti 2020, "Star identification robust to angular rates and false objects with
rolling shutter compensation", section 5; the numbers of equations are theirs.
Acceptance phase: the angles from a pole to all other spikes are looked up in the pair catalogue; pairs that
agree in brightness too vote for the star that the pole may be. Check phase: what two poles say of the same
spikes. What is recognised must then explain the image (verification.py), and no second attitude may explain
it too.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from ..catalogue.kvector import range_kernel
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
from .verification import (
    ANGLES_COMPUTED,
    CANDIDATES_MARKED,
    KVECTOR_HITS,
    KVECTOR_QUERIES,
    MAGNITUDES_COMPARED,
    MARKS_SCATTERED,
    MARKS_STAMPED,
    PAIRS_COMPARED,
    VOTES,
    CountArray,
    exhausted_kernel,
    false_solutions_kernel,
    first_counts,
    refine_kernel,
    scattered_kernel,
    separation_kernel,
    spread_kernel,
    verify_kernel,
    work_of,
)

_SOLVED, _UNCONFIRMED, _NO_MATCH, _AMBIGUOUS, _WORK_LIMIT = range(5)
_REASONS = (Reason.NONE, Reason.UNCONFIRMED, Reason.NO_MATCH, Reason.AMBIGUOUS, Reason.WORK_LIMIT)
_FEWEST = 3  # two neighbours beside the pole: of two spikes both would get one vote

_Limits = tuple[float, int, float, float, float, float, float, float, int]


def identify(
    spikes: Spikes, catalogue: StarTables, parameters: IdentificationParameters
) -> tuple[Identification, Work]:
    """Identify spots by the improved multi-poles algorithm; see `IdentificationAlgorithm` for the contract.

    All spikes are neighbours and each may become the pole, as printed: `max_spots` is no limit here,
    `work_limit` is. With fewer spikes than t* all of them have to be recognised (ASSUMED: the paper
    gives such images up); of three alone the attitude is UNCONFIRMED.
    """
    usable, places = usable_spikes(spikes)
    spots = len(usable)
    counts = first_counts(len(spikes))
    if spots < _FEWEST:
        return no_identification(len(spikes), Reason.TOO_FEW_STARS), work_of(counts)
    ascending = np.argsort(usable.magnitudes, kind="stable")  # (34)
    star_index = np.full(spots, -1, np.int32)
    q = np.zeros(4)
    outcome, matched, expected, seen, chance = _multi_poles_kernel(
        usable.b_vectors[ascending],
        usable.magnitudes[ascending],
        star_arrays(catalogue.catalogue),
        pair_arrays(catalogue.pairs),
        parameters.normals,
        (
            float(parameters.tolerance_rad),
            int(parameters.min_stars),
            float(parameters.multi_poles.magnitude_tolerance),
            float(parameters.least_seen_share),
            float(parameters.magnitude_tolerance),
            float(parameters.most_false_solutions),
            float(parameters.most_false_triangles),
            float(parameters.certain_false_solutions),
            max(_FEWEST, min(int(parameters.multi_poles.least_recognised), spots)),
        ),
        parameters.work_limit,
        star_index,
        q,
        counts,
    )
    work = work_of(counts)
    if _REASONS[outcome] not in (Reason.NONE, Reason.UNCONFIRMED):
        return no_identification(len(spikes), _REASONS[outcome]), work
    in_order = np.empty(spots, np.int32)
    in_order[ascending] = star_index
    found = Identification(
        in_order, int(matched), _REASONS[outcome], q, float(chance), int(expected), int(seen)
    )
    return for_all_spikes(found, places, len(spikes)), work


@numba.njit(nogil=True)
def feasible_kernel(
    pole_star_mag: float,
    neighbour_star_mag: float,
    pole_mag: float,
    neighbour_mag: float,
    tolerance_mag: float,
    counts: CountArray,
) -> bool:
    """One line of (38): may a catalogue pair be pole and neighbour, this way round, by its magnitudes?"""
    counts[MAGNITUDES_COMPARED] += 1
    if not abs(pole_star_mag - pole_mag) < tolerance_mag:
        return False
    counts[MAGNITUDES_COMPARED] += 1
    return abs(neighbour_star_mag - neighbour_mag) < tolerance_mag


@numba.njit(nogil=True)
def acceptance_kernel(
    pole: int,
    b: FloatArray,
    magnitudes: FloatArray,
    hp_mag: npt.NDArray[np.float32],
    pairs: PairArrays,
    tolerance_rad: float,
    tolerance_mag: float,
    base: int,
    votes: IntArray,
    last_voter: npt.NDArray[np.int64],
    head: IntArray,
    accepted: IntArray,
    counts: CountArray,
) -> int:
    """Acceptance phase for one pole: accepted[n] as (43), and how many of it are stars; 0: not accepted.

    votes, last_voter, head: one of each catalogue star, kept between calls; last_voter starts at -1 and
    base grows by n with each call, so that nothing has to be cleared.
    A star gets one vote of each neighbour at most, and only as the pole (38): the other star of a pair that
    fits one way round can be the neighbour's alone. Of several partners of the pole's star the one whose
    angle fits best becomes the neighbour's (ASSUMED; the paper takes them to be one).
    """
    cos_angle, brighter, dimmer, slope, offset, count_below = pairs
    spots = len(b)
    first = np.zeros(spots, np.int64)
    end = np.zeros(spots, np.int64)
    cosine = np.zeros(spots)
    room = 0
    for j in range(spots):
        accepted[j] = -1
        if j == pole:
            continue
        dx = b[pole, 0] - b[j, 0]
        dy = b[pole, 1] - b[j, 1]
        dz = b[pole, 2] - b[j, 2]
        angle = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(dx * dx + dy * dy + dz * dz)))  # (36)
        first[j], end[j], _ = range_kernel(
            cos_angle,
            slope,
            offset,
            count_below,
            math.cos(min(math.pi, angle + tolerance_rad)),
            math.cos(max(0.0, angle - tolerance_rad)),
        )  # (37)
        cosine[j] = b[pole, 0] * b[j, 0] + b[pole, 1] * b[j, 1] + b[pole, 2] * b[j, 2]
        room += end[j] - first[j]
    counts[ANGLES_COMPUTED] += spots - 1
    counts[KVECTOR_QUERIES] += spots - 1
    counts[KVECTOR_HITS] += room
    counts[MARKS_SCATTERED] += scattered_kernel(2 * room, len(hp_mag))  # magnitudes are read anywhere as well
    # The union of the pairs that fit (41), chained by the star that would be the pole.
    partner = np.empty(2 * room, np.int32)
    place_of = np.empty(2 * room, np.int32)
    neighbour = np.empty(2 * room, np.int32)
    chain = np.empty(2 * room, np.int32)
    entries = 0
    most = 0
    pole_star = -1
    for j in range(spots):
        for place in range(first[j], end[j]):
            for turned in range(2):
                star = dimmer[place] if turned else brighter[place]
                other = brighter[place] if turned else dimmer[place]
                if not feasible_kernel(
                    hp_mag[star], hp_mag[other], magnitudes[pole], magnitudes[j], tolerance_mag, counts
                ):
                    continue
                counts[CANDIDATES_MARKED] += 2
                counts[MARKS_STAMPED] += 1
                if last_voter[star] < base:
                    votes[star] = 0
                    head[star] = -1
                partner[entries] = other
                place_of[entries] = place
                neighbour[entries] = j
                chain[entries] = head[star]
                head[star] = entries
                entries += 1
                if last_voter[star] == base + j:
                    continue
                last_voter[star] = base + j
                votes[star] += 1
                counts[VOTES] += 1
                if votes[star] > most:
                    most = votes[star]
                    pole_star = star
                elif votes[star] == most:
                    pole_star = -1  # no identifier is the most frequent one
    if pole_star < 0:
        return 0
    accepted[pole] = pole_star
    best = np.full(spots, math.inf)
    entry = head[pole_star]
    while entry >= 0:
        j = neighbour[entry]
        off = abs(cos_angle[place_of[entry]] - cosine[j])
        counts[CANDIDATES_MARKED] += 1
        if off < best[j]:
            best[j] = off
            accepted[j] = partner[entry]  # (42)
        entry = chain[entry]
    return most + 1


@numba.njit(nogil=True)
def recognised_kernel(one: IntArray, other: IntArray, recognised: IntArray, counts: CountArray) -> int:
    """Check phase (44)-(45): stars that two sets give to the same spikes, and how many they are."""
    number = 0
    counts[PAIRS_COMPARED] += len(one)
    for spot in range(len(one)):
        recognised[spot] = -1
        if one[spot] >= 0 and one[spot] == other[spot]:
            recognised[spot] = one[spot]
            number += 1
    return number


@numba.njit(nogil=True)
def _next_pole(tried: npt.NDArray[np.bool_], accepted: IntArray, counts: CountArray) -> int:
    """The brightest spike not tried yet: of the accepted ones, else of all; -1 when there is none left."""
    brightest = -1
    for spot in range(len(tried)):
        counts[CANDIDATES_MARKED] += 1
        if tried[spot]:
            continue
        if accepted[spot] >= 0:
            return spot
        if brightest < 0:
            brightest = spot
    return brightest


@numba.njit(nogil=True)
def _same_attitude(one: FloatArray, other: FloatArray, spread_rad: float, tolerance_rad: float) -> bool:
    """Whether two attitudes are one within the tolerance; roll may differ by it over the spots' spread."""
    turn = abs(one[0] * other[0] + one[1] * other[1] + one[2] * other[2] + one[3] * other[3])
    # 1 - |turn| = (angle / 2)^2 / 2
    angle = 2.0 * math.sqrt(max(0.0, 2.0 * (1.0 - turn)))
    return angle < 4.0 * tolerance_rad / min(1.0, max(spread_rad, 0.01))


@numba.njit(nogil=True)
def _multi_poles_kernel(
    b: FloatArray,
    magnitudes: FloatArray,
    stars: StarArrays,
    pairs: PairArrays,
    normals: FloatArray,
    limits: _Limits,
    work_limit: FloatArray,
    star_index: IntArray,
    q: FloatArray,
    counts: CountArray,
) -> tuple[int, int, int, int, float]:
    """(outcome, matched, expected, seen, false solutions); the solution in star_index[n] and q[4]."""
    unit_vectors, hp_mag, band_height_rad, band_first_cell, cell_start, cell_star = stars
    (
        tolerance_rad,
        min_stars,
        pole_tolerance_mag,
        least_seen_share,
        odd_mag,
        most_false_solutions,
        most_false_triangles,
        certain_false_solutions,
        least_recognised,
    ) = limits
    spots = len(b)
    spread = spread_kernel(b, spots)
    votes = np.zeros(len(hp_mag), np.int32)
    last_voter = np.full(len(hp_mag), -1, np.int64)
    head = np.full(len(hp_mag), -1, np.int32)
    tried = np.zeros(spots, np.bool_)
    sets = np.empty((spots, spots), np.int32)  # accepted ones, one a row
    nothing = np.full(spots, -1, np.int32)
    kept = 0
    from_set = -1  # the set whose neighbours the next pole is taken from
    recognised = np.empty(spots, np.int32)
    trial_q = np.empty(4)
    best_matched = best_expected = best_seen = 0
    best_chance = math.inf
    base = 0
    limited = False
    while True:
        if exhausted_kernel(counts, work_limit):
            limited = True
            break
        pole = _next_pole(tried, sets[from_set] if from_set >= 0 else nothing, counts)
        if pole < 0:
            break
        tried[pole] = True
        accepted = sets[kept]
        found = acceptance_kernel(
            pole,
            b,
            magnitudes,
            hp_mag,
            pairs,
            tolerance_rad,
            pole_tolerance_mag,
            base,
            votes,
            last_voter,
            head,
            accepted,
            counts,
        )
        base += spots
        # A set smaller than t* cannot pass the check with any other.
        if found < least_recognised:
            from_set = -1
            continue
        from_set = kept
        kept += 1
        for earlier in range(kept - 1):
            number = recognised_kernel(sets[earlier], accepted, recognised, counts)
            if number < least_recognised:
                continue
            if best_matched > 0:
                known = True
                for spot in range(spots):
                    known = known and (recognised[spot] < 0 or recognised[spot] == star_index[spot])
                if known:
                    continue  # the solution already found, once more
            refine_kernel(b, unit_vectors, recognised, trial_q, counts)
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
                min_stars if number >= min_stars else number,
                normals,
                least_seen_share,
                odd_mag,
                recognised,
                counts,
            )
            if matched == 0:
                continue
            chance = false_solutions_kernel(len(unit_vectors), spots, matched, spread, tolerance_rad)
            if chance > (most_false_solutions if matched >= min_stars else most_false_triangles):
                continue
            if best_matched > 0:
                same = _same_attitude(q, trial_q, spread, tolerance_rad)
                for spot in range(spots):
                    if recognised[spot] >= 0 and star_index[spot] >= 0:
                        same = same and recognised[spot] == star_index[spot]
                # A rival stands unless one of the two is certain.
                if not same and min(chance, best_chance) > certain_false_solutions:
                    return _AMBIGUOUS, 0, 0, 0, math.inf
                if chance >= best_chance:
                    continue
            best_matched, best_expected, best_seen, best_chance = matched, expected, seen, chance
            star_index[:] = recognised
            q[:] = trial_q
            if chance <= certain_false_solutions:
                return _SOLVED, best_matched, best_expected, best_seen, best_chance
    if best_matched >= min_stars:
        return _SOLVED, best_matched, best_expected, best_seen, best_chance
    if best_matched > 0:
        return _UNCONFIRMED, best_matched, best_expected, best_seen, best_chance
    return (_WORK_LIMIT if limited else _NO_MATCH), 0, 0, 0, math.inf
