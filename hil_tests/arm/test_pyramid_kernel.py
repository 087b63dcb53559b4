"""The pyramid in C: the Python stage's identifications, and the truth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import nnls

from hil_tests.arm.identification_scenes import SCENES, Scene, seen, sky, with_parameters
from st_emulator.firmware_model.catalogue.pairs import build_pair_catalogue
from st_emulator.firmware_model.catalogue.star_catalogue import build_star_catalogue
from st_emulator.firmware_model.catalogue.tables import StarTables
from st_emulator.firmware_model.identification import pyramid
from st_emulator.firmware_model.identification.interface import Identification, Spikes
from st_emulator.firmware_model.reasons import Reason
from tools.arm_timing.machine import ArmMachine
from tools.calibration.steps import identification as binding
from tools.calibration.steps.identification import IdentifyStep, pyramid_kernel, unlimited
from tools.calibration.steps.step import MismatchError, StageRun
from tools.calibration.struct_layout import place_struct, read_struct, reserve_structs

LINE_FILL_CYCLES = 48.0


def run(machine: ArmMachine, scene: Scene) -> StageRun:
    (stage_run,) = IdentifyStep().run(machine, scene.record(pyramid.identify))
    return stage_run


@pytest.mark.parametrize("name", ["narrow", "wide"])
@pytest.mark.parametrize("kind", SCENES)
def test_the_outcome_is_that_of_the_python_stage(machine: ArmMachine, name: str, kind: str) -> None:
    """Reason, stars, numbers and attitude, whatever the image; the step compares and raises."""
    for seed in range(6):
        IdentifyStep().run(machine, SCENES[kind](name, seed).record(pyramid.identify))


def test_the_scenes_end_in_every_way(machine: ArmMachine) -> None:
    """So that the comparison above has seen them all; ambiguous ones are the rarest."""
    reasons = {
        SCENES[kind](name, seed).record(pyramid.identify).result.reason
        for name in ("narrow", "wide")
        for kind in SCENES
        for seed in range(6)
    }
    assert reasons == {
        Reason.NONE,
        Reason.UNCONFIRMED,
        Reason.NO_MATCH,
        Reason.TOO_FEW_STARS,
        Reason.AMBIGUOUS,
    }


@pytest.mark.parametrize("name", ["narrow", "wide"])
def test_the_stars_are_the_true_ones(machine: ArmMachine, name: str) -> None:
    """Against what was drawn into the image, without the Python stage."""
    right = 0
    for seed in range(20):
        scene = seen(name, 100 + seed, false=4)
        found = pyramid_kernel(machine, scene.spikes, sky(name).tables, unlimited(scene.parameters)).found
        machine.release()
        if found.reason == Reason.NONE:
            true = (found.star_index >= 0) & (scene.true_rows >= 0)
            np.testing.assert_array_equal(found.star_index[true], scene.true_rows[true])
            assert found.verified == (found.star_index >= 0).sum()
            right += true.sum() >= 4
    assert right >= 18


@pytest.mark.parametrize("spikes", [3, 4, 5])
@pytest.mark.parametrize("step", [1, -1])
def test_a_catalogue_of_few_stars(machine: ArmMachine, spikes: int, step: int) -> None:
    """Every range has a pair or none: the first and last entries of the tables count.

    Also with the dimmest spike first, which makes the joined stars the brighter ones of their pairs.
    """
    for seed in range(8):
        scene = with_parameters(
            seen("wide", seed, stars=spikes), field_normals=None, most_false_triangles=1e9
        )
        kept, rows = np.sort(scene.true_rows), scene.true_rows[::step]
        spikes_given = Spikes(scene.spikes.b_vectors[::step], scene.spikes.magnitudes[::step])
        whole = sky("wide").catalogue
        catalogue = build_star_catalogue(
            whole.hip[kept], whole.unit_vectors[kept], whole.hp_mag[kept], whole.limit_mag, 0.0
        )
        tables = StarTables(catalogue, build_pair_catalogue(catalogue, sky("wide").pairs.max_angle_rad))
        expected, _ = pyramid.identify(spikes_given, tables, scene.parameters)
        binding.compare(pyramid_kernel(machine, spikes_given, tables, scene.parameters).found, expected)
        np.testing.assert_array_equal(kept[expected.star_index], rows)
        machine.release()


def marks_at(machine: ArmMachine, scene: Scene, base: int) -> tuple[Identification, int]:
    """The scene identified with the mark table's numbers starting at `base`; and where they end."""
    tables, parameters = sky(scene.name).tables, unlimited(scene.parameters)
    entries = 2 * len(tables.pairs)
    marks = place_struct(
        machine,
        "st_pyramid_marks",
        # old marks everywhere, all of numbers below the base
        head=machine.place(np.random.default_rng(0).integers(0, base, len(tables.catalogue), dtype=np.int32)),
        partner=machine.reserve(4 * entries),
        chain=machine.reserve(4 * entries),
        entries=entries,
        base=base,
    )
    found, star_index = reserve_structs(machine, "st_identification"), machine.reserve(4 * len(scene.spikes))
    machine.call(
        "st_identify_pyramid",
        binding.place_spikes(machine, scene.spikes),
        binding.place_star_table(machine, tables.catalogue),
        binding.place_pair_table(machine, tables.pairs),
        binding.place_limits(machine, parameters, tables.pairs),
        parameters.max_spots,
        marks,
        found,
        star_index,
    )
    end = int(read_struct(machine, "st_pyramid_marks", marks)["base"])
    identification = binding.read_identification(machine, found, star_index, len(scene.spikes))
    machine.release()
    return identification, end


@pytest.mark.parametrize("base", [1, 12_345, (1 << 30) - 500, (1 << 30) + 1])
def test_old_marks_change_nothing(machine: ArmMachine, base: int) -> None:
    """Marks of earlier images, up to where the numbers start again."""
    for seed, kind in enumerate(("stars", "mostly false", "nothing of the sky")):
        scene = SCENES[kind]("wide", seed)
        expected, _ = pyramid.identify(scene.spikes, sky("wide").tables, scene.parameters)
        found, end = marks_at(machine, scene, base)
        binding.compare(found, expected)
        assert end < 1 << 24 if base > 1 << 30 else end > 1


def test_a_limited_search_is_run_again_without_its_limit(machine: ArmMachine) -> None:
    scene = SCENES["nothing of the sky"]("wide", 3)
    limited = with_parameters(scene, max_triads=2).record(pyramid.identify)
    assert limited.result.reason == Reason.WORK_LIMIT
    (stage_run,) = IdentifyStep().run(machine, limited)
    _, work = pyramid.identify(scene.spikes, sky("wide").tables, unlimited(scene.parameters))
    assert stage_run.work == work
    assert work["triads_tested"] > 2


CHANGES: dict[str, dict[str, Any]] = {
    "reason": {"reason": Reason.AMBIGUOUS},
    "verified": {"verified": 3},
    "star_index": {"star_index": np.zeros(60, np.int32)},
    "quaternion": {"q_icrs_to_sensor": np.array([1e-8, 0.0, 0.0, 1.0])},
    "false_solutions": {"false_solutions": 1.0},
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_difference_is_a_mismatch(name: str) -> None:
    same = Identification(
        np.full(60, 4, np.int32), 60, Reason.NONE, np.array([0.0, 0.0, 0.0, 1.0]), 1e-12, 9, 8
    )
    binding.compare(same, replace(same, q_icrs_to_sensor=np.array([1e-10, 0.0, 0.0, 1.0])))
    with pytest.raises(MismatchError, match=name):
        binding.compare(replace(same, **CHANGES[name]), same)


def test_the_cycles_follow_from_the_counts(machine: ArmMachine) -> None:
    """Coefficients of one set of images give the cycles of another within 10 %, line fills included."""
    kinds = [kind for kind in SCENES if kind != "too few"]
    runs: dict[bool, list[StageRun]] = {False: [], True: []}
    for held_out in runs:
        for number, kind in enumerate(kinds * (2 if held_out else 3)):
            scene = SCENES[kind](("narrow", "wide")[number % 2], 1000 * held_out + number)
            runs[held_out].append(run(machine, scene))
    names = sorted({name for stage_run in runs[False] for name in stage_run.work.counts})

    def counts(part: list[StageRun]) -> np.ndarray:
        return np.array([[stage_run.work[name] for name in names] for stage_run in part], float)

    def cycles(part: list[StageRun]) -> np.ndarray:
        totals = [r.cost.core_cycles + r.cost.memory_cycles(LINE_FILL_CYCLES) for r in part]
        return np.array(totals, float)

    known = cycles(runs[False])
    scale = counts(runs[False]).max(axis=0)
    coefficients, _ = nnls(counts(runs[False]) / scale / known[:, np.newaxis], np.ones(len(known)))
    error = counts(runs[True]) / scale @ coefficients / cycles(runs[True]) - 1.0
    assert len(error) >= 28
    assert np.abs(error).max() < 0.10
