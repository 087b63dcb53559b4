"""Cycles against the time that a frame has: margins, frames late and dropped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..campaigns.confidence import share
from ..clock import NS_PER_MS
from .figures import Cost, Costing, Distribution, Figure, distribution
from .subject import Subject


@dataclass(frozen=True)
class Late:
    """How many of the frames are late, and how many following ones that costs, at the nominal cost and at
    the bounds; share: of the frames late, with its 95 % interval by the number of frames."""

    frames: int
    late: Figure
    dropped: Figure

    def as_dict(self) -> dict[str, object]:
        found = share(int(self.late.value), self.frames)
        return {
            "frames": self.frames,
            "late": self.late.as_dict(),
            "late_share": {"value": found.value, "low": found.low, "high": found.high},
            "dropped": self.dropped.as_dict(),
        }


@dataclass(frozen=True)
class Margin:
    """Frames against their time. time_ms: of a frame's processing; margin_ms: of the budget, what the
    distribution's median, p99 and worst leave, so that its worst is the smallest."""

    budget_ms: float
    time_ms: Distribution
    late: Late

    @property
    def fits(self) -> bool:
        """At the nominal cost no frame is late."""
        return self.budget_ms > 0 and self.time_ms.worst.value <= self.budget_ms

    @property
    def fits_at_bound(self) -> bool:
        """At the highest cost that the model allows no frame is late."""
        return self.budget_ms > 0 and self.time_ms.worst.high <= self.budget_ms

    def left_ms(self, time_ms: Figure) -> Figure:
        """Margin of one of the times."""
        return Figure(
            self.budget_ms - time_ms.value, self.budget_ms - time_ms.high, self.budget_ms - time_ms.low
        )

    def as_dict(self) -> dict[str, object]:
        return {
            "budget_ms": self.budget_ms,
            "time_ms": self.time_ms.as_dict(),
            "margin_ms": {
                "median": self.left_ms(self.time_ms.median).as_dict(),
                "p99": self.left_ms(self.time_ms.p99).as_dict(),
                "worst": self.left_ms(self.time_ms.worst).as_dict(),
            },
            "late": self.late.as_dict(),
            "fits": self.fits,
            "fits_at_bound": self.fits_at_bound,
        }


def margin_of(subject: Subject, costing: Costing, costs: Sequence[Cost], pipelined: bool) -> Margin:
    """Frames of these costs against the unit's time in a mode of the pipeline. ValueError: no frames."""
    times = [costing.ms(cost.frame) for cost in costs]
    budget_ns = subject.budget_ns(pipelined)

    def counted(which: str) -> tuple[int, int]:
        spans = [costing.processor.duration_ns(int(getattr(cost.frame, which))) for cost in costs]
        late = sum(span > budget_ns for span in spans)
        return late, sum(subject.frames_dropped(span, pipelined) for span in spans if span > budget_ns)

    low, value, high = (counted(which) for which in ("low", "value", "high"))
    return Margin(
        budget_ns / NS_PER_MS,
        distribution(times),
        Late(
            len(times),
            Figure(value[0], low[0], high[0]),
            Figure(value[1], low[1], high[1]),
        ),
    )
