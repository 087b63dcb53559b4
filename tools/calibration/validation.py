"""Predictions beside the simulation: errors per stage and per frame.

An error is (predicted - simulated) / simulated, of core and memory cycles together: caches of 32 KiB and the
nominal line fill unless another size is named. A stage that takes less than 0.1 ms has its error relative to
that: then it is the chance of the caches, some code being there or not, which no count can know.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from st_emulator.firmware_model.work import STAGES
from tools.calibration.frames import LOST_IN_SPACE, TRACKING
from tools.calibration.samples import CACHES_KIB, TARGETS, Sample, frames_of, total_cycles

__all__ = [
    "FRAME_LIMIT",
    "SHORT_CYCLES",
    "STAGE_LIMIT",
    "Errors",
    "StageError",
    "by_kind",
    "by_stage",
    "errors_by_cache",
    "errors_of",
    "frame_errors",
    "stage_errors",
    "within_limits",
]

STAGE_LIMIT: Final = 0.10
FRAME_LIMIT: Final = 0.05
SHORT_CYCLES: Final = 40_000.0  # 0.1 ms at 400 MHz, a 2500th of a frame's period

Predict = Callable[[Sample], Mapping[str, float]]


@dataclass(frozen=True)
class StageError:
    """One stage in one frame (stage "frame": all of it), cycles simulated and predicted."""

    sequence: int
    frame: int
    kind: str
    stage: str
    simulated: float
    predicted: float

    @property
    def error(self) -> float:
        return (self.predicted - self.simulated) / max(self.simulated, SHORT_CYCLES)


@dataclass(frozen=True)
class Errors:
    """Sizes of the errors of so many frames; bias: the median of the errors with their signs.

    short: so many of the frames take less than ``SHORT_CYCLES``.
    """

    frames: int
    median: float
    p95: float
    worst: float
    bias: float
    short: int = 0

    def as_dict(self) -> dict[str, Any]:
        """As the document has it, shares rounded to a ten-thousandth."""
        return {name: round(value, 4) for name, value in asdict(self).items()}


def stage_errors(samples: Iterable[Sample], predict: Predict, kib: int = CACHES_KIB[0]) -> list[StageError]:
    """Each stage of each frame: the runs that its steps had in it, added up."""
    found = []
    for (sequence, frame), own in frames_of(samples).items():
        sums: dict[str, list[float]] = {}
        for sample in own:
            simulated, predicted = _cycles(sample, predict, kib)
            both = sums.setdefault(sample.stage, [0.0, 0.0])
            both[0] += simulated
            both[1] += predicted
        found += [
            StageError(sequence, frame, own[0].kind, stage, *sums[stage]) for stage in STAGES if stage in sums
        ]
    return found


def frame_errors(
    samples: Iterable[Sample],
    predict: Predict,
    left_out: Iterable[tuple[int, int]] = (),
    kib: int = CACHES_KIB[0],
) -> list[StageError]:
    """Whole frames, lost in space and tracking; without those left out and records of no frame."""
    without = set(left_out)
    found = []
    for (sequence, frame), own in frames_of(samples).items():
        if own[0].kind not in (LOST_IN_SPACE, TRACKING) or (sequence, frame) in without:
            continue
        pairs = np.array([_cycles(sample, predict, kib) for sample in own])
        simulated, predicted = (float(value) for value in pairs.sum(axis=0))
        found.append(StageError(sequence, frame, own[0].kind, "frame", simulated, predicted))
    return found


def _cycles(sample: Sample, predict: Predict, kib: int) -> tuple[float, float]:
    simulated = total_cycles(dict(zip(TARGETS, sample.values, strict=True)), kib)
    return simulated, total_cycles(predict(sample), kib)


def errors_of(items: Sequence[StageError]) -> Errors:
    """Their distribution. ValueError: there are none."""
    if not items:
        raise ValueError("no frames")
    errors = np.array([item.error for item in items])
    sizes = np.abs(errors)
    return Errors(
        len(items),
        float(np.median(sizes)),
        float(np.percentile(sizes, 95)),
        float(sizes.max()),
        float(np.median(errors)),
        sum(item.simulated < SHORT_CYCLES for item in items),
    )


def by_stage(items: Iterable[StageError]) -> dict[str, Errors]:
    """Of each stage that there is, in the stages' order."""
    grouped: dict[str, list[StageError]] = {}
    for item in items:
        grouped.setdefault(item.stage, []).append(item)
    return {stage: errors_of(grouped[stage]) for stage in STAGES if stage in grouped}


def by_kind(items: Iterable[StageError]) -> dict[str, Errors]:
    """Of frames lost in space and of tracked ones."""
    grouped: dict[str, list[StageError]] = {}
    for item in items:
        grouped.setdefault(item.kind, []).append(item)
    return {kind: errors_of(grouped[kind]) for kind in (LOST_IN_SPACE, TRACKING) if kind in grouped}


def within_limits(document: Mapping[str, Any]) -> bool:
    """Whether the held out errors of a document are all within the limits, the worst ones."""
    stages = all(item["worst"] <= STAGE_LIMIT for item in document["held_out"].values())
    return stages and all(item["worst"] <= FRAME_LIMIT for item in document["frame_held_out"].values())


def errors_by_cache(samples: Sequence[Sample], predict: Predict) -> dict[int, dict[str, Errors]]:
    """Errors of each stage by the size of the caches."""
    return {kib: by_stage(stage_errors(samples, predict, kib)) for kib in CACHES_KIB}
