"""Solutions: what each frame gave, how many in a row, by which way, and whether they are trustworthy."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...device.commands import Quaternion
from ...device.reports import AttitudeReady
from ...firmware_model.attitude import rotation_between
from ...firmware_model.frame_result import FrameResult
from ...firmware_model.modes import Mode, ModeEvent
from ...protocol.sagitta.telemetry import Strategy, TrackerMode
from .wire_frame import WireFrame

MOST_STABLE = 0xFFFFFFFF


@dataclass
class Validation:
    """What a trustworthy solution needs: the parameter of that name."""

    stable_count: int = 0
    max_difference_deg: float = math.inf
    min_confidence: float = 0.0
    min_stars: int = 0


class Solutions:
    """Keeps what a solution on the wire says of the frames so far.

    ASSUMED: solutions are counted as stable while each frame is solved and no more than the parameter's
    angle from the one before; a solution is valid when the device calls it so, enough in a row are, this one
    included, enough stars are matched, and in tracking the confidence is high enough.

    Args:
        wire_frame: turns the attitudes.
        validation: the limits, as they are when a frame is told.
        validated: whether they count; else each attitude of the device is valid.
        held: whether the last attitude is sent on where there is none; else 0,0,0,0.
    """

    def __init__(self, wire_frame: WireFrame, validation: Validation, *, validated: bool, held: bool) -> None:
        self._wire_frame = wire_frame
        self._validation = validation
        self._validated = validated
        self._held = held
        self.reset()

    def reset(self) -> None:
        """No frame so far."""
        self.stable_count = 0
        self.valid = False
        self.mode = TrackerMode.LISA
        self.strategy = Strategy.LISA_LOW_CONFIDENCE
        self.mid_exposure_ns: int | None = None
        self._solved = False
        self._last: Quaternion | None = None
        self._of_mode: dict[TrackerMode, Quaternion | None] = dict.fromkeys(TrackerMode)
        self._confidence = 0.0
        self._fraction_close = 0.0
        self._close = 0
        self._counts = (0, 0, 0)
        self._missed = False

    def interrupted(self) -> None:
        """No frames are looked at any more."""
        self._none(Strategy.LISA_LOW_CONFIDENCE)
        self.mode = TrackerMode.LISA
        self._counts = (0, 0, 0)
        self._missed = False

    def _none(self, strategy: Strategy) -> None:
        self.valid = self._solved = False
        self.stable_count = 0
        self.strategy = strategy

    def take(self, report: AttitudeReady, tracking: bool) -> None:
        """The result of a frame, or that it was dropped. ``tracking``: the mode in which it is told."""
        record, result = report.record, report.record.result
        self.mid_exposure_ns = record.mid_exposure_ns
        if result is None:
            self.mode = TrackerMode.TRACKING if tracking else TrackerMode.LISA
            self._counts = (0, 0, 0)
            self._none(Strategy.TRACKING_RECOVERED if tracking else Strategy.LISA_LOW_CONFIDENCE)
            self._missed = tracking
            return
        self.mode = TrackerMode.TRACKING if record.acquisition is Mode.TRACKING else TrackerMode.LISA
        self._count(result)
        if report.reasons:
            self._unsolved(result)
        else:
            self._solve(report.q_icrs_to_sensor)

    def _count(self, result: FrameResult) -> None:
        spots, matched = len(result.spots), len(result.stars)
        self._counts = (result.spots.rejected.total, spots, matched)
        if self.mode is TrackerMode.TRACKING:
            planned = 0 if result.plan is None else len(result.plan.star)
            self._confidence = matched / planned if planned else 0.0
        else:
            self._fraction_close = matched / spots if spots else 0.0
            self._close = matched

    def _unsolved(self, result: FrameResult) -> None:
        if self.mode is TrackerMode.LISA:
            self._none(Strategy.LISA_LOW_CONFIDENCE)
            self._missed = False
        elif result.event is ModeEvent.TRACKING_LOST:
            self._none(Strategy.DEMOTED_TO_LISA)
            self._missed = False
        else:
            self._none(Strategy.TRACKING_RECOVERED)
            self._missed = True

    def _solve(self, quaternion: Quaternion) -> None:
        limits = self._validation
        if self.stable_count and self._last is not None:
            turn_rad = np.linalg.norm(rotation_between(np.array(self._last), np.array(quaternion)))
            if math.degrees(float(turn_rad)) > limits.max_difference_deg:
                self.stable_count = 0
        self.stable_count = min(self.stable_count + 1, MOST_STABLE)
        self._solved = True
        self._last = self._of_mode[self.mode] = quaternion
        tracking = self.mode is TrackerMode.TRACKING
        self.strategy = Strategy.LISA_OK
        if tracking:
            self.strategy = Strategy.TRACKING_RECOVERED if self._missed else Strategy.TRACKING_OK
        self._missed = False
        self.valid = not self._validated or (
            self.stable_count >= limits.stable_count
            and self._counts[2] >= limits.min_stars
            and not (tracking and self._confidence < limits.min_confidence)
        )

    def values(self) -> dict[str, Any]:
        """The data of telemetry ``solution``."""
        shown = self._last if self._solved or self._held else None
        removed, centroided, matched = (min(count, 0xFF) for count in self._counts)
        return {
            **self._quaternion("", shown),
            "track_confidence": self._confidence,
            **self._quaternion("track_", self._of_mode[TrackerMode.TRACKING]),
            "removed": removed,
            "centroided": centroided,
            "matched": matched,
            **self._quaternion("lisa_", self._of_mode[TrackerMode.LISA]),
            "lisa_fraction_close": self._fraction_close,
            "lisa_close": min(self._close, 0xFF),
            "mode": int(self.mode),
            "valid": int(self.valid),
            "stable_count": self.stable_count,
            "strategy": int(self.strategy),
        }

    def _quaternion(self, prefix: str, quaternion: Quaternion | None) -> dict[str, float]:
        x, y, z, w = (0.0,) * 4 if quaternion is None else self._wire_frame.of(quaternion)
        return {f"{prefix}w": w, f"{prefix}x": x, f"{prefix}y": y, f"{prefix}z": z}
