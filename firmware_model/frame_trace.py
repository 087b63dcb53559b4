"""The steps of a frame with what goes in and what comes out: for calibration, replay and inspection.

``process_frame(..., trace=f)`` calls ``f`` after each step. A trace changes nothing; it may keep the records
but must not write to the arrays in them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from .work import Work

__all__ = ["STEPS", "StepRecord", "Trace"]

STEPS: Final = (
    "velocity",  # of the observer, for the aberration
    "detect",  # full frame to spots
    "keep_runs",  # runs of the spots, for the next frame
    "fuse",  # spots of the frame before and of this one
    "star_rate",  # rate of the fused spots, not identified
    "compensate",  # rolling shutter, by each spot's own motion
    "places_by_rate",  # rolling shutter, by the rate
    "window_rate",  # the same of the windows' spots, from those of the frame before
    "flow_light",  # full frame to lit pixels and stars, for the optical flow
    "flow",  # stars of the frame before followed into this one
    "flow_rate",  # rate of the followed stars
    "plan",  # last attitude to detection windows
    "windows",  # pixels of the windows to spots
    "unit_vectors",  # pixel positions to directions
    "identify",  # lost in space
    "verify",  # tracking, by the pivot
    "apparent",  # catalogue directions with aberration
    "attitude",  # directions to quaternion and covariance
    "false_solutions",  # how likely chance gives such a solution
    "rate",  # from two attitudes
    "rate_limit",  # whether a rate without attitudes is too high to track
)


@dataclass(frozen=True)
class StepRecord:
    """One step as it ran: its name of ``STEPS``, arguments by name, result and the work that it counted."""

    step: str
    arguments: dict[str, Any]
    result: Any
    work: Work


Trace = Callable[[StepRecord], None]
