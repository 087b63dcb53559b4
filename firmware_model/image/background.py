"""Background and noise of an image, robust against the stars in it."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["NOISE_SAMPLES", "frame_samples", "frame_statistics", "window_samples", "window_statistics"]

# ASSUMED: 4096 pairs give the noise of a frame within 1.1 %, 1 / sqrt(2 * 4096); more would cost time.
NOISE_SAMPLES = 4096
# ASSUMED: pixels four columns apart: near enough for a gradient to cancel, too far for interpolated colour
# pixels or one star's image to tie the two together.
PAIR_DISTANCE_PX = 4


@numba.njit(nogil=True)
def frame_samples(image: NDArray[np.uint16]) -> int:
    """How many pairs of its pixels ``frame_statistics`` takes."""
    rows, columns = image.shape
    total = int(rows * (columns - min(PAIR_DISTANCE_PX, columns - 1)))
    return min(NOISE_SAMPLES, total)


@numba.njit(nogil=True)
def frame_statistics(image: NDArray[np.uint16]) -> tuple[float, float, int]:
    """Background (DN), noise of a pixel (DN, 1 sigma) and the samples looked at in all passes.

    Noise: differences of pixels a few columns apart, so that slow gradients cancel; the mean of their
    absolute values starts, then the r.m.s. of those within 4 sigma until it settles (1 %, at most 12 times;
    an r.m.s. does not jump in whole DN as a median does). The start is from above: stars cover little of a
    frame, but more than half of its pixels may stand at 0 DN where a converter clips, and a median would
    then see no noise at all. The differences' sigma is sqrt(2) times the pixel's.
    Background: mean of the samples within 3 sigma of their median.
    ``image``: ``uint16[rows, columns]`` DN.
    """
    rows, columns = image.shape
    distance = min(PAIR_DISTANCE_PX, columns - 1)
    usable = columns - distance
    total = rows * usable
    count = frame_samples(image)
    # An additive sequence with the golden ratio spreads the samples evenly over rows and columns
    values = np.empty(count, np.float64)
    differences = np.empty(count, np.float64)
    for i in range(count):
        place = (i * total) // count
        row = place // usable
        column = int((i * 0.6180339887498949 % 1.0) * usable)
        value = float(image[row, column])
        values[i] = value
        differences[i] = value - float(image[row, column + distance])
    passes = 1
    sigma = max(1.2533 * float(np.mean(np.abs(differences))), 1.0)
    for _ in range(12):
        limit = 4.0 * sigma
        squares = 0.0
        kept = 0
        for i in range(count):
            if abs(differences[i]) <= limit:
                squares += differences[i] * differences[i]
                kept += 1
        passes += 1
        before = sigma
        sigma = math.sqrt(squares / kept) if kept else 0.0
        if abs(sigma - before) <= 0.01 * before or sigma == 0.0:
            break
    noise = sigma / math.sqrt(2.0)
    median = float(np.median(values))
    limit = 3.0 * max(noise, 0.5)
    level = 0.0
    kept = 0
    for i in range(count):
        if abs(values[i] - median) <= limit:
            level += values[i]
            kept += 1
    passes += 1
    return (level / kept if kept else median), noise, passes * count


@numba.njit(nogil=True)
def window_statistics(window: NDArray[np.uint16], scratch: NDArray[np.float64]) -> tuple[float, float, int]:
    """Background and noise (DN, 1 sigma) of a detection window, and the number of passes over its pixels.

    Median and median absolute deviation of ``window_samples`` pixels start; then mean and r.m.s. of the
    pixels within 4 sigma, until it settles (2 %, at most 12 times). From below, a star in a small window does
    not count; and with 4 sigma the noise still grows to its full width where half of a distribution is
    missing (a converter that clips at 0 DN). The sums are whole numbers, so that the mean is exact.
    ``scratch``: at least 256 float64.
    """
    rows, columns = window.shape
    size = rows * columns
    step = _sample_step(size, columns)
    count = 0
    for place in range(0, size, step):
        scratch[count] = window[place // columns, place % columns]
        count += 1
    level = float(np.median(scratch[:count]))
    for i in range(count):
        scratch[i] = abs(scratch[i] - level)
    sigma = max(1.4826 * float(np.median(scratch[:count])), 0.7)
    passes = 0
    for _ in range(12):
        low = math.ceil(level - 4.0 * sigma)
        span = math.floor(level + 4.0 * sigma) - low
        total = 0
        squares = 0
        kept = 0
        for row in range(rows):
            for column in range(columns):
                offset = int(np.int64(window[row, column])) - low
                if 0 <= offset <= span:
                    total += offset
                    squares += offset * offset
                    kept += 1
        passes += 1
        if kept < 2:
            break
        level = (low * kept + total) / kept
        mean = total / kept
        before = sigma
        sigma = math.sqrt(max(squares / kept - mean * mean, 0.0))
        if abs(sigma - before) <= 0.02 * before or sigma == 0.0:
            break
    return level, sigma, passes


@numba.njit(nogil=True)
def window_samples(size: int, columns: int) -> int:
    """How many of a window's ``size`` pixels the medians of ``window_statistics`` are of, at most 256."""
    step = _sample_step(size, columns)
    return (size + step - 1) // step


@numba.njit(nogil=True)
def _sample_step(size: int, columns: int) -> int:
    step = (size + 255) // 256
    if step > 1 and columns % step == 0:
        step += 1  # or the samples would all stand in the same columns
    return step
