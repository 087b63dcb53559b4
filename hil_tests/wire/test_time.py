"""On-board time: set at a frame's start, carried in every packet, kept through a warm reset."""

from __future__ import annotations

from itertools import pairwise

import pytest

from .conftest import STATUS, Wire

TICK_S = 2.0**-24
SUPERSEDED, ABORTED = 15, 17
NOON = 2_000_000_000
ON_THE_WAY_S = 0.1
"""ASSUMED: more than a telecommand needs on any link, whatever else the computer does."""


def seconds(time: tuple[int, int]) -> float:
    return time[0] + time[1] * TICK_S


def test_it_is_set_at_a_frame_start_and_told(line: Wire) -> None:
    count = line.send("set_time", {"time": (NOON, 1 << 23)})
    assert line.await_end(count) == ["acceptance_success", "start_success", "completion_success"]
    (event,) = line.events("TIME_SET")
    assert 0 <= seconds(event["new"]) - (NOON + 0.5) <= line.period_s + ON_THE_WAY_S
    (told,) = [packet for packet in line.packets if packet.fields.get("event_id") == 12]
    assert told.decoded["time_status"] == 1
    assert told.decoded["time"] == event["new"]
    assert line.housekeeping(STATUS)["time_status"] == 1


def test_it_goes_on_as_fast_as_time_does(line: Wire) -> None:
    line.done("set_time", {"time": (NOON, 0)})
    line.forget()
    line.done("ping")
    line.run(3)
    line.done("ping")
    first, *_, last = line.packets
    passed_s = seconds(last.decoded["time"]) - seconds(first.decoded["time"])
    assert passed_s == pytest.approx((last.t_ns - first.t_ns) / 1e9, abs=ON_THE_WAY_S)


def test_a_later_one_supersedes_an_earlier(line: Wire) -> None:
    line.done("set_time", {"time": (1000, 0)})  # a frame has just started: there is time for two
    line.forget()
    first = line.send("set_time", {"time": (100, 0)})
    second = line.send("set_time", {"time": (NOON, 0)})
    assert line.await_end(second)[-1] == "completion_success"
    assert line.failure(first) == ("completion_failure", SUPERSEDED, 0)
    (event,) = line.events("TIME_SET")
    assert event["new"][0] in (NOON, NOON + 1)


@pytest.mark.parametrize(("kind", "kept"), [(0, 1), (1, 0)], ids=["warm", "cold"])
def test_a_warm_reset_keeps_it(line: Wire, kind: int, kept: int) -> None:
    line.done("set_time", {"time": (NOON, 0)})
    line.forget()
    line.function("RESET", {"kind": kind})
    line.await_(lambda: line.events("BOOT_COMPLETED"))
    (boot,) = [packet for packet in line.packets if packet.fields.get("event_id") == 1]
    assert boot.decoded["time_status"] == kept
    assert (NOON < seconds(boot.decoded["time"]) < NOON + 10) == bool(kept)


def test_time_reports_come_each_power_of_two_frames(line: Wire) -> None:
    line.done("time_report_rate", {"rate_exponent": 1})
    line.forget()
    line.await_(lambda: len(line.of("time_report")) >= 4)
    stamps = [seconds(packet.decoded["time"]) for packet in line.packets if packet.name == "time_report"][:4]
    steps = [later - earlier for earlier, later in pairwise(stamps)]
    assert steps == [pytest.approx(2 * line.period_s, abs=1e-3)] * 3, "by the unit's own clock, on any link"
    line.done("time_report_rate", {"rate_exponent": 0})
