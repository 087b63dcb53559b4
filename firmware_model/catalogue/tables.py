"""The star tables in the unit's memory."""

from __future__ import annotations

from dataclasses import dataclass
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
