"""What the tests of identification kernels do alike: scenes run on the ARM, and cycles predicted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from unicorn import UC_HOOK_CODE
from unicorn.arm_const import UC_ARM_REG_LR

from hil_tests.arm.identification_scenes import SCENES, Scene, sky
from st_emulator.firmware_model.identification.interface import Identification, IdentificationAlgorithm
from st_emulator.firmware_model.reasons import Reason
from st_emulator.firmware_model.work import Work
from tools.arm_timing.machine import ArmMachine
from tools.calibration.steps import identification_others
from tools.calibration.steps.identification import KERNELS, IdentifyStep, unlimited
from tools.calibration.steps.step import StageRun

SKIES = ("narrow", "wide")
LINE_FILL_CYCLES = 48.0

SceneMaker = Callable[[str, int], Scene]

assert identification_others.KERNELS is KERNELS  # it has put its kernels there


# Functions that the kernels call as often as Python counts.
CALLS = {
    "st_range": "kvector_queries",
    "st_cosine_range": "angles_computed",
    "st_stars_in_cone": "cones_searched",
    "st_quaternion": "qmethod_solves",
}


@contextmanager
def calls_counted(machine: ArmMachine, symbols: Sequence[str]) -> Iterator[Counter[str]]:
    """How often the program calls each function; the scalar products of st_expected, never counted, apart."""
    calls: Counter[str] = Counter()
    engine = machine.engine

    def count(_engine: object, _address: int, _size: int, symbol: str) -> None:
        caller = machine.program.place_of(engine.reg_read(UC_ARM_REG_LR))
        calls[symbol] += "(st_expected+" not in caller or symbol != "st_dot"

    hooks = []
    for symbol in symbols:
        place = machine.symbols[symbol]
        hooks.append(engine.hook_add(UC_HOOK_CODE, count, symbol, place, place))
    engine.ctl_flush_tb()
    try:
        yield calls
    finally:
        for hook in hooks:
            engine.hook_del(hook)
        engine.ctl_flush_tb()


def compare_with_python(
    machine: ArmMachine, algorithm: IdentificationAlgorithm, scene: Scene, dots: Callable[[Work], int]
) -> None:
    """The scene's step on the ARM: the same outcome, and the same work on the way.

    MismatchError where Python finds anything else; AssertionError where it looks up, computes or solves more
    or less often. dots: scalar products that it computes outside of the final judgement, from its counts.
    """
    with calls_counted(machine, (*CALLS, "st_dot")) as calls:
        runs = IdentifyStep().run(machine, scene.record(algorithm))
    for run in runs:
        assert {symbol: calls[symbol] for symbol in CALLS} == {s: run.work[n] for s, n in CALLS.items()}
        assert calls["st_dot"] == dots(run.work)


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
        for number, kind in enumerate(kinds * (1 if held_out else 2)):
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
