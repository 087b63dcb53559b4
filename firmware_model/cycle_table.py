"""What one of each count costs on a processor, and how that is known: the tables of ``cycle_costs/``.

The file is what ``tools/calibrate_cycles`` writes: core cycles of one of each count, with all accesses in the
caches, and line fills, accesses and their uncertainty apart, so that clock, cache and memory may be changed.
A user's own table may give ``memory_cycles`` at its clock instead of line fills, for any cache.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, Final

from .work import COUNTS

__all__ = [
    "EVIDENCE",
    "LINE_FILLS",
    "Coefficient",
    "CycleTable",
    "MemoryTiming",
    "ProcessorProfileError",
    "load_table",
]

EVIDENCE: Final = ("calibrated", "trial", "derived", "assumed")  # best first; README.md says what each means
LINE_FILLS: Final = ("low", "nominal", "high")
NO_CACHE_KIB: Final = 0


class ProcessorProfileError(ValueError):
    """A processor profile that cannot be used; the message names file, key and what is allowed."""


@dataclass(frozen=True, slots=True)
class MemoryTiming:
    """Times of the memory, which keeps its clock whatever the processor's: of a cache line's fill and of a
    single access past the caches, each low, nominal and high, in ns.

    Line fill: 24, 48 and 72 cycles at 400 MHz, derived from a 133 MHz bus, not measured. ASSUMED: a single
    access takes 40, 75 and 120 ns, the time to the first word of a burst.
    """

    line_fill_ns: Mapping[str, float] = field(
        default_factory=lambda: {"low": 60.0, "nominal": 120.0, "high": 180.0}
    )
    access_ns: Mapping[str, float] = field(
        default_factory=lambda: {"low": 40.0, "nominal": 75.0, "high": 120.0}
    )


@dataclass(frozen=True, slots=True)
class Coefficient:
    """What one of a count costs, and how that is known.

    core_cycles: with all accesses in the caches; core_sigma: its uncertainty, 1 sigma.
    line_fills: cache lines read from memory, by the size of the caches in KiB (each of the two);
    line_fills_sigma: their uncertainty. accesses: instruction fetches and data accesses, what counts without
    caches; None: not known.
    """

    core_cycles: float
    line_fills: Mapping[int, float]
    evidence: str  # one of EVIDENCE
    source: str
    core_sigma: float = 0.0
    line_fills_sigma: Mapping[int, float] = field(default_factory=dict)
    accesses: float | None = None


@dataclass(frozen=True)
class CycleTable:
    """One file of ``cycle_costs/``: a core at a clock, its memory, and a coefficient for each count.

    core_uncertainty: share of the core cycles that the model of the core may be wrong by.
    accuracy: what may be said of the figures, one sentence.
    Raises ProcessorProfileError unless there is exactly one coefficient for each count of ``work.COUNTS``.
    """

    name: str
    clock_hz: int
    coefficients: Mapping[str, Coefficient]
    memory: MemoryTiming = field(default_factory=MemoryTiming)
    core_uncertainty: float = 0.0
    accuracy: str = ""

    def __post_init__(self) -> None:
        who = self.name or "processor"
        if self.clock_hz < 1:
            raise ProcessorProfileError(f"{who}: clock_hz must be 1 or more, not {self.clock_hz}")
        missing = sorted(COUNTS.keys() - self.coefficients.keys())
        unknown = sorted(self.coefficients.keys() - COUNTS.keys())
        if missing or unknown:
            raise ProcessorProfileError(
                f"{who}: counts without a coefficient: {', '.join(missing) or 'none'}; "
                f"coefficients of unknown counts: {', '.join(unknown) or 'none'}"
            )
        for count, c in self.coefficients.items():
            figures = [c.core_cycles, c.core_sigma, *c.line_fills.values(), *c.line_fills_sigma.values()]
            figures.append(c.accesses or 0.0)
            if not all(0.0 <= figure < 1e9 for figure in figures):
                raise ProcessorProfileError(f"{who}: {count}: every figure must be 0 to 1e9")
            if c.evidence not in EVIDENCE:
                raise ProcessorProfileError(
                    f"{who}: {count}: evidence {c.evidence!r} is none of {', '.join(EVIDENCE)}"
                )
        if not 0.0 <= self.core_uncertainty < 1.0:
            raise ProcessorProfileError(f"{who}: model_uncertainty.core must be 0 to 1")
        for what, times in (("line_fill_ns", self.memory.line_fill_ns), ("access_ns", self.memory.access_ns)):
            values = [times.get(level, -1.0) for level in LINE_FILLS]
            if values != sorted(values) or not all(0.0 <= value < 1e6 for value in values):
                raise ProcessorProfileError(
                    f"{who}: memory.{what} must have low, nominal and high, ascending, 0 to 1e6 ns"
                )

    @property
    def caches_kib(self) -> tuple[int, ...]:
        """Sizes of the caches that every coefficient has figures for, largest first; 0: without caches."""
        sizes = set.intersection(*(set(c.line_fills) for c in self.coefficients.values()))
        if all(c.accesses is not None for c in self.coefficients.values()):
            sizes.add(NO_CACHE_KIB)
        return tuple(sorted(sizes, reverse=True))


# Sizes that a user's own table, which has memory cycles alone, is good for
ANY_CACHE_KIB: Final = (32, 16, 8, 4)


def load_table(source: str | Path) -> CycleTable:
    """A table by the name of one of ours (``arm926ej_s``) or from a JSON file.

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


def _from_document(document: Any, where: str) -> CycleTable:
    if not isinstance(document, dict) or not isinstance(document.get("counts"), dict):
        raise ProcessorProfileError(f"{where}: key 'counts' must be a table of coefficients")
    clock_hz = document.get("clock_hz")
    if not isinstance(clock_hz, int) or isinstance(clock_hz, bool) or clock_hz < 1:
        raise ProcessorProfileError(f"{where}: key 'clock_hz' must be a whole number of Hz, 1 or more")
    memory = MemoryTiming()
    try:
        if "memory" in document:
            line_fill_ns, access_ns = (
                {str(k): float(v) for k, v in document["memory"][key].items()}
                for key in ("line_fill_ns", "access_ns")
            )
            memory = MemoryTiming(line_fill_ns, access_ns)
        core_uncertainty = float(document.get("model_uncertainty", {}).get("core", 0.0))
    except (AttributeError, TypeError, KeyError, ValueError) as error:
        raise ProcessorProfileError(
            f"{where}: memory needs line_fill_ns and access_ns, each with low, nominal and high; "
            "model_uncertainty needs core, a share"
        ) from error
    nominal_cycles = memory.line_fill_ns.get("nominal", math.nan) * 1e-9 * clock_hz
    coefficients = {}
    for name, entry in document["counts"].items():
        try:
            coefficients[name] = _coefficient(entry, nominal_cycles)
        except (AttributeError, TypeError, KeyError, ValueError) as error:
            raise ProcessorProfileError(
                f"{where}: counts.{name}: core_cycles, line_fills by cache size (or memory_cycles), evidence "
                "and source are needed"
            ) from error
    name, accuracy = str(document.get("name", where)), str(document.get("accuracy", ""))
    try:
        return CycleTable(name, clock_hz, coefficients, memory, core_uncertainty, accuracy)
    except ProcessorProfileError as error:
        raise ProcessorProfileError(f"{where}: {error}") from error


def _coefficient(entry: dict[str, Any], nominal_fill_cycles: float) -> Coefficient:
    if "line_fills" in entry:
        fills = {int(size): float(value) for size, value in entry["line_fills"].items()}
    else:
        fills = dict.fromkeys(ANY_CACHE_KIB, float(entry["memory_cycles"]) / nominal_fill_cycles)
    accesses = entry.get("accesses")
    return Coefficient(
        float(entry["core_cycles"]),
        fills,
        str(entry["evidence"]),
        str(entry["source"]),
        float(entry.get("core_sigma", 0.0)),
        {int(size): float(value) for size, value in entry.get("line_fills_sigma", {}).items()},
        None if accesses is None else float(accesses),
    )
