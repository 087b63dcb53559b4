"""Optical flow from frame to frame on the ARM, equal to the Python stage's to the last bit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.image.lit_pixels import DN_PARTS, FlowFrame, FlowParameters, light_up
from st_emulator.firmware_model.image.optical_flow import OpticalFlow, flow_between
from st_emulator.firmware_model.rate_from_flow import foreseen_shifts
from tools.arm_timing.machine import ArmMachine, Cost
from tools.calibration.steps.lit_pixels import FlowScenes
from tools.calibration.steps.step import MismatchError, StageRun
from tools.calibration.struct_layout import (
    layout_of,
    place_struct,
    read_structs,
    reserve_structs,
)

__all__ = ["STEPS", "FlowStep", "place_lit", "require_equal_flows", "run_flow"]

RATE_ERROR_RAD_S: Final = 5e-4  # of a foreseen rate: about that of the frame before
# What the parameters are drawn from, so that stars, rows and shifts do not go together.
MAX_STARS: Final = (60, 60, 25, 10)
LARGEST_SHIFTS_PX: Final = (40, 40, 25)
PREDICTION_MARGINS_PX: Final = (8, 8, 4, 16)
_BOX = ("first_x", "last_x", "first_y", "last_y")


def place_lit(machine: ArmMachine, frame: FlowFrame) -> int:
    """An st_lit. Its tables are in no cache: between two frames the pixels of one went through it."""
    runs = layout_of(machine, "st_run").pack_array(
        len(frame.runs), row=frame.runs[:, 0], first=frame.runs[:, 1], end=frame.runs[:, 2]
    )
    return place_struct(
        machine,
        "st_lit",
        runs=machine.dma(runs),
        run_background=0,
        offsets=machine.dma(frame.offsets),
        values=machine.dma(frame.values),
        row_start=machine.dma(frame.row_start),
        capacity=len(runs),
        run_count=len(runs),
        lit=len(frame.values),
        level=int(np.floor(frame.mean_dn * DN_PARTS)),
        overflowed=int(frame.overflowed),
        reserved=0,
        mean_dn=frame.mean_dn,
        sigma_dn=frame.sigma_dn,
    )


def _place_stars(machine: ArmMachine, frame: FlowFrame) -> int:
    members: dict[str, Any] = {
        name: getattr(frame, name) for name in ("x_px", "y_px", "flux_dn", "peak_dn", "pixels")
    }
    members |= dict(zip(_BOX, frame.box.T, strict=True))
    layout = layout_of(machine, "st_flow_star")
    return machine.place(layout.pack_array(len(frame), **members, reserved=np.zeros(len(frame), np.int32)))


def run_flow(
    machine: ArmMachine,
    before: FlowFrame,
    after: FlowFrame,
    parameters: FlowParameters,
    foreseen_px: npt.NDArray[np.float64] | None = None,
) -> tuple[OpticalFlow, Cost]:
    """``st_flow_between`` for the arguments of ``optical_flow.flow_between``."""
    reach = parameters.largest_shift_px if foreseen_px is None else parameters.prediction_margin_px
    sides = before.box[:, 1::2] - before.box[:, ::2] + 1
    width, height = (int(np.max(sides[:, axis], initial=1)) for axis in (0, 1))
    layout = layout_of(machine, "st_flow_room")
    room = place_struct(
        machine,
        "st_flow_room",
        **{
            name: machine.reserve(layout.items_bytes(name, count))
            for name, count in {
                "own": len(before.runs),
                "second": len(after.runs),
                "own_start": height + 1,
                "second_start": height + 2 * reach + 1,
                "column_energy": width + 2 * reach,
                "product": 2 * reach + 1,
            }.items()
        },
    )
    search = place_struct(
        machine,
        "st_flow_search",
        reach=reach,
        margin=parameters.margin_px,
        centrings=parameters.centrings,
    )
    image = place_struct(machine, "st_image", pixels=0, rows=before.height_px, columns=before.width_px)
    matches = reserve_structs(machine, "st_flow_match", len(before))
    call = machine.call(
        "st_flow_between",
        image,
        place_lit(machine, before),
        _place_stars(machine, before),
        len(before),
        place_lit(machine, after),
        search,
        0 if foreseen_px is None else machine.place(np.ascontiguousarray(foreseen_px, np.float64)),
        room,
        matches,
    )
    found = read_structs(machine, "st_flow_match", matches, call.result)
    star = found["star"].copy()
    measured = ("x_px", "y_px", "mismatch", "length_px", "noise")
    return OpticalFlow(
        star=star,
        x_before_px=before.x_px[star],
        y_before_px=before.y_px[star],
        **{name: found[name].copy() for name in measured},
    ), call.cost


def require_equal_flows(found: OpticalFlow, expected: OpticalFlow) -> None:
    """MismatchError unless all is the same, to the bit."""
    for field in fields(OpticalFlow):
        ours, theirs = getattr(found, field.name), getattr(expected, field.name)
        if not np.array_equal(ours, theirs):
            raise MismatchError(f"flow: {field.name} is {ours}, {theirs} in Python")


class FlowStep:
    """Stars of one frame looked for in the next."""

    name = "flow"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        """One run, of the stage tracking; none where the frame before has no stars."""
        try:
            found, cost = run_flow(machine, **record.arguments)
        finally:
            machine.release()
        require_equal_flows(found, record.result)
        return [StageRun(self.name, "tracking", cost, record.work)] if record.work.counts else []


def own_records(seed: int, n: int) -> list[StepRecord]:
    """``n`` flows at rates over all of paper F's, with and without a foreseen rate in turn; the same for the
    same seed.
    """
    scenes = FlowScenes(seed)
    rng = np.random.default_rng([seed, 23])
    records = []
    for place in range(n):
        rate, images = scenes.images(place, 2)
        parameters = FlowParameters(
            max_stars=int(rng.choice(MAX_STARS)),
            largest_shift_px=int(rng.choice(LARGEST_SHIFTS_PX)),
            prediction_margin_px=int(rng.choice(PREDICTION_MARGINS_PX)),
        )
        before, after = (light_up(image, parameters)[0] for image in images)
        foreseen = None
        if (place + scenes.number) % 2:
            expected = rate + rng.normal(0.0, RATE_ERROR_RAD_S, 3)
            geometry = scenes.configuration.geometry
            foreseen, _ = foreseen_shifts(before, geometry, expected, scenes.period_ns * 1e-9)
        arguments = {"before": before, "after": after, "parameters": parameters, "foreseen_px": foreseen}
        records.append(StepRecord("flow", arguments, *flow_between(**arguments)))
    return records


STEPS = (FlowStep(),)
