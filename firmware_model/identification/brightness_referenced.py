"""Brightness-referenced: which of two spikes is the brighter one halves the search for their stars.

Zhang et al. 2014, "A Brightness-Referenced Star Identification Algorithm for APS Star Trackers", section 4.
In the pair catalogue (10) each pair has its brighter star in I and its dimmer one in J. The range (13)-(14)
of the angle between a bright spike, the pivot, and a dim one therefore has the pivot's star among its I
alone; the ranges of several dim partners have it in common. Reference (three-star) mode, while the pivot is
brighter than M_t: two partners, and only pairs whose I is brighter than M_t. Four-star mode else: the three
dimmest of the spikes that are left. A spike's intensity serves for the order (9) and for M_t, never for the
star's magnitude.

What is different here, and why:
- The ranges are read shortest first, and the last of a group only if the others leave nothing: a candidate
  of two ranges is confirmed by the angle between the two partners, and the final judgement
  (judgement.py) then asks for the third partner, and every other spike, at its very place. That is
  stricter than the intersection with the third range, and cheaper.
- Ranges of an earlier group stay marked. A later partner meets all of them, so that two true partners of one
  pivot suffice wherever they are in the order, and each range is read but once or twice.
- ASSUMED: in reference mode a pivot meets its three dimmest partners only, not all. If one spike is false
  two of the three are true, and if the pivot is no reference star further ranges are read in vain; four-star
  mode tries them all in any case.
- ASSUMED, where the paper gives up: after the pivot's last group the next brightest spike is the pivot; and
  after the last pivot all is done once more with either spike of a pair as the brighter one, since with few
  stars a brightness that is wrong by more than gamma spoils every group.
- The paper takes an intersection of one star as right (its table 3 has bad matches). Here nothing is right
  before the final judgement, and a rival attitude makes an image ambiguous.
- Three stars: a triangle that fits at one place of the sky only is identified but UNCONFIRMED. ASSUMED: of
  four spikes too, where no star fits the fourth, as one may be false.
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
    CANDIDATES_MARKED,
    KVECTOR_HITS,
    KVECTOR_QUERIES,
    MAGNITUDES_COMPARED,
    MARKS_SCATTERED,
    MARKS_STAMPED,
    THIRD_SIDES,
    TRIADS_TESTED,
    TRIANGLES_TESTED,
    CountArray,
    exhausted_kernel,
    first_counts,
    scattered_kernel,
    spread_kernel,
    work_of,
)
from .solutions import (
    CONFIRMED,
    LIMIT,
    MATCHED,
    NOTHING,
    Limits,
    Solutions,
    best_identification,
    judge_kernel,
    limits_of,
    no_solutions,
    volume_kernel,
)

_GROUP = 3  # partners of a pivot that are tried together

_Marks = tuple[IntArray, IntArray, IntArray, IntArray, IntArray]
_Windows = tuple[FloatArray, FloatArray]


def identify(
    spikes: Spikes, catalogue: StarTables, parameters: IdentificationParameters
) -> tuple[Identification, Work]:
    """Identify spikes by the brightness-referenced algorithm; see `IdentificationAlgorithm`."""
    usable, places = usable_spikes(spikes)
    spots = len(usable)
    counts = first_counts(len(spikes))
    if spots < 3:
        return no_identification(len(spikes), Reason.TOO_FEW_STARS), work_of(counts)
    limit_mag = float(parameters.brightness.bright_limit_mag)
    solutions = no_solutions(spots)
    outcome = _search_kernel(
        usable.b_vectors,
        usable.magnitudes,
        star_arrays(catalogue.catalogue),
        pair_arrays(catalogue.pairs),
        pair_arrays(catalogue.reference_pairs(limit_mag)),
        limits_of(parameters, catalogue.pairs),
        int(parameters.max_spots),
        float(parameters.brightness.distinct_mag),
        limit_mag,
        solutions,
        counts,
    )
    _count_marks_kernel(len(catalogue.catalogue), counts)
    found = best_identification(outcome, spots, solutions)
    return for_all_spikes(found, places, len(spikes)), work_of(counts)


@numba.njit(nogil=True)
def _window_kernel(
    i: int, j: int, b: FloatArray, tolerance_rad: float, windows: _Windows, counts: CountArray
) -> None:
    """Cosines that fit the angle of spikes i and j, (14); computed once and kept."""
    lowest, highest = windows
    if not math.isnan(lowest[i, j]):
        return
    dx = b[i, 0] - b[j, 0]
    dy = b[i, 1] - b[j, 1]
    dz = b[i, 2] - b[j, 2]
    angle = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(dx * dx + dy * dy + dz * dz)))
    counts[ANGLES_COMPUTED] += 1
    lowest[i, j] = lowest[j, i] = math.cos(min(math.pi, angle + tolerance_rad))
    highest[i, j] = highest[j, i] = math.cos(max(0.0, angle - tolerance_rad))


@numba.njit(nogil=True)
def _count_marks_kernel(stars: int, counts: CountArray) -> None:
    """What all marks so far are for a processor: a mark is a star's last entry and its pivot, two words."""
    counts[MARKS_STAMPED] = counts[CANDIDATES_MARKED]
    counts[MARKS_SCATTERED] = scattered_kernel(counts[CANDIDATES_MARKED], 2 * stars)


@numba.njit(nogil=True)
def _mark_kernel(
    place: int,
    ends: int,
    spot: int,
    pairs: PairArrays,
    hp_mag: npt.NDArray[np.float32],
    pivot_limit_mag: float,
    serial: int,
    used: int,
    marks: _Marks,
    counts: CountArray,
) -> int:
    """Mark the pivot's candidates of one pair with partner `spot`; returns the entries used by then.

    ends: 1, the pivot is the brighter star of the pair; 2, it may be either.
    """
    _, brighter, dimmer, _, _, _ = pairs
    head, stamp, chain, partner_star, partner_spot = marks
    for turned in range(ends):
        star = brighter[place] if turned == 0 else dimmer[place]
        if turned == 1 and pivot_limit_mag < math.inf:
            counts[MAGNITUDES_COMPARED] += 1
            if not hp_mag[star] < pivot_limit_mag:
                continue
        counts[CANDIDATES_MARKED] += 1
        chain[used] = head[star] if stamp[star] == serial else -1
        partner_star[used] = dimmer[place] if turned == 0 else brighter[place]
        partner_spot[used] = spot
        head[star] = used
        stamp[star] = serial
        used += 1
    return used


@numba.njit(nogil=True)
def _meet_kernel(
    place: int,
    ends: int,
    pivot: int,
    spot: int,
    volume_of: FloatArray,
    b: FloatArray,
    magnitudes: FloatArray,
    spread: float,
    stars: StarArrays,
    pairs: PairArrays,
    limits: Limits,
    serial: int,
    marks: _Marks,
    windows: _Windows,
    trial_index: IntArray,
    trial_q: FloatArray,
    solutions: Solutions,
    counts: CountArray,
) -> int:
    """Candidates of one pair that earlier ranges of the pivot have too, and what becomes of them."""
    _, brighter, dimmer, _, _, _ = pairs
    head, stamp, chain, partner_star, partner_spot = marks
    unit_vectors = stars[0]
    lowest, highest = windows
    star_index, _, numbers, _ = solutions
    for turned in range(ends):
        star = brighter[place] if turned == 0 else dimmer[place]
        other = dimmer[place] if turned == 0 else brighter[place]
        counts[CANDIDATES_MARKED] += 1
        entry = head[star] if stamp[star] == serial else -1
        while entry >= 0:
            earlier, earlier_spot = partner_star[entry], partner_spot[entry]
            entry = chain[entry]
            counts[TRIANGLES_TESTED] += 1
            if earlier == other or earlier_spot == spot:  # the latter marked while this range is read
                continue
            counts[THIRD_SIDES] += 1
            _window_kernel(earlier_spot, spot, b, limits[0], windows, counts)
            cosine = (
                unit_vectors[earlier, 0] * unit_vectors[other, 0]
                + unit_vectors[earlier, 1] * unit_vectors[other, 1]
                + unit_vectors[earlier, 2] * unit_vectors[other, 2]
            )
            if not lowest[earlier_spot, spot] <= cosine <= highest[earlier_spot, spot]:
                continue
            if math.isnan(volume_of[earlier_spot]):
                volume_of[earlier_spot] = volume_kernel(b, pivot, earlier_spot, spot)
            volume = volume_of[earlier_spot]
            mirror = volume_kernel(unit_vectors, star, earlier, other)
            # A triangle so flat that the tolerance can turn it over has no handedness.
            longest = min(lowest[pivot, spot], min(lowest[pivot, earlier_spot], lowest[earlier_spot, spot]))
            flat = 2.0 * limits[0] * math.acos(max(-1.0, min(1.0, longest)))
            if volume * mirror < 0.0 and min(abs(volume), abs(mirror)) > flat:
                continue
            known = False
            for kept in range(2):
                known = known or (
                    numbers[kept, MATCHED] > 0
                    and star_index[kept, pivot] == star
                    and star_index[kept, earlier_spot] == earlier
                    and star_index[kept, spot] == other
                )
            if known:
                continue  # a solution already found, once more
            if exhausted_kernel(counts, limits[8]):
                return LIMIT
            trial_index[:] = -1
            trial_index[pivot] = star
            trial_index[earlier_spot] = earlier
            trial_index[spot] = other
            outcome = judge_kernel(
                b, magnitudes, spread, stars, limits, trial_index, trial_q, solutions, counts
            )
            if outcome != NOTHING:
                return int(outcome)
    return NOTHING


@numba.njit(nogil=True)
def _group_kernel(
    pivot: int,
    left: int,
    group_spot: IntArray,
    b: FloatArray,
    tolerance_rad: float,
    windows: _Windows,
    counts: CountArray,
) -> int:
    """The pivot's next partners, the three dimmest of those left, nearest first; how many there are."""
    lowest, _ = windows
    size = min(_GROUP, left)
    for member in range(size):
        spot = left - member + pivot
        _window_kernel(pivot, spot, b, tolerance_rad, windows, counts)
        slot = member
        while slot > 0 and lowest[pivot, group_spot[slot - 1]] < lowest[pivot, spot]:
            group_spot[slot] = group_spot[slot - 1]
            slot -= 1
        group_spot[slot] = spot
    return size


@numba.njit(nogil=True)
def _search_kernel(
    b: FloatArray,
    magnitudes: FloatArray,
    stars: StarArrays,
    all_pairs: PairArrays,
    reference_pairs: PairArrays,
    limits: Limits,
    max_spots: int,
    distinct_mag: float,
    bright_limit_mag: float,
    solutions: Solutions,
    counts: CountArray,
) -> int:
    """How the search ended; the solutions in their arrays.

    Rounds: 0 reference mode, 1 four-star mode, 2 without the order of brightness. In each the pivots from
    the brightest on, and for each its partners from the dimmest on, in groups of two or three.
    """
    numbers = solutions[2]
    spots = min(len(b), max_spots)
    catalogued = len(stars[0])
    spread = spread_kernel(b, len(b))
    windows = (np.full((spots, spots), np.nan), np.full((spots, spots), np.nan))
    lowest, highest = windows
    # Ranges of the whole list, (13), kept for the last round; and those of a group.
    range_first = np.full((spots, spots), -1, np.int32)
    range_end = np.full((spots, spots), -1, np.int32)
    group_spot = np.empty(_GROUP, np.int32)
    # Mark table: the chain of a star's entries is of this pivot where its stamp is, so nothing is cleared.
    head = np.zeros(catalogued, np.int32)
    stamp = np.zeros(catalogued, np.int32)
    chain = np.empty(256, np.int32)
    partner_star = np.empty(256, np.int32)
    partner_spot = np.empty(256, np.int32)
    volume_of = np.empty(spots)
    trial_index = np.empty(len(b), np.int32)
    trial_q = np.empty(4)
    serial = 0
    ordered = False
    for round_ in range(3):
        if round_ == 0 and len(b) < 4:
            continue
        if round_ == 2 and (not ordered or numbers[CONFIRMED, MATCHED] > 0):
            break
        pairs = reference_pairs if round_ == 0 else all_pairs
        pivot_limit_mag = bright_limit_mag if round_ == 0 else math.inf
        for pivot in range(spots - 2):
            if round_ == 0:
                counts[MAGNITUDES_COMPARED] += 1
                if not magnitudes[pivot] < bright_limit_mag:
                    break
            serial += 1
            used = 0
            joined = 0
            waiting, waiting_first, waiting_end, waiting_ends = -1, 0, 0, 0  # a range not marked yet
            left = spots - 1 - pivot
            while left > 0:
                brightest = pivot + 1 + max(0, left - _GROUP)
                if round_ < 2:
                    counts[MAGNITUDES_COMPARED] += 1
                # Spikes come brightest first: what holds for the group's brightest holds for all of it.
                distinct = round_ < 2 and magnitudes[brightest] - magnitudes[pivot] > distinct_mag
                size = _group_kernel(pivot, left, group_spot, b, limits[0], windows, counts)
                left = left - size if round_ > 0 else 0  # one group alone in reference mode
                for member in range(size):
                    spot = group_spot[member]
                    if round_ == 0 or range_first[pivot, spot] < 0:
                        counts[KVECTOR_QUERIES] += 1
                        first, end, _ = range_kernel(
                            pairs[0],
                            pairs[3],
                            pairs[4],
                            pairs[5],
                            lowest[pivot, spot],
                            highest[pivot, spot],
                        )
                        if round_ > 0:
                            range_first[pivot, spot] = first
                            range_end[pivot, spot] = end
                    else:
                        first, end = range_first[pivot, spot], range_end[pivot, spot]
                    if end <= first:
                        continue
                    _count_marks_kernel(catalogued, counts)
                    if exhausted_kernel(counts, limits[8]):
                        return LIMIT
                    ends = 2
                    if round_ < 2 and not distinct:
                        counts[MAGNITUDES_COMPARED] += 1
                    if round_ < 2 and (distinct or magnitudes[spot] - magnitudes[pivot] > distinct_mag):
                        ends = 1
                        ordered = True
                    room = 2 * (waiting_end - waiting_first + end - first)
                    if used + room > len(chain):
                        chain = _longer(chain, used, room)
                        partner_star = _longer(partner_star, used, room)
                        partner_spot = _longer(partner_spot, used, room)
                    marks = (head, stamp, chain, partner_star, partner_spot)
                    if waiting >= 0:
                        counts[KVECTOR_HITS] += waiting_end - waiting_first
                        for place in range(waiting_first, waiting_end):
                            used = _mark_kernel(
                                place,
                                waiting_ends,
                                waiting,
                                pairs,
                                stars[1],
                                pivot_limit_mag,
                                serial,
                                used,
                                marks,
                                counts,
                            )
                        waiting, waiting_first, waiting_end = -1, 0, 0
                    if used > 0:
                        counts[TRIADS_TESTED] += 1
                        volume_of[:] = np.nan
                        for step in range(end - first):
                            # From the middle outwards: the true pair is the likeliest there, and may end it.
                            aside = (step + 1) // 2
                            place = (first + end) // 2 + (aside if step % 2 == 0 else -aside)
                            counts[KVECTOR_HITS] += 1
                            outcome = _meet_kernel(
                                place,
                                ends,
                                pivot,
                                spot,
                                volume_of,
                                b,
                                magnitudes,
                                spread,
                                stars,
                                pairs,
                                limits,
                                serial,
                                marks,
                                windows,
                                trial_index,
                                trial_q,
                                solutions,
                                counts,
                            )
                            if outcome != NOTHING:
                                return outcome
                            if joined > 0 and (member < size - 1 or left > 0):
                                used = _mark_kernel(
                                    place,
                                    ends,
                                    spot,
                                    pairs,
                                    stars[1],
                                    pivot_limit_mag,
                                    serial,
                                    used,
                                    marks,
                                    counts,
                                )
                        joined += 1
                    # The first two ranges are marked when a third one needs them, later ones at once.
                    if joined < 2:
                        waiting, waiting_first, waiting_end, waiting_ends = (
                            spot,
                            first,
                            end,
                            ends,
                        )
    return NOTHING


@numba.njit(nogil=True)
def _longer(values: IntArray, used: int, room: int) -> IntArray:
    """The same values with room for at least so many more."""
    longer = np.empty(2 * (used + room), np.int32)
    longer[:used] = values[:used]
    return longer
