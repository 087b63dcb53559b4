"""Sequences of frames through the kernels on the simulated processor: samples for the fit."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import st_emulator
from tools.arm_timing.errors import ArmError
from tools.arm_timing.machine import ArmMachine
from tools.calibration.frames import IDENTIFY, FrameRecords, SkySequence, records_of
from tools.calibration.registry import own_records, steps_by_name
from tools.calibration.samples import Sample, sample_of
from tools.calibration.steps.step import MismatchError

__all__ = ["Case", "OwnSequence", "Simulated", "fingerprint", "simulate"]


_BINDING_MODULES = ("frames", "registry", "samples", "simulation", "struct_layout")


@dataclass(frozen=True)
class OwnSequence:
    """Records that a family of kernels makes itself, as no frame has them."""

    seed: int
    number: int
    family: str
    records: int

    def __str__(self) -> str:
        return f"{self.family}, {self.records} records, {self.number} of {self.seed}"


@dataclass(frozen=True)
class Case:
    """One sequence and its number among all of its set."""

    number: int
    sky: SkySequence | None = None
    own: OwnSequence | None = None


@dataclass(frozen=True)
class Simulated:
    """samples: of one case; left_out: frames without their identification, which took too long.

    failure: why the case was not gone on with: a kernel's output is wrong, or it cannot be run.
    """

    samples: tuple[Sample, ...]
    left_out: tuple[int, ...] = ()
    failure: str = ""


def _frames_of_case(case: Case) -> list[FrameRecords]:
    """What a case runs, in order."""
    if case.sky is not None:
        return list(records_of(case.sky))
    assert case.own is not None
    made = own_records()[case.own.family](case.own.seed * 1000 + case.own.number, case.own.records)
    return [FrameRecords(number, record.step, (record,)) for number, record in enumerate(made)]


def simulate(elf: str, case: Case) -> Simulated:
    """Run a case on a processor of its own: it depends on no other case.

    The steps run in their order, so that each finds the caches as the one before left them; before the first
    frame its last one is run, so that a frame lost in space finds what tracking left, not empty caches.
    """
    steps = steps_by_name()
    machine = ArmMachine(Path(elf))
    samples: list[Sample] = []
    frames = _frames_of_case(case)
    before = [frame for frame in frames if frame.kind != IDENTIFY][-1:]
    for place, frame in enumerate([*before, *frames]):
        for record in frame.steps:
            if frame.kind == IDENTIFY:
                machine.flush_caches()  # as after a full frame's pixels
            try:
                runs = steps[record.step].run(machine, record)
            except (MismatchError, ArmError) as error:
                where = f"{case.sky or case.own}, frame {frame.frame}, step {record.step}"
                return Simulated((), (), f"{where}: {type(error).__name__}: {error}")
            if place >= len(before):
                samples += [sample_of(run, case.number, frame.frame, frame.kind) for run in runs]
    return Simulated(tuple(samples), tuple(frame.frame for frame in frames if frame.left_out))


@lru_cache
def fingerprint() -> str:
    """Hash of all that samples follow from but the kernels: units, firmware, world, simulator, bindings.

    The cycle costs are not among it: no frame of the calibration depends on them.
    """
    package = Path(st_emulator.__file__).parent
    here = Path(__file__).parent
    rooms: Sequence[Path] = (
        package,
        package / "protocol",
        package / "firmware_model",
        here.parent / "arm_timing",
    )
    files = {path.resolve() for room in rooms for kind in ("*.py", "*.toml") for path in room.rglob(kind)}
    files |= {here / f"{name}.py" for name in _BINDING_MODULES}
    files |= set((here / "steps").glob("*.py"))
    digest = hashlib.sha256()
    for contents in sorted(hashlib.sha256(path.read_bytes()).digest() for path in files):
        digest.update(contents)
    return digest.hexdigest()[:16]
