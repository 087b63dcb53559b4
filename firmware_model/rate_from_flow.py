"""Angular rate from the directions of stars in two frames, without knowing which stars they are.

Fasano et al., Sensors 13 (2013), section 2.2 (paper F): u_dot + omega x u = 0 for each star, least squares by
orthogonal-triangular (QR) decomposition, residuals that show what does not belong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from .frame_log import FrameLog
from .geometry import CameraGeometry
from .image.optical_flow import FlowFrame, FlowParameters, OpticalFlow, flow_between
from .work import Work

__all__ = ["FlowRate", "FlowSettings", "foreseen_shifts", "rate_by_flow", "rate_from_directions"]

FloatArray = NDArray[np.float64]

LEAST_STARS = 2
PRIOR_DEGREES = 8.0
"""ASSUMED: the expected error of a direction weighs like so many measured ones when the spread is estimated,
so that few stars that agree by chance do not make a rate look better than it is.
"""
OUTLIER_SIGMA = 3.5
PASSES = 8
RAYLEIGH_MEDIAN = 2.0 * math.log(2.0)
"""The square of the median of residuals of two axes, over the variance of one (a Rayleigh distribution)."""
LEAST_VARIANCE = 1.0 / 9.0
"""ASSUMED: over the expected one; residuals that are all small by chance make no star an outlier."""


@dataclass(frozen=True, slots=True)
class FlowRate:
    """rate_rad_s: float64[3], of the sensor relative to ICRS in sensor axes; covariance_rad2_s2:
    float64[3, 3]; residual: float64[n], how far each star is from where the rate puts it, in its expected
    errors; kept: bool[n].
    """

    rate_rad_s: FloatArray
    covariance_rad2_s2: FloatArray
    residual: FloatArray
    kept: NDArray[np.bool_]


@numba.njit(nogil=True)
def _equations(
    before: FloatArray,
    after: FloatArray,
    along_rad: FloatArray,
    across_rad: FloatArray,
    foreseen: FloatArray,
    is_foreseen: bool,
    rows: FloatArray,
) -> None:
    """Two equations a star, rows[2 n, 4], of a . (m x t) = (a x m) . t: along its shift, then across."""
    middle, change, along = np.empty(3), np.empty(3), np.empty(3)
    for star in range(before.shape[0]):
        for i in range(3):
            middle[i] = 0.5 * (before[star, i] + after[star, i])
            change[i] = after[star, i] - before[star, i]
        x, y, z = middle[0], middle[1], middle[2]
        if is_foreseen:
            along[0] = y * foreseen[2] - z * foreseen[1]
            along[1] = z * foreseen[0] - x * foreseen[2]
            along[2] = x * foreseen[1] - y * foreseen[0]
        else:
            along[:] = change
        # tangents of length one: along the shift (any one where nothing moves), and across
        radial = along[0] * x + along[1] * y + along[2] * z
        for i in range(3):
            along[i] -= middle[i] * radial
        length = math.sqrt(along[0] * along[0] + along[1] * along[1] + along[2] * along[2])
        if length < 1e-9:
            along[0], along[1], along[2] = -z, 0.0, x
            length = math.sqrt(z * z + x * x)
        shorter = 1.0 / length
        for i in range(3):
            along[i] *= shorter
        first, second = 1.0 / along_rad[star], 1.0 / across_rad[star]
        across_x = y * along[2] - z * along[1]
        across_y = z * along[0] - x * along[2]
        across_z = x * along[1] - y * along[0]
        row, other = 2 * star, 2 * star + 1
        rows[row, 0], rows[row, 1], rows[row, 2] = -across_x * first, -across_y * first, -across_z * first
        rows[row, 3] = (along[0] * change[0] + along[1] * change[1] + along[2] * change[2]) * first
        # (m x a) x m = a |m|^2, as a is normal to m
        scale = (x * x + y * y + z * z) * second
        for i in range(3):
            rows[other, i] = along[i] * scale
        rows[other, 3] = (across_x * change[0] + across_y * change[1] + across_z * change[2]) * second


@numba.njit(nogil=True)
def _triangularise(rows: FloatArray, kept: NDArray[np.bool_], turned: FloatArray) -> None:
    """Upper triangle of the equations of the stars that are kept, into the first three rows of ``turned``,
    which has room for all of them: Householder's reflections (QR).
    """
    count = 0
    for row in range(rows.shape[0]):
        if kept[row // 2]:
            for k in range(4):
                turned[count, k] = rows[row, k]
            count += 1
    for column in range(3):
        square = 0.0
        for row in range(column, count):
            square += turned[row, column] * turned[row, column]
        length = math.sqrt(square)
        top = turned[column, column]
        if top > 0.0:
            length = -length
        if length == 0.0:
            continue
        top -= length
        factor = 1.0 / (length * top)
        for k in range(column + 1, 4):
            product = top * turned[column, k]
            for row in range(column + 1, count):
                product += turned[row, column] * turned[row, k]
            product *= factor
            turned[column, k] += product * top
            for row in range(column + 1, count):
                turned[row, k] += product * turned[row, column]
        turned[column, column] = length


@numba.njit(nogil=True)
def _solve(
    rows: FloatArray,
    least: int,
    kept: NDArray[np.bool_],
    residual: FloatArray,
    turned: FloatArray,
    turn: FloatArray,
    covariance: FloatArray,
) -> tuple[bool, int, int]:
    """The turn by passes of least squares until no star comes or goes. Returns (solved, passes, stars in all
    passes together); covariance: of the turn.
    """
    count = residual.shape[0]
    order = np.empty(count, np.int32)
    wanted = np.empty(count, np.bool_)
    stars = 0
    spread = 1.0
    passes = 0
    for star in range(count):
        kept[star] = True
    while passes < PASSES:
        passes += 1
        stars += count
        _triangularise(rows, kept, turned)
        a, b, c = abs(turned[0, 0]), abs(turned[1, 1]), abs(turned[2, 2])
        if min(a, b, c) <= 1e-3 * a:
            return False, passes, stars
        turn[2] = turned[2, 3] / turned[2, 2]
        turn[1] = (turned[1, 3] - turned[1, 2] * turn[2]) / turned[1, 1]
        turn[0] = (turned[0, 3] - turned[0, 1] * turn[1] - turned[0, 2] * turn[2]) / turned[0, 0]
        squares = 0.0
        degrees = -3
        for star in range(count):
            square = 0.0
            for row in range(2 * star, 2 * star + 2):
                error = rows[row, 3] - (
                    rows[row, 0] * turn[0] + rows[row, 1] * turn[1] + rows[row, 2] * turn[2]
                )
                square += error * error
            residual[star] = math.sqrt(square)
            if kept[star]:
                squares += square
                degrees += 2
            place = star
            while place > 0 and residual[order[place - 1]] > residual[star]:
                order[place] = order[place - 1]
                place -= 1
            order[place] = star
        spread = max((PRIOR_DEGREES + squares) / (PRIOR_DEGREES + max(degrees, 0)), 1.0)
        median = 0.5 * (residual[order[(count - 1) // 2]] + residual[order[count // 2]])
        limit = OUTLIER_SIGMA * math.sqrt(2.0 * max(median * median / RAYLEIGH_MEDIAN, LEAST_VARIANCE))
        changed = False
        for rank in range(count):
            star = order[rank]
            wanted[star] = residual[star] <= limit or rank < least
            changed = changed or wanted[star] != kept[star]
        if not changed:
            break
        for star in range(count):
            kept[star] = wanted[star]
    inverse = np.zeros((3, 3))
    a, b, c = 1.0 / turned[0, 0], 1.0 / turned[1, 1], 1.0 / turned[2, 2]
    inverse[0, 0], inverse[1, 1], inverse[2, 2] = a, b, c
    inverse[0, 1] = -turned[0, 1] * a * b
    inverse[1, 2] = -turned[1, 2] * b * c
    inverse[0, 2] = -(turned[0, 1] * inverse[1, 2] + turned[0, 2] * c) * a
    for i in range(3):
        for j in range(i + 1):
            product = 0.0
            for k in range(i, 3):
                product += inverse[i, k] * inverse[j, k]
            covariance[i, j] = covariance[j, i] = spread * product
    return True, passes, stars


def rate_from_directions(
    before: FloatArray,
    after: FloatArray,
    interval_s: float,
    along_rad: FloatArray,
    across_rad: FloatArray,
    foreseen_rad_s: FloatArray | None = None,
) -> tuple[FlowRate | None, Work]:
    """Rate of the sensor from unit vectors float64[n, 3] of the same stars, ``interval_s`` apart.

    u2 - u1 = (u1 + u2) / 2 x t holds exactly for a turn about t whose length is 2 tan(a / 2) of its angle a
    (Cayley), so that a large turn leaves no bias. The three equations of F (4) for a star are two, along its
    shift and across, so that each can have its own weight: along_rad, across_rad, float64[n], expected errors
    of the shift. foreseen_rad_s: a rate that says which way the shifts go; without it each goes its own,
    which makes short ones look longer than they are where the two weights differ. Stars whose residual is
    over OUTLIER_SIGMA of the spread go, at most a third of them. The covariance is that of the weights times
    the spread about them, shrunk towards 1 (PRIOR_DEGREES) and never less. None: fewer than two stars, or all
    in one direction.
    """
    work = Work()
    count = len(before)
    if count < LEAST_STARS or interval_s <= 0.0:
        return None, work
    rows, turned = np.empty((2 * count, 4)), np.empty((2 * count, 4))
    turn, covariance, residual = np.zeros(3), np.zeros((3, 3)), np.zeros(count)
    kept = np.ones(count, np.bool_)
    foreseen = np.zeros(3) if foreseen_rad_s is None else np.ascontiguousarray(foreseen_rad_s, np.float64)
    _equations(before, after, along_rad, across_rad, foreseen, foreseen_rad_s is not None, rows)
    least = max(LEAST_STARS, -(-2 * count // 3))
    solved, passes, stars = _solve(rows, least, kept, residual, turned, turn, covariance)
    work += Work({"flow_equations": count, "flow_rates": passes, "flow_rate_stars": stars})
    if not solved:
        return None, work
    x, y, z = turn.tolist()
    size = math.sqrt(x * x + y * y + z * z)  # 2 tan(a / 2) of the angle a
    angle = 2.0 * math.atan(0.5 * size)
    scale = (angle / size if size > 0.0 else 1.0) / interval_s
    return FlowRate(turn * scale, covariance / (interval_s * interval_s), residual, kept), work


@dataclass(frozen=True, slots=True)
class FlowSettings:
    """How a rate is made of a flow.

    weighted: each shift weighs by its expected errors along itself and across, in REWEIGHTINGS passes; else
    all weigh alike (F). predicted: the search is round where the last rate puts the stars, as long as its
    errors are below most_sigma_px of shift; else every shift is tried (F). least_error_px: of a centroid.
    ASSUMED defaults: measured against F's way in the campaign iris-tables, they are the better ones; 0.14 px
    and not 0.1, which the centroids are, keeps 99 % of the rates of turns to 5 deg/s within three sigma.
    """

    weighted: bool = True
    predicted: bool = True
    least_error_px: float = 0.14
    most_sigma_px: float = 2.0
    min_stars: int = LEAST_STARS
    most_error_rad_s: float = math.inf


REWEIGHTINGS = 3


def foreseen_shifts(
    frame: FlowFrame, geometry: CameraGeometry, rate_rad_s: FloatArray, interval_s: float
) -> tuple[FloatArray, Work]:
    """Where a rate moves a frame's stars in ``interval_s``: shifts (x, y), px, float64[n, 2]."""
    u, newton_steps = geometry.counted_unit_vectors(frame.x_px, frame.y_px)
    turned = u + np.cross(u, rate_rad_s * interval_s)
    x, y, _ = geometry.project(turned)
    work = Work(
        {"unit_vectors": len(frame), "newton_steps": newton_steps, "predicted_stars_projected": len(frame)}
    )
    return np.stack([x - frame.x_px, y - frame.y_px], axis=1), work


def rate_by_flow(
    before: FlowFrame,
    after: FlowFrame,
    interval_s: float,
    exposure_s: float,
    geometry: CameraGeometry,
    parameters: FlowParameters,
    settings: FlowSettings,
    last: FlowRate | None,
    log: FrameLog,
) -> tuple[OpticalFlow, FlowRate | None]:
    """The flow from one frame to the next and the rate that it shows (F sections 2.1 and 2.2).

    interval_s: from mid-exposure to mid-exposure. last: the rate of the frame before, if it is known. The
    steps are put into ``log``. No rate: see ``FlowSettings``.
    """
    foreseen = None
    if settings.predicted and last is not None:
        across = float(np.sqrt(np.diag(last.covariance_rad2_s2)[:2].max()))
        if across * interval_s * geometry.focal_px <= settings.most_sigma_px:
            foreseen, counted = foreseen_shifts(before, geometry, last.rate_rad_s, interval_s)
            log.count(counted)
    flow = log.run(
        "flow", flow_between, before=before, after=after, parameters=parameters, foreseen_px=foreseen
    )
    first, steps_before = geometry.counted_unit_vectors(flow.x_before_px, flow.y_before_px)
    second, steps_after = geometry.counted_unit_vectors(flow.x_px, flow.y_px)
    log.count(Work({"unit_vectors": 2 * len(flow), "newton_steps": steps_before + steps_after}))
    directions = {"before": first, "after": second, "interval_s": interval_s}
    rate: FlowRate | None = None
    if not settings.weighted:
        alike = np.full(len(flow), math.sqrt(2.0) * settings.least_error_px / geometry.focal_px)
        rate = log.run("flow_rate", rate_from_directions, **directions, along_rad=alike, across_rad=alike)
        return flow, _worth_telling(rate, settings)
    shift_x, shift_y = flow.x_px - flow.x_before_px, flow.y_px - flow.y_before_px
    streak = np.sqrt(shift_x * shift_x + shift_y * shift_y) * (exposure_s / interval_s)
    for _ in range(REWEIGHTINGS):
        along, across_px = flow.errors_px(streak, settings.least_error_px)
        log.count(Work({"shift_errors": len(flow)}))
        rate = log.run(
            "flow_rate",
            rate_from_directions,
            **directions,
            along_rad=along / geometry.focal_px,
            across_rad=across_px / geometry.focal_px,
            foreseen_rad_s=None if rate is None else rate.rate_rad_s,
        )
        if rate is None:
            break
        moved = np.cross(first, rate.rate_rad_s)
        streak = np.sqrt((moved * moved).sum(axis=1)) * (exposure_s * geometry.focal_px)
    return flow, _worth_telling(rate, settings)


def _worth_telling(rate: FlowRate | None, settings: FlowSettings) -> FlowRate | None:
    if rate is None or int(np.count_nonzero(rate.kept)) < settings.min_stars:
        return None
    worst = float(np.diag(rate.covariance_rad2_s2).max())
    return rate if worst <= settings.most_error_rad_s * settings.most_error_rad_s else None
