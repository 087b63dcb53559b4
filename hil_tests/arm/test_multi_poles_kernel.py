"""Improved multi-poles in C: the Python stage's outcomes, and the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hil_tests.arm.identification_runs import (
    SKIES,
    SceneMaker,
    compare_with_python,
    prediction_errors,
    reasons,
    right_and_wrong,
)
from hil_tests.arm.identification_scenes import PARAMETERS, SCENES, Scene, seen, sky, with_parameters
from st_emulator.firmware_model.identification.interface import Identification, MultiPolesParameters, Spikes
from st_emulator.firmware_model.identification.multi_poles import identify
from st_emulator.firmware_model.reasons import Reason
from st_emulator.firmware_model.work import Work
from tools.arm_timing.machine import ArmMachine
from tools.calibration.steps import identification as binding
from tools.calibration.steps.identification_others import place_poles_parameters
from tools.calibration.struct_layout import layout_of, place_struct, read_struct, reserve_structs

MOST_NUMBERS = 1 << 30  # multi_poles.c: where the numbers start again


def with_poles(scene: Scene, **changes: float) -> Scene:
    """The same with other parameters of this algorithm."""
    return with_parameters(scene, multi_poles=replace(MultiPolesParameters(), **changes))


def unsorted(scene: Scene, seed: int, decimals: int = 1) -> Scene:
    """The same spikes in any order, some as bright as others: the algorithm sorts them itself."""
    order = np.random.default_rng(seed).permutation(len(scene.spikes))
    magnitudes = np.round(scene.spikes.magnitudes, decimals)
    spikes = Spikes(np.ascontiguousarray(scene.spikes.b_vectors[order]), magnitudes[order])
    return replace(scene, spikes=spikes, true_rows=scene.true_rows[order])


KINDS: dict[str, SceneMaker] = {
    **SCENES,
    "unsorted": lambda name, seed: unsorted(seen(name, seed, false=4), seed),
    "unsorted, mostly false": lambda name, seed: with_poles(
        unsorted(seen(name, seed, stars=6, false=24), seed, 0), magnitude_tolerance=1.2
    ),
    "unsorted, some unusable": lambda name, seed: unsorted(SCENES["unusable"](name, seed + 10), seed),
    "two skies, of three": lambda name, seed: with_poles(SCENES["two skies"](name, seed), least_recognised=3),
    "as bright as it may be": lambda name, seed: with_poles(seen(name, seed), magnitude_tolerance=20.0),
    # many partners for each neighbour: the one that fits best is it
    "many partners": lambda name, seed: with_poles(
        with_parameters(seen(name, seed, stars=12), tolerance_rad=10 * PARAMETERS[name].tolerance_rad),
        magnitude_tolerance=20.0,
    ),
    "hardly any fits": lambda name, seed: with_poles(seen(name, seed), magnitude_tolerance=0.1),
    "none fits": lambda name, seed: with_poles(seen(name, seed, stars=8), magnitude_tolerance=0.0),
}


def cosines(work: Work) -> int:
    """Of the pole and each neighbour."""
    return work["angles_computed"]


@pytest.mark.parametrize("name", SKIES)
@pytest.mark.parametrize("kind", KINDS)
def test_the_outcome_is_that_of_the_python_stage(machine: ArmMachine, name: str, kind: str) -> None:
    """Reason, stars, numbers and attitude, whatever the image; the step compares and raises."""
    for seed in range(2):
        compare_with_python(machine, identify, KINDS[kind](name, seed), cosines)


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


def keys(values: NDArray[np.float32]) -> NDArray[np.int32]:
    """Words that order as the values do."""
    words = values.view(np.int32)
    return np.where(words < 0, words ^ 0x7FFFFFFF, words).astype(np.int32)


def magnitude_keys(machine: ArmMachine, magnitude: float, tolerance: float) -> tuple[int, int]:
    brightest, dimmest = machine.reserve(4), machine.reserve(4)
    call = machine.call("st_magnitude_keys", magnitude, tolerance, brightest, dimmest)
    assert call.cost.instructions < 60_000  # by steps that double: never through all of them
    found = machine.read(brightest, np.int32, 1)[0], machine.read(dimmest, np.int32, 1)[0]
    machine.release()
    return int(found[0]), int(found[1])


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    st.one_of(st.floats(-2.0, 8.0), st.floats(allow_nan=False, allow_infinity=False)),
    st.one_of(st.sampled_from([0.0, 0.1, 0.7, 3.0]), st.floats(0.0, 30.0)),
)
@example(0.7, 0.7)  # next to 0 there are a thousand million values that round to the same difference
@example(-0.7, 0.7)
@example(0.0, 1e-300)
@example(1e300, 0.7)
@example(-1e300, 0.7)
@example(4.25, 0.5)
def test_the_magnitudes_that_pass(machine: ArmMachine, magnitude: float, tolerance: float) -> None:
    """Those whose key is in the range are those within the tolerance in double precision: about its ends."""
    brightest, dimmest = magnitude_keys(machine, magnitude, tolerance)
    with np.errstate(over="ignore"):
        ends = np.array([magnitude - tolerance, magnitude + tolerance, magnitude, 0.0, np.inf, -np.inf])
        ends = ends.astype(np.float32)
    around = np.concatenate([keys(ends), [brightest, dimmest]]).astype(np.int64)
    near = np.unique((around[:, np.newaxis] + np.arange(-4, 5)).ravel())
    words = np.where(near < 0, near ^ 0x7FFFFFFF, near)
    values = words.astype(np.uint64).astype(np.uint32).view(np.float32)
    near, values = near[~np.isnan(values)], values[~np.isnan(values)]
    passing = np.abs(values.astype(np.float64) - magnitude) < tolerance
    np.testing.assert_array_equal((near >= brightest) & (near <= dimmest), passing)


def run_with(
    machine: ArmMachine, scene: Scene, marks: np.ndarray, entries: int, base: int
) -> tuple[int, Identification, int]:
    """(returned, found, next number) with a mark table as another image left it."""
    tables, parameters = sky(scene.name).tables, scene.parameters
    spikes = len(scene.spikes)
    columns = dict(zip(("last_voter", "head", "votes"), marks.T, strict=True))
    table = place_struct(
        machine,
        "st_poles_marks",
        mark=machine.place(layout_of(machine, "st_poles_mark").pack_array(len(marks), **columns)),
        entry=reserve_structs(machine, "st_poles_entry", entries),
        entries=entries,
        base=base,
        sets=machine.reserve(4 * spikes**2),
    )
    found, star_index = reserve_structs(machine, "st_identification"), machine.reserve(4 * spikes)
    call = machine.call(
        "st_identify_multi_poles",
        binding.place_spikes(machine, scene.spikes),
        binding.place_star_table(machine, tables.catalogue),
        binding.place_pair_table(machine, tables.pairs),
        binding.place_limits(machine, parameters, tables.pairs),
        place_poles_parameters(machine, parameters),
        table,
        found,
        star_index,
    )
    identification = binding.read_identification(machine, found, star_index, spikes)
    following = int(read_struct(machine, "st_poles_marks", table)["base"])
    machine.release()
    return call.result, identification, following


@pytest.mark.parametrize("base", [1, 12_345, MOST_NUMBERS - 1, MOST_NUMBERS + 1])
def test_old_marks_change_nothing(machine: ArmMachine, base: int) -> None:
    """Marks of earlier images, up to where the numbers start again."""
    rng = np.random.default_rng(1)
    for seed, kind in enumerate(("stars", "mostly false", "nothing of the sky", "few")):
        scene = KINDS[kind]("wide", seed)
        stars = len(sky("wide").catalogue)
        marks = rng.integers(0, [base, 1000, 50], (stars, 3), dtype=np.int32)
        expected, _ = identify(scene.spikes, sky("wide").tables, scene.parameters)
        done, found, following = run_with(machine, scene, marks, 100_000, base)
        binding.compare(found, expected)
        assert done == 1
        assert following < 1 << 20 if base > MOST_NUMBERS else following > base


def test_a_table_that_is_too_small_is_told(machine: ArmMachine) -> None:
    """Nothing is found then, and a larger one finds it."""
    scene = seen("wide", 4)
    marks = np.zeros((len(sky("wide").catalogue), 3), np.int32)
    done, found, _ = run_with(machine, scene, marks, 20, 1)
    assert (done, found.reason, found.verified) == (0, Reason.NO_MATCH, 0)
    assert (found.star_index == -1).all()
    done, found, _ = run_with(machine, scene, marks, 100_000, 1)
    assert (done, found.reason) == (1, Reason.NONE)


def test_the_cycles_follow_from_the_counts(machine: ArmMachine) -> None:
    """Coefficients of one set of images give the cycles of another within 10 %, line fills included."""
    errors = prediction_errors(machine, identify)
    assert len(errors) >= 14
    assert np.abs(errors).max() < 0.10
