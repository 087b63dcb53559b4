"""RATE_ONLY: a frame's result leads there and back, and the rate is told where no attitude is known."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from st_emulator.device.star_tracker import StarTracker
from st_emulator.firmware_model.firmware import FrameContext, FrameResult
from st_emulator.firmware_model.modes import Mode, ModeEvent

from .conftest import MODE, Bench, MakeBench, make, make_can
from .tumbling import COVARIANCE, RATE_RAD_S, REASONS, process_frames_by, rate_alone, tumble

COLD = {"kind": 1}
TRIANGLE = {"xx": (0, 0), "xy": (0, 1), "xz": (0, 2), "yy": (1, 1), "yz": (1, 2), "zz": (2, 2)}
CAUSE = {"COMMAND_ACQUIRE": 6, "ATTITUDE_ACQUIRED": 12, "RATE_ALONE": 16, "SLOW_AGAIN": 17}


def single(value: float) -> float:
    """As it comes out of 32 bits."""
    return struct.unpack(">f", struct.pack(">f", value))[0]


def changes(bench: Bench) -> list[tuple[int, int, int]]:
    return [(e["from_mode"], e["to_mode"], e["cause"]) for e in bench.events("MODE_CHANGED")]


def told_rate(fields: dict[str, Any]) -> list[float]:
    return [fields[f"rate_{axis}"] for axis in "xyz"]


def told_covariance(fields: dict[str, Any]) -> dict[str, float]:
    return {name: fields[f"rate_covariance_{name}"] for name in TRIANGLE}


def test_there_and_back(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    tumble(monkeypatch, 5)
    count = bench.function("START_ACQUISITION")
    bench.run_until(lambda: bench.emulator.device.mode == MODE["RATE_ONLY"])
    bench.run(300)
    assert bench.housekeeping(1)["mode"] == 7
    bench.run_until(lambda: bench.emulator.device.mode == MODE["TRACKING"])
    bench.run(600)
    assert changes(bench) == [
        (MODE["STANDBY"], MODE["LOST_IN_SPACE"], CAUSE["COMMAND_ACQUIRE"]),
        (MODE["LOST_IN_SPACE"], MODE["RATE_ONLY"], CAUSE["RATE_ALONE"]),
        (MODE["RATE_ONLY"], MODE["LOST_IN_SPACE"], CAUSE["SLOW_AGAIN"]),
        (MODE["LOST_IN_SPACE"], MODE["TRACKING"], CAUSE["ATTITUDE_ACQUIRED"]),
    ]
    reports = bench.of("attitude_report")
    lost, tracking = MODE["LOST_IN_SPACE"], MODE["TRACKING"]
    assert [fields["mode"] for fields in reports] == [
        lost,
        7,
        7,
        7,
        7,
        lost,
        *[tracking] * (len(reports) - 6),
    ]
    assert [fields["valid"] for fields in reports] == [0] * 5 + [1] * (len(reports) - 5)
    assert bench.events("TRACKING_LOST") == []
    assert len(bench.events("ATTITUDE_ACQUIRED")) == 1
    assert bench.stages(count) == ["acceptance_success", "start_success", "completion_success"]
    completed = next(p for p in bench.reports(count) if p.name == "completion_success")
    acquired = next(p for p in bench.packets if p.name == "attitude_report" and p.fields["valid"])
    assert completed.t_ns > acquired.t_ns, "with the first valid attitude, not with the rate"


def test_the_report_of_a_frame_without_attitude_tells_the_rate(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    tumble(monkeypatch)
    bench.function("START_ACQUISITION")
    bench.run(1500)
    reports = bench.of("attitude_report")
    assert len(reports) >= 4
    for fields in reports:
        assert (fields["valid"], fields["reasons"]) == (0, int(REASONS))
        assert [fields[f"q_{axis}"] for axis in "xyzw"] == [0, 0, 0, 1]
        assert {fields[f"covariance_{name}"] for name in TRIANGLE} == {0.0}
        assert fields["false_match_probability"] == 1.0
        assert (fields["rate_valid"], fields["rate_covariance_valid"]) == (1, 1)
        assert told_rate(fields) == [single(value) for value in RATE_RAD_S]
        assert told_covariance(fields) == {n: single(COVARIANCE[place]) for n, place in TRIANGLE.items()}


def test_such_a_frame_counts_as_processed_and_as_not_valid(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    tumble(monkeypatch)
    bench.function("START_ACQUISITION")
    bench.run(2000)
    values = bench.housekeeping(1)
    assert values["mode"] == MODE["RATE_ONLY"]
    assert values["frames_processed"] == len(bench.of("attitude_report")) > 5
    assert (values["frames_valid"], values["frames_tracking"], values["frames_dropped"]) == (0, 0, 0)
    assert values["last_reasons"] == int(REASONS)


@pytest.mark.parametrize(
    ("rate", "covariance", "flags"),
    [
        (np.zeros(3), np.zeros((3, 3)), (1, 1)),
        (np.zeros(3), None, (1, 0)),
        (None, None, (0, 0)),
        (None, COVARIANCE, (0, 0)),
    ],
    ids=["zero", "no covariance", "unknown", "covariance of nothing"],
)
def test_what_is_not_known_is_told_apart_from_zero(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, rate: Any, covariance: Any, flags: tuple[int, int]
) -> None:
    tumble(monkeypatch, rate=rate, covariance=covariance)
    bench.function("START_ACQUISITION")
    bench.run(800)
    for fields in bench.of("attitude_report"):
        assert (fields["rate_valid"], fields["rate_covariance_valid"]) == flags
        assert {*told_rate(fields), *told_covariance(fields).values()} == {0.0}


def test_a_dropped_frame_has_no_rate(new_bench: MakeBench, monkeypatch: pytest.MonkeyPatch) -> None:
    tumble(monkeypatch)
    bench = new_bench(parameters={"clock_hz": 1_000_000}).boot()
    bench.function("START_ACQUISITION")
    bench.run_until(lambda: len(bench.events("FRAME_DROPPED")) > 2, 20_000)
    bench.run(50)
    dropped = [fields for fields in bench.of("attitude_report") if fields["cycles"] == 0]
    assert len(dropped) > 2
    for fields in dropped:
        assert (fields["rate_valid"], fields["rate_covariance_valid"]) == (0, 0)
        assert {*told_rate(fields), *told_covariance(fields).values()} == {0.0}


def test_an_attitude_leads_to_tracking_at_once(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The event that the table has for it, from a frame that was processed in RATE_ONLY."""
    frames: list[int] = []

    def change(context: FrameContext, result: FrameResult) -> FrameResult:
        frames.append(context.frame_index)
        return rate_alone(context, result) if len(frames) < 4 else result

    process_frames_by(monkeypatch, change)
    bench.function("START_ACQUISITION")
    bench.run(2000)
    assert changes(bench)[-1] == (MODE["RATE_ONLY"], MODE["TRACKING"], CAUSE["ATTITUDE_ACQUIRED"])
    (acquired,) = bench.events("ATTITUDE_ACQUIRED")
    assert acquired["frame_index"] == frames[3]
    by_frame = {fields["frame_index"]: fields for fields in bench.of("attitude_report")}
    assert (by_frame[frames[3]]["mode"], by_frame[frames[3]]["valid"]) == (MODE["RATE_ONLY"], 1)


def test_tracking_is_not_lost_where_there_was_none(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def change(context: FrameContext, result: FrameResult) -> FrameResult:
        told = rate_alone(context, result)
        if context.acquisition is Mode.RATE_ONLY:
            told = replace(told, event=ModeEvent.TRACKING_LOST)
        return told

    process_frames_by(monkeypatch, change)
    bench.function("START_ACQUISITION")
    bench.run(1500)
    assert bench.emulator.device.mode == MODE["RATE_ONLY"]
    assert bench.events("TRACKING_LOST") == []
    assert len(changes(bench)) == 2


@pytest.mark.parametrize(
    ("function", "arguments", "mode"),
    [
        ("GO_STANDBY", {}, "STANDBY"),
        ("START_ACQUISITION", {}, "LOST_IN_SPACE"),
        ("TRACK_FROM", {"q_x": 0.0, "q_y": 0.0, "q_z": 0.0, "q_w": 1.0}, "TRACKING"),
        ("RESET", COLD, "BOOT"),
        ("SHUTDOWN", {}, "OFF"),
    ],
)
def test_commands_lead_out(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, function: str, arguments: dict[str, Any], mode: str
) -> None:
    tumble(monkeypatch)
    bench.to_mode("RATE_ONLY")
    first = bench.count
    count = bench.function(function, arguments)
    bench.run(60)
    assert bench.stages(count)[0] == "acceptance_success"
    assert bench.emulator.device.mode == MODE[mode]
    failed = bench.failure(first)
    assert failed[0] == "completion_failure", "the acquisition that waited for an attitude has its end"


def test_an_image_is_kept_meanwhile(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    tumble(monkeypatch)
    bench.to_mode("RATE_ONLY")
    count = bench.function("CAPTURE_IMAGE")
    bench.run(600)
    assert bench.stages(count)[-1] == "completion_success"
    assert bench.emulator.device.mode == MODE["RATE_ONLY"]


def test_a_fault_ends_it(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    tumble(monkeypatch)
    bench.to_mode("RATE_ONLY")
    bench.to_mode("FAULT")
    bench.run(20)
    assert changes(bench)[-1] == (MODE["RATE_ONLY"], MODE["FAULT"], 14)


def test_the_table_has_no_other_ways_in_and_out(bench: Bench) -> None:
    """Through the one function of the device: every event in RATE_ONLY, and RATE_ALONE in every mode."""
    device: StarTracker = bench.emulator.device
    for event in (ModeEvent.TRACKING_LOST, ModeEvent.RATE_ALONE, ModeEvent.BOOT_DONE, ModeEvent.POWER_ON):
        device.mode = Mode.RATE_ONLY
        device._follow(event)
        assert device.mode is Mode.RATE_ONLY, event
    for mode in Mode:
        device.mode = mode
        device._follow(ModeEvent.RATE_ALONE)
        assert device.mode is (Mode.RATE_ONLY if mode is Mode.LOST_IN_SPACE else mode), mode
    device.mode = Mode.STANDBY


ELEMENTS = st.floats(-1e3, 1e3, width=32)


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(rate=st.tuples(*[ELEMENTS] * 3), upper=st.tuples(*[ELEMENTS] * 6))
def test_any_rate_and_covariance_are_read_as_they_were_measured(
    rate: tuple[float, ...], upper: tuple[float, ...]
) -> None:
    """All from the bytes, by the decoder made with struct alone."""
    covariance = np.zeros((3, 3))
    for value, (row, column) in zip(upper, TRIANGLE.values(), strict=True):
        covariance[row, column] = covariance[column, row] = value
    with pytest.MonkeyPatch.context() as patch:
        tumble(patch, rate=np.array(rate), covariance=covariance)
        bench = make().boot()
        bench.function("START_ACQUISITION")
        bench.run(600)
    reports = bench.of("attitude_report")
    assert reports
    for fields in reports:
        assert told_rate(fields) == list(rate)
        assert tuple(told_covariance(fields).values()) == upper


def test_on_a_bus_the_cyclic_frames_say_it_too(monkeypatch: pytest.MonkeyPatch) -> None:
    tumble(monkeypatch)
    bench = make_can(can_section={"rates_frames": 1, "status_frames": 1}).boot()
    bench.function("START_ACQUISITION")
    bench.run(2500)
    reports = {fields["frame_index"] & 0xFF: fields for fields in bench.of("attitude_report")}
    rates, states = bench.frames("rates"), bench.frames("status")
    assert len(rates) == len(states) == len(reports) >= 6
    for (_, rate), (_, status) in zip(rates, states, strict=True):
        report = reports[rate["counter"]]
        assert (rate["rate_valid"], status["rate_valid"], status["valid"]) == (1, 1, 0)
        assert [rate[f"rate_{axis}"] for axis in "xyz"] == pytest.approx(RATE_RAD_S, abs=2**-20)
        assert status["mode"] == report["mode"]
        assert status["reasons"] == int(REASONS)
        assert report["rate_covariance_valid"] == 1
    assert {status["mode"] for _, status in states} == {MODE["LOST_IN_SPACE"], MODE["RATE_ONLY"]}
    assert bench.frames("heartbeat")[-1][1]["mode"] == MODE["RATE_ONLY"]
