"""Frames of one mode under one condition: cycles by stage, margins, how often the search was cut short."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..firmware_model.reasons import Reason
from .figures import FRAME, Costing, Distribution, by_row
from .margins import Margin, margin_of
from .samples import Lost, SkySample, Tracked
from .subject import Subject

LOST_IN_SPACE = "lost in space"
TRACKING = "tracking"


@dataclass(frozen=True)
class Cycles:
    """Cycles by stage (and of the frame), and the margin of the frames."""

    rows: dict[str, Distribution]
    margin: Margin

    def as_dict(self) -> dict[str, object]:
        return {
            "cycles": {row: found.as_dict() for row, found in self.rows.items()},
            **self.margin.as_dict(),
        }


@dataclass(frozen=True)
class LostResult:
    """Frames lost in space. flown: with the search's limit, in the unit's mode of the pipeline; other: in
    the other one; whole: no limit. limited: searches that the cycle budget ended, of_own_limit: that the
    algorithm's own limits ended; valid: attitudes found, all of ``frames``.
    """

    frames: int
    flown: Cycles
    other: Margin
    whole: Cycles
    limited: int
    other_limited: int
    of_own_limit: int
    valid: int

    def as_dict(self) -> dict[str, object]:
        return {
            "frames": self.frames,
            "as_flown": self.flown.as_dict(),
            "other_pipeline_mode": self.other.as_dict() | {"searches_ended_by_budget": self.other_limited},
            "search_without_limit": self.whole.as_dict(),
            "searches_ended_by_budget": self.limited,
            "searches_ended_by_own_limits": self.of_own_limit,
            "valid": self.valid,
        }


@dataclass(frozen=True)
class TrackedResult:
    """Tracked frames. flown: in the unit's mode of the pipeline; other: in the other one. windows,
    half_width_px: largest number and size of windows."""

    frames: int
    flown: Cycles
    other: Margin
    valid: int
    windows: int
    half_width_px: int

    def as_dict(self) -> dict[str, object]:
        return {
            "frames": self.frames,
            "as_flown": self.flown.as_dict(),
            "other_pipeline_mode": self.other.as_dict(),
            "valid": self.valid,
            "most_windows": self.windows,
            "largest_half_width_px": self.half_width_px,
        }


def lost_result(subject: Subject, costing: Costing, samples: Sequence[Lost]) -> LostResult:
    """Of frames lost in space; ValueError without any."""
    flown = [costing.cost(sample.counts) for sample in samples]
    other = [costing.cost(sample.other_counts) for sample in samples]
    whole = [costing.cost(sample.whole_counts) for sample in samples]
    return LostResult(
        len(samples),
        Cycles(by_row(flown), margin_of(subject, costing, flown, subject.pipelined)),
        margin_of(subject, costing, other, not subject.pipelined),
        Cycles(by_row(whole), margin_of(subject, costing, whole, subject.pipelined)),
        sum(sample.limited for sample in samples),
        sum(_limited(sample.other_reasons, sample.whole_reasons) for sample in samples),
        sum(bool(sample.whole_reasons & Reason.WORK_LIMIT) for sample in samples),
        sum(sample.reasons == 0 for sample in samples),
    )


def tracked_result(subject: Subject, costing: Costing, samples: Sequence[Tracked]) -> TrackedResult:
    """Of tracked frames; ValueError without any."""
    flown = [costing.cost(sample.counts) for sample in samples]
    return TrackedResult(
        len(samples),
        Cycles(by_row(flown), margin_of(subject, costing, flown, subject.pipelined)),
        margin_of(subject, costing, flown, not subject.pipelined),
        sum(sample.reasons == 0 for sample in samples),
        max(sample.windows for sample in samples),
        max(sample.half_width_px for sample in samples),
    )


def both(subject: Subject, costing: Costing, skies: Sequence[SkySample]) -> tuple[LostResult, TrackedResult]:
    """Both modes of the same skies."""
    return (
        lost_result(subject, costing, [sky.lost for sky in skies]),
        tracked_result(subject, costing, [item for sky in skies for item in sky.tracked]),
    )


def _limited(reasons: int, whole_reasons: int) -> bool:
    return bool(reasons & Reason.WORK_LIMIT) and not whole_reasons & Reason.WORK_LIMIT


__all__ = [
    "FRAME",
    "LOST_IN_SPACE",
    "TRACKING",
    "Cycles",
    "LostResult",
    "TrackedResult",
    "both",
    "lost_result",
    "tracked_result",
]
