"""Solutions found so far, and what a further one means: better, the same, or a rival.

For searches that go on after a first solution: `judge_kernel` gives a trial to the final judgement
(verification.py) and keeps it if it is the best. Two are kept, of different worth: a confirmed one, and of
images of 3 or 4 spikes a triangle alone (UNCONFIRMED).
"""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from ..catalogue.pairs import PairCatalogue
from ..catalogue.tables import StarArrays
from ..reasons import Reason
from .interface import FloatArray, Identification, IdentificationParameters, IntArray, no_identification
from .verification import (
    CountArray,
    false_solutions_kernel,
    refine_kernel,
    separation_kernel,
    verify_kernel,
)

NOTHING, CERTAIN, RIVAL, LIMIT = range(4)  # how a search ends, or that it goes on
CONFIRMED, TRIANGLE = range(2)  # places of the two solutions
MATCHED, EXPECTED, SEEN, RIVALS = range(4)  # places in their numbers
MOST_TRIANGLE_SPOTS = 4  # images of more spikes need a confirmed solution

# IdentificationParameters from tolerance_rad to work_limit, then `separation_kernel`'s angle
Limits = tuple[float, int, FloatArray, float, float, float, float, float, FloatArray, float]
# star_index[2, n], q[2, 4], numbers[2, 4], chance[2]
Solutions = tuple[IntArray, FloatArray, npt.NDArray[np.int64], FloatArray]


def limits_of(parameters: IdentificationParameters, pairs: PairCatalogue) -> Limits:
    """The limits of a search in these pairs."""
    return (
        float(parameters.tolerance_rad),
        int(parameters.min_stars),
        parameters.normals,
        float(parameters.least_seen_share),
        float(parameters.magnitude_tolerance),
        float(parameters.most_false_solutions),
        float(parameters.most_false_triangles),
        float(parameters.certain_false_solutions),
        parameters.work_limit,
        float(separation_kernel(pairs.cos_angle)),
    )


def no_solutions(spots: int) -> Solutions:
    """Room for the solutions of an image of so many spikes."""
    return (
        np.full((2, spots), -1, np.int32),
        np.zeros((2, 4)),
        np.zeros((2, 4), np.int64),
        np.full(2, math.inf),
    )


def best_identification(outcome: int, spots: int, solutions: Solutions) -> Identification:
    """The better of the two solutions, or why there is none, after a search that ended with `outcome`."""
    star_index, q, numbers, chance = solutions
    if outcome == RIVAL:
        return no_identification(spots, Reason.AMBIGUOUS)
    if numbers[CONFIRMED, MATCHED] > 0:
        kept, reason = CONFIRMED, Reason.NONE
    elif outcome == LIMIT:
        return no_identification(spots, Reason.WORK_LIMIT)
    elif numbers[TRIANGLE, RIVALS] > 0:
        return no_identification(spots, Reason.AMBIGUOUS)
    elif numbers[TRIANGLE, MATCHED] > 0:
        kept, reason = TRIANGLE, Reason.UNCONFIRMED
    else:
        return no_identification(spots, Reason.NO_MATCH)
    matched, expected, seen, _ = (int(number) for number in numbers[kept])
    return Identification(
        star_index[kept].copy(), matched, reason, q[kept].copy(), float(chance[kept]), expected, seen
    )


@numba.njit(nogil=True)
def volume_kernel(u: FloatArray, i: int, j: int, k: int) -> float:
    """Triple product u_i . (u_j x u_k): its sign is the triangle's handedness."""
    volume: float = (
        u[i, 0] * (u[j, 1] * u[k, 2] - u[j, 2] * u[k, 1])
        + u[i, 1] * (u[j, 2] * u[k, 0] - u[j, 0] * u[k, 2])
        + u[i, 2] * (u[j, 0] * u[k, 1] - u[j, 1] * u[k, 0])
    )
    return volume


@numba.njit(nogil=True)
def rival_kernel(
    kept: int, trial_index: IntArray, trial_q: FloatArray, solutions: Solutions, turn_rad: float
) -> bool:
    """Whether a trial is not the solution kept: another star, or turned by more than turn_rad."""
    star_index, q, _, _ = solutions
    for spot in range(len(trial_index)):
        star = star_index[kept, spot]
        if trial_index[spot] >= 0 and star >= 0 and trial_index[spot] != star:
            return True
    turn = 0.0
    for m in range(4):
        turn += q[kept, m] * trial_q[m]
    # 1 - |turn| = (angle / 2)^2 / 2
    return 2.0 * math.sqrt(max(0.0, 2.0 * (1.0 - abs(turn)))) >= turn_rad


@numba.njit(nogil=True)
def judge_kernel(
    b: FloatArray,
    magnitudes: FloatArray,
    spread: float,
    stars: StarArrays,
    limits: Limits,
    trial_index: IntArray,
    trial_q: FloatArray,
    solutions: Solutions,
    counts: CountArray,
) -> int:
    """The final judgement of a triangle: keep it if it stands and is the best; how the search goes on."""
    unit_vectors, hp_mag, band_height_rad, band_first_cell, cell_start, cell_star = stars
    tolerance_rad, min_stars, normals, least_seen_share, magnitude_tolerance = limits[:5]
    most_false_solutions, most_false_triangles, certain_false_solutions = limits[5:8]
    separation_rad = limits[9]
    star_index, q, numbers, chances = solutions
    spots = len(b)
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
        separation_rad,
        tolerance_rad,
        3 if spots <= MOST_TRIANGLE_SPOTS else min_stars,
        normals,
        least_seen_share,
        magnitude_tolerance,
        trial_index,
        counts,
    )
    if matched == 0:
        return NOTHING
    kept = CONFIRMED if matched >= min_stars else TRIANGLE
    chance = false_solutions_kernel(len(unit_vectors), spots, matched, spread, tolerance_rad)
    if chance > (most_false_solutions if kept == CONFIRMED else most_false_triangles):
        return NOTHING
    if numbers[kept, MATCHED] > 0:
        # A roll may differ by the tolerance over the spread.
        turn_rad = 4.0 * tolerance_rad / min(1.0, max(spread, 0.01))
        if rival_kernel(kept, trial_index, trial_q, solutions, turn_rad):
            # A rival stands unless one of the two is certain.
            if kept == CONFIRMED and min(chance, chances[kept]) > certain_false_solutions:
                return RIVAL
            numbers[kept, RIVALS] += 1
        if chance >= chances[kept]:
            return NOTHING
    for spot in range(spots):
        star_index[kept, spot] = trial_index[spot]
    for m in range(4):
        q[kept, m] = trial_q[m]
    numbers[kept, MATCHED] = matched
    numbers[kept, EXPECTED] = expected
    numbers[kept, SEEN] = seen
    chances[kept] = chance
    return CERTAIN if kept == CONFIRMED and chance <= certain_false_solutions else NOTHING
