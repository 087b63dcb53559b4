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
so that few stars that agree by chance do not make a rate look better than it is."""
OUTLIER_SIGMA = 3.5
PASSES = 8


@dataclass(frozen=True, slots=True)
class FlowRate:
    """rate_rad_s: float64[3], of the sensor relative to ICRS in sensor axes; covariance_rad2_s2: float64[3,
    3]; residual: float64[n], how far each star is from where the rate puts it, in its expected errors; kept:
    bool[n].
    """

    rate_rad_s: FloatArray
    covariance_rad2_s2: FloatArray
    residual: FloatArray
    kept: NDArray[np.bool_]


@numba.njit(nogil=True)
def _triangularise(rows: FloatArray, kept: NDArray[np.bool_], r: FloatArray) -> int:
    """Upper triangle r[3, 4] of two equations a star, rows[2 n, 4], by Givens rotations, row after row."""
    for i in range(3):
        for j in range(4):
            r[i, j] = 0.0
    rotations = 0
    row = np.empty(4)
    for equation in range(rows.shape[0]):
        if not kept[equation // 2]:
            continue
        row[:] = rows[equation]
        for i in range(3):
            if row[i] == 0.0:
                continue
            length = math.sqrt(r[i, i] * r[i, i] + row[i] * row[i])
            cosine, sine = r[i, i] / length, row[i] / length
            for j in range(i, 4):
                above = r[i, j]
                r[i, j] = cosine * above + sine * row[j]
                row[j] = cosine * row[j] - sine * above
            rotations += 1
    return rotations


def rate_from_directions(
    before: FloatArray,
    after: FloatArray,
    interval_s: float,
    along_rad: FloatArray,
    across_rad: FloatArray,
    foreseen_rad_s: FloatArray | None = None,
) -> tuple[FlowRate | None, Work]:
    """Rate of the sensor from unit vectors float64[n, 3] of the same stars at two instants, ``interval_s``
    apart.

    u2 - u1 = (u1 + u2) / 2 x t holds exactly for a turn about t whose length is 2 tan(a / 2) of its angle a
    (Cayley), so that a large turn leaves no bias. The three equations of F (4) for a star are two, along its
    shift and across, so that each can have its own weight: along_rad, across_rad, float64[n], expected errors
    of the shift. foreseen_rad_s: a rate that says which way the shifts go; without it each goes its own,
    which makes short ones look longer than they are where the two weights differ. Stars whose residual is
    over OUTLIER_SIGMA of the spread go, at most a third of them. The covariance is that of the weights times
    the spread about them, shrunk towards 1 (PRIOR_DEGREES). None: fewer than two stars, or all in one
    direction.
    """
    work = Work()
    count = len(before)
    if count < LEAST_STARS or interval_s <= 0.0:
        return None, work
    middle, change = 0.5 * (before + after), after - before
    # unit tangents: along the shift that is foreseen (any one where nothing moves), and across
    foreseen = change if foreseen_rad_s is None else np.cross(middle, foreseen_rad_s)
    along = foreseen - middle * (foreseen * middle).sum(axis=1, keepdims=True)
    length = np.sqrt((along * along).sum(axis=1))
    still = length < 1e-9
    along[still] = np.cross(middle[still], np.array([0.0, 1.0, 0.0]))
    length[still] = np.sqrt((along[still] ** 2).sum(axis=1))
    along /= length[:, np.newaxis]
    across = np.cross(middle, along)
    # a . (m x t) = (a x m) . t
    rows = np.empty((2 * count, 4))
    for first, axis, sigma in ((0, along, along_rad), (1, across, across_rad)):
        rows[first::2, :3] = np.cross(axis, middle) / sigma[:, np.newaxis]
        rows[first::2, 3] = (axis * change).sum(axis=1) / sigma
    kept = np.ones(count, np.bool_)
    least = max(LEAST_STARS, math.ceil(2.0 * count / 3.0))
    r = np.empty((3, 4))
    turn = np.zeros(3)
    residual = np.zeros(count)
    spread = 1.0
    for _ in range(PASSES):
        work.add("flow_rates")
        work.add("flow_rate_stars", count)
        _triangularise(rows, kept, r)
        if min(abs(r[0, 0]), abs(r[1, 1]), abs(r[2, 2])) < 1e-3 * abs(r[0, 0]):
            return None, work
        turn = _solve_triangle(r)
        error = rows[:, 3] - rows[:, :3] @ turn
        residual = np.sqrt(error[0::2] ** 2 + error[1::2] ** 2)
        degrees = max(2 * int(kept.sum()) - 3, 0)
        spread = (PRIOR_DEGREES + float((residual[kept] ** 2).sum())) / (PRIOR_DEGREES + degrees)
        wanted = residual <= OUTLIER_SIGMA * math.sqrt(2.0 * _robust_variance(residual))
        if int(wanted.sum()) < least:
            order = np.argsort(residual, kind="stable")
            wanted = np.zeros(count, np.bool_)
            wanted[order[:least]] = True
        if (wanted == kept).all():
            break
        kept = wanted
    inverse = _inverse_triangle(r)
    covariance = spread * (inverse @ inverse.T) / (interval_s * interval_s)
    size = math.sqrt(float(turn @ turn))  # 2 tan(a / 2) of the angle a
    angle = 2.0 * math.atan(0.5 * size)
    scale = angle / size if size > 0.0 else 1.0
    return FlowRate(turn * scale / interval_s, covariance, residual, kept), work


@dataclass(frozen=True, slots=True)
class FlowSettings:
    """How a rate is made of a flow.

    weighted: each shift weighs by its expected errors along itself and across, in REWEIGHTINGS passes; else
    all weigh alike (F). predicted: the search is round where the last rate puts the stars, as long as its
    errors are below most_sigma_px of shift; else every shift is tried (F). ASSUMED defaults: measured against
    F's way in the campaign iris-tables, they are the better ones.
    """

    weighted: bool = True
    predicted: bool = True
    least_error_px: float = 0.1
    most_sigma_px: float = 2.0


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
    steps are put into ``log``.
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
    vectors = {"unit_vectors": 2 * len(flow), "newton_steps": steps_before + steps_after}
    log.count(Work(vectors))
    alike = np.full(len(flow), math.sqrt(2.0) * settings.least_error_px / geometry.focal_px)
    directions = {"before": first, "after": second, "interval_s": interval_s}
    if not settings.weighted:
        return flow, log.run(
            "flow_rate", rate_from_directions, **directions, along_rad=alike, across_rad=alike
        )
    rate: FlowRate | None = None
    streak = np.hypot(flow.x_px - flow.x_before_px, flow.y_px - flow.y_before_px) * (exposure_s / interval_s)
    for _ in range(REWEIGHTINGS):
        along, across_px = flow.errors_px(streak, settings.least_error_px)
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
        streak = np.sqrt((moved * moved).sum(axis=1)) * exposure_s * geometry.focal_px
    return flow, rate


def _robust_variance(residual: FloatArray) -> float:
    """Variance of an axis of a star's residual by their median (of a Rayleigh distribution), over that
    expected; not below a ninth."""
    median = float(np.median(residual))
    return max(median * median / (2.0 * math.log(2.0)), 1.0 / 9.0)


def _solve_triangle(r: FloatArray) -> FloatArray:
    z = r[2, 3] / r[2, 2]
    y = (r[1, 3] - r[1, 2] * z) / r[1, 1]
    return np.array([(r[0, 3] - r[0, 1] * y - r[0, 2] * z) / r[0, 0], y, z])


def _inverse_triangle(r: FloatArray) -> FloatArray:
    a, b, c = 1.0 / r[0, 0], 1.0 / r[1, 1], 1.0 / r[2, 2]
    ab = -r[0, 1] * a * b
    bc = -r[1, 2] * b * c
    ac = -(r[0, 1] * bc + r[0, 2] * c) * a
    return np.array([[a, ab, ac], [0.0, b, bc], [0.0, 0.0, c]])
