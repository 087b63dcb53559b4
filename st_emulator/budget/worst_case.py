"""The search for the worst frame: from the heaviest frames that chance has found, further by mutation.

Several islands, each an evolution of its own with a fixed number of frames and a seed, so that the outcome
depends neither on how many processes there are nor on which ends first.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np

from ..bench.scenario import Scenario
from ..campaigns.workers import Workers
from ..units.profile import UnitProfile
from .figures import Cost, Costing, Figure
from .modes import LOST_IN_SPACE, TRACKING
from .mutation import Domain, domain_of, mutated
from .samples import Counts, Instant, Look, SkySample, look
from .scenes import Conditions
from .subject import Parameters, Subject

AS_FLOWN = "as flown"
WITHOUT_LIMIT = "search without limit"
ISLANDS = 4  # of each objective
PARENTS = 4
Place = Conditions | Instant


@dataclass(frozen=True)
class Objective:
    """What is made as large as can be: the cycles of a frame in a mode, as flown or without limit."""

    mode: str
    search: str

    @property
    def title(self) -> str:
        return self.mode if self.mode == TRACKING else f"{self.mode}, {self.search}"

    def heaviest(self, costing: Costing, sample: SkySample) -> tuple[int, Counts]:
        """(number of the frame, counts) of a sky's heaviest frame; 0 is lost in space, 1 on are tracked."""
        if self.mode == LOST_IN_SPACE:
            return 0, sample.lost.counts if self.search == AS_FLOWN else sample.lost.whole_counts
        frames = [item.counts for item in sample.tracked]
        values = [costing.cost(counts).frame.value for counts in frames]
        place = int(np.argmax(values))
        return place + 1, frames[place]

    def value(self, costing: Costing, sample: SkySample) -> float:
        """Cycles of the heaviest frame at the nominal cost."""
        return costing.cost(self.heaviest(costing, sample)[1]).frame.value


OBJECTIVES = (
    Objective(LOST_IN_SPACE, AS_FLOWN),
    Objective(LOST_IN_SPACE, WITHOUT_LIMIT),
    Objective(TRACKING, AS_FLOWN),
)


@dataclass(frozen=True)
class Island:
    """One evolution: its objective (place in OBJECTIVES), number, how many frames it may try and where it
    starts, the heaviest first."""

    objective: int
    number: int
    evaluations: int
    seed: int
    starts: tuple[Place, ...]
    changed: Parameters


@dataclass(frozen=True)
class IslandOutcome:
    """What an evolution ended with: the place (as JSON holds it), its sample, skies tried, improvements."""

    objective: int
    place: str
    sample: SkySample
    evaluations: int
    improvements: int


@dataclass(frozen=True)
class WorstCase:
    """The heaviest frame found for an objective.

    frame: 0 lost in space, 1 on tracked. before: cycles of the heaviest of the frames that the search began
    with. evaluations: skies tried by the islands of this objective.
    """

    objective: Objective
    place: Place
    frame: int
    sample: SkySample
    cost: Cost
    before: Figure
    evaluations: int
    improvements: int

    def as_dict(self, changed: Parameters) -> dict[str, object]:
        return {
            "mode": self.objective.mode,
            "search": self.objective.search,
            "cycles": {row: figure.as_dict() for row, figure in self.cost.by_row.items()},
            "worst_before_search": self.before.as_dict(),
            "evaluations": self.evaluations,
            "improvements": self.improvements,
            "inputs": inputs_of(self.place, self.frame, changed),
        }


def evolve(profile: UnitProfile, scenario: Scenario | None, island: Island) -> IslandOutcome:
    """Run one island: each step changes a good one's place a little and keeps it where it is heavier."""
    subject, costing = _costing(profile.model_dump_json(), island.changed)
    objective = OBJECTIVES[island.objective]
    domain = domain_of(subject, objective.mode, scenario)
    rng = np.random.default_rng([island.seed, 0xE701, island.objective, island.number])

    def tried(place: Place) -> tuple[float, Place, SkySample]:
        sample = look(profile, scenario, Look(place, island.changed))
        return objective.value(costing, sample), place, sample

    kept = [tried(place) for place in island.starts[: min(PARENTS, island.evaluations)]]
    kept.sort(key=lambda item: -item[0])
    improvements = 0
    for _ in range(island.evaluations - len(kept)):
        parent = kept[int(len(kept) * rng.random() ** 2)]
        child = tried(mutated(rng, parent[1], domain))
        if child[0] > kept[-1][0]:
            improvements += child[0] > kept[0][0]
            kept[-1] = child
            kept.sort(key=lambda item: -item[0])
    _, place, sample = kept[0]
    return IslandOutcome(
        island.objective, place_to_json(place), sample, island.evaluations, int(improvements)
    )


@lru_cache(maxsize=4)
def _costing(profile_json: str, changed: Parameters) -> tuple[Subject, Costing]:
    subject = Subject(UnitProfile.model_validate_json(profile_json), changed)
    return subject, Costing(subject.processor)


def search(
    subject: Subject,
    scenario: Scenario | None,
    seen: Sequence[tuple[Look, SkySample]],
    evaluations: int,
    seed: int,
    workers: Workers,
) -> list[WorstCase]:
    """The heaviest frame of each objective, starting from what was seen already.

    evaluations: skies tried in all, shared evenly; at least one an island. What the search ends with is
    never lighter than what it starts with.
    """
    costing = Costing(subject.processor)
    islands = []
    before: dict[int, Figure] = {}
    each = max(1, evaluations // (len(OBJECTIVES) * ISLANDS))
    for place, objective in enumerate(OBJECTIVES):
        domain = domain_of(subject, objective.mode, scenario)
        usable = [
            (objective.value(costing, sample), number, case.place, sample)
            for number, (case, sample) in enumerate(seen)
            if case.changed == subject.changed and domain.holds(case.place)
        ]
        usable.sort(key=lambda item: (-item[0], item[1]))
        before[place] = costing.cost(objective.heaviest(costing, usable[0][3])[1]).frame
        for number in range(ISLANDS):
            starts = tuple(item[2] for item in usable[number : PARENTS * ISLANDS : ISLANDS])
            if starts:
                islands.append(Island(place, number, each, seed, starts, subject.changed))
    outcomes = workers.map(partial(evolve, subject.profile, scenario), islands)
    found = []
    for place, objective in enumerate(OBJECTIVES):
        own = [outcome for outcome in outcomes if outcome.objective == place]
        best = max(own, key=lambda outcome: objective.value(costing, outcome.sample))
        frame, counts = objective.heaviest(costing, best.sample)
        found.append(
            WorstCase(
                objective,
                place_from_json(best.place),
                frame,
                best.sample,
                costing.cost(counts),
                before[place],
                sum(outcome.evaluations for outcome in own),
                sum(outcome.improvements for outcome in own),
            )
        )
    return found


def domain_text(subject: Subject, scenario: Scenario | None) -> dict[str, str]:
    """What the search may change, by mode, in words."""
    return {mode: domain_of(subject, mode, scenario).text() for mode in (LOST_IN_SPACE, TRACKING)}


def place_to_json(place: Place) -> str:
    """A place as text; every bit of its numbers survives."""
    kind = "conditions" if isinstance(place, Conditions) else "instant"
    return json.dumps({kind: asdict(place)})


def place_from_json(text: str) -> Place:
    """The place that `place_to_json` wrote. ValueError, KeyError, TypeError: it is other text."""
    document: Mapping[str, Any] = json.loads(text)
    if "conditions" in document:
        fields = dict(document["conditions"])
        for name in ("attitude", "rate_deg_s", "false_star_magnitudes"):
            fields[name] = tuple(float(item) for item in fields[name])
        return Conditions(**fields)
    return Instant(**document["instant"])


def inputs_of(place: Place, frame: int, changed: Parameters) -> dict[str, Any]:
    """All that a frame follows from besides unit and scenario, so that it can be run again."""
    return {**json.loads(place_to_json(place)), "frame": frame, "parameters": dict(changed)}


__all__ = [
    "OBJECTIVES",
    "Domain",
    "Island",
    "Objective",
    "WorstCase",
    "domain_text",
    "evolve",
    "inputs_of",
    "place_from_json",
    "place_to_json",
    "search",
]
