"""Wahba's problem without anything round it: what the robust method is held against."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from st_emulator.firmware_model.attitude import AttitudeSolution, solve_attitude_kernel
from st_emulator.firmware_model.work import Work

FloatArray = npt.NDArray[np.float64]


def q_method(
    measured: FloatArray, reference: FloatArray, sigma_rad: FloatArray
) -> tuple[AttitudeSolution | None, Work]:
    """The attitude of least loss sum |b_i - A r_i|^2 / sigma_i^2 (Wahba; Davenport; Shuster & Oh 1981).

    measured[n, 3]: unit vectors in the sensor frame; reference[n, 3]: the same stars in ICRS; sigma_rad[n]:
    error of each measured direction, 1 sigma in each of two axes. None when the geometry does not fix the
    attitude (fewer than two directions, or all parallel). The covariance is [sum (I - b b^T) / sigma^2]^-1,
    times chi^2 per degree of freedom where that is above 1: the scatter then says that the sigmas are too
    small.
    """
    count = len(measured)
    quaternion = np.empty(4)
    residuals = np.empty(count)
    covariance = np.empty((3, 3))
    work = Work({"qmethod_stars": count})
    if count < 2:
        return None, work
    b = np.ascontiguousarray(measured, np.float64)
    r = np.ascontiguousarray(reference, np.float64)
    weights = 1.0 / np.square(np.ascontiguousarray(sigma_rad, np.float64))
    solved, chi_square, rotations = solve_attitude_kernel(
        b, r, weights, count, quaternion, residuals, covariance
    )
    work.add("covariance_stars", count)
    work.add("covariance_solves", 1)
    if not solved:
        return None, work
    work.add("qmethod_solves", 1)
    work.add("jacobi_rotations", rotations)
    work.add("residual_stars", count)
    return AttitudeSolution(quaternion, residuals, covariance, float(chi_square), 2 * count - 3), work
