"""Where a sweep stops fitting, and what is looked at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil_tests.budget.conftest import counts, hand_made
from st_emulator.bench.scenario import InertialTrajectory, Scenario
from st_emulator.budget.assessment import stop_rows
from st_emulator.budget.figures import Costing
from st_emulator.budget.modes import LOST_IN_SPACE, TRACKING, both
from st_emulator.budget.samples import Lost, SkySample, Tracked
from st_emulator.budget.subject import Subject, subject_of
from st_emulator.budget.sweeps import (
    CROWDED,
    FALSE_STARS,
    FRAMES_LOST,
    RATE,
    WINDOWS,
    PointResult,
    Stop,
    random_plan,
    refinements,
    scenario_instants,
    scenario_plan,
    stop_of,
)
from st_emulator.firmware_model.reasons import Reason
from st_emulator.units.profile import load_unit

ROJA1 = Subject(load_unit("roja1"))
# 100 MHz and 1000 cycles a count: 25,000 counts are the 250 ms of a frame
COSTING = Costing(hand_made(core=1000.0, core_uncertainty=0.1))


def sky(flown: int, whole: int, tracked: int, *, holds: bool = True) -> SkySample:
    limit = 0 if flown == whole else int(Reason.WORK_LIMIT)
    lost = Lost(
        counts(runs=1000, votes=flown - 1000),
        limit,
        counts(runs=1000, votes=flown - 1000),
        limit,
        counts(runs=1000, votes=whole - 1000),
        0,
        counts(runs=1000),
        counts(votes=whole - 1000),
        9,
        5,
    )
    reasons = 0 if holds else int(Reason.PIVOT_LOST)
    return SkySample(lost, [Tracked(counts(window_pixels=tracked), reasons, 5, 5, 6, 20, True)])


def point(value: float, *skies: SkySample) -> PointResult:
    return PointResult(value, *both(ROJA1, COSTING, skies))


POINTS = [
    point(0, sky(2000, 2000, 100)),
    point(5, sky(20_000, 20_000, 24_000)),  # at the upper bound 264 ms tracked
    point(10, sky(22_000, 40_000, 26_000)),
    point(20, sky(22_000, 90_000, 26_000, holds=False)),
]


def test_where_it_stops():
    whole = stop_of(POINTS, "whole", LOST_IN_SPACE)
    assert (whole.fits_to, whole.stops_at, whole.stage) == (5, 10, "identification")
    assert (whole.stops_at_low_cost, whole.stops_at_high_cost) == (10, 10)
    flown = stop_of(POINTS, "flown", LOST_IN_SPACE)
    assert (flown.fits_to, flown.stops_at, flown.stage) == (20, None, None)
    tracked = stop_of(POINTS, "flown", TRACKING)
    assert (tracked.fits_to, tracked.stops_at, tracked.stops_at_high_cost) == (5, 10, 5)
    assert tracked.stops_at_low_cost is None  # 234 ms
    assert tracked.stage == "threshold"


def test_one_late_sky_in_fifty_stops_it():
    most = [sky(2000, 2000, 100)] * 49
    points = [point(0, *most), point(5, *most, sky(2000, 30_000, 100))]
    assert points[1].lost.frames == 50
    assert stop_of(points, "whole", LOST_IN_SPACE).stops_at == 5
    assert stop_of(points, "flown", LOST_IN_SPACE).stops_at is None


def test_every_tracked_frame_counts():
    skies = [sky(2000, 2000, number) for number in (100, 200, 300)]
    found = point(0, *skies).tracked
    assert found.frames == 3
    assert found.flown.rows["threshold"].worst.value == 300_000
    assert found.flown.rows["threshold"].median.value == 200_000


def test_what_never_fits():
    late = stop_of([point(0, sky(30_000, 30_000, 1))], "flown", LOST_IN_SPACE)
    assert (late.fits_to, late.stops_at, late.stage) == (None, 0, "identification")


def test_tracking_is_judged_up_to_the_rate_that_it_holds():
    rows = {(row.mode, row.cycles): row for row in stop_rows({RATE: POINTS})}
    assert rows[TRACKING, "flown"].last_value == 10
    assert rows[LOST_IN_SPACE, "flown"].last_value == 20
    assert "holds" in stop_rows({RATE: POINTS[:1]})[-1].text()


def test_searches_that_the_budget_cut_are_counted():
    result = POINTS[2].lost
    assert (result.limited, result.frames, result.of_own_limit) == (1, 1, 0)
    assert POINTS[0].lost.limited == 0


def test_a_closer_look_between_the_last_that_fits_and_the_first_that_does_not():
    stop = Stop(50, 100, 100, 100, "identification")
    values = list(refinements(stop, True))
    assert values == sorted(set(values))
    assert all(50 < value < 100 and value == int(value) for value in values)
    assert len(values) == 5
    assert list(refinements(replace(stop, fits_to=5, stops_at=7), True)) == [6]
    assert list(refinements(replace(stop, stops_at=None), True)) == []
    assert list(refinements(replace(stop, fits_to=None, stops_at=0), True)) == []


def test_the_plan_of_random_skies():
    plan = random_plan(ROJA1, 100, 3)
    assert len(plan.skies) == 100
    found: dict[str, list[float]] = {}
    for item in plan.points:
        found.setdefault(item.sweep, []).append(item.value)
        assert len(item.looks) == 20
    assert found[FALSE_STARS] == [0, 5, 10, 20, 50, 100, 200, 500]
    assert (found[RATE][0], found[RATE][-1]) == (0, 5)
    assert (found[WINDOWS][0], found[WINDOWS][-1]) == (0.1, 10)
    assert found[FRAMES_LOST] == [0, 1, 2]
    assert found[CROWDED] == found[FALSE_STARS]
    for item in plan.points:
        for case in item.looks:
            changed = dict(case.changed)
            if item.sweep == WINDOWS:
                assert changed["tracking_rate_deg_s"] == pytest.approx(item.value)
            if item.sweep in (RATE, WINDOWS):
                assert np.linalg.norm(case.place.rate_deg_s) == pytest.approx(min(item.value, 5.0))
            if item.sweep == CROWDED:
                assert (case.place.false_stars, case.place.frames_lost) == (item.value, 2)
    # the skies of a point are the first ones of the random skies
    assert [case.place.attitude for case in plan.points[0].looks] == [
        case.place.attitude for case in plan.skies[:20]
    ]


def test_instants_of_a_scenario():
    scenario = Scenario(duration_s=10.0, trajectory=InertialTrajectory(ra_deg=10.0, dec_deg=5.0))
    instants = scenario_instants(ROJA1, 20, scenario)
    starts = [item.start_ns for item in instants]
    assert starts == [number * 2 * ROJA1.period_ns for number in range(20)]
    many = scenario_instants(ROJA1, 100, scenario)
    assert len(set(many)) == 100  # two or three at a time, of different noise
    assert max(item.start_ns for item in many) < 10 * 10**9
    assert all(item.start_ns % ROJA1.period_ns == 0 for item in many)
    plan = scenario_plan(ROJA1, 20, scenario)
    assert {item.sweep for item in plan.points} == {FALSE_STARS, WINDOWS, FRAMES_LOST, CROWDED}


def test_parameters_of_a_scenario_are_kept_in_every_point():
    unit = subject_of(load_unit("roja1"), parameters={"tracking_max_missed": 1}, clock_hz=80_000_000)
    plan = random_plan(unit, 5, 1)
    assert [item.value for item in plan.points if item.sweep == FRAMES_LOST] == [0, 1]
    assert all(dict(case.changed)["clock_hz"] == 80_000_000 for case in plan.looks)
