"""Adaptive threshold along a zigzag scan, and run-length clustering.

Paper M, section 2.1: pixels over the local background (a moving average along a zigzag scan) plus tau_pre
are kept, coded as runs, and runs that touch make a cluster.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = [
    "BLOCK_PX",
    "CLUSTER_FIELDS",
    "RUN_FIELDS",
    "join_pieces",
    "join_runs",
    "sum_clusters",
    "threshold_scan",
]

# The moving average is brought up to date once in this many pixels: a burst of the image sensor's DMA.
# ASSUMED: paper M does not say how often; within 32 px the background of a sky image does not change.
BLOCK_PX = 32

# Two pixels of a word are compared at once with a limit below this.
HALF_RANGE_DN = 0x7FFF

RUN_FIELDS = 3  # row, first column, end column (half-open): int32[runs, 3]

# float64[clusters, CLUSTER_FIELDS]
PIXELS, SUM, SUM_X, SUM_Y, PEAK, BACKGROUND, FIRST_X, LAST_X, FIRST_Y, LAST_Y = range(10)
CLUSTER_FIELDS = 10


@numba.njit(nogil=True)
def threshold_scan(
    image: NDArray[np.uint16],
    background_dn: float,
    over_dn: float,
    average_pixels: int,
    runs: NDArray[np.int32],
    run_background: NDArray[np.float64],
    row_start: NDArray[np.int32],
) -> tuple[int, bool, int]:
    """Runs of pixels over (moving average + ``over_dn``). Returns (runs, overflowed, pixels looked at again).

    Rows are scanned alternately to the right and to the left (zigzag), so that the average never jumps
    across the image. It starts at ``background_dn`` and moves, block by block of ``BLOCK_PX`` pixels, by
    (block's mean - average) * BLOCK_PX / ``average_pixels``; a pixel over the threshold counts as the
    threshold itself, so that a star hardly lifts the average but a step of the background is followed.
    ``runs``: ``int32[capacity, RUN_FIELDS]``, filled row by row, left to right; ``run_background``:
    ``float64[capacity]``, the average where the run begins; ``row_start``: ``int32[rows + 1]``.
    When the table is full the scan stops: rows below hold no runs. A block is looked at pixel by pixel where
    one of it is over the threshold, or over half of what 16 bits hold.
    """
    rows, columns = image.shape
    blocks = (columns + BLOCK_PX - 1) // BLOCK_PX
    averages = np.empty(blocks, np.float64)
    limits = np.empty(blocks, np.int64)
    over = np.empty(blocks, np.bool_)
    average = background_dn
    gain = 1.0 / max(average_pixels, BLOCK_PX)
    count = 0
    looked_at = 0
    capacity = runs.shape[0]
    for row in range(rows):
        row_start[row] = count
        line = image[row]
        any_over = False
        for step in range(blocks):
            block = step if row % 2 == 0 else blocks - 1 - step
            first = block * BLOCK_PX
            end = min(first + BLOCK_PX, columns)
            total = np.uint32(0)
            largest = np.uint16(0)
            for column in range(first, end):
                value = line[column]
                total = np.uint32(total + value)
                largest = max(largest, value)
            # value > average + over  <=>  value > floor(average + over), for whole numbers
            limit = int(np.floor(average + over_dn))
            averages[block] = average
            limits[block] = limit
            over[block] = largest > limit
            if largest > min(limit, HALF_RANGE_DN):
                looked_at += end - first
            if over[block]:
                any_over = True
                excess = 0
                for column in range(first, end):
                    if line[column] > limit:
                        excess += line[column] - limit
                average += (float(total) - excess - (end - first) * average) * gain
            else:
                average += (float(total) - (end - first) * average) * gain
        if not any_over:
            continue
        inside = False
        for block in range(blocks):
            first = block * BLOCK_PX
            if not over[block]:
                if inside:
                    runs[count - 1, 2] = first
                    inside = False
                continue
            limit = limits[block]
            for column in range(first, min(first + BLOCK_PX, columns)):
                if line[column] > limit:
                    if not inside:
                        if count == capacity:
                            for rest in range(row + 1, rows + 1):
                                row_start[rest] = count
                            return count, True, looked_at
                        runs[count, 0] = row
                        runs[count, 1] = column
                        run_background[count] = averages[block]
                        count += 1
                        inside = True
                elif inside:
                    runs[count - 1, 2] = column
                    inside = False
        if inside:
            runs[count - 1, 2] = columns
    row_start[rows] = count
    return count, False, looked_at


@numba.njit(nogil=True)
def _root(parent: NDArray[np.int32], run: int) -> int:
    while parent[run] != run:
        parent[run] = parent[parent[run]]  # path halving
        run = parent[run]
    return run


@numba.njit(nogil=True)
def join_runs(
    runs: NDArray[np.int32], count: int, row_start: NDArray[np.int32], label: NDArray[np.int32]
) -> tuple[int, int]:
    """Label the first ``count`` runs by 8-connected cluster. Returns (clusters, unions).

    ``runs`` row by row, left to right; ``row_start``: ``int32[rows + 1]``. ``label``: ``int32[>= count]``,
    filled with 0 .. clusters - 1 in order of each cluster's first run. One pass over pairs of rows;
    union-find with the smaller index as root.
    """
    for run in range(count):
        label[run] = run
    unions = 0
    for row in range(1, row_start.shape[0] - 1):
        above, above_end = row_start[row - 1], row_start[row]
        run, run_end = row_start[row], row_start[row + 1]
        while above < above_end and run < run_end:
            # half-open ends: equality means that the runs touch at a corner
            if runs[above, 1] <= runs[run, 2] and runs[run, 1] <= runs[above, 2]:
                a = _root(label, above)
                b = _root(label, run)
                if a != b:
                    unions += 1
                    if a < b:
                        label[b] = a
                    else:
                        label[a] = b
            if runs[above, 2] < runs[run, 2]:
                above += 1
            else:
                run += 1
    clusters = 0
    for run in range(count):
        # roots have the smallest index, so a run's root is already renumbered when the run is reached
        if label[run] == run:
            label[run] = clusters
            clusters += 1
        else:
            label[run] = label[label[run]]
    return clusters, unions


@numba.njit(nogil=True)
def join_pieces(
    runs: NDArray[np.int32],
    count: int,
    row_start: NDArray[np.int32],
    label: NDArray[np.int32],
    clusters: int,
    gap_px: int,
) -> tuple[int, int]:
    """Join clusters with no more than ``gap_px`` pixels between them, on either axis: the pieces of a streak
    whose light is about the threshold. Returns (clusters, runs compared).

    ``label``: as ``join_runs`` has left it, renumbered here in the same order.
    """
    parent = np.arange(clusters).astype(np.int32)
    compared = 0
    rows = row_start.shape[0] - 1
    for row in range(rows):
        for run in range(row_start[row], row_start[row + 1]):
            first, end = runs[run, 1], runs[run, 2]
            # the rows above, and of its own those to the left
            for other in range(row_start[max(row - gap_px - 1, 0)], run):
                compared += 1
                if runs[other, 1] - end <= gap_px and first - runs[other, 2] <= gap_px:
                    a = _root(parent, label[other])
                    b = _root(parent, label[run])
                    if a < b:
                        parent[b] = a
                    else:
                        parent[a] = b
    number = np.empty(clusters, np.int32)
    left = 0
    for cluster in range(clusters):
        # roots have the smallest index
        if parent[cluster] == cluster:
            number[cluster] = left
            left += 1
        else:
            number[cluster] = number[_root(parent, cluster)]
    for run in range(count):
        label[run] = number[label[run]]
    return left, compared


@numba.njit(nogil=True)
def sum_clusters(
    image: NDArray[np.uint16],
    runs: NDArray[np.int32],
    count: int,
    run_background: NDArray[np.float64],
    label: NDArray[np.int32],
    clusters: int,
) -> NDArray[np.float64]:
    """Pixels, background-subtracted sums, peak and bounding box of each cluster.

    Returns ``float64[clusters, CLUSTER_FIELDS]``; the columns are named by the constants of this module.
    BACKGROUND is that of the cluster's first run, and is subtracted from all of its pixels.
    """
    table = np.zeros((clusters, CLUSTER_FIELDS), np.float64)
    for cluster in range(clusters):
        table[cluster, PIXELS] = 0.0
        table[cluster, FIRST_X] = 1e9
        table[cluster, FIRST_Y] = 1e9
        table[cluster, LAST_X] = -1.0
        table[cluster, LAST_Y] = -1.0
    for run in range(count):
        entry = table[label[run]]
        row, first, end = runs[run, 0], runs[run, 1], runs[run, 2]
        if entry[PIXELS] == 0.0:
            entry[BACKGROUND] = run_background[run]
        background = entry[BACKGROUND]
        total = 0.0
        total_x = 0.0
        peak = entry[PEAK]
        for column in range(first, end):
            value = float(image[row, column]) - background
            total += value
            total_x += value * column
            peak = max(peak, value)
        entry[PIXELS] += end - first
        entry[SUM] += total
        entry[SUM_X] += total_x
        entry[SUM_Y] += total * row
        entry[PEAK] = peak
        entry[FIRST_X] = min(entry[FIRST_X], first)
        entry[LAST_X] = max(entry[LAST_X], end - 1)
        entry[FIRST_Y] = min(entry[FIRST_Y], row)
        entry[LAST_Y] = max(entry[LAST_Y], row)
    return table
