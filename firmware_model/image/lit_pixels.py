"""Lit pixels and stars of a whole image, for the optical flow: where each star of one frame is in the next.

Fasano et al., "Optical flow-based angular rate", Sensors 13 (2013), section 2.1 (paper F): one threshold for
the whole image, mean + 3 sigma; what is under it is zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from ..work import Work
from .clustering import (
    FIRST_X,
    FIRST_Y,
    LAST_X,
    LAST_Y,
    PEAK,
    PIXELS,
    RUN_FIELDS,
    SUM,
    SUM_X,
    SUM_Y,
    join_runs,
    sum_clusters,
)
from .detection import sorting_work

__all__ = ["DN_PARTS", "FlowFrame", "FlowParameters", "light_up"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]

DN_PARTS = 16
"""Values are whole numbers of so many parts of a DN: sums of them and of their products are exact, in any
order and on every machine, and a flight processor adds whole numbers faster than others.
"""

BLOCK_PX = 32
"""A row is compared with the threshold so many pixels at a time."""

CACHED_CLUSTERS = 180
"""Clusters whose sums are still in a data cache of 32 KiB when stars are sought among them. ASSUMED: of 180,
220, 260 and 300 the one that fits the simulated kernel best, on the frames of the fit alone.
"""


@dataclass(frozen=True, slots=True)
class FlowParameters:
    """What the optical flow is tuned by.

    sigma_factor: threshold over the mean of the whole image, in standard deviations of the whole image (F
    section 2.1: 3). min_pixels: stars of fewer lit pixels are dropped (F: 3). max_pixels, max_extent_px:
    clusters beyond are no stars. largest_shift_px: of a star between two frames, on either axis: the largest
    rate. margin_px: the window of the refining centroid is the star's plus this (F: 2). prediction_margin_px:
    where a shift is foreseen, the search is only so far round it (F section 5 proposes such a feedback).
    max_stars: the brightest are followed. max_runs: size of the run table.
    """

    sigma_factor: float = 3.0
    min_pixels: int = 3
    max_pixels: int = 4000
    max_extent_px: int = 160
    largest_shift_px: int = 40
    margin_px: int = 2
    centrings: int = 8
    prediction_margin_px: int = 8
    least_error_px: float = 0.1
    max_stars: int = 60
    max_runs: int = 32768

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)}")


@dataclass(frozen=True, slots=True)
class FlowFrame:
    """The lit pixels of one image and its stars: all that the next frame needs of this one.

    runs: int32[r, 3] (row, first column, end column), row by row, left to right; row_start: int32[rows + 1];
    offsets: int32[r], where the values of a run begin in values: int32[lit], 1/16 DN over the image's mean,
    which is rounded down to 1/16 DN. x_px, y_px, flux_dn: of the stars, brightest first; box: int32[n, 4],
    first and last column, first and last row. mean_dn, sigma_dn: of the whole image. overflowed: more runs
    than the table holds; no stars then.
    """

    width_px: int
    height_px: int
    runs: IntArray
    row_start: IntArray
    offsets: IntArray
    values: IntArray
    x_px: FloatArray
    y_px: FloatArray
    flux_dn: FloatArray
    peak_dn: FloatArray
    pixels: IntArray
    box: IntArray
    mean_dn: float
    sigma_dn: float
    overflowed: bool = False

    def __len__(self) -> int:
        return len(self.x_px)


@numba.njit(nogil=True)
def _statistics(image: NDArray[np.uint16]) -> tuple[float, float]:
    """Mean and standard deviation of all pixels; the sums are whole numbers and exact."""
    total = np.uint64(0)
    squares = np.uint64(0)
    rows, columns = image.shape
    for row in range(rows):
        line_total = np.uint64(0)
        line_squares = np.uint64(0)
        line = image[row]
        for column in range(columns):
            value = np.uint32(line[column])
            line_total += value
            line_squares += np.uint64(value) * np.uint64(value)
        total += line_total
        squares += line_squares
    count = float(rows * columns)
    mean = float(total) / count
    return mean, math.sqrt(max(float(squares) / count - mean * mean, 0.0))


@numba.njit(nogil=True)
def _lit_runs(
    image: NDArray[np.uint16], limit: int, runs: IntArray, row_start: IntArray
) -> tuple[int, bool, int]:
    """Runs of pixels over ``limit``. Returns (runs, overflowed, blocks that have a pixel over it)."""
    count = 0
    blocks = 0
    capacity = runs.shape[0]
    rows, columns = image.shape
    for row in range(rows):
        row_start[row] = count
        line = image[row]
        column = 0
        block = -1
        while column < columns:
            if line[column] <= limit:
                column += 1
                continue
            if count == capacity:
                for rest in range(row + 1, rows + 1):
                    row_start[rest] = count
                return count, True, blocks
            first = column
            while column < columns and line[column] > limit:
                column += 1
            runs[count, 0] = row
            runs[count, 1] = first
            runs[count, 2] = column
            count += 1
            last = (column - 1) // BLOCK_PX
            blocks += last - max(first // BLOCK_PX, block + 1) + 1
            block = last
    row_start[rows] = count
    return count, False, blocks


@numba.njit(nogil=True)
def _values(
    image: NDArray[np.uint16], runs: IntArray, level: int, offsets: IntArray, values: IntArray
) -> None:
    place = 0
    for run in range(runs.shape[0]):
        offsets[run] = place
        for column in range(runs[run, 1], runs[run, 2]):
            values[place] = DN_PARTS * np.int32(image[runs[run, 0], column]) - level
            place += 1


def light_up(image: NDArray[np.uint16], parameters: FlowParameters) -> tuple[FlowFrame, Work]:
    """The lit pixels and the stars of an image ``uint16[rows, columns]``, DN.

    A pixel is lit where it is over mean + ``sigma_factor`` standard deviations of the whole image (F section
    2.1). Lit pixels that touch are one star; its place is the mean of its pixels, weighted by what they have
    over the image's mean. Stars at the very edge are dropped: a part of them may be outside.
    """
    if image.ndim != 2 or image.dtype != np.uint16:
        raise ValueError(f"an image is uint16[rows, columns], not {image.dtype}{list(image.shape)}")
    image = np.ascontiguousarray(image)
    rows, columns = image.shape
    mean, sigma = _statistics(image)
    limit = math.floor(mean + parameters.sigma_factor * sigma)
    runs = np.empty((parameters.max_runs, RUN_FIELDS), np.int32)
    row_start = np.empty(rows + 1, np.int32)
    count, overflowed, blocks = _lit_runs(image, limit, runs, row_start)
    runs = runs[:count].copy()
    lit = int((runs[:, 2] - runs[:, 1]).sum())
    level = math.floor(mean * DN_PARTS)
    offsets, values = np.empty(count, np.int32), np.empty(lit, np.int32)
    _values(image, runs, level, offsets, values)
    label = np.empty(count, np.int32)
    clusters, _ = join_runs(runs, count, row_start, label)
    table = sum_clusters(image, runs, count, np.full(count, level / DN_PARTS), label, clusters)
    wide = np.maximum(table[:, LAST_X] - table[:, FIRST_X], table[:, LAST_Y] - table[:, FIRST_Y]) + 1
    inside = (table[:, FIRST_X] > 0) & (table[:, LAST_X] < columns - 1)
    inside &= (table[:, FIRST_Y] > 0) & (table[:, LAST_Y] < rows - 1)
    fit = (table[:, PIXELS] >= parameters.min_pixels) & (table[:, PIXELS] <= parameters.max_pixels)
    chosen = np.flatnonzero(inside & fit & (wide <= parameters.max_extent_px))
    if overflowed:
        chosen = chosen[:0]
    order = chosen[np.argsort(-table[chosen, SUM], kind="stable")][: parameters.max_stars]
    stars = table[order]
    frame = FlowFrame(
        width_px=columns,
        height_px=rows,
        runs=runs,
        row_start=row_start,
        offsets=offsets,
        values=values,
        x_px=stars[:, SUM_X] / stars[:, SUM],
        y_px=stars[:, SUM_Y] / stars[:, SUM],
        flux_dn=stars[:, SUM].copy(),
        peak_dn=stars[:, PEAK].copy(),
        pixels=stars[:, PIXELS].astype(np.int32),
        box=np.ascontiguousarray(stars[:, [FIRST_X, LAST_X, FIRST_Y, LAST_Y]].astype(np.int32)),
        mean_dn=mean,
        sigma_dn=sigma,
        overflowed=overflowed,
    )
    work = Work(
        {
            "flow_pixels": rows * columns,
            "lit_blocks": blocks,
            "lit_pixels": lit,
            "clusterings": 1,
            "run_tables": 1,
            "cold_runs": count,
            "runs": count,
            "rows_joined": rows,
            "cluster_pixels": lit,
            "clusters": clusters,
            "flow_clusters": clusters,
            "cold_clusters": max(clusters - CACHED_CLUSTERS, 0),
            "flow_stars_sorted": sorting_work(len(chosen)),
            "flow_stars": len(order),
        }
    )
    return frame, work
