"""Optical flow of stars: where each star of one frame is in the next, without knowing which star it is.

Fasano et al., "Optical flow-based angular rate", Sensors 13 (2013), section 2.1 (paper F). Stars of the first
image are matched by the smallest sum of squared differences (SSD) over whole-pixel shifts, then refined by a
centroid in the second image. What is lit of an image is of ``lit_pixels.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from ..work import Work
from .lit_pixels import FlowFrame, FlowParameters, light_up

__all__ = ["FlowFrame", "FlowParameters", "OpticalFlow", "flow_between", "light_up"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]


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
        """Expected errors of the shifts along themselves and across, 1 sigma, with streaks that are so long.

        Of a streak that is seen shorter the rest lies under the threshold: its middle may be anywhere along
        the whole, in both images. The length must not be taken from the star's own shift, for then one that
        is measured too short would look the better one. least_px: of a centroid at its best.
        """
        missing = np.maximum(streak_px - self.length_px, 0.0)
        floor = 2.0 * least_px * least_px
        turned = np.maximum(streak_px, 1.0)
        along = np.sqrt(floor + missing**2 / 6.0 + (self.noise * turned) ** 2 / 6.0)
        return along, np.sqrt(floor + 2.0 * self.noise**2)


# pieces int32[n, 3]: first column, end column, both counted from a window's first, where the values begin
PIECE_FIRST, PIECE_END, PIECE_VALUES = range(3)

# counts of _follow
ROWS, RUNS, SHIFT_ROWS, LINES, PAIRS, SHIFTS, CENTRINGS = range(7)
COUNT_NAMES = (
    "flow_rows",
    "runs_looked_at",
    "shift_rows",
    "lines_matched",
    "pixels_matched",
    "shifts_compared",
    "flow_centrings",
)


@numba.njit(nogil=True)
def _pieces(
    x0: int,
    x1: int,
    y0: int,
    y1: int,
    runs: IntArray,
    row_start: IntArray,
    offsets: IntArray,
    pieces: IntArray,
    piece_start: IntArray,
    tally: NDArray[np.int64],
) -> None:
    """The parts of the runs that lie in columns x0 to x1 - 1 of rows y0 to y1 - 1, rows outside the image
    without any; ``piece_start[y1 - y0 + 1]``: where the rows' pieces begin.
    """
    count = 0
    height_px = row_start.shape[0] - 1
    for row in range(y0, y1):
        piece_start[row - y0] = count
        if row < 0 or row >= height_px:
            continue
        tally[ROWS] += 1
        for run in range(row_start[row], row_start[row + 1]):
            tally[RUNS] += 1
            if runs[run, 1] >= x1:
                break
            if runs[run, 2] <= x0:
                continue
            first = max(runs[run, 1], x0)
            pieces[count, PIECE_FIRST] = first - x0
            pieces[count, PIECE_END] = min(runs[run, 2], x1) - x0
            pieces[count, PIECE_VALUES] = offsets[run] + first - runs[run, 1]
            count += 1
    piece_start[y1 - y0] = count


@numba.njit(nogil=True)
def _add_squares(
    row: int,
    sign: int,
    pieces: IntArray,
    piece_start: IntArray,
    values: IntArray,
    column_energy: NDArray[np.int64],
) -> int:
    """Add a row's squares to the columns' sums, or take them away; returns how many."""
    pixels = 0
    for piece in range(piece_start[row], piece_start[row + 1]):
        place = pieces[piece, PIECE_VALUES]
        for column in range(pieces[piece, PIECE_FIRST], pieces[piece, PIECE_END]):
            value = np.int64(values[place])
            column_energy[column] += sign * value * value
            place += 1
            pixels += 1
    return pixels


@numba.njit(nogil=True)
def _coarse_shift(
    height: int,
    width: int,
    own: IntArray,
    own_start: IntArray,
    own_values: IntArray,
    second: IntArray,
    second_start: IntArray,
    second_values: IntArray,
    shifts: int,
    away_x: float,
    away_y: float,
    column_energy: NDArray[np.int64],
    product: NDArray[np.int64],
    tally: NDArray[np.int64],
) -> tuple[int, int, float]:
    """The whole-pixel shift of the least SSD: (column, row of the ``shifts`` on either axis, SSD / the star's
    energy).

    own: the star's pieces in its window; second: those of the other image in that window moved to all shifts,
    shifts - 1 wider and higher. SSD = sum own^2 + sum second^2 - 2 sum own second; pixels that are not lit
    add nothing to any of them, and a shift at which no two lit ones meet is none. The second sum of a row of
    shifts is kept by columns, to which a row is added at one end and taken away at the other. Of equal shifts
    the one nearest to (away_x, away_y) wins. Sums are whole numbers, so that every machine finds the same.
    """
    total = np.int64(0)
    for piece in range(own_start[height]):
        place = own[piece, PIECE_VALUES]
        for _ in range(own[piece, PIECE_FIRST], own[piece, PIECE_END]):
            value = np.int64(own_values[place])
            total += value * value
            place += 1
    for column in range(shifts + width - 1):
        column_energy[column] = 0
    for j in range(shifts):
        product[j] = 0
    best = total  # as of nothing: a shift must be better
    best_i, best_j = -1, -1
    lit = 0
    for row in range(height - 1):
        lit += _add_squares(row, 1, second, second_start, second_values, column_energy)
    for i in range(shifts):
        lit += _add_squares(i + height - 1, 1, second, second_start, second_values, column_energy)
        if lit > 0:
            least_j, most_j = shifts, -1
            for r in range(height):
                for b in range(second_start[i + r], second_start[i + r + 1]):
                    first, end = second[b, PIECE_FIRST], second[b, PIECE_END]
                    for a in range(own_start[r], own_start[r + 1]):
                        own_first, own_end = own[a, PIECE_FIRST], own[a, PIECE_END]
                        # columns of the star that meet this piece at one of the shifts
                        low, high = max(own_first, first - shifts + 1), min(own_end, end)
                        if low >= high:
                            continue
                        least_j = min(least_j, max(first - high + 1, 0))
                        most_j = max(most_j, min(end - 1 - low, shifts - 1))
                        tally[LINES] += high - low
                        for c in range(low, high):
                            value = np.int64(own_values[own[a, PIECE_VALUES] + c - own_first])
                            left, right = max(first, c), min(end, c + shifts)
                            place = second[b, PIECE_VALUES] + left - first
                            tally[PAIRS] += right - left
                            for u in range(left, right):
                                product[u - c] += value * second_values[place]
                                place += 1
            if most_j >= 0:
                tally[SHIFTS] += most_j - least_j + 1
                tally[SHIFT_ROWS] += 1
                energy = np.int64(0)
                for column in range(least_j, least_j + width - 1):
                    energy += column_energy[column]
                for j in range(least_j, most_j + 1):
                    energy += column_energy[j + width - 1]
                    if product[j] > 0:
                        ssd = total + energy - 2 * product[j]
                        product[j] = 0
                        if ssd < best or (
                            ssd == best
                            and best_i >= 0
                            and (i - away_y) ** 2 + (j - away_x) ** 2
                            < (best_i - away_y) ** 2 + (best_j - away_x) ** 2
                        ):
                            best, best_i, best_j = ssd, i, j
                    energy -= column_energy[j]
        lit -= _add_squares(i, -1, second, second_start, second_values, column_energy)
    if best_i < 0:
        return 0, 0, 1.0
    return best_j, best_i, float(best) / float(total)


@numba.njit(nogil=True)
def _centre(
    x0: int,
    y0: int,
    width: int,
    height: int,
    runs: IntArray,
    row_start: IntArray,
    offsets: IntArray,
    values: IntArray,
    tally: NDArray[np.int64],
) -> tuple[np.int64, np.int64, np.int64]:
    """Sums of the lit pixels in a window inside the image: value, value times column and row there."""
    total, total_x, total_y = np.int64(0), np.int64(0), np.int64(0)
    tally[ROWS] += height
    for r in range(height):
        line = np.int64(0)
        for run in range(row_start[y0 + r], row_start[y0 + r + 1]):
            tally[RUNS] += 1
            if runs[run, 1] >= x0 + width:
                break
            for column in range(max(runs[run, 1], x0), min(runs[run, 2], x0 + width)):
                value = np.int64(values[offsets[run] + column - runs[run, 1]])
                line += value
                total_x += value * (column - x0)
        total += line
        total_y += line * r
    return total, total_x, total_y


@numba.njit(nogil=True)
def _follow(
    box: IntArray,
    runs_a: IntArray,
    start_a: IntArray,
    offsets_a: IntArray,
    values_a: IntArray,
    runs_b: IntArray,
    start_b: IntArray,
    offsets_b: IntArray,
    values_b: IntArray,
    width_px: int,
    foreseen: FloatArray,
    reach: int,
    margin: int,
    centrings: int,
    places: FloatArray,
    found: FloatArray,
    tally: NDArray[np.int64],
) -> None:
    """For each box (x, y, mismatch) into found[n, 3], mismatch -1: nothing; counts into ``tally``."""
    height_px = start_a.shape[0] - 1
    shifts = 2 * reach + 1
    tallest, widest = 1, 1
    for star in range(box.shape[0]):
        widest = max(widest, box[star, 1] - box[star, 0] + 1)
        tallest = max(tallest, box[star, 3] - box[star, 2] + 1)
    own, own_start = np.empty((runs_a.shape[0], 3), np.int32), np.empty(tallest + 1, np.int32)
    second, second_start = np.empty((runs_b.shape[0], 3), np.int32), np.empty(tallest + shifts, np.int32)
    column_energy, product = np.empty(widest + shifts - 1, np.int64), np.empty(shifts, np.int64)
    for star in range(box.shape[0]):
        found[star, 2] = -1.0
        x0, x1, y0, y1 = box[star, 0], box[star, 1], box[star, 2], box[star, 3]
        width, height = x1 - x0 + 1, y1 - y0 + 1
        low_x, low_y = int(np.rint(foreseen[star, 0])) - reach, int(np.rint(foreseen[star, 1])) - reach
        _pieces(x0, x1 + 1, y0, y1 + 1, runs_a, start_a, offsets_a, own, own_start, tally)
        _pieces(
            x0 + low_x, x1 + low_x + shifts, y0 + low_y, y1 + low_y + shifts,
            runs_b, start_b, offsets_b, second, second_start, tally,
        )  # fmt: skip
        j, i, mismatch = _coarse_shift(
            height, width, own, own_start, values_a, second, second_start, values_b, shifts,
            foreseen[star, 0] - low_x, foreseen[star, 1] - low_y, column_energy, product, tally,
        )  # fmt: skip
        if mismatch >= 1.0:
            continue
        # where the star stands in its own window
        place_x, place_y = places[star, 0] - x0 + margin, places[star, 1] - y0 + margin
        wide, high = width + 2 * margin, height + 2 * margin
        left, top = x0 + low_x + j - margin, y0 + low_y + i - margin
        for _ in range(centrings):
            if left < 0 or top < 0 or left + wide > width_px or top + high > height_px:
                found[star, 2] = -1.0
                break
            tally[CENTRINGS] += 1
            total, total_x, total_y = _centre(
                left, top, wide, high, runs_b, start_b, offsets_b, values_b, tally
            )
            if total <= 0:
                break
            centre_x, centre_y = float(total_x) / float(total), float(total_y) / float(total)
            found[star, 0] = left + centre_x
            found[star, 1] = top + centre_y
            found[star, 2] = mismatch
            # where the window stands off its light, that light is cut: it goes after it, by whole pixels
            step_x, step_y = int(np.rint(centre_x - place_x)), int(np.rint(centre_y - place_y))
            if step_x == 0 and step_y == 0:
                break
            left += step_x
            top += step_y


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
    tally = np.zeros(len(COUNT_NAMES), np.int64)
    _follow(
        before.box, before.runs, before.row_start, before.offsets, before.values,
        after.runs, after.row_start, after.offsets, after.values,
        before.width_px, expected, reach, parameters.margin_px,
        parameters.centrings, np.stack([before.x_px, before.y_px], axis=1), found, tally,
    )  # fmt: skip
    star = np.flatnonzero(found[:, 2] >= 0.0).astype(np.int32)
    sides = (before.box[star, 1::2] - before.box[star, ::2]).astype(np.float64)
    return OpticalFlow(
        star,
        before.x_px[star],
        before.y_px[star],
        found[star, 0],
        found[star, 1],
        found[star, 2],
        np.sqrt(sides[:, 0] ** 2 + sides[:, 1] ** 2),
        before.sigma_dn * np.sqrt(before.pixels[star]) / before.flux_dn[star],
    ), Work(
        {
            "stars_followed": len(before),
            **dict(zip(COUNT_NAMES, tally.tolist(), strict=True)),
        }
    )
