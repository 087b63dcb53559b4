"""Centroid by Gaussian interpolation, paper Z eqs. (4)-(6): the ratio of two neighbouring columns or rows.

The light of a Gaussian spot on a pixel column is I = A g(x, s, a, b), x the star's place, s the standard
deviation, a and b the column's sides. Of two columns the ratio does not depend on A; with both g developed
to second order it is a quadratic equation for x. The coefficients depend on s alone: a unit holds them as
six numbers, and one axis of one star costs a square root and a division.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["InterpolationTerms", "gaussian_share", "interpolation_errors", "interpolation_terms"]

# ASSUMED: g is developed about the place a quarter of a pixel from the middle of the largest column towards
# the larger of its neighbours. The paper does not say where; the star lies at most half a pixel to that
# side, and from the middle of this range the largest error is 0.009 px for s = 0.75 px, from its end 0.037.
DEVELOPED_AT_PX = -0.25
# ASSUMED: noise may carry the star a quarter of a pixel beyond the range that follows from which columns are
# the largest; further out it is not noise.
FURTHEST_PX = 0.5
# ASSUMED: two answers to one question: they may differ by a tenth of a pixel and 3 sigma of the centre of
# mass before the background's noise, at most by half a pixel. Further apart the spot is not the Gaussian that
# (6) takes it for: most often two stars, whose photocentre is what the catalogue holds.
NEAR_COM_PX = 0.1
NEAR_COM_SIGMA = 3.0
MOST_FROM_COM_PX = 0.5
# For a Gaussian I2^2 = I1 I3 exp(1 / v), v = s^2 + 1/12, wherever it lies. ASSUMED: a spot whose v is over
# 4/3 of that (drawn out by motion over 1.6 px for s = 0.75 px, or two stars) is none.
LEAST_CURVATURE = 0.75

# ASSUMED: columns are summed over three rows; the paper's text goes on to speak of two pixels. Three rows
# hold 95 % of the light for s = 0.75 px, the largest pixel's alone half of it or less: campaign zy3-centroids
# measures both.
HALF_HEIGHT_PX = 1

PHASES = 51  # places of the star within half a pixel, for the mean error


class InterpolationTerms(NamedTuple):
    """(6) of one point spread: g of both columns to second order about ``DEVELOPED_AT_PX``.

    The origin is the middle of the largest column, I2, from -0.5 to 0.5; I1 lies from -1.5 to -0.5.
    """

    wanted: bool
    half_height_px: int  # rows on each side of the largest pixel's that columns are summed over
    first_0: float
    first_1: float
    first_2: float
    second_0: float
    second_1: float
    second_2: float
    least_square_ratio: float  # I2^2 / (I1 I3) of the widest spot that is interpolated


def gaussian_share(x_px: float, sigma_px: float, from_px: float, to_px: float) -> float:
    """g of (5): sqrt(pi) times the share of the light of a star at x_px between two boundaries."""
    scale = 1.0 / (math.sqrt(2.0) * sigma_px)
    return 0.5 * math.sqrt(math.pi) * (math.erf((to_px - x_px) * scale) - math.erf((from_px - x_px) * scale))


def _to_second_order(
    x_px: float, sigma_px: float, from_px: float, to_px: float
) -> tuple[float, float, float]:
    """g, its slope and half its second derivative by x at x_px."""
    scale = 1.0 / (math.sqrt(2.0) * sigma_px)
    near = math.exp(-(((from_px - x_px) * scale) ** 2))
    far = math.exp(-(((to_px - x_px) * scale) ** 2))
    return (
        gaussian_share(x_px, sigma_px, from_px, to_px),
        scale * (near - far),
        0.5 * scale * ((from_px - x_px) * near - (to_px - x_px) * far) / sigma_px**2,
    )


@lru_cache(maxsize=16)
def interpolation_terms(
    sigma_px: float, wanted: bool = True, half_height_px: int = HALF_HEIGHT_PX
) -> InterpolationTerms:
    """What (6) needs for a point spread of sigma_px. ValueError unless it is a finite number over 0.1.

    ``wanted`` False: the centre of mass stays. ``half_height_px`` 0: one pixel of each column, 1: three.
    """
    if not 0.1 < sigma_px < math.inf:
        raise ValueError(f"psf_sigma_px must be over 0.1, not {sigma_px}")
    if half_height_px not in (0, 1):
        raise ValueError(f"interpolation_half_height_px must be 0 or 1, not {half_height_px}")
    return InterpolationTerms(
        wanted,
        int(half_height_px),
        *_to_second_order(DEVELOPED_AT_PX, sigma_px, -1.5, -0.5),
        *_to_second_order(DEVELOPED_AT_PX, sigma_px, -0.5, 0.5),
        math.exp(LEAST_CURVATURE / (sigma_px**2 + 1.0 / 12.0)),
    )


@lru_cache(maxsize=16)
def interpolation_errors(sigma_px: float, half_height_px: int = HALF_HEIGHT_PX) -> tuple[float, float]:
    """(photon_factor, noise_factor) of the expected error of one axis, root mean square over all places.

    Error by the star's photons: photon_factor / sqrt(electrons); by the background's noise: noise_factor
    noise / flux. From (6): dx = (dI1 / I1 - dI2 / I2) / (d ln(g1 / g2) / dx), of a spot as far off the
    middle of its row.
    """
    photons = noise = 0.0
    for phase in range(PHASES):
        x = -0.5 * phase / (PHASES - 1)
        rows = gaussian_share(x, sigma_px, -half_height_px - 0.5, half_height_px + 0.5) / math.sqrt(math.pi)
        first = _to_second_order(x, sigma_px, -1.5, -0.5)
        second = _to_second_order(x, sigma_px, -0.5, 0.5)
        slope = first[1] / first[0] - second[1] / second[0]
        share_1 = rows * first[0] / math.sqrt(math.pi)
        share_2 = rows * second[0] / math.sqrt(math.pi)
        photons += (1.0 / share_1 + 1.0 / share_2) / slope**2
        noise += (2 * half_height_px + 1) * (1.0 / share_1**2 + 1.0 / share_2**2) / slope**2
    return (
        math.sqrt(photons / PHASES),
        math.sqrt(noise / PHASES),
    )


@numba.njit(nogil=True)
def offset_from_ratio(first: float, second: float, terms: InterpolationTerms) -> float:
    """The star's place from the middle of column I2 = ``second``, px, positive away from I1 = ``first``.

    (6) without A: I1 g2(x) - I2 g1(x) = 0, both g to second order: a quadratic equation a u^2 + b u + c = 0
    for u = x - ``DEVELOPED_AT_PX``. With I2 the largest a < 0 < b, and the lower root is
    -2 c / (b + sqrt(b^2 - 4 a c)), which keeps its digits where a is near zero. 1e9 where there is no root.
    """
    a = first * terms.second_2 - second * terms.first_2
    b = first * terms.second_1 - second * terms.first_1
    c = first * terms.second_0 - second * terms.first_0
    square = b * b - 4.0 * a * c
    if not square >= 0.0:
        return 1e9
    divisor = b + math.sqrt(square)
    if not divisor > 0.0:
        return 1e9
    return DEVELOPED_AT_PX - 2.0 * c / divisor


@numba.njit(nogil=True)
def has_place(before: float, middle: float, after: float, terms: InterpolationTerms) -> bool:
    """Whether three columns can be those of a spot of the unit's width: then (6) is worth solving."""
    larger = max(before, after)
    smaller = min(before, after)
    if not (larger > 0.0 and middle > 0.0):
        return False
    return middle * middle >= terms.least_square_ratio * larger * max(smaller, 0.0)


@numba.njit(nogil=True)
def place_on_axis(before: float, middle: float, after: float, terms: InterpolationTerms) -> float:
    """The star's place from the middle of three columns, px: (6) with the larger neighbour; 1e9: none.

    ``middle`` should be the largest; noise may make a neighbour a little larger.
    """
    if not has_place(before, middle, after, terms):
        return 1e9
    x = offset_from_ratio(max(before, after), middle, terms)
    if not abs(x - DEVELOPED_AT_PX) <= FURTHEST_PX:
        return 1e9
    return x if before >= after else -x


@numba.njit(nogil=True)
def interpolate(
    image: NDArray[np.uint16],
    mask: NDArray[np.uint8],
    left: int,
    top: int,
    other: np.uint8,
    background: float,
    com_x: float,
    com_y: float,
    com_sigma_px: float,
    terms: InterpolationTerms,
) -> tuple[int, bool, float, float]:
    """(axes solved, True, x, y) of a spot by (6) on both axes, or (axes solved, False, 0, 0): then its centre
    of mass stays.

    The largest pixel is looked for in 3 x 3 px about the centre of mass; columns are summed over its row and
    ``terms.half_height_px`` on each side, rows alike.
    ``mask[row - top, column - left]``: pixels marked ``other`` belong to another cluster. ``com_sigma_px``:
    error of the centre of mass by the background's noise, 1 sigma.
    """
    rows, columns = image.shape
    middle_x, middle_y = math.floor(com_x + 0.5), math.floor(com_y + 0.5)
    if middle_x < 1 or middle_y < 1 or middle_x > columns - 2 or middle_y > rows - 2:
        return 0, False, 0.0, 0.0
    peak_x, peak_y = middle_x, middle_y
    for row in range(middle_y - 1, middle_y + 2):
        for column in range(middle_x - 1, middle_x + 2):
            if image[row, column] > image[peak_y, peak_x]:
                peak_x, peak_y = column, row
    if peak_x < 1 or peak_y < 1 or peak_x > columns - 2 or peak_y > rows - 2:
        return 0, False, 0.0, 0.0
    across = (0.0, 0.0, 0.0)
    down = (0.0, 0.0, 0.0)
    for step in range(-1, 2):
        row, column = peak_y + step, peak_x + step
        for at in range(peak_x - 1, peak_x + 2):
            if mask[row - top, at - left] == other:
                return 0, False, 0.0, 0.0
        if abs(step) <= terms.half_height_px:
            across = (
                across[0] + float(image[row, peak_x - 1]) - background,
                across[1] + float(image[row, peak_x]) - background,
                across[2] + float(image[row, peak_x + 1]) - background,
            )
            down = (
                down[0] + float(image[peak_y - 1, column]) - background,
                down[1] + float(image[peak_y, column]) - background,
                down[2] + float(image[peak_y + 1, column]) - background,
            )
    solved = int(has_place(across[0], across[1], across[2], terms)) + int(
        has_place(down[0], down[1], down[2], terms)
    )
    x = peak_x + place_on_axis(across[0], across[1], across[2], terms)
    y = peak_y + place_on_axis(down[0], down[1], down[2], terms)
    most = min(NEAR_COM_PX + NEAR_COM_SIGMA * com_sigma_px, MOST_FROM_COM_PX)
    if abs(x - com_x) <= most and abs(y - com_y) <= most:
        return solved, True, x, y
    return solved, False, 0.0, 0.0
