"""Faults of the telemetry: by chance, live, from a journal, in every language that can show them."""

from __future__ import annotations

import math
import struct
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from hil_tests.dialects.canopen.bench import make as make_canopen
from hil_tests.dialects.nos3 import bench as nos3
from hil_tests.dialects.nos3.client import quaternion as nos3_quaternion
from hil_tests.dialects.sagitta import bench as sagitta
from hil_tests.dialects.sagitta import client as sagitta_client
from hil_tests.dialects.test_template import UNIT as TEMPLATE_UNIT
from hil_tests.faults.exercises_telemetry import turn_deg
from hil_tests.faults.runs import kinds_of, replayed, run, started, within_chance
from hil_tests.unit.conftest import MS
from st_emulator.bench.emulator import Emulator
from st_emulator.errors import ConfigurationError
from st_emulator.faults.catalogue import FAULTS

KINDS = kinds_of("telemetry", "serial")
ON_BOTH = [(name, on_can) for name in KINDS for on_can in (False, True)]


@pytest.mark.parametrize(("name", "on_can"), ON_BOTH)
def test_the_same_seed_is_the_same_run_and_another_is_another(name: str, on_can: bool) -> None:
    fault = {"kind": name, "probability": 0.5}
    one = run(fault | {"seed": 7}, on_can=on_can)
    assert run(fault | {"seed": 7}, on_can=on_can).journal == one.journal
    assert any(run(fault | {"seed": seed}, on_can=on_can).groups != one.groups for seed in range(8, 12))


@pytest.mark.parametrize(("name", "on_can"), ON_BOTH)
def test_nothing_is_left_behind(name: str, on_can: bool) -> None:
    """Its octets apart, the wire is the same, to the nanosecond on the line; then all octets are."""
    plain, faulty = run(None, on_can=on_can), run({"kind": name}, on_can=on_can)
    assert faulty.before() == plain.before()
    assert faulty.during() != plain.during()
    assert len(plain.after(1)) > 20
    assert faulty.after(1) == plain.after(1)


@pytest.mark.parametrize(("name", "on_can"), ON_BOTH)
def test_live_and_from_a_journal(name: str, on_can: bool, tmp_path: Path) -> None:
    scenario = run({"kind": name}, on_can=on_can, pings=True)
    live = run({"kind": name}, on_can=on_can, pings=True, live=True)
    assert live.groups == scenario.groups
    assert replayed(live.journal, tmp_path) == live.groups
    assert replayed(scenario.journal, tmp_path) == live.groups


@pytest.mark.parametrize("name", ["telemetry.opposite_sign", "telemetry.wrong_attitude"])
def test_frames_are_struck_as_often_as_is_said(name: str) -> None:
    bench = started(False)
    bench.run_to(3000)
    report = bench.emulator._seams.attitude
    bench.emulator.faults.inject({"kind": name, "probability": 0.3, "seed": 3})
    seen: list[Any] = []
    bench.emulator.device._tell = seen.append
    bench.run(1000)
    told = next(one for one in seen if hasattr(one, "q_icrs_to_sensor"))
    count = sum(report(told) is not told for _ in range(3000))
    assert within_chance(count, 3000, 0.3)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_turn_is_about_an_axis_of_the_sensor(axis: str) -> None:
    """The sensor turned by 90 degrees about its axis (right-handed): what lay along the next axis lies along
    the one behind it against its direction. By matrices, which turn ICRS to the sensor.
    """
    bench = started(False)
    bench.run_to(3000)
    before = bench.of("attitude_report")[-1]
    bench.emulator.faults.inject({"kind": "telemetry.wrong_attitude", "deg": 90, "axis": axis})
    bench.run(1000)
    after = bench.of("attitude_report")[-1]
    old, new = (matrix([one[f"q_{name}"] for name in "xyzw"]) for one in (before, after))
    place = "xyz".index(axis)
    second, third = (place + 1) % 3, (place + 2) % 3
    close = {"abs_tol": 2e-3}  # a second of the unit's life lies between
    assert all(math.isclose(a, b, **close) for a, b in zip(new[place], old[place], strict=True))
    assert all(math.isclose(a, b, **close) for a, b in zip(new[second], old[third], strict=True))
    assert all(math.isclose(a, -b, **close) for a, b in zip(new[third], old[second], strict=True))


def matrix(q: list[float]) -> list[list[float]]:
    """Rows: the sensor's axes in ICRS (passive turn, scalar last)."""
    x, y, z, w = q
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
        [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)],
        [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)],
    ]


def test_a_time_before_power_on_turns_over() -> None:
    bench = started(False)
    bench.emulator.faults.inject({"kind": "telemetry.stale_time", "lag_s": 100})
    bench.run_to(3000)
    told = bench.of("attitude_report")[-1]
    assert (1 << 32) - 101 < told["mid_exposure_time"][0] < (1 << 32) - 95


def test_two_at_once() -> None:
    """Frozen, and of another time: each does its own."""
    bench = started(False)
    bench.run_to(3000)
    for fault in ({"kind": "telemetry.stale_time", "lag_s": 1}, {"kind": "telemetry.frozen_attitude"}):
        bench.emulator.faults.inject(fault)
    bench.forget()
    bench.run(2000)
    told = bench.packets
    reports = [one for one in told if one.name == "attitude_report"]
    assert len({one.fields["q_x"] for one in reports}) == 1
    for one in reports:
        coarse, fine = one.fields["mid_exposure_time"]
        sent, rest = one.decoded["time"]
        age = sent + rest / 2**24 - coarse - fine / 2**24 - one.fields["latency_us"] / 1e6
        assert math.isclose(age, 1.0, abs_tol=1e-5)


# -- sagitta


def sagitta_solutions(fault: dict[str, Any]) -> tuple[list[Any], list[Any], list[Any]]:
    """Solutions before, with and after a fault of 2 s; each frame's hash is checked by the client."""
    bench = sagitta.make().boot()
    bench.subscribe(24)
    bench.run(2000)
    bench.frames.clear()
    bench.run(1000)
    bench.emulator.faults.inject(fault | {"duration_s": 2})
    bench.run(2000)
    number = len(bench.frames)
    bench.run(2000)
    solutions = bench.subscribed(24)
    later = bench.subscribed(24, bench.frames[number:])
    split = len(solutions) - len(later)
    assert split > 8
    return solutions[:4], solutions[4:split], later


def test_sagitta_frozen() -> None:
    before, during, after = sagitta_solutions({"kind": "telemetry.frozen_attitude"})
    told = {sagitta_client.solution(one)["q"] for one in during}
    assert len(told) == 1
    assert len({sagitta_client.solution(one)["q"] for one in before + after}) > 8
    assert all(sagitta_client.solution(one)["valid"] for one in during + after)


def test_sagitta_counter_stands() -> None:
    before, during, after = sagitta_solutions({"kind": "telemetry.stuck_sequence_count"})
    assert {one.counter for one in during} == {before[-1].counter + 1}
    assert after[0].counter == before[-1].counter + 1 + len(during)


@pytest.mark.parametrize("lag_s", [None, 0.7])
def test_sagitta_time(lag_s: float | None) -> None:
    fault = {"kind": "telemetry.stale_time"} | ({} if lag_s is None else {"lag_s": lag_s})
    before, during, after = sagitta_solutions(fault)

    def age_us(one: Any) -> float:
        return one.t_ns / 1000 - one.time_us

    usual = age_us(before[0])
    if lag_s is None:
        assert len({one.time_us for one in during}) <= 2  # when it is sent is a whole number of us
    else:
        assert all(abs(age_us(one) - usual - lag_s * 1e6) < 5000 for one in during)
    assert all(abs(age_us(one) - usual) < 5000 for one in after)


def test_sagitta_time_jumps() -> None:
    before, during, after = sagitta_solutions({"kind": "telemetry.jumping_time", "most_s": 0.5})
    assert any(b.time_us < a.time_us for a, b in pairwise(during))
    assert all(b.time_us > a.time_us for a, b in pairwise(before + after))


def test_sagitta_nan() -> None:
    before, during, after = sagitta_solutions({"kind": "telemetry.not_a_number", "component": "x"})
    for one in during:
        assert [math.isnan(part) for part in sagitta_client.solution(one)["q"]] == [0, 1, 0, 0]  # w, x, y, z
    assert not any(math.isnan(part) for one in before + after for part in sagitta_client.solution(one)["q"])


def test_sagitta_turned() -> None:
    before, during, after = sagitta_solutions({"kind": "telemetry.wrong_attitude", "deg": 3, "axis": "z"})

    def attitude(one: Any) -> tuple[float, ...]:
        w, x, y, z = sagitta_client.solution(one)["q"]
        return x, y, z, w

    assert all(abs(turn_deg(attitude(one), attitude(before[-1])) - 3) < 0.05 for one in during)
    assert turn_deg(attitude(after[0]), attitude(before[-1])) < 0.05


# -- nos3


@pytest.mark.parametrize(
    ("fault", "turn"),
    [
        ({"kind": "telemetry.wrong_attitude", "deg": -5, "axis": "x"}, 5.0),
        ({"kind": "telemetry.opposite_sign"}, 0.0),
    ],
)
def test_nos3_polls_what_is_told(fault: dict[str, Any], turn: float) -> None:
    bench = nos3.make().boot()
    before = nos3_quaternion(bench.until_valid())
    number = bench.emulator.faults.inject(fault)
    bench.run(600)
    told = bench.data()
    assert told["valid"] == 1
    assert math.isclose(turn_deg(nos3_quaternion(told), before), turn, abs_tol=0.05)
    assert (nos3_quaternion(told)[3] * before[3] < 0) is (turn == 0.0)
    bench.emulator.faults.clear(number)
    bench.run(600)
    assert turn_deg(nos3_quaternion(bench.data()), before) < 0.05


def test_nos3_frozen() -> None:
    bench = nos3.make(scenario=None).boot()
    bench.until_valid()
    bench.emulator.faults.inject({"kind": "telemetry.frozen_attitude"})
    bench.run(600)
    frozen = bench.emulator.device.last_quaternion
    bench.run(1000)
    assert bench.emulator.device.last_quaternion == frozen
    assert bench.data()["valid"] == 1


# -- CANopen


def canopen_attitudes(fault: dict[str, Any]) -> tuple[list[Any], list[Any], list[Any]]:
    bench = make_canopen().boot()
    bench.nmt("start")
    bench.ask_for("STAR_TRACK")
    bench.run_until(lambda: len(bench.attitudes) >= 4)
    before = len(bench.attitudes)
    bench.emulator.faults.inject(fault | {"duration_s": 2})
    bench.run(2000)
    during = len(bench.attitudes)
    bench.run(2000)
    found = bench.attitudes
    assert during - before >= 4
    assert len(found) - during >= 4
    return found[:before], found[before:during], found[during:]


def told(one: Any) -> tuple[float, ...]:
    return one.i, one.j, one.k, one.real


def test_canopen_frozen() -> None:
    before, during, after = canopen_attitudes({"kind": "telemetry.frozen_attitude"})
    assert len({told(one) for one in during}) == 1
    assert len({one.since_midnight for one in during}) >= 2  # whole seconds
    assert len({told(one) for one in before + after}) > 4


def test_canopen_time() -> None:
    _, during, after = canopen_attitudes({"kind": "telemetry.stale_time"})
    assert len({one.since_midnight for one in during}) == 1
    assert len({one.since_midnight for one in after}) >= 2  # whole seconds
    assert len(during) >= len(after) - 1  # its own schedule does not follow the time that it tells


def test_canopen_nan_and_sign_and_turn() -> None:
    _, during, after = canopen_attitudes({"kind": "telemetry.not_a_number"})
    assert all(math.isnan(part) for one in during for part in told(one))
    assert not any(math.isnan(part) for one in after for part in told(one))
    before, during, _ = canopen_attitudes({"kind": "telemetry.opposite_sign"})
    assert all(one.real * before[-1].real < 0 for one in during)
    assert all(turn_deg(told(one), told(before[-1])) < 0.05 for one in during)
    before, during, _ = canopen_attitudes({"kind": "telemetry.wrong_attitude", "deg": 4, "axis": "z"})
    assert all(abs(turn_deg(told(one), told(before[-1])) - 4) < 0.05 for one in during)


# -- the template of an own dialect


def test_the_template_shows_them() -> None:
    sent: list[tuple[int, bytes]] = []
    emulator = Emulator(TEMPLATE_UNIT, transmit=lambda data, t_ns: sent.append((t_ns, data)))
    emulator.advance(1000 * MS)
    emulator.receive(b"\xa5\x5a\x07\x02\x00" + struct.pack("<H", 0))  # a wrong CRC: nothing happens
    from hil_tests.dialects.test_template import FIND, frame

    emulator.receive(frame(FIND))
    emulator.advance(4000 * MS)
    number = emulator.faults.inject({"kind": "telemetry.frozen_counter"})
    emulator.faults.inject({"kind": "telemetry.stale_time", "lag_s": 2})
    emulator.advance(6000 * MS)
    line = b"".join(data for t_ns, data in sent if t_ns > 4000 * MS)
    attitudes = [
        struct.unpack_from("<IQB4f", part, 3)
        for part in line.split(b"\xa5\x5a")
        if len(part) == 34 and part[1] == 0x84
    ]
    assert len(attitudes) >= 6
    assert len({one[0] for one in attitudes}) == 1
    assert all(1_500_000 < one[1] < 4_500_000 for one in attitudes)
    emulator.faults.clear(number)


# -- settings and languages


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"kind": "telemetry.stale_time", "lag_s": -1}, "lag_s"),
        ({"kind": "telemetry.jumping_time", "most_s": 0}, "most_s"),
        ({"kind": "telemetry.not_a_number", "component": "v"}, "'x', 'y', 'z', 'w', 'all'"),
        ({"kind": "telemetry.wrong_attitude", "deg": 181}, "deg"),
        ({"kind": "telemetry.wrong_attitude", "axis": "w"}, "'x', 'y', 'z'"),
        ({"kind": "telemetry.opposite_sign", "direction": "both"}, "direction"),
    ],
)
def test_a_bad_setting_is_told_in_one_line(settings: dict[str, Any], told: str) -> None:
    bench = started(False)
    with pytest.raises(ConfigurationError) as caught:
        bench.emulator.faults.inject(settings)
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


LANGUAGES = {
    "sagitta": lambda: sagitta.make().emulator,
    "nos3": lambda: nos3.make().emulator,
    "canopen": lambda: make_canopen().emulator,
}


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_language_has_the_faults_that_it_can_show(language: str) -> None:
    emulator = LANGUAGES[language]()
    for name in KINDS:
        kind = FAULTS[name]
        if kind.spoken_in(language):
            emulator.faults.inject({"kind": name})
        else:
            with pytest.raises(ConfigurationError, match=language) as caught:
                emulator.faults.inject({"kind": name})
            assert f" {name}," not in str(caught.value).partition("allowed are")[2]
