"""Object 4000h: every state, every transition that is asked for, and what the device does then."""

from __future__ import annotations

from itertools import pairwise

import pytest

from hil_tests.dialects.canopen.bench import Bench, make
from hil_tests.dialects.canopen.client import DEVICE_STATE, STATES, VALUE, AbortedError, place

#: From CiA's client's point of view: what follows when it is asked for. All else is ignored.
ALLOWED = {
    "BOOT": set(),
    "STANDBY": {"LOW_POWER", "STAR_TRACK", "CAPTURE"},
    "LOW_POWER": {"STANDBY", "STAR_TRACK", "CAPTURE"},
    "STAR_TRACK": {"STANDBY", "LOW_POWER", "CAPTURE", "ERROR"},
    "CAPTURE": {"STANDBY", "LOW_POWER", "STAR_TRACK", "ERROR"},
    "ERROR": {"OFF"},
}


def brought_to(state: str, **settings: object) -> Bench:
    bench = make(boot_ms=5000 if state == "BOOT" else 0, **settings).boot()
    bench.sdo.write(0x4001, 3, (3600).to_bytes(4, "little"))  # a capture that lasts
    bench.sdo.write(0x4001, 1, b"\0")
    if state == "ERROR":
        bench.ask_for("STAR_TRACK")
    if state not in ("BOOT", "STANDBY"):
        bench.ask_for(state)
    assert bench.state == STATES[state]
    return bench


@pytest.mark.parametrize("wanted", STATES)
@pytest.mark.parametrize("state", ALLOWED)
def test_transition(state, wanted):
    bench = brought_to(state)
    bench.ask_for(wanted)  # acknowledged in any case
    if wanted == "OFF" and wanted in ALLOWED[state]:
        bench.run(5)
        assert bench.emulator.device.mode.name == "OFF"
        return
    follows = wanted if wanted in ALLOWED[state] else state
    assert bench.state == STATES[follows]
    mode = bench.emulator.device.mode.name
    expected = {"STAR_TRACK": "LOST_IN_SPACE", "ERROR": "FAULT"}.get(follows, "STANDBY")
    assert mode in (expected, "TRACKING" if follows == "STAR_TRACK" else expected)


@pytest.mark.parametrize("number", [6, 7, 0x80, 0xFE])
def test_numbers_that_are_no_state(number):
    bench = make().boot()
    bench.sdo.write(0x4000, 0, bytes((number,)))
    assert bench.state == STATES["STANDBY"]
    bench = make(ignores_bad_states=False).boot()
    with pytest.raises(AbortedError) as error:
        bench.sdo.write(0x4000, 0, bytes((number,)))
    assert error.value.code == VALUE


def test_without_the_quirk_a_state_that_cannot_follow_is_aborted():
    bench = brought_to("STANDBY", ignores_bad_states=False)
    for wanted in ("OFF", "BOOT", "ERROR"):
        with pytest.raises(AbortedError) as error:
            bench.ask_for(wanted)
        assert error.value.code == DEVICE_STATE
    bench.ask_for("STANDBY")  # the same: nothing to change
    bench.ask_for("LOW_POWER")
    assert bench.state == STATES["LOW_POWER"]


def test_a_fault_of_the_device_is_the_state_error():
    from st_emulator.firmware_model.causes import FaultCause

    bench = brought_to("CAPTURE")
    bench.emulator.device.enter_fault(FaultCause.SENSOR_LOST)
    bench.run(5)
    assert bench.state == STATES["ERROR"]
    bench.nmt("reset_node")
    bench.run(450)
    assert bench.state == STATES["STANDBY"]


def test_lost_attitude_keeps_the_state():
    from st_emulator.bench.scenario import InertialTrajectory, Scenario

    # Towards the Sun: nothing is ever solved.
    sun = Scenario(trajectory=InertialTrajectory(ra_deg=297.0, dec_deg=-21.0))
    bench = make(scenario=sun).boot()
    bench.ask_for("STAR_TRACK")
    bench.run(2000)
    assert bench.state == STATES["STAR_TRACK"]
    assert bench.attitudes == []
    assert bench.sdo.number(0x4002, 6) == 0


def test_captures_until_there_are_enough():
    bench = make().boot()
    bench.sdo.write(0x4001, 1, b"\x03")
    bench.sdo.write(0x4001, 3, (60).to_bytes(4, "little"))
    bench.ask_for("CAPTURE")
    begun_ms = bench.now_ms
    bench.run_until(lambda: bench.emulator.dialect.card.state != STATES["CAPTURE"])
    # A frame each 250 ms: the delay of 100 ms behind the read-out of one (117 ms) lets the next be taken.
    assert 500 < bench.now_ms - begun_ms < 1000
    assert bench.state == STATES["STANDBY"]
    assert bench.sdo.number(0x4001, 7) == 3
    bench.ask_for("CAPTURE")
    assert bench.sdo.number(0x4001, 7) == 0  # counts anew


def test_captures_until_the_duration_is_over():
    bench = make().boot()
    bench.sdo.write(0x4001, 1, b"\0")
    bench.sdo.write(0x4001, 2, (600).to_bytes(4, "little"))
    bench.sdo.write(0x4001, 3, (2).to_bytes(4, "little"))
    bench.ask_for("CAPTURE")
    begun_ms = bench.now_ms
    bench.run_until(lambda: bench.emulator.dialect.card.state != STATES["CAPTURE"])
    assert abs(bench.now_ms - begun_ms - 2000) < 10
    assert 2 <= bench.sdo.number(0x4001, 7) <= 3


def test_an_earlier_capture_leaves_nothing_behind():
    bench = make().boot()
    bench.sdo.write(0x4001, 1, b"\0")
    bench.sdo.write(0x4001, 2, (600).to_bytes(4, "little"))
    bench.sdo.write(0x4001, 3, (2).to_bytes(4, "little"))
    memory = bench.emulator.device.image_memory
    bench.ask_for("CAPTURE")
    bench.run(400)  # an image is there, and its delay runs
    assert memory.image is not None
    bench.ask_for("STANDBY")
    bench.ask_for("CAPTURE")
    begun_ms = bench.now_ms
    frames: list[int] = []
    while bench.emulator.dialect.card.state == STATES["CAPTURE"]:
        bench.run(10)
        assert bench.now_ms < begun_ms + 2100
        if memory.image.frame_index not in frames:
            frames.append(memory.image.frame_index)
    assert bench.now_ms > begun_ms + 1990  # the end of the first duration did not end the second
    # 600 ms behind a read-out comes the next image: four frames of 250 ms, or three, never fewer.
    assert all(b - a >= 3 for a, b in pairwise(frames[1:]))
    assert len(frames) >= 3


def test_a_duration_of_0_captures_nothing():
    bench = make().boot()
    bench.sdo.write(0x4001, 3, bytes(4))
    bench.ask_for("CAPTURE")
    bench.run(600)
    assert bench.state == STATES["STANDBY"]
    assert bench.sdo.number(0x4001, 7) == 0
    assert bench.sdo.read(0x4001, 4) == b""


def test_a_capture_left_and_entered_again_at_once():
    bench = brought_to("CAPTURE")
    bench.ask_for("STANDBY")
    bench.ask_for("CAPTURE")
    bench.run(1500)
    assert bench.state == STATES["CAPTURE"]
    assert bench.sdo.number(0x4001, 7) >= 3


@pytest.mark.parametrize(
    ("filter_objects", "taken"),
    [
        ({}, True),
        ({2: 255, 3: 1}, False),  # 1 % above the highest value: none is
        ({2: 255, 3: 1, 1: 0}, True),  # the filter is off
        ({2: 1, 3: 90}, True),  # the black level of 32 of 1024 is 8 of 256
        ({4: 1, 5: 1}, False),  # 1 % below 1: none is
        ({4: 200, 5: 99}, True),
    ],
)
def test_the_filter(filter_objects, taken):
    bench = make().boot()
    for sub, value in filter_objects.items():
        bench.sdo.write(0x4003, sub, bytes((value,)))
    bench.ask_for("CAPTURE")
    bench.run(1100)
    assert bench.state == STATES["STANDBY"]
    assert bench.sdo.number(0x4001, 7) == int(taken)
    answer = bench.sdo.ask(b"\x40" + place(0x4001, 5))
    assert (int.from_bytes(answer[4:], "little") > 0) is taken
