"""Faults of the clock: together, live, and that nothing is left behind but the error."""

from __future__ import annotations

from typing import Any

import pytest

from hil_tests.unit.conftest import MS, Bench, make
from st_emulator.bench.scenario import Scenario
from st_emulator.clock import NS_PER_S
from st_emulator.device.onboard_time import TURNOVER_NS, OnboardTime

TAI_NS = 2_100_000_000 * NS_PER_S


def inject(bench: Bench, kind: str, **settings: Any) -> int:
    return bench.emulator.faults.inject({"kind": kind} | settings)


def read_ns(bench: Bench) -> int:
    return bench.emulator.device.time.tai_ns(bench.emulator.now_ns)


def test_drifts_add_up_and_end_alone() -> None:
    bench = make().boot()
    begin_ns = bench.emulator.now_ns
    inject(bench, "clock.drift", ppm=100.0, duration_s=4.0)
    number = inject(bench, "clock.drift", ppm=-30.0)
    bench.run(2000)
    assert read_ns(bench) == bench.emulator.now_ns + 140_000
    bench.emulator.faults.clear(number)
    bench.run(1000)
    assert read_ns(bench) == bench.emulator.now_ns + 240_000
    bench.run(5000)
    assert read_ns(bench) == bench.emulator.now_ns + 340_000
    assert bench.emulator.now_ns == begin_ns + 8000 * MS


def test_a_set_time_drifts_from_when_it_was_latched() -> None:
    bench = make().boot()
    inject(bench, "clock.drift", ppm=1000.0)
    bench.send("set_time", {"time": (2_100_000_000, 0)})
    bench.run(10)
    latched_ns = bench.emulator.device.time._latched_ns
    bench.run(3000)
    passed = bench.emulator.now_ns - latched_ns
    assert read_ns(bench) == TAI_NS + passed + passed * 1_000_000 // 10**9


@pytest.mark.parametrize(("kind", "drifts"), [(0, True), (1, True)])
def test_through_a_reset(kind: int, drifts: bool) -> None:
    """A cold reset counts from zero, a warm one keeps the error; both go on drifting."""
    bench = make().boot()
    inject(bench, "clock.drift", ppm=1000.0)
    inject(bench, "clock.jump", seconds=50.0)
    bench.run(1000)
    before = read_ns(bench)
    bench.function("RESET", {"kind": kind}, ack=0)
    bench.run(2000)
    event = next(one for one in bench.packets if one.fields.get("event_id") == 1 and one.t_ns > 900 * MS)
    assert event.fields["data"]["reset_cause"] in (1, 2)
    warm = event.fields["data"]["reset_cause"] == 1
    assert (read_ns(bench) > before) is warm
    first = read_ns(bench)
    bench.run(1000)
    assert abs(read_ns(bench) - first - 1_001_000_000) <= 1


def test_back_beyond_zero_it_turns_over() -> None:
    bench = make().boot()
    inject(bench, "clock.jump", seconds=-(10.0**9))
    now_ns = bench.emulator.now_ns
    assert read_ns(bench) == (now_ns - 10**18) % TURNOVER_NS
    assert bench.housekeeping(1)["time_status"] == 0


def test_times_before_a_drift_began_have_none() -> None:
    time = OnboardTime()
    time.drift(1_000_000, 5 * NS_PER_S)
    assert time.tai_ns(4 * NS_PER_S) == 4 * NS_PER_S
    assert time.tai_ns(6 * NS_PER_S) == 6 * NS_PER_S + 1_000_000


def test_a_setting_that_waits_is_superseded_and_discarded_as_ever() -> None:
    bench = make().boot()
    inject(bench, "clock.missed_sync", duration_s=5.0)
    first = bench.send("set_time", {"time": (2_100_000_000, 0)})
    bench.run(600)
    second = bench.send("set_time", {"time": (2_100_000_007, 0)})
    bench.run(600)
    assert bench.stages(first)[-1] == "completion_failure"
    assert bench.stages(second)[-1] == "start_success"
    bench.run(4500)
    assert bench.stages(second)[-1] == "completion_success"
    assert 2_100_000_011 <= read_ns(bench) / NS_PER_S <= 2_100_000_013


def test_chance_is_asked_only_while_a_time_waits() -> None:
    """So that a run without settings is the same with the fault."""
    runs = []
    for faults in ([], [{"kind": "clock.missed_sync", "probability": 0.5}]):
        bench = make(scenario=Scenario(parameters={"autonomous_start": 1}, faults=faults))
        bench.run(3000)
        runs.append(bench.groups)
        assert bench.emulator.faults.active() != [] or not faults
        for one in bench.emulator.faults.active():
            assert one.fault.random.getstate() == type(one.fault.random)(one.fault.seed).getstate()
    assert runs[0] == runs[1]


def test_some_frames_are_missed_and_then_one_is_not() -> None:
    waits = []
    for seed in range(12):
        bench = make().boot()
        inject(bench, "clock.missed_sync", probability=0.5, seed=seed)
        count = bench.send("set_time", {"time": (2_100_000_000, 0)})
        bench.run_until(lambda bench=bench, count=count: "completion_success" in bench.stages(count), 8000)
        waits.append(round(bench.now_ms / 250))
    assert len(set(waits)) > 2
