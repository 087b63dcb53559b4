"""What the calibration asks of the module of a family of kernels in this folder.

A module here has ``STEPS``, a tuple of ``Step``: one for each step of a frame that its kernels stand for.
Steps that no frame's trace has (telemetry) are fed by a function of the module, ``own_records(seed, n)``,
which gives ``n`` records of varied inputs, the same for the same seed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from st_emulator.firmware_model.frame_trace import StepRecord
    from st_emulator.firmware_model.work import Work
    from tools.arm_timing.machine import ArmMachine, Cost

__all__ = ["MismatchError", "OwnRecords", "StageRun", "Step"]


class MismatchError(AssertionError):
    """A kernel's output is not that of the Python stage: the message names step, output and both values."""


@dataclass(frozen=True)
class StageRun:
    """What one stage cost in one run of a step.

    step: the step's name in the frame's trace; stage: one of ``work.STAGES``.
    cost: of the calls of this stage's kernels alone.
    work: the counts of the step's work that this cost is of.
    """

    step: str
    stage: str
    cost: Cost
    work: Work


class Step(Protocol):
    """One step of a frame on the ARM: inputs into the machine's memory, kernels called, outputs compared."""

    name: str

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        """Run the step's kernels on the record's arguments; scratch memory is released again.

        Raises MismatchError where an output differs from ``record.result`` by more than the kernel's bound.
        """
        ...


OwnRecords = Callable[[int, int], "Sequence[StepRecord]"]
