"""Detection in windows: tracking looks only where stars are expected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..work import Work
from .detection import DetectionParameters
from .spots import WindowSpots

__all__ = ["detect_in_windows"]


def detect_in_windows(
    flat: NDArray[np.uint16],
    offsets: NDArray[np.int64],
    rects: NDArray[np.int32],
    parameters: DetectionParameters,
    *,
    width_px: int,
    height_px: int,
    keep: NDArray[np.int32] | int = 1,
    expected_flux_dn: NDArray[np.float64] | None = None,
) -> tuple[WindowSpots, Work]:
    """Find the star(s) of each window (paper R, tracking step 4).

    ``flat, offsets, rects`` as of ``Frame.windows``. ``keep`` (int or int32[n]): how many spots a window may
    give (a merged window holds more than one predicted star); the brightest are kept. ``expected_flux_dn``
    (float64[n], nan = unknown): where given and ``keep`` is 1, the spot nearest to it in magnitude is taken instead of
    the brightest. ``width_px, height_px``: of the image (a side of a window on the image's edge).
    """
    raise NotImplementedError
