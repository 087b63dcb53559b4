"""Rate from an optical flow in C: the Python stage's bits, normal equations beside, cycles from counts."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hil_tests.arm.flow_scenes import turning_stars
from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.rate_from_flow import FlowRate, rate_from_directions
from tools.arm_timing.machine import ArmMachine
from tools.calibration.steps import flow_rate as binding
from tools.calibration.steps.step import MismatchError

RATE, ERRORS = binding.STEPS
TURN_RAD_S = np.radians([1.0, -2.5, 4.0])
ERROR_RAD = 5e-5


def record_of(arguments: dict[str, Any]) -> StepRecord:
    return StepRecord("flow_rate", arguments, *rate_from_directions(**arguments))


@pytest.mark.parametrize("foreseen", [False, True])
@pytest.mark.parametrize("count", [2, 3, 4, 5, 17, 60])
def test_rates_are_those_of_python(machine: ArmMachine, count: int, foreseen: bool) -> None:
    for seed in range(5):
        wrong = seed % 3 if count > 8 else 0
        arguments = turning_stars(seed, count, TURN_RAD_S, 0.1, ERROR_RAD, wrong, 1.0 + seed)
        if foreseen:
            arguments["foreseen_rad_s"] = TURN_RAD_S * 1.01
        record = record_of(arguments)
        (run,) = RATE.run(machine, record)
        assert (run.stage, run.work["flow_equations"]) == ("attitude", count)
        if wrong:
            assert not record.result.kept[:wrong].any()
            assert run.work["flow_rates"] > 1


def test_the_rate_is_the_weighted_least_squares_solution(machine: ArmMachine) -> None:
    """All three equations of each star, weighed by its errors, by normal equations; and the true turn."""
    arguments = turning_stars(11, 40, TURN_RAD_S, 0.1, ERROR_RAD)
    foreseen = arguments["foreseen_rad_s"] = TURN_RAD_S
    found, _ = binding.run_flow_rate(machine, **arguments)
    assert found is not None
    assert found.kept.all()
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for u, v, along, across in zip(
        *(arguments[name] for name in ("before", "after", "along_rad", "across_rad")), strict=True
    ):
        m, d = 0.5 * (u + v), v - u
        a = np.cross(m, foreseen)
        a -= m * (a @ m)
        a /= np.linalg.norm(a)
        b = np.cross(m, a)
        weight = np.outer(a, a) / along**2 + np.outer(b, b) / across**2
        matrix = np.array([[0, -m[2], m[1]], [m[2], 0, -m[0]], [-m[1], m[0], 0]])  # m x t
        normal += matrix.T @ weight @ matrix
        right += matrix.T @ weight @ d
    turn = np.linalg.solve(normal, right)
    size = np.linalg.norm(turn)
    rate = turn / size * 2.0 * math.atan(0.5 * size) / 0.1
    assert found.rate_rad_s == pytest.approx(rate, rel=1e-6)
    covariance = np.linalg.inv(normal) / 0.01
    ratio = found.covariance_rad2_s2 / covariance
    assert ratio == pytest.approx(np.full((3, 3), ratio[0, 0]), rel=1e-3)
    assert 0.5 < ratio[0, 0] < 2.0
    off = found.rate_rad_s - TURN_RAD_S
    assert off @ np.linalg.solve(found.covariance_rad2_s2, off) < 20.0


def test_stars_that_do_not_move(machine: ArmMachine) -> None:
    arguments = turning_stars(1, 12, np.zeros(3), 0.1, 0.0)
    arguments["along_rad"] = arguments["across_rad"] = np.full(12, ERROR_RAD)
    record = record_of(arguments)
    RATE.run(machine, record)
    assert record.result.rate_rad_s == pytest.approx(np.zeros(3), abs=1e-15)


def test_too_few_stars_or_all_in_one_direction(machine: ArmMachine) -> None:
    one = turning_stars(1, 1, TURN_RAD_S, 0.1, ERROR_RAD)
    assert binding.run_flow_rate(machine, **one)[0] is None
    assert RATE.run(machine, record_of(one)) == []
    same = turning_stars(1, 6, TURN_RAD_S, 0.1, 1e-12)
    for name in ("before", "after"):
        same[name] = np.tile(same[name][:1], (6, 1))
    record = record_of(same)
    assert record.result is None
    RATE.run(machine, record)
    assert binding.run_flow_rate(machine, **(one | {"interval_s": 0.0}))[0] is None


@pytest.mark.parametrize("field", ["rate_rad_s", "covariance_rad2_s2", "residual", "kept"])
def test_another_rate_is_refused(machine: ArmMachine, field: str) -> None:
    record = record_of(turning_stars(2, 20, TURN_RAD_S, 0.1, ERROR_RAD))
    expected: FlowRate = record.result
    values = getattr(expected, field)
    spoiled = ~values if field == "kept" else values * (1.0 + 1e-14)
    with pytest.raises(MismatchError, match="rate" if field == "rate_rad_s" else field):
        RATE.run(machine, replace(record, result=replace(expected, **{field: spoiled})))
    with pytest.raises(MismatchError, match="None"):
        RATE.run(machine, replace(record, result=None))


def own(step: str) -> list[StepRecord]:
    made = [record for seed in range(4) for record in binding.own_records(seed, 6)]
    return [record for record in made if record.step == step]


def test_expected_errors_are_those_of_python(machine: ArmMachine) -> None:
    for record in own("shift_errors"):
        (run,) = ERRORS.run(machine, record)
        assert 5_000 < run.cost.core_cycles / run.work["shift_errors"] < 20_000
        streak, along, across = record.result
        with pytest.raises(MismatchError, match="along"):
            ERRORS.run(machine, replace(record, result=(streak, np.nextafter(along, 9.0), across)))


def test_a_rate_costs_what_its_counts_say(machine: ArmMachine) -> None:
    names = ("flow_equations", "flow_rates", "flow_rate_stars")
    runs = [run for record in own("flow_rate") for run in RATE.run(machine, record)]
    cycles = np.array([run.cost.core_cycles for run in runs], float)
    rows = np.array([[run.work[name] for name in names] for run in runs]) / cycles[:, None]
    found = np.linalg.lstsq(rows, np.ones(len(runs)), rcond=None)[0]
    assert np.abs(rows @ found - 1.0).max() < 0.08
    assert found.min() > 0.0
