"""What a budget looks at: random skies or a scenario's, and sweeps over what makes frames heavier."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from ..bench.scenario import Scenario
from .figures import Costing, Figure
from .margins import Margin
from .modes import LOST_IN_SPACE, TRACKING, LostResult, TrackedResult, both
from .samples import Instant, Look, SkySample
from .scenes import random_conditions
from .subject import Subject

SKIES = "skies"
FALSE_STARS = "false stars"
RATE = "angular rate"
WINDOWS = "window size"
FRAMES_LOST = "frames lost"
CROWDED = "false stars after lost frames"

MOST_FALSE_STARS = 500
MOST_RATE_DEG_S = 5.0
FALSE_STAR_COUNTS = (0, 5, 10, 20, 50, 100, 200, MOST_FALSE_STARS)
RATES_DEG_S = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, MOST_RATE_DEG_S)
WINDOW_RATES_DEG_S = (0.1, 0.25, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0)  # to the end of the parameter's range
SHARE_OF_SKIES = 5  # a point of a sweep has so much fewer skies than the random ones
FEWEST_SKIES = 20
REFINEMENTS = 5  # values looked at between the last that fits and the first that does not
SCENARIO_S = 60.0  # of a scenario that says no duration
HOLDS = 0.5  # tracking holds where at least this share of the frames has an attitude


@dataclass(frozen=True)
class SweepKind:
    """A sweep: its name, the unit of its values, what it means and the modes that it is of."""

    name: str
    unit: str
    meaning: str
    modes: tuple[str, ...] = (LOST_IN_SPACE, TRACKING)
    whole_values: bool = False


KINDS = {
    kind.name: kind
    for kind in (
        SweepKind(
            FALSE_STARS,
            "spots",
            "spots that are no stars, new ones each frame, 3 to 6 mag",
            whole_values=True,
        ),
        SweepKind(
            RATE, "deg/s", "the sky turns at this rate about a random axis; windows as the unit has them"
        ),
        SweepKind(
            WINDOWS,
            "deg/s",
            "parameter tracking_rate_deg_s, which makes the windows; the sky turns as fast, to 5 deg/s",
            (TRACKING,),
        ),
        SweepKind(
            FRAMES_LOST,
            "frames",
            "frames without attitude before a tracked one, which widen its windows",
            (TRACKING,),
            whole_values=True,
        ),
        SweepKind(
            CROWDED,
            "spots",
            "spots that are no stars in windows as wide as lost frames make them",
            (TRACKING,),
            whole_values=True,
        ),
    )
}


@dataclass(frozen=True)
class Point:
    """One value of a sweep and the skies looked at for it."""

    sweep: str
    value: float
    looks: tuple[Look, ...]


@dataclass(frozen=True)
class PointResult:
    """What the frames of a point took."""

    value: float
    lost: LostResult
    tracked: TrackedResult

    @property
    def holds(self) -> bool:
        """Whether tracking holds here."""
        return self.tracked.valid >= HOLDS * self.tracked.frames


@dataclass(frozen=True)
class Plan:
    """All that is looked at: the skies, and the points of the sweeps."""

    skies: tuple[Look, ...]
    points: tuple[Point, ...]

    @property
    def looks(self) -> list[Look]:
        """Skies first, then the points in their order."""
        return [*self.skies, *(look for point in self.points for look in point.looks)]

    def results(
        self, subject: Subject, costing: Costing, samples: Sequence[SkySample]
    ) -> dict[str, list[PointResult]]:
        """Of the samples of `looks`, the sweeps by name, values ascending."""
        found: dict[str, list[PointResult]] = {}
        at = len(self.skies)
        for point in self.points:
            skies = samples[at : at + len(point.looks)]
            at += len(point.looks)
            found.setdefault(point.sweep, []).append(PointResult(point.value, *both(subject, costing, skies)))
        return {name: sorted(points, key=lambda item: item.value) for name, points in found.items()}


def random_plan(subject: Subject, n: int, seed: int) -> Plan:
    """``n`` random skies at rest, and every sweep with fewer of the same skies in each point."""
    skies = random_conditions(n, seed)
    looks = tuple(Look(item, subject.changed) for item in skies)
    values: dict[str, Sequence[float]] = {
        FALSE_STARS: FALSE_STAR_COUNTS,
        RATE: RATES_DEG_S,
        WINDOWS: WINDOW_RATES_DEG_S,
        FRAMES_LOST: range(most_lost(subject) + 1),
        CROWDED: FALSE_STAR_COUNTS,
    }
    points = [
        random_point(subject, n, seed, sweep, value) for sweep, found in values.items() for value in found
    ]
    return Plan(looks, tuple(points))


def random_point(subject: Subject, n: int, seed: int, sweep: str, value: float) -> Point:
    """A point of a sweep over random skies."""
    fewer = max(FEWEST_SKIES, n // SHARE_OF_SKIES)
    changed = subject.changed
    if sweep == FALSE_STARS:
        skies = random_conditions(fewer, seed, false_stars=int(value))
    elif sweep == RATE:
        skies = random_conditions(fewer, seed, rate_deg_s=value)
    elif sweep == WINDOWS:
        skies = random_conditions(fewer, seed, rate_deg_s=min(value, MOST_RATE_DEG_S))
        changed = subject.with_parameters(tracking_rate_deg_s=value).changed
    elif sweep == FRAMES_LOST:
        skies = random_conditions(fewer, seed, frames_lost=int(value))
    else:
        skies = random_conditions(fewer, seed, false_stars=int(value), frames_lost=most_lost(subject))
    return Point(sweep, value, tuple(Look(item, changed) for item in skies))


def scenario_plan(subject: Subject, n: int, scenario: Scenario) -> Plan:
    """``n`` instants of the scenario, evenly over its duration, and those sweeps that leave its trajectory
    as it is."""
    instants = scenario_instants(subject, n, scenario)
    looks = tuple(Look(item, subject.changed) for item in instants)
    values: dict[str, Sequence[float]] = {
        FALSE_STARS: FALSE_STAR_COUNTS,
        WINDOWS: WINDOW_RATES_DEG_S,
        FRAMES_LOST: range(most_lost(subject) + 1),
        CROWDED: FALSE_STAR_COUNTS,
    }
    points = [
        scenario_point(subject, n, scenario, sweep, value)
        for sweep, found in values.items()
        for value in found
    ]
    return Plan(looks, tuple(points))


def scenario_point(subject: Subject, n: int, scenario: Scenario, sweep: str, value: float) -> Point:
    """A point of a sweep over a scenario."""
    instants = scenario_instants(subject, max(FEWEST_SKIES, n // SHARE_OF_SKIES), scenario)
    changed = subject.changed
    if sweep == FALSE_STARS:
        instants = [replace(item, false_stars=int(value)) for item in instants]
    elif sweep == WINDOWS:
        changed = subject.with_parameters(tracking_rate_deg_s=value).changed
    elif sweep == FRAMES_LOST:
        instants = [replace(item, frames_lost=int(value)) for item in instants]
    else:
        lost = most_lost(subject)
        instants = [replace(item, false_stars=int(value), frames_lost=lost) for item in instants]
    return Point(sweep, value, tuple(Look(item, changed) for item in instants))


def scenario_instants(subject: Subject, n: int, scenario: Scenario) -> list[Instant]:
    """Starts on the frame grid, evenly over the scenario; more than it has frames differ by their noise."""
    frames = scenario_frame_count(subject, scenario)
    found = []
    seen: Counter[int] = Counter()
    for number in range(n):
        frame = number * frames // n
        found.append(Instant(frame * subject.period_ns, seen[frame]))
        seen[frame] += 1
    return found


def scenario_frame_count(subject: Subject, scenario: Scenario) -> int:
    """Frames of the scenario's duration."""
    duration_s = scenario.duration_s if scenario.duration_s is not None else SCENARIO_S
    return max(1, int(duration_s * 1e9) // subject.period_ns)


def most_lost(subject: Subject) -> int:
    """Frames that tracking survives without attitude."""
    return int(subject.parameters["tracking_max_missed"])


@dataclass(frozen=True)
class Stop:
    """Where the 99th percentile of a sweep stops fitting: the last value that fits and the first that does
    not, at the nominal cost and at the bounds (None: none of that kind in the range). stage: what has grown
    most up to there."""

    fits_to: float | None
    stops_at: float | None
    stops_at_low_cost: float | None
    stops_at_high_cost: float | None
    stage: str | None

    def as_dict(self) -> dict[str, object]:
        return dict(self.__dict__)


def stop_of(points: Sequence[PointResult], cycles: str, mode: str) -> Stop:
    """cycles: "flown" or "whole" (of lost in space)."""

    def margin(point: PointResult) -> Margin:
        found = getattr(point.lost if mode == LOST_IN_SPACE else point.tracked, cycles)
        return found.margin  # type: ignore[no-any-return]

    def first(late: Callable[[Figure, float], bool]) -> PointResult | None:
        for point in points:
            found = margin(point)
            if late(found.time_ms.p99, found.budget_ms):
                return point
        return None

    nominal = first(lambda time, budget: time.value > budget)
    at_low = first(lambda time, budget: time.low > budget)
    at_high = first(lambda time, budget: time.high > budget)
    below = [point.value for point in points if nominal is None or point.value < nominal.value]
    return Stop(
        below[-1] if below else None,
        None if nominal is None else nominal.value,
        None if at_low is None else at_low.value,
        None if at_high is None else at_high.value,
        None if nominal is None else _grown(points[0], nominal, cycles, mode),
    )


def _grown(base: PointResult, point: PointResult, cycles: str, mode: str) -> str:
    """The stage whose 99th percentile has grown most; the heaviest where the first point is late already."""

    def rows(item: PointResult) -> dict[str, float]:
        found = getattr(item.lost if mode == LOST_IN_SPACE else item.tracked, cycles)
        return {name: row.p99.value for name, row in found.rows.items() if name != "frame"}

    now, then = rows(point), rows(base)
    if point is base:
        return max(now, key=lambda name: now[name])
    return max(now, key=lambda name: now[name] - then[name])


def refinements(stop: Stop, whole_values: bool) -> Iterator[float]:
    """Values between the last that fits and the first that does not, to look closer."""
    if stop.stops_at is None or stop.fits_to is None:
        return
    step = (stop.stops_at - stop.fits_to) / (REFINEMENTS + 1)
    seen = {stop.fits_to, stop.stops_at}
    for number in range(1, REFINEMENTS + 1):
        value = stop.fits_to + number * step
        value = float(round(value)) if whole_values else round(value, 2)
        if value not in seen:
            seen.add(value)
            yield value
