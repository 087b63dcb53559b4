"""Which stars can be in an image, and where their light falls during the exposure."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .stars import StarField

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

_CELL_DEG = 6.0
PATH_BLOCK = 8


class StarIndex:
    """The stars of a field sorted into cells of about 6 x 6 degrees, each brightest first."""

    def __init__(self, stars: StarField) -> None:
        v = stars.unit_vectors
        bands = round(180.0 / _CELL_DEG)
        band = np.minimum(
            ((np.arcsin(np.clip(v[:, 2], -1.0, 1.0)) / np.pi + 0.5) * bands).astype(int), bands - 1
        )
        middle = np.pi * ((np.arange(bands) + 0.5) / bands - 0.5)
        per_band = np.ceil(np.cos(middle) * 360.0 / _CELL_DEG).astype(int)
        first = np.concatenate(([0], np.cumsum(per_band)))
        turn = np.arctan2(v[:, 1], v[:, 0]) / (2.0 * np.pi) % 1.0
        cell = first[band] + np.minimum((turn * per_band[band]).astype(int), per_band[band] - 1)
        order = np.lexsort((stars.hip, stars.hp_mag, cell))
        occupied, starts = np.unique(cell[order], return_index=True)
        self.hip = stars.hip[order]
        self.hp_mag = stars.hp_mag[order]
        self.vectors = np.ascontiguousarray(v[order])
        self.parallax_rad = stars.parallax_rad[order]
        self.starts = np.append(starts, len(order)).astype(np.int64)
        sums = np.add.reduceat(self.vectors, starts, axis=0) if len(occupied) else np.zeros((0, 3))
        self.centres = sums / np.linalg.norm(sums, axis=1, keepdims=True)
        cosines = np.einsum("ij,ij->i", self.vectors, np.repeat(self.centres, np.diff(self.starts), axis=0))
        # the rounding of one dot product is allowed for
        self.radii = (
            np.arccos(np.clip(np.minimum.reduceat(cosines, starts), -1.0, 1.0)) + 1e-7
            if len(occupied)
            else np.zeros(0)
        )

    def __len__(self) -> int:
        return int(self.hip.shape[0])

    def within(self, axis: F64, radius_rad: float, limit_mag: float) -> I32:
        """Numbers (in this index's order) of the stars within radius_rad of a unit vector with Hp <
        limit_mag."""
        return stars_within(
            axis,
            radius_rad,
            np.float32(limit_mag),
            self.centres,
            self.radii,
            self.starts,
            self.vectors,
            self.hp_mag,
        )


_KEPT: list[tuple[StarField, StarIndex]] = []
_MOST_KEPT = 2


def star_index_of(stars: StarField) -> StarIndex:
    """The index of a field; that of the fields asked for last is kept, as it takes a tenth of a second."""
    for field, index in _KEPT:
        if field is stars:
            return index
    index = StarIndex(stars)
    _KEPT.insert(0, (stars, index))
    del _KEPT[_MOST_KEPT:]
    return index


@njit(nogil=True, error_model="numpy")
def stars_within(
    axis: F64,
    radius: float,
    limit_mag: np.float32,
    centres: F64,
    radii: F64,
    starts: NDArray[np.int64],
    vectors: F64,
    hp_mag: NDArray[np.float32],
) -> I32:
    """See `StarIndex.within`."""
    cells = np.empty(centres.shape[0], np.int32)
    n_cells = 0
    room = 0
    for c in range(centres.shape[0]):
        cosine = axis[0] * centres[c, 0] + axis[1] * centres[c, 1] + axis[2] * centres[c, 2]
        reach = radius + radii[c]
        if reach >= math.pi or cosine >= math.cos(reach):
            cells[n_cells] = c
            n_cells += 1
            room += starts[c + 1] - starts[c]
    found = np.empty(room, np.int32)
    n = 0
    least = math.cos(min(radius, math.pi))
    for k in range(n_cells):
        c = cells[k]
        for i in range(starts[c], starts[c + 1]):
            if hp_mag[i] >= limit_mag:
                break
            if axis[0] * vectors[i, 0] + axis[1] * vectors[i, 1] + axis[2] * vectors[i, 2] >= least:
                found[n] = i
                n += 1
    return found[:n].copy()


@njit(nogil=True, error_model="numpy")
def matrix_of(q: F64, matrix: F64) -> None:
    """As `quaternion.attitude_matrix`, for one quaternion."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    matrix[0, 0] = w * w + x * x - y * y - z * z
    matrix[0, 1] = 2.0 * (x * y + w * z)
    matrix[0, 2] = 2.0 * (x * z - w * y)
    matrix[1, 0] = 2.0 * (x * y - w * z)
    matrix[1, 1] = w * w - x * x + y * y - z * z
    matrix[1, 2] = 2.0 * (y * z + w * x)
    matrix[2, 0] = 2.0 * (x * z + w * y)
    matrix[2, 1] = 2.0 * (y * z - w * x)
    matrix[2, 2] = w * w - x * x - y * y + z * z


@njit(nogil=True, error_model="numpy")
def turn_between(b: F64, a: F64) -> tuple[float, float]:
    """From attitude b to a: angles turned across and about the boresight, rad."""
    # vector part of a (x) conjugate(b): half the rotation vector, but for its arcsine
    x = -a[3] * b[0] + b[3] * a[0] + (a[1] * b[2] - a[2] * b[1])
    y = -a[3] * b[1] + b[3] * a[1] + (a[2] * b[0] - a[0] * b[2])
    z = -a[3] * b[2] + b[3] * a[2] + (a[0] * b[1] - a[1] * b[0])
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 * math.asin(min(sine, 1.0)) / sine if sine > 1e-12 else 2.0
    return scale * math.sqrt(x * x + y * y), scale * abs(z)


@njit(nogil=True, error_model="numpy")
def turned(q: F64) -> tuple[float, float]:
    """Along attitudes [n, 4]: angles turned across and about the boresight, rad, summed over the steps."""
    across = 0.0
    about = 0.0
    for k in range(q.shape[0] - 1):
        step_across, step_about = turn_between(q[k], q[k + 1])
        across += step_across
        about += step_about
    return across, about


@njit(nogil=True, error_model="numpy")
def _project(a: F64, ux: float, uy: float, uz: float, optics: F64) -> tuple[float, float, bool]:
    """(x_px, y_px, whether it is ahead) of a direction at an attitude matrix, as `CameraModel.project`."""
    focal, cx, cy, k1, k2, p1, p2 = (
        optics[2],
        optics[3],
        optics[4],
        optics[5],
        optics[6],
        optics[7],
        optics[8],
    )
    z = a[2, 0] * ux + a[2, 1] * uy + a[2, 2] * uz
    if z < 0.05:
        return 0.0, 0.0, False
    x = (a[0, 0] * ux + a[0, 1] * uy + a[0, 2] * uz) / z
    y = (a[1, 0] * ux + a[1, 1] * uy + a[1, 2] * uz) / z
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * k2)
    px = cx + focal * (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x))
    py = cy + focal * (y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y)
    return px, py, True


@njit(nogil=True, error_model="numpy")
def image_paths(
    chosen: I32,
    vectors: F64,
    parallax: NDArray[np.float32],
    electrons_s: F64,
    observer_au: F64,
    beta: F64,
    occulting: F64,
    attitudes: F64,
    at_middle: F64,
    optics: F64,
    reach_px: float,
    exposure_s: float,
    false_spots: F64,
    row_step: float,
    row_span: float,
    block_px: float,
) -> tuple[I32, F64, F64, F64, I32, I32, F64]:
    """Where the chosen stars' light falls: the stars whose light touches the image, in the order given.

    vectors, parallax, electrons_s are indexed by chosen. observer_au: barycentric, for the parallax (zeros:
    none). beta: the observer's velocity over the speed of light, for the aberration (zeros: none). occulting:
    [x, y, z, cos]: stars within acos(cos) of that unit vector are hidden (cos > 1: none). attitudes
    [points, 4]: q_icrs_to_sensor at the middle of each sub-step; with a rolling shutter at their ends (one
    more than there are sub-steps). at_middle: at mid-exposure. optics: [width, height, focal, cx, cy, k1,
    k2, p1, p2]. false_spots [m, 3]: x_px, y_px, electrons in the exposure; they stand still and come after
    the stars with the number -1. row_step, row_span: of a rolling shutter, in sub-steps, from the start of a
    row to that of the next one, and the length of the exposure; row_span 0: a global shutter. block_px: no
    star moves by more in PATH_BLOCK sub-steps.

    Returns (number int32[n], x_px float64[n, points], y_px, electrons in the exposure float64[n], box
    int32[n, 4], lit int32[n, 2], middle float64[n, 2]): box is x0, y0, x1, y1, half-open, of the pixels
    touched, clipped to the image; lit the first sub-step in which a row that it touches is exposed, and the
    one behind the last; middle x_px, y_px at mid-exposure.
    """
    points = attitudes.shape[0]
    rolling = row_span > 0.0
    room = chosen.shape[0] + false_spots.shape[0]
    number = np.empty(room, np.int32)
    xs = np.empty((room, points))
    ys = np.empty((room, points))
    light = np.empty(room)
    box = np.empty((room, 4), np.int32)
    lit = np.empty((room, 2), np.int32)
    middle = np.empty((room, 2))
    width, height = int(optics[0]), int(optics[1])
    beta_squared = beta[0] * beta[0] + beta[1] * beta[1] + beta[2] * beta[2]
    inverse_gamma = math.sqrt(1.0 - beta_squared)
    matrices = np.empty((points + 1, 3, 3))
    for s in range(points):
        matrix_of(attitudes[s], matrices[s])
    matrix_of(at_middle, matrices[points])
    n = 0
    for k in range(room):
        star = -1
        amount = 0.0
        ux = uy = uz = 0.0
        if k < chosen.shape[0]:
            star = chosen[k]
            amount = electrons_s[star] * exposure_s
            ux, uy, uz = vectors[star, 0], vectors[star, 1], vectors[star, 2]
            shift = np.float64(parallax[star])
            ux -= shift * observer_au[0]
            uy -= shift * observer_au[1]
            uz -= shift * observer_au[2]
            norm = math.sqrt(ux * ux + uy * uy + uz * uz)
            ux, uy, uz = ux / norm, uy / norm, uz / norm
            if ux * occulting[0] + uy * occulting[1] + uz * occulting[2] > occulting[3]:
                continue
            # as `stars.aberrate`, but for the norm, which a projection does not feel
            along = 1.0 + (ux * beta[0] + uy * beta[1] + uz * beta[2]) / (1.0 + inverse_gamma)
            ux = inverse_gamma * ux + along * beta[0]
            uy = inverse_gamma * uy + along * beta[1]
            uz = inverse_gamma * uz + along * beta[2]
            ahead = True
            from_point, to_point = 0, points
            if rolling:
                from_point, to_point, ahead = _points_needed(
                    matrices, points, ux, uy, uz, optics, reach_px + block_px, row_step, row_span
                )
                if from_point == to_point:
                    continue
            for s in range(from_point, to_point):
                px, py, ahead = _project(matrices[s], ux, uy, uz, optics)
                if not ahead:
                    break
                xs[n, s], ys[n, s] = px, py
            if not ahead:
                continue
            middle[n, 0], middle[n, 1], _ = _project(matrices[points], ux, uy, uz, optics)
        else:
            px, py, amount = (
                false_spots[k - chosen.shape[0], 0],
                false_spots[k - chosen.shape[0], 1],
                false_spots[k - chosen.shape[0], 2],
            )
            xs[n], ys[n] = px, py
            from_point, to_point = 0, points
            middle[n, 0], middle[n, 1] = px, py
        lit[n, 0], lit[n, 1] = 0, points
        if rolling:
            lit[n, 0], lit[n, 1] = _lit_steps(
                ys[n], from_point, to_point - 1, reach_px, row_step, row_span, height
            )
        low_x = low_y = 1e9
        high_x = high_y = -1e9
        for s in range(lit[n, 0], min(lit[n, 1] + (1 if rolling else 0), points)):
            low_x, high_x = min(low_x, xs[n, s]), max(high_x, xs[n, s])
            low_y, high_y = min(low_y, ys[n, s]), max(high_y, ys[n, s])
        x0 = max(math.floor(max(low_x, -1e6) - reach_px + 0.5), 0)
        y0 = max(math.floor(max(low_y, -1e6) - reach_px + 0.5), 0)
        x1 = min(math.floor(min(high_x, 1e6) + reach_px + 0.5) + 1, width)
        y1 = min(math.floor(min(high_y, 1e6) + reach_px + 0.5) + 1, height)
        if high_x < low_x or x0 >= x1 or y0 >= y1:
            continue
        number[n] = star
        light[n] = amount
        box[n, 0], box[n, 1], box[n, 2], box[n, 3] = x0, y0, x1, y1
        n += 1
    return (
        number[:n].copy(),
        xs[:n].copy(),
        ys[:n].copy(),
        light[:n].copy(),
        box[:n].copy(),
        lit[:n].copy(),
        middle[:n].copy(),
    )


@njit(nogil=True, error_model="numpy")
def _points_needed(
    matrices: F64,
    points: int,
    ux: float,
    uy: float,
    uz: float,
    optics: F64,
    margin_px: float,
    row_step: float,
    row_span: float,
) -> tuple[int, int, bool]:
    """(first, end, whether all that was looked at is ahead): the points of a star's path, of which every
    PATH_BLOCK-th is looked at, between which it may light a row; margin_px: so far off light reaches a point.
    """
    width, height = optics[0], optics[1]
    first, end = points, 0
    for block in range(0, points - 1, PATH_BLOCK):
        last = min(block + PATH_BLOCK, points - 1)
        px, py, ahead = _project(matrices[(block + last) // 2], ux, uy, uz, optics)
        if not ahead:
            return 0, 0, False
        lowest = max((block - row_span) / row_step - 1.0, 0.0)
        highest = min(last / row_step + 1.0, height)
        if -margin_px <= px <= width + margin_px and py + margin_px >= lowest and py - margin_px <= highest:
            first = min(first, block)
            end = last + 1
    return first, max(end, first), True


@njit(nogil=True, error_model="numpy")
def _lit_steps(
    y: F64, first_point: int, last_point: int, reach_px: float, row_step: float, row_span: float, height: int
) -> tuple[int, int]:
    """The first sub-step in which a rolling shutter exposes a row that the star touches, and the one behind
    the last; y [steps + 1] at the ends of the sub-steps, known from first_point to last_point. It may begin a
    row too early and end one too late.
    """
    first, end = last_point, first_point
    far = reach_px + 1.5
    for s in range(first_point, last_point):
        # the rows from lowest to highest that are exposed at some time in the sub-step
        lowest = max((s - row_span) / row_step - 1.0, 0.0)
        highest = min((s + 1.0) / row_step + 1.0, height - 1.0)
        if max(y[s], y[s + 1]) + far >= lowest and min(y[s], y[s + 1]) - far <= highest:
            first = min(first, s)
            end = s + 1
    return first, end
