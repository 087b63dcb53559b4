"""Faults of the power: alone and together, live, from the start, and while every telecommand runs."""

from __future__ import annotations

from typing import Any

import pytest

from hil_tests.unit.conftest import MODE, MS, Bench, make, make_can
from hil_tests.unit.test_life_at_random import TELECOMMANDS, Watched, back_to_standby, check, function
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.scenario import Scenario
from st_emulator.errors import ConfigurationError
from st_emulator.faults.supply import Supply
from st_emulator.units.profile import load_unit


def cut(bench: Bench, **settings: Any) -> int:
    return bench.emulator.faults.inject({"kind": "power.cut"} | settings)


def scenario(*faults: dict[str, Any]) -> dict[str, Any]:
    return {"scenario": Scenario(faults=list(faults))}


def test_off_from_the_start_until_the_end() -> None:
    bench = make(**scenario({"kind": "power.cut", "end_s": 1.0}))
    assert not bench.emulator.device.powered
    bench.run(1399)
    assert bench.packets == []
    bench.run(20)
    (booted,) = bench.events("BOOT_COMPLETED")
    assert booted["boot_count"] == 1


@pytest.mark.parametrize("times", [{}, {"duration_s": 0}])
def test_without_an_end_it_stays_off(times: dict[str, Any]) -> None:
    bench = make().boot()
    number = cut(bench, **times)
    bench.run(20_000)
    assert bench.packets == []
    assert bench.emulator.next_event_ns() is None
    bench.emulator.faults.clear(number)
    bench.run(500)
    assert len(bench.events("BOOT_COMPLETED")) == 1


def test_power_comes_when_the_last_one_lets_go() -> None:
    bench = make().boot()
    first = cut(bench, duration_s=2.0)
    cut(bench, duration_s=3.0)
    bench.emulator.faults.inject({"kind": "power.brown_out", "duration_s": 2.5, "off_ms": 60})
    bench.emulator.faults.clear(first)
    start_ms = bench.now_ms
    bench.run(2999)
    assert bench.emulator.device.mode == MODE["OFF"]
    bench.run(500)
    (booted,) = [one for one in bench.packets if one.fields.get("event_id") == 1]
    assert booted.t_ns / MS >= start_ms + 3400
    assert booted.fields["data"]["boot_count"] == 2


def test_a_supply() -> None:
    class Unit:
        log = ""

        def power_on(self) -> None:
            self.log += "+"

        def power_off(self) -> None:
            self.log += "-"

    unit, first, second = Unit(), object(), object()
    supply = Supply(unit)
    supply.cut(first)
    supply.begin()
    assert unit.log == "-"
    supply.cut(first)
    supply.cut(second)
    supply.restore(first)
    assert unit.log == "--"
    supply.restore(first)
    supply.restore(second)
    assert unit.log == "--+"


def test_a_shutdown_is_ended_by_a_cut() -> None:
    bench = make().boot()
    bench.function("SHUTDOWN", ack=0)
    bench.run(400)
    cut(bench, duration_s=0.1)
    bench.run(600)
    assert bench.emulator.device.mode == MODE["STANDBY"]


def test_so_often_and_not_again() -> None:
    bench = make().boot()
    bench.emulator.faults.inject(
        {"kind": "power.brown_out", "times": 4, "after_ms": 10, "off_ms": 5, "duration_s": 60}
    )
    bench.run(2000)
    (booted,) = bench.events("BOOT_COMPLETED")
    assert booted["boot_count"] == 5
    bench.run(60_000)
    assert len(bench.events("BOOT_COMPLETED")) == 1, "nothing when it ends"


@pytest.mark.parametrize("make_bench", [make, make_can])
@pytest.mark.parametrize("octet", [0, 1, 15, 16, 17, 3000])
def test_so_many_octets_of_a_download_leave(make_bench: Any, octet: int) -> None:
    bench = make_bench().boot()
    bench.broken = []
    cut(bench, during="image_download", at_octet=octet, off_s=0.2)
    bench.function("CAPTURE_IMAGE", ack=0)
    bench.run(600)
    bench.forget()
    bench.groups.clear()
    bench.function("DOWNLOAD_IMAGE", {"transaction_id": 1, "first_part": 0, "parts": 0}, ack=0)
    bench.run_until(lambda: bench.emulator.device.mode == MODE["OFF"])
    bench.run(100)
    left = sum(len(data) for _, data in bench.groups)
    if make_bench is make:
        assert left == octet
    bench.run_until(lambda: bool(bench.events("BOOT_COMPLETED")), 5000)
    bench.run(3000)
    assert len(bench.events("BOOT_COMPLETED")) == 1


def test_other_octets_than_a_downloads_do_not_count() -> None:
    bench = make().boot()
    cut(bench, during="image_download", at_octet=2000)
    bench.function("CAPTURE_IMAGE", ack=0)
    bench.run(600)
    part = {"transaction_id": 1, "first_part": 1, "parts": 1}
    for _ in range(3):
        bench.function("DOWNLOAD_IMAGE", part)
        bench.run(300)
        for _ in range(8):
            bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 900})
            bench.run(200)
    assert bench.emulator.device.powered


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"at_octet": 3}, "fault: at_octet is for a cut in the middle of something: give during"),
        ({"off_s": 3}, "fault: off_s is for a cut"),
        (
            {"during": "boot"},
            "fault: during: found 'boot'; allowed is one of 'parameter_write', 'memory_load'",
        ),
        ({"kind": "power.brown_out", "times": 0}, "fault: times: found 0; allowed is a whole number from 1"),
        ({"kind": "power.brown_out", "after_ms": 0}, "fault: after_ms: found 0; allowed is a number over 0"),
    ],
)
def test_wrong_settings(table: dict[str, Any], says: str) -> None:
    with pytest.raises(ConfigurationError, match=says):
        cut(make(), **table)


def test_a_download_that_a_language_does_not_have() -> None:
    with pytest.raises(ConfigurationError, match=r"during: image_download is for the dialect pus, .* nos3"):
        cut(make(wire={"dialect": "nos3"}), during="image_download")


COMMANDS = [
    *TELECOMMANDS,
    function("CAPTURE_IMAGE"),
    ("parameter_report", {"parameter_ids": [1, 2, 3]}),
    ("time_report_rate", {"rate_exponent": 0}),
]


@pytest.mark.parametrize("number", range(len(COMMANDS)))
def test_while_a_telecommand_runs(number: int) -> None:
    """It is cut where it has just been heard, begins, runs, and where its reports leave."""
    watched = Watched()
    watched.bench.run(35)
    name, fields = COMMANDS[number]
    if fields.get("function_id") == 6:  # there is something to download
        watched.telecommand(*function("CAPTURE_IMAGE"))
        watched.bench.run(600)
    for wait_ms in (0.3, 1.1, 2.2, 3.7, 9, 61, 280):
        watched.telecommand(name, fields)
        watched.bench.run(wait_ms)
        watched.cuts_ns.append(watched.bench.emulator.now_ns)
        cut(watched.bench, duration_s=0.003)
        watched.bench.run(3)
        watched.power_ons_ns.append(watched.bench.emulator.now_ns)
        watched.bench.run(60)
    back_to_standby(watched, cycle=True)
    check(watched)


def test_the_switch_and_a_cut_both_keep_power_away() -> None:
    """Power is there when the switch is on and no fault keeps it away, whichever lets go last."""
    emulator = Emulator(load_unit("roja1"))
    second = 1_000_000_000
    powered = []

    def at(seconds: float) -> None:
        emulator.advance(round(seconds * second))
        powered.append(emulator.device.powered)

    emulator.advance(second)
    emulator.power(False)
    emulator.faults.inject({"kind": "power.cut", "duration_s": 2})
    at(2)
    at(3.5)  # the fault has ended, the switch is off
    emulator.power(True)
    at(4)
    emulator.faults.inject({"kind": "power.cut", "duration_s": 2})
    emulator.power(False)
    emulator.power(True)
    at(5)  # the switch is on again, the fault lasts
    at(6.5)
    assert powered == [False, False, True, False, True]
