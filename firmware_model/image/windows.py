"""Detection in windows: tracking looks only where stars are expected (paper R, tracking steps 2 to 4)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from ..work import Work
from . import centroid
from .background import window_samples, window_statistics
from .clustering import FIRST_X, FIRST_Y, LAST_X, LAST_Y, RUN_FIELDS, SUM, join_runs, sum_clusters
from .detection import DetectionParameters, sorting_work, spots_of_table
from .spots import Rejections, WindowSpots, WindowStatus

__all__ = ["LARGE_WINDOW_PX", "detect_in_windows"]

# Pixels of 2 bytes that the flight processor's data cache of 32 KiB holds: of a larger window none is left
# there from one pass to the next.
LARGE_WINDOW_PX = 16384

_EMPTY = int(WindowStatus.EMPTY)
_FOUND = int(WindowStatus.FOUND)
_CLIPPED = int(WindowStatus.CLIPPED)
_FAINT = int(WindowStatus.FAINT)
_REJECTED = int(WindowStatus.REJECTED)


@numba.njit(nogil=True)
def smoothed_runs(
    window: NDArray[np.uint16],
    limit: int,
    runs: NDArray[np.int32],
    row_start: NDArray[np.int32],
    sums: NDArray[np.int32],
) -> int:
    """Runs of pixels whose 3 x 3 sum of DN is over ``limit``; returns their number.

    The window's outermost rows and columns have no full 3 x 3 surroundings: sums there are of the pixels
    inside, each missing one taken as its mirror image (the row or column next to the rim counts twice).
    ``sums``: int32[>= columns], scratch. The scan stops where ``runs`` is full.
    """
    rows, columns = window.shape
    count = 0
    for row in range(rows):
        row_start[row] = count
        above = window[row - 1 if row > 0 else min(1, rows - 1)]
        line = window[row]
        below = window[row + 1 if row < rows - 1 else max(rows - 2, 0)]
        for column in range(columns):
            sums[column] = np.int32(above[column]) + np.int32(line[column]) + np.int32(below[column])
        inside = False
        for column in range(columns):
            before = sums[column - 1 if column > 0 else min(1, columns - 1)]
            after = sums[column + 1 if column < columns - 1 else max(columns - 2, 0)]
            if before + sums[column] + after > limit:
                if not inside:
                    if count == runs.shape[0]:
                        row_start[row + 1 : rows + 1] = count
                        return count
                    runs[count, 0] = row
                    runs[count, 1] = column
                    count += 1
                    inside = True
                runs[count - 1, 2] = column + 1
            else:
                inside = False
    row_start[rows] = count
    return count


@numba.njit(nogil=True)
def _detect_in_windows(
    flat: NDArray[np.uint16],
    offsets: NDArray[np.int64],
    rects: NDArray[np.int32],
    keep: NDArray[np.int32],
    expected_magnitude: NDArray[np.float64],
    image_width: int,
    image_height: int,
    sigma_factor: float,
    tau_min_dn: float,
    max_runs: int,
    limits: centroid.SpotLimits,
    status: NDArray[np.uint8],
    background: NDArray[np.float64],
    noise: NDArray[np.float64],
    counts: NDArray[np.int64],
    tally: NDArray[np.int64],
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    windows = rects.shape[0]
    tallest = 1
    widest = 1
    wanted = 0
    for i in range(windows):
        widest = max(widest, rects[i, 2] - rects[i, 0])
        tallest = max(tallest, rects[i, 3] - rects[i, 1])
        wanted += keep[i]
    runs = np.empty((max_runs, RUN_FIELDS), np.int32)
    run_background = np.empty(max_runs, np.float64)
    row_start = np.empty(tallest + 1, np.int32)
    label = np.empty(max_runs, np.int32)
    sums = np.empty(widest, np.int32)
    scratch = np.empty(256, np.float64)
    chosen = np.empty((wanted, centroid.SPOT_FIELDS), np.float64)
    window_of = np.empty(wanted, np.int32)
    total = 0
    for i in range(windows):
        columns = rects[i, 2] - rects[i, 0]
        rows = rects[i, 3] - rects[i, 1]
        window = flat[offsets[i] : offsets[i + 1]].reshape(rows, columns)
        background[i], noise[i], passes = window_statistics(window, scratch)
        counts[4] += window_samples(window.size, columns)
        counts[5] += passes * window.size
        large = window.size > LARGE_WINDOW_PX
        if large:
            counts[7] += passes * window.size  # by all passes but the first, and by the smoothing
        # a 3 x 3 sum has 9 times the background and 3 times the noise of a pixel
        over = 3.0 * max(sigma_factor * noise[i], tau_min_dn)
        starts = row_start[: rows + 1]
        count = smoothed_runs(window, int(np.floor(9.0 * background[i] + over)), runs, starts, sums)
        status[i] = _EMPTY
        if count == 0:
            continue
        if count == max_runs:
            counts[3] += 1
        run_background[:count] = background[i]
        clusters, _ = join_runs(runs, count, starts, label)
        table = sum_clusters(window, runs, count, run_background, label, clusters)
        spots = np.empty((clusters, centroid.SPOT_FIELDS), np.float64)
        outcome = np.empty(clusters, np.int8)
        found = centroid.measure_spots(
            window,
            runs,
            starts,
            label,
            table,
            noise[i],
            False,
            0,
            limits,
            spots,
            outcome,
            tally,
        )
        counts[0] += count
        counts[1] += clusters
        counts[2] += found
        counts[6] += rows
        if large:
            counts[8] += count
        if found == 0:
            status[i] = _worst_status(outcome, table, rects[i], image_width, image_height)
            continue
        status[i] = _FOUND
        if keep[i] == 1 and not np.isnan(expected_magnitude[i]):
            difference = np.abs(spots[:found, centroid.MAGNITUDE] - expected_magnitude[i])
            order = np.argsort(difference, kind="mergesort")
        else:
            order = np.argsort(-spots[:found, centroid.FLUX], kind="mergesort")
        for place in range(min(found, keep[i])):
            spot = spots[order[place]]
            chosen[total] = spot
            chosen[total, centroid.X] = spot[centroid.X] + rects[i, 0]
            chosen[total, centroid.Y] = spot[centroid.Y] + rects[i, 1]
            window_of[total] = i
            total += 1
    return chosen[:total], window_of[:total]


@numba.njit(nogil=True)
def _worst_status(
    outcome: NDArray[np.int8],
    table: NDArray[np.float64],
    rect: NDArray[np.int32],
    image_width: int,
    image_height: int,
) -> int:
    """Why a window with clusters gave no spot: what became of its brightest cluster."""
    brightest = 0
    for cluster in range(1, outcome.shape[0]):
        if table[cluster, SUM] > table[brightest, SUM]:
            brightest = cluster
    if outcome[brightest] == centroid.EDGE:
        # a side that lies on the image's edge cannot be helped by a larger window
        entry = table[brightest]
        reach = 3.0
        if (
            (rect[0] > 0 and entry[FIRST_X] < reach)
            or (rect[1] > 0 and entry[FIRST_Y] < reach)
            or (rect[2] < image_width and entry[LAST_X] >= rect[2] - rect[0] - reach)
            or (rect[3] < image_height and entry[LAST_Y] >= rect[3] - rect[1] - reach)
        ):
            return _CLIPPED
        return _REJECTED
    if outcome[brightest] == centroid.FAINT:
        return _FAINT
    return _REJECTED


def detect_in_windows(
    flat: NDArray[np.uint16],
    offsets: NDArray[np.int64],
    rects: NDArray[np.int32],
    parameters: DetectionParameters,
    *,
    width_px: int,
    height_px: int,
    keep: NDArray[np.int32] | int = 1,
    expected_flux_dn: NDArray[np.float64] | None = None,
) -> tuple[WindowSpots, Work]:
    """Find the star(s) of each window (paper R, tracking step 4).

    ``flat, offsets, rects`` as of ``Frame.windows``. ``keep`` (int or int32[n]): how many spots a window may
    give (a merged window holds more than one predicted star); the brightest are kept. ``expected_flux_dn``
    (float64[n], nan = unknown): where given and ``keep`` is 1, the spot nearest to it in magnitude is taken
    instead of the brightest. ``width_px, height_px``: of the image (a side of a window on the image's edge).

    Background and noise are each window's own. The threshold, ``window_sigma_factor`` times the noise, is
    applied to 3 x 3 sums (noise 3 times a pixel's), so that a star drawn out to a streak is found while its
    single pixels are near the noise; ``Spots.pixels`` counts pixels of the smoothed cluster. The magnitude
    limit is relaxed by ``window_magnitude_margin``. A spot whose
    centroid window does not fit is rejected: status ``CLIPPED`` if a side of the window cut it.
    """
    rects = np.ascontiguousarray(rects, np.int32).reshape(-1, 4)
    windows = len(rects)
    kept = np.full(windows, keep, np.int32) if isinstance(keep, int) else np.ascontiguousarray(keep, np.int32)
    limits = parameters.spot_limits(in_windows=True)
    expected = np.full(windows, np.nan)
    if expected_flux_dn is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            expected = -2.5 * np.log10(np.asarray(expected_flux_dn, np.float64) / limits.zero_point_dn)
    status = np.zeros(windows, np.uint8)
    background, noise = np.zeros(windows), np.zeros(windows)
    counts = np.zeros(9, np.int64)
    tally = np.zeros(centroid.TALLIES, np.int64)
    table, window_of = _detect_in_windows(
        np.ascontiguousarray(flat, np.uint16),
        np.ascontiguousarray(offsets, np.int64),
        rects,
        kept,
        expected,
        int(width_px),
        int(height_px),
        float(parameters.window_sigma_factor),
        float(parameters.tau_min_dn),
        int(parameters.max_runs),
        limits,
        status,
        background,
        noise,
        counts,
        tally,
    )
    (
        runs,
        clusters,
        found,
        overflowed,
        samples,
        noise_pixels,
        rows_joined,
        reread_pixels,
        cold_runs,
    ) = counts.tolist()
    tallied = tally.tolist()
    rejected = Rejections(
        small=tallied[centroid.SMALL],
        large=tallied[centroid.LARGE],
        sharp=tallied[centroid.SHARP],
        edge=tallied[centroid.EDGE],
        faint=tallied[centroid.FAINT],
        surplus=found - len(table),
    )
    work = Work()
    work.counts = {
        "windows": windows,
        "window_pixels": len(flat),
        "window_samples": samples,
        "window_noise_pixels": noise_pixels,
        "reread_pixels": reread_pixels,
        "clusterings": int(runs > 0),
        "run_tables": tallied[centroid.TABLES],
        "cold_runs": cold_runs,
        "runs": runs,
        "rows_joined": rows_joined,
        "cluster_pixels": tallied[centroid.CLUSTER_PIXELS],
        "clusters": clusters,
        "spots_sorted": sorting_work(found),
    }
    work.counts |= centroid.centroid_counts(tallied)
    level = float(np.median(background)) if windows else 0.0
    sigma = float(np.median(noise)) if windows else 0.0
    spots = spots_of_table(table, rejected, level, sigma, overflowed > 0)
    return WindowSpots(spots, window_of, status, background, noise), work
