"""The sub-steps of an exposure: where the camera looks while light falls, fine enough for what it does.

The camera may do anything in an exposure: turn evenly, start a slew, shake. Its path is looked at at 5 even
instants, and at probes that are a little off even distances, so that no vibration stands still in them. The
probes are doubled until the path through them grows no more. (A trajectory whose attribute ``turns_evenly``
is True says that there is nothing to look for.) An even motion has as many sub-steps as its
path through the 5 instants asks for; another one as many as its fastest part. What comes and goes again
within 1/64 of the exposure, once, may be missed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .star_index import turn_between, turned
from .trajectory import Trajectory

Array = NDArray[np.float64]

MAX_STEP_PX = 0.5
_MAX_STEPS = 1024  # an exposure's length; a rolling shutter's frame lasts longer and may have more
_SHORT_STEPS = 32
_KNOTS = 5
_PROBES = 65
_MOST_PROBES = 8193
_GOLDEN_FRACTION = 0.6180339887498949
# The path has converged where twice the probes add no more than this to it.
_MORE_SHARE, _MORE_PX = 0.02, 0.05
# A motion is even where its fastest part is no more than this over its mean.
_UNEVEN_SHARE, _UNEVEN_PX = 1.5, 0.5


class Sight(NamedTuple):
    """Of a camera, as far as a star's way in the image depends on it."""

    focal_px: float
    corner: float  # tangent of the angle between the boresight and the image's corner
    max_step_px: float = MAX_STEP_PX  # no star is to move by more in a sub-step
    short_step_px: float = MAX_STEP_PX  # the same of a path of up to _SHORT_STEPS of these


class ExposurePath(NamedTuple):
    """What the camera does while light falls.

    attitudes [n, 4]: q_icrs_to_sensor of the ``steps`` equal sub-steps: at their middles, or with
    ``at_ends`` where they begin and end (n = steps + 1). at_middle: at the middle of the time. across_rad:
    the boresight's path. even: the motion is so even that a star's light is spread evenly along its path.
    step_px: no star moves by more in a sub-step.
    """

    attitudes: Array
    at_middle: Array
    steps: int
    across_rad: float
    even: bool
    step_px: float


def exposure_path(
    trajectory: Trajectory, start_ns: int, exposure_ns: int, later_ns: int, sight: Sight, at_ends: bool
) -> ExposurePath:
    """Of the time from start_ns to start_ns + exposure_ns + later_ns.

    later_ns: from the start of the first row's exposure to that of the last one. No star moves by more than
    sight.max_step_px in a sub-step, or by twice that in the fastest part of an even motion.
    """
    lasts_ns = exposure_ns + later_ns
    knots = start_ns + (np.arange(_KNOTS) * lasts_ns) // (_KNOTS - 1)
    q = trajectory.q_icrs_to_sensor(knots)
    across, about = turned(q)
    path_px = _path_px(across, about, sight)
    even = True
    if not getattr(trajectory, "turns_evenly", False):
        fastest_px, probed_across = _probed(trajectory, start_ns, lasts_ns, sight)
        even = fastest_px <= _UNEVEN_SHARE * path_px + _UNEVEN_PX
        if not even:
            across = max(across, probed_across)
            path_px = fastest_px
    most = math.ceil(_MAX_STEPS * lasts_ns / exposure_ns)
    short = min(math.ceil(path_px / sight.short_step_px), _SHORT_STEPS)
    steps = min(max(math.ceil(path_px / sight.max_step_px), short, 1), most)
    step_px = (_UNEVEN_SHARE * path_px + _UNEVEN_PX) / steps
    middle = q[_KNOTS // 2]
    if at_ends:
        times = start_ns + (np.arange(steps + 1) * lasts_ns) // steps
        return ExposurePath(trajectory.q_icrs_to_sensor(times), middle, steps, across, even, step_px)
    if steps == 1:
        return ExposurePath(q[_KNOTS // 2 : _KNOTS // 2 + 1], middle, 1, across, even, step_px)
    times = start_ns + ((2 * np.arange(steps) + 1) * lasts_ns) // (2 * steps)
    return ExposurePath(trajectory.q_icrs_to_sensor(times), middle, steps, across, even, step_px)


def _path_px(across: float, about: float, sight: Sight) -> float:
    """The image of a turn, at its largest, in a corner of the field."""
    return sight.focal_px * (across * (1.0 + sight.corner * sight.corner) + about * sight.corner)


def _probed(trajectory: Trajectory, start_ns: int, lasts_ns: int, sight: Sight) -> tuple[float, float]:
    """(length in px if all of the path were as fast as its fastest part, the boresight's path in rad)."""
    n = _PROBES
    while True:
        times = np.minimum(_unit_times(n) * lasts_ns, lasts_ns).astype(np.int64)
        q = trajectory.q_icrs_to_sensor(start_ns + times)
        length, fastest, across = _measured(q, times, sight.focal_px, sight.corner, 1)
        half, _, _ = _measured(q, times, sight.focal_px, sight.corner, 2)
        if length <= half * (1.0 + _MORE_SHARE) + _MORE_PX or n >= _MOST_PROBES:
            return fastest * lasts_ns, across
        n = 2 * n - 1


_KEPT_TIMES: dict[int, Array] = {}


def _unit_times(n: int) -> Array:
    """n growing numbers from 0 to 1, each off its even place by up to half a distance."""
    if n not in _KEPT_TIMES:
        off = (np.arange(n) * _GOLDEN_FRACTION) % 1.0 - 0.5
        off[[0, -1]] = 0.0
        _KEPT_TIMES[n] = (np.arange(n) + off) / (n - 1)
    return _KEPT_TIMES[n]


@njit(nogil=True, error_model="numpy")
def _measured(
    q: Array, times: NDArray[np.int64], focal_px: float, corner: float, stride: int
) -> tuple[float, float, float]:
    """(path through every stride-th attitude in px, fastest part in px/ns, boresight's path in rad)."""
    length = 0.0
    fastest = 0.0
    boresight = 0.0
    for k in range(0, q.shape[0] - stride, stride):
        across, about = turn_between(q[k], q[k + stride])
        path = focal_px * (across * (1.0 + corner * corner) + about * corner)
        length += path
        boresight += across
        lasted = times[k + stride] - times[k]
        if lasted > 0:
            fastest = max(fastest, path / lasted)
    return length, fastest, boresight
