"""Star light on the rows of a rolling shutter, each of which is exposed in its own time.

A row gets of a sub-step's light the part in which it is exposed. Where that is the whole sub-step, the star
stands in the sub-step's middle; else in the middle of that part. The shares of the point spread come from a
table over the place within a pixel, straight between its lines (2e-6 of a star's light off): light is added
to eight pixels of a row at a time.

A shutter that exposes all rows at once is one whose rows all start at 0; so light can be had quickly for it.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .eight_lanes import LANES, add_scaled, between
from .lit_scene import Scene

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

_LINES = 256  # of the table, a pixel


@lru_cache(maxsize=8)
def share_table(sigma_px: float, reach_px: float) -> F32:
    """Shares of a Gaussian on the pixels about it: float32[lines, pixels].

    Line i is that of a star i / 256 px behind the middle of pixel number pixels / 2 - 1; pixels is a multiple
    of 8 and holds reach_px on each side.
    """
    pixels = LANES * math.ceil((2.0 * reach_px + 1.0) / LANES)
    place = np.arange(_LINES + 2) / _LINES
    edges = np.arange(pixels + 1) - (pixels // 2 - 1) - 0.5
    z = (edges[np.newaxis, :] - place[:, np.newaxis]) / (sigma_px * math.sqrt(2.0))
    below = np.array([0.5 * math.erfc(-value) for value in z.ravel()]).reshape(z.shape)
    return np.ascontiguousarray(np.diff(below, axis=1), dtype=np.float32)


@njit(nogil=True, error_model="numpy")
def _shares_at(place: float, table: F32, pixels: int, out: F32) -> int:
    """The shares about a place of one axis into out; returns the pixel of the first one. table: flat."""
    before = math.floor(place)
    line = (place - before) * _LINES
    number = math.floor(line)
    part = np.float32(line - number)
    for first in range(0, pixels, LANES):
        here = number * pixels + first
        between(table, here, here + pixels, part, out, first)
    return int(before) - (pixels // 2 - 1)


@njit(nogil=True, error_model="numpy")
def _add_row(flat: F32, at: int, amount: np.float32, shares: F32, pixels: int) -> None:
    """Adds amount x shares to flat[at:], eight pixels at a time."""
    for first in range(0, pixels, LANES):
        add_scaled(flat, at + first, amount, shares, first)


@njit(nogil=True, error_model="numpy")
def add_stars_by_rows(x0: int, y0: int, scene: Scene, near: I32, wide: F32) -> None:
    """Adds the stars' electrons, stars and sub-steps in their order, to a rectangle that begins at x0, y0.

    near: the stars to look at, `stars_near` of a rectangle that holds this one. wide float32[rows + 2 margin,
    columns + 2 margin]: the rectangle with a margin of share_table's pixels about it, in which light falls as
    well, but not all of it.
    """
    xs, ys, light, box = scene.xs, scene.ys, scene.light, scene.box
    table = scene.share_table.reshape(-1)
    flat = wide.reshape(-1)
    row_starts, row_span = scene.row_starts, scene.row_span
    rows = row_starts.shape[0]
    pixels = scene.share_table.shape[1]
    columns_wide, rows_wide = wide.shape[1], wide.shape[0]
    x1, y1 = x0 + columns_wide - 2 * pixels, y0 + rows_wide - 2 * pixels
    share_x, share_y = np.empty(pixels, np.float32), np.empty(pixels, np.float32)
    column_x = np.empty(pixels, np.float32)
    half = pixels // 2
    for k in near:
        if box[k, 0] >= x1 or box[k, 2] <= x0 or box[k, 1] >= y1 or box[k, 3] <= y0:
            continue
        each = light[k] / row_span
        for s in range(scene.lit[k, 0], scene.lit[k, 1]):
            ya, yb = ys[k, s], ys[k, s + 1]
            low, high = min(ya, yb), max(ya, yb)
            if low - half > y1 or high + half < y0:
                continue
            xa, xb = xs[k, s], xs[k, s + 1]
            if min(xa, xb) - half > x1 or max(xa, xb) + half < x0:
                continue
            first = max(math.floor(low) - (half - 1), 0)
            end = min(math.floor(high) + half + 1, rows)
            begins, ends = np.float64(s), s + 1.0
            if first >= end or row_starts[first] >= ends or row_starts[end - 1] + row_span <= begins:
                continue
            # whole: all the rows in reach are exposed for the whole sub-step
            whole = row_starts[end - 1] <= begins and row_starts[first] + row_span >= ends
            column = _shares_at(0.5 * (xa + xb), table, pixels, share_x)
            top = _shares_at(0.5 * (ya + yb), table, pixels, share_y)
            at_x, at_y = column - x0 + pixels, top - y0 + pixels
            if 0 <= at_x <= columns_wide - pixels:
                for i in range(max(-at_y, -top, 0), min(rows_wide - at_y, rows - top, pixels)):
                    r = top + i
                    if whole or (row_starts[r] <= begins and row_starts[r] + row_span >= ends):
                        at = (at_y + i) * columns_wide + at_x
                        _add_row(flat, at, np.float32(each * share_y[i]), share_x, pixels)
            if whole:
                continue
            for r in range(max(first, y0), min(end, y1)):
                if row_starts[r] <= begins and row_starts[r] + row_span >= ends:
                    continue
                since = max(row_starts[r] - begins, 0.0)
                until = min(row_starts[r] + row_span - begins, 1.0)
                if until <= since:
                    continue
                middle = 0.5 * (since + until)
                column = _shares_at(xa + middle * (xb - xa), table, pixels, column_x)
                i = r - _shares_at(ya + middle * (yb - ya), table, pixels, share_y)
                at_x = column - x0 + pixels
                if 0 <= i < pixels and 0 <= at_x <= columns_wide - pixels:
                    at = (r - y0 + pixels) * columns_wide + at_x
                    _add_row(flat, at, np.float32(each * (until - since) * share_y[i]), column_x, pixels)
