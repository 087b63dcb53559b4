"""Tracking on the ARM: the plan of windows, and verification by the pivot."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from st_emulator.firmware_model.catalogue.star_catalogue import StarCatalogue
from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.geometry import CameraGeometry
from st_emulator.firmware_model.image.spots import WindowSpots
from st_emulator.firmware_model.tracking import TrackingParameters, TrackingPlan, Verification
from tools.arm_timing.machine import ArmMachine, Call
from tools.calibration.steps.attitude import place_camera
from tools.calibration.steps.step import MismatchError, StageRun
from tools.calibration.steps.windows import packed_spots

__all__ = [
    "PLACE_BOUND_PX",
    "REFERENCE_BOUND",
    "STEPS",
    "PlanStep",
    "VerifyStep",
    "compare_plans",
    "compare_verifications",
    "place_catalogue",
    "place_parameters",
    "run_plan",
    "run_verification",
]

PLACE_BOUND_PX = 1e-9  # of a predicted star: the matrix product is summed in another order
REFERENCE_BOUND = 1e-15  # of an element of an apparent direction: the same operations

_PLAN = struct.Struct("<6I3i")  # st_tracking_plan
_WORD_BYTES = 4
_DOUBLE_BYTES = 8
_RECT_BYTES = 16


def place_packed(machine: ArmMachine, form: str, *values: float) -> int:
    """A C struct in the machine's memory, little-endian and packed as ``form`` says; its address."""
    return machine.place(np.frombuffer(struct.pack("<" + form, *values), np.uint8))


def place_catalogue(machine: ArmMachine, catalogue: StarCatalogue) -> int:
    """An st_catalogue; the tables themselves are placed once and stay."""
    cells = catalogue.cells
    return place_packed(
        machine,
        "diIIII4xIi",
        cells.band_height_rad,
        len(cells.band_first_cell) - 1,
        machine.place(cells.band_first_cell, keep=True),
        machine.place(cells.cell_start, keep=True),
        machine.place(cells.cell_star, keep=True),
        machine.place(catalogue.unit_vectors, keep=True),
        machine.place(catalogue.hp_mag, keep=True),
        len(catalogue),
    )


def place_parameters(
    machine: ArmMachine, parameters: TrackingParameters, geometry: CameraGeometry | None = None
) -> int:
    """An st_tracking_parameters; verification needs no geometry."""
    return place_packed(
        machine,
        "7d2i",
        parameters.rate_rad_s,
        math.cos(0.5 * parameters.tolerance_rad),
        math.sin(0.5 * parameters.tolerance_rad),
        parameters.star_radius_px,
        parameters.magnitude_tolerance,
        geometry.pixels_per_degree if geometry else 0.0,
        geometry.half_diagonal_rad if geometry else 0.0,
        parameters.min_stars,
        parameters.max_windows,
    )


def run_plan(
    machine: ArmMachine,
    q_icrs_to_sensor: npt.NDArray[np.float64],
    pivot_star: int,
    catalogue: StarCatalogue,
    geometry: CameraGeometry,
    parameters: TrackingParameters,
    interval_s: float,
    exposure_s: float,
    velocity: npt.NDArray[np.float64],
) -> tuple[TrackingPlan, Call]:
    """``st_plan_windows`` for the arguments of ``tracking.plan_windows``."""
    stars, most = len(catalogue), parameters.max_windows
    room = place_packed(
        machine,
        "8Ii",
        machine.reserve(_WORD_BYTES * stars),
        machine.reserve(3 * _DOUBLE_BYTES * stars),
        machine.reserve(3 * _DOUBLE_BYTES * stars),
        machine.reserve(_DOUBLE_BYTES * stars),
        machine.reserve(_DOUBLE_BYTES * stars),
        machine.reserve(_WORD_BYTES * stars),
        machine.reserve(_WORD_BYTES * (most + 1)),
        machine.reserve(_WORD_BYTES * (most + 1)),
        stars,
    )
    sizes = (
        _WORD_BYTES,
        3 * _DOUBLE_BYTES,
        _DOUBLE_BYTES,
        _DOUBLE_BYTES,
        _WORD_BYTES,
        _RECT_BYTES,
    )
    star, reference, x, y, window, rects = (machine.reserve(size * most) for size in sizes)
    plan = place_packed(machine, "6I3i", star, reference, x, y, window, rects, 0, 0, 0)
    call = machine.call(
        "st_plan_windows",
        machine.place(q_icrs_to_sensor),
        int(pivot_star),
        place_catalogue(machine, catalogue),
        place_camera(machine, geometry),
        place_parameters(machine, parameters, geometry),
        float(interval_s),
        float(exposure_s),
        machine.place(velocity),
        plan,
        room,
    )
    *_, count, windows, half = _PLAN.unpack(machine.read(plan, np.uint8, _PLAN.size).tobytes())
    return TrackingPlan(
        machine.read(star, np.int32, count),
        machine.read(reference, np.float64, (count, 3)),
        machine.read(x, np.float64, count),
        machine.read(y, np.float64, count),
        machine.read(window, np.int32, count),
        machine.read(rects, np.int32, (windows, 4)),
        half,
    ), call


def compare_plans(found: TrackingPlan, expected: TrackingPlan) -> None:
    """MismatchError unless both have the same stars and windows, at the same places within the bounds."""
    for name in ("star", "window", "rects", "half_width_px"):
        ours, theirs = getattr(found, name), getattr(expected, name)
        if not np.array_equal(ours, theirs):
            raise MismatchError(f"plan: {name} is {ours}, {theirs} in Python")
    for name, bound in (("x_px", PLACE_BOUND_PX), ("y_px", PLACE_BOUND_PX), ("reference", REFERENCE_BOUND)):
        off = float(np.max(np.abs(getattr(found, name) - getattr(expected, name)), initial=0.0))
        if not off <= bound:
            raise MismatchError(f"plan: {name} is off by {off:.3g}, {bound:.3g} are allowed")


def run_verification(
    machine: ArmMachine,
    plan: TrackingPlan,
    found: WindowSpots,
    b_vectors: npt.NDArray[np.float64],
    catalogue: StarCatalogue,
    parameters: TrackingParameters,
) -> tuple[Verification, Call]:
    """``st_verify_by_pivot`` for the arguments of ``tracking.verify_by_pivot``."""
    stars, windows, spots = len(plan.star), len(plan.rects), len(found)
    planned = place_packed(
        machine,
        "6I3i",
        machine.place(plan.star),
        machine.place(plan.reference),
        machine.place(plan.x_px),
        machine.place(plan.y_px),
        machine.place(plan.window),
        machine.place(plan.rects),
        stars,
        windows,
        plan.half_width_px,
    )
    room = place_packed(
        machine,
        "8I",
        machine.reserve(_WORD_BYTES * stars),
        machine.reserve(_DOUBLE_BYTES * stars),
        machine.reserve(_DOUBLE_BYTES * stars),
        machine.reserve(_DOUBLE_BYTES * stars),
        machine.reserve(_DOUBLE_BYTES * spots),
        machine.reserve(_WORD_BYTES * spots),
        machine.reserve(_WORD_BYTES * (windows + 1)),
        machine.reserve(_WORD_BYTES * windows),
    )
    chosen = machine.reserve(_WORD_BYTES * stars)
    verified, possible = machine.reserve(_WORD_BYTES), machine.reserve(_WORD_BYTES)
    call = machine.call(
        "st_verify_by_pivot",
        planned,
        place_catalogue(machine, catalogue),
        place_parameters(machine, parameters),
        machine.place(b_vectors),
        machine.place(packed_spots(found.spots)),
        machine.place(found.window),
        spots,
        chosen,
        verified,
        possible,
        room,
    )
    return Verification(
        machine.read(chosen, np.int32, stars),
        int(np.int32(np.uint32(call.result))),
        int(machine.read(verified, np.int32, 1)[0]),
        int(machine.read(possible, np.int32, 1)[0]),
    ), call


def compare_verifications(found: Verification, expected: Verification) -> None:
    """MismatchError unless both gave the same stars the same spots."""
    for name in ("pivot", "verified", "found", "spot"):
        ours, theirs = getattr(found, name), getattr(expected, name)
        if not np.array_equal(ours, theirs):
            raise MismatchError(f"verify: {name} is {ours}, {theirs} in Python")


class PlanStep:
    """Steps 1 and 2 of tracking; the aberration of its stars is part of the run."""

    name = "plan"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        """One run of the stage tracking."""
        try:
            plan, call = run_plan(machine, **record.arguments)
        finally:
            machine.release()
        compare_plans(plan, record.result)
        return [StageRun(self.name, "tracking", call.cost, record.work)]


class VerifyStep:
    """Step 5 of tracking."""

    name = "verify"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        """One run of the stage tracking."""
        try:
            verification, call = run_verification(machine, **record.arguments)
        finally:
            machine.release()
        compare_verifications(verification, record.result)
        return [StageRun(self.name, "tracking", call.cost, record.work)]


STEPS = (PlanStep(), VerifyStep())
