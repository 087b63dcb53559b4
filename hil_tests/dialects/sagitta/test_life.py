"""Boot loader and program, starts, power; refusals of actions."""

from __future__ import annotations

import struct

from hil_tests.dialects.sagitta import client
from hil_tests.dialects.sagitta.bench import MS, Bench, at_rest, line_ns, make, unit
from hil_tests.dialects.sagitta.client import ACTION, READ, REQUEST, SET
from st_emulator.device.commands import Reset
from st_emulator.firmware_model.causes import FaultCause, ResetCause
from st_emulator.firmware_model.modes import Mode

BOOT_MS = 400  # timing.boot_ms of roja1


def everything() -> list[tuple[int, int, bytes]]:
    return [
        *((SET, id_, arguments) for id_, arguments in client.DEFAULTS.items()),
        *((READ, id_, b"") for id_ in client.DEFAULTS),
        *((REQUEST, id_, b"") for id_ in client.TELEMETRY_BODY_BYTES),
        (ACTION, client.SET_TIME, bytes(8)),
        (ACTION, 2, b""),
    ]


def test_the_boot_loader_takes_boot_alone() -> None:
    bench = make().to_loader()
    for message in everything():
        assert bench.ask(*message, ms=20) == []
    assert bench.run(2000) == []  # nothing by itself
    assert bench.device.mode == Mode.STANDBY
    assert bench.status(ACTION, client.BOOT, b"\x01") == 0


def test_a_boot_loader_that_answers() -> None:
    bench = make(boot_loader_answers=True).to_loader()
    for message in everything():
        type_, id_, _ = message
        frames = bench.ask(*message, ms=20)
        if type_ == READ:
            assert frames == []
            continue
        (frame,) = frames
        assert (frame.type, frame.id, frame.status) == (type_ | 0x80, id_, 4)
        assert len(frame.body) == (20 if type_ == REQUEST else 8)


def test_boot_takes_its_time_and_starts_the_clock() -> None:
    bench = make(autonomous=False).to_loader()
    begun_ns = bench.now_ns
    request = client.request(ACTION, client.BOOT, b"\x01")
    bench.put(request)
    bench.run(20)
    (reply,) = bench.frames
    # The request's last bit, the latency, and the reply on the line.
    assert reply.t_ns == begun_ns + line_ns(len(request)) + bench.latency_ns + line_ns(reply.line_bytes)
    assert bench.device.mode == Mode.BOOT
    bench.put(client.request(READ, 13))  # nobody listens
    ready_ns = reply.t_ns + BOOT_MS * MS
    bench.emulator.advance(ready_ns - 1)
    assert bench.device.mode == Mode.BOOT
    bench.emulator.advance(ready_ns)
    assert bench.device.mode == Mode.STANDBY
    assert len(bench.frames) == 1
    frame = bench.telemetry(client.TIME)
    uptime_ms, unix_us = struct.unpack("<IQ", frame.data)
    sent_ns = frame.t_ns - line_ns(frame.line_bytes)
    assert unix_us == frame.time_us == (sent_ns - reply.t_ns) // 1000
    assert uptime_ms == (sent_ns - reply.t_ns) // MS


def test_the_program_looks_for_the_attitude_by_itself_or_does_not() -> None:
    assert make().boot().device.mode == Mode.LOST_IN_SPACE
    assert at_rest().device.mode == Mode.STANDBY


def test_without_a_boot_loader_the_program_starts_with_the_power() -> None:
    bench = make(boot_loader=False, autonomous=False).to_loader()
    assert bench.one(READ, 13).arguments == client.DEFAULTS[13]


def test_a_second_boot_does_no_harm() -> None:
    bench = at_rest()
    bench.status(SET, 13, bytes(8))
    assert bench.status(ACTION, client.BOOT, b"\x01") == 0
    assert bench.one(READ, 13).arguments == bytes(8)


def test_actions_that_are_refused() -> None:
    bench = at_rest()
    assert bench.status(ACTION, 2) == 1
    assert bench.status(ACTION, client.BOOT) == 2
    assert bench.status(ACTION, client.BOOT, b"\x01\x01") == 2
    assert bench.status(ACTION, client.SET_TIME, bytes(7)) == 2
    assert bench.status(ACTION, client.SET_TIME, b"\xff" * 8) == 2


def test_telemetry_that_is_none() -> None:
    bench = at_rest()
    frame = bench.one(REQUEST, 99)
    assert (frame.status, len(frame.body)) == (1, 20)


def test_a_power_cycle_leads_to_the_boot_loader() -> None:
    bench = make().boot()
    bench.subscribe(client.SOLUTION)
    bench.run(600)
    bench.device.power_off()
    number = len(bench.groups)
    bench.run(1000)
    assert len(bench.groups) <= number + 1  # the group on the wire is completed
    bench.frames.clear()
    bench.device.power_on()
    bench.to_loader()
    assert bench.ask(REQUEST, client.TIME) == []
    assert bench.run(1500) == []
    bench.boot()
    assert bench.telemetry(client.TIME).counter == 0


def test_power_that_goes_during_the_boot() -> None:
    bench = make(autonomous=False).to_loader()
    bench.status(ACTION, client.BOOT, b"\x01")
    bench.device.power_off()
    bench.device.power_on()
    bench.to_loader()
    assert bench.ask(READ, 13) == []  # the boot was of the life before


def test_a_restart_that_was_not_asked_for_leads_to_the_boot_loader() -> None:
    bench = at_rest()
    bench.device.execute(Reset(ResetCause.WARM_RESET))
    bench.to_loader()
    assert bench.ask(READ, 13) == []


def test_boot_leads_out_of_fault() -> None:
    bench = at_rest()
    bench.device.enter_fault(FaultCause.COMMANDED)
    assert bench.status(ACTION, client.BOOT, b"\x01") == 0
    bench.run(BOOT_MS + 5)
    assert bench.device.mode == Mode.STANDBY
    assert bench.one(READ, 13).arguments == client.DEFAULTS[13]


def test_a_device_that_starts_by_itself_waits_in_the_boot_loader() -> None:
    from st_emulator.bench.scenario import Scenario

    bench = Bench(unit(autonomous=False), Scenario(parameters={"autonomous_start": 1})).to_loader()
    bench.run(10)
    assert bench.device.mode == Mode.STANDBY


def test_set_time_in_fault_and_where_it_is_told() -> None:
    bench = at_rest()
    bench.device.enter_fault(FaultCause.COMMANDED)
    assert bench.status(ACTION, client.SET_TIME, bytes(8)) == 0
    assert f"{115200} baud" in bench.emulator.dialect.where()
    assert "0x21" in bench.emulator.dialect.where()
