"""Which catalogue stars are near a direction: a grid of declination bands cut into cells of right ascension.

The grid is plain arrays, so that it can be flashed with the catalogue: `cell_start[c] .. cell_start[c + 1]`
are the places in `cell_star` that hold the stars of cell c, and `band_first_cell[b]` is the first cell of
declination band b.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]

STARS_PER_CELL = (
    2.0  # ASSUMED: small cells cost cell visits, large ones cost star tests; 2 stars balance the two
)
SMALLEST_CELL_RAD = math.radians(0.5)
LARGEST_CELL_RAD = math.radians(15.0)


@dataclass(frozen=True)
class SkyCells:
    """The grid of one star catalogue.

    band_height_rad: height of each declination band, from the south pole upwards.
    band_first_cell: int32[bands + 1], number of the first cell of each band; the last entry is the number
        of cells.
    cell_start: int32[cells + 1], place in cell_star of each cell's first star.
    cell_star: int32[stars], rows of the catalogue, cell by cell.
    """

    band_height_rad: float
    band_first_cell: IntArray
    cell_start: IntArray
    cell_star: IntArray


def build_sky_cells(unit_vectors: FloatArray) -> SkyCells:
    """Grid of the directions unit_vectors[n, 3]; cells are about as wide as high and hold about two stars."""
    count = len(unit_vectors)
    size = math.sqrt(4.0 * math.pi * STARS_PER_CELL / max(count, 1))
    size = min(max(size, SMALLEST_CELL_RAD), LARGEST_CELL_RAD)
    bands = max(1, round(math.pi / size))
    height = math.pi / bands
    # A band is cut by its widest circle, so that no cell is wider than it is high.
    south = -0.5 * math.pi + height * np.arange(bands)
    widest = np.where(south * (south + height) < 0.0, 1.0, np.maximum(np.cos(south), np.cos(south + height)))
    cells_of_band = np.maximum(1, np.ceil(2.0 * math.pi * widest / height)).astype(np.int32)
    band_first_cell = np.zeros(bands + 1, np.int32)
    np.cumsum(cells_of_band, out=band_first_cell[1:])
    dec = np.arcsin(np.clip(unit_vectors[:, 2], -1.0, 1.0))
    ra = np.arctan2(unit_vectors[:, 1], unit_vectors[:, 0]) % (2.0 * math.pi)
    band = np.clip(np.floor((dec + 0.5 * math.pi) / height).astype(np.int64), 0, bands - 1)
    column = np.floor(ra / (2.0 * math.pi) * cells_of_band[band]).astype(np.int64)
    cell = band_first_cell[band] + np.clip(column, 0, cells_of_band[band] - 1)
    order = np.argsort(cell, kind="stable").astype(np.int32)
    cell_start = np.zeros(int(band_first_cell[-1]) + 1, np.int32)
    np.cumsum(np.bincount(cell, minlength=int(band_first_cell[-1])), out=cell_start[1:])
    return SkyCells(height, band_first_cell, cell_start, order)


@numba.njit(nogil=True)
def stars_in_cone_kernel(
    unit_vectors: FloatArray,
    band_height_rad: float,
    band_first_cell: IntArray,
    cell_start: IntArray,
    cell_star: IntArray,
    x: float,
    y: float,
    z: float,
    radius_rad: float,
    found: IntArray,
) -> tuple[int, int]:
    """Write the rows of the stars within radius_rad of (x, y, z) to `found`, in the grid's order.

    Returns (stars found, stars tested). No more than len(found) rows are written; the count goes on.
    """
    bands = len(band_first_cell) - 1
    cos_radius = math.cos(radius_rad) if radius_rad < math.pi else -1.0
    dec = math.asin(min(1.0, max(-1.0, z)))
    # The rounding of asin and of the bands' edges must never lose a star at the rim.
    margin = 1e-9
    first_band = max(0, math.floor((dec - radius_rad - margin + 0.5 * math.pi) / band_height_rad))
    last_band = min(bands - 1, math.floor((dec + radius_rad + margin + 0.5 * math.pi) / band_height_rad))
    over_pole = abs(dec) + radius_rad >= 0.5 * math.pi - 1e-6
    ra = 0.0
    half_width = math.pi
    if not over_pole:
        ra = math.atan2(y, x)
        if ra < 0.0:
            ra += 2.0 * math.pi
        # The widest half-angle in right ascension of a cone that does not hold a pole.
        half_width = math.asin(min(1.0, math.sin(radius_rad) / math.cos(dec))) + margin
    count = 0
    tested = 0
    for band in range(first_band, last_band + 1):
        first_cell = band_first_cell[band]
        cells = band_first_cell[band + 1] - first_cell
        low = 0
        high = cells - 1
        if not over_pole:
            scale = cells / (2.0 * math.pi)
            low = math.floor((ra - half_width) * scale)
            high = math.floor((ra + half_width) * scale)
            if high - low >= cells:
                low = 0
                high = cells - 1
        for column in range(low, high + 1):
            cell = first_cell + (column + cells) % cells
            for place in range(cell_start[cell], cell_start[cell + 1]):
                star = cell_star[place]
                tested += 1
                dot = unit_vectors[star, 0] * x + unit_vectors[star, 1] * y + unit_vectors[star, 2] * z
                if dot >= cos_radius:
                    if count < len(found):
                        found[count] = star
                    count += 1
    return count, tested


@numba.njit(nogil=True)
def nearest_star_kernel(
    unit_vectors: FloatArray,
    band_height_rad: float,
    band_first_cell: IntArray,
    cell_start: IntArray,
    cell_star: IntArray,
    x: float,
    y: float,
    z: float,
    radius_rad: float,
    found: IntArray,
) -> tuple[int, float, int]:
    """The star nearest to the unit vector (x, y, z) within radius_rad: (row or -1, angle_rad, stars tested).

    `found` is room to work in. The angle is from the chord, which keeps its precision where the cosine
    loses it.
    """
    count, tested = stars_in_cone_kernel(
        unit_vectors, band_height_rad, band_first_cell, cell_start, cell_star, x, y, z, radius_rad, found
    )
    nearest = -1
    smallest = 1e300
    for place in range(min(count, len(found))):
        star = found[place]
        dx = unit_vectors[star, 0] - x
        dy = unit_vectors[star, 1] - y
        dz = unit_vectors[star, 2] - z
        square = dx * dx + dy * dy + dz * dz
        if square < smallest:
            smallest = square
            nearest = star
    if nearest < 0:
        return -1, math.pi, tested
    return nearest, 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(smallest))), tested
