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
    "plan",  # last attitude to detection windows
    "windows",  # pixels of the windows to spots
    "unit_vectors",  # pixel positions to directions
    "identify",  # lost in space
    "verify",  # tracking, by the pivot
    "apparent",  # catalogue directions with aberration
    "attitude",  # directions to quaternion and covariance
    "false_solutions",  # how likely chance gives such a solution
    "rate",  # from two attitudes
    "flow_light",  # a whole image to its lit pixels and stars, for the optical flow
    "flow",  # stars of the frame before, found in this one by optical flow
    "flow_rate",  # their directions to the angular rate and its covariance
)


@dataclass(frozen=True)
class StepRecord:
    """One step as it ran: its name of ``STEPS``, arguments by name, result and the work that it counted."""

    step: str
    arguments: dict[str, Any]
    result: Any
    work: Work


Trace = Callable[[StepRecord], None]
