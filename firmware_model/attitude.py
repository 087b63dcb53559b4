"""Attitude from vector pairs: Davenport's q-method, residuals, covariance, and quaternion arithmetic.

Quaternions are float64 [x, y, z, w], scalar last, passive: v_S = A(q) v_ICRS with
A(q) = (w^2 - v.v) I + 2 v v^T - 2 w [v x] (Shuster 1993), and A(p (x) q) = A(p) A(q). Canonical: w >= 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from .work import Work

FloatArray = npt.NDArray[np.float64]

# ASSUMED: geometry is degenerate when one axis is known 10^8 times worse (in variance) than another. Stars
# spread over 0.01 deg still pass; a single star, or one star twice, does not.
DEGENERATE_INFORMATION_RATIO = 1e-8


@dataclass(frozen=True)
class AttitudeSolution:
    """An attitude with its quality.

    q_icrs_to_sensor: float64[4].
    residuals_rad: float64[n], angle between each measured direction and its reference turned by the attitude.
    covariance_rad2: float64[3, 3] of the small-angle error in sensor axes.
    chi_square: sum of (residual / sigma)^2; degrees_of_freedom: 2 n - 3.
    """

    q_icrs_to_sensor: FloatArray
    residuals_rad: FloatArray
    covariance_rad2: FloatArray
    chi_square: float
    degrees_of_freedom: int

    @property
    def residual_rms_rad(self) -> float:
        """Root mean square of the residuals."""
        return math.sqrt(float(self.residuals_rad @ self.residuals_rad) / len(self.residuals_rad))


def robust_q_method(
    measured: FloatArray, reference: FloatArray, sigma_rad: FloatArray, tolerance_rad: float, least: int
) -> tuple[AttitudeSolution | None, npt.NDArray[np.intp], Work]:
    """The q-method with stars that do not belong taken out, and those that fit badly given less weight.

    First at equal weights the star that fits worst is dropped while its residual is over tolerance_rad:
    with the weights of the sigmas, a bright star in the wrong place (two stars that make one spot) would
    pull the attitude onto itself and make the others look wrong. Then, three times, each star is weighted
    by the larger of its sigma and a third of its residual.
    ASSUMED: three sigma, as the usual bound between noise and something else.

    Returns (solution, indices of the stars kept, work); the solution's residuals are of the stars kept.
    None when fewer than `least` fit (the indices are then those left) or the geometry is degenerate (all
    indices).
    """
    count = len(measured)
    kept = np.ones(count, np.bool_)
    quaternion = np.empty(4)
    residuals = np.empty(count)
    covariance = np.empty((3, 3))
    counts = np.zeros(4, np.int64)
    solved, left, chi_square = _robust_kernel(
        np.ascontiguousarray(measured, np.float64),
        np.ascontiguousarray(reference, np.float64),
        np.ascontiguousarray(sigma_rad, np.float64),
        tolerance_rad,
        least,
        kept,
        quaternion,
        residuals,
        covariance,
        counts,
    )
    work = Work(
        {
            "qmethod_stars": int(counts[0]),
            "qmethod_solves": int(counts[1]),
            "jacobi_rotations": int(counts[3]),
            "residual_stars": int(counts[0]),
            "covariance_stars": int(counts[2]),
            "covariance_solves": 1 if counts[2] else 0,
        }
    )
    indices = np.flatnonzero(kept)
    if not solved:
        return None, indices, work
    solution = AttitudeSolution(
        quaternion, residuals[:left].copy(), covariance, float(chi_square), 2 * int(left) - 3
    )
    return solution, indices, work


@numba.njit(nogil=True)
def _robust_kernel(
    measured: FloatArray,
    reference: FloatArray,
    sigma: FloatArray,
    tolerance_rad: float,
    least: int,
    kept: npt.NDArray[np.bool_],
    q: FloatArray,
    residuals: FloatArray,
    covariance: FloatArray,
    counts: npt.NDArray[np.int64],
) -> tuple[bool, int, float]:
    """(solved, stars kept, chi^2); see robust_q_method. residuals[:kept] are those of the stars kept.

    counts[4]: stars summed and solves of the q-method, stars of the covariance, rotations.
    """
    stars = len(measured)
    b = measured.copy()
    r = reference.copy()
    s = sigma.copy()
    weights = np.ones(stars)
    place = np.arange(stars)
    left = stars
    if left < max(least, 2):
        return False, left, 0.0
    counts[2] += left
    if not covariance_kernel(b, weights, left, covariance):
        return False, left, 0.0
    while True:
        counts[3] += quaternion_kernel(b, r, weights, left, q)
        residuals_kernel(b, r, left, q, residuals)
        counts[0] += left
        counts[1] += 1
        worst = 0
        for i in range(1, left):
            if residuals[i] > residuals[worst]:
                worst = i
        if residuals[worst] <= tolerance_rad:
            break
        kept[place[worst]] = False
        left -= 1
        if left < max(least, 2):
            return False, left, 0.0
        for i in range(worst, left):
            for m in range(3):
                b[i, m] = b[i + 1, m]
                r[i, m] = r[i + 1, m]
            s[i] = s[i + 1]
            place[i] = place[i + 1]
    for _ in range(3):
        for i in range(left):
            spread = max(s[i], residuals[i] / 3.0)
            weights[i] = 1.0 / (spread * spread)
        counts[3] += quaternion_kernel(b, r, weights, left, q)
        residuals_kernel(b, r, left, q, residuals)
        counts[0] += left
        counts[1] += 1
    chi_square = 0.0
    for i in range(left):
        chi_square += weights[i] * residuals[i] * residuals[i]
    counts[2] += left
    if not covariance_kernel(b, weights, left, covariance):
        return False, left, 0.0
    freedom = 2 * left - 3
    if chi_square > freedom:
        for m in range(3):
            for n in range(3):
                covariance[m, n] *= chi_square / freedom
    return True, left, chi_square


@numba.njit(nogil=True)
def largest_eigenvector_kernel(k: FloatArray, vector: FloatArray) -> int:
    """Unit eigenvector of the largest eigenvalue of symmetric k[4, 4] (destroyed), by cyclic Jacobi.

    Returns the rotations done. Jacobi keeps small eigenvalue gaps exact, which a narrow field needs: the gap
    is about the square of the field's radius.
    """
    v = np.eye(4)
    rotations = 0
    for _sweep in range(30):
        off = 0.0
        for p in range(3):
            for q in range(p + 1, 4):
                off += k[p, q] * k[p, q]
        diagonal = 0.0
        for p in range(4):
            diagonal += k[p, p] * k[p, p]
        if off <= 1e-34 * diagonal:
            break
        for p in range(3):
            for q in range(p + 1, 4):
                if k[p, q] == 0.0:
                    continue
                rotations += 1
                theta = (k[q, q] - k[p, p]) / (2.0 * k[p, q])
                t = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    t = -t
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for i in range(4):
                    left = k[i, p]
                    right = k[i, q]
                    k[i, p] = c * left - s * right
                    k[i, q] = s * left + c * right
                for i in range(4):
                    left = k[p, i]
                    right = k[q, i]
                    k[p, i] = c * left - s * right
                    k[q, i] = s * left + c * right
                for i in range(4):
                    left = v[i, p]
                    right = v[i, q]
                    v[i, p] = c * left - s * right
                    v[i, q] = s * left + c * right
    largest = 0
    for i in range(1, 4):
        if k[i, i] > k[largest, largest]:
            largest = i
    norm = 0.0
    for i in range(4):
        norm += v[i, largest] * v[i, largest]
    norm = math.sqrt(norm)
    if v[3, largest] < 0.0:
        norm = -norm
    for i in range(4):
        vector[i] = v[i, largest] / norm
    return rotations


@numba.njit(nogil=True)
def matrix_kernel(q: FloatArray, a: FloatArray) -> None:
    """Write A(q) to a[3, 3]: v_S = A v_ICRS."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    a[0, 0] = w * w + x * x - y * y - z * z
    a[0, 1] = 2.0 * (x * y + w * z)
    a[0, 2] = 2.0 * (x * z - w * y)
    a[1, 0] = 2.0 * (x * y - w * z)
    a[1, 1] = w * w - x * x + y * y - z * z
    a[1, 2] = 2.0 * (y * z + w * x)
    a[2, 0] = 2.0 * (x * z + w * y)
    a[2, 1] = 2.0 * (y * z - w * x)
    a[2, 2] = w * w - x * x - y * y + z * z


@numba.njit(nogil=True)
def quaternion_kernel(b: FloatArray, r: FloatArray, weights: FloatArray, count: int, q: FloatArray) -> int:
    """The q-method alone: the first `count` pairs b[i], r[i] with their weights to the quaternion q[4].

    Returns the rotations that its eigenvector took.
    """
    profile = np.zeros((3, 3))
    for i in range(count):
        for m in range(3):
            for n in range(3):
                profile[m, n] += weights[i] * b[i, m] * r[i, n]
    trace = profile[0, 0] + profile[1, 1] + profile[2, 2]
    k = np.empty((4, 4))
    for m in range(3):
        for n in range(3):
            k[m, n] = profile[m, n] + profile[n, m]
        k[m, m] -= trace
    k[0, 3] = k[3, 0] = profile[1, 2] - profile[2, 1]
    k[1, 3] = k[3, 1] = profile[2, 0] - profile[0, 2]
    k[2, 3] = k[3, 2] = profile[0, 1] - profile[1, 0]
    k[3, 3] = trace
    return largest_eigenvector_kernel(k, q)


@numba.njit(nogil=True)
def residuals_kernel(b: FloatArray, r: FloatArray, count: int, q: FloatArray, residuals: FloatArray) -> None:
    """Angles between b[i] and A(q) r[i], rad. From the chord, which is exact for small angles."""
    a = np.empty((3, 3))
    matrix_kernel(q, a)
    for i in range(count):
        square = 0.0
        for m in range(3):
            difference = b[i, m] - (a[m, 0] * r[i, 0] + a[m, 1] * r[i, 1] + a[m, 2] * r[i, 2])
            square += difference * difference
        residuals[i] = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(square)))


@numba.njit(nogil=True)
def covariance_kernel(b: FloatArray, weights: FloatArray, count: int, covariance: FloatArray) -> bool:
    """Write [sum weights (I - b b^T)]^-1 to covariance[3, 3]; False and zeros where degenerate."""
    xx = yy = zz = xy = xz = yz = 0.0
    for i in range(count):
        w = weights[i]
        xx += w * (1.0 - b[i, 0] * b[i, 0])
        yy += w * (1.0 - b[i, 1] * b[i, 1])
        zz += w * (1.0 - b[i, 2] * b[i, 2])
        xy -= w * b[i, 0] * b[i, 1]
        xz -= w * b[i, 0] * b[i, 2]
        yz -= w * b[i, 1] * b[i, 2]
    c00 = yy * zz - yz * yz
    c01 = xz * yz - xy * zz
    c02 = xy * yz - xz * yy
    determinant = xx * c00 + xy * c01 + xz * c02
    trace = xx + yy + zz
    for m in range(3):
        for n in range(3):
            covariance[m, n] = 0.0
    # The two large eigenvalues are each about half of the trace, so determinant / trace^3 is about an
    # eighth of the ratio of the smallest to the largest.
    if not determinant > 0.125 * DEGENERATE_INFORMATION_RATIO * trace**3:
        return False
    scale = 1.0 / determinant
    covariance[0, 0] = scale * c00
    covariance[0, 1] = covariance[1, 0] = scale * c01
    covariance[0, 2] = covariance[2, 0] = scale * c02
    covariance[1, 1] = scale * (xx * zz - xz * xz)
    covariance[1, 2] = covariance[2, 1] = scale * (xy * xz - xx * yz)
    covariance[2, 2] = scale * (xx * yy - xy * xy)
    return True


@numba.njit(nogil=True)
def solve_attitude_kernel(
    b: FloatArray,
    r: FloatArray,
    weights: FloatArray,
    count: int,
    q: FloatArray,
    residuals: FloatArray,
    covariance: FloatArray,
) -> tuple[bool, float, int]:
    """(solved, chi^2, rotations): q-method, residuals, scaled covariance of the first `count` pairs."""
    if not covariance_kernel(b, weights, count, covariance):
        return False, 0.0, 0
    rotations = quaternion_kernel(b, r, weights, count, q)
    residuals_kernel(b, r, count, q, residuals)
    chi_square = 0.0
    for i in range(count):
        chi_square += weights[i] * residuals[i] * residuals[i]
    freedom = 2 * count - 3
    if chi_square > freedom:
        for m in range(3):
            for n in range(3):
                covariance[m, n] *= chi_square / freedom
    return True, chi_square, rotations


def attitude_matrix(q_icrs_to_sensor: FloatArray) -> FloatArray:
    """A(q), float64[3, 3]: v_S = A v_ICRS."""
    a = np.empty((3, 3))
    matrix_kernel(np.ascontiguousarray(q_icrs_to_sensor, np.float64), a)
    return a


def quaternion_product(p: FloatArray, q: FloatArray) -> FloatArray:
    """p (x) q with A(p (x) q) = A(p) A(q), canonical (w >= 0) and of unit length."""
    px, py, pz, pw = (float(c) for c in p)
    qx, qy, qz, qw = (float(c) for c in q)
    product = np.array(
        [
            pw * qx + qw * px - (py * qz - pz * qy),
            pw * qy + qw * py - (pz * qx - px * qz),
            pw * qz + qw * pz - (px * qy - py * qx),
            pw * qw - px * qx - py * qy - pz * qz,
        ]
    )
    product /= math.copysign(math.sqrt(float(product @ product)), float(product[3]))
    return product


def rotation_between(q_before: FloatArray, q_after: FloatArray) -> FloatArray:
    """Rotation vector, rad, in sensor axes, that turns the sensor from q_before to q_after (shortest way)."""
    inverse = np.array([-q_before[0], -q_before[1], -q_before[2], q_before[3]])
    turn = quaternion_product(q_after, inverse)
    sine = math.sqrt(float(turn[:3] @ turn[:3]))
    if sine < 1e-15:
        return np.zeros(3)
    return np.asarray(turn[:3] * (2.0 * math.atan2(sine, float(turn[3])) / sine))


def angular_rate(q_before: FloatArray, q_after: FloatArray, interval_s: float) -> FloatArray:
    """Mean rate of the sensor relative to ICRS between two attitudes, rad/s, in sensor axes."""
    return rotation_between(q_before, q_after) / interval_s
