"""Streaks, fusion, star rate and rolling shutter in C: what the Python stages give on made-up skies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from st_emulator.firmware_model.frame_trace import StepRecord
from tools.arm_timing.machine import ArmMachine
from tools.calibration.registry import steps_by_name
from tools.calibration.steps.motion import STEPS, own_records
from tools.calibration.steps.step import MismatchError

NAMES = {step.name for step in STEPS}


@pytest.fixture(scope="module")
def records() -> list[StepRecord]:
    return own_records(4, 12)


@pytest.mark.parametrize("name", ["detect", *sorted(NAMES)])
def test_the_kernels_give_what_python_gives(
    machine: ArmMachine, records: list[StepRecord], name: str
) -> None:
    """And every count of a record is in one of the runs that its cost is split into."""
    step = steps_by_name()[name]
    mine = [record for record in records if record.step == name]
    assert len(mine) >= 12
    for record in mine:
        runs = step.run(machine, record)
        counted: dict[str, int] = {}
        for run in runs:
            assert run.cost.core_cycles > 0
            for count, number in run.work.counts.items():
                counted[count] = counted.get(count, 0) + number
        assert counted == {count: number for count, number in record.work.counts.items() if count in counted}
        missing = {c for c, number in record.work.counts.items() if number and c not in counted}
        assert not missing


def test_the_records_exercise_every_case(records: list[StepRecord]) -> None:
    """Streaks and spots, rates and none, both centroids, stars left out."""
    of = {name: [r for r in records if r.step == name] for name in ("detect", *NAMES)}
    assert {r.work["piece_runs"] > 0 for r in of["detect"]} == {True, False}
    assert {r.work["energies"] > 0 for r in of["detect"]} == {True, False}
    assert any(r.result is not None and not r.result.kept.all() for r in of["star_rate"])
    assert any(r.result is not None for r in of["window_rate"])
    assert {bool(r.result) for r in of["rate_limit"]} == {True}


def test_another_result_is_a_mismatch(machine: ArmMachine, records: list[StepRecord]) -> None:
    fused = next(r for r in records if r.step == "fuse" and len(r.result) > 2)
    wrong = replace(fused.result, now=fused.result.now[::-1].copy())
    with pytest.raises(MismatchError, match="now"):
        steps_by_name()["fuse"].run(machine, replace(fused, result=wrong))
    machine.release()
    rated = next(r for r in records if r.step == "star_rate" and r.result is not None)
    off = replace(rated.result, rate_rad_s=rated.result.rate_rad_s * (1.0 + 1e-6))
    with pytest.raises(MismatchError, match="rate_rad_s"):
        steps_by_name()["star_rate"].run(machine, replace(rated, result=off))
    assert np.isfinite(off.rate_rad_s).all()
