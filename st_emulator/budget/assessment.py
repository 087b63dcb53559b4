"""A whole budget: everything looked at, costed and judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..bench.scenario import Scenario
from ..campaigns.workers import Workers
from .figures import ROWS, Cost, Costing, Figure, p99
from .least_clock import Laws, LeastClock, clock_as_flown, clock_for_frames
from .memory import Memory, memory_of
from .modes import LOST_IN_SPACE, TRACKING, LostResult, TrackedResult, both
from .samples import Counts, Look, SkySample, look
from .subject import Subject
from .sweeps import (
    FALSE_STARS,
    FRAMES_LOST,
    KINDS,
    RATE,
    WINDOWS,
    Plan,
    Point,
    PointResult,
    Stop,
    random_plan,
    random_point,
    refinements,
    scenario_plan,
    scenario_point,
    stop_of,
)
from .transmission import Transmission, transmission_of
from .verdict import Requirement, Verdict, heaviest_stage, verdict_of
from .worst_case import AS_FLOWN, OBJECTIVES, WITHOUT_LIMIT, WorstCase, search

BATCH = 5
FLOWN, WHOLE = "flown", "whole"


@dataclass(frozen=True)
class Order:
    """What is asked for. evaluations: skies that the search for the worst frame may try, all in all."""

    subject: Subject
    n: int
    seed: int
    evaluations: int
    scenario: Scenario | None = None


@dataclass(frozen=True)
class StopRow:
    """Where a sweep stops fitting: of which mode, and with or without the limit to its search."""

    sweep: str
    mode: str
    cycles: str
    last_value: float
    stop: Stop

    @property
    def title(self) -> str:
        limit = "" if self.mode == TRACKING else f", {AS_FLOWN if self.cycles == FLOWN else WITHOUT_LIMIT}"
        return f"{self.mode}{limit}"

    def text(self) -> str:
        """``fits to 50, not at 58 spots (lower bound: not at 67; upper bound: not at 50)``, or that it
        never stops."""
        kind = KINDS[self.sweep]
        stop = self.stop
        if stop.stops_at is None:
            what = "the most looked at"
            if self.sweep == RATE and self.mode == TRACKING:
                what = "the most at which tracking holds"
            words = f"fits to {self.last_value:g} {kind.unit}, {what}"
            if stop.stops_at_high_cost is not None:
                words += f" (upper bound: not at {stop.stops_at_high_cost:g})"
            return words
        start = "fits nowhere" if stop.fits_to is None else f"fits to {stop.fits_to:g},"
        bounds = "; ".join(
            f"{name} bound: {'to the end' if value is None else f'not at {value:g}'}"
            for name, value in (("lower", stop.stops_at_low_cost), ("upper", stop.stops_at_high_cost))
        )
        return f"{start} not at {stop.stops_at:g} {kind.unit} ({bounds})"


@dataclass(frozen=True)
class Assessment:
    """The budget of a unit: what the tables, the page and the JSON are made from."""

    order: Order
    plan: Plan
    samples: list[SkySample]
    costing: Costing
    lost: LostResult
    tracked: TrackedResult
    sweeps: dict[str, list[PointResult]]
    stops: list[StopRow]
    worst: list[WorstCase]
    worst_stages: dict[str, dict[str, Figure]]
    verdict: Verdict
    memory: Memory
    transmission: Transmission

    @property
    def subject(self) -> Subject:
        return self.order.subject

    def worst_of(self, mode: str, search_kind: str = AS_FLOWN) -> WorstCase:
        """The heaviest frame that the search found."""
        return next(
            item
            for item in self.worst
            if item.objective.mode == mode and item.objective.search == search_kind
        )

    def median_cost(self, mode: str, pipelined: bool) -> Cost:
        """The frame in the middle of the random ones, with its search limited as in that mode of the
        pipeline."""
        skies = self.samples[: len(self.plan.skies)]
        if mode == TRACKING:
            counts = [item.counts for sky in skies for item in sky.tracked]
        elif pipelined == self.subject.pipelined:
            counts = [sky.lost.counts for sky in skies]
        else:
            counts = [sky.lost.other_counts for sky in skies]
        costs = sorted((self.costing.cost(item) for item in counts), key=lambda cost: cost.frame.value)
        return costs[len(costs) // 2]


def assess(order: Order, workers: Workers) -> Assessment:
    """Look at everything that the order asks for and judge it.

    Raises ConfigurationError: a case refuses, or the scenario does not fit the unit.
    """
    subject = order.subject
    costing = Costing(subject.processor)
    run = partial(look, subject.profile, order.scenario)
    plan = (
        random_plan(subject, order.n, order.seed)
        if order.scenario is None
        else scenario_plan(subject, order.n, order.scenario)
    )
    samples = workers.map(run, plan.looks, batch=BATCH)
    sweeps = plan.results(subject, costing, samples)
    closer = _closer(order, sweeps)
    if closer:
        plan = Plan(plan.skies, (*plan.points, *closer))
        samples = samples + workers.map(run, [item for point in closer for item in point.looks], batch=BATCH)
        sweeps = plan.results(subject, costing, samples)
    seen = list(zip(plan.looks, samples, strict=True))
    worst = search(subject, order.scenario, seen, order.evaluations, order.seed, workers)
    skies = samples[: order.n]
    lost, tracked = both(subject, costing, skies)
    return Assessment(
        order,
        plan,
        samples,
        costing,
        lost,
        tracked,
        sweeps,
        stop_rows(sweeps),
        worst,
        _worst_stages(subject, costing, seen, worst),
        verdict_of(_requirements(subject, costing, skies, lost, tracked, worst)),
        memory_of(subject),
        transmission_of(subject),
    )


def stop_rows(sweeps: dict[str, list[PointResult]]) -> list[StopRow]:
    """Where each sweep stops fitting, by mode."""
    rows = []
    for name, points in sweeps.items():
        for mode in KINDS[name].modes:
            used = points
            if mode == TRACKING and name == RATE:
                used = [point for point in points if point.holds] or points[:1]
            for cycles in (FLOWN, WHOLE) if mode == LOST_IN_SPACE else (FLOWN,):
                rows.append(StopRow(name, mode, cycles, used[-1].value, stop_of(used, cycles, mode)))
    return rows


def _closer(order: Order, sweeps: dict[str, list[PointResult]]) -> list[Point]:
    """Further points where a sweep stops fitting, to say more exactly where."""
    wanted: dict[tuple[str, float], None] = {}
    for row in stop_rows(sweeps):
        for value in refinements(row.stop, KINDS[row.sweep].whole_values):
            wanted[row.sweep, value] = None
    if order.scenario is None:
        return [random_point(order.subject, order.n, order.seed, *item) for item in wanted]
    return [scenario_point(order.subject, order.n, order.scenario, *item) for item in wanted]


def _worst_stages(
    subject: Subject,
    costing: Costing,
    seen: Sequence[tuple[Look, SkySample]],
    worst: Sequence[WorstCase],
) -> dict[str, dict[str, Figure]]:
    """The most that each stage took in any frame looked at, as flown, by mode; stages of different frames.

    Frames with other windows than the unit's do not count."""
    skies = [sample for case, sample in seen if case.changed == subject.changed]
    skies += [item.sample for item in worst]
    modes = {
        LOST_IN_SPACE: [costing.cost(sky.lost.counts) for sky in skies],
        TRACKING: [costing.cost(item.counts) for sky in skies for item in sky.tracked],
    }
    return {
        mode: {row: max((cost.by_row[row] for cost in costs), key=lambda item: item.value) for row in ROWS}
        for mode, costs in modes.items()
    }


def _requirements(
    subject: Subject,
    costing: Costing,
    skies: Sequence[SkySample],
    lost: LostResult,
    tracked: TrackedResult,
    worst: Sequence[WorstCase],
) -> list[Requirement]:
    laws = Laws(subject.processor)
    budget_ns = subject.budget_ns(subject.pipelined)
    budget_s = budget_ns * 1e-9

    def required(
        name: str,
        mode: str,
        statistic: str,
        time_ms: Figure,
        frames: Sequence[Counts],
        clock: LeastClock,
        *,
        sought: bool = False,
    ) -> Requirement:
        heaviest = max((costing.cost(item) for item in frames), key=lambda cost: cost.frame.value)
        stage = heaviest_stage(heaviest)
        return Requirement(name, mode, statistic, time_ms, budget_ns / 1e6, stage, clock, sought)

    flown = [sky.lost for sky in skies]
    whole = [sky.lost.whole_counts for sky in skies]
    tracking = [item.counts for sky in skies for item in sky.tracked]
    found = []
    found.append(
        required(
            "lost in space, as flown",
            LOST_IN_SPACE,
            "worst of the skies",
            lost.flown.margin.time_ms.worst,
            [item.counts for item in flown],
            clock_as_flown(laws, flown, budget_s),
        )
    )
    found.append(
        required(
            "lost in space, search completed",
            LOST_IN_SPACE,
            "p99 of the skies",
            lost.whole.margin.time_ms.p99,
            whole,
            clock_for_frames(laws, whole, budget_s, p99),
        )
    )
    found.append(
        required(
            "tracking",
            TRACKING,
            "worst of the skies",
            tracked.flown.margin.time_ms.worst,
            tracking,
            clock_for_frames(laws, tracking, budget_s, np.max),
        )
    )
    for case in worst:
        if case.objective == OBJECTIVES[1]:
            continue  # without its limit no unit flies
        counts = case.objective.heaviest(costing, case.sample)[1]
        clock = (
            clock_as_flown(laws, [case.sample.lost], budget_s)
            if case.objective.mode == LOST_IN_SPACE
            else clock_for_frames(laws, [counts], budget_s)
        )
        found.append(
            required(
                f"worst frame found, {case.objective.title}",
                case.objective.mode,
                "worst found by search",
                costing.ms(case.cost.frame),
                [counts],
                clock,
                sought=True,
            )
        )
    return found


__all__ = [
    "FALSE_STARS",
    "FRAMES_LOST",
    "RATE",
    "WINDOWS",
    "Assessment",
    "Order",
    "StopRow",
    "assess",
    "stop_rows",
]
