"""Full-frame detection: adaptive threshold, clustering, centroids, magnitude limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..work import Work
from .spots import Spots

__all__ = ["DetectionParameters", "detect"]


@dataclass(frozen=True, slots=True)
class DetectionParameters:
    """What the image stages need to know; the same for full frames and windows."""

    sigma_factor: float = 5.0  # threshold over the local background, in units of the frame's noise
    tau_min_dn: float = 1.0  # and never less than this (paper M: tau_pre), DN
    min_pixels: int = 2  # clusters below this are dropped (paper M: isolated pixels)
    max_pixels: int = 2000  # clusters above this are no stars
    centroid_half_window_px: int = 2  # the centre of mass is taken over +-(this + 0.5) px at least
    magnitude_limit: float = 99.0  # spots dimmer than this are dropped (paper R: < 6.9)
    zero_point_dn_per_s: float = 1.0e6  # DN/s of a magnitude 0 star
    exposure_s: float = 0.1
    saturation_dn: int = 65535  # a pixel at or above is saturated
    max_peak_fraction: float = 0.85  # a spot with more of its flux in one pixel is a hot pixel
    average_pixels: int = 256  # length of the moving average along the scan
    max_runs: int = 16384  # size of the run table
    max_spots: int = 1000  # spots handed on; the dimmest are dropped
    window_sigma_factor: float = 4.0  # threshold in detection windows, where a star is expected


def detect(image: NDArray[np.uint16], parameters: DetectionParameters) -> tuple[Spots, Work]:
    """Find the spots of a whole image. ``image``: ``uint16[rows, columns]`` DN."""
    raise NotImplementedError
