"""Frames run through the firmware, and the work that they took: what every figure of a budget is made from.

A sample keeps counts of work, not cycles, so that it can be costed at any clock, cache and memory afterwards.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..bench.scenario import Scenario
from ..firmware_model.reasons import Reason
from ..firmware_model.work import COUNTS, Work
from ..units.profile import UnitProfile
from .scenes import Conditions, FrameInputs, frames_under, scenario_frames
from .subject import Parameters, Subject
from .transmission import transmission_of

Counts = NDArray[np.int64]
NAMES = tuple(COUNTS)
# Of a budget's cycles: a search that takes no more than this is never ended by it (`CycleBudget.for_search`
# gives half of the budget in any case).
SURE_SHARE = 0.45
TRACKED = 2  # frames tracked after each frame lost in space: from its attitude, and from a tracked one


@dataclass(frozen=True)
class Instant:
    """A place in a scenario: the exposure's start; number of the noise; what differs from the scenario."""

    start_ns: int
    number: int
    false_stars: int | None = None
    frames_lost: int = 0


@dataclass(frozen=True)
class Look:
    """One sky that is looked at: under conditions, or at an instant of the scenario.

    changed: on-board parameters in force.
    """

    place: Conditions | Instant
    changed: Parameters = ()


@dataclass(frozen=True)
class Lost:
    """A frame searched lost in space. All counts are int64[len(NAMES)] in the order of NAMES.

    counts, reasons: as the unit flies, its search limited by the cycle budget. other_counts, other_reasons:
    in the other of pipelined and not pipelined, whose budget differs. whole_counts, whole_reasons: without
    that limit; before_counts, search_counts: of these what was done before the search, and the search itself.
    """

    counts: Counts
    reasons: int
    other_counts: Counts
    other_reasons: int
    whole_counts: Counts
    whole_reasons: int
    before_counts: Counts
    search_counts: Counts
    spots: int
    stars: int

    @property
    def limited(self) -> bool:
        """Whether the cycle budget ended the search."""
        return bool(self.reasons & Reason.WORK_LIMIT) and not self.whole_reasons & Reason.WORK_LIMIT


@dataclass(frozen=True)
class Tracked:
    """A tracked frame. acquired: from the firmware's own attitude; else from the true one."""

    counts: Counts
    reasons: int
    spots: int
    stars: int
    windows: int
    half_width_px: int
    acquired: bool


@dataclass(frozen=True)
class SkySample:
    """One sky: lost in space, then tracked."""

    lost: Lost
    tracked: list[Tracked]


def counts_of(work: Work) -> Counts:
    """Counts as an array in the order of NAMES."""
    return np.array([work.counts.get(name, 0) for name in NAMES], np.int64)


def work_of(counts: Counts) -> Work:
    """The work of such an array."""
    work = Work()
    work.counts = {name: int(number) for name, number in zip(NAMES, counts, strict=True) if number}
    return work


def look(profile: UnitProfile, scenario: Scenario | None, case: Look) -> SkySample:
    """Run one sky: the frame lost in space as the unit flies it, in the other mode of the pipeline and
    without limit to the search, then the tracked frames.

    The report of the frame before is part of each frame's work, as in the unit.
    """
    subject, report = _subject(profile.model_dump_json(), case.changed)
    lost: Lost | None = None
    tracked = []
    for inputs in frames_at(subject, scenario, case.place):
        if not inputs.tracking:
            lost = lost_in_space(subject, inputs, report)
            continue
        result, _ = inputs.traced
        tracked.append(
            Tracked(
                counts_of(result.work + report),
                int(result.reasons),
                len(result.spots),
                len(result.stars),
                len(result.rects),
                int(result.window_half_width_px),
                inputs.acquired,
            )
        )
    assert lost is not None
    return SkySample(lost, tracked)


@lru_cache(maxsize=32)
def _subject(profile_json: str, changed: Parameters) -> tuple[Subject, Work]:
    subject = Subject(UnitProfile.model_validate_json(profile_json), changed)
    return subject, transmission_of(subject).work


def frames_at(
    subject: Subject, scenario: Scenario | None, place: Conditions | Instant
) -> Iterator[FrameInputs]:
    """The frame lost in space of a place, and those tracked after it."""
    if isinstance(place, Conditions):
        return frames_under(subject.profile, place, tracked=TRACKED, parameters=dict(subject.changed))
    assert scenario is not None
    if place.false_stars is not None:
        sky = scenario.sky.model_copy(update={"false_spots": place.false_stars})
        scenario = scenario.model_copy(update={"sky": sky})
    return scenario_frames(
        subject.profile,
        scenario,
        place.start_ns,
        place.number,
        tracked=TRACKED,
        frames_lost=place.frames_lost,
        parameters=dict(subject.changed),
    )


def lost_in_space(subject: Subject, inputs: FrameInputs, report: Work) -> Lost:
    """A frame lost in space with its limit, with that of the other mode, and with none.

    A search that a limit does not end is the same with a wider one or none, so it is run once.
    """
    flown, records = inputs.traced
    whole = flown
    if flown.reasons & Reason.WORK_LIMIT:
        whole, records = inputs.without_limit().traced
    steps = [record.step for record in records]
    at = steps.index("identify") if "identify" in steps else len(steps)
    before = sum((record.work for record in records[:at]), Work({"frames": 1}))
    search = records[at].work if at < len(steps) else Work()
    other = whole
    budget = subject.cycle_budget(not subject.pipelined)
    if subject.processor.cycles(search).total >= SURE_SHARE * budget.cycles:
        limited = replace(inputs.configuration, cycle_budget=budget)
        other = replace(inputs, configuration=limited).process()
    return Lost(
        counts_of(flown.work + report),
        int(flown.reasons),
        counts_of(other.work + report),
        int(other.reasons),
        counts_of(whole.work + report),
        int(whole.reasons),
        counts_of(before),
        counts_of(search),
        len(whole.spots),
        len(flown.stars),
    )
