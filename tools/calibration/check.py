"""Whether the committed figures are those of the sources as they are: `tools/calibrate_cycles --check`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from st_emulator.firmware_model.work import COUNTS
from tools.calibration.compiler import Build, Compiler
from tools.calibration.document import SampleSet, predictor
from tools.calibration.validation import (
    FRAME_LIMIT,
    STAGE_LIMIT,
    StageError,
    frame_errors,
    stage_errors,
)

__all__ = ["MISSING_COMPILER", "OTHER_COMPILER_LIMIT", "Finding", "check", "check_document", "check_hashes"]

MISSING_COMPILER: Final = (
    "There is no cross compiler for ARM926EJ-S here, so the committed figures cannot be checked; they serve "
    "as they are. On Debian, as root: apt-get install gcc-arm-linux-gnueabi libc6-dev-armel-cross"
)
# Another compiler makes other code: what is committed stands for the pinned one's, and this is how far
# another's may be off before the kernels themselves are to be suspected.
OTHER_COMPILER_LIMIT: Final = 0.30


@dataclass(frozen=True)
class Finding:
    """What a check found: whether all holds, and its lines to print, failures first."""

    failures: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)

    @property
    def holds(self) -> bool:
        return not self.failures

    def __add__(self, other: Finding) -> Finding:
        return Finding(
            self.failures + other.failures,
            self.notes + other.notes,
            {**self.figures, **other.figures},
        )


def check_document(document: Mapping[str, Any]) -> Finding:
    """Whether the document has every count of ``work.py`` and no other."""
    missing = sorted(COUNTS.keys() - document["counts"].keys())
    unknown = sorted(document["counts"].keys() - COUNTS.keys())
    failures = []
    if missing:
        failures.append(f"counts without figures: {', '.join(missing)}; run tools/calibrate_cycles")
    if unknown:
        failures.append(
            f"figures of counts that are no more: {', '.join(unknown)}; run tools/calibrate_cycles"
        )
    assumed = sorted(name for name, item in document["counts"].items() if item["evidence"] == "assumed")
    notes = [f"assumed: {name}: {document['counts'][name]['source']}" for name in assumed]
    return Finding(tuple(failures), tuple(notes))


def check_hashes(document: Mapping[str, Any], build: Build, compiler: Compiler) -> Finding:
    """Whether the build has the committed hashes. Of another compiler than the committed one: a note."""
    if compiler.version != document["compiler"]:
        return Finding(
            notes=(
                f"The compiler here is {compiler.version}, the figures are those of {document['compiler']}: "
                f"hashes are not compared, figures to {OTHER_COMPILER_LIMIT:.0%}.",
            )
        )
    committed, ours = dict(document["binaries"]), dict(build.sha256)
    changed = sorted(name for name in ours.keys() & committed.keys() if ours[name] != committed[name])
    added = sorted(ours.keys() - committed.keys())
    removed = sorted(committed.keys() - ours.keys())
    failures = []
    for what, names in (("changed", changed), ("new", added), ("gone", removed)):
        if names:
            failures.append(f"binaries {what} since the calibration: {', '.join(names)}")
    if list(build.flags) != list(document["flags"]):
        failures.append(f"flags changed since the calibration: {' '.join(build.flags)}")
    if failures:
        failures.append("the committed figures are of another program: run tools/calibrate_cycles")
    return Finding(tuple(failures), figures={"binaries": len(ours)})


def check_predictions(
    document: Mapping[str, Any], held_out: SampleSet, stage_limit: float, frame_limit: float
) -> Finding:
    """Whether the figures predict the simulation of frames that the fit never saw, each stage and frame."""
    predict = predictor(document)
    stages = stage_errors(held_out.samples, predict)
    frames = frame_errors(held_out.samples, predict, held_out.left_out)
    failures = [
        *(_failure(item, stage_limit) for item in stages if abs(item.error) > stage_limit),
        *(_failure(item, frame_limit) for item in frames if abs(item.error) > frame_limit),
    ]
    figures = {
        "frames": len(frames),
        "worst_stage": max((abs(item.error) for item in stages), default=None),
        "worst_frame": max((abs(item.error) for item in frames), default=None),
    }
    return Finding(tuple(failures), figures=figures)


def _failure(item: StageError, limit: float) -> str:
    return (
        f"sequence {item.sequence}, frame {item.frame} ({item.kind}), {item.stage}: predicted "
        f"{item.predicted:.0f} cycles, simulated {item.simulated:.0f}: {item.error:+.1%}, "
        f"{limit:.0%} is allowed"
    )


def check(
    document: Mapping[str, Any],
    compiler: Compiler | None,
    make: Callable[[], Build],
    held_out: Callable[[Build], SampleSet],
) -> Finding | None:
    """All of it: document, hashes, predictions. None: there is no compiler, so that nothing can be said.

    make: builds the kernels; held_out: simulates held out frames with the build.
    """
    if compiler is None:
        return None
    found = check_document(document)
    if not found.holds:
        return found
    build = make()
    found += check_hashes(document, build, compiler)
    same = compiler.version == document["compiler"]
    limits: Sequence[float] = (STAGE_LIMIT, FRAME_LIMIT) if same else (OTHER_COMPILER_LIMIT,) * 2
    return found + check_predictions(document, held_out(build), *limits)
