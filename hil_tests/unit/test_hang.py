"""The processor hangs, and the watchdog resets it: nothing is sent, taken or processed meanwhile."""

from __future__ import annotations

import pytest

from st_emulator.firmware_model.causes import FaultCause, ResetCause
from st_emulator.firmware_model.modes import Mode

from .conftest import MODE, MS, Bench, MakeBench, make_can

PERIOD_MS = 250
WATCHDOG_MS = 700


def hang(bench: Bench) -> None:
    bench.broken = []  # what the line had half of
    bench.emulator.device.hang(WATCHDOG_MS * MS)


@pytest.mark.parametrize("mode", ["STANDBY", "SELF_TEST", "LOST_IN_SPACE", "TRACKING", "FAULT"])
def test_in_every_mode(bench: Bench, mode: str) -> None:
    bench.to_mode(mode)
    bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 1000})
    bench.function("CAPTURE_IMAGE")
    bench.run(15)
    hang(bench)
    device = bench.emulator.device
    assert device.silent
    assert not device.listening
    sent = len(bench.groups)
    for _ in range(3):
        bench.send("ping")
        bench.run(150)
    assert len(bench.groups) - sent <= 1, "what the UART holds is on the line"
    assert device.mode == MODE[mode], "it stands where it stood"
    bench.forget()
    bench.run(WATCHDOG_MS - 450 - 1)
    assert len(bench.groups) - sent <= 1
    bench.run(bench.emulator.profile.timing.boot_ms + 20)
    assert device.mode == Mode.STANDBY
    (booted,) = bench.events("BOOT_COMPLETED")
    assert booted == {"boot_count": 2, "reset_cause": 3}
    assert bench.of("pong") == []
    bench.run(2500)
    assert {packet.name for packet in bench.packets} <= {"event_info", "hk_report"}, "nothing of before"
    count = bench.send("ping")
    bench.run(50)
    assert bench.stages(count)[-1] == "completion_success"
    status = bench.housekeeping(1)
    assert status["reset_cause"] == 3
    assert status["frames_dropped"] == 0


def test_in_boot(new_bench: MakeBench) -> None:
    bench = new_bench(parameters={"autonomous_start": 1})
    bench.run_to(200)
    hang(bench)
    bench.run_to(200 + WATCHDOG_MS + 399)
    assert bench.packets == []
    bench.run(20)
    (booted,) = bench.events("BOOT_COMPLETED")
    assert booted == {"boot_count": 2, "reset_cause": 3}


def test_without_power_and_shut_down_nothing_hangs(bench: Bench) -> None:
    device = bench.emulator.device
    device.power_off()
    hang(bench)
    bench.run(2000)
    assert device.mode == Mode.OFF
    assert bench.emulator.next_event_ns() is None
    device.power_on()
    bench.run(450)
    bench.function("SHUTDOWN", ack=0)
    bench.run(100)
    assert device.mode == Mode.OFF
    hang(bench)
    bench.run(2000)
    assert device.mode == Mode.OFF, "its watchdog is off as well"


def test_power_goes_while_it_hangs(bench: Bench) -> None:
    bench.to_mode("TRACKING")
    hang(bench)
    bench.run(200)
    bench.emulator.device.power_off()
    bench.run(200)
    bench.emulator.device.power_on()
    bench.forget()
    bench.run(2500)
    (booted,) = bench.events("BOOT_COMPLETED")
    assert booted == {"boot_count": 2, "reset_cause": 0}, "once, by power: the watchdog is of a former life"


def test_a_second_hang_does_not_put_off_the_watchdog(bench: Bench) -> None:
    hang(bench)
    bench.run(600)
    hang(bench)
    bench.run(100 + bench.emulator.profile.timing.boot_ms + 20)
    assert len(bench.events("BOOT_COMPLETED")) == 1


def test_a_reset_or_a_fault_while_it_hangs(bench: Bench) -> None:
    device = bench.emulator.device
    bench.to_mode("TRACKING")
    hang(bench)
    device.enter_fault(FaultCause.COMMANDED)
    assert device.mode == Mode.TRACKING, "nothing is processed, and nothing found"
    bench.run(100)
    bench.forget()
    device.restart(ResetCause.FAULT)
    bench.run(2000)
    (booted,) = bench.events("BOOT_COMPLETED")
    assert booted["reset_cause"] == 4


def test_while_going_down(bench: Bench) -> None:
    bench.function("RESET", {"kind": 1}, ack=0)
    bench.run(1)
    hang(bench)
    bench.run(WATCHDOG_MS + bench.emulator.profile.timing.boot_ms + 20)
    (booted,) = bench.events("BOOT_COMPLETED")
    assert booted == {"boot_count": 2, "reset_cause": 3}


def test_the_frame_grid_goes_on(new_bench: MakeBench) -> None:
    """Its phase is that of power-on, and frames are numbered through."""
    bench = new_bench(parameters={"autonomous_start": 1})
    bench.run_to(2013)
    hang(bench)
    bench.forget()
    bench.run_to(5000)
    reports = bench.of("attitude_report")
    indices = [report["frame_index"] for report in reports]
    assert indices == list(range(indices[0], indices[0] + len(indices)))
    back_ms = 2013 + WATCHDOG_MS + bench.emulator.profile.timing.boot_ms
    assert indices[0] == -(-back_ms // PERIOD_MS)
    (booted,) = bench.events("BOOT_COMPLETED")
    assert booted["reset_cause"] == 3
    for report in reports:
        coarse, fine = report["mid_exposure_time"]
        onboard_ms = coarse * 1e3 + fine * 1e3 / 2**24
        since_ms = report["frame_index"] * PERIOD_MS + 50 - (2013 + WATCHDOG_MS)
        assert onboard_ms == pytest.approx(since_ms, abs=1e-3), "time counts from the reset"


def test_parameters_stay_and_time_goes(bench: Bench) -> None:
    bench.set_parameters(exposure_us=70_000)
    bench.send("set_time", {"time": (2_000_000_000, 0)})
    bench.run(400)
    assert bench.housekeeping(1)["time_status"] != 0
    hang(bench)
    bench.run(WATCHDOG_MS + 600)
    assert bench.parameter("exposure_us") == 70_000
    assert bench.housekeeping(1)["time_status"] == 0


def test_on_a_can_bus() -> None:
    bench = make_can(parameters={"autonomous_start": 1})
    bench.run_to(2000)
    hang(bench)
    bench.forget()
    bench.send("ping")
    bench.run(WATCHDOG_MS + bench.emulator.profile.timing.boot_ms - 10)
    assert bench.peer.frames == [], "no cyclic frame, no heartbeat, no flow control"
    assert bench.packets == []
    bench.run(1900)
    assert next(values["counter"] for _, values in bench.frames("heartbeat")) == 0
    (booted,) = bench.events("BOOT_COMPLETED")
    assert booted["reset_cause"] == 3
    assert bench.emulator.device.mode == MODE["TRACKING"]
