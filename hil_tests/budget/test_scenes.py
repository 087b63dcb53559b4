"""Frames for a budget: pure functions of their conditions, with the state that the firmware would have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from st_emulator.budget.scenes import Conditions, FrameInputs, frames_of, frames_under, random_conditions
from st_emulator.firmware_model.modes import Mode
from st_emulator.firmware_model.work import Work
from st_emulator.world import quaternion

ORION = (0.3, 0.2, -0.4, 0.8)


def pixels(inputs: FrameInputs) -> np.ndarray:
    return inputs.frame.full()


def test_frames_are_the_same_whatever_was_rendered_between(roja1):
    first, second = random_conditions(2, 5, rate_deg_s=1.0, false_stars=20)
    alone = [pixels(item).copy() for item in frames_under(roja1, first, tracked=0)]
    one = list(frames_under(roja1, first, tracked=0))
    other = list(frames_under(roja1, replace(second, hot_pixel_fraction=0.01), tracked=0))
    pixels(other[0])
    assert np.array_equal(pixels(one[0]), alone[0])
    assert not np.array_equal(pixels(other[0]), alone[0])


def test_the_first_skies_of_a_seed_stay(roja1):
    assert random_conditions(3, 7) == random_conditions(20, 7)[:3]
    assert random_conditions(3, 7) != random_conditions(3, 8)
    rates = [np.linalg.norm(item.rate_deg_s) for item in random_conditions(5, 7, rate_deg_s=2.5)]
    assert rates == pytest.approx([2.5] * 5)


def test_lost_in_space_then_tracked_from_what_was_found(roja1):
    frames = list(frames_of(roja1, seed=1, skies=1, tracked=2))
    assert [item.context.acquisition for item in frames] == [
        Mode.LOST_IN_SPACE,
        Mode.TRACKING,
        Mode.TRACKING,
    ]
    result = frames[0].process()
    assert result.valid
    assert np.array_equal(frames[1].state.q_icrs_to_sensor, result.q_icrs_to_sensor)
    assert frames[1].acquired
    assert frames[1].context.t_mid_ns - frames[0].context.t_mid_ns == roja1.frame_period_ns
    assert all(item.process().valid for item in frames[1:])


def test_after_a_frame_without_attitude_the_true_one_is_tracked(roja1):
    frames = list(frames_of(roja1, seed=1, skies=1, tracked=1, false_stars=500))
    assert not frames[0].process().valid
    tracked = frames[1]
    assert not tracked.acquired
    conditions = tracked.conditions
    assert conditions is not None
    error = quaternion.error_rotation_vector(tracked.state.q_icrs_to_sensor, np.array(conditions.attitude))
    assert np.linalg.norm(error) < 1e-12
    # a pivot as an own attitude would have left it: the brightest catalogue star in the field
    row = tracked.state.pivot
    in_field = (
        tracked.tables.catalogue.unit_vectors[row]
        @ quaternion.attitude_matrix(np.array(conditions.attitude)).T
    )
    assert in_field[2] > np.cos(np.radians(roja1.diagonal_deg / 2))


def test_frames_lost_widen_the_windows(roja1):
    half = []
    for lost in (0, 1, 2):
        frames = list(frames_of(roja1, seed=1, skies=1, tracked=1, frames_lost=lost))
        gap = frames[1].context.t_mid_ns - frames[0].context.t_mid_ns
        assert gap == (lost + 1) * roja1.frame_period_ns
        assert frames[1].state.missed == lost
        half.append(frames[1].process().window_half_width_px)
    assert half[0] < half[1] < half[2]


def test_the_sky_turns_at_the_rate(roja1):
    still = Conditions(ORION)
    moving = Conditions(ORION, rate_deg_s=(0.0, 2.0, 0.0))
    path = {}
    for name, conditions in (("still", still), ("moving", moving)):
        frame = next(frames_under(roja1, conditions, tracked=0)).frame
        path[name] = frame.light.xs[:, -1] - frame.light.xs[:, 0]
    assert np.all(path["still"] == 0)
    # 2 deg/s for 0.1 s, first to last middle of a sub-step
    wanted = np.radians(2.0) * 0.1 * roja1.focal_px
    assert np.median(np.abs(path["moving"])) == pytest.approx(wanted, rel=0.06)


def test_conditions_of_the_detector(roja1):
    dark = next(frames_under(roja1, Conditions(ORION), tracked=0))
    light = next(frames_under(roja1, Conditions(ORION, stray_electrons_s=20_500.0), tracked=0))
    more = 20_000.0 * 0.1 / roja1.detector.electrons_per_dn
    assert np.median(pixels(light)) - np.median(pixels(dark)) == pytest.approx(more, rel=0.02)
    hot = next(frames_under(roja1, Conditions(ORION, hot_pixel_fraction=0.05), tracked=0))
    assert np.mean(pixels(hot) > np.median(pixels(dark)) + 100) > 0.01


def test_false_stars_are_as_many_as_asked_for(roja1):
    frame = next(frames_under(roja1, Conditions(ORION, false_stars=37), tracked=0)).frame
    assert len(frame.light.false_spots) == 37
    other = next(frames_under(roja1, Conditions(ORION, false_stars=37, noise=1), tracked=0)).frame
    assert not np.array_equal(other.light.false_spots, frame.light.false_spots)


def test_without_limit_a_search_goes_on(roja1):
    slow = {"clock_hz": 8_000_000}
    limited = list(frames_of(roja1, seed=2, skies=2, tracked=0, false_stars=100, parameters=slow))
    whole = list(
        frames_of(roja1, seed=2, skies=2, tracked=0, false_stars=100, parameters=slow, search_limit=False)
    )

    def steps(inputs: FrameInputs) -> int:
        return inputs.process().work.operations()

    assert all(steps(a) < steps(b) for a, b in zip(limited, whole, strict=True))


def test_a_trace_adds_up_to_the_frames_work(roja1):
    inputs = next(frames_of(roja1, seed=1, skies=1))
    records = []
    result = inputs.process(records.append)
    total = Work({"frames": 1})
    for record in records:
        total += record.work
    assert total == result.work
