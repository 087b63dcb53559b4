"""Angular rate from stars that nobody has identified: their directions in two frames.

A star stands still, so in the sensor's axes its direction u turns by du/dt = -omega x u. Over a finite turn
about a fixed axis, u' - u = -p x (u' + u) exactly, with p = tan(half the angle) along the axis (Cayley): a
linear equation whatever the angle. Least squares over all stars gives p.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from .work import Work

__all__ = ["StarRate", "rate_of_pairs", "turned_later"]

FloatArray = npt.NDArray[np.float64]

# ASSUMED: as for attitudes, geometry is degenerate where one axis is known 10^8 times worse in variance.
DEGENERATE_INFORMATION_RATIO = 1e-8


@dataclass(frozen=True)
class StarRate:
    """A rate with its quality.

    rate_rad_s: float64[3], of the sensor relative to ICRS, in sensor axes, mean over the interval.
    covariance_rad2_s2: float64[3, 3]. kept: bool[n], the pairs that it is made of.
    residuals_rad: float64[n], how far each pair is from the turn that the rate gives, the dropped ones too.
    chi_square: of those kept; degrees_of_freedom: 2 kept - 3.
    """

    rate_rad_s: FloatArray
    covariance_rad2_s2: FloatArray
    kept: npt.NDArray[np.bool_]
    residuals_rad: FloatArray
    chi_square: float
    degrees_of_freedom: int


def rate_of_pairs(
    before: FloatArray,
    now: FloatArray,
    interval_s: FloatArray,
    along_rad: FloatArray,
    across_rad: FloatArray,
    tolerance_rad: float,
    min_stars: int,
) -> tuple[StarRate | None, Work]:
    """Rate of the sensor from pairs of directions (sensor axes, unit vectors).

    before, now: float64[n, 3]. interval_s: float64[n], time between the two of each pair: with a rolling
        shutter each star has its own. along_rad, across_rad: float64[n], expected errors of now - before
        along the star's motion and across it, 1 sigma: a streak's end is less sharp than its side.
    The pair that fits worst (most sigmas off) is dropped while it is over ``tolerance_rad`` and over 3 sigma
    on either axis. ASSUMED: at most a third; more, and the rest is not to be trusted either.
    Where chi^2 is over its degrees of freedom the covariance is scaled by it.
    None: fewer than ``min_stars`` (at least 2) fit, or they all lie in one direction.
    """
    count = len(now)
    rate, covariance = np.empty(3), np.empty((3, 3))
    residuals, kept = np.empty(count), np.ones(count, np.bool_)
    tally = np.zeros(2, np.int64)
    least = max(min_stars, 2, math.ceil(2.0 * count / 3.0))
    solved, chi_square = _rate_kernel(
        np.ascontiguousarray(before, np.float64),
        np.ascontiguousarray(now, np.float64),
        np.ascontiguousarray(interval_s, np.float64),
        np.ascontiguousarray(along_rad, np.float64),
        np.ascontiguousarray(across_rad, np.float64),
        tolerance_rad,
        least,
        kept,
        residuals,
        rate,
        covariance,
        tally,
    )
    work = Work({"star_rates": 1, "rate_stars": int(tally[0]), "rate_least_squares": int(tally[1])})
    if not solved:
        return None, work
    freedom = 2 * int(np.count_nonzero(kept)) - 3
    return StarRate(rate, covariance, kept, residuals, float(chi_square), freedom), work


@numba.njit(nogil=True)
def _rate_kernel(
    before: FloatArray,
    now: FloatArray,
    interval_s: FloatArray,
    along_rad: FloatArray,
    across_rad: FloatArray,
    tolerance_rad: float,
    least: int,
    kept: npt.NDArray[np.bool_],
    residuals: FloatArray,
    rate: FloatArray,
    covariance: FloatArray,
    tally: npt.NDArray[np.int64],
) -> tuple[bool, float]:
    """(solved, chi^2); see rate_of_pairs. tally: stars summed, solutions."""
    count = len(now)
    left = count
    if left < least:
        return False, 0.0
    mean_s = 0.0
    for i in range(count):
        mean_s += interval_s[i]
    mean_s /= count
    # along and across rows of the equation of each star, in sigmas: rows . p = seen
    rows = np.empty((count, 2, 3))
    seen = np.empty(count)
    for i in range(count):
        share = interval_s[i] / mean_s
        ax, ay, az = now[i, 0] - before[i, 0], now[i, 1] - before[i, 1], now[i, 2] - before[i, 2]
        mx, my, mz = now[i, 0] + before[i, 0], now[i, 1] + before[i, 1], now[i, 2] + before[i, 2]
        moved = math.sqrt(ax * ax + ay * ay + az * az)
        if moved < 1e-12:  # any direction across m will do: the two errors are then the same
            ax, ay, az = mz, 0.0, -mx
            length = math.sqrt(ax * ax + az * az)
            if length == 0.0:
                ax, az, length = 1.0, 0.0, 1.0
            ax, ay, az = ax / length, 0.0, az / length
        else:
            ax, ay, az = ax / moved, ay / moved, az / moved
        # a x m, and across the motion c = a x m / |m|, c x m
        bx, by, bz = ay * mz - az * my, az * mx - ax * mz, ax * my - ay * mx
        size = math.sqrt(mx * mx + my * my + mz * mz)
        scale = share / along_rad[i]
        rows[i, 0, 0], rows[i, 0, 1], rows[i, 0, 2] = bx * scale, by * scale, bz * scale
        scale = share / (across_rad[i] * size)
        rows[i, 1, 0] = (by * mz - bz * my) * scale
        rows[i, 1, 1] = (bz * mx - bx * mz) * scale
        rows[i, 1, 2] = (bx * my - by * mx) * scale
        seen[i] = moved / along_rad[i]
    p = np.empty(3)
    while True:
        tally[0] += left
        tally[1] += 1
        if not _solve(rows, seen, kept, p, covariance):
            return False, 0.0
        worst = -1
        worst_off = 0.0
        chi_square = 0.0
        for i in range(count):
            off_along = seen[i] - (rows[i, 0, 0] * p[0] + rows[i, 0, 1] * p[1] + rows[i, 0, 2] * p[2])
            off_across = rows[i, 1, 0] * p[0] + rows[i, 1, 1] * p[1] + rows[i, 1, 2] * p[2]
            off = off_along * off_along + off_across * off_across
            along, across = off_along * along_rad[i], off_across * across_rad[i]
            residuals[i] = math.sqrt(along * along + across * across)
            if not kept[i]:
                continue
            chi_square += off
            if off > worst_off and residuals[i] > tolerance_rad and off > 9.0:
                worst, worst_off = i, off
        if worst < 0:
            break
        kept[worst] = False
        left -= 1
        if left < least:
            return False, 0.0
    # p is tan(angle / 2) along the axis
    size = math.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    factor = (2.0 * math.atan(size) / size if size > 1e-12 else 2.0) / mean_s
    scale = 4.0 / (mean_s * mean_s)
    freedom = 2 * left - 3
    if chi_square > freedom:
        scale *= chi_square / freedom
    for m in range(3):
        rate[m] = p[m] * factor
        for n in range(3):
            covariance[m, n] *= scale
    return True, chi_square


@numba.njit(nogil=True)
def _solve(
    rows: FloatArray, seen: FloatArray, kept: npt.NDArray[np.bool_], p: FloatArray, inverse: FloatArray
) -> bool:
    """Least squares of the kept stars: p[3] and the inverse of the normal matrix; False where degenerate."""
    xx = yy = zz = xy = xz = yz = 0.0
    rx = ry = rz = 0.0
    for i in range(len(seen)):
        if not kept[i]:
            continue
        for row in range(2):
            x, y, z = rows[i, row, 0], rows[i, row, 1], rows[i, row, 2]
            xx += x * x
            yy += y * y
            zz += z * z
            xy += x * y
            xz += x * z
            yz += y * z
        rx += rows[i, 0, 0] * seen[i]
        ry += rows[i, 0, 1] * seen[i]
        rz += rows[i, 0, 2] * seen[i]
    c00, c01, c02 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    determinant = xx * c00 + xy * c01 + xz * c02
    trace = xx + yy + zz
    if not determinant > 0.125 * DEGENERATE_INFORMATION_RATIO * trace * trace * trace:
        return False
    scale = 1.0 / determinant
    inverse[0, 0] = scale * c00
    inverse[0, 1] = inverse[1, 0] = scale * c01
    inverse[0, 2] = inverse[2, 0] = scale * c02
    inverse[1, 1] = scale * (xx * zz - xz * xz)
    inverse[1, 2] = inverse[2, 1] = scale * (xy * xz - xx * yz)
    inverse[2, 2] = scale * (xx * yy - xy * xy)
    for m in range(3):
        p[m] = inverse[m, 0] * rx + inverse[m, 1] * ry + inverse[m, 2] * rz
    return True


def turned_later(vectors: FloatArray, rate_rad_s: FloatArray, interval_s: FloatArray) -> FloatArray:
    """Where stars stand in sensor axes so much later (negative: earlier), float64[n, 3]: by the full turn.

    vectors: float64[n, 3] unit vectors; interval_s: float64[n].
    """
    turned = np.empty((len(vectors), 3))
    _turn_kernel(np.ascontiguousarray(vectors, np.float64), rate_rad_s, interval_s, turned)
    return turned


@numba.njit(nogil=True)
def _turn_kernel(
    vectors: FloatArray, rate_rad_s: FloatArray, interval_s: FloatArray, turned: FloatArray
) -> None:
    """Cayley again: u' (1 + p.p) = (1 - p.p) u - 2 p x u + 2 p (p.u), p = omega dt / 2."""
    for i in range(len(vectors)):
        half = 0.5 * interval_s[i]
        # tan(a) = a + a^3 / 3: to 1e-10 of the turn where it is under 1 deg
        square = half * half * (rate_rad_s[0] ** 2 + rate_rad_s[1] ** 2 + rate_rad_s[2] ** 2)
        half *= 1.0 + square / 3.0
        px, py, pz = rate_rad_s[0] * half, rate_rad_s[1] * half, rate_rad_s[2] * half
        x, y, z = vectors[i, 0], vectors[i, 1], vectors[i, 2]
        pp = px * px + py * py + pz * pz
        pu = 2.0 * (px * x + py * y + pz * z)
        rest = 1.0 - pp
        scale = 1.0 / (1.0 + pp)
        turned[i, 0] = (rest * x - 2.0 * (py * z - pz * y) + pu * px) * scale
        turned[i, 1] = (rest * y - 2.0 * (pz * x - px * z) + pu * py) * scale
        turned[i, 2] = (rest * z - 2.0 * (px * y - py * x) + pu * pz) * scale
