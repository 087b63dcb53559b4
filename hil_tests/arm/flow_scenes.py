"""Images and fields of stars for the tests of the optical flow's kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Image = NDArray[np.uint16]


def star_field(seed: int, stars: int, rows: int, columns: int) -> FloatArray:
    """(x, y, flux) of stars, some of them outside."""
    rng = np.random.default_rng([seed, 1])
    return np.column_stack(
        [
            rng.uniform(-5, columns + 5, stars),
            rng.uniform(-5, rows + 5, stars),
            10 ** rng.uniform(2.0, 3.6, stars),
        ]
    )


def picture(
    table: FloatArray,
    rows: int,
    columns: int,
    seed: int,
    shift: tuple[float, float] = (0.0, 0.0),
    streak: tuple[float, float] = (0.0, 0.0),
    bits: int = 10,
    noise_dn: float = 1.5,
) -> Image:
    """Gaussian stars, all shifted and smeared alike, with a level and noise."""
    row, column = np.mgrid[0:rows, 0:columns]
    scale = 2.0 ** (bits - 10)
    image = np.full((rows, columns), 32.0)
    steps = 1 + 2 * int(np.hypot(*streak))
    for x, y, flux in table:
        for part in np.linspace(-0.5, 0.5, steps) if steps > 1 else (0.0,):
            square = (column - x - shift[0] - part * streak[0]) ** 2
            square = square + (row - y - shift[1] - part * streak[1]) ** 2
            image += flux / steps * np.exp(-square / (2 * 0.8**2)) / (2 * np.pi * 0.8**2)
    image += np.random.default_rng([seed, 2]).normal(0.0, noise_dn, image.shape)
    return np.clip(np.rint(image * scale), 0, 2**bits - 1).astype(np.uint16)


def turning_stars(
    seed: int,
    count: int,
    rate_rad_s: FloatArray,
    interval_s: float,
    error_rad: float,
    wrong: int = 0,
    along_factor: float = 1.0,
) -> dict[str, Any]:
    """What ``rate_from_directions`` takes; the first ``wrong`` of the stars are far off after the turn."""
    rng = np.random.default_rng([seed, 3])
    before = np.column_stack([rng.uniform(-0.18, 0.18, (count, 2)), np.ones(count)])
    before /= np.sqrt((before**2).sum(axis=1, keepdims=True))
    size = float(np.linalg.norm(rate_rad_s))
    after = before.copy()
    if size:  # Rodrigues: the stars turn against the sensor
        axis, angle = rate_rad_s / size, -size * interval_s
        after = (
            before * np.cos(angle)
            + np.cross(axis, before) * np.sin(angle)
            + np.outer(before @ axis, axis) * (1.0 - np.cos(angle))
        )
    after[:, :2] += error_rad * rng.normal(size=(count, 2))
    after[:wrong, :2] += 200.0 * error_rad * rng.choice([-1.0, 1.0], (wrong, 2))
    after /= np.sqrt((after**2).sum(axis=1, keepdims=True))
    return {
        "before": before,
        "after": after,
        "interval_s": interval_s,
        "along_rad": along_factor * error_rad * rng.uniform(0.7, 1.3, count),
        "across_rad": error_rad * rng.uniform(0.7, 1.3, count),
        "foreseen_rad_s": None,
    }
