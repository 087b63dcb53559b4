"""The on-board star catalogue: what the camera can tell apart, from a table of stars.

Sarvi et al. 2014, "Catalogue structure": of stars closer than the angular resolution of the lens only one
stays, as base star. One catalogue serves lost in space and tracking.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from .sky_cells import FloatArray, IntArray, SkyCells, build_sky_cells, stars_in_cone_kernel

MOST_COMPANIONS = 256


@dataclass(frozen=True)
class StarCatalogue:
    """Stars that lost in space and tracking both use, in ascending order of their numbers.

    hip: int32[n], Hipparcos number (of the brightest component where several merge).
    unit_vectors: float64[n, 3], directions in ICRS at the epoch of the table it was built from.
    hp_mag: float32[n], Hipparcos magnitude, of the merged light.
    limit_mag: every star is brighter than this.
    resolution_rad: components closer than this were merged.
    cells: grid for searches by direction.
    """

    hip: IntArray
    unit_vectors: FloatArray
    hp_mag: npt.NDArray[np.float32]
    limit_mag: float
    resolution_rad: float
    cells: SkyCells

    def __len__(self) -> int:
        return len(self.hip)

    def stars_near(self, direction: FloatArray, radius_rad: float) -> tuple[IntArray, int]:
        """Rows of the stars within radius_rad of direction[3] (ICRS, unit), and how many were tested."""
        found = np.empty(len(self.hip), np.int32)
        count, tested = stars_in_cone_kernel(
            self.unit_vectors,
            self.cells.band_height_rad,
            self.cells.band_first_cell,
            self.cells.cell_start,
            self.cells.cell_star,
            float(direction[0]),
            float(direction[1]),
            float(direction[2]),
            radius_rad,
            found,
        )
        return found[:count].copy(), int(tested)

    def row_of(self, hip: int) -> int:
        """Row of a Hipparcos number, or -1 when the catalogue does not hold it."""
        place = int(np.searchsorted(self.hip, hip))
        return place if place < len(self.hip) and self.hip[place] == hip else -1

    def to_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """The catalogue as plain arrays, for a cache or an image of the unit's memory."""
        return {
            "star_hip": self.hip,
            "star_unit_vectors": self.unit_vectors,
            "star_hp_mag": self.hp_mag,
            "star_limits": np.array([self.limit_mag, self.resolution_rad, self.cells.band_height_rad]),
            "star_band_first_cell": self.cells.band_first_cell,
            "star_cell_start": self.cells.cell_start,
            "star_cell_star": self.cells.cell_star,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, npt.NDArray[Any]]) -> StarCatalogue:
        """The catalogue that `to_arrays` gave. KeyError: an array is missing; ValueError: lengths differ."""
        limits = np.asarray(arrays["star_limits"], np.float64)
        cells = SkyCells(
            float(limits[2]),
            np.ascontiguousarray(arrays["star_band_first_cell"], np.int32),
            np.ascontiguousarray(arrays["star_cell_start"], np.int32),
            np.ascontiguousarray(arrays["star_cell_star"], np.int32),
        )
        hip = np.ascontiguousarray(arrays["star_hip"], np.int32)
        unit_vectors = np.ascontiguousarray(arrays["star_unit_vectors"], np.float64)
        hp_mag = np.ascontiguousarray(arrays["star_hp_mag"], np.float32)
        if unit_vectors.shape != (len(hip), 3) or len(hp_mag) != len(hip) or len(cells.cell_star) != len(hip):
            raise ValueError("star catalogue arrays of different lengths")
        return cls(hip, unit_vectors, hp_mag, float(limits[0]), float(limits[1]), cells)


def build_star_catalogue(
    hip: npt.NDArray[Any],
    unit_vectors: npt.NDArray[Any],
    hp_mag: npt.NDArray[Any],
    limit_mag: float,
    resolution_rad: float,
) -> StarCatalogue:
    """Catalogue of the light sources brighter than limit_mag that the lens tells apart.

    hip[n], unit_vectors[n, 3] (ICRS), hp_mag[n]: a table of stars that reaches deeper than the limit, so
    that dim companions count. Magnitudes are compared as float32, strictly: "magnitude less than 6.9"
    (Sarvi et al. 2014).

    ASSUMED: from the brightest star down, each takes every dimmer star within resolution_rad that no
        brighter one has taken; they become one entry at the photocentre of their light, with their combined
        magnitude and the number of the brightest. The paper says only that one star stays as base star; the
        image holds the merged spot, so the catalogue must say where that spot lies and how bright it is.
        Two stars below the limit whose joint light is above it count. Raises ValueError when the lengths
        differ or resolution_rad is negative.
    """
    numbers = np.asarray(hip, np.int32)
    vectors = np.ascontiguousarray(unit_vectors, np.float64)
    magnitudes = np.asarray(hp_mag, np.float32)
    if vectors.shape != (len(numbers), 3) or len(magnitudes) != len(numbers):
        raise ValueError(
            f"{len(numbers)} hip, {vectors.shape} unit_vectors, {len(magnitudes)} hp_mag: no match"
        )
    if resolution_rad < 0.0:
        raise ValueError(f"resolution_rad {resolution_rad} is negative")
    cells = build_sky_cells(vectors)
    order = np.lexsort((numbers, magnitudes)).astype(np.int32)
    # Stars so dim that even all MOST_COMPANIONS together stay below the limit cannot be the brightest of an
    # entry.
    hopeless = limit_mag + 2.5 * math.log10(MOST_COMPANIONS)
    candidates = order[magnitudes[order] < hopeless]
    base, merged, flux = _merge_kernel(
        vectors,
        magnitudes.astype(np.float64),
        candidates,
        resolution_rad,
        cells.band_height_rad,
        cells.band_first_cell,
        cells.cell_start,
        cells.cell_star,
    )
    combined = (-2.5 * np.log10(flux)).astype(np.float32)
    # A star alone keeps its printed magnitude to the last bit: no star at the limit moves over it by
    # rounding.
    alone = np.abs(combined - magnitudes[base]) < 1e-5
    combined[alone] = magnitudes[base][alone]
    kept = np.flatnonzero(combined < np.float32(limit_mag))
    kept = kept[np.argsort(numbers[base[kept]], kind="stable")]
    directions = np.ascontiguousarray(merged[kept])
    return StarCatalogue(
        np.ascontiguousarray(numbers[base[kept]]),
        directions,
        np.ascontiguousarray(combined[kept]),
        float(limit_mag),
        float(resolution_rad),
        build_sky_cells(directions),
    )


@numba.njit(nogil=True)
def _merge_kernel(
    unit_vectors: FloatArray,
    magnitudes: FloatArray,
    brightest_first: IntArray,
    resolution_rad: float,
    band_height_rad: float,
    band_first_cell: IntArray,
    cell_start: IntArray,
    cell_star: IntArray,
) -> tuple[IntArray, FloatArray, FloatArray]:
    """(row of the brightest component, photocentre, flux where magnitude 0 is 1) of every entry."""
    taken = np.zeros(len(unit_vectors), np.bool_)
    base = np.empty(len(brightest_first), np.int32)
    merged = np.empty((len(brightest_first), 3), np.float64)
    flux = np.empty(len(brightest_first), np.float64)
    found = np.empty(MOST_COMPANIONS, np.int32)
    entries = 0
    for star in brightest_first:
        if taken[star]:
            continue
        taken[star] = True
        light = 10.0 ** (-0.4 * magnitudes[star])
        x = light * unit_vectors[star, 0]
        y = light * unit_vectors[star, 1]
        z = light * unit_vectors[star, 2]
        companions = 0
        if resolution_rad > 0.0:
            count, _ = stars_in_cone_kernel(
                unit_vectors,
                band_height_rad,
                band_first_cell,
                cell_start,
                cell_star,
                unit_vectors[star, 0],
                unit_vectors[star, 1],
                unit_vectors[star, 2],
                resolution_rad,
                found,
            )
            for place in range(min(count, len(found))):
                other = found[place]
                if taken[other]:
                    continue
                taken[other] = True
                companions += 1
                share = 10.0 ** (-0.4 * magnitudes[other])
                light += share
                x += share * unit_vectors[other, 0]
                y += share * unit_vectors[other, 1]
                z += share * unit_vectors[other, 2]
        base[entries] = star
        flux[entries] = light
        if companions == 0:
            merged[entries, 0] = unit_vectors[star, 0]
            merged[entries, 1] = unit_vectors[star, 1]
            merged[entries, 2] = unit_vectors[star, 2]
        else:
            norm = math.sqrt(x * x + y * y + z * z)
            merged[entries, 0] = x / norm
            merged[entries, 1] = y / norm
            merged[entries, 2] = z / norm
        entries += 1
    return base[:entries].copy(), merged[:entries].copy(), flux[:entries].copy()
