"""What the tests of identification kernels do alike: scenes run on the ARM, and cycles predicted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from hil_tests.arm.identification_scenes import SCENES, Scene, sky
from st_emulator.firmware_model.identification.interface import Identification, IdentificationAlgorithm
from st_emulator.firmware_model.reasons import Reason
from tools.arm_timing.machine import ArmMachine
from tools.calibration.steps import identification_others
from tools.calibration.steps.identification import KERNELS, IdentifyStep, unlimited
from tools.calibration.steps.step import StageRun

SKIES = ("narrow", "wide")
LINE_FILL_CYCLES = 48.0

SceneMaker = Callable[[str, int], Scene]

assert identification_others.KERNELS is KERNELS  # it has put its kernels there


def compare_with_python(machine: ArmMachine, algorithm: IdentificationAlgorithm, scene: Scene) -> None:
    """The scene's step on the ARM; MismatchError where Python finds anything else."""
    IdentifyStep().run(machine, scene.record(algorithm))


def identified(machine: ArmMachine, algorithm: IdentificationAlgorithm, scene: Scene) -> Identification:
    """What the kernel finds, whatever Python would."""
    try:
        tables, parameters = sky(scene.name).tables, unlimited(scene.parameters)
        return KERNELS[algorithm](machine, scene.spikes, tables, parameters).found
    finally:
        machine.release()


def reasons(
    algorithm: IdentificationAlgorithm, kinds: Mapping[str, SceneMaker], seeds: Sequence[int]
) -> set[Reason]:
    """How Python's searches of scenes end."""
    return {
        make(name, seed).record(algorithm).result.reason
        for make in kinds.values()
        for name in SKIES
        for seed in seeds
    }


def right_and_wrong(machine: ArmMachine, algorithm: IdentificationAlgorithm, name: str) -> tuple[int, int]:
    """Of 10 images with false stars: those with a valid attitude and no true star taken for another; others.

    Against what was drawn into the image, without the Python stage.
    """
    right = wrong = 0
    for seed in range(10):
        scene = SCENES["false stars"](name, 100 + seed)
        found = identified(machine, algorithm, scene)
        if found.reason == Reason.NONE:
            true = (found.star_index >= 0) & (scene.true_rows >= 0)
            same = np.array_equal(found.star_index[true], scene.true_rows[true]) and true.sum() >= 4
            right, wrong = right + same, wrong + (not same)
    return right, wrong


def prediction_errors(machine: ArmMachine, algorithm: IdentificationAlgorithm) -> NDArray[np.float64]:
    """Relative errors of the cycles of images, line fills included, by coefficients of other images.

    Non-negative least squares of relative errors, as the calibration's.
    """
    kinds = [kind for kind in SCENES if kind != "too few"]
    rows: dict[bool, list[dict[str, float]]] = {False: [], True: []}
    for held_out, samples in rows.items():
        for number, kind in enumerate(kinds * (2 if held_out else 3)):
            scene = SCENES[kind](SKIES[number % 2], 1000 * held_out + number)
            samples += [_per_cycle(run) for run in IdentifyStep().run(machine, scene.record(algorithm))]
    names = sorted({name for row in rows[False] for name in row})
    known, asked = (
        np.array([[row.get(name, 0.0) for name in names] for row in rows[held_out]]) for held_out in rows
    )
    scale = known.max(axis=0)
    coefficients, _ = nnls(known / scale, np.ones(len(known)))
    return np.asarray(asked / scale @ coefficients - 1.0)


def _per_cycle(run: StageRun) -> dict[str, float]:
    """Counts of a run over its cycles."""
    cycles = run.cost.core_cycles + run.cost.memory_cycles(LINE_FILL_CYCLES)
    return {name: number / cycles for name, number in run.work.counts.items()}
