"""Attitude, aberration, rate and chance in C: the Python stages' results, and those of numpy and scipy."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from st_emulator.firmware_model.aberration import SPEED_OF_LIGHT_KM_S, apparent_kernel, earth_velocity_km_s
from st_emulator.firmware_model.attitude import (
    angular_rate,
    covariance_kernel,
    largest_eigenvector_kernel,
    matrix_kernel,
    quaternion_kernel,
    robust_q_method,
)
from st_emulator.firmware_model.configuration import CentroidError, TrackingParameters
from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.identification.judgement import false_solutions_kernel, spread_kernel
from st_emulator.firmware_model.work import Work
from tools.arm_timing.machine import ArmMachine
from tools.calibration.steps import attitude_parts
from tools.calibration.steps.attitude import STEPS, place_vectors
from tools.calibration.steps.step import MismatchError, StageRun

ARCSEC = math.radians(1.0 / 3600.0)
FOCAL_PX = 6850.0
BY_NAME = {step.name: step for step in STEPS}
ERRORS = CentroidError(floor_px=0.02, psf_sigma_px=0.8, electrons_per_dn=6.0, half_window_px=2)

# One machine serves all examples: what an example places is released again.
SHARED_MACHINE = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
SEEDS = st.integers(0, 2**32 - 1)


def run(machine: ArmMachine, record: StepRecord) -> list[StageRun]:
    return list(BY_NAME[record.step].run(machine, record))


def scene(
    rng: np.random.Generator, stars: int, radius_rad: float, noise_arcsec: float, wrong: int = 0
) -> dict[str, Any]:
    """Arguments of a record "attitude": a field, turned at random, with noise and some stars elsewhere."""
    b = np.column_stack([rng.uniform(-radius_rad, radius_rad, (stars, 2)), np.ones(stars)])
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    reference = Rotation.random(random_state=rng).apply(b)
    measured = b + rng.normal(0, noise_arcsec * ARCSEC, (stars, 3))
    measured[:wrong] += rng.normal(0, 100 * ARCSEC, (wrong, 3))
    measured /= np.linalg.norm(measured, axis=1, keepdims=True)
    return {
        "measured": measured,
        "reference": reference,
        "flux_dn": 10.0 ** rng.uniform(-1, 5, stars),
        "noise_dn": float(rng.uniform(0.5, 8)),
        "centroid_error": ERRORS,
        "focal_px": FOCAL_PX,
        "tolerance_rad": 25 * ARCSEC,
        "least": max(3, math.ceil(2 * stars / 3)),
    }


def solved(arguments: dict[str, Any]) -> StepRecord:
    """The record that the firmware makes of these arguments."""
    error: CentroidError = arguments["centroid_error"]
    sigma = error.sigma_px(arguments["flux_dn"], arguments["noise_dn"]) / arguments["focal_px"]
    solution, kept, work = robust_q_method(
        arguments["measured"], arguments["reference"], sigma, arguments["tolerance_rad"], arguments["least"]
    )
    work.add("centroid_errors", len(sigma))
    return StepRecord("attitude", arguments, (solution, kept), work)


@settings(SHARED_MACHINE, max_examples=60)
@given(SEEDS, st.integers(2, 40), st.sampled_from([0.02, 0.07, 0.25]), st.sampled_from([0.0, 2.0, 30.0]))
def test_the_attitude_is_that_of_the_python_stage(
    machine: ArmMachine, seed: int, stars: int, radius_rad: float, noise_arcsec: float
) -> None:
    rng = np.random.default_rng(seed)
    run(
        machine,
        solved(scene(rng, stars, radius_rad, noise_arcsec, wrong=int(rng.integers(0, 1 + stars // 3)))),
    )


def test_stars_that_do_not_belong_are_left_out_alike(machine: ArmMachine) -> None:
    rng = np.random.default_rng(5)
    dropped = set()
    for wrong in (1, 2, 3, 5):
        record = solved(scene(rng, 9, 0.07, 3.0, wrong))
        run(machine, record)
        dropped.add(9 - len(record.result[1]))
    assert len(dropped) >= 3  # a few of them, and too many


@pytest.mark.parametrize("stars", [0, 1, 2])
def test_what_gives_no_attitude_gives_none(machine: ArmMachine, stars: int) -> None:
    arguments = scene(np.random.default_rng(6), stars, 0.07, 1.0)
    run(machine, solved(arguments | {"least": 3}))
    if stars == 2:  # the same star twice
        for name in ("measured", "reference"):
            arguments[name] = np.repeat(arguments[name][:1], 2, axis=0)
        record = solved(arguments | {"least": 2})
        assert record.result[0] is None
        run(machine, record)


@pytest.mark.parametrize("change", ["quaternion", "kept", "residuals", "covariance", "chi_square", "none"])
def test_a_wrong_attitude_would_be_seen(machine: ArmMachine, change: str) -> None:
    record = solved(scene(np.random.default_rng(7), 8, 0.07, 3.0))
    solution, kept = record.result
    altered: dict[str, Callable[[], Any]] = {
        "quaternion": lambda: (replace(solution, q_icrs_to_sensor=solution.q_icrs_to_sensor + 2e-12), kept),
        "kept": lambda: (solution, kept[1:]),
        "residuals": lambda: (replace(solution, residuals_rad=solution.residuals_rad + 2e-12), kept),
        "covariance": lambda: (replace(solution, covariance_rad2=solution.covariance_rad2 * 1.00001), kept),
        "chi_square": lambda: (replace(solution, chi_square=solution.chi_square * 1.00001), kept),
        "none": lambda: (None, kept),
    }
    with pytest.raises(MismatchError, match="attitude: "):
        run(machine, replace(record, result=altered[change]()))


@settings(SHARED_MACHINE, max_examples=40)
@given(SEEDS, st.integers(2, 20), st.sampled_from([0.05, 0.3]))
def test_the_attitude_is_scipys(machine: ArmMachine, seed: int, stars: int, radius_rad: float) -> None:
    arguments = scene(np.random.default_rng(seed), stars, radius_rad, 5.0)
    b, r = arguments["measured"], arguments["reference"]
    weights = np.random.default_rng(seed + 1).uniform(0.5, 2.0, stars)
    if np.linalg.norm(b[:, None] - b[None, :], axis=2).max() < 0.2 * radius_rad:
        return  # stars nearly in one place fix nothing, and rounding decides
    q = machine.reserve(32)
    machine.call("st_quaternion", *(place_vectors(machine, v) for v in (b, r, weights)), stars, q)
    found = machine.read(q, np.float64, 4)
    machine.release()
    theirs, _ = Rotation.align_vectors(b, r, weights=weights)
    # b = A(q) r with a passive q: A is the inverse turn of scipy's, active, of the same numbers
    assert (Rotation.from_quat(found).inv() * theirs.inv()).magnitude() < 1e-9


@settings(SHARED_MACHINE, max_examples=60)
@given(SEEDS)
def test_the_eigenvector_is_numpys_and_its_rotations_are_counted(machine: ArmMachine, seed: int) -> None:
    rng = np.random.default_rng(seed)
    k = rng.normal(size=(4, 4))
    k += k.T
    place, vector = place_vectors(machine, k), machine.reserve(32)
    rotations = machine.call("st_largest_eigenvector", place, vector).result
    found = machine.read(vector, np.float64, 4)
    machine.release()
    assert abs(found @ np.linalg.eigh(k)[1][:, 3]) == pytest.approx(1.0, abs=1e-12)
    expected = np.empty(4)
    assert rotations == largest_eigenvector_kernel(k.copy(), expected)
    assert (found == expected).all()


@settings(SHARED_MACHINE, max_examples=40)
@given(SEEDS, st.integers(2, 30))
def test_sums_and_products_are_the_same_bits(machine: ArmMachine, seed: int, stars: int) -> None:
    rng = np.random.default_rng(seed)
    arguments = scene(rng, stars, 0.1, 10.0)
    b, r, weights = arguments["measured"], arguments["reference"], rng.uniform(0.1, 10.0, stars)
    q, matrix, covariance = np.empty(4), np.empty((3, 3)), np.empty((3, 3))
    quaternion_kernel(b, r, weights, stars, q)
    matrix_kernel(q, matrix)
    regular = covariance_kernel(b, weights, stars, covariance)
    places = [place_vectors(machine, array) for array in (b, r, weights)]
    out = [machine.reserve(8 * n) for n in (4, 9, 9)]
    machine.call("st_quaternion", *places, stars, out[0])
    machine.call("st_matrix", out[0], out[1])
    assert machine.call("st_covariance", places[0], places[2], stars, out[2]).result == regular
    for place, expected in zip(out, (q, matrix, covariance), strict=True):
        assert (machine.read(place, np.float64, expected.shape) == expected).all()
    machine.release()


@SHARED_MACHINE
@given(st.integers(0, 10_000))
def test_parts_of_an_attitude_one_by_one(machine: ArmMachine, seed: int) -> None:
    (step,) = attitude_parts.STEPS
    records = attitude_parts.own_records(seed, 3)
    assert [record.arguments["part"] for record in records] == list(attitude_parts.PARTS)
    for record in records:
        (first,), (again,) = step.run(machine, record), step.run(machine, record)
        assert first.cost.core_cycles == again.cost.core_cycles
        assert first.cost.line_fills() == again.cost.line_fills() == 0  # warm
        with pytest.raises(MismatchError, match="attitude_part"):
            step.run(
                machine, replace(record, result=record.result + 2e-12 * abs(record.result).max() + 2e-12)
            )


def test_velocity_of_the_earth_over_a_century(machine: ArmMachine) -> None:
    about_earth = (7.1, -2.0, 0.4)
    for year in range(1960, 2051, 3):
        tai_ns = int((year - 1958) * 365.25 * 86_400e9) + 123_456_789
        over_c = (earth_velocity_km_s(tai_ns) + np.array(about_earth)) / SPEED_OF_LIGHT_KM_S
        arguments = {"tai_ns": tai_ns, "velocity_km_s": about_earth}
        record = StepRecord("velocity", arguments, over_c, Work({"observer_velocities": 1}))
        (only,) = run(machine, record)
        assert only.stage == "attitude"
    with pytest.raises(MismatchError, match="velocity"):
        run(machine, replace(record, result=over_c + 3e-18))


@settings(SHARED_MACHINE, max_examples=30)
@given(SEEDS, st.integers(1, 30))
def test_apparent_directions(machine: ArmMachine, seed: int, stars: int) -> None:
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(100, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    rows = rng.integers(0, 100, stars).astype(np.int32)
    velocity = rng.normal(0, 1e-4, 3)
    apparent = np.empty((stars, 3))
    for beta in (velocity, np.zeros(3)):
        apparent_kernel(vectors, rows, beta, apparent)
        work = Work({"aberrated_stars": stars} if beta.any() else None)
        arguments = {"unit_vectors": vectors, "rows": rows, "velocity": beta}
        assert len(run(machine, StepRecord("apparent", arguments, apparent, work))) == beta.any()
    # to first order the sky moves by the velocity's part across the direction
    direction = vectors[rows[0]]
    apparent_kernel(vectors, rows, velocity, apparent)
    across = velocity - (velocity @ direction) * direction
    assert apparent[0] - direction == pytest.approx(across, abs=2e-7)


def rate_record(rng: np.random.Generator, speed_rad_s: float) -> StepRecord:
    """Two attitudes apart by a turn, as the firmware compares them."""
    before = Rotation.random(random_state=rng)
    axis = rng.normal(size=3)
    turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * speed_rad_s * 0.25)
    # in sensor axes: first the turn, then the attitude; the quaternions are those of the passive matrices
    q = [r.as_quat() for r in (before, before * turn)]
    q = [v * np.copysign(1.0, v[3]) for v in q]
    rate = angular_rate(q[0], q[1], 0.25)
    assert rate == pytest.approx(axis / np.linalg.norm(axis) * speed_rad_s, abs=1e-12)
    arguments = {
        "before": q[0],
        "after": q[1],
        "interval_s": 0.25,
        "covariance_before_rad2": np.diag(rng.uniform(1e-12, 1e-10, 3)),
        "covariance_after_rad2": np.diag(rng.uniform(1e-12, 1e-10, 3)),
        "tracking": TrackingParameters(tolerance_rad=25 * ARCSEC, rate_rad_s=0.05),
    }
    return StepRecord("rate", arguments, rate, Work({"rate_solves": 1}))


@pytest.mark.parametrize("speed_rad_s", [0.0, 1e-6, 0.01, 0.049, 0.2, 3.0])
def test_rates(machine: ArmMachine, speed_rad_s: float) -> None:
    rng = np.random.default_rng(31)
    for _ in range(5):
        record = rate_record(rng, speed_rad_s)
        run(machine, record)
    if speed_rad_s:
        with pytest.raises(MismatchError, match="rate"):
            run(machine, replace(record, result=record.result * (1 + 3e-12)))


@pytest.mark.parametrize(
    ("speed_rad_s", "sigma_rad", "high"),
    [(0.05, 1e-9, 0), (0.2, 1e-9, 1), (0.2, 0.1, 0), (0.2, 0.0055, 1), (0.2, 0.0065, 0)],
)
def test_a_rate_is_too_high_beyond_three_sigma(
    machine: ArmMachine, speed_rad_s: float, sigma_rad: float, high: int
) -> None:
    rate = place_vectors(machine, [0.0, speed_rad_s, 0.0])
    covariance = place_vectors(machine, np.diag([0.0, sigma_rad**2, 0.0]))
    # of both attitudes over 0.25 s: 0.1 rad/s over the limit is three sigma at 0.0059 rad
    call = machine.call("st_rate_too_high", rate, 0.25, covariance, covariance, 0.1)
    assert call.result == high


@settings(SHARED_MACHINE, max_examples=40)
@given(SEEDS, st.integers(3, 30), st.integers(0, 30))
def test_the_chance_of_a_false_solution(machine: ArmMachine, seed: int, matched: int, more: int) -> None:
    rng = np.random.default_rng(seed)
    b = scene(rng, matched, 0.08, 0.0)["measured"]
    stars, tolerance_rad = int(rng.integers(1000, 10_000)), float(rng.uniform(10, 60)) * ARCSEC
    spread = spread_kernel(b, matched)
    chance = false_solutions_kernel(stars, matched + more, matched, spread, tolerance_rad)
    arguments = {
        "stars": stars,
        "spots": matched + more,
        "matched": matched,
        "b_vectors": b,
        "tolerance_rad": tolerance_rad,
    }
    record = StepRecord("false_solutions", arguments, chance, Work({"false_solutions": 1}))
    run(machine, record)
    with pytest.raises(MismatchError, match="false_solutions"):
        run(machine, replace(record, result=chance * 1.0001))
    for matches, spots in ((2, 9), (5, 4)):
        result = machine.call("st_false_solutions", stars, spots, matches, spread, tolerance_rad).result_pair
        assert result == math.inf == false_solutions_kernel(stars, spots, matches, spread, tolerance_rad)


def test_a_chance_beyond_all_numbers_stays_one(machine: ArmMachine) -> None:
    spread, tolerance_rad = 0.1, 0.03  # 1000 spots, and a star within each one's tolerance by chance
    chance = machine.call("st_false_solutions", 10_000, 1000, 400, spread, tolerance_rad).result_pair
    assert chance == pytest.approx(math.exp(700.0), rel=1e-9)
    assert chance == pytest.approx(false_solutions_kernel(10_000, 1000, 400, spread, tolerance_rad), rel=1e-9)


def test_software_arithmetic_costs_what_a_trial_found(machine: ArmMachine) -> None:
    """Core cycles of GCC 12's soft double add, multiply and divide: 82, 74 and 566 in an earlier trial."""
    rng = np.random.default_rng(40)
    for symbol, trial in (("__aeabi_dadd", 82), ("__aeabi_dmul", 74), ("__aeabi_ddiv", 566)):
        values = rng.uniform(-1, 1, (50, 2))
        cycles = [machine.call(symbol, float(x), float(y)).cost.core_cycles for x, y in values]
        assert np.mean(cycles) == pytest.approx(trial, rel=0.15)


def test_counts_predict_the_core_cycles_of_attitudes(machine: ArmMachine) -> None:
    """Coefficients from some fields, 5 to 24 stars, foretell others to a tenth, with wrong stars too."""
    rng = np.random.default_rng(41)
    runs = []
    for number in range(60):
        stars = 5 + number % 20
        wrong = number % 3 if stars > 8 else 0
        runs.append(run(machine, solved(scene(rng, stars, rng.choice([0.03, 0.07, 0.2]), 3.0, wrong))))
    for place in range(2):  # the centroids' errors, the solution
        chosen = [stage_runs[place] for stage_runs in runs]
        names = sorted({name for one in chosen for name in one.work.counts})
        counts = np.array([[one.work[name] for name in names] for one in chosen], float)
        cycles = np.array([one.cost.core_cycles for one in chosen], float)
        relative = counts / cycles[:, None]
        coefficients = np.linalg.lstsq(relative[:30], np.ones(30), rcond=None)[0]
        assert np.abs(relative[30:] @ coefficients - 1.0).max() < 0.10
