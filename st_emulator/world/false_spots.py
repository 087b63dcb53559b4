"""Light that is no star: particles, space debris, sparkling windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import noise

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FalseSpots:
    """Spots with the shape of a star that stand still in the image.

    per_frame spots a frame at random places, uniform over the image, with magnitudes uniform in
    [brightest_mag, faintest_mag]: new ones each frame, a function of (seed, frame). persistent: (x_px, y_px,
    mag) of spots that are in every frame.
    """

    per_frame: int = 0
    brightest_mag: float = 3.0
    faintest_mag: float = 6.0
    persistent: Sequence[tuple[float, float, float]] = ()

    def __post_init__(self) -> None:
        if not 0 <= self.per_frame <= 10_000:
            raise ValueError(f"per_frame is {self.per_frame}; allowed is 0 to 10000")
        if not self.brightest_mag <= self.faintest_mag:
            raise ValueError(
                f"brightest_mag {self.brightest_mag} is fainter than faintest_mag {self.faintest_mag}"
            )

    def in_frame(self, seed: int, frame_index: int, width_px: int, height_px: int) -> Array:
        """float64[n, 3]: x_px, y_px, magnitude; the persistent ones first."""
        fixed = np.array(self.persistent, dtype=np.float64).reshape(-1, 3)
        key = noise.stream_key(seed, noise.STREAM_FALSE_SPOTS, frame_index)
        u = noise.uniforms(key, 3 * self.per_frame).reshape(-1, 3)
        span = np.array([width_px, height_px, self.faintest_mag - self.brightest_mag])
        return np.concatenate((fixed, u * span + np.array([-0.5, -0.5, self.brightest_mag])))
