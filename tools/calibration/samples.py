"""What the simulation of one step gave: counts of work beside cycles, fills, accesses, instructions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from tools.calibration.steps.step import StageRun

__all__ = [
    "CACHES_KIB",
    "CYCLES_PER_FILL",
    "TARGETS",
    "Sample",
    "class_totals",
    "fills_target",
    "frames_of",
    "sample_of",
    "total_cycles",
]

CACHES_KIB: Final = (32, 16, 8, 4)  # of each of the two caches; all are simulated in one run
CYCLES_PER_FILL: Final = 48.0  # nominal, 120 ns at 400 MHz: what fills and cycles are weighed with


def fills_target(kib: int) -> str:
    """The target's name of the line fills with caches of this size."""
    return f"line_fills_{kib}"


# What coefficients are fitted to, each by itself.
TARGETS: Final = ("core_cycles", "instructions", "accesses", *(fills_target(kib) for kib in CACHES_KIB))


@dataclass(frozen=True)
class Sample:
    """One stage's run in one step of one frame.

    sequence: number of the sequence of frames; frame: of the frame in it; kind: its search, or the step's
    name where it belongs to no frame.
    counts: (name, number) of the work, zeros left out. values: one for each of ``TARGETS``, in order.
    classes: (class of instruction, how many).
    """

    sequence: int
    frame: int
    kind: str
    step: str
    stage: str
    counts: tuple[tuple[str, int], ...]
    values: tuple[int, ...]
    classes: tuple[tuple[str, int], ...] = ()

    def value(self, target: str) -> int:
        """What the simulation gave for one of ``TARGETS``."""
        return self.values[TARGETS.index(target)]


def sample_of(run: StageRun, sequence: int, frame: int, kind: str) -> Sample:
    """The sample of a stage's run."""
    cost = run.cost
    values = {
        "core_cycles": cost.core_cycles,
        "instructions": cost.instructions,
        "accesses": cost.fetches + cost.data_accesses,
    }
    values.update({fills_target(kib): cost.line_fills(kib) for kib in CACHES_KIB})
    return Sample(
        sequence,
        frame,
        kind,
        run.step,
        run.stage,
        tuple(sorted((name, int(number)) for name, number in run.work.counts.items() if number)),
        tuple(int(values[target]) for target in TARGETS),
        tuple(sorted((name, int(number)) for name, number in cost.class_counts.items() if number)),
    )


def total_cycles(values: Mapping[str, float], kib: int = CACHES_KIB[0]) -> float:
    """Core and memory cycles with caches of this size and the nominal line fill."""
    return values["core_cycles"] + CYCLES_PER_FILL * values[fills_target(kib)]


def frames_of(samples: Iterable[Sample]) -> dict[tuple[int, int], list[Sample]]:
    """Samples by (sequence, frame), both in ascending order."""
    grouped: dict[tuple[int, int], list[Sample]] = {}
    for sample in samples:
        grouped.setdefault((sample.sequence, sample.frame), []).append(sample)
    return {key: grouped[key] for key in sorted(grouped)}


def class_totals(samples: Sequence[Sample]) -> dict[str, int]:
    """Instructions of each class over all samples."""
    totals: dict[str, int] = {}
    for sample in samples:
        for name, number in sample.classes:
            totals[name] = totals.get(name, 0) + number
    return dict(sorted(totals.items()))
