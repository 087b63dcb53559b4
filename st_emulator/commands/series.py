"""A run over time, as its picture shows it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..protocol.pus.enumerations import Mode


@dataclass
class Series:
    """One entry an attitude report; ``modes``: (seconds, mode) from each change on."""

    t_s: NDArray[np.float64]
    mode: NDArray[np.int64]
    valid: NDArray[np.bool_]
    at_rest: NDArray[np.bool_]
    error_arcsec: NDArray[np.float64]
    frame_index: NDArray[np.int64]
    modes: list[tuple[float, Mode]]
