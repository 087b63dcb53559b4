"""Frames of a unit that measures its rate without an attitude: the budget sees fusion and rate at work."""

from __future__ import annotations

from st_emulator.budget.memory import memory_of
from st_emulator.budget.scenes import frames_of
from st_emulator.budget.subject import Subject
from st_emulator.firmware_model.modes import Mode
from st_emulator.units.profile import UnitProfile, load_unit, parse_unit, unit_text

SECTION = "\n[rate]\nidentify_below_deg_s = 1.5\n"


def unit() -> UnitProfile:
    return parse_unit(unit_text("aps_rs")[1] + SECTION, "with a rate")


def test_the_frame_lost_in_space_is_fused_with_one_before() -> None:
    lost, tracked = list(frames_of(unit(), seed=4, rate_deg_s=0.5, tracked=1))
    result, steps = lost.traced
    assert [step.step for step in steps][:5] == ["velocity", "detect", "keep_runs", "fuse", "star_rate"]
    assert result.work["fusions"] == 1
    assert result.work["rate_stars"] > 4
    assert result.rate_rad_s is not None
    assert tracked.context.acquisition is Mode.TRACKING
    assert tracked.process().work["fusions"] == 0


def test_other_units_frames_are_what_they_were() -> None:
    lost = next(frames_of(load_unit("aps_rs"), seed=4, rate_deg_s=0.5, tracked=0))
    assert lost.frame.exposure_mid_ns < 200_000_000  # the very first
    assert lost.state.previous is None


def test_what_is_kept_takes_memory() -> None:
    kept = [item for item in memory_of(Subject(unit())).items if "two frames" in item.name]
    assert len(kept) == 1
    assert kept[0].nbytes > 400_000
    assert not [i for i in memory_of(Subject(load_unit("aps_rs"))).items if "two frames" in i.name]
