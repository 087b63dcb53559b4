"""Camera geometry in C: the same bits as the Python kernels, and what the pinhole's formulas say."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.geometry import CameraGeometry
from st_emulator.firmware_model.work import Work
from tools.arm_timing.machine import ArmMachine
from tools.calibration.steps.attitude import STEPS, place_camera, place_vectors
from tools.calibration.steps.step import MismatchError, StageRun

PINHOLE = CameraGeometry(752, 480, 6850.0)
BARREL = CameraGeometry(1024, 1024, 1500.0, 505.0, 520.0, k1=-0.2, k2=0.05, p1=1e-3, p2=-8e-4)
CUSHION = CameraGeometry(800, 600, 2000.0, k1=0.15)
CAMERAS = st.sampled_from([PINHOLE, BARREL, CUSHION])
(UNIT_VECTORS,) = (step for step in STEPS if step.name == "unit_vectors")
SHARED_MACHINE = settings(
    deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
SEEDS = st.integers(0, 2**32 - 1)


def directions(rng: np.random.Generator, count: int, spread: float) -> np.ndarray:
    """Unit vectors round the boresight, some of them out of the field or behind the camera."""
    v = np.column_stack([rng.normal(0, spread, (count, 2)), np.ones(count)])
    v[0, 2] = -1.0
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def unit_vector_record(camera: CameraGeometry, x_px: np.ndarray, y_px: np.ndarray) -> StepRecord:
    """As the firmware records the step."""
    vectors, steps = camera.counted_unit_vectors(x_px, y_px)
    arguments = {"geometry": camera, "x_px": x_px, "y_px": y_px}
    return StepRecord(
        "unit_vectors", arguments, vectors, Work({"unit_vectors": len(x_px), "newton_steps": steps})
    )


def places(rng: np.random.Generator, camera: CameraGeometry, count: int) -> tuple[np.ndarray, np.ndarray]:
    return rng.uniform(-0.5, camera.width_px - 0.5, count), rng.uniform(-0.5, camera.height_px - 0.5, count)


@SHARED_MACHINE
@given(CAMERAS, SEEDS, st.integers(1, 40))
def test_unit_vectors_are_the_same_bits(
    machine: ArmMachine, camera: CameraGeometry, seed: int, count: int
) -> None:
    record = unit_vector_record(camera, *places(np.random.default_rng(seed), camera, count))
    (run,) = UNIT_VECTORS.run(machine, record)
    assert run.stage == "centroid"
    off = record.result.copy()
    off[-1, 0] = np.nextafter(off[-1, 0], 1.0)
    with pytest.raises(MismatchError, match="unit_vectors: vectors"):
        UNIT_VECTORS.run(machine, replace(record, result=off))


def test_no_spots_need_no_run(machine: ArmMachine) -> None:
    assert not UNIT_VECTORS.run(machine, unit_vector_record(PINHOLE, np.empty(0), np.empty(0)))


def test_a_pinholes_unit_vector_by_hand(machine: ArmMachine) -> None:
    vectors = machine.reserve(24)
    camera = place_camera(machine, PINHOLE)
    x_px, y_px = place_vectors(machine, [375.5 + 685.0]), place_vectors(machine, [239.5 - 1370.0])
    machine.call("st_unit_vectors", x_px, y_px, 1, camera, vectors)
    length = math.sqrt(1 + 0.1**2 + 0.2**2)
    assert machine.read(vectors, np.float64, 3) == pytest.approx([0.1 / length, -0.2 / length, 1 / length])


@SHARED_MACHINE
@given(CAMERAS, SEEDS)
def test_projections_are_the_same_bits(machine: ArmMachine, camera: CameraGeometry, seed: int) -> None:
    v = directions(np.random.default_rng(seed), 50, 0.3)
    x, y, ahead = camera.project(v)
    out = [machine.reserve(8 * 50), machine.reserve(8 * 50), machine.reserve(4 * 50)]
    machine.call("st_project", place_vectors(machine, v), 50, place_camera(machine, camera), *out)
    found = machine.read(out[2], np.int32, 50).astype(bool)
    assert (found == ahead).all()
    assert not found[0]
    for place, expected in zip(out, (x, y), strict=False):
        assert (machine.read(place, np.float64, 50)[ahead] == expected[ahead]).all()
    machine.release()


def test_a_direction_beyond_the_fold_is_not_ahead(machine: ArmMachine) -> None:
    folding = CameraGeometry(256, 256, 1500.0, k1=-0.4)  # 1 + 3 k1 r^2 = 0 at r = 0.913
    inside, outside = ([math.sin(a), 0.0, math.cos(a)] for a in (math.atan(0.90), math.atan(0.92)))
    out = [machine.reserve(16), machine.reserve(16), machine.reserve(8)]
    v = place_vectors(machine, [inside, outside])
    machine.call("st_project", v, 2, place_camera(machine, folding), *out)
    assert machine.read(out[2], np.int32, 2).tolist() == [1, 0]


@SHARED_MACHINE
@given(CAMERAS, SEEDS)
def test_the_field_is_the_same(machine: ArmMachine, camera: CameraGeometry, seed: int) -> None:
    v = directions(np.random.default_rng(seed), 200, 0.7 * camera.half_diagonal_rad)
    v[0] = 0.0  # on all four planes
    inside = machine.reserve(4 * 200)
    normals = place_vectors(machine, camera.plane_normals)
    machine.call("st_in_field", place_vectors(machine, v), 200, normals, inside)
    found = machine.read(inside, np.int32, 200).astype(bool)
    machine.release()
    assert (found == camera.in_field(v)).all()
    assert 0 < np.count_nonzero(found) < 200
    if not camera.distorted:  # and then the planes are the image's edges
        x, y, ahead = camera.project(v)
        assert (found == (ahead & camera.in_image(x, y))).all()


@SHARED_MACHINE
@given(CAMERAS, SEEDS, st.sampled_from([0.0, 3.5, -2.0]))
def test_the_image_is_the_same(
    machine: ArmMachine, camera: CameraGeometry, seed: int, border_px: float
) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-20, camera.width_px + 20, 100), rng.uniform(-20, camera.height_px + 20, 100)
    x[:2], y[:2] = border_px - 0.5, camera.height_px - 0.5 - border_px  # on two edges: within
    inside = machine.reserve(400)
    places = place_vectors(machine, x), place_vectors(machine, y)
    machine.call("st_in_image", *places, 100, place_camera(machine, camera), border_px, inside)
    found = machine.read(inside, np.int32, 100).astype(bool)
    machine.release()
    assert (found == camera.in_image(x, y, border_px)).all()
    assert found[0]


def test_counts_predict_the_core_cycles_of_directions(machine: ArmMachine) -> None:
    """Some fields' coefficients foretell others' cycles to a tenth, whatever the distortion."""
    rng = np.random.default_rng(50)
    runs: list[StageRun] = []
    for number in range(60):
        camera = (PINHOLE, BARREL, CUSHION)[number % 3]
        record = unit_vector_record(camera, *places(rng, camera, int(rng.integers(3, 40))))
        runs += UNIT_VECTORS.run(machine, record)
    counts = np.array([[run.work["unit_vectors"], run.work["newton_steps"]] for run in runs], float)
    relative = counts / np.array([run.cost.core_cycles for run in runs], float)[:, None]
    coefficients = np.linalg.lstsq(relative[:30], np.ones(30), rcond=None)[0]
    assert np.abs(relative[30:] @ coefficients - 1.0).max() < 0.10
