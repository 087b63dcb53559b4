"""Frames of the calibration, the steps that have kernels, and how a case is run."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from st_emulator.campaigns.bench import random_pointings
from st_emulator.errors import ConfigurationError
from st_emulator.firmware_model.frame_trace import STEPS, StepRecord
from st_emulator.firmware_model.identification.algorithms import ALGORITHMS
from st_emulator.firmware_model.processor import ProcessorProfile
from st_emulator.firmware_model.work import Work
from tools.arm_timing.cost import Cost
from tools.arm_timing.errors import ArmError
from tools.calibration import frames, simulation
from tools.calibration.calibration import KernelError, Plan, _joined
from tools.calibration.frames import (
    FIT,
    HELD_OUT,
    IDENTIFY,
    LOST_IN_SPACE,
    TRACKING,
    UNITS,
    FrameRecords,
    SkySequence,
    records_of,
    sequences,
)
from tools.calibration.registry import steps_of
from tools.calibration.simulation import Case, Simulated, simulate
from tools.calibration.steps.step import MismatchError, StageRun


def test_the_first_sequences_stay_the_same():
    assert sequences(40, FIT)[:12] == sequences(12, FIT)
    assert sequences(12, FIT) != sequences(12, HELD_OUT)


def test_fitted_and_held_out_skies_are_others():
    fitted, held_out = random_pointings(120, FIT), random_pointings(40, HELD_OUT)
    apart = np.degrees(2 * np.arccos(np.clip(np.abs(fitted @ held_out.T), 0, 1)))
    assert apart.min() > 1.0


def test_conditions_cover_what_is_asked_for():
    fitted, held_out = sequences(120, FIT), sequences(40, HELD_OUT)
    for drawn in (fitted, held_out):
        assert {item.unit for item in drawn} == set(UNITS)
        assert {item.algorithm for item in drawn} == set(ALGORITHMS)
        assert {item.centroid for item in drawn} == {"com", "gaussian"}
        assert any(item.frames_lost for item in drawn)
        assert any(item.stray_share > 1 for item in drawn)
    assert {item.false_stars for item in fitted} == {0, 5, 30, 120, 500}
    assert {item.false_stars for item in held_out} == {0, 1, 12, 60, 250}
    rates = [float(np.linalg.norm(item.rate_deg_s)) for item in fitted]
    assert max(rates) == pytest.approx(5.0)
    windows = {dict(item.parameters).get("tracking_rate_deg_s") for item in fitted if item.unit == "zy3"}
    assert windows == {None, 0.3, 1.0, 2.0}


@pytest.fixture(scope="module")
def sky():
    return SkySequence(FIT, 0, "roja1", "multi_poles", tracked=1)


@pytest.fixture(scope="module")
def records(sky):
    return list(records_of(sky))


def test_a_sequence_is_searched_tracked_and_identified_by_all(records):
    assert [item.kind for item in records] == [LOST_IN_SPACE, TRACKING, IDENTIFY, IDENTIFY, IDENTIFY]
    searched, tracked = ([step.step for step in item.steps] for item in records[:2])
    assert searched[:4] == ["velocity", "detect", "unit_vectors", "identify"]
    assert tracked[:4] == ["velocity", "plan", "windows", "unit_vectors"]
    used = {item.steps[-1].arguments["algorithm"] for item in records[2:]}
    used.add(next(s for s in records[0].steps if s.step == IDENTIFY).arguments["algorithm"])
    assert used == set(ALGORITHMS.values())


def test_no_search_has_a_limit_from_the_cycle_costs(records, sky, monkeypatch):
    """A frame's work is the same whatever the processor costs: the calibration does not feed on itself."""
    for item in records:
        for step in item.steps:
            if step.step == IDENTIFY:
                assert step.arguments["parameters"].max_cycles == np.inf
    before = [[step.work for step in item.steps] for item in records]

    def no_costs(source):
        raise AssertionError(f"cycle costs {source} were looked at")

    monkeypatch.setattr(ProcessorProfile, "load", staticmethod(no_costs))
    assert [[step.work for step in item.steps] for item in records_of(sky)] == before


def test_an_identification_that_takes_too_long_is_left_out(sky, records, monkeypatch):
    monkeypatch.setattr(frames, "MOST_STEPS", 10)
    short = list(records_of(sky))
    assert short[0].left_out
    assert [step.step for step in short[0].steps] == [
        step.step for step in records[0].steps if step.step != IDENTIFY
    ]
    assert [item.kind for item in short] == [LOST_IN_SPACE, TRACKING]


@dataclass
class FakeStep:
    name: str

    def run(self, machine, record):
        if record.arguments.get("wrong"):
            raise MismatchError("x_px is 3.0, 4.0 in Python")
        if record.arguments.get("stuck"):
            raise ArmError("at 0x10000 (st_plan): still running")
        sizes = dict.fromkeys((32, 16, 8, 4), 7)
        number = record.arguments["number"]
        FakeMachine.used.append(f"run {number}")
        cost = Cost(number, 2 * number, sizes, sizes, 3, number, sizes, {"alu": number}, 0)
        return [StageRun(self.name, "tracking", cost, record.work)]


def test_steps_are_found_in_the_families():
    found = steps_of({"a": SimpleNamespace(STEPS=(FakeStep("plan"),))}, ("plan",))
    assert set(found) == {"plan"}


def test_missing_steps_are_named():
    modules = {"a": SimpleNamespace(STEPS=(FakeStep("plan"), FakeStep("rate")))}
    with pytest.raises(
        ConfigurationError, match=r"no kernels for: velocity, detect, windows.*there are plan, rate"
    ):
        steps_of(modules, [name for name in STEPS if name in ("velocity", "detect", "plan", "windows")])


def test_a_step_that_two_families_have_is_named():
    modules = {
        "a": SimpleNamespace(STEPS=(FakeStep("plan"),)),
        "b": SimpleNamespace(STEPS=(FakeStep("plan"),)),
    }
    with pytest.raises(ConfigurationError, match=r"'plan' is in a\.py and in b\.py"):
        steps_of(modules, ())


class FakeMachine:
    """Says in which order it was used."""

    used: list[str] = []  # noqa: RUF012

    def __init__(self, elf):
        FakeMachine.used = []

    def flush_caches(self):
        FakeMachine.used.append("flush")


def record(number, **arguments):
    return StepRecord("plan", {"number": number, **arguments}, None, Work({"pivots_tried": number}))


@pytest.fixture
def with_fakes(monkeypatch):
    """A processor that only counts, and the frames that a test gives."""

    def use(*given):
        monkeypatch.setattr(simulation, "ArmMachine", FakeMachine)
        monkeypatch.setattr(simulation, "steps_by_name", lambda: {"plan": FakeStep("plan")})
        monkeypatch.setattr(simulation, "records_of", lambda sky: iter(given))

    return use


def test_samples_of_a_case(with_fakes, sky):
    with_fakes(
        FrameRecords(0, LOST_IN_SPACE, (record(5), record(6)), left_out=True),
        FrameRecords(1, TRACKING, (record(7),)),
        FrameRecords(1000, IDENTIFY, (record(8),)),
    )
    found = simulate("kernels.elf", Case(3, sky))
    assert [(s.sequence, s.frame, s.kind) for s in found.samples] == [
        (3, 0, LOST_IN_SPACE),
        (3, 0, LOST_IN_SPACE),
        (3, 1, TRACKING),
        (3, 1000, IDENTIFY),
    ]
    assert found.left_out == (0,)
    assert found.failure == ""
    last = found.samples[-1]
    assert last.counts == (("pivots_tried", 8),)
    assert (last.value("core_cycles"), last.value("instructions")) == (16, 8)
    assert (last.value("accesses"), last.value("line_fills_8")) == (11, 14)
    assert last.classes == (("alu", 8),)
    # the last frame first, so that nothing is cold; and what is no frame as after a full frame's pixels
    assert FakeMachine.used == ["run 7", "run 5", "run 6", "run 7", "flush", "run 8"]


@pytest.mark.parametrize(
    ("fault", "says"), [("wrong", "MismatchError: x_px is 3.0"), ("stuck", "ArmError: at 0x10000")]
)
def test_a_wrong_kernel_fails_its_case_and_is_named(with_fakes, sky, fault, says):
    with_fakes(FrameRecords(0, TRACKING, (record(5), record(6, **{fault: True}))))
    found = simulate("kernels.elf", Case(0, sky))
    assert found.samples == ()
    assert "roja1, multi_poles, sky 0 of 926" in found.failure
    assert f"frame 0, step plan: {says}" in found.failure
    with pytest.raises(KernelError, match="1 of 2 sequences failed") as raised:
        _joined([Case(0, sky), Case(1, sky)], [Simulated(()), found])
    assert says in str(raised.value)


def test_a_plan_has_the_same_cases_each_time():
    plan = Plan(30, 9)
    assert plan.cases(FIT) == plan.cases(FIT)
    skies = [case.sky for case in plan.cases(FIT) if case.sky]
    assert skies == sequences(10, FIT)
    assert [case.sky for case in plan.cases(HELD_OUT) if case.sky] == sequences(3, HELD_OUT)
    numbers = [case.number for case in plan.cases(FIT)]
    assert numbers == list(range(len(numbers)))
