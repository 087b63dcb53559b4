"""Modes: what leads from one to another, what each refuses."""

from __future__ import annotations

import pytest

from .conftest import FUNCTION, LOST_IN_SPACE, SELF_TEST, STANDBY, STATUS, TRACKING, Wire

NOT_ALLOWED = 7


def test_standby_after_the_boot(line: Wire) -> None:
    assert line.mode() == STANDBY


def test_the_self_test_passes_and_ends_in_standby(line: Wire) -> None:
    count = line.function("START_SELF_TEST")
    line.await_(lambda: "start_success" in line.stages(count))
    assert line.mode() == SELF_TEST
    assert line.await_end(count)[-1] == "completion_success"
    steps = [packet.fields["step"] for packet in line.reports(count) if packet.name == "progress"]
    assert steps == [1, 2, 3, 4]
    assert line.mode() == STANDBY


@pytest.mark.parametrize("name", ["START_ACQUISITION", "START_SELF_TEST", "CAPTURE_IMAGE"])
def test_the_self_test_is_not_disturbed(line: Wire, name: str) -> None:
    first = line.function("START_SELF_TEST")
    line.await_(lambda: "start_success" in line.stages(first))
    second = line.function(name)
    assert line.await_end(second) == ["acceptance_failure"]
    assert line.failure(second)[:2] == ("acceptance_failure", NOT_ALLOWED)
    assert line.await_end(first)[-1] == "completion_success"


def test_acquisition_completes_with_an_attitude_and_standby_ends_it(line: Wire) -> None:
    line.acquire()
    assert line.mode() == TRACKING
    changes = [(event["from_mode"], event["to_mode"]) for event in line.events("MODE_CHANGED")]
    assert changes == [(STANDBY, LOST_IN_SPACE), (LOST_IN_SPACE, TRACKING)]
    line.done("function", {"function_id": FUNCTION["GO_STANDBY"], "arguments": {}})
    assert line.mode() == STANDBY
    line.run(2 * line.period_s)
    line.forget()
    line.run(4 * line.period_s)
    assert line.of("attitude_report") == []


def test_reset_counts_the_boots(line: Wire) -> None:
    before = line.housekeeping(STATUS)["boot_count"]
    line.function("RESET", {"kind": 0})
    line.await_(lambda: line.events("BOOT_COMPLETED"))
    assert line.events("BOOT_COMPLETED")[0]["boot_count"] == before + 1
    status = line.housekeeping(STATUS)
    assert (status["mode"], status["boot_count"]) == (STANDBY, before + 1)


def test_power_comes_back(line: Wire, star_tracker, bench) -> None:
    star_tracker.power_off()
    line.forget()
    bench.never(lambda: line.packets, for_s=2)
    star_tracker.power_on()
    line.await_(lambda: line.events("BOOT_COMPLETED"))
    assert line.mode() == STANDBY


def test_silent_after_a_shutdown(line: Wire, star_tracker, bench) -> None:
    count = line.function("SHUTDOWN")
    assert line.await_end(count)[-1] == "completion_success"
    line.run(0.5)
    line.forget()
    line.send("ping")
    bench.never(lambda: line.packets, for_s=2)
    star_tracker.power_off()
    star_tracker.power_on()
    line.await_(lambda: line.events("BOOT_COMPLETED"))
