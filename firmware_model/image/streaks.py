"""Clusters of a frame with their pixels, and which of them are those of the frame before.

Paper M section 2.3, cluster fusion: the images of one star in two exposures that follow each other without a
gap touch, however fast the star moves; so clusters are paired by the distance between their nearest pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from ..work import Work
from .spots import Spots

__all__ = ["DetectedClusters", "Fusion", "StreakTable", "fuse", "streak_table"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class DetectedClusters:
    """Spots of one full frame, brightest first, and the tables that they were made of.

    cluster: the cluster of each spot. extent: int32[clusters, 4], first and last column, first and last row.
    runs: int32[r, 3], row, first column, end column (half-open), row by row; label: the cluster of each.
    streaks: whether the brightest clusters are longer than stars at rest (looked at with ``piece_gap_px``).
    """

    spots: Spots
    cluster: NDArray[np.intp]
    extent: IntArray
    runs: IntArray
    label: IntArray
    streaks: bool = False


@dataclass(frozen=True, slots=True)
class StreakTable:
    """Spots of one full frame with the pixels that they are made of.

    spots: brightest first. extent: int32[n, 4], first and last column, first and last row of each spot's
    cluster. runs: int32[r, 3], row, first column, end column (half-open), those of one spot together and in
    the order of the spots; run_start: int32[n + 1], where each spot's begin.
    """

    spots: Spots
    extent: IntArray
    runs: IntArray
    run_start: IntArray

    def __len__(self) -> int:
        return len(self.spots)


@dataclass(frozen=True, slots=True)
class Fusion:
    """Pairs of spots that are one star: places in the frame before and in this one, int32[m] each.

    In the order of this frame's spots; no spot is in two pairs.
    """

    before: IntArray
    now: IntArray

    def __len__(self) -> int:
        return len(self.now)


def streak_table(detected: DetectedClusters) -> tuple[StreakTable, Work]:
    """What is kept of a frame's clusters for the frame that follows."""
    count = len(detected.spots)
    spot_of = np.full(len(detected.extent), -1, np.int32)
    spot_of[detected.cluster] = np.arange(count, dtype=np.int32)
    owner = spot_of[detected.label]
    order = np.argsort(owner, kind="stable")
    order = order[np.searchsorted(owner[order], 0) :]
    starts = np.searchsorted(owner[order], np.arange(count + 1)).astype(np.int32)
    work = Work({"runs_sorted": len(owner), "streaks_kept": count, "runs_kept": len(order)})
    return StreakTable(detected.spots, detected.extent[detected.cluster], detected.runs[order], starts), work


def fuse(before: StreakTable, now: StreakTable, distance_px: float) -> tuple[Fusion, Work]:
    """Pair the spots of two frames that follow each other, paper M section 2.3.

    Each spot's partner is the one whose nearest pixel is nearest to one of its own, no further than
    ``distance_px`` between the pixels' centres; of several as near, the one most alike in brightness. Paper M
    looks from the first frame alone; here the two must be each other's nearest, so that the pieces of a
    broken streak do not all go to one star.
    """
    first, second = np.full(len(before), -1, np.int32), np.full(len(now), -1, np.int32)
    tally = np.zeros(3, np.int64)
    _fuse(
        before.extent,
        before.runs,
        before.run_start,
        before.spots.magnitude,
        now.extent,
        now.runs,
        now.run_start,
        now.spots.magnitude,
        float(distance_px),
        first,
        second,
        tally,
    )
    chosen = np.flatnonzero(second >= 0)
    chosen = chosen[first[second[chosen]] == chosen].astype(np.int32)
    work = Work(
        {
            "fusions": 1,
            "boxes_compared": int(tally[0]),
            "boxes_met": int(tally[1]),
            "runs_compared": int(tally[2]),
        }
    )
    return Fusion(second[chosen], chosen), work


@numba.njit(nogil=True)
def _run_distance2(
    a: IntArray,
    a_first: int,
    a_end: int,
    b: IntArray,
    b_first: int,
    b_end: int,
    limit2: int,
    tally: NDArray[np.int64],
) -> int:
    """Square of the distance of the nearest pixels of two sets of runs; over ``limit2`` where none is within.

    Runs of a cluster come row by row.
    """
    best = limit2 + 1
    for i in range(a_first, a_end):
        for j in range(b_first, b_end):
            tally[2] += 1
            down = a[i, 0] - b[j, 0]
            gap = max(a[i, 1] - b[j, 2], b[j, 1] - a[i, 2]) + 1
            across = max(gap, 0)
            best = min(best, across * across + down * down)
        if best == 0:
            break
    return best


@numba.njit(nogil=True)
def _fuse(
    extent_a: IntArray,
    runs_a: IntArray,
    start_a: IntArray,
    magnitude_a: FloatArray,
    extent_b: IntArray,
    runs_b: IntArray,
    start_b: IntArray,
    magnitude_b: FloatArray,
    distance_px: float,
    best_a: IntArray,
    best_b: IntArray,
    tally: NDArray[np.int64],
) -> None:
    """Write the nearest of the other frame of each spot to best_a, best_b (-1: none within the distance).

    tally: boxes compared, boxes that met, runs compared.
    """
    reach = int(distance_px)
    limit2 = int(distance_px * distance_px)
    distance_a = np.full(len(best_a), limit2 + 1, np.int64)
    distance_b = np.full(len(best_b), limit2 + 1, np.int64)
    unlike_a = np.full(len(best_a), np.inf)
    unlike_b = np.full(len(best_b), np.inf)
    for i in range(len(best_a)):
        left, right = extent_a[i, 0] - reach, extent_a[i, 1] + reach
        top, bottom = extent_a[i, 2] - reach, extent_a[i, 3] + reach
        tally[0] += len(best_b)
        for j in range(len(best_b)):
            if extent_b[j, 0] > right or extent_b[j, 1] < left:
                continue
            if extent_b[j, 2] > bottom or extent_b[j, 3] < top:
                continue
            tally[1] += 1
            distance = _run_distance2(
                runs_a, start_a[i], start_a[i + 1], runs_b, start_b[j], start_b[j + 1], limit2, tally
            )
            if distance > limit2:
                continue
            unlike = abs(magnitude_a[i] - magnitude_b[j])
            if distance < distance_a[i] or (distance == distance_a[i] and unlike < unlike_a[i]):
                distance_a[i], unlike_a[i], best_a[i] = distance, unlike, j
            if distance < distance_b[j] or (distance == distance_b[j] and unlike < unlike_b[j]):
                distance_b[j], unlike_b[j], best_b[j] = distance, unlike, i
