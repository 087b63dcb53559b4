"""Cycles from work: the one place where counts become time.

A profile is a clock and a table of coefficients, core and memory cycles of one of each count, each with its
evidence. Those of ``cycle_costs/arm926ej_s_provisional.json`` are provisional: see its ``accuracy``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final

from .work import COUNTS, STAGES, Work

__all__ = [
    "EVIDENCE",
    "Coefficient",
    "CycleBudget",
    "CycleReport",
    "ProcessorProfile",
    "ProcessorProfileError",
]

EVIDENCE: Final = ("trial", "derived", "assumed")  # best first; the JSON file says what each means


class ProcessorProfileError(ValueError):
    """A processor profile that cannot be used; the message names file, key and what is allowed."""


@dataclass(frozen=True, slots=True)
class Coefficient:
    """What one of a count costs, and how that is known."""

    core_cycles: float  # with all memory accesses hitting the caches
    memory_cycles: float  # waiting for memory
    evidence: str  # one of EVIDENCE
    source: str


@dataclass(frozen=True, slots=True)
class CycleReport:
    """Cycles of a piece of work: every stage of ``work.STAGES``, in order, and their sum."""

    by_stage: dict[str, int]
    total: int


class ProcessorProfile:
    """A clock and coefficients: ``cycles(work)``, ``duration_ns(cycles)``.

    Raises ProcessorProfileError unless there is exactly one coefficient for each count of ``work.COUNTS``.
    """

    def __init__(self, clock_hz: int, coefficients: Mapping[str, Coefficient], name: str = "") -> None:
        who = name or "processor"
        if clock_hz < 1:
            raise ProcessorProfileError(f"{name}: clock_hz must be 1 or more, not {clock_hz}")
        missing = sorted(COUNTS.keys() - coefficients.keys())
        unknown = sorted(coefficients.keys() - COUNTS.keys())
        if missing or unknown:
            raise ProcessorProfileError(
                f"{who}: counts without a coefficient: {', '.join(missing) or 'none'}; "
                f"coefficients of unknown counts: {', '.join(unknown) or 'none'}"
            )
        for count, c in coefficients.items():
            if not (0.0 <= c.core_cycles < 1e9 and 0.0 <= c.memory_cycles < 1e9):
                raise ProcessorProfileError(f"{who}: {count}: cycles must be 0 to 1e9")
            if c.evidence not in EVIDENCE:
                raise ProcessorProfileError(
                    f"{who}: {count}: evidence {c.evidence!r} is none of {', '.join(EVIDENCE)}"
                )
        self.name = name
        self.clock_hz = int(clock_hz)
        self.coefficients = dict(coefficients)
        self._cost = {n: (COUNTS[n].stage, c.core_cycles + c.memory_cycles) for n, c in coefficients.items()}

    def with_clock(self, clock_hz: int) -> ProcessorProfile:
        """The same processor at another clock.

        ASSUMED: memory cycles stay as they are; with the memory's own clock unchanged they would scale.
        """
        return ProcessorProfile(clock_hz, self.coefficients, self.name)

    def costs(self, counts: Sequence[str]) -> tuple[float, ...]:
        """Cycles of one of each of these counts."""
        return tuple(self._cost[name][1] for name in counts)

    def cycles(self, work: Work) -> CycleReport:
        """Cycles of ``work``, rounded to whole cycles stage by stage; ``total`` is the sum of the stages."""
        exact = dict.fromkeys(STAGES, 0.0)
        cost = self._cost
        for name, number in work.counts.items():
            stage, each = cost[name]
            exact[stage] += number * each
        by_stage = {stage: round(value) for stage, value in exact.items()}
        return CycleReport(by_stage, sum(by_stage.values()))

    def duration_ns(self, cycles: int) -> int:
        """Time that ``cycles`` take, whole nanoseconds, rounded up."""
        return -(-cycles * 1_000_000_000 // self.clock_hz)

    @staticmethod
    def load(source: str | Path) -> ProcessorProfile:
        """A profile by the name of one of ours (``arm926ej_s_provisional``) or from a JSON file.

        Raises ProcessorProfileError naming file, key and what is allowed.
        """
        if isinstance(source, Path) or "/" in source or source.endswith(".json"):
            path = Path(source)
            try:
                text = path.read_text(encoding="utf-8")
            except (OSError, UnicodeDecodeError) as error:
                raise ProcessorProfileError(f"{path}: cannot be read: {error}") from error
            where = str(path)
        else:
            folder = resources.files(__package__) / "cycle_costs"
            file = folder / f"{source}.json"
            if not file.is_file():
                ours = sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".json"))
                raise ProcessorProfileError(f"processor {source!r}: not one of {', '.join(ours)}")
            text = file.read_text(encoding="utf-8")
            where = f"{source}.json"
        try:
            document = json.loads(text)
        except json.JSONDecodeError as error:
            raise ProcessorProfileError(f"{where}: line {error.lineno}: {error.msg}") from error
        return _from_document(document, where)


@dataclass(frozen=True)
class CycleBudget:
    """What a frame may take on its processor before it is late: `cycles` from its read-out on."""

    processor: ProcessorProfile
    cycles: int

    def for_search(self, spent: Work) -> float:
        """Cycles that a search may use after the work spent on the frame so far.

        ASSUMED: a tenth of the budget is kept for what follows (attitude, telemetry) and for the search's
        last step; half of it is given in any case, so that a unit whose detection leaves less than that can
        acquire at all: such a frame may be late, which telemetry tells.
        """
        left = 0.9 * self.cycles - self.processor.cycles(spent).total
        return max(left, 0.5 * self.cycles)


def _from_document(document: Any, where: str) -> ProcessorProfile:
    if not isinstance(document, dict) or not isinstance(document.get("counts"), dict):
        raise ProcessorProfileError(f"{where}: key 'counts' must be a table of coefficients")
    clock_hz = document.get("clock_hz")
    if not isinstance(clock_hz, int) or isinstance(clock_hz, bool):
        raise ProcessorProfileError(f"{where}: key 'clock_hz' must be a whole number of Hz")
    coefficients = {}
    for name, entry in document["counts"].items():
        try:
            coefficients[name] = Coefficient(
                float(entry["core_cycles"]),
                float(entry["memory_cycles"]),
                str(entry["evidence"]),
                str(entry["source"]),
            )
        except (TypeError, KeyError, ValueError) as error:
            raise ProcessorProfileError(
                f"{where}: counts.{name}: core_cycles, memory_cycles (numbers), evidence, source are needed"
            ) from error
    try:
        return ProcessorProfile(clock_hz, coefficients, str(document.get("name", where)))
    except ProcessorProfileError as error:
        raise ProcessorProfileError(f"{where}: {error}") from error
