"""The star tables in the unit's memory."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy.typing as npt

from .pairs import PairCatalogue
from .star_catalogue import StarCatalogue


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
