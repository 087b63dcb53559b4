"""From nothing to figures: kernels built, frames simulated on all cores, coefficients fitted."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from st_emulator.campaigns.results_file import ResultsFile, identity_hash
from st_emulator.campaigns.workers import Progress, Workers
from st_emulator.world.stars import cache_folder
from tools.calibration.compiler import Build
from tools.calibration.document import SampleSet
from tools.calibration.frames import FIT, TRACKED, sequences
from tools.calibration.registry import own_records
from tools.calibration.samples import Sample
from tools.calibration.simulation import Case, OwnSequence, Simulated, fingerprint, simulate

__all__ = ["CHECK_FRAMES", "FRAMES", "QUICK_FRAMES", "KernelError", "Plan", "simulate_set"]

FRAMES: Final = 360  # of the fit; a third as many are held out
QUICK_FRAMES: Final = 72
CHECK_FRAMES: Final = 24
HELD_OUT_SHARE: Final = 3
OWN_SEQUENCES: Final = 8  # of each family that makes records itself, in the fit
OWN_RECORDS: Final = 6  # in each of these


class KernelError(Exception):
    """Kernels that do not give what the Python stages give; the message has a line for each sequence."""


@dataclass(frozen=True)
class Plan:
    """How many frames are simulated, and by how many processes.

    fit_frames: of the fit; held_out_frames: of the others. restart: kept results are not used.
    """

    fit_frames: int = FRAMES
    held_out_frames: int = FRAMES // HELD_OUT_SHARE
    jobs: int | None = None
    restart: bool = False

    def cases(self, seed: int) -> list[Case]:
        """The sequences of the fit's set or of the held out one (``frames.FIT``, ``HELD_OUT``): the same
        ones each time.
        """
        fitted = seed == FIT
        skies = sequences(-(-(self.fit_frames if fitted else self.held_out_frames) // (TRACKED + 1)), seed)
        cases = [Case(number, sky) for number, sky in enumerate(skies)]
        for family in own_records():
            for number in range(OWN_SEQUENCES if fitted else -(-OWN_SEQUENCES // HELD_OUT_SHARE)):
                cases.append(Case(len(cases), own=OwnSequence(seed, number, family, OWN_RECORDS)))
        return cases


def simulate_set(build: Build, cases: Sequence[Case], plan: Plan, progress: Progress) -> SampleSet:
    """Run cases, those whose results were kept by an earlier run excepted.

    Raises KernelError naming the cases whose kernels gave other outputs than the Python stages.
    """
    identity = {
        "program": build.sha256[build.elf.name],
        "simulator": fingerprint(),
        "cases": [str(case) for case in cases],
    }
    folder = cache_folder() / "calibration"
    path = folder / f"{identity_hash(identity)}.jsonl"
    kept = ResultsFile(path, identity, named=False, fresh=plan.restart)
    _drop_old(folder, path)
    workers = Workers(plan.jobs, progress, results=kept)
    found = workers.map(partial(simulate, str(build.elf)), cases)
    return _joined(cases, found)


def _joined(cases: Sequence[Case], found: Sequence[Simulated]) -> SampleSet:
    samples: list[Sample] = []
    left_out: set[tuple[int, int]] = set()
    failures = [item.failure for item in found if item.failure]
    if failures:
        raise KernelError("\n".join([f"{len(failures)} of {len(found)} sequences failed", *failures]))
    for case, item in zip(cases, found, strict=True):
        samples += item.samples
        left_out |= {(case.number, frame) for frame in item.left_out}
    return SampleSet(tuple(samples), frozenset(left_out))


_MOST_KEPT: Final = 6


def _drop_old(folder: Path, current: Path) -> None:
    """Keep the results of the last few programs alone."""
    with contextlib.suppress(OSError):
        files = sorted(folder.glob("*.jsonl"), key=lambda path: path.stat().st_mtime)
        for path in files[:-_MOST_KEPT]:
            if path != current:
                path.unlink()
