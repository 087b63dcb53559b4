"""Angular rate from stars that nobody has identified: their directions in two frames.

A star stands still, so in the sensor's axes its direction u turns by du/dt = -omega x u. Over a finite turn
about a fixed axis, u' - u = -p x (u' + u) exactly, with p = tan(half the angle) along the axis (Cayley): a
linear equation whatever the angle. Least squares over all stars gives p.

Under a rolling shutter the pairs are not of one time: those at the top of the image are a row time for each
row earlier than those at the bottom. Where the rate changes, they turn at different rates; so its change is
estimated with it, held near zero by what changes are expected. Without that a rate that grows by
0.5 deg/s^2 is off by ten of its sigmas.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from .work import Work

__all__ = ["StarRate", "bend_s2", "rate_of_pairs", "turned_later"]

FloatArray = npt.NDArray[np.float64]

# ASSUMED: as for attitudes, geometry is degenerate where one axis is known 10^8 times worse in variance.
DEGENERATE_INFORMATION_RATIO = 1e-8
# ASSUMED: 1 sigma of each axis, before anything is measured: 5 deg/s are reached in 5 s. Faster changes are
# measured all the same where there are more than a few stars.
EXPECTED_CHANGE_RAD_S2 = math.radians(1.0)
# ASSUMED: 1 sigma of each axis, of the change of that change, which is not estimated: a ramp to 5 deg/s in
# 10 s by half a versine begins with a third of it, one in 4 s with twice as much.
EXPECTED_JERK_RAD_S3 = math.radians(0.75)
# ASSUMED: a change counts where chance gives one as large in 0.27 % of frames (chi^2 of three axes), so that
# the places of the stars are not moved by noise.
SIGNIFICANT_CHANGE = 14.156
# ASSUMED: of two or three pairs that fit one rate worse than chance lets them (chi^2 of one and three
# degrees, 0.27 % of frames) one is of two stars, and which cannot be told: such a rate was off by 10 of its
# sigmas, as a covariance that is scaled by so few residuals says little.
WORST_OF_TWO, WORST_OF_THREE = 9.0, 14.156


@dataclass(frozen=True)
class StarRate:
    """A rate with its quality.

    rate_rad_s: float64[3], of the sensor relative to ICRS, in sensor axes, mean over the interval.
    covariance_rad2_s2: float64[3, 3]. change_rad_s2: float64[3], how fast the rate changes, zeros where that
    is not significant. kept: bool[n], the pairs that it is made of.
    residuals_rad: float64[n], how far each pair is from the turn that the rate gives, the dropped ones too.
    chi_square: of those kept and of the change as it was expected; degrees_of_freedom: 2 kept - 3.
    """

    rate_rad_s: FloatArray
    covariance_rad2_s2: FloatArray
    change_rad_s2: FloatArray
    kept: npt.NDArray[np.bool_]
    residuals_rad: FloatArray
    chi_square: float
    degrees_of_freedom: int


def rate_of_pairs(
    before: FloatArray,
    now: FloatArray,
    interval_s: FloatArray,
    later_s: FloatArray,
    along_rad: FloatArray,
    across_rad: FloatArray,
    common_rad_s: float,
    tolerance_rad: float,
    min_stars: int,
) -> tuple[StarRate | None, Work]:
    """Rate of the sensor from pairs of directions (sensor axes, unit vectors).

    before, now: float64[n, 3]. interval_s: float64[n], time between the two of each pair: with a rolling
        shutter each star has its own. later_s: float64[n], the middle of that time after the one that the
        rate is asked for. along_rad, across_rad: float64[n], expected errors of now - before
        along the star's motion and across it, 1 sigma: a streak's end is less sharp than its side.
    common_rad_s: error of all pairs' rates alike, 1 sigma of each axis, which no number of stars makes less.
    The pair that fits worst (most sigmas off) is dropped while it is over ``tolerance_rad`` and over 3 sigma
    on either axis. ASSUMED: at most a third; more, and the rest is not to be trusted either.
    Where chi^2 is over its degrees of freedom the covariance is scaled by it.
    None: fewer than ``min_stars`` (at least 2) fit, they all lie in one direction, or two or three are all
        that is left and contradict each other.
    """
    count = len(now)
    rate, change, covariance = np.empty(3), np.empty(3), np.empty((3, 3))
    residuals, kept = np.empty(count), np.ones(count, np.bool_)
    tally = np.zeros(2, np.int64)
    least = max(min_stars, 2, math.ceil(2.0 * count / 3.0))
    solved, chi_square = _rate_kernel(
        np.ascontiguousarray(before, np.float64),
        np.ascontiguousarray(now, np.float64),
        np.ascontiguousarray(interval_s, np.float64),
        np.ascontiguousarray(later_s, np.float64),
        np.ascontiguousarray(along_rad, np.float64),
        np.ascontiguousarray(across_rad, np.float64),
        common_rad_s,
        tolerance_rad,
        least,
        kept,
        residuals,
        rate,
        change,
        covariance,
        tally,
    )
    work = Work({"star_rates": 1, "rate_stars": int(tally[0]), "rate_least_squares": int(tally[1])})
    if not solved:
        return None, work
    freedom = 2 * int(np.count_nonzero(kept)) - 3
    return StarRate(rate, covariance, change, kept, residuals, float(chi_square), freedom), work


@numba.njit(nogil=True)
def _rate_kernel(
    before: FloatArray,
    now: FloatArray,
    interval_s: FloatArray,
    later_s: FloatArray,
    along_rad: FloatArray,
    across_rad: FloatArray,
    common_rad_s: float,
    tolerance_rad: float,
    least: int,
    kept: npt.NDArray[np.bool_],
    residuals: FloatArray,
    rate: FloatArray,
    change: FloatArray,
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
    # along and across rows of the equation of each star, in sigmas: rows . (p + later change) = seen
    rows = np.empty((count, 2, 3))
    seen = np.empty(count)
    # p grows by half of the mean interval times the rate
    expected = 2.0 / (EXPECTED_CHANGE_RAD_S2 * mean_s)
    expected *= expected
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
    p, growth, turn = np.empty(3), np.empty(3), np.empty(3)
    while True:
        tally[0] += left
        tally[1] += 1
        solved, significance = _solve(rows, seen, later_s, kept, expected, p, growth, covariance)
        if not solved:
            return False, 0.0
        worst = -1
        worst_off = 0.0
        chi_square = expected * (growth[0] * growth[0] + growth[1] * growth[1] + growth[2] * growth[2])
        for i in range(count):
            for m in range(3):
                turn[m] = p[m] + later_s[i] * growth[m]
            off_along = seen[i] - (
                rows[i, 0, 0] * turn[0] + rows[i, 0, 1] * turn[1] + rows[i, 0, 2] * turn[2]
            )
            off_across = rows[i, 1, 0] * turn[0] + rows[i, 1, 1] * turn[1] + rows[i, 1, 2] * turn[2]
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
    if (left == 2 and chi_square > WORST_OF_TWO) or (left == 3 and chi_square > WORST_OF_THREE):
        return False, 0.0
    # p is tan(angle / 2) along the axis
    size = math.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    factor = (2.0 * math.atan(size) / size if size > 1e-12 else 2.0) / mean_s
    scale = 4.0 / (mean_s * mean_s)
    freedom = 2 * left - 3
    spread = 1.0
    if chi_square > freedom:
        spread = chi_square / freedom
        scale *= spread
    counts = significance > SIGNIFICANT_CHANGE * spread
    for m in range(3):
        rate[m] = p[m] * factor
        change[m] = 2.0 * growth[m] / mean_s if counts else 0.0
        for n in range(3):
            covariance[m, n] *= scale
        covariance[m, m] += common_rad_s * common_rad_s
    return True, chi_square


@numba.njit(nogil=True)
def _invert(matrix: FloatArray, inverse: FloatArray) -> bool:
    """Inverse of a symmetric float64[3, 3] that is positive definite; False where it is degenerate."""
    xx, yy, zz = matrix[0, 0], matrix[1, 1], matrix[2, 2]
    xy, xz, yz = matrix[0, 1], matrix[0, 2], matrix[1, 2]
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
    return True


@numba.njit(nogil=True)
def _solve(
    rows: FloatArray,
    seen: FloatArray,
    later_s: FloatArray,
    kept: npt.NDArray[np.bool_],
    expected: float,
    p: FloatArray,
    growth: FloatArray,
    covariance: FloatArray,
) -> tuple[bool, float]:
    """Least squares of the kept stars: p[3], its growth[3] (1/s) and the covariance of p.

    expected: information on each axis of the growth, that it is zero. Returns whether the stars give a p
    without any growth, and growth . information . growth, chi^2 of three degrees where there is none.
    The growth is taken out of the normal equations (Schur), so that two 3 x 3 matrices are inverted.
    """
    of_p, of_both, of_growth = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    right, right_growth = np.zeros(3), np.zeros(3)
    for i in range(len(seen)):
        if not kept[i]:
            continue
        later = later_s[i]
        for m in range(3):
            along = rows[i, 0, m] * seen[i]
            right[m] += along
            right_growth[m] += later * along
            for n in range(m, 3):
                product = rows[i, 0, m] * rows[i, 0, n] + rows[i, 1, m] * rows[i, 1, n]
                of_p[m, n] += product
                product *= later
                of_both[m, n] += product
                of_growth[m, n] += later * product
    for m in range(3):
        of_growth[m, m] += expected
        for n in range(m):
            of_both[m, n] = of_both[n, m]
    alone = np.empty((3, 3))
    if not _invert(of_p, alone):
        return False, 0.0
    share, rest, inverse = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for m in range(3):
        for n in range(3):
            share[m, n] = (
                alone[m, 0] * of_both[0, n] + alone[m, 1] * of_both[1, n] + alone[m, 2] * of_both[2, n]
            )
    for m in range(3):
        right_growth[m] -= share[0, m] * right[0] + share[1, m] * right[1] + share[2, m] * right[2]
        for n in range(m, 3):
            taken = of_both[0, m] * share[0, n] + of_both[1, m] * share[1, n] + of_both[2, m] * share[2, n]
            rest[m, n] = rest[n, m] = of_growth[m, n] - taken
    if not _invert(rest, inverse):
        return False, 0.0
    significance = 0.0
    for m in range(3):
        growth[m] = (
            inverse[m, 0] * right_growth[0]
            + inverse[m, 1] * right_growth[1]
            + inverse[m, 2] * right_growth[2]
        )
        significance += growth[m] * right_growth[m]
    for m in range(3):
        p[m] = alone[m, 0] * right[0] + alone[m, 1] * right[1] + alone[m, 2] * right[2]
        p[m] -= share[m, 0] * growth[0] + share[m, 1] * growth[1] + share[m, 2] * growth[2]
        for n in range(3):
            covariance[m, n] = alone[m, n]
            for k in range(3):
                covariance[m, n] += (
                    inverse[k, 0] * share[n, 0] + inverse[k, 1] * share[n, 1] + inverse[k, 2] * share[n, 2]
                ) * share[m, k]
    return True, significance


def bend_s2(later_s: FloatArray, exposure_s: float) -> FloatArray:
    """What a jerk adds to the rate of each pair, over the jerk, float64[n].

    later_s^2 / 2 for the pair's time; exposure_s^2 / 24 as a star's mean place in an exposure is not that of
    its middle, for pairs that follow each other without a gap: their rate is the mean over a triangle of two
    exposures, not over the time between their middles.
    """
    return np.asarray(0.5 * later_s * later_s + exposure_s * exposure_s / 24.0)


def turned_later(
    vectors: FloatArray,
    rate_rad_s: FloatArray,
    interval_s: FloatArray,
    change_rad_s2: FloatArray | None = None,
    since_s: float = 0.0,
    exposure_s: float = 0.0,
) -> FloatArray:
    """Where stars stand in sensor axes so much later (negative: earlier), float64[n, 3]: by the full turn.

    vectors: float64[n, 3] unit vectors; interval_s: float64[n]. The rate changes by change_rad_s2[3], and all
    the intervals end since_s after it was rate_rad_s. The vectors are means over exposure_s: where the rate
    changes, a star's mean place is change exposure_s^2 / 24 from that in the middle of the exposure.
    """
    turned = np.empty((len(vectors), 3))
    change = np.zeros(3) if change_rad_s2 is None else change_rad_s2
    _turn_kernel(
        np.ascontiguousarray(vectors, np.float64), rate_rad_s, change, since_s, exposure_s, interval_s, turned
    )
    return turned


@numba.njit(nogil=True)
def _turn_kernel(
    vectors: FloatArray,
    rate_rad_s: FloatArray,
    change_rad_s2: FloatArray,
    since_s: float,
    exposure_s: float,
    interval_s: FloatArray,
    turned: FloatArray,
) -> None:
    """Cayley again: u' (1 + p.p) = (1 - p.p) u - 2 p x u + 2 p (p.u), p = omega dt / 2."""
    beside = exposure_s * exposure_s / 48.0
    for i in range(len(vectors)):
        half = 0.5 * interval_s[i]
        later = since_s - half
        rate_x = rate_rad_s[0] + later * change_rad_s2[0]
        rate_y = rate_rad_s[1] + later * change_rad_s2[1]
        rate_z = rate_rad_s[2] + later * change_rad_s2[2]
        # tan(a) = a + a^3 / 3: to 1e-10 of the turn where it is under 1 deg
        square = half * half * (rate_x * rate_x + rate_y * rate_y + rate_z * rate_z)
        half *= 1.0 + square / 3.0
        px = rate_x * half - beside * change_rad_s2[0]
        py = rate_y * half - beside * change_rad_s2[1]
        pz = rate_z * half - beside * change_rad_s2[2]
        x, y, z = vectors[i, 0], vectors[i, 1], vectors[i, 2]
        pp = px * px + py * py + pz * pz
        pu = 2.0 * (px * x + py * y + pz * z)
        rest = 1.0 - pp
        scale = 1.0 / (1.0 + pp)
        turned[i, 0] = (rest * x - 2.0 * (py * z - pz * y) + pu * px) * scale
        turned[i, 1] = (rest * y - 2.0 * (pz * x - px * z) + pu * py) * scale
        turned[i, 2] = (rest * z - 2.0 * (px * y - py * x) + pu * pz) * scale
