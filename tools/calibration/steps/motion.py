"""Streaks of two frames on the ARM: pieces, clusters kept, fusion, rate of the stars, rolling shutter.

Whole numbers are equal; what the C library's atan and hypot take part in differs in a last place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from st_emulator.firmware_model.camera_errors import CentroidError
from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.image.rolling_shutter import RowTiming
from st_emulator.firmware_model.image.streaks import Fusion, StreakTable
from st_emulator.firmware_model.star_rate import EXPECTED_JERK_RAD_S3, StarRate
from st_emulator.firmware_model.work import COUNTS, Work
from tools.arm_timing.machine import ArmMachine, Cost
from tools.calibration.steps.attitude import place_camera, place_vectors
from tools.calibration.steps.motion_records import streak_records
from tools.calibration.steps.step import MismatchError, StageRun
from tools.calibration.struct_layout import (
    layout_of,
    place_struct,
    read_struct,
    read_structs,
    reserve_structs,
)

__all__ = ["PLACE_BOUND_PX", "RATE_BOUND", "STEPS", "own_records", "place_runs"]

RATE_BOUND = 1e-9  # relative to the largest element: a thousand times under any error of a centroid
PLACE_BOUND_PX = 1e-9
_WORD, _DOUBLE = 4, 8
_RATE_SCRATCH_DOUBLES = 7  # ST_RATE_SCRATCH_DOUBLES


def place_runs(machine: ArmMachine, runs: npt.NDArray[np.int32]) -> int:
    """st_run[n] of the Python stage's int32[n, 3]."""
    packed = layout_of(machine, "st_run").pack_array(
        len(runs), row=runs[:, 0], first=runs[:, 1], end=runs[:, 2]
    )
    return machine.place(packed)


def _place_table(machine: ArmMachine, table: StreakTable) -> int:
    return place_struct(
        machine,
        "st_streak_table",
        runs=place_runs(machine, table.runs),
        run_start=machine.place(table.run_start),
        extent=machine.place(table.extent),
        magnitude=place_vectors(machine, table.spots.magnitude),
        count=len(table),
    )


def _place_timing(machine: ArmMachine, timing: RowTiming) -> int:
    return place_struct(
        machine,
        "st_row_timing",
        row_time_s=timing.row_time_s,
        exposure_s=timing.exposure_s,
        period_s=timing.period_s,
        middle_row=timing.middle_row,
    )


def _require_equal(step: str, what: str, found: Any, expected: Any) -> None:
    if not np.array_equal(found, expected):
        raise MismatchError(f"{step}: {what} {found}, {expected} in Python")


def _require_within(step: str, what: str, found: Any, expected: Any, bound: float) -> None:
    off = float(np.max(np.abs(np.asarray(found) - np.asarray(expected)), initial=0.0))
    if not off <= bound:
        raise MismatchError(f"{step}: {what} off by {off:.3g}, {bound:.3g} are allowed")


def _stages(step: str, costs: Mapping[str, Cost], work: Work) -> list[StageRun]:
    runs = []
    for stage, cost in costs.items():
        part = {name: number for name, number in work.counts.items() if COUNTS[name].stage == stage}
        if any(part.values()):
            runs.append(StageRun(step, stage, cost, Work(part)))
    return runs


class KeepRunsStep:
    """The runs of a frame's spots put together: the same table."""

    name = "keep_runs"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        detected, expected = record.arguments["detected"], record.result
        spots, clusters, count = len(detected.spots), len(detected.extent), len(detected.runs)
        kept = reserve_structs(machine, "st_run", count)
        starts, extent = machine.reserve(_WORD * (spots + 1)), machine.reserve(4 * _WORD * spots)
        call = machine.call(
            "st_keep_runs",
            place_runs(machine, detected.runs),
            machine.place(detected.label),
            count,
            machine.place(detected.extent),
            clusters,
            machine.place(detected.cluster.astype(np.int32)),
            spots,
            machine.reserve(_WORD * clusters),
            *(kept, starts, extent),
        )
        found = read_structs(machine, "st_run", kept, call.result)
        runs = np.stack([found[name] for name in ("row", "first", "end")], axis=1)
        _require_equal(self.name, "runs", runs, expected.runs)
        _require_equal(self.name, "starts", machine.read(starts, np.int32, spots + 1), expected.run_start)
        _require_equal(self.name, "extents", machine.read(extent, np.int32, (spots, 4)), expected.extent)
        machine.release()
        return [StageRun(self.name, "clustering", call.cost, record.work)]


class FuseStep:
    """Spots of two frames paired: the same pairs."""

    name = "fuse"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        arguments = record.arguments
        expected: Fusion = record.result
        before, now = arguments["before"], arguments["now"]
        first, second = machine.reserve(_WORD * len(now)), machine.reserve(_WORD * len(now))
        call = machine.call(
            "st_fuse",
            _place_table(machine, before),
            _place_table(machine, now),
            float(arguments["distance_px"]),
            reserve_structs(machine, "st_partner", len(before) + len(now)),
            *(first, second),
        )
        _require_equal(self.name, "before", machine.read(first, np.int32, call.result), expected.before)
        _require_equal(self.name, "now", machine.read(second, np.int32, call.result), expected.now)
        machine.release()
        return [StageRun(self.name, "clustering", call.cost, record.work)]


class _Pairs:
    """Pairs of spots on the ARM: directions, errors, rate."""

    def __init__(self, machine: ArmMachine, first: Any, second: Any, arguments: Mapping[str, Any]) -> None:
        self.machine, self.first, self.second, self.arguments = machine, first, second, arguments

    def rate(self, step: str, expected: StarRate | None) -> dict[str, Cost]:
        machine, arguments, count = self.machine, self.arguments, len(self.second)
        error: CentroidError = arguments["centroid_error"]
        focal = arguments["geometry"].focal_px
        camera = place_camera(machine, arguments["geometry"])
        places = [
            place_vectors(machine, values)
            for values in (self.first.x_px, self.first.y_px, self.second.x_px, self.second.y_px)
        ]
        then, now = machine.reserve(3 * _DOUBLE * count), machine.reserve(3 * _DOUBLE * count)
        pairs = place_struct(
            machine,
            "st_star_pairs",
            **dict(zip(("x_before", "y_before", "x_now", "y_now"), places, strict=True)),
            flux_before=place_vectors(machine, self.first.flux_dn),
            flux_now=place_vectors(machine, self.second.flux_dn),
            count=count,
        )
        model = place_struct(
            machine,
            "st_streak_error",
            floor_px=error.floor_px,
            psf_sigma_px=error.psf_sigma_px,
            electrons_per_dn=error.electrons_per_dn,
            width_px=2.0 * error.half_window_px + 1.0,
            noise_before_dn=self.first.noise_dn,
            noise_now_dn=self.second.noise_dn,
        )
        interval, later, along, across = (machine.reserve(_DOUBLE * count) for _ in range(4))
        kept, residuals = machine.reserve(_WORD * count), machine.reserve(_DOUBLE * count)
        result = reserve_structs(machine, "st_rate_result")
        scratch = machine.reserve(_RATE_SCRATCH_DOUBLES * _DOUBLE * count)
        timing = _place_timing(machine, arguments["timing"])
        least = max(arguments["min_stars"], 2, -(-2 * count // 3))
        cost = machine.call("st_unit_vectors", places[0], places[1], count, camera, then).cost
        cost += machine.call("st_unit_vectors", places[2], places[3], count, camera, now).cost
        errors = machine.call(
            "st_pair_errors", pairs, timing, model, focal, interval, later, along, across
        ).cost
        exposure_s = arguments["timing"].exposure_s
        common = EXPECTED_JERK_RAD_S3 * exposure_s * exposure_s / 24.0
        solving = machine.call(
            "st_star_rate",
            *(then, now, interval, later, along, across, count, common),
            *(arguments["tolerance_px"] / focal, least),
            *(kept, residuals, scratch, result),
        ).cost
        found = read_struct(machine, "st_rate_result", result)
        if bool(found["solved"]) != (expected is not None):
            raise MismatchError(f"{step}: solved is {found['solved']}, {expected is not None} in Python")
        if expected is not None:
            _require_equal(step, "stars kept", machine.read(kept, np.int32, count) != 0, expected.kept)
            for what, values in (
                ("rate_rad_s", expected.rate_rad_s),
                ("covariance", expected.covariance_rad2_s2.ravel()),
                ("change_rad_s2", expected.change_rad_s2),
            ):
                bound = RATE_BOUND * max(float(np.abs(values).max()), 1e-12)
                _require_within(step, what, found[what], values, bound)
        return {"centroid": cost, "attitude": errors + solving}


class StarRateStep:
    """Rate of the fused stars."""

    name = "star_rate"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        arguments = record.arguments
        fusion: Fusion = arguments["fusion"]
        first = arguments["before"].spots.take(fusion.before)
        second = arguments["now"].spots.take(fusion.now)
        costs = _Pairs(machine, first, second, arguments).rate(self.name, record.result)
        machine.release()
        return _stages(self.name, costs, record.work)


class WindowRateStep:
    """Rate of the spots of detection windows from those of the same stars in the frame before."""

    name = "window_rate"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        arguments = record.arguments
        found, window, before = arguments["found"], arguments["window"], arguments["before"]
        windows = int(window.max(initial=-1)) + 1
        place, spot = machine.reserve(_WORD * len(window)), machine.reserve(_WORD * len(window))
        pairing = machine.call(
            "st_pair_windows",
            machine.place(arguments["star"]),
            machine.place(window),
            len(window),
            machine.place(before.row),
            len(before.row),
            machine.place(found.window),
            len(found.window),
            windows,
            machine.reserve(_WORD * windows),
            machine.reserve(_WORD * windows),
            *(place, spot),
        )
        first = before.spots.take(machine.read(place, np.int32, pairing.result))
        second = found.spots.take(machine.read(spot, np.int32, pairing.result))
        costs = _Pairs(machine, first, second, arguments).rate(self.name, record.result)
        machine.release()
        return _stages(self.name, {"tracking": pairing.cost} | costs, record.work)


class CompensateStep:
    """Places by each spot's own velocity."""

    name = "compensate"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        arguments = record.arguments
        if not record.work.counts:
            return []
        before, now, fusion = arguments["before"], arguments["now"], arguments["fusion"]
        x, y = place_vectors(machine, now.spots.x_px), place_vectors(machine, now.spots.y_px)
        call = machine.call(
            "st_compensate",
            place_vectors(machine, before.spots.x_px),
            place_vectors(machine, before.spots.y_px),
            machine.place(fusion.before),
            machine.place(fusion.now),
            len(fusion),
            machine.place(now.extent),
            _place_timing(machine, arguments["timing"]),
            int(arguments["method"] == "streak"),
            float(arguments["least_speed_px_s"]),
            *(x, y),
        )
        _require_equal(self.name, "spots moved", call.result, record.work.counts["spots_moved"])
        for address, places in zip((x, y), record.result, strict=True):
            found = machine.read(address, np.float64, len(places))
            _require_within(self.name, "places", found, places, PLACE_BOUND_PX)
        machine.release()
        return [StageRun(self.name, "centroid", call.cost, record.work)]


class PlacesByRateStep:
    """Places by the rate of all stars."""

    name = "places_by_rate"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        arguments = record.arguments
        if not record.work.counts:
            return []
        count = len(arguments["x_px"])
        x, y = place_vectors(machine, arguments["x_px"]), place_vectors(machine, arguments["y_px"])
        camera = place_camera(machine, arguments["geometry"])
        vectors, turned = machine.reserve(3 * _DOUBLE * count), machine.reserve(3 * _DOUBLE * count)
        timing = _place_timing(machine, arguments["timing"])
        rate = place_vectors(machine, arguments["rate_rad_s"])
        change = place_vectors(machine, arguments["change_rad_s2"])
        ahead = machine.reserve(_WORD * count)
        cost = machine.call("st_unit_vectors", x, y, count, camera, vectors).cost
        cost += machine.call("st_turn_stars", vectors, y, count, rate, change, timing, turned).cost
        cost += machine.call("st_project", turned, count, camera, x, y, ahead).cost
        for address, places in zip((x, y), record.result, strict=True):
            found = machine.read(address, np.float64, count)
            _require_within(self.name, "places", found, places, PLACE_BOUND_PX)
        machine.release()
        return [StageRun(self.name, "centroid", cost, record.work)]


class RateLimitStep:
    """Whether a rate is too high to track."""

    name = "rate_limit"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        arguments = record.arguments
        call = machine.call(
            "st_too_fast",
            place_vectors(machine, arguments["rate_rad_s"]),
            place_vectors(machine, arguments["covariance_rad2_s2"]),
            float(arguments["limit_rad_s"]),
        )
        machine.release()
        _require_equal(self.name, "verdict", bool(call.result), bool(record.result))
        return [StageRun(self.name, "attitude", call.cost, record.work)]


def own_records(seed: int, n: int) -> list[StepRecord]:
    """The records of ``n`` pairs of frames; the same for the same seed."""
    rng = np.random.default_rng([seed, 31])
    return [record for _ in range(n) for record in streak_records(rng)]


STEPS = (
    KeepRunsStep(),
    FuseStep(),
    StarRateStep(),
    WindowRateStep(),
    CompensateStep(),
    PlacesByRateStep(),
    RateLimitStep(),
)
