"""Faults of the clock, exercised."""

from __future__ import annotations

from datetime import datetime
from itertools import pairwise

from hil_tests.faults.exercise import Exercise, Seen
from hil_tests.unit.conftest import MS, Bench, CanBench, Packet

SET_AT_S = 2.0
TAI_UTC_S = 37
SET_TO_S = int((datetime(2026, 1, 15, 0, 0, 2) - datetime(1958, 1, 1)).total_seconds()) + TAI_UTC_S
SET = {"telecommands": [{"at_s": SET_AT_S, "name": "set_time", "fields": {"time": "2026-01-15T00:00:02Z"}}]}
PERIOD_MS = 250
DRIFT_PPM = 2000


def ms_of(time: tuple[int, int]) -> float:
    coarse, fine = time
    return coarse * 1e3 + fine * 1e3 / 2**24


def stamp_ms(report: Packet) -> float:
    """On-board time at the middle of the exposure."""
    return ms_of(report.fields["mid_exposure_time"])


def error_ms(report: Packet) -> float:
    """Of the on-board time, by the frame's place on the grid and when the OBC set it."""
    middle_ms = report.fields["frame_index"] * PERIOD_MS + 50
    return stamp_ms(report) - SET_TO_S * 1e3 - (middle_ms - SET_AT_S * 1e3)


def attitudes(packets: list[Packet]) -> list[Packet]:
    found = [
        one for one in packets
        if one.name == "attitude_report" and one.t_ns > (SET_AT_S + 0.5) * 1000 * MS
    ]  # fmt: skip
    assert found
    assert all(one.fields["valid"] for one in found)
    assert all(one.fields["time_status"] == 1 for one in found)
    return found


def drift(seen: Seen) -> str:
    before, during, after = (attitudes(part) for part in (seen.before(), seen.during(), seen.after()))
    set_ms = error_ms(before[-1])  # what the telecommand took on the line
    assert abs(set_ms) < 50
    gained = [error_ms(one) - set_ms for one in during[1:]]
    steps = [later - earlier for earlier, later in pairwise(gained)]
    assert all(abs(step - PERIOD_MS * DRIFT_PPM / 1e6) < 0.001 for step in steps)
    last = [error_ms(one) - set_ms for one in after[1:]]
    assert max(last) - min(last) < 0.001, "the error stays"
    assert abs(last[0] - 3000 * DRIFT_PPM / 1e6) < 0.001
    assert seen.bench.events("TIME_SET") != []
    return (
        f"each frame's mid-exposure time {steps[0]:.1f} ms more than 250 ms behind the one before, all "
        f"{len(during)} attitudes valid, time status SET; {last[0]:.1f} ms of error stay"
    )


def jump(seen: Seen) -> str:
    before, after = attitudes(seen.before()), attitudes(seen.after())
    steps = [
        stamp_ms(later) - stamp_ms(earlier)
        - PERIOD_MS * (later.fields["frame_index"] - earlier.fields["frame_index"])
        for earlier, later in zip([before[-1], *after], after, strict=False)
    ]  # fmt: skip
    wanted_ms = seen.figures["seconds"] * 1e3
    (step,) = [one for one in steps if abs(one) > 0.001]
    assert abs(step - wanted_ms) < 0.001
    assert len(seen.bench.events("TIME_SET")) == 1, "the OBC's own, before"
    return f"one step of {step / 1e3:.1f} s in the mid-exposure times, no event TIME_SET, attitudes valid"


def jumped(seconds: float) -> Exercise:
    def look(seen: Seen) -> str:
        seen.figures["seconds"] = seconds
        return jump(seen)

    name = "forward" if seconds > 0 else "back"
    return Exercise({"kind": "clock.jump", "seconds": seconds}, look, name=name, lasts_ms=0, scenario=SET)


def set_time(bench: Bench, seen: Seen) -> None:
    bench.run(100)
    seen.figures["count"] = bench.send("set_time", {"time": (SET_TO_S, 0)})
    bench.run(1000)
    seen.figures["status"] = bench.housekeeping(1)["time_status"]


def missed_sync(seen: Seen) -> str:
    bench, count = seen.bench, seen.figures["count"]
    reports = bench.reports(count)
    assert [one.name for one in reports] == ["acceptance_success", "start_success", "completion_success"]
    assert reports[1].t_ns <= seen.end_ms * MS < reports[2].t_ns
    assert seen.figures["status"] == 0
    assert {one.fields["time_status"] for one in seen.during("attitude_report")} == {0}
    assert {one.fields["time_status"] for one in seen.after("attitude_report")[2:]} == {1}
    late_ms = reports[2].t_ns / MS - seen.end_ms
    sent_ms = seen.start_ms + 100
    last = seen.after("attitude_report")[-1]
    right_ms = SET_TO_S * 1e3 + last.fields["frame_index"] * PERIOD_MS + 50 - sent_ms
    assert abs(stamp_ms(last) - right_ms) < 50, "the time it was set to, by when it was sent"
    return (
        f"accepted and started, time status FREE_RUNNING until the end; completion {late_ms:.0f} ms after "
        "it, and the time is right"
    )


def synchronise(bench: Bench, seen: Seen) -> None:
    assert isinstance(bench, CanBench)
    for counter in (1, 2):
        bench.put_frame("sync", bytes([counter]))
        bench.run(20)
        bench.put_frame("time_at_sync", bytes([counter]) + SET_TO_S.to_bytes(4, "little") + bytes(3))
        bench.run(980)


def missed_on_can(seen: Seen) -> str:
    bench = seen.bench
    assert isinstance(bench, CanBench)
    beats = bench.frames("heartbeat")
    during = [values["time_set"] for t_ns, values in beats if seen.start_ms < t_ns / MS <= seen.end_ms]
    after = [values["time_set"] for t_ns, values in beats if t_ns / MS > seen.end_ms + PERIOD_MS]
    assert set(during) == {0}
    assert set(after) == {1}
    return f"two times after SYNC without effect: time_set 0 in {len(during)} heartbeats, 1 after the end"


EXERCISES = (
    Exercise({"kind": "clock.drift", "ppm": DRIFT_PPM}, drift, scenario=SET),
    jumped(7200.0),
    jumped(-5.0),
    Exercise({"kind": "clock.missed_sync"}, missed_sync, meanwhile=set_time),
    Exercise({"kind": "clock.missed_sync"}, missed_on_can, on_can=True, meanwhile=synchronise),
)
