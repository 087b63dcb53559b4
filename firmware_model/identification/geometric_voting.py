"""Geometric voting: catalogue pairs vote for the identities of spots, and the identities for each other.

Kolomenkin, Pollak, Shimshoni & Lindenbaum 2008, "Geometric voting algorithm for star trackers", IEEE Trans.
AES 44(2), as Zhang et al. 2014, 2.2, retell it. First vote: of every pair of spots, each catalogue pair
whose angle fits (within +-3 sigma, `tolerance_rad`) votes with both its stars for both spots; the identity of
a spot is the star with the most votes. Second vote: the identities of two spots vote for each other if their
angle fits; identities that support each other are a cluster, and the largest cluster stands.

ASSUMED: the papers say neither what happens on a tie nor what the "simple clustering" is. Here all stars that
tie for a spot are its identities; a cluster grows from the identity with the most second votes by those that
fit all its members, in the order of their votes; where no cluster of the first in the vote stands, the
runners-up come in too. Every cluster must explain the image (judgement.py), and no second attitude may
explain it too.
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
from .judgement import (
    ANGLES_COMPUTED,
    CATALOGUE_ANGLES,
    KVECTOR_HITS,
    KVECTOR_QUERIES,
    MARKS_SCATTERED,
    VOTES,
    VOTES_CAST,
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

FEWEST_SPOTS = 3
MOST_SPOTS = 128  # ASSUMED: the work grows with its square
# ASSUMED: a first place that more stars share says nothing; the work of the second vote grows with the square
# of all identities.
MOST_IDENTITIES = 32
MOST_IDENTITIES_IN_ALL = 768
_PAIRS_BETWEEN_LIMITS = 4096
_VOTES_OF_A_LINE = 16  # of a cache, as halfwords

_SOLVED, _UNCONFIRMED, _NO_MATCH, _AMBIGUOUS, _WORK_LIMIT = range(5)
_REASONS = (Reason.NONE, Reason.UNCONFIRMED, Reason.NO_MATCH, Reason.AMBIGUOUS, Reason.WORK_LIMIT)


def identify(
    spikes: Spikes, catalogue: StarTables, parameters: IdentificationParameters
) -> tuple[Identification, Work]:
    """Identify spots by geometric voting; see `IdentificationAlgorithm` for the contract."""
    usable, places = usable_spikes(spikes)
    spots = len(usable)
    counts = first_counts(len(spikes))
    if spots < FEWEST_SPOTS:
        return no_identification(len(spikes), Reason.TOO_FEW_STARS), work_of(counts)
    star_index = np.full(spots, -1, np.int32)
    q = np.zeros(4)
    outcome, matched, expected, seen, chance = _voting_kernel(
        usable.b_vectors,
        usable.magnitudes,
        star_arrays(catalogue.catalogue),
        pair_arrays(catalogue.pairs),
        parameters.tolerance_rad,
        parameters.max_spots,
        parameters.min_stars,
        parameters.normals,
        parameters.least_seen_share,
        parameters.magnitude_tolerance,
        parameters.most_false_solutions,
        parameters.most_false_triangles,
        parameters.certain_false_solutions,
        parameters.work_limit,
        star_index,
        q,
        counts,
    )
    work = work_of(counts)
    reason = _REASONS[outcome]
    if outcome not in (_SOLVED, _UNCONFIRMED):
        return no_identification(len(spikes), reason), work
    found = Identification(star_index, int(matched), reason, q, float(chance), int(expected), int(seen))
    return for_all_spikes(found, places, len(spikes)), work


@numba.njit(nogil=True)
def cast_votes_kernel(
    b: FloatArray,
    voted: int,
    spots: int,
    tolerance_rad: float,
    pairs: PairArrays,
    work_limit: FloatArray,
    lowest: FloatArray,
    highest: FloatArray,
    votes: IntArray,
    counts: CountArray,
) -> bool:
    """The first vote, into votes[>= spots, stars]; False when the limit of work came first.

    Of all pairs of the first `spots` spots but those of the first `voted`, which have been counted before.
    lowest, highest: float64[>= spots, >= spots], bounds of the cosine of each pair of spots.
    """
    cos_angle, brighter, dimmer, slope, offset, count_below = pairs
    for j in range(voted, spots):
        for i in range(j):
            if exhausted_kernel(counts, work_limit):
                return False
            dx = b[i, 0] - b[j, 0]
            dy = b[i, 1] - b[j, 1]
            dz = b[i, 2] - b[j, 2]
            angle = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(dx * dx + dy * dy + dz * dz)))
            low = math.cos(min(math.pi, angle + tolerance_rad))
            high = math.cos(max(0.0, angle - tolerance_rad))
            lowest[i, j] = lowest[j, i] = low
            highest[i, j] = highest[j, i] = high
            first, end, _ = range_kernel(cos_angle, slope, offset, count_below, low, high)
            counts[ANGLES_COMPUTED] += 1
            counts[KVECTOR_QUERIES] += 1
            # A query of a wide tolerance has tens of thousands of pairs: the limit holds within it too.
            for begin in range(first, end, _PAIRS_BETWEEN_LIMITS):
                if begin > first and exhausted_kernel(counts, work_limit):
                    return False
                part = min(begin + _PAIRS_BETWEEN_LIMITS, end)
                for place in range(begin, part):
                    one = brighter[place]
                    other = dimmer[place]
                    votes[i, one] += 1
                    votes[i, other] += 1
                    votes[j, one] += 1
                    votes[j, other] += 1
                counts[KVECTOR_HITS] += part - begin
                counts[VOTES] += 4 * (part - begin)
                counts[VOTES_CAST] += 4 * (part - begin)
            # Two spots have half a word each for a star; spot i is another one each time, so that the first
            # vote of a line is cold.
            stars = votes.shape[1]
            cold = min(2 * (end - first), stars // _VOTES_OF_A_LINE)
            counts[MARKS_SCATTERED] += cold + scattered_kernel(4 * (end - first) - cold, stars)
    return True


@numba.njit(nogil=True)
def first_identities_kernel(votes_of_spot: IntArray, identity_star: IntArray, counts: CountArray) -> int:
    """Stars with the most votes of a spot, into identity_star; how many, 0 where the vote says nothing.

    It says nothing where no star has two votes (every star with a pair of that angle has one), or where more
    than MOST_IDENTITIES tie.
    """
    most = 2
    found = 0
    for star in range(len(votes_of_spot)):
        number = votes_of_spot[star]
        if number < most:
            continue
        if number > most:
            most = number
            found = 0
        if found < MOST_IDENTITIES:
            identity_star[found] = star
        found += 1
    counts[VOTES] += len(votes_of_spot)
    return found if found <= MOST_IDENTITIES else 0


@numba.njit(nogil=True)
def runners_up_kernel(
    votes_of_spot: IntArray, most_identities: int, identity_star: IntArray, counts: CountArray
) -> int:
    """The same with runners-up: all with so few votes, but two, that at most most_identities have as many."""
    stars_with = np.zeros(16, np.int32)
    most = 0
    for star in range(len(votes_of_spot)):
        number = votes_of_spot[star]
        if number >= len(stars_with):
            wider = np.zeros(2 * number, np.int32)
            wider[: len(stars_with)] = stars_with
            stars_with = wider
        stars_with[number] += 1
        most = max(most, number)
    fewest = most + 1
    found = 0
    while fewest > 2 and found + stars_with[fewest - 1] <= most_identities:
        fewest -= 1
        found += stars_with[fewest]
    counts[VOTES] += 2 * len(votes_of_spot)
    found = 0
    for star in range(len(votes_of_spot)):
        if votes_of_spot[star] >= fewest:
            identity_star[found] = star
            found += 1
    return found


@numba.njit(nogil=True)
def identities_kernel(
    votes: IntArray,
    spots: int,
    runners_up: bool,
    work_limit: FloatArray,
    identity_spot: IntArray,
    identity_star: IntArray,
    counts: CountArray,
) -> int:
    """Who each spot may be after the first vote: (spot, star) by spot.

    Returns how many there are, -1 when the limit of work came first.
    """
    identities = 0
    most_identities = min(MOST_IDENTITIES, MOST_IDENTITIES_IN_ALL // spots)
    for spot in range(spots):
        if exhausted_kernel(counts, work_limit):
            return -1
        stars = identity_star[identities:]
        if runners_up:
            found = runners_up_kernel(votes[spot], most_identities, stars, counts)
        else:
            found = first_identities_kernel(votes[spot], stars, counts)
        for place in range(found):
            identity_spot[identities + place] = spot
        identities += found
    return identities


@numba.njit(nogil=True)
def second_votes_kernel(
    identity_spot: IntArray,
    identity_star: IntArray,
    identities: int,
    unit_vectors: FloatArray,
    lowest: FloatArray,
    highest: FloatArray,
    work_limit: FloatArray,
    fits: npt.NDArray[np.bool_],
    support: IntArray,
    counts: CountArray,
) -> bool:
    """The second vote: fits[h, g] where the angle of two identities fits that of their spots.

    support[h]: how many fit h. False when the limit of work came first.
    """
    for h in range(identities):
        support[h] = 0
        fits[h, h] = False
    for h in range(identities):
        if exhausted_kernel(counts, work_limit):
            return False
        i = identity_spot[h]
        one = identity_star[h]
        for g in range(h + 1, identities):
            j = identity_spot[g]
            other = identity_star[g]
            fit = False
            if i != j and one != other:
                counts[CATALOGUE_ANGLES] += 1
                cosine = (
                    unit_vectors[one, 0] * unit_vectors[other, 0]
                    + unit_vectors[one, 1] * unit_vectors[other, 1]
                    + unit_vectors[one, 2] * unit_vectors[other, 2]
                )
                fit = lowest[i, j] <= cosine <= highest[i, j]
            fits[h, g] = fits[g, h] = fit
            if fit:
                support[h] += 1
                support[g] += 1
                counts[VOTES] += 2
    return True


@numba.njit(nogil=True)
def grow_cluster_kernel(
    seed: int,
    order: IntArray,
    identities: int,
    fits: npt.NDArray[np.bool_],
    cluster: IntArray,
    counts: CountArray,
) -> int:
    """The cluster about an identity: those that fit all its members, in the given order; its size."""
    cluster[0] = seed
    members = 1
    for place in range(identities):
        identity = order[place]
        fitting = True
        for member in range(members):
            counts[VOTES] += 1
            if not fits[identity, cluster[member]]:
                fitting = False
                break
        if fitting and members < len(cluster):
            cluster[members] = identity
            members += 1
    return members


@numba.njit(nogil=True)
def _same_solution(
    q: FloatArray, star_index: IntArray, other_q: FloatArray, other_index: IntArray, least_angle_rad: float
) -> bool:
    """Whether two solutions name no spot differently and their attitudes are closer than the angle."""
    for spot in range(len(star_index)):
        one, other = star_index[spot], other_index[spot]
        if one >= 0 and other >= 0 and one != other:
            return False
    turn = q[0] * other_q[0] + q[1] * other_q[1] + q[2] * other_q[2] + q[3] * other_q[3]
    # 1 - |turn| = (angle / 2)^2 / 2
    return 2.0 * math.sqrt(max(0.0, 2.0 * (1.0 - abs(turn)))) < least_angle_rad


@numba.njit(nogil=True)
def _voting_kernel(
    b: FloatArray,
    magnitudes: FloatArray,
    stars: StarArrays,
    pairs: PairArrays,
    tolerance_rad: float,
    max_spots: int,
    min_stars: int,
    normals: FloatArray,
    least_seen_share: float,
    magnitude_tolerance: float,
    most_false_solutions: float,
    most_false_triangles: float,
    certain_false_solutions: float,
    work_limit: FloatArray,
    star_index: IntArray,
    q: FloatArray,
    counts: CountArray,
) -> tuple[int, int, int, int, float]:
    """(outcome, matched, expected, seen, false solutions); the solution in star_index[n] and q[4]."""
    unit_vectors, hp_mag, band_height_rad, band_first_cell, cell_start, cell_star = stars
    all_spots = len(b)
    most_spots = min(all_spots, max(max_spots, MOST_SPOTS))
    spread = spread_kernel(b, all_spots)
    # A roll may differ by the tolerance over the spread.
    least_angle = 4.0 * tolerance_rad / min(1.0, max(spread, 0.01))
    lowest = np.empty((most_spots, most_spots))
    highest = np.empty((most_spots, most_spots))
    votes = np.zeros((most_spots, len(unit_vectors)), np.int32)
    identity_spot = np.empty(most_spots * MOST_IDENTITIES, np.int32)
    identity_star = np.empty(most_spots * MOST_IDENTITIES, np.int32)
    cluster = np.empty(most_spots, np.int32)
    trial_index = np.empty(all_spots, np.int32)
    trial_q = np.empty(4)
    best_matched = best_expected = best_seen = 0
    best_chance = math.inf
    rivals = False  # among those of fewer than min_stars
    limited = False
    voted = 0
    runners_up = False
    while not runners_up:
        runners_up = voted == most_spots
        spots = min(most_spots, max_spots if voted == 0 else 2 * voted)
        if not runners_up:
            if not cast_votes_kernel(
                b, voted, spots, tolerance_rad, pairs, work_limit, lowest, highest, votes, counts
            ):
                limited = True
                break
            voted = spots
        identities = identities_kernel(
            votes, spots, runners_up, work_limit, identity_spot, identity_star, counts
        )
        if identities < 0:
            limited = True
            break
        support = np.empty(identities, np.int32)
        fits = np.empty((identities, identities), np.bool_)
        if not second_votes_kernel(
            identity_spot,
            identity_star,
            identities,
            unit_vectors,
            lowest,
            highest,
            work_limit,
            fits,
            support,
            counts,
        ):
            limited = True
            break
        order = np.argsort(-support, kind="mergesort").astype(np.int32)
        clustered = np.zeros(identities, np.bool_)
        for place in range(identities):
            seed = order[place]
            if support[seed] < 2:
                break
            if clustered[seed]:
                continue
            if exhausted_kernel(counts, work_limit):
                limited = True
                break
            members = grow_cluster_kernel(seed, order, identities, fits, cluster, counts)
            if members < 3:
                continue
            for spot in range(all_spots):
                trial_index[spot] = -1
            for member in range(members):
                clustered[cluster[member]] = True
                trial_index[identity_spot[cluster[member]]] = identity_star[cluster[member]]
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
                3,
                normals,
                least_seen_share,
                magnitude_tolerance,
                trial_index,
                counts,
            )
            if matched == 0 or (matched < min_stars and best_matched >= min_stars):
                continue
            chance = false_solutions_kernel(len(unit_vectors), all_spots, matched, spread, tolerance_rad)
            if chance > (most_false_solutions if matched >= min_stars else most_false_triangles):
                continue
            if best_matched > 0 and (matched >= min_stars) == (best_matched >= min_stars):
                same = _same_solution(q, star_index, trial_q, trial_index, least_angle)
                # A rival stands unless one of the two is certain; of those of too few stars none is.
                if not same and matched < min_stars:
                    rivals = True
                elif not same and min(chance, best_chance) > certain_false_solutions:
                    return _AMBIGUOUS, 0, 0, 0, math.inf
                if chance >= best_chance:
                    continue
            best_matched, best_expected, best_seen = matched, expected, seen
            best_chance = chance
            for spot in range(all_spots):
                star_index[spot] = trial_index[spot]
            for m in range(4):
                q[m] = trial_q[m]
            if matched >= min_stars and chance <= certain_false_solutions:
                return _SOLVED, best_matched, best_expected, best_seen, best_chance
        if limited:
            break
    if best_matched >= min_stars:
        return _SOLVED, best_matched, best_expected, best_seen, best_chance
    if limited:
        return _WORK_LIMIT, 0, 0, 0, math.inf
    if best_matched == 0:
        return _NO_MATCH, 0, 0, 0, math.inf
    if rivals:
        return _AMBIGUOUS, 0, 0, 0, math.inf
    return _UNCONFIRMED, best_matched, best_expected, best_seen, best_chance
