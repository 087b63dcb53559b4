"""Lit pixels and stars of a whole frame on the ARM, equal to the Python stage's to the last bit.

No frame of the calibration's units is lit up as a whole yet: ``own_records`` renders frames of the unit iris.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from st_emulator.firmware_model.configuration import FirmwareConfiguration
from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.image.lit_pixels import FlowFrame, FlowParameters, light_up
from st_emulator.firmware_model.work import COUNTS, Work
from st_emulator.units.profile import load_unit
from st_emulator.world.scene import SceneRenderer
from st_emulator.world.trajectory import ConstantRateTrajectory
from tools.arm_timing.machine import ArmMachine, Cost
from tools.calibration.frames import SkySequence, configured_without_costs, renderer_of
from tools.calibration.steps.detection import STAGES, place_image, read_runs
from tools.calibration.steps.step import MismatchError, StageRun
from tools.calibration.struct_layout import (
    layout_of,
    place_struct,
    read_struct,
    read_structs,
    reserve_structs,
)

__all__ = ["STEPS", "FlowScenes", "LightStep", "require_equal_frames", "run_light_up"]

UNIT: Final = "iris"
MOST_DEG_S: Final = 5.5  # a little over the largest rate of paper F's tables
FALSE_STARS: Final = (0, 0, 60, 250)  # by the number of the sequence
SHARES: Final = (1.0, 0.25, 0.5)  # of a frame's rows that are lit up, in turn
GOLDEN: Final = 0.6180339887498949
_WORD_BYTES = 4
_BOX = ("first_x", "last_x", "first_y", "last_y")


class FlowScenes:
    """Frames of the unit iris at a rate: one sky for each sequence of a seed, evenly spread rates."""

    def __init__(self, seed: int) -> None:
        """seed: that of ``own_records``, the set's times 1000 and the sequence's number."""
        set_seed, number = divmod(seed, 1000)
        self.number = number
        profile = load_unit(UNIT)
        sequence = SkySequence(
            set_seed,
            number,
            UNIT,
            profile.identification.algorithm,
            false_stars=FALSE_STARS[number % len(FALSE_STARS)],
        )
        self._rng = np.random.default_rng([seed, 19])
        self._first = self._rng.uniform()
        self.scene: SceneRenderer = renderer_of(profile, sequence)
        self._q = self.scene.trajectory.q_icrs_to_sensor(0)
        self.configuration = _configuration()
        self.period_ns: int = profile.frame_period_ns

    def images(self, place: int, count: int) -> tuple[npt.NDArray[np.float64], list[npt.NDArray[np.uint16]]]:
        """Rate, rad/s, of the ``place``-th record and so many frames one after another."""
        axis = self._rng.normal(size=3)
        size = MOST_DEG_S * ((self._first + place * GOLDEN) % 1.0)
        rate = np.radians(size) * axis / np.linalg.norm(axis)
        self.scene.trajectory = ConstantRateTrajectory(np.asarray(self._q), rate)
        exposure_ns = self.configuration.exposure_ns
        return rate, [
            self.scene.frame(10 * place + number, number * self.period_ns, exposure_ns).full()
            for number in range(count)
        ]


@lru_cache(maxsize=1)
def _configuration() -> FirmwareConfiguration:
    return configured_without_costs(load_unit(UNIT), {})


def run_light_up(
    machine: ArmMachine, image: npt.NDArray[np.uint16], parameters: FlowParameters
) -> tuple[FlowFrame, dict[str, Cost]]:
    """The kernels of ``lit_pixels.light_up``, stage by stage."""
    rows, columns = image.shape
    picture = place_image(machine, machine.dma(image), (rows, columns))
    layout = layout_of(machine, "st_lit")
    most_lit = int(image.size / (1.0 + parameters.sigma_factor**2)) + 1  # Cantelli
    numbers = dict.fromkeys(("run_count", "lit", "level", "overflowed", "reserved"), 0)
    room = {
        name: machine.reserve(layout.items_bytes(name, count))
        for name, count in {
            "runs": parameters.max_runs,
            "run_background": parameters.max_runs,
            "offsets": parameters.max_runs,
            "values": most_lit,
            "row_start": rows + 1,
        }.items()
    }
    place = place_struct(
        machine, "st_lit", **room, **numbers, capacity=parameters.max_runs, mean_dn=0.0, sigma_dn=0.0
    )
    bits = int(image.max()).bit_length()
    costs = {"threshold": machine.call("st_light_up", picture, parameters.sigma_factor, bits, place).cost}
    lit = read_struct(machine, "st_lit", place)
    count = int(lit["run_count"])

    labels = machine.reserve(_WORD_BYTES * count)
    joining = machine.call("st_join_runs", room["runs"], count, room["row_start"], rows, labels)
    number = joining.result
    table = reserve_structs(machine, "st_cluster", number)
    summing = machine.call(
        "st_sum_clusters", picture, room["runs"], count, room["run_background"], labels, table, number
    )
    costs["clustering"] = joining.cost + summing.cost

    limits = place_struct(
        machine,
        "st_flow_limits",
        min_pixels=parameters.min_pixels,
        max_pixels=parameters.max_pixels,
        max_extent=parameters.max_extent_px,
        max_stars=parameters.max_stars,
    )
    stars = reserve_structs(machine, "st_flow_star", parameters.max_stars)
    order = machine.reserve(2 * _WORD_BYTES * number)
    clusters = 0 if lit["overflowed"] else number
    call = machine.call("st_flow_stars", picture, table, clusters, limits, order, stars)
    costs["centroid"] = call.cost
    found = read_structs(machine, "st_flow_star", stars, call.result)
    return FlowFrame(
        width_px=columns,
        height_px=rows,
        runs=read_runs(machine, room["runs"], count),
        row_start=machine.read(room["row_start"], np.int32, rows + 1),
        offsets=machine.read(room["offsets"], np.int32, count),
        values=machine.read(room["values"], np.int32, int(lit["lit"])),
        x_px=found["x_px"].copy(),
        y_px=found["y_px"].copy(),
        flux_dn=found["flux_dn"].copy(),
        peak_dn=found["peak_dn"].copy(),
        pixels=found["pixels"].copy(),
        box=np.stack([found[name] for name in _BOX], axis=1),
        mean_dn=float(lit["mean_dn"]),
        sigma_dn=float(lit["sigma_dn"]),
        overflowed=bool(lit["overflowed"]),
    ), costs


def require_equal_frames(found: FlowFrame, expected: FlowFrame) -> None:
    """MismatchError unless all is the same, to the bit."""
    for field in fields(FlowFrame):
        ours, theirs = getattr(found, field.name), getattr(expected, field.name)
        if not np.array_equal(np.asarray(ours), np.asarray(theirs)):
            raise MismatchError(f"flow_light: {field.name} is {ours}, {theirs} in Python")


class LightStep:
    """A whole frame's lit pixels, clusters and stars for the optical flow."""

    name = "flow_light"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        """One run each of threshold, clustering and centroid."""
        try:
            found, costs = run_light_up(machine, **record.arguments)
        finally:
            machine.release()
        require_equal_frames(found, record.result)
        return [StageRun(self.name, stage, costs[stage], _part(record.work, stage)) for stage in STAGES]


def _part(work: Work, stage: str) -> Work:
    return Work({name: number for name, number in work.counts.items() if COUNTS[name].stage == stage})


def own_records(seed: int, n: int) -> list[StepRecord]:
    """``n`` frames at rates over all of paper F's, some of them a part of the rows; the same for the same
    seed.
    """
    scenes = FlowScenes(seed)
    records = []
    for place in range(n):
        _, (image,) = scenes.images(place, 1)
        share = SHARES[(place + scenes.number) % len(SHARES)]
        arguments = {"image": image[: int(len(image) * share)], "parameters": FlowParameters()}
        records.append(StepRecord("flow_light", arguments, *light_up(**arguments)))
    return records


STEPS = (LightStep(),)
