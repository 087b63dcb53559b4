"""Simulated star images for the tests of the image stages: written with scipy, not with our renderer."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import erf

RenderStars = Callable[..., NDArray[np.float64]]


def _share(pixels: NDArray[np.int64], centre: float, sigma_px: float) -> NDArray[np.float64]:
    """Share of a normal distribution on each pixel (paper Z eqs. (4)-(5))."""
    scale = 1.0 / (sigma_px * np.sqrt(2.0))
    return 0.5 * (erf((pixels + 0.5 - centre) * scale) - erf((pixels - 0.5 - centre) * scale))


def render(
    shape: tuple[int, int],
    stars: Iterable[tuple[float, float, float]],
    *,
    sigma_px: float = 0.75,
    streak_px: tuple[float, float] = (0.0, 0.0),
) -> NDArray[np.float64]:
    """Noise-free image of stars (x, y, flux), each drawn out along ``streak_px`` about its place."""
    image = np.zeros(shape)
    steps = max(1, int(np.ceil(4 * np.hypot(*streak_px))))
    for x, y, flux in stars:
        for step in range(steps):
            t = (step + 0.5) / steps - 0.5
            xs, ys = x + t * streak_px[0], y + t * streak_px[1]
            x0, x1 = max(int(xs) - 9, 0), min(int(xs) + 11, shape[1])
            y0, y1 = max(int(ys) - 9, 0), min(int(ys) + 11, shape[0])
            if x0 >= x1 or y0 >= y1:
                continue
            across = _share(np.arange(x0, x1), xs, sigma_px)
            down = _share(np.arange(y0, y1), ys, sigma_px)
            image[y0:y1, x0:x1] += flux / steps * down[:, None] * across[None, :]
    return image


@pytest.fixture(scope="session")
def render_stars() -> RenderStars:
    """``render_stars(shape, [(x, y, flux), ...], sigma_px=, streak_px=) -> float64[rows, columns]``."""
    return render


@pytest.fixture(scope="session")
def expose() -> Callable[..., NDArray[np.uint16]]:
    """``expose(signal_electrons, rng, ...)``: shot noise, background noise, conversion to DN."""

    def convert(
        signal_electrons: NDArray[np.float64],
        rng: np.random.Generator,
        *,
        background_electrons: float = 800.0,
        noise_electrons: float = 19.0,
        electrons_per_dn: float = 8.0,
        maximum_dn: int = 4095,
    ) -> NDArray[np.uint16]:
        electrons = rng.poisson(signal_electrons) + background_electrons
        electrons = electrons + rng.normal(0.0, noise_electrons, signal_electrons.shape)
        return np.clip(np.rint(electrons / electrons_per_dn), 0, maximum_dn).astype(np.uint16)

    return convert
