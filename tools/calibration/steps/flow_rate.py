"""Angular rate from an optical flow on the ARM: the same bits but for the rate itself, whose arc tangent is
the C library's.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.image.optical_flow import OpticalFlow
from st_emulator.firmware_model.rate_from_flow import FlowRate, rate_from_directions
from st_emulator.firmware_model.work import Work
from tools.arm_timing.machine import ArmMachine, Cost
from tools.calibration.steps.attitude import place_vectors
from tools.calibration.steps.step import MismatchError, StageRun
from tools.calibration.struct_layout import read_struct, reserve_structs

__all__ = ["RATE_BOUND", "STEPS", "FlowRateStep", "ShiftErrorsStep", "run_flow_rate"]

FloatArray = npt.NDArray[np.float64]

RATE_BOUND: Final = 1e-15  # of the rate's length: a last place of the arc tangent
MOST_STARS: Final = 60  # FlowParameters.max_stars
_ROOM_DOUBLES, _ROOM_WORDS = 16, 2  # ST_FLOW_RATE_DOUBLES, ST_FLOW_RATE_WORDS
_DOUBLE_BYTES, _WORD_BYTES = 8, 4
_FOCAL_PX = 3440.0  # of the unit iris
_INTERVAL_S = 0.1


def run_flow_rate(
    machine: ArmMachine,
    before: FloatArray,
    after: FloatArray,
    interval_s: float,
    along_rad: FloatArray,
    across_rad: FloatArray,
    foreseen_rad_s: FloatArray | None = None,
) -> tuple[FlowRate | None, Cost]:
    """``st_flow_rate`` for the arguments of ``rate_from_flow.rate_from_directions``."""
    count = len(before)
    residual, kept = machine.reserve(_DOUBLE_BYTES * count), machine.reserve(_WORD_BYTES * count)
    result = reserve_structs(machine, "st_flow_rate_result")
    call = machine.call(
        "st_flow_rate",
        place_vectors(machine, before),
        place_vectors(machine, after),
        count,
        float(interval_s),
        place_vectors(machine, along_rad),
        place_vectors(machine, across_rad),
        0 if foreseen_rad_s is None else place_vectors(machine, foreseen_rad_s),
        machine.reserve(_ROOM_DOUBLES * _DOUBLE_BYTES * count),
        machine.reserve(_ROOM_WORDS * _WORD_BYTES * count),
        residual,
        kept,
        result,
    )
    if not call.result:
        return None, call.cost
    found = read_struct(machine, "st_flow_rate_result", result)
    return FlowRate(
        found["rate_rad_s"].copy(),
        found["covariance_rad2_s2"].reshape(3, 3).copy(),
        machine.read(residual, np.float64, count),
        machine.read(kept, np.int32, count) != 0,
    ), call.cost


class FlowRateStep:
    """Least squares of the stars' shifts."""

    name = "flow_rate"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        """One run, of the stage attitude; none with too few stars."""
        try:
            found, cost = run_flow_rate(machine, **record.arguments)
        finally:
            machine.release()
        self._compare(found, record.result)
        return [StageRun(self.name, "attitude", cost, record.work)] if record.work.counts else []

    def _compare(self, found: FlowRate | None, expected: FlowRate | None) -> None:
        if found is None or expected is None:
            if found is not expected:
                raise MismatchError(f"{self.name}: the rate is {found}, {expected} in Python")
            return
        for name in ("covariance_rad2_s2", "residual", "kept"):
            ours, theirs = getattr(found, name), getattr(expected, name)
            if not np.array_equal(ours, theirs):
                raise MismatchError(f"{self.name}: {name} is {ours}, {theirs} in Python")
        bound = RATE_BOUND * float(np.linalg.norm(expected.rate_rad_s))
        if not np.all(np.abs(found.rate_rad_s - expected.rate_rad_s) <= bound):
            raise MismatchError(f"{self.name}: rate {found.rate_rad_s}, {expected.rate_rad_s} in Python")


class ShiftErrorsStep:
    """Expected errors of the stars' shifts, after the streaks that a rate makes; the same bits."""

    name = "shift_errors"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        arguments = record.arguments
        count = len(arguments["vectors"])
        streak, along, across = (machine.reserve(_DOUBLE_BYTES * count) for _ in range(3))
        streaks = machine.call(
            "st_streaks",
            place_vectors(machine, arguments["vectors"]),
            count,
            place_vectors(machine, arguments["rate_rad_s"]),
            float(arguments["factor"]),
            streak,
        )
        errors = machine.call(
            "st_shift_errors",
            streak,
            place_vectors(machine, arguments["length_px"]),
            place_vectors(machine, arguments["noise"]),
            count,
            float(arguments["least_px"]),
            along,
            across,
        )
        found = tuple(machine.read(place, np.float64, count) for place in (streak, along, across))
        machine.release()
        for name, ours, theirs in zip(("streak", "along", "across"), found, record.result, strict=True):
            if not np.array_equal(ours, theirs):
                raise MismatchError(f"{self.name}: {name} is {ours}, {theirs} in Python")
        return [StageRun(self.name, "attitude", streaks.cost + errors.cost, record.work)]


def _directions(rng: np.random.Generator) -> dict[str, Any]:
    """Stars of a field that turn between two frames, some of them mismatched."""
    count = int(rng.integers(2, MOST_STARS + 1))
    before = np.column_stack([rng.uniform(-0.18, 0.18, (count, 2)), np.ones(count)])
    before /= np.sqrt((before**2).sum(axis=1, keepdims=True))
    rate = rng.normal(size=3) * np.radians(rng.uniform(0.0, 5.0)) / np.sqrt(3.0)
    along = np.hypot(0.15, rng.uniform(0.0, 2.0) * rng.uniform(size=count)) / _FOCAL_PX
    across = np.full(count, 0.15 / _FOCAL_PX)
    after = before + np.cross(before, rate) * _INTERVAL_S
    after[:, :2] += rng.normal(size=(count, 2)) * across[:, np.newaxis]
    wrong = rng.random(count) < rng.choice([0.0, 0.05, 0.2])
    after[wrong, :2] += rng.normal(0.0, 20.0 / _FOCAL_PX, (int(wrong.sum()), 2))
    after /= np.sqrt((after**2).sum(axis=1, keepdims=True))
    return {
        "before": before,
        "after": after,
        "interval_s": _INTERVAL_S,
        "along_rad": along,
        "across_rad": across,
        "foreseen_rad_s": rate + rng.normal(0.0, 1e-3, 3) if rng.random() < 0.6 else None,
    }


def _errors(rng: np.random.Generator) -> StepRecord:
    given = _directions(rng)
    vectors, count = given["before"], len(given["before"])
    arguments = {
        "vectors": vectors,
        "rate_rad_s": np.radians(rng.uniform(-3.0, 3.0, 3)),
        "factor": 0.08 * _FOCAL_PX,
        "length_px": np.floor(rng.uniform(2.0, 25.0, count)),
        "noise": rng.uniform(0.01, 0.2, count),
        "least_px": 0.1,
    }
    moved = np.cross(vectors, arguments["rate_rad_s"])
    streak = np.sqrt((moved * moved).sum(axis=1)) * arguments["factor"]
    nowhere = np.zeros(count)
    flow = OpticalFlow(
        np.arange(count, dtype=np.int32),
        *(nowhere,) * 5,
        arguments["length_px"],
        arguments["noise"],
    )
    result = (streak, *flow.errors_px(streak, arguments["least_px"]))
    return StepRecord("shift_errors", arguments, result, Work({"shift_errors": count}))


def own_records(seed: int, n: int) -> list[StepRecord]:
    """``n`` rates of stars of random fields, every third only their errors; the same for the same seed."""
    rng = np.random.default_rng([seed, 29])
    records = []
    for place in range(n):
        if place % 3 == 2:
            records.append(_errors(rng))
            continue
        arguments = _directions(rng)
        records.append(StepRecord("flow_rate", arguments, *rate_from_directions(**arguments)))
    return records


STEPS = (FlowRateStep(), ShiftErrorsStep())
