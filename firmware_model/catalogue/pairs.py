"""The pair catalogue: every pair of stars that fits into the field, sorted by cosine.

Zhang et al. 2014, (10): P = cos(angle) ascending with I the brighter and J the dimmer star of each pair.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from .kvector import FloatArray, IntArray, KVector, build_kvector, range_kernel
from .sky_cells import stars_in_cone_kernel
from .star_catalogue import StarCatalogue


@dataclass(frozen=True)
class PairCatalogue:
    """Unordered pairs of catalogue stars, each once, in ascending order of the cosine.

    cos_angle: float64[m]; brighter, dimmer: int32[m], rows of the star catalogue.
    max_angle_rad: every pair at most this far apart is in the list.
    kvector: range search over cos_angle.
    """

    cos_angle: FloatArray
    brighter: IntArray
    dimmer: IntArray
    max_angle_rad: float
    kvector: KVector

    def __len__(self) -> int:
        return len(self.cos_angle)

    def query(self, angle_rad: float, tolerance_rad: float) -> tuple[int, int]:
        """[first, end) of the pairs whose angle is within tolerance_rad of angle_rad."""
        lowest, highest = cosine_range(angle_rad, tolerance_rad)
        first, end, _ = range_kernel(
            self.cos_angle, self.kvector.slope, self.kvector.offset, self.kvector.count_below, lowest, highest
        )
        return int(first), int(end)

    def query_pairs(self, angle_rad: float, tolerance_rad: float) -> tuple[IntArray, IntArray]:
        """(brighter, dimmer) rows of the pairs whose angle is within tolerance_rad of angle_rad."""
        first, end = self.query(angle_rad, tolerance_rad)
        return self.brighter[first:end], self.dimmer[first:end]

    def restricted(self, kept: npt.NDArray[np.bool_]) -> PairCatalogue:
        """The pairs where kept[m] is set, in the same order, with a k-vector of their own."""
        cos_angle = np.ascontiguousarray(self.cos_angle[kept])
        return PairCatalogue(
            cos_angle,
            np.ascontiguousarray(self.brighter[kept]),
            np.ascontiguousarray(self.dimmer[kept]),
            self.max_angle_rad,
            build_kvector(cos_angle),
        )

    def to_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """The pair catalogue as plain arrays, for a cache or an image of the unit's memory."""
        return {
            "pair_cos_angle": self.cos_angle,
            "pair_brighter": self.brighter,
            "pair_dimmer": self.dimmer,
            "pair_limits": np.array([self.max_angle_rad, self.kvector.slope, self.kvector.offset]),
            "pair_count_below": self.kvector.count_below,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, npt.NDArray[Any]]) -> PairCatalogue:
        """The pairs that `to_arrays` gave. KeyError: an array is missing; ValueError: lengths differ."""
        limits = np.asarray(arrays["pair_limits"], np.float64)
        count_below = np.ascontiguousarray(arrays["pair_count_below"], np.int32)
        cos_angle = np.ascontiguousarray(arrays["pair_cos_angle"], np.float64)
        brighter = np.ascontiguousarray(arrays["pair_brighter"], np.int32)
        dimmer = np.ascontiguousarray(arrays["pair_dimmer"], np.int32)
        if not len(cos_angle) == len(brighter) == len(dimmer) == len(count_below) - 1:
            raise ValueError("pair catalogue arrays of different lengths")
        kvector = KVector(float(limits[1]), float(limits[2]), count_below)
        return cls(cos_angle, brighter, dimmer, float(limits[0]), kvector)


def cosine_range(angle_rad: float, tolerance_rad: float) -> tuple[float, float]:
    """(lowest, highest) cosine of the angles within tolerance_rad of angle_rad, clamped to [0, pi]."""
    return (
        math.cos(min(math.pi, angle_rad + tolerance_rad)),
        math.cos(max(0.0, angle_rad - tolerance_rad)),
    )


def build_pair_catalogue(catalogue: StarCatalogue, max_angle_rad: float) -> PairCatalogue:
    """All pairs of the catalogue at most max_angle_rad apart. ValueError unless 0 < it < pi / 2."""
    if not 0.0 < max_angle_rad < 0.5 * math.pi:
        raise ValueError(f"max_angle_rad {max_angle_rad} is not between 0 and pi / 2")
    cells = catalogue.cells
    cos_angle, one, other = _pairs_kernel(
        catalogue.unit_vectors,
        max_angle_rad,
        cells.band_height_rad,
        cells.band_first_cell,
        cells.cell_start,
        cells.cell_star,
    )
    order = np.argsort(cos_angle, kind="stable")
    cos_angle = np.ascontiguousarray(cos_angle[order])
    one = one[order]
    other = other[order]
    # On equal magnitudes the lower number counts as the brighter one, so that the catalogue is one and the
    # same always.
    swap = catalogue.hp_mag[other] < catalogue.hp_mag[one]
    return PairCatalogue(
        cos_angle,
        np.where(swap, other, one).astype(np.int32),
        np.where(swap, one, other).astype(np.int32),
        float(max_angle_rad),
        build_kvector(cos_angle),
    )


@numba.njit(nogil=True)
def _pairs_kernel(
    unit_vectors: FloatArray,
    max_angle_rad: float,
    band_height_rad: float,
    band_first_cell: IntArray,
    cell_start: IntArray,
    cell_star: IntArray,
) -> tuple[FloatArray, IntArray, IntArray]:
    """Cosine and both rows (lower row first) of every pair, in the order of the rows."""
    count = len(unit_vectors)
    room = 1024
    cos_angle = np.empty(room, np.float64)
    one = np.empty(room, np.int32)
    other = np.empty(room, np.int32)
    found = np.empty(max(count, 1), np.int32)
    pairs = 0
    for star in range(count):
        x = unit_vectors[star, 0]
        y = unit_vectors[star, 1]
        z = unit_vectors[star, 2]
        near, _ = stars_in_cone_kernel(
            unit_vectors,
            band_height_rad,
            band_first_cell,
            cell_start,
            cell_star,
            x,
            y,
            z,
            max_angle_rad,
            found,
        )
        if pairs + near > room:
            room = 2 * (pairs + near)
            wider_cos = np.empty(room, np.float64)
            wider_one = np.empty(room, np.int32)
            wider_other = np.empty(room, np.int32)
            wider_cos[:pairs] = cos_angle[:pairs]
            wider_one[:pairs] = one[:pairs]
            wider_other[:pairs] = other[:pairs]
            cos_angle, one, other = wider_cos, wider_one, wider_other
        for place in range(near):
            neighbour = found[place]
            if neighbour <= star:
                continue
            cos_angle[pairs] = (
                x * unit_vectors[neighbour, 0]
                + y * unit_vectors[neighbour, 1]
                + z * unit_vectors[neighbour, 2]
            )
            one[pairs] = star
            other[pairs] = neighbour
            pairs += 1
    return cos_angle[:pairs].copy(), one[:pairs].copy(), other[:pairs].copy()
