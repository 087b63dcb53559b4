"""Geometric voting in C: the Python stage's outcomes, and the truth."""

from __future__ import annotations

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
from hil_tests.arm.identification_scenes import PARAMETERS, SCENES, Scene, seen, sky, with_parameters
from st_emulator.firmware_model.identification.geometric_voting import identify
from st_emulator.firmware_model.identification.interface import Identification
from st_emulator.firmware_model.reasons import Reason
from st_emulator.firmware_model.work import Work
from tools.arm_timing.machine import ArmMachine
from tools.calibration.steps import identification as binding
from tools.calibration.struct_layout import place_struct, reserve_structs

KINDS: dict[str, SceneMaker] = {
    **SCENES,
    # the votes of few spikes say nothing: more are taken, twice as many each time
    "most are false": lambda name, seed: with_parameters(
        seen(name, seed, stars=10, false=30), max_spots=6, tolerance_rad=1e-4
    ),
    # no star of a spike has two votes
    "hardly any pair fits": lambda name, seed: with_parameters(
        seen(name, seed, stars=8), tolerance_rad=PARAMETERS[name].tolerance_rad / 60
    ),
    "more than vote": lambda name, seed: with_parameters(
        seen("wide", seed + len(name), stars=20, false=112), max_spots=64
    ),
}


def second_votes(work: Work) -> int:
    """Angles of two identities: the judgement's are of stars in a cone and of spots it follows."""
    return work["catalogue_angles"] - work["cone_stars"] - work["spots_followed"]


@pytest.mark.parametrize("name", SKIES)
@pytest.mark.parametrize("kind", KINDS)
def test_the_outcome_is_that_of_the_python_stage(machine: ArmMachine, name: str, kind: str) -> None:
    """Reason, stars, numbers and attitude, whatever the image; the step compares and raises."""
    many = kind in ("most are false", "more than vote")
    for seed in range(1 if many else 2):
        compare_with_python(machine, identify, KINDS[kind](name, seed), second_votes)


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
    machine: ArmMachine, scene: Scene, votes: np.ndarray, fits: np.ndarray
) -> tuple[int, Identification]:
    """(returned, found) with a room to work in that holds these."""
    tables, parameters = sky(scene.name).tables, scene.parameters
    room = place_struct(
        machine, "st_voting_room", votes=machine.place(votes), fits=machine.place(fits), words=len(fits)
    )
    found, star_index = reserve_structs(machine, "st_identification"), machine.reserve(4 * len(scene.spikes))
    call = machine.call(
        "st_identify_geometric_voting",
        binding.place_spikes(machine, scene.spikes),
        binding.place_star_table(machine, tables.catalogue),
        binding.place_pair_table(machine, tables.pairs),
        binding.place_limits(machine, parameters, tables.pairs),
        parameters.max_spots,
        room,
        found,
        star_index,
    )
    identification = binding.read_identification(machine, found, star_index, len(scene.spikes))
    machine.release()
    return call.result, identification


def old_votes(scene: Scene) -> np.ndarray:
    """What another image may have left."""
    stars = len(sky(scene.name).catalogue)
    shape = len(scene.spikes), stars + stars % 2
    return np.random.default_rng(1).integers(0, 1 << 16, shape, dtype=np.uint16)


def test_old_votes_change_nothing(machine: ArmMachine) -> None:
    """Votes and fits of earlier images; the two skies have an odd and an even number of stars."""
    assert {len(sky(name).catalogue) % 2 for name in SKIES} == {0, 1}
    for name in SKIES:
        for seed, kind in enumerate(("few", "mostly false", "nothing of the sky", "two skies")):
            scene = KINDS[kind](name, seed)
            expected, _ = identify(scene.spikes, sky(name).tables, scene.parameters)
            fits = np.random.default_rng(2).integers(0, 1 << 32, 40_000, dtype=np.uint32)
            done, found = run_with(machine, scene, old_votes(scene), fits)
            binding.compare(found, expected)
            assert done == 1


def test_a_room_that_is_too_small_is_told(machine: ArmMachine) -> None:
    """Nothing is found then, and a larger one finds it."""
    scene = seen("wide", 4)
    done, found = run_with(machine, scene, old_votes(scene), np.zeros(2, np.uint32))
    assert (done, found.reason, found.verified) == (0, Reason.NO_MATCH, 0)
    assert (found.star_index == -1).all()
    done, found = run_with(machine, scene, old_votes(scene), np.zeros(4096, np.uint32))
    assert (done, found.reason) == (1, Reason.NONE)


def test_the_cycles_follow_from_the_counts(machine: ArmMachine) -> None:
    """Coefficients of one set of images give the cycles of another within 10 %, line fills included."""
    errors = prediction_errors(machine, identify)
    assert len(errors) >= 14
    assert np.abs(errors).max() < 0.10
