"""Frames of a unit that measures its rate without an attitude: the budget sees fusion and rate at work."""

from __future__ import annotations

from st_emulator.budget.memory import memory_of
from st_emulator.budget.scenes import frames_of
from st_emulator.budget.subject import Subject
from st_emulator.firmware_model.modes import Mode
from st_emulator.units.profile import load_unit

WITH_RATE, WITHOUT = "aps_rs", "zy3"


def test_the_frame_lost_in_space_is_fused_with_one_before() -> None:
    lost, tracked = list(frames_of(load_unit(WITH_RATE), seed=4, rate_deg_s=0.5, tracked=1))
    result, steps = lost.traced
    assert [step.step for step in steps][:5] == ["velocity", "detect", "keep_runs", "fuse", "star_rate"]
    assert result.work["fusions"] == 1
    assert result.work["rate_stars"] > 4
    assert result.rate_rad_s is not None
    assert tracked.context.acquisition is Mode.TRACKING
    assert tracked.process().work["fusions"] == 0


def test_other_units_frames_are_what_they_were() -> None:
    lost = next(frames_of(load_unit(WITHOUT), seed=4, rate_deg_s=0.5, tracked=0))
    assert lost.frame.exposure_mid_ns < 200_000_000  # the very first
    assert lost.state.previous is None


def test_what_is_kept_takes_memory() -> None:
    kept = [item for item in memory_of(Subject(load_unit(WITH_RATE))).items if "two frames" in item.name]
    assert len(kept) == 1
    assert kept[0].nbytes > 400_000
    assert not [i for i in memory_of(Subject(load_unit(WITHOUT))).items if "two frames" in i.name]
