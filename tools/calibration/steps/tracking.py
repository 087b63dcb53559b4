"""Tracking on the ARM: the plan of windows, and verification by the pivot."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from st_emulator.firmware_model.catalogue.star_catalogue import StarCatalogue
from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.geometry import CameraGeometry
from st_emulator.firmware_model.image.spots import WindowSpots
from st_emulator.firmware_model.tracking import TrackingParameters, TrackingPlan
from st_emulator.firmware_model.verification import Verification
from tools.arm_timing.machine import ArmMachine, Call
from tools.calibration.steps.attitude import place_camera
from tools.calibration.steps.detection import packed_spots
from tools.calibration.steps.identification import placed_cells
from tools.calibration.steps.step import MismatchError, StageRun
from tools.calibration.steps.windows import place_rects, read_rects
from tools.calibration.struct_layout import layout_of, place_struct, read_struct

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

_WORD_BYTES = 4


def place_catalogue(machine: ArmMachine, catalogue: StarCatalogue) -> int:
    """An st_catalogue; the tables themselves are placed once and stay."""
    return place_struct(
        machine,
        "st_catalogue",
        cells=placed_cells(machine, catalogue),
        hp_mag=machine.place(catalogue.hp_mag, keep=True),
        stars=len(catalogue),
    )


def place_parameters(
    machine: ArmMachine, parameters: TrackingParameters, geometry: CameraGeometry | None = None
) -> int:
    """An st_tracking_parameters; verification needs no geometry."""
    return place_struct(
        machine,
        "st_tracking_parameters",
        rate_rad_s=parameters.rate_rad_s,
        cos_half_tolerance=math.cos(0.5 * parameters.tolerance_rad),
        sin_half_tolerance=math.sin(0.5 * parameters.tolerance_rad),
        star_radius_px=parameters.star_radius_px,
        magnitude_tolerance=parameters.magnitude_tolerance,
        pixels_per_degree=geometry.pixels_per_degree if geometry else 0.0,
        half_diagonal_rad=geometry.half_diagonal_rad if geometry else 0.0,
        min_stars=parameters.min_stars,
        max_windows=parameters.max_windows,
    )


def _place_room(machine: ArmMachine, struct: str, counts: dict[str, int], **members: int) -> int:
    """A struct of pointers to room for so many; members: what is no pointer."""
    layout = layout_of(machine, struct)
    room = {name: machine.reserve(layout.items_bytes(name, count)) for name, count in counts.items()}
    return place_struct(machine, struct, **room, **members)


def run_plan(
    machine: ArmMachine,
    q_icrs_to_sensor: npt.NDArray[np.float64],
    pivot_star: int,
    catalogue: StarCatalogue,
    geometry: CameraGeometry,
    parameters: TrackingParameters,
    interval_s: float,
    exposure_s: float,
    velocity_over_c: npt.NDArray[np.float64],
) -> tuple[TrackingPlan, Call]:
    """``st_plan_windows`` for the arguments of ``tracking.plan_windows``."""
    stars, most = len(catalogue), parameters.max_windows
    room = _place_room(
        machine,
        "st_plan_room",
        {
            "neighbour": stars,
            "reference": 3 * stars,
            "sensor": 3 * stars,
            "x_px": stars,
            "y_px": stars,
            "flag": stars,
            "place": most + 1,
            "key": most + 1,
        },
        capacity=stars,
    )
    plan = _place_room(
        machine,
        "st_tracking_plan",
        {"star": most, "reference": 3 * most, "x_px": most, "y_px": most, "window": most, "rects": most},
        stars=0,
        windows=0,
        half_width_px=0,
    )
    call = machine.call(
        "st_plan_windows",
        machine.place(q_icrs_to_sensor),
        int(pivot_star),
        place_catalogue(machine, catalogue),
        place_camera(machine, geometry),
        place_parameters(machine, parameters, geometry),
        float(interval_s),
        float(exposure_s),
        machine.place(velocity_over_c),
        plan,
        room,
    )
    planned = read_struct(machine, "st_tracking_plan", plan)
    count = int(planned["stars"])
    return TrackingPlan(
        star=machine.read(int(planned["star"]), np.int32, count),
        reference=machine.read(int(planned["reference"]), np.float64, (count, 3)),
        x_px=machine.read(int(planned["x_px"]), np.float64, count),
        y_px=machine.read(int(planned["y_px"]), np.float64, count),
        window=machine.read(int(planned["window"]), np.int32, count),
        rects=read_rects(machine, int(planned["rects"]), int(planned["windows"])),
        half_width_px=int(planned["half_width_px"]),
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
    """``st_verify_by_pivot`` for the arguments of ``verification.verify_by_pivot``."""
    stars, windows, spots = len(plan.star), len(plan.rects), len(found)
    planned = place_struct(
        machine,
        "st_tracking_plan",
        star=machine.place(plan.star),
        reference=machine.place(plan.reference),
        x_px=machine.place(plan.x_px),
        y_px=machine.place(plan.y_px),
        window=machine.place(plan.window),
        rects=place_rects(machine, plan.rects),
        stars=stars,
        windows=windows,
        half_width_px=plan.half_width_px,
    )
    room = _place_room(
        machine,
        "st_verify_room",
        {
            "trial": stars,
            "distance": stars,
            "low": stars,
            "high": stars,
            "chord": spots,
            "owner": spots,
            "spot_from": windows + 1,
            "in_window": windows,
        },
    )
    chosen = machine.reserve(_WORD_BYTES * stars)
    verified, possible = machine.reserve(_WORD_BYTES), machine.reserve(_WORD_BYTES)
    call = machine.call(
        "st_verify_by_pivot",
        planned,
        place_catalogue(machine, catalogue),
        place_parameters(machine, parameters),
        machine.place(b_vectors),
        machine.place(packed_spots(machine, found.spots)),
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
