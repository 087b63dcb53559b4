"""How well the camera measures: the expected errors of centroids."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .image.interpolation import interpolation_errors

__all__ = ["CentroidError"]

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class CentroidError:
    """Expected error of a centroid, for the weights of the attitude and its covariance.

    Each axis: sigma^2 = floor_px^2 + psf_sigma_px^2 / (flux electrons) + (window_factor noise / flux)^2:
    what the pixels leave over, the photons of the star, and the noise of the background in the window of
    the centre of mass, where window_factor = sqrt(sum x^2) = (2 h + 1) sqrt(h (h + 1) / 3) of a square
    window of half-width h. interpolated: the centroids are those of Gaussian interpolation, whose two
    columns take more from the photons and less from the background (`interpolation_errors`).
    """

    floor_px: float = 0.01
    psf_sigma_px: float = 0.7
    electrons_per_dn: float = 1.0
    half_window_px: int = 2
    interpolated: bool = False

    @property
    def photon_px(self) -> float:
        """Error of a star of one electron by its photons alone."""
        return interpolation_errors(self.psf_sigma_px)[0] if self.interpolated else self.psf_sigma_px

    @property
    def window_factor(self) -> float:
        """sqrt of the sum of x^2 over the window."""
        if self.interpolated:
            return interpolation_errors(self.psf_sigma_px)[1]
        h = self.half_window_px
        return (2.0 * h + 1.0) * math.sqrt(h * (h + 1.0) / 3.0)

    def sigma_px(self, flux_dn: FloatArray, noise_dn: float) -> FloatArray:
        """Expected error in each axis, 1 sigma, of stars of these fluxes[n] before this noise of a pixel."""
        flux = np.maximum(flux_dn, 1.0)
        variance = (
            self.floor_px**2
            + self.photon_px**2 / (flux * self.electrons_per_dn)
            + np.square(self.window_factor * noise_dn / flux)
        )
        return np.asarray(np.sqrt(variance))

    def streak_sigma_px(
        self, flux_dn: FloatArray, noise_dn: float, length_px: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Expected errors along and across streaks of these lengths[n], which is ``sigma_px`` at length 0.

        Photons spread evenly over the length L, L^2 / 12 along it; the window grows by the length.
        """
        flux = np.maximum(flux_dn, 1.0)
        photons = 1.0 / (flux * self.electrons_per_dn)
        noise = np.square(noise_dn / flux)
        width = 2.0 * self.half_window_px + 1.0
        longer = width + length_px
        lever_along = width * longer * (np.square(longer) - 1.0) / 12.0
        lever_across = width * longer * (width * width - 1.0) / 12.0
        fixed = self.floor_px**2 + self.psf_sigma_px**2 * photons
        along = fixed + np.square(length_px) / 12.0 * photons + lever_along * noise
        return np.sqrt(along), np.sqrt(fixed + lever_across * noise)
