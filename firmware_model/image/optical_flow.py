"""Optical flow of stars: where each star of one frame is in the next, without knowing which star it is.

Fasano et al., "Optical flow-based angular rate", Sensors 13 (2013), section 2.1 (paper F). The whole image
has one threshold, mean + 3 sigma; what is under it is zero. Stars of the first image are matched by the
smallest sum of squared differences (SSD) over whole-pixel shifts, then refined by a centroid in the second
image.
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

__all__ = ["FlowFrame", "FlowParameters", "OpticalFlow", "flow_between", "light_up"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]


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
    offsets: int32[r], where the values of a run begin in values_dn: float32[lit], DN over the mean. x_px,
    y_px, flux_dn: of the stars, brightest first; box: int32[n, 4], first and last column, first and last row.
    mean_dn, sigma_dn: of the whole image. overflowed: more runs than the table holds; no stars then.
    """

    width_px: int
    height_px: int
    runs: IntArray
    row_start: IntArray
    offsets: IntArray
    values_dn: NDArray[np.float32]
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


@dataclass(frozen=True, slots=True)
class OpticalFlow:
    """Stars found in both frames: index into the first frame's stars, places in both, px; ssd of the match as
    a share of the star's own energy (0: the same picture, 1: nothing there). length_px: of the lit streak in
    the first frame; noise: of the star's lit pixels over their sum.
    """

    star: IntArray
    x_before_px: FloatArray
    y_before_px: FloatArray
    x_px: FloatArray
    y_px: FloatArray
    mismatch: FloatArray
    length_px: FloatArray
    noise: FloatArray

    def __len__(self) -> int:
        return len(self.star)

    def take(self, index: NDArray[np.intp]) -> OpticalFlow:
        """The stars selected by an index array."""
        return OpticalFlow(
            self.star[index],
            self.x_before_px[index],
            self.y_before_px[index],
            self.x_px[index],
            self.y_px[index],
            self.mismatch[index],
            self.length_px[index],
            self.noise[index],
        )

    def errors_px(self, streak_px: FloatArray, least_px: float) -> tuple[FloatArray, FloatArray]:
        """Expected errors of the shifts along themselves and across, 1 sigma, where the stars' streaks are so
        long.

        Of a streak that is seen shorter the rest lies under the threshold: its middle may be anywhere along
        the whole, in both images. The length must not be taken from the star's own shift, for then one that
        is measured too short would look the better one. least_px: of a centroid at its best.
        """
        missing = np.maximum(streak_px - self.length_px, 0.0)
        floor = 2.0 * least_px * least_px
        turned = np.maximum(streak_px, 1.0)
        along = np.sqrt(floor + missing**2 / 6.0 + (self.noise * turned) ** 2 / 6.0)
        return along, np.sqrt(floor + 2.0 * self.noise**2)


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
def _lit_runs(image: NDArray[np.uint16], limit: int, runs: IntArray, row_start: IntArray) -> tuple[int, bool]:
    """Runs of pixels over ``limit``. Returns (runs, overflowed)."""
    count = 0
    capacity = runs.shape[0]
    rows, columns = image.shape
    for row in range(rows):
        row_start[row] = count
        line = image[row]
        column = 0
        while column < columns:
            if line[column] <= limit:
                column += 1
                continue
            if count == capacity:
                for rest in range(row + 1, rows + 1):
                    row_start[rest] = count
                return count, True
            runs[count, 0] = row
            runs[count, 1] = column
            while column < columns and line[column] > limit:
                column += 1
            runs[count, 2] = column
            count += 1
    row_start[rows] = count
    return count, False


@numba.njit(nogil=True)
def _values(
    image: NDArray[np.uint16], runs: IntArray, mean: float, offsets: IntArray, values: NDArray[np.float32]
) -> None:
    place = 0
    for run in range(runs.shape[0]):
        offsets[run] = place
        for column in range(runs[run, 1], runs[run, 2]):
            values[place] = np.float32(float(image[runs[run, 0], column]) - mean)
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
    count, overflowed = _lit_runs(image, limit, runs, row_start)
    runs = runs[:count].copy()
    lit = int((runs[:, 2] - runs[:, 1]).sum())
    offsets, values = np.empty(count, np.int32), np.empty(lit, np.float32)
    _values(image, runs, mean, offsets, values)
    label = np.empty(count, np.int32)
    clusters, _ = join_runs(runs, count, row_start, label)
    table = sum_clusters(image, runs, count, np.full(count, mean), label, clusters)
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
        values_dn=values,
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
            "lit_pixels": lit,
            "clusterings": 1,
            "run_tables": 1,
            "cold_runs": count,
            "runs": count,
            "rows_joined": rows,
            "cluster_pixels": lit,
            "clusters": clusters,
            "spots_sorted": sorting_work(len(chosen)),
        }
    )
    return frame, work


@numba.njit(nogil=True)
def _coarse_shift(
    own: FloatArray,
    first_column: int,
    first_row: int,
    low_x: int,
    low_y: int,
    shifts: int,
    runs: IntArray,
    row_start: IntArray,
    offsets: IntArray,
    values: NDArray[np.float32],
    height_px: int,
    foreseen_x: float,
    foreseen_y: float,
    energy: FloatArray,
    product: FloatArray,
) -> tuple[int, int, float, int]:
    """The whole-pixel shift of the least SSD: (dx, dy, SSD / the star's energy, pairs of pixels).

    own: float64[h, w], the star's window of the first image, first pixel at (first_column, first_row); shifts
    from (low_x, low_y) on, ``shifts`` on either axis. SSD = sum own^2 + sum second^2 - 2 sum own second, and
    only lit pixels of the second image add to its last two sums. Of equal shifts the one nearest to that
    foreseen wins. Sums are of whole numbers of 1/16 DN in order, so that every machine finds the same.
    """
    height, width = own.shape
    for i in range(shifts):
        for j in range(shifts):
            energy[i, j] = 0.0
            product[i, j] = 0.0
    total = 0.0
    for r in range(height):
        for c in range(width):
            total += own[r, c] * own[r, c]
    pairs = 0
    top = max(first_row + low_y, 0)
    bottom = min(first_row + low_y + shifts + height - 1, height_px)
    left, right = first_column + low_x, first_column + low_x + shifts + width - 1
    for row in range(top, bottom):
        for run in range(row_start[row], row_start[row + 1]):
            if runs[run, 2] <= left or runs[run, 1] >= right:
                continue
            for column in range(max(runs[run, 1], left), min(runs[run, 2], right)):
                value = float(values[offsets[run] + column - runs[run, 1]])
                square = value * value
                for r in range(height):
                    i = row - (first_row + r) - low_y
                    if i < 0 or i >= shifts:
                        continue
                    for c in range(width):
                        j = column - (first_column + c) - low_x
                        if 0 <= j < shifts:
                            energy[i, j] += square
                            product[i, j] += own[r, c] * value
                            pairs += 1
    best, best_distance = np.inf, np.inf
    best_i, best_j = -1, -1
    for i in range(shifts):
        for j in range(shifts):
            if product[i, j] <= 0.0:
                continue
            ssd = total + energy[i, j] - 2.0 * product[i, j]
            if ssd > best:
                continue
            distance = (low_y + i - foreseen_y) ** 2 + (low_x + j - foreseen_x) ** 2
            if ssd < best or distance < best_distance:
                best, best_distance, best_i, best_j = ssd, distance, i, j
    if best_i < 0 or total <= 0.0:
        return 0, 0, 1.0, pairs
    return low_x + best_j, low_y + best_i, best / total, pairs


@numba.njit(nogil=True)
def _window(
    x0: int,
    y0: int,
    window: FloatArray,
    runs: IntArray,
    row_start: IntArray,
    offsets: IntArray,
    values: NDArray[np.float32],
) -> None:
    """window[row - y0, column - x0] = the lit pixels' values, else 0; the window lies inside the image."""
    for r in range(window.shape[0]):
        for c in range(window.shape[1]):
            window[r, c] = 0.0
        for run in range(row_start[y0 + r], row_start[y0 + r + 1]):
            for column in range(max(runs[run, 1], x0), min(runs[run, 2], x0 + window.shape[1])):
                window[r, column - x0] = float(values[offsets[run] + column - runs[run, 1]])


@numba.njit(nogil=True)
def _follow(
    box: IntArray,
    runs_a: IntArray,
    start_a: IntArray,
    offsets_a: IntArray,
    values_a: NDArray[np.float32],
    runs_b: IntArray,
    start_b: IntArray,
    offsets_b: IntArray,
    values_b: NDArray[np.float32],
    width_px: int,
    height_px: int,
    foreseen: FloatArray,
    reach: int,
    margin: int,
    centrings: int,
    places: FloatArray,
    found: FloatArray,
) -> tuple[int, int]:
    """For each box (x, y, mismatch) into found[n, 3], mismatch < 0 where there is nothing. Returns (pairs of
    pixels compared, pixels weighted)."""
    shifts = 2 * reach + 1
    energy, product = np.empty((shifts, shifts)), np.empty((shifts, shifts))
    pairs = 0
    weighted = 0
    for star in range(box.shape[0]):
        found[star, 2] = -1.0
        x0, x1, y0, y1 = box[star, 0], box[star, 1], box[star, 2], box[star, 3]
        own = np.empty((y1 - y0 + 1, x1 - x0 + 1))
        _window(x0, y0, own, runs_a, start_a, offsets_a, values_a)
        low_x, low_y = int(np.rint(foreseen[star, 0])) - reach, int(np.rint(foreseen[star, 1])) - reach
        dx, dy, mismatch, compared = _coarse_shift(
            own, x0, y0, low_x, low_y, shifts, runs_b, start_b, offsets_b, values_b, height_px,
            foreseen[star, 0], foreseen[star, 1], energy, product,
        )  # fmt: skip
        pairs += compared
        # where the star stands in its own window
        place_x, place_y = places[star, 0] - x0 + margin, places[star, 1] - y0 + margin
        if mismatch >= 1.0:
            continue
        wide, high = x1 - x0 + 1 + 2 * margin, y1 - y0 + 1 + 2 * margin
        second = np.empty((high, wide))
        left, top = x0 + dx - margin, y0 + dy - margin
        for _ in range(centrings):
            if left < 0 or top < 0 or left + wide > width_px or top + high > height_px:
                found[star, 2] = -1.0
                break
            _window(left, top, second, runs_b, start_b, offsets_b, values_b)
            total = 0.0
            total_x = 0.0
            total_y = 0.0
            for r in range(high):
                for c in range(wide):
                    value = second[r, c]
                    total += value
                    total_x += value * c
                    total_y += value * r
            weighted += high * wide
            if total <= 0.0:
                break
            found[star, 0] = left + total_x / total
            found[star, 1] = top + total_y / total
            found[star, 2] = mismatch
            # where the window stands off its light, that light is cut: it goes after it, by whole pixels
            step_x = int(np.rint(found[star, 0] - left - place_x))
            step_y = int(np.rint(found[star, 1] - top - place_y))
            if step_x == 0 and step_y == 0:
                break
            left += step_x
            top += step_y
    return pairs, weighted


def flow_between(
    before: FlowFrame,
    after: FlowFrame,
    parameters: FlowParameters,
    foreseen_px: FloatArray | None = None,
) -> tuple[OpticalFlow, Work]:
    """Where the stars of one frame are in the next (F (2) and the refinement after it).

    foreseen_px: float64[stars of ``before``, 2], shifts (x, y) that are expected: the search is
    ``prediction_margin_px`` round them; None: every shift up to ``largest_shift_px``.
    A star whose window leaves the image, or that is nowhere, is left out.
    """
    if (before.width_px, before.height_px) != (after.width_px, after.height_px):
        raise ValueError("two frames of one flow have the same size")
    reach = parameters.largest_shift_px if foreseen_px is None else parameters.prediction_margin_px
    expected = (
        np.zeros((len(before), 2)) if foreseen_px is None else np.ascontiguousarray(foreseen_px, np.float64)
    )
    found = np.empty((len(before), 3))
    pairs, weighted = _follow(
        before.box, before.runs, before.row_start, before.offsets, before.values_dn,
        after.runs, after.row_start, after.offsets, after.values_dn,
        before.width_px, before.height_px, expected, reach, parameters.margin_px,
        parameters.centrings, np.stack([before.x_px, before.y_px], axis=1), found,
    )  # fmt: skip
    length = np.hypot(before.box[:, 1] - before.box[:, 0], before.box[:, 3] - before.box[:, 2])
    noise = before.sigma_dn * np.sqrt(before.pixels) / before.flux_dn
    star = np.flatnonzero(found[:, 2] >= 0.0).astype(np.int32)
    return OpticalFlow(
        star,
        before.x_px[star],
        before.y_px[star],
        found[star, 0],
        found[star, 1],
        found[star, 2],
        length[star].astype(np.float64),
        noise[star],
    ), Work(
        {
            "stars_followed": len(before),
            "shifts_compared": len(before) * (2 * reach + 1) ** 2,
            "pixels_matched": pairs,
            "centroid_pixels": weighted,
        }
    )
