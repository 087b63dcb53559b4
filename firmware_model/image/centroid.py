"""Centre of mass of a spot, paper Z eqs. (1)-(3): x = sum x I / sum I, background-subtracted, in a window.

Where the unit wants it, Gaussian interpolation (``interpolation.py``) then gives the centroid.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from .clustering import BACKGROUND, FIRST_X, FIRST_Y, LAST_X, LAST_Y, PEAK, PIXELS, SUM, SUM_X, SUM_Y
from .interpolation import InterpolationTerms, interpolate

__all__ = ["SPOT_FIELDS", "SpotLimits", "centroid_counts", "measure_spots"]

# float64[spots, SPOT_FIELDS]
X, Y, FLUX, MAGNITUDE, SPOT_PEAK, SPOT_PIXELS, SATURATED, AT_EDGE = range(8)
SPOT_FIELDS = 8

# int64[TALLIES]: rejections by reason, then work
SMALL, LARGE, SHARP, EDGE, FAINT = range(5)
PASSES, CLUSTER_PIXELS, WINDOW_PIXELS, RING_PIXELS, INTERPOLATIONS = range(5, 10)
TABLES, REFUSED, MASK_PIXELS, MASK_RUNS, MARKED_PIXELS, SOLVED, JUDGED, INTERPOLATED = range(10, 18)
ENERGIES, LENGTHS, PIECES, PIECE_RUNS, RESUMMED, ENERGY_TABLES, MASK_ROWS = range(18, 25)
TALLIES = 25


class SpotLimits(NamedTuple):
    """What makes a cluster a spot; the fields are those of ``DetectionParameters``."""

    half_window: int
    min_pixels: int
    max_pixels: int
    max_extent: int
    max_peak_fraction: float
    saturation_dn: int
    zero_point_dn: float  # DN of a magnitude 0 star in this exposure
    magnitude_limit: float
    interpolation: InterpolationTerms  # (6) of the unit's point spread, where it is wanted


def centroid_counts(tally: Sequence[int]) -> dict[str, int]:
    """Counts of the stage centroid of what ``measure_spots`` has tallied in one frame."""
    return {
        "measurings": int(tally[TABLES] > 0),
        "first_centroids": int(tally[PASSES] > 0),
        "cluster_tables": tally[TABLES],
        "clusters_refused": tally[REFUSED],
        "mask_pixels": tally[MASK_PIXELS],
        "mask_rows": tally[MASK_ROWS],
        "mask_runs": tally[MASK_RUNS],
        "marked_pixels": tally[MARKED_PIXELS],
        "centroid_background_pixels": tally[RING_PIXELS],
        "centroid_stars": tally[PASSES],
        "centroid_pixels": tally[WINDOW_PIXELS],
        "centroid_interpolations": tally[INTERPOLATIONS],
        "first_interpolations": int(tally[INTERPOLATIONS] > 0),
        "interpolated_tables": tally[INTERPOLATED],
        "interpolations_solved": tally[SOLVED],
        "spots_judged": tally[JUDGED],
        "energy_tables": tally[ENERGY_TABLES],
        "energies": tally[ENERGIES],
    }


OWN = np.uint8(1)
OTHER = np.uint8(2)

# ASSUMED: two passes; the first estimate (the cluster's own centre of mass) is within 0.05 px, and each pass
# shrinks its error by the share of the light that crosses the window's rim, under 2 %.
RECENTRINGS = 2
# ASSUMED: no window narrower than 4 px in full: below, pixel phase errors exceed 0.01 px for sigma 0.7 px.
LEAST_HALF_WIDTH_PX = 2.0
# Fractions of a pixel that a window's centre has, as the flight kernels have it: the window and the ring of a
# cluster that just fills them must not depend on the rounding of a quotient.
PLACES_PER_PX = 65536.0
# ASSUMED: less than this in a window is what rounding leaves of no light at all.
LEAST_FLUX_DN = 0.01
# The ring for the local background: from 1 px outside the window, 3 px wide (120 px about a 5 x 5 window).
# ASSUMED: far enough from the star's wings, near enough for gradients, many enough for the flux's accuracy.
RING_GAP_PX = 1
RING_WIDTH_PX = 3


@numba.njit(nogil=True)
def _paint(
    mask: NDArray[np.uint8],
    left: int,
    top: int,
    runs: NDArray[np.int32],
    row_start: NDArray[np.int32],
    label: NDArray[np.int32],
    cluster: int,
    reach: int,
    tally: NDArray[np.int64],
) -> None:
    """Mark the pixels within ``reach`` of the cluster (OWN) and of other clusters (OTHER)."""
    height, width = mask.shape
    mask[:, :] = 0
    rows = row_start.shape[0] - 1
    first_row, end_row = max(top - reach, 0), min(top + height + reach, rows)
    tally[MASK_PIXELS] += width * height
    tally[MASK_ROWS] += height
    tally[MASK_RUNS] += row_start[end_row] - row_start[first_row]
    for row in range(first_row, end_row):
        first_y, end_y = max(row - reach - top, 0), min(row + reach + 1 - top, height)
        for run in range(row_start[row], row_start[row + 1]):
            first = max(runs[run, 1] - reach - left, 0)
            end = min(runs[run, 2] + reach - left, width)
            if first >= end:
                continue
            mark = OWN if label[run] == cluster else OTHER
            tally[MARKED_PIXELS] += (end_y - first_y) * (end - first)
            for y in range(first_y, end_y):
                for x in range(first, end):
                    mask[y, x] |= mark


@numba.njit(nogil=True)
def _ring_background(
    image: NDArray[np.uint16],
    mask: NDArray[np.uint8],
    left: int,
    top: int,
    inner: tuple[int, int, int, int],
    noise_dn: float,
    fallback: float,
    tally: NDArray[np.int64],
) -> float:
    """Mean of the unmarked pixels of ``mask`` outside ``inner``; again of those within 3 sigma of that."""
    height, width = mask.shape
    x0, y0, x1, y1 = inner
    level = fallback
    for attempt in range(2 if noise_dn > 0.0 else 1):
        total = 0.0
        kept = 0
        for y in range(height):
            row = top + y
            if row < 0 or row >= image.shape[0]:
                continue
            for x in range(width):
                column = left + x
                if mask[y, x] != 0 or column < 0 or column >= image.shape[1]:
                    continue
                if y0 <= row <= y1 and x0 <= column <= x1:
                    continue
                value = float(image[row, column])
                tally[RING_PIXELS] += 1
                if attempt == 0 or abs(value - level) <= 3.0 * noise_dn:
                    total += value
                    kept += 1
        if kept < 8:
            return level
        level = total / kept
    return level


@numba.njit(nogil=True)
def _place(px: float) -> float:
    return math.floor(px * PLACES_PER_PX + 0.5) / PLACES_PER_PX


@numba.njit(nogil=True)
def _half_width(centre: float, first: float, last: float, nominal: float, grow: float) -> float:
    """Half-width of the window along one axis: the nominal one, or what holds the cluster."""
    extent = max(centre - (first - 0.5), (last + 0.5) - centre)
    return max(nominal, extent + grow)


@numba.njit(nogil=True)
def measure_spots(
    image: NDArray[np.uint16],
    runs: NDArray[np.int32],
    row_start: NDArray[np.int32],
    label: NDArray[np.int32],
    clusters: NDArray[np.float64],
    noise_dn: float,
    local_background: bool,
    reach: int,
    limits: SpotLimits,
    spots: NDArray[np.float64],
    outcome: NDArray[np.int8],
    tally: NDArray[np.int64],
) -> int:
    """Centroid, flux and verdict of each cluster. Returns the number of spots put into ``spots``.

    The window is centred on the current estimate to the fraction of a pixel: pixels on its rim weigh by the
    share of them inside. So it is symmetric about the star whatever the pixel phase, which removes the bias
    that a window of whole pixels has. It is ``half_window`` + 0.5 px wide on each side, and wider where the
    cluster is (saturated stars, streaks); a much wider one counts only pixels within ``reach`` of the
    cluster, or a streak would drown in the noise of its bounding box. Pixels within ``reach`` of another
    cluster count for nothing. At the image's edge the window is narrowed on both sides alike; where the
    cluster would not fit into it any more the spot is rejected.

    ``reach``: 1 for clusters of raw pixels, 0 for those of a smoothed image, which reach out by themselves.
    ``local_background``: take the background from a ring round the spot, else the cluster's own.
    ``spots``: ``float64[>= clusters, SPOT_FIELDS]``. ``outcome``: ``int8[clusters]``, -1 for a spot, else the
    reason (SMALL, LARGE, SHARP, EDGE, FAINT). ``tally``: ``int64[TALLIES]``, added to.

    ``limits.interpolation.wanted``: the centroid of an unsaturated spot that is a Gaussian of the unit's
    width is then taken by (6), see ``interpolation.py``; flux and verdict are those above.
    """
    tally[TABLES] += 1
    rows, columns = image.shape
    nominal = limits.half_window + 0.5
    # sqrt of the sum of x^2 over the window: what noise does to the centre of mass
    window_factor = 2.0 * nominal * math.sqrt(limits.half_window * (limits.half_window + 1) / 3.0)
    grow = 0.5 if reach > 0 else -0.5
    least = min(LEAST_HALF_WIDTH_PX, nominal)
    margin = limits.half_window + RING_GAP_PX + RING_WIDTH_PX + 2
    side = limits.max_extent + 2 * margin + 2
    store = np.empty(side * side, np.uint8)
    found = 0
    interpolated = 0
    for cluster in range(clusters.shape[0]):
        entry = clusters[cluster]
        first_x, last_x = entry[FIRST_X], entry[LAST_X]
        first_y, last_y = entry[FIRST_Y], entry[LAST_Y]
        outcome[cluster] = -1
        tally[CLUSTER_PIXELS] += int(entry[PIXELS])
        if entry[PIXELS] < limits.min_pixels:
            outcome[cluster] = SMALL
        elif (
            entry[PIXELS] > limits.max_pixels or max(last_x - first_x, last_y - first_y) >= limits.max_extent
        ):
            outcome[cluster] = LARGE
        elif first_x == 0 or first_y == 0 or last_x == columns - 1 or last_y == rows - 1:
            outcome[cluster] = EDGE
        if outcome[cluster] >= 0 or entry[SUM] <= 0.0:
            outcome[cluster] = outcome[cluster] if outcome[cluster] >= 0 else FAINT
            tally[outcome[cluster]] += 1
            tally[REFUSED] += 1
            continue

        centre_x = _place(entry[SUM_X] / entry[SUM])
        centre_y = _place(entry[SUM_Y] / entry[SUM])
        background = entry[BACKGROUND]
        wide_x = _half_width(centre_x, first_x, last_x, nominal, grow)
        wide_y = _half_width(centre_y, first_y, last_y, nominal, grow)
        hug = wide_x > nominal + 1.0 or wide_y > nominal + 1.0
        # what the window may touch in any pass, and the ring outside it
        x0 = min(math.floor(centre_x - wide_x) - RING_GAP_PX, int(first_x) - 1)
        x1 = max(math.ceil(centre_x + wide_x) + RING_GAP_PX, int(last_x) + 1)
        y0 = min(math.floor(centre_y - wide_y) - RING_GAP_PX, int(first_y) - 1)
        y1 = max(math.ceil(centre_y + wide_y) + RING_GAP_PX, int(last_y) + 1)
        left, top = x0 - RING_WIDTH_PX, y0 - RING_WIDTH_PX
        width, height = x1 + RING_WIDTH_PX + 1 - left, y1 + RING_WIDTH_PX + 1 - top
        if width * height > store.shape[0]:
            outcome[cluster] = LARGE
            tally[LARGE] += 1
            continue
        mask = store[: width * height].reshape(height, width)
        _paint(mask, left, top, runs, row_start, label, cluster, reach, tally)
        if local_background:
            inner = (x0, y0, x1, y1)
            background = _ring_background(image, mask, left, top, inner, noise_dn, background, tally)

        flux = 0.0
        narrowed = False
        for _ in range(RECENTRINGS):
            centre_x, centre_y = _place(centre_x), _place(centre_y)
            wide_x = _half_width(centre_x, first_x, last_x, nominal, grow)
            wide_y = _half_width(centre_y, first_y, last_y, nominal, grow)
            room_x = min(centre_x + 0.5, columns - 0.5 - centre_x)
            room_y = min(centre_y + 0.5, rows - 0.5 - centre_y)
            narrowed = room_x < wide_x or room_y < wide_y
            if narrowed:
                need_x = max(least, _half_width(centre_x, first_x, last_x, 0.0, min(grow, 0.0) + 0.5))
                need_y = max(least, _half_width(centre_y, first_y, last_y, 0.0, min(grow, 0.0) + 0.5))
                if room_x < min(need_x, wide_x) or room_y < min(need_y, wide_y):
                    outcome[cluster] = EDGE
                    break
                wide_x, wide_y = min(wide_x, room_x), min(wide_y, room_y)
            flux = 0.0
            sum_x = 0.0
            sum_y = 0.0
            # pixel k covers k - 0.5 .. k + 0.5
            row_first = max(math.floor(centre_y - wide_y + 0.5), top, 0)
            row_last = min(math.ceil(centre_y + wide_y - 0.5), top + height - 1, rows - 1)
            column_first = max(math.floor(centre_x - wide_x + 0.5), left, 0)
            column_last = min(math.ceil(centre_x + wide_x - 0.5), left + width - 1, columns - 1)
            for row in range(row_first, row_last + 1):
                share_y = min(row + 0.5, centre_y + wide_y) - max(row - 0.5, centre_y - wide_y)
                if share_y <= 0.0:
                    continue
                line = 0.0
                line_x = 0.0
                for column in range(column_first, column_last + 1):
                    mark = mask[row - top, column - left]
                    if mark == OTHER or (hug and mark == 0):
                        continue
                    share_x = min(column + 0.5, centre_x + wide_x) - max(column - 0.5, centre_x - wide_x)
                    if share_x <= 0.0:
                        continue
                    value = (float(image[row, column]) - background) * share_x
                    line += value
                    line_x += value * (column - centre_x)
                flux += line * share_y
                sum_x += line_x * share_y
                sum_y += line * share_y * (row - centre_y)
            tally[PASSES] += 1
            tally[WINDOW_PIXELS] += (row_last + 1 - row_first) * (column_last + 1 - column_first)
            if flux <= LEAST_FLUX_DN:
                break
            centre_x += sum_x / flux
            centre_y += sum_y / flux
        inside = first_x - 1.0 <= centre_x <= last_x + 1.0 and first_y - 1.0 <= centre_y <= last_y + 1.0
        if outcome[cluster] < 0:
            lit = flux > LEAST_FLUX_DN and inside
            tally[JUDGED] += lit
            magnitude = -2.5 * math.log10(flux / limits.zero_point_dn) if lit else np.inf
            peak = entry[PEAK] + entry[BACKGROUND] - background
            if not magnitude <= limits.magnitude_limit or not lit:
                outcome[cluster] = FAINT
            elif peak > limits.max_peak_fraction * flux:
                outcome[cluster] = SHARP
            else:
                # a whole number but for the rounding of the two
                saturated = entry[PEAK] + entry[BACKGROUND] >= limits.saturation_dn - 0.5
                if limits.interpolation.wanted and not saturated:
                    # two axes; a spot that is no Gaussian is found out by the same sums
                    tally[INTERPOLATIONS] += 2
                    interpolated = 1
                    solved, good, place_x, place_y = interpolate(
                        image,
                        mask,
                        left,
                        top,
                        OTHER,
                        background,
                        centre_x,
                        centre_y,
                        window_factor * noise_dn / flux,
                        limits.interpolation,
                    )
                    tally[SOLVED] += solved
                    if good:
                        centre_x, centre_y = place_x, place_y
                spot = spots[found]
                spot[X], spot[Y], spot[FLUX], spot[MAGNITUDE] = centre_x, centre_y, flux, magnitude
                spot[SPOT_PEAK], spot[SPOT_PIXELS] = peak, entry[PIXELS]
                spot[SATURATED] = 1.0 if saturated else 0.0
                spot[AT_EDGE] = 1.0 if narrowed else 0.0
                found += 1
        if outcome[cluster] >= 0:
            tally[outcome[cluster]] += 1
    tally[INTERPOLATED] += interpolated
    return found
