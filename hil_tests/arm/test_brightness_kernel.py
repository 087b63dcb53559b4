"""The brightness-referenced identification in C: the Python stage's outcomes, and the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil_tests.arm.identification_runs import (
    SKIES,
    SceneMaker,
    compare_with_python,
    prediction_errors,
    reasons,
    right_and_wrong,
)
from hil_tests.arm.identification_scenes import SCENES, Scene, seen, sky, with_parameters
from st_emulator.firmware_model.identification.brightness_referenced import identify
from st_emulator.firmware_model.identification.interface import BrightnessParameters, Identification
from st_emulator.firmware_model.reasons import Reason
from st_emulator.firmware_model.work import Work
from tools.arm_timing.machine import ArmMachine
from tools.calibration.steps import identification as binding
from tools.calibration.steps.identification_others import place_brightness_parameters
from tools.calibration.struct_layout import layout_of, place_struct, read_struct, reserve_structs

MOST_PIVOTS = 1 << 30  # brightness_referenced.c: where the numbers start again


def with_brightness(scene: Scene, **changes: float) -> Scene:
    """The same with other parameters of this algorithm."""
    return with_parameters(scene, brightness=replace(BrightnessParameters(), **changes))


KINDS: dict[str, SceneMaker] = {
    **SCENES,
    # pivots of reference mode in nearly all images, not only where a very bright star is
    "reference stars": lambda name, seed: with_brightness(
        seen(name, seed, false=6, noise_px=0.15), bright_limit_mag=sky(name).limit_mag - 0.7
    ),
    # either spike may be the brighter star, but the pivot's is a reference star
    "reference stars, no order": lambda name, seed: with_brightness(
        seen(name, seed, stars=16, false=6), distinct_mag=20.0, bright_limit_mag=sky(name).limit_mag - 0.5
    ),
    "three, one for reference": lambda name, seed: with_brightness(
        seen(name, seed, stars=3), bright_limit_mag=sky(name).limit_mag
    ),
    "no order": lambda name, seed: with_brightness(seen(name, seed, false=6), distinct_mag=20.0),
    "all in order": lambda name, seed: with_brightness(seen(name, seed, false=6), distinct_mag=0.0),
    "wrong order": lambda name, seed: with_brightness(
        replace(
            (scene := seen(name, seed, stars=8)),
            spikes=replace(scene.spikes, b_vectors=scene.spikes.b_vectors[::-1].copy()),
            true_rows=scene.true_rows[::-1],
        ),
        distinct_mag=0.1,
    ),
    "many": lambda name, seed: with_parameters(seen(name, seed, stars=30, false=12), max_spots=64),
}


def third_sides(work: Work) -> int:
    return work["third_sides"]


@pytest.mark.parametrize("name", SKIES)
@pytest.mark.parametrize("kind", KINDS)
def test_the_outcome_is_that_of_the_python_stage(machine: ArmMachine, name: str, kind: str) -> None:
    """Reason, stars, numbers and attitude, whatever the image; the step compares and raises."""
    for seed in range(2):
        compare_with_python(machine, identify, KINDS[kind](name, seed), third_sides)


def test_the_scenes_end_in_every_way() -> None:
    """So that the comparison above has seen them all."""
    assert reasons(identify, KINDS, range(2)) == {
        Reason.NONE,
        Reason.UNCONFIRMED,
        Reason.NO_MATCH,
        Reason.TOO_FEW_STARS,
        Reason.AMBIGUOUS,
    }


@pytest.mark.parametrize("name", SKIES)
def test_the_stars_are_the_true_ones(machine: ArmMachine, name: str) -> None:
    right, wrong = right_and_wrong(machine, identify, name)
    assert right >= 8
    assert wrong == 0


def run_with(
    machine: ArmMachine, scene: Scene, marks: np.ndarray, entries: int, pivots: int
) -> tuple[int, Identification, int]:
    """(returned, found, number of the last pivot) with a mark table as another image left it."""
    tables, parameters = sky(scene.name).tables, scene.parameters
    bright_limit_mag = parameters.brightness.bright_limit_mag
    columns = dict(zip(("head", "pivot"), marks.T, strict=True))
    table = place_struct(
        machine,
        "st_brightness_marks",
        mark=machine.place(layout_of(machine, "st_brightness_mark").pack_array(len(marks), **columns)),
        entry=reserve_structs(machine, "st_brightness_entry", entries),
        entries=entries,
        pivots=pivots,
    )
    found, star_index = reserve_structs(machine, "st_identification"), machine.reserve(4 * len(scene.spikes))
    call = machine.call(
        "st_identify_brightness_referenced",
        binding.place_spikes(machine, scene.spikes),
        binding.place_star_table(machine, tables.catalogue),
        binding.place_pair_table(machine, tables.pairs),
        binding.place_pair_table(machine, tables.reference_pairs(bright_limit_mag)),
        binding.place_limits(machine, parameters, tables.pairs),
        place_brightness_parameters(machine, parameters),
        table,
        found,
        star_index,
    )
    identification = binding.read_identification(machine, found, star_index, len(scene.spikes))
    last = int(read_struct(machine, "st_brightness_marks", table)["pivots"])
    machine.release()
    return call.result, identification, last


@pytest.mark.parametrize("pivots", [0, 12_345, MOST_PIVOTS - 1, MOST_PIVOTS + 1])
def test_old_marks_change_nothing(machine: ArmMachine, pivots: int) -> None:
    """Marks of earlier images, up to where the numbers start again."""
    rng = np.random.default_rng(1)
    for seed, kind in enumerate(("stars", "mostly false", "nothing of the sky", "two skies")):
        scene = KINDS[kind]("wide", seed)
        stars = len(sky("wide").catalogue)
        marks = rng.integers(0, [1000, pivots + 1], (stars, 2), dtype=np.int32)
        expected, _ = identify(scene.spikes, sky("wide").tables, scene.parameters)
        done, found, last = run_with(machine, scene, marks, 100_000, pivots)
        binding.compare(found, expected)
        assert done == 1
        assert last < 1000 if pivots > MOST_PIVOTS else last > pivots


def test_a_table_that_is_too_small_is_told(machine: ArmMachine) -> None:
    """Nothing is found then, nothing is written beyond the table, and a larger one finds it."""
    scene = seen("wide", 4)
    marks = np.zeros((len(sky("wide").catalogue), 2), np.int32)
    done, found, _ = run_with(machine, scene, marks, 3, 0)
    assert (done, found.reason, found.verified) == (0, Reason.NO_MATCH, 0)
    assert (found.star_index == -1).all()
    done, found, _ = run_with(machine, scene, marks, 100_000, 0)
    assert (done, found.reason) == (1, Reason.NONE)


def test_the_cycles_follow_from_the_counts(machine: ArmMachine) -> None:
    """Coefficients of one set of images give the cycles of another within 10 %, line fills included."""
    errors = prediction_errors(machine, identify)
    assert len(errors) >= 14
    assert np.abs(errors).max() < 0.10
