"""A frame in time: exposure, read-out, stages, report on the line, next exposures, deadline."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from ..firmware_model.work import STAGES
from .assessment import Assessment
from .figures import Cost
from .modes import LOST_IN_SPACE, TRACKING

EXPOSURE = "exposure"
READOUT = "read-out"
MEDIAN = "median frame"
WORST = "worst frame found"
SERIAL = "on the line"
MOST_EXPOSURES = 12  # of the sensor that are shown
MS = 1e-6  # of a nanosecond


@dataclass(frozen=True)
class Span:
    """Something that takes time, ms from the frame's exposure start. lane: who does it; what: a stage, an
    exposure, a read-out, a transmission; end_high_ms: its end at the upper bound of the cost."""

    lane: str
    what: str
    start_ms: float
    end_ms: float
    end_high_ms: float


@dataclass(frozen=True)
class Timeline:
    """One frame of a mode, pipelined or not. deadline_ms: from which on the frame is late."""

    mode: str
    pipelined: bool
    own: bool  # the unit's mode of the pipeline
    period_ms: float
    deadline_ms: float
    spans: tuple[Span, ...]

    @property
    def title(self) -> str:
        return f"{self.mode}, {'pipelined' if self.pipelined else 'not pipelined'}" + (
            "" if self.own else " (not the unit's mode)"
        )

    def end(self, lane: str) -> Span:
        """The last span of a lane."""
        return max((span for span in self.spans if span.lane == lane), key=lambda span: span.end_ms)

    def as_dict(self) -> dict[str, object]:
        return asdict(self)


def timelines(assessment: Assessment) -> list[Timeline]:
    """Both modes, in the unit's mode of the pipeline and in the other one."""
    own = assessment.subject.pipelined
    return [
        timeline(assessment, mode, pipelined)
        for pipelined in (own, not own)
        for mode in (LOST_IN_SPACE, TRACKING)
    ]


def timeline(assessment: Assessment, mode: str, pipelined: bool) -> Timeline:
    """The median of the random frames and the worst frame found, each with its report."""
    subject = assessment.subject
    exposure, readout = subject.exposure_ns * MS, subject.readout_ns * MS
    period = subject.period_ns * MS
    begin = exposure + readout
    spans = []
    for lane, cost in (
        (MEDIAN, assessment.median_cost(mode, pipelined)),
        (WORST, _worst(assessment, mode, pipelined)),
    ):
        spans += processing(assessment, lane, cost, begin)
    latest = max(span.end_high_ms for span in spans)
    for number in range(min(MOST_EXPOSURES, max(2, math.ceil(latest / period)))):
        start = number * period
        end = start + exposure
        spans.append(Span(EXPOSURE, EXPOSURE, start, end, end))
        spans.append(Span(READOUT, READOUT, end, end + readout, end + readout))
    return Timeline(
        mode,
        pipelined,
        pipelined == subject.pipelined,
        period,
        begin + subject.budget_ns(pipelined) * MS,
        tuple(spans),
    )


def processing(assessment: Assessment, lane: str, cost: Cost, begin_ms: float) -> list[Span]:
    """The stages of a frame from its read-out on, one after the other, then its report on the serial line.

    The stage tracking stands where its verification does; the windows are planned before the read-out's
    pixels are looked at.
    """
    costing = assessment.costing
    spans = []
    at = at_high = begin_ms
    for stage in STAGES:
        time = costing.ms(cost.by_row[stage])
        if time.high <= 0:
            continue
        spans.append(Span(lane, stage, at, at + time.value, at_high + time.high))
        at += time.value
        at_high += time.high
    sent = assessment.transmission.serial_ns * MS
    if sent:
        spans.append(Span(f"{lane}, {SERIAL}", "report", at, at + sent, at_high + sent))
    return spans


def _worst(assessment: Assessment, mode: str, pipelined: bool) -> Cost:
    case = assessment.worst_of(mode)
    if mode == LOST_IN_SPACE and pipelined != assessment.subject.pipelined:
        return assessment.costing.cost(case.sample.lost.other_counts)
    return assessment.costing.cost(case.objective.heaviest(assessment.costing, case.sample)[1])


__all__ = ["Span", "Timeline", "timeline", "timelines"]
