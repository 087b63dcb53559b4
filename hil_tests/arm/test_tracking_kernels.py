"""Tracking in C: plain geometry, the Python stage's outcomes, cycles from counts."""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hil_tests.firmware_model.synthetic_sky import (
    ARCSEC,
    SyntheticSky,
    matrix,
    random_attitude,
    random_directions,
    turned,
    vectors_of,
)
from st_emulator.firmware_model import verification
from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.geometry import CameraGeometry
from st_emulator.firmware_model.image.spots import Spots, WindowSpots
from st_emulator.firmware_model.tracking import (
    TrackingParameters,
    TrackingPlan,
    plan_windows,
)
from st_emulator.firmware_model.verification import Verification, verify_by_pivot
from tools.arm_timing.machine import ArmMachine
from tools.calibration.compiler import KERNELS
from tools.calibration.steps import tracking as binding
from tools.calibration.steps.step import MismatchError
from tools.calibration.steps.windows import read_rects
from tools.calibration.struct_layout import reserve_structs

Array = NDArray[np.float64]
CAMERA = CameraGeometry(512, 512, 1440.0)
BARREL = CameraGeometry(512, 400, 1440.0, 250.0, 210.0, k1=-0.15, k2=0.02, p1=1e-3, p2=-5e-4)
SKY = SyntheticSky.make(21, 1500, CAMERA, 6.0)
CROWDED = SyntheticSky.make(22, 9000, CAMERA, 6.0)
PARAMETERS = TrackingParameters(math.radians(1.0), 60 * ARCSEC, max_windows=24)
REST = np.zeros(3)
MOVING = np.array([5e-5, -7e-5, 4e-5])
PLAN, VERIFY = binding.STEPS
SHARED_MACHINE = settings(
    deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def cone(
    machine: ArmMachine, sky: SyntheticSky, direction: Array, radius_rad: float, room: int | None = None
) -> tuple[int, list[int]]:
    """(stars counted, rows written) of st_stars_in_cone."""
    capacity = len(sky.catalogue) if room is None else room
    found = machine.place(np.full(capacity + 1, -1, np.int32))
    x, y, z = (float(value) for value in direction)
    catalogue = binding.place_catalogue(machine, sky.catalogue)
    call = machine.call("st_stars_in_cone", catalogue, x, y, z, radius_rad, found, capacity)
    rows = machine.read(found, np.int32, min(call.result, capacity)).tolist()
    assert machine.read(found, np.int32, capacity + 1)[-1] == -1  # nothing is written beyond the room
    machine.release()
    return call.result, rows


@pytest.mark.parametrize("radius_deg", [0.01, 1.0, 7.0, 40.0, 89.0, 120.0, 180.0])
def test_a_cone_holds_the_stars_within_its_angle(machine: ArmMachine, radius_deg: float) -> None:
    """Against all the stars; at random, at both poles, just beside them, and where right ascension turns."""
    rng = np.random.default_rng(1)
    axes = [[0, 0, 1], [0, 0, -1], [1e-7, 0, 1], [1, 0, 0], [1, -1e-9, 0], [1, 1e-9, 0.2], [-1, 0, 0]]
    radius_rad = math.radians(radius_deg)
    for direction in [*random_directions(rng, 6), *(np.array(axis) / np.linalg.norm(axis) for axis in axes)]:
        count, rows = cone(machine, SKY, direction, radius_rad)
        angle = np.arccos(np.clip(SKY.catalogue.unit_vectors @ direction, -1.0, 1.0))
        assert np.abs(angle - radius_rad).min() > 1e-9  # none so near to the rim that rounding decides
        assert sorted(rows) == np.flatnonzero(angle <= radius_rad).tolist()
        assert count == len(rows)
        assert rows == SKY.catalogue.stars_near(direction, radius_rad)[0].tolist()  # in the grid's order


def test_a_cone_counts_on_where_the_room_ends(machine: ArmMachine) -> None:
    direction = SKY.catalogue.unit_vectors[3]
    count, rows = cone(machine, SKY, direction, 0.3)
    assert count > 20
    assert cone(machine, SKY, direction, 0.3, room=7) == (count, rows[:7])


def test_the_nearest_star(machine: ArmMachine) -> None:
    """Against all the stars; and none where the cone is empty."""
    rng = np.random.default_rng(2)
    vectors = SKY.catalogue.unit_vectors
    found, angle = machine.reserve(4 * len(vectors)), machine.reserve(8)
    misses = 0
    for direction in random_directions(rng, 60):
        x, y, z = (float(value) for value in direction)
        call = machine.call(
            "st_nearest_star",
            binding.place_catalogue(machine, SKY.catalogue),
            x,
            y,
            z,
            0.05,
            found,
            len(vectors),
            angle,
        )
        chords = np.linalg.norm(vectors - direction, axis=1)
        nearest = int(np.argmin(chords))
        true_angle = 2 * math.asin(chords[nearest] / 2)
        measured = float(machine.read(angle, np.float64, 1)[0])
        if true_angle > 0.05:
            misses += 1
            assert (np.int32(np.uint32(call.result)), measured) == (-1, math.pi)
        else:
            assert (call.result, measured) == (nearest, pytest.approx(true_angle, rel=1e-12))
    assert 5 < misses < 55


def plan_record(
    sky: SyntheticSky,
    q: Array,
    pivot: int = -1,
    geometry: CameraGeometry = CAMERA,
    velocity: Array = REST,
    interval_s: float = 0.25,
    **changes: Any,
) -> StepRecord:
    """As the firmware records the step."""
    parameters = replace(PARAMETERS, **changes)
    arguments = {
        "q_icrs_to_sensor": q,
        "pivot_star": pivot,
        "catalogue": sky.catalogue,
        "geometry": geometry,
        "parameters": parameters,
        "interval_s": interval_s,
        "exposure_s": 0.1,
        "velocity_over_c": velocity,
    }
    values = [value for name, value in arguments.items() if name != "velocity_over_c"]
    plan, work = plan_windows(*values, velocity)
    return StepRecord("plan", arguments, plan, work)


@pytest.mark.parametrize("velocity", [REST, MOVING], ids=["rest", "moving"])
@pytest.mark.parametrize("geometry", [CAMERA, BARREL], ids=["pinhole", "distorted"])
def test_plans_are_those_of_python(machine: ArmMachine, geometry: CameraGeometry, velocity: Array) -> None:
    rng = np.random.default_rng(3)
    merged = 0
    for number in range(12):
        sky = CROWDED if number % 3 == 0 else SKY
        q = random_attitude(rng)
        in_field = sky.catalogue.unit_vectors @ matrix(q)[2]
        pivot = int(np.argmax(in_field)) if number % 2 else -1
        record = plan_record(
            sky, q, pivot, geometry, velocity, interval_s=0.25 * (1 + number % 4), max_windows=5 + 3 * number
        )
        (run,) = PLAN.run(machine, record)
        assert run.stage == "tracking"
        assert run.work["aberrated_stars"] == (run.work["predicted_stars_tested"] if velocity.any() else 0)
        merged += len(record.result.star) - len(record.result.rects)
    assert merged > 10


def test_a_plan_holds_the_brightest_stars_where_they_are(machine: ArmMachine) -> None:
    """Against the pinhole written out; no Python stage."""
    rng = np.random.default_rng(4)
    for _ in range(5):
        q = random_attitude(rng)
        arguments = plan_record(SKY, q).arguments
        plan, _ = binding.run_plan(machine, **arguments)
        machine.release()
        view = SKY.view(q, border_px=-0.5)
        number = min(24, len(view))
        assert plan.star.tolist() == view.row[:number].tolist()
        assert plan.x_px == pytest.approx(view.x_px[:number], abs=1e-9)
        assert plan.y_px == pytest.approx(view.y_px[:number], abs=1e-9)
        # ceil(1 deg/s 0.25 s eps) + ceil(4 px + half a streak), eps = 512 px / 20.16 deg
        assert plan.half_width_px == 7 + 6


def test_stars_as_bright_as_each_other_stay_in_the_grids_order(machine: ArmMachine) -> None:
    """With magnitudes below zero and minus zero, in whole steps so that many are the same."""
    rng = np.random.default_rng(5)
    steps = np.sort(rng.integers(-3, 4, len(SKY.magnitude))).astype(np.float32)
    rng.shuffle(steps)
    steps[steps == 0] = np.where(rng.uniform(size=np.count_nonzero(steps == 0)) < 0.5, -0.0, 0.0)
    catalogue = replace(SKY.catalogue, hp_mag=steps)
    for _ in range(6):
        record = plan_record(SKY, random_attitude(rng), max_windows=9)
        arguments = record.arguments | {"catalogue": catalogue}
        values = [value for name, value in arguments.items() if name != "velocity_over_c"]
        plan, work = plan_windows(*values, REST)
        assert len(np.unique(steps[plan.star])) < len(plan.star) == 9
        PLAN.run(machine, StepRecord("plan", arguments, plan, work))


def test_an_empty_field_has_an_empty_plan(machine: ArmMachine) -> None:
    lonely = SyntheticSky.make(5, 3, CAMERA, 6.0)
    away = -lonely.vectors.sum(axis=0)
    q = next(
        q
        for q in (random_attitude(np.random.default_rng(seed)) for seed in range(100))
        if matrix(q)[2] @ away > 0.9 * np.linalg.norm(away)
    )
    record = plan_record(lonely, q)
    assert len(record.result.star) == 0
    PLAN.run(machine, record)


@SHARED_MACHINE
@given(
    st.lists(st.tuples(st.floats(-0.5, 99.49), st.floats(-0.5, 79.49)), min_size=0, max_size=24),
    st.integers(0, 12),
)
def test_merged_windows_hold_their_stars_and_touch_no_other(
    machine: ArmMachine, places: list[tuple[float, float]], half: int
) -> None:
    x, y = np.array(places, np.float64).reshape(-1, 2).T.copy()
    stars = len(x)
    rects, window = reserve_structs(machine, "st_rect", stars), machine.reserve(4 * stars)
    number = machine.call(
        "st_merge_windows", machine.place(x), machine.place(y), stars, half, 100, 80, rects, window
    ).result
    found = read_rects(machine, rects, number)
    of_star = machine.read(window, np.int32, stars)
    machine.release()
    column, row = np.floor(x + 0.5).astype(int), np.floor(y + 0.5).astype(int)
    own = np.stack([column - half, row - half, column + half + 1, row + half + 1], axis=-1)
    own = np.clip(own, 0, [100, 80, 100, 80])
    for one, other in itertools.combinations(found.tolist(), 2):
        assert one[0] > other[2] or other[0] > one[2] or one[1] > other[3] or other[1] > one[3]
    assert sorted(set(of_star.tolist())) == list(range(number))
    for place, rect in enumerate(found):
        # no larger than what its stars' windows need
        inside = own[of_star == place]
        assert rect.tolist() == [*inside[:, :2].min(axis=0), *inside[:, 2:].max(axis=0)]


def found_in(plan: TrackingPlan, x: Array, y: Array, magnitude: Array) -> WindowSpots:
    """Those of the spots that lie in a window, by window, brightest first in each."""
    r = plan.rects
    inside = (x[:, None] >= r[:, 0]) & (x[:, None] < r[:, 2])
    inside &= (y[:, None] >= r[:, 1]) & (y[:, None] < r[:, 3])
    seen = inside.any(axis=1)
    x, y, magnitude, window = x[seen], y[seen], magnitude[seen], inside[seen].argmax(axis=1)
    order = np.lexsort((magnitude, window))
    ideal = Spots.at(x, y, magnitude)
    back = np.argsort(np.argsort(magnitude, kind="stable"), kind="stable")[order]
    number = len(r)
    return WindowSpots(
        ideal.take(back),
        window[order].astype(np.int32),
        np.ones(number, np.uint8),
        np.zeros(number),
        np.ones(number),
    )


def verify_record(
    sky: SyntheticSky, seed: int, false: int = 0, lost: float = 0.0, half_s: float = 0.25, **changes: Any
) -> StepRecord:
    """A turned sky seen in the windows: spots of its stars, some lost, and false ones beside them."""
    rng = np.random.default_rng(seed)
    q = random_attitude(rng)
    parameters = replace(PARAMETERS, **changes)
    plan = plan_record(sky, q, interval_s=half_s, **changes).result
    view = sky.view(turned(q, rng.uniform(-0.5, 0.5, 3) * PARAMETERS.rate_rad_s * 0.25))
    kept = rng.uniform(size=len(view)) >= lost
    near = rng.integers(0, max(len(plan.star), 1), false if len(plan.star) else 0)
    x = np.concatenate([view.x_px[kept], plan.x_px[near] + rng.uniform(-12, 12, len(near))])
    y = np.concatenate([view.y_px[kept], plan.y_px[near] + rng.uniform(-12, 12, len(near))])
    magnitude = np.concatenate(
        [view.magnitude[kept] + rng.normal(0, 0.3, kept.sum()), rng.uniform(1, 6, len(near))]
    )
    found = found_in(plan, x, y, magnitude)
    arguments = {
        "plan": plan,
        "found": found,
        "b_vectors": vectors_of(CAMERA, found.spots.x_px, found.spots.y_px),
        "catalogue": sky.catalogue,
        "parameters": parameters,
    }
    verification, work = verify_by_pivot(**arguments)
    return StepRecord("verify", arguments, verification, work)


SCENES: dict[str, dict[str, Any]] = {
    "stars": {},
    "false spots": {"false": 80},
    "stars lost": {"lost": 0.6, "false": 10},
    "few": {"lost": 0.95},
    "wide windows": {"half_s": 2.0, "false": 60},
    "one window": {"half_s": 12.0, "false": 30, "max_windows": 40},
    "loose": {"tolerance_rad": 2000 * ARCSEC, "false": 40},
    "strict brightness": {"magnitude_tolerance": 0.4, "false": 40},
}


@pytest.mark.parametrize("name", SCENES)
def test_verification_is_that_of_python(machine: ArmMachine, name: str) -> None:
    records = [verify_record(CROWDED if seed % 2 else SKY, seed, **SCENES[name]) for seed in range(6)]
    for record in records:
        (run,) = VERIFY.run(machine, record)
        assert run.stage == "tracking"
    # the scenes are what they are called
    if name in ("stars", "false spots"):
        assert all(record.result.pivot >= 0 for record in records)
    if name == "few":
        assert any(record.result.found < 3 for record in records)
    if name == "one window":
        assert any(len(record.arguments["plan"].rects) == 1 for record in records)


def test_many_pivots_are_tried_before_the_right_one(machine: ArmMachine) -> None:
    tried = [
        VERIFY.run(machine, verify_record(SKY, seed, false=40, lost=0.5))[0].work["pivots_tried"]
        for seed in range(20)
    ]
    assert max(tried) >= 4


def test_the_true_stars_are_verified(machine: ArmMachine) -> None:
    """No Python stage: with no false spot each star's spot is the star's."""
    rng = np.random.default_rng(8)
    for _ in range(4):
        q = random_attitude(rng)
        plan = plan_record(SKY, q).result
        view = SKY.view(q)
        found = found_in(plan, view.x_px, view.y_px, view.magnitude)
        b = vectors_of(CAMERA, found.spots.x_px, found.spots.y_px)
        verification, _ = binding.run_verification(machine, plan, found, b, SKY.catalogue, PARAMETERS)
        machine.release()
        for star, spot in zip(plan.star, verification.spot, strict=True):
            place = np.flatnonzero(view.row == star)
            assert len(place) == (spot >= 0)
            if spot >= 0:
                assert found.spots.x_px[spot] == view.x_px[place[0]]
        assert verification.verified == np.count_nonzero(verification.spot >= 0)


@pytest.mark.parametrize("field", ["spot", "pivot", "verified", "found"])
def test_another_verification_is_refused(machine: ArmMachine, field: str) -> None:
    record = verify_record(SKY, 1)
    value = getattr(record.result, field)
    result: Verification = replace(record.result, **{field: value + 1})
    with pytest.raises(MismatchError, match=field):
        VERIFY.run(machine, replace(record, result=result))


@pytest.mark.parametrize(
    ("field", "change"), [("x_px", 2e-9), ("y_px", -2e-9), ("reference", 1e-14), ("rects", 1), ("star", 1)]
)
def test_another_plan_is_refused(machine: ArmMachine, field: str, change: float) -> None:
    record = plan_record(SKY, random_attitude(np.random.default_rng(1)))
    spoiled = replace(record.result, **{field: getattr(record.result, field) + change})
    with pytest.raises(MismatchError, match=field):
        PLAN.run(machine, replace(record, result=spoiled))


def angle(u: Array, v: Array) -> float:
    return math.atan2(float(np.linalg.norm(np.cross(u, v))), float(u @ v))


def judged(machine: ArmMachine, plan: TrackingPlan, b: Array, star: int, tolerance_rad: float) -> bool:
    """Whether a star with its spot in direction b[star] is verified, the brightest one being the pivot."""
    order = np.argsort(plan.window, kind="stable")
    spots = Spots.at(plan.x_px, plan.y_px, np.arange(len(plan.star), dtype=float)).take(order)
    spots = replace(spots, magnitude=SKY.catalogue.hp_mag[plan.star][order].astype(np.float64))
    levels = np.zeros(len(plan.rects))
    found = WindowSpots(spots, plan.window[order], np.ones(len(levels), np.uint8), levels, levels)
    parameters = replace(PARAMETERS, min_stars=2, tolerance_rad=tolerance_rad)
    result, _ = binding.run_verification(machine, plan, found, b[order], SKY.catalogue, parameters)
    machine.release()
    assert result.pivot == 0
    return bool(result.spot[star] >= 0 and order[result.spot[star]] == star)


@pytest.mark.parametrize("tolerance", [60 * ARCSEC, None])
def test_a_star_at_the_tolerance_is_judged_by_its_angle(machine: ArmMachine, tolerance: float | None) -> None:
    """One star moved to just inside and just outside of the tolerance, by an angle that arctan2 measures.

    And with a tolerance over the angle itself: then no angle is too small.
    """
    near = 0
    for seed in range(4):
        q = random_attitude(np.random.default_rng(seed))
        plan = plan_record(SKY, q).result
        reference = plan.reference @ matrix(q).T
        for star in range(1, len(plan.star)):
            apart = angle(reference[0], reference[star])
            across = np.cross(np.cross(reference[0], reference[star]), reference[0])
            across /= np.linalg.norm(across)
            if tolerance is not None:
                wide = tolerance
                cases = [(-1.0 + 1e-6, True), (1.0 - 1e-6, True), (-1.0 - 1e-6, False), (1.0 + 1e-6, False)]
            else:
                wide = 0.099
                cases = [(1.0 - 1e-6, True), (1.0 + 1e-6, False)]
                if apart < wide:
                    cases.append((-0.95 * apart / wide, True))
                    near += 1
            for share, verified in cases:
                moved = apart + share * wide
                b = reference.copy()
                b[star] = math.cos(moved) * b[0] + math.sin(moved) * across
                assert angle(b[0], b[star]) == pytest.approx(moved, abs=1e-12)
                assert judged(machine, plan, b, star, wide) == verified
    assert near >= 2 or tolerance is not None


def test_tracking_costs_what_its_counts_say(machine: ArmMachine) -> None:
    records = [
        plan_record(sky, random_attitude(np.random.default_rng(seed)), velocity=velocity, interval_s=interval)
        for sky in (SKY, CROWDED)
        for velocity in (REST, MOVING)
        for interval in (0.25, 1.0)
        for seed in range(3)
    ]
    records += [
        verify_record(SKY if seed % 2 else CROWDED, seed, **scene)
        for scene in SCENES.values()
        for seed in range(5)
    ]
    steps = {"plan": PLAN, "verify": VERIFY}
    runs = [run for record in records for run in steps[record.step].run(machine, record)]
    names = sorted({name for run in runs for name, number in run.work.counts.items() if number})
    counts = np.array([[run.work[name] for name in names] for run in runs], float)
    cycles = np.array([run.cost.core_cycles for run in runs], float)
    found = np.linalg.lstsq(counts / cycles[:, None], np.ones(len(runs)), rcond=None)[0]
    errors = np.abs(counts @ found / cycles - 1.0)
    large = cycles > 20_000
    assert errors[large].max() < 0.1
    assert large.sum() > 30


def test_the_python_verification_has_the_parts_of_its_twin() -> None:
    """So that one can be read beside the other: the functions of tracking.c's verification, in its order."""
    text = (KERNELS / "tracking.c").read_text(encoding="utf-8")
    parts = re.findall(
        r"^(?:static )?\w+ (\w+)\([^;]*?\)\n\{", text[text.index("static double chord_square") :], re.M
    )
    assert parts == ["chord_square", "chord_bounds", "forget", "try_pivot", "st_verify_by_pivot"]
    kernels = [f"_{name}" for name in parts[:-1]] + ["_verify_kernel"]
    lines = [getattr(verification, name).py_func.__code__.co_firstlineno for name in kernels]
    assert lines == sorted(lines)
