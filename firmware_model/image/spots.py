"""Spots: what the image stages hand on to identification and tracking."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

__all__ = ["Rejections", "Spots", "WindowSpots", "WindowStatus"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Rejections:
    """How many clusters were not made spots, by the first reason that applied."""

    small: int = 0  # fewer pixels than min_pixels: isolated pixels, hot pixels
    large: int = 0  # more pixels than max_pixels: Moon, Earth, stray light
    sharp: int = 0  # nearly all of the flux in one pixel: a hot pixel or a particle, no image of a star
    edge: int = 0  # too near to the edge of the image (or window) for an unbiased centroid
    faint: int = 0  # dimmer than the magnitude limit
    surplus: int = 0  # more than the number of spots asked for; the dimmest go

    @property
    def total(self) -> int:
        return self.small + self.large + self.sharp + self.edge + self.faint + self.surplus


@dataclass(frozen=True, slots=True)
class Spots:
    """Spots of one image, brightest (``flux_dn``) first. All arrays have length n."""

    x_px: FloatArray  # centroid, column
    y_px: FloatArray  # centroid, row
    flux_dn: FloatArray  # background-subtracted sum in the centroid window
    magnitude: FloatArray  # instrumental: -2.5 log10(flux / (zero point * exposure))
    peak_dn: FloatArray  # largest pixel less background
    pixels: NDArray[np.int32]  # pixels of the cluster over threshold
    saturated: NDArray[np.bool_]  # a pixel at the converter's limit
    at_edge: NDArray[np.bool_]  # centroid window narrowed by the edge of the image (centroid still unbiased)
    background_dn: float = 0.0  # of the whole image (median of the samples; windows: median of the windows)
    noise_dn: float = 0.0  # 1 sigma of a background pixel
    rejected: Rejections = field(default_factory=Rejections)
    overflowed: bool = False  # more runs than the run table holds: the scan stopped, the spots are of a part

    def __len__(self) -> int:
        return len(self.x_px)

    def take(self, index: NDArray[np.intp] | NDArray[np.int32] | NDArray[np.bool_] | slice) -> Spots:
        """The spots selected by an index array, a mask or a slice (order as given)."""
        return Spots(
            self.x_px[index],
            self.y_px[index],
            self.flux_dn[index],
            self.magnitude[index],
            self.peak_dn[index],
            self.pixels[index],
            self.saturated[index],
            self.at_edge[index],
            self.background_dn,
            self.noise_dn,
            self.rejected,
            self.overflowed,
        )

    def brightest(self, count: int) -> Spots:
        """The ``count`` brightest spots."""
        return self.take(slice(0, count))

    @staticmethod
    def empty(background_dn: float = 0.0, noise_dn: float = 0.0) -> Spots:
        """No spots."""
        return Spots.at(np.zeros(0), np.zeros(0), np.zeros(0), background_dn=background_dn, noise_dn=noise_dn)

    @staticmethod
    def at(
        x_px: FloatArray,
        y_px: FloatArray,
        magnitude: FloatArray,
        *,
        zero_point_dn: float = 1.0e6,
        background_dn: float = 0.0,
        noise_dn: float = 0.0,
    ) -> Spots:
        """Ideal spots at given places with given magnitudes, sorted: for trials that begin after the image.

        ``zero_point_dn``: DN of a magnitude 0 star in the exposure.
        """
        x, y, mag = (np.asarray(a, np.float64).reshape(-1) for a in (x_px, y_px, magnitude))
        order = np.argsort(mag, kind="stable")
        x, y, mag = x[order], y[order], mag[order]
        flux = zero_point_dn * 10.0 ** (-0.4 * mag)
        return Spots(
            x,
            y,
            flux,
            mag,
            0.25 * flux,
            np.full(len(x), 9, np.int32),
            np.zeros(len(x), np.bool_),
            np.zeros(len(x), np.bool_),
            background_dn,
            noise_dn,
        )


class WindowStatus(IntEnum):
    """What came of one detection window."""

    EMPTY = 0  # no cluster that could be a star
    FOUND = 1  # at least one spot
    CLIPPED = 2  # the best candidate was cut by the window's edge and nothing else was found
    FAINT = 3  # only clusters dimmer than the magnitude limit
    REJECTED = 4  # only clusters too small, too large or too sharp


@dataclass(frozen=True, slots=True)
class WindowSpots:
    """Spots found in detection windows: by window, and within a window brightest (or best) first."""

    spots: Spots
    window: NDArray[np.int32]  # [spots] index of the window of each spot, ascending
    status: NDArray[np.uint8]  # [windows] WindowStatus
    background_dn: FloatArray  # [windows]
    noise_dn: FloatArray  # [windows]

    def __len__(self) -> int:
        return len(self.window)
