"""The star tables in the unit's memory."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from .kvector import FloatArray, IntArray
from .pairs import PairCatalogue
from .star_catalogue import StarCatalogue

# What compiled kernels take of a star catalogue (unit vectors, magnitudes, sky grid) and of a pair catalogue
# (cosines, brighter and dimmer stars, k-vector).
StarArrays = tuple[FloatArray, npt.NDArray[np.float32], float, IntArray, IntArray, IntArray]
PairArrays = tuple[FloatArray, IntArray, IntArray, float, float, IntArray]


@dataclass(frozen=True)
class StarTables:
    """The catalogue in the unit's memory: one for both modes, with its pairs for lost in space."""

    catalogue: StarCatalogue
    pairs: PairCatalogue

    def arrays(self) -> tuple[npt.NDArray[Any], ...]:
        """All arrays in a fixed order: what a check of the memory is taken over."""
        named = self.catalogue.to_arrays() | self.pairs.to_arrays()
        return tuple(named[name] for name in sorted(named))

    @cached_property
    def _reference_pairs(self) -> dict[float, PairCatalogue]:
        return {}

    def reference_pairs(self, limit_mag: float) -> PairCatalogue:
        """The pairs whose brighter star is under limit_mag, with a k-vector of their own; made once.

        Zhang et al. 2014, reference-star mode, restricts the ranges that it read to these; kept apart, the
        others need not be read at all.
        """
        made = self._reference_pairs.get(limit_mag)
        if made is None:
            made = self.pairs.restricted(self.catalogue.hp_mag[self.pairs.brighter] < limit_mag)
            self._reference_pairs[limit_mag] = made
        return made


def star_arrays(catalogue: StarCatalogue) -> StarArrays:
    """A star catalogue for kernels: unit vectors, magnitudes, height of a band, the grid's three tables."""
    cells = catalogue.cells
    return (
        catalogue.unit_vectors,
        catalogue.hp_mag,
        cells.band_height_rad,
        cells.band_first_cell,
        cells.cell_start,
        cells.cell_star,
    )


def pair_arrays(pairs: PairCatalogue) -> PairArrays:
    """A pair catalogue for kernels: cosines, brighter and dimmer stars, slope, offset, k-vector."""
    kvector = pairs.kvector
    return (
        pairs.cos_angle,
        pairs.brighter,
        pairs.dimmer,
        kvector.slope,
        kvector.offset,
        kvector.count_below,
    )
