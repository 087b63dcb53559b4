"""Faults of the processor: cycles by stage, one table for all frames, what a unit cannot have."""

from __future__ import annotations

from typing import Any, get_args

import pytest

from hil_tests.faults.sensor_bench import reach_of
from hil_tests.unit.conftest import make
from st_emulator.bench.scenario import Scenario
from st_emulator.faults import processor as faults_of_processor
from st_emulator.faults.catalogue import FAULTS
from st_emulator.faults.faults import settings_of
from st_emulator.firmware_model.causes import ResetCause
from st_emulator.firmware_model.processor import ProcessorProfile, ProcessorProfileError
from st_emulator.firmware_model.work import COUNTS, STAGES, Work

PROCESSOR = ProcessorProfile.load("arm926ej_s")
SOME_WORK = Work({name: 1000 + 7 * number for number, name in enumerate(COUNTS)})


def fault_of(table: dict[str, Any], seed: int = 1) -> Any:
    settings = settings_of(table, "test")
    return FAULTS[settings.kind].make(settings, reach_of("roja1"), seed)


@pytest.mark.parametrize("stage", STAGES)
def test_one_stage_takes_so_many_times_as_long(stage: str) -> None:
    slow = fault_of({"kind": "processor.slow_stage", "stage": stage, "factor": 7.0}).processor(PROCESSOR)
    plain, slowed = PROCESSOR.cycles(SOME_WORK), slow.cycles(SOME_WORK)
    for name in STAGES:
        times = 7.0 if name == stage else 1.0
        assert slowed.by_stage[name] == pytest.approx(times * plain.by_stage[name], abs=4)
    low, high = slow.bounds(SOME_WORK)
    assert low.total < slowed.total < high.total
    parts = slow.parts(SOME_WORK)
    assert sum(core + memory for core, memory in parts.values()) == pytest.approx(slowed.total, abs=10)
    for other in (slow.with_clock(100_000_000), slow.with_cache(8), slow.with_line_fill("high")):
        assert other.slow_stages == {stage: 7.0}
    assert slow.with_slow_stage(stage, 2.0).slow_stages == {stage: 14.0}


def test_a_stage_that_there_is_not_is_refused() -> None:
    with pytest.raises(ProcessorProfileError, match="allowed are stages threshold"):
        PROCESSOR.with_slow_stage("cooking", 2.0)
    with pytest.raises(ProcessorProfileError, match="factors over 0"):
        PROCESSOR.with_slow_stage("centroid", float("inf"))


def test_the_settings_name_what_there_is() -> None:
    assert get_args(faults_of_processor.Stage) == STAGES
    assert {name.upper() for name in get_args(faults_of_processor.Cause)} == set(ResetCause.__members__)


def test_clock_and_cache() -> None:
    slower = fault_of({"kind": "processor.slower_clock", "factor": 4.0}).processor(PROCESSOR)
    assert slower.clock_hz == PROCESSOR.clock_hz // 4
    total = slower.cycles(SOME_WORK).total
    assert total < PROCESSOR.cycles(SOME_WORK).total, (
        "the memory keeps its time, fewer cycles of the slower core"
    )
    assert slower.duration_ns(total) > 2 * PROCESSOR.duration_ns(PROCESSOR.cycles(SOME_WORK).total)
    off = fault_of({"kind": "processor.cache_off"}).processor(PROCESSOR)
    assert off.cache_kib == 0
    assert off.cycles(SOME_WORK).total > 5 * PROCESSOR.cycles(SOME_WORK).total


def test_no_table_is_built_for_each_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    built: list[int] = []
    original = ProcessorProfile.__init__

    def counted(self: ProcessorProfile, *args: Any, **kwargs: Any) -> None:
        built.append(1)
        original(self, *args, **kwargs)

    table = {"kind": "processor.slow_stage", "stage": "attitude", "factor": 3.0}
    bench = make(
        "roja1", scenario=Scenario(parameters={"autonomous_start": 1}, faults=[settings_of(table, "test")])
    )
    bench.run_to(1500)
    monkeypatch.setattr(ProcessorProfile, "__init__", counted)
    bench.run(2000)
    assert built == []
    bench.set_parameters(clock_hz=200_000_000)
    bench.run(1000)
    assert 1 <= len(built) <= 6, "anew where parameters changed the processor"
    assert bench.housekeeping(3)["clock_hz"] == 200_000_000


def test_a_frame_that_is_struck() -> None:
    fault = fault_of({"kind": "processor.slower_clock", "probability": 0.5})
    struck = [fault.processor(PROCESSOR) is not PROCESSOR for _ in range(400)]
    assert 140 < sum(struck) < 260
    again = fault_of({"kind": "processor.slower_clock", "probability": 0.5})
    assert [again.processor(PROCESSOR) is not PROCESSOR for _ in range(400)] == struck


def test_chance_of_an_instant() -> None:
    """A reset or a hang that does not strike does nothing."""
    boots = 0
    for seed in range(12):
        bench = make("roja1", scenario=Scenario(parameters={"autonomous_start": 1}))
        bench.run_to(900)
        table = {"kind": "processor.spurious_reset", "probability": 0.5, "seed": seed}
        bench.emulator.faults.inject(table)
        bench.run(500)
        boots += len(bench.events("BOOT_COMPLETED")) - 1
    assert 2 <= boots <= 10


def test_caches_that_nothing_is_known_of_off_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    class Table:
        name = "some_core"
        caches_kib = (16, 32)

    class Processor:
        table = Table()

    monkeypatch.setattr(faults_of_processor, "processor_profile", lambda profile: Processor())
    with pytest.raises(ValueError, match="some_core"):
        fault_of({"kind": "processor.cache_off"})
