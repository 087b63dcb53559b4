"""Cycles from work: the one place where counts become time.

A processor is a table of coefficients (``cycle_table.py``) at a clock, with caches of a size and a memory
that fills a line of them in a low, nominal or high time. The clock of the processor does not change that of
the memory: the same fill takes more cycles of a faster processor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

from .cycle_table import (
    EVIDENCE,
    LINE_FILLS,
    NO_CACHE_KIB,
    Coefficient,
    CycleTable,
    MemoryTiming,
    ProcessorProfileError,
    load_table,
)
from .work import COUNTS, STAGES, Work

__all__ = [
    "EVIDENCE",
    "LINE_FILLS",
    "Coefficient",
    "CycleBudget",
    "CycleReport",
    "CycleTable",
    "MemoryTiming",
    "ProcessorProfile",
    "ProcessorProfileError",
]

NONE_SLOW: Final[Mapping[str, float]] = MappingProxyType({})
_SIGMAS = 2.0  # of the fit, in the bounds


@dataclass(frozen=True, slots=True)
class CycleReport:
    """Cycles of a piece of work: every stage of ``work.STAGES``, in order, and their sum."""

    by_stage: dict[str, int]
    total: int


class ProcessorProfile:
    """A processor: ``cycles(work)``, ``bounds(work)``, ``duration_ns(cycles)``.

    clock_hz: of the core; default: the table's. cache_kib: size of each of the two caches, one of
    ``table.caches_kib``, 0 for none; default: the largest. line_fill: one of ``LINE_FILLS``. slow_stages: how
    many times as long stages of ``work.STAGES`` take, where that is not once.
    Raises ProcessorProfileError naming what is allowed.
    """

    def __init__(
        self,
        table: CycleTable,
        clock_hz: int | None = None,
        cache_kib: int | None = None,
        line_fill: str = "nominal",
        slow_stages: Mapping[str, float] = NONE_SLOW,
    ) -> None:
        who = table.name or "processor"
        sizes = table.caches_kib
        self.table = table
        self.name = table.name
        self.clock_hz = table.clock_hz if clock_hz is None else int(clock_hz)
        self.cache_kib = max(sizes, default=-1) if cache_kib is None else int(cache_kib)
        self.line_fill = line_fill
        if self.clock_hz < 1:
            raise ProcessorProfileError(f"{who}: clock_hz must be 1 or more, not {clock_hz}")
        if self.cache_kib not in sizes:
            raise ProcessorProfileError(
                f"{who}: cache_kib {cache_kib}: none of {', '.join(map(str, sizes)) or 'nothing'}"
            )
        if line_fill not in LINE_FILLS:
            raise ProcessorProfileError(f"{who}: line_fill {line_fill!r}: none of {', '.join(LINE_FILLS)}")
        for stage, factor in slow_stages.items():
            if stage not in STAGES or not 0.0 < factor < math.inf:
                raise ProcessorProfileError(
                    f"{who}: {stage} taking {factor} times as long: allowed are stages "
                    f"{', '.join(STAGES)}, and factors over 0"
                )
        self.slow_stages = dict(slow_stages)
        self._cost = {name: (COUNTS[name].stage, sum(self._parts(name, line_fill))) for name in COUNTS}

    @property
    def coefficients(self) -> Mapping[str, Coefficient]:
        """One for each count."""
        return self.table.coefficients

    @property
    def line_fill_cycles(self) -> float:
        """Cycles of the core that a line fill takes."""
        return self.table.memory.line_fill_ns[self.line_fill] * 1e-9 * self.clock_hz

    @property
    def uncertainty(self) -> str:
        """How far off the figures may be, one sentence to print beside them."""
        fills = "/".join(
            f"{self.table.memory.line_fill_ns[level] * 1e-9 * self.clock_hz:.0f}" for level in LINE_FILLS
        )
        return (
            f"from the pinned program: core cycles +-{self.table.core_uncertainty:.0%}, line fill {fills} "
            "cycles (low/nominal/high, derived), not validated on hardware; a flight program of other "
            "authors: a factor of 2"
        )

    def _memory_cycles(self, name: str, line_fill: str) -> float:
        c, memory = self.table.coefficients[name], self.table.memory
        if self.cache_kib == NO_CACHE_KIB:
            assert c.accesses is not None
            return c.accesses * memory.access_ns[line_fill] * 1e-9 * self.clock_hz
        return c.line_fills[self.cache_kib] * memory.line_fill_ns[line_fill] * 1e-9 * self.clock_hz

    def _parts(self, name: str, line_fill: str) -> tuple[float, float]:
        longer = self._longer(name)
        return (
            self.table.coefficients[name].core_cycles * longer,
            self._memory_cycles(name, line_fill) * longer,
        )

    def _longer(self, name: str) -> float:
        return self.slow_stages.get(COUNTS[name].stage, 1.0)

    def with_clock(self, clock_hz: int) -> ProcessorProfile:
        """The same processor at another clock; the memory keeps its own."""
        return ProcessorProfile(self.table, clock_hz, self.cache_kib, self.line_fill, self.slow_stages)

    def with_cache(self, cache_kib: int) -> ProcessorProfile:
        """The same processor with other caches."""
        return ProcessorProfile(self.table, self.clock_hz, cache_kib, self.line_fill, self.slow_stages)

    def with_line_fill(self, line_fill: str) -> ProcessorProfile:
        """The same processor with a slower or faster memory."""
        return ProcessorProfile(self.table, self.clock_hz, self.cache_kib, line_fill, self.slow_stages)

    def with_slow_stage(self, stage: str, factor: float) -> ProcessorProfile:
        """The same processor, one stage taking ``factor`` times as long as it does on this one."""
        slow = self.slow_stages | {stage: self.slow_stages.get(stage, 1.0) * factor}
        return ProcessorProfile(self.table, self.clock_hz, self.cache_kib, self.line_fill, slow)

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
        return _report(exact)

    def parts(self, work: Work) -> dict[str, tuple[float, float]]:
        """Core and memory cycles of each count of ``work``."""
        return {
            name: (number * core, number * memory)
            for name, number in work.counts.items()
            for core, memory in (self._parts(name, self.line_fill),)
        }

    def bounds(self, work: Work) -> tuple[CycleReport, CycleReport]:
        """Least and most cycles of ``work``, stage by stage.

        Core cycles less or more by the model's uncertainty, memory at the low and the high line fill, and
        two sigma of the coefficients, taken as independent of one another. A count that is assumed has its
        own uncertainty in its sigma.
        """
        low, high = dict.fromkeys(STAGES, 0.0), dict.fromkeys(STAGES, 0.0)
        variance = dict.fromkeys(STAGES, 0.0)
        fill_cycles = self.table.memory.line_fill_ns["nominal"] * 1e-9 * self.clock_hz
        for name, number in work.counts.items():
            stage, c = COUNTS[name].stage, self.table.coefficients[name]
            times = number * self._longer(name)
            low[stage] += times * (
                c.core_cycles * (1.0 - self.table.core_uncertainty) + self._memory_cycles(name, "low")
            )
            high[stage] += times * (
                c.core_cycles * (1.0 + self.table.core_uncertainty) + self._memory_cycles(name, "high")
            )
            fills_sigma = c.line_fills_sigma.get(self.cache_kib, 0.0) * fill_cycles
            variance[stage] += times * times * (c.core_sigma**2 + fills_sigma**2)
        spread = {stage: _SIGMAS * math.sqrt(value) for stage, value in variance.items()}
        return (
            _report({stage: max(0.0, value - spread[stage]) for stage, value in low.items()}),
            _report({stage: value + spread[stage] for stage, value in high.items()}),
        )

    def duration_ns(self, cycles: int) -> int:
        """Time that ``cycles`` take, whole nanoseconds, rounded up."""
        return -(-cycles * 1_000_000_000 // self.clock_hz)

    @staticmethod
    def load(source: str | Path) -> ProcessorProfile:
        """A processor by the name of one of our tables (``arm926ej_s``) or from a JSON file, at its clock.

        Raises ProcessorProfileError naming file, key and what is allowed.
        """
        return ProcessorProfile(load_table(source))


def _report(exact: Mapping[str, float]) -> CycleReport:
    by_stage = {stage: round(value) for stage, value in exact.items()}
    return CycleReport(by_stage, sum(by_stage.values()))


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
