"""A firmware that measures the rate alone for some frames: results are put in place of those of the real one.

The frames are processed as ever; a frame in RATE_ONLY is searched as one lost in space. What is told of the
unit beyond its firmware can so be tested for any rate, covariance and event.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from st_emulator.device import imaging
from st_emulator.firmware_model.firmware import FirmwareState, FrameContext, FrameResult
from st_emulator.firmware_model.modes import Mode, ModeEvent
from st_emulator.firmware_model.reasons import Reason

RATE_RAD_S = np.array([0.0625, -0.03, 1e-5])
COVARIANCE = np.array([[4e-10, -1e-11, 3e-12], [-1e-11, 9e-10, 5e-12], [3e-12, 5e-12, 1.6e-7]])
REASONS = Reason.RATE_TOO_HIGH | Reason.NO_MATCH

Change = Callable[[FrameContext, FrameResult], FrameResult]


def process_frames_by(monkeypatch: pytest.MonkeyPatch, change: Change) -> None:
    """Each frame's result is what ``change`` makes of the real one."""
    real = imaging.process_frame

    def process(frame: Any, context: FrameContext, state: FirmwareState, *more: Any) -> FrameResult:
        searched = context
        if context.acquisition is Mode.RATE_ONLY:
            searched = replace(context, acquisition=Mode.LOST_IN_SPACE)
        return change(context, real(frame, searched, state, *more))

    monkeypatch.setattr(imaging, "process_frame", process)


def rate_alone(
    context: FrameContext,
    result: FrameResult,
    *,
    rate: np.ndarray | None = RATE_RAD_S,
    covariance: np.ndarray | None = COVARIANCE,
    last: bool = False,
) -> FrameResult:
    """The frame gives a rate, no attitude; ``last``: it is slow enough for one again."""
    lost = context.acquisition is Mode.LOST_IN_SPACE
    event = ModeEvent.RATE_ALONE if lost else ModeEvent.SLOW_AGAIN if last else None
    return replace(
        result,
        valid=False,
        reasons=REASONS,
        q_icrs_to_sensor=np.array([0.0, 0.0, 0.0, 1.0]),
        covariance_rad2=np.zeros((3, 3)),
        false_solutions=math.inf,
        rate_rad_s=rate,
        rate_covariance_rad2_s2=covariance,
        event=event,
        acquisition_after=Mode.LOST_IN_SPACE if last and not lost else Mode.RATE_ONLY,
        state=FirmwareState.initial(),
    )


def tumble(monkeypatch: pytest.MonkeyPatch, frames: int | None = None, **told: Any) -> None:
    """From the first frame on that is processed so many give a rate alone, None: all; then the real firmware.

    The last of them says that the unit is slow again.
    """
    begun: list[int] = []

    def change(context: FrameContext, result: FrameResult) -> FrameResult:
        begun.append(context.frame_index)
        if frames is not None and len(begun) > frames:
            return result
        return rate_alone(context, result, last=len(begun) == frames, **told)

    process_frames_by(monkeypatch, change)
