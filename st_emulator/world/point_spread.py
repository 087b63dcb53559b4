"""Star light on pixels: a Gaussian point spread integrated over each pixel, summed along the path of the
exposure.

Each sub-step's share on pixel column i is Phi((i + 1/2 - x) / sigma) - Phi((i - 1/2 - x) / sigma), and the
same by rows (Zhang et al. 2014, equations 4-5, in terms of the normal distribution Phi). Pixels out to those
that hold x +- 4.5 sigma are lit: at most 1.4e-5 of a star's light is lost. Phi comes from a table of its
values and a Taylor series to fourth order about the nearest (error under 1e-10): faster than erf, and the
same on every machine.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .exposed_rows import add_stars_by_rows
from .lit_scene import Scene
from .noise import digitise, normals_of, words_of

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U64 = NDArray[np.uint64]
I32 = NDArray[np.int32]

SUPPORT_SIGMA = 4.5
_PER_SIGMA = 32.0
_LIMIT = 7.0
_STRIP_PIXELS = 8192
_STAR_STRIP_PIXELS = 65536


def _phi_table() -> F64:
    x = np.arange(-int(_LIMIT * _PER_SIGMA), int(_LIMIT * _PER_SIGMA) + 1) / _PER_SIGMA
    value = [0.5 * math.erfc(-t / math.sqrt(2.0)) for t in x]
    density = [math.exp(-0.5 * t * t) / math.sqrt(2.0 * math.pi) for t in x]
    return np.stack((value, density), axis=1)


PHI_TABLE: F64 = _phi_table()


@njit(nogil=True, error_model="numpy")
def phi(x: float, table: F64) -> float:
    """The normal distribution function at x, clamped to +-7."""
    x = min(max(x, -_LIMIT), _LIMIT)
    nearest = math.floor(x * _PER_SIGMA + 0.5)
    x0 = nearest / _PER_SIGMA
    d = x - x0
    row = nearest + int(_LIMIT * _PER_SIGMA)
    x0_squared = x0 * x0
    series = 1.0 - d * (0.5 * x0 - d * ((x0_squared - 1.0) / 6.0 - d * (x0_squared - 3.0) * x0 / 24.0))
    return float(table[row, 0] + table[row, 1] * d * series)


@njit(nogil=True, error_model="numpy")
def _shares(first: int, end: int, centre: float, inverse_sigma: float, table: F64, out: F64) -> None:
    """out[i - first] = the share of the light on pixels i = first .. end - 1 of one axis."""
    left = phi((first - 0.5 - centre) * inverse_sigma, table)
    for i in range(first, end):
        right = phi((i + 0.5 - centre) * inverse_sigma, table)
        out[i - first] = right - left
        left = right


@njit(nogil=True, error_model="numpy")
def stars_near(rect: I32, box: I32) -> I32:
    """Numbers of the stars whose light touches a rectangle (x0, y0, x1, y1, half-open), in their order."""
    near = np.empty(box.shape[0], np.int32)
    n = 0
    for k in range(box.shape[0]):
        if box[k, 0] < rect[2] and box[k, 2] > rect[0] and box[k, 1] < rect[3] and box[k, 3] > rect[1]:
            near[n] = k
            n += 1
    return near[:n]


@njit(nogil=True, error_model="numpy")
def add_stars(x0: int, y0: int, scene: Scene, near: I32, share_x: F64, share_y: F64, signal: F32) -> None:
    """Adds the stars' electrons to signal[row - y0, column - x0], stars and sub-steps in their order.

    near: the stars to look at, `stars_near` of a rectangle that holds this one. share_x, share_y: scratch,
    as long as signal is wide and high.
    """
    xs, ys, light, box, table = scene.xs, scene.ys, scene.light, scene.box, scene.phi_table
    x1, y1 = x0 + signal.shape[1], y0 + signal.shape[0]
    steps = xs.shape[1]
    inverse_sigma = 1.0 / scene.sigma_px
    reach = SUPPORT_SIGMA * scene.sigma_px
    for k in near:
        if box[k, 0] >= x1 or box[k, 2] <= x0 or box[k, 1] >= y1 or box[k, 3] <= y0:
            continue
        each = light[k] / steps
        for s in range(steps):
            x, y = xs[k, s], ys[k, s]
            c0 = max(math.floor(x - reach + 0.5), x0)
            c1 = min(math.floor(x + reach + 0.5) + 1, x1)
            r0 = max(math.floor(y - reach + 0.5), y0)
            r1 = min(math.floor(y + reach + 0.5) + 1, y1)
            if c0 >= c1 or r0 >= r1:
                continue
            _shares(c0, c1, x, inverse_sigma, table, share_x)
            _shares(r0, r1, y, inverse_sigma, table, share_y)
            for r in range(r0, r1):
                row_light = each * share_y[r - r0]
                row = signal[r - y0, c0 - x0 : c1 - x0]
                for c in range(row.shape[0]):
                    row[c] += np.float32(row_light * share_x[c])


@njit(nogil=True, error_model="numpy")
def seen_places(scene: Scene) -> tuple[F64, F64, F64]:
    """(mean x_px [n], mean y_px, electrons) of each star's light as the rows of a rolling shutter see it.

    A star that no row sees has no electrons and no place. Rows go on beyond the image's edges.
    """
    xs, ys, row_starts, row_span = scene.xs, scene.ys, scene.row_starts, scene.row_span
    n = xs.shape[0]
    x, y, electrons = np.zeros(n), np.zeros(n), np.zeros(n)
    inverse_sigma = 1.0 / scene.sigma_px
    reach = SUPPORT_SIGMA * scene.sigma_px
    row_step = row_starts[-1] / max(row_starts.shape[0] - 1, 1)
    for k in range(n):
        for s in range(scene.lit[k, 0], scene.lit[k, 1]):
            xa, xb, ya, yb = xs[k, s], xs[k, s + 1], ys[k, s], ys[k, s + 1]
            first = math.floor(min(ya, yb) - reach + 0.5)
            end = math.floor(max(ya, yb) + reach + 0.5) + 1
            if first * row_step >= s + 1.0 or (end - 1) * row_step + row_span <= s:
                continue
            if (end - 1) * row_step <= s and first * row_step + row_span >= s + 1.0:
                x[k] += 0.5 * (xa + xb)
                y[k] += 0.5 * (ya + yb)
                electrons[k] += 1.0
                continue
            for r in range(first, end):
                since = max(r * row_step - s, 0.0)
                until = min(r * row_step + row_span - s, 1.0)
                if until <= since:
                    continue
                at = 0.5 * (since + until)
                middle = (r - ya - at * (yb - ya)) * inverse_sigma
                half = 0.5 * inverse_sigma
                share = phi(middle + half, scene.phi_table) - phi(middle - half, scene.phi_table)
                part = (until - since) * share
                x[k] += part * (xa + at * (xb - xa))
                y[k] += part * r
                electrons[k] += part
        if electrons[k] > 0.0:
            x[k] /= electrons[k]
            y[k] /= electrons[k]
            electrons[k] *= scene.light[k] / row_span
    return x, y, electrons


@njit(nogil=True, error_model="numpy")
def add_background(x0: int, y0: int, scene: Scene, signal: F32) -> None:
    """Star light in, mean charge out: adds stray light, applies the response, adds the dark current."""
    w = signal.shape[1]
    uniform = np.float32(scene.stray)
    time = np.float32(scene.exposure_s)
    for r in range(signal.shape[0]):
        row = signal[r]
        for g in range(scene.glow_rows.shape[0]):
            factor = scene.glow_rows[g, y0 + r]
            columns = scene.glow_columns[g, x0 : x0 + w]
            for c in range(w):
                row[c] += factor * columns[c]
        gains = scene.response[y0 + r, x0 : x0 + w]
        currents = scene.dark[y0 + r, x0 : x0 + w]
        for c in range(w):
            row[c] = (row[c] + uniform) * gains[c] + currents[c] * time


@njit(nogil=True, error_model="numpy")
def expose(rect: I32, scene: Scene) -> F32:
    """Mean electrons of the pixels of a rectangle (x0, y0, x1, y1, half-open): float32[rows, columns]."""
    w, h = rect[2] - rect[0], rect[3] - rect[1]
    signal = np.zeros((h, w), np.float32)
    near = stars_near(rect, scene.box)
    if scene.row_span > 0.0:
        margin = scene.share_table.shape[1]
        wide = np.zeros((h + 2 * margin, w + 2 * margin), np.float32)
        add_stars_by_rows(rect[0], rect[1], scene, near, wide)
        signal[:] = wide[margin : margin + h, margin : margin + w]
    else:
        add_stars(rect[0], rect[1], scene, near, np.empty(w), np.empty(h), signal)
    add_background(rect[0], rect[1], scene, signal)
    return signal


@njit(nogil=True, error_model="numpy")
def render(
    rects: I32,
    scene: Scene,
    key: np.uint64,
    normal_table: F32,
    detector: F32,
    offsets: NDArray[np.int64],
    out: NDArray[np.uint16],
) -> None:
    """What the detector puts out in each rectangle, row by row into out[offsets[i]:].

    key: the frame's stream of noise; detector: `noise.detector_constants`. Works through strips of rows, so
    that the working set stays in the processor's cache: high ones for the stars, of a few rows for the rest.
    """
    widest = 1
    highest = 1
    for i in range(rects.shape[0]):
        widest = max(widest, rects[i, 2] - rects[i, 0])
        highest = max(highest, rects[i, 3] - rects[i, 1])
    by_rows = scene.row_span > 0.0
    margin = scene.share_table.shape[1] if by_rows else 0
    tall_rows = max(min(_STAR_STRIP_PIXELS // widest, highest), 1)
    tall_room = np.empty((tall_rows + 2 * margin) * (widest + 2 * margin), np.float32)
    room = np.empty(max(_STRIP_PIXELS, widest), np.float32)
    share_x, share_y = np.empty(widest), np.empty(highest)
    words = np.empty(room.shape[0], np.uint64)
    deviates = np.empty(room.shape[0], np.float32)
    image_width = scene.response.shape[1]
    for i in range(rects.shape[0]):
        x0, y0, x1, y1 = rects[i, 0], rects[i, 1], rects[i, 2], rects[i, 3]
        w = x1 - x0
        if w <= 0:
            continue
        at = offsets[i]
        near = stars_near(rects[i], scene.box)
        strip_rows = max(_STRIP_PIXELS // w, 1)
        for tall_top in range(y0, y1, tall_rows):
            tall = min(tall_rows, y1 - tall_top)
            wide_w = w + 2 * margin
            stars = tall_room[: (tall + 2 * margin) * wide_w].reshape((tall + 2 * margin, wide_w))
            stars[:] = np.float32(0.0)
            if by_rows:
                add_stars_by_rows(x0, tall_top, scene, near, stars)
            else:
                add_stars(x0, tall_top, scene, near, share_x, share_y, stars)
            for top in range(tall_top, tall_top + tall, strip_rows):
                h = min(strip_rows, tall_top + tall - top)
                n = h * w
                flat = tall_room[(top - tall_top) * w : (top - tall_top) * w + n]
                if by_rows:
                    flat = room[:n]
                    for r in range(h):
                        lit = stars[margin + top - tall_top + r]
                        flat[r * w : r * w + w] = lit[margin : margin + w]
                add_background(x0, top, scene, flat.reshape((h, w)))
                for r in range(h):
                    words_of(key, (top + r) * image_width + x0, words[r * w : r * w + w])
                normals_of(words[:n], normal_table, deviates[:n])
                digitise(flat, words[:n], deviates[:n], normal_table, detector, out[at : at + n])
                at += n
