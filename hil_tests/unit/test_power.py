"""Power off and on: one frame grid, nothing of the life before, again and again."""

from __future__ import annotations

import pytest

from st_emulator.firmware_model.modes import Mode

from .conftest import MODE, MS, Bench, MakeBench, make_can

PERIOD_MS = 250


def cycle(bench: Bench, off_ms: float = 100) -> None:
    bench.emulator.device.power_off()
    bench.run(off_ms)
    bench.emulator.device.power_on()


def test_off_at_once_and_silent(bench: Bench) -> None:
    bench.to_mode("TRACKING")
    bench.run(200)
    bench.forget()
    sent = len(bench.groups)
    bench.emulator.device.power_off()
    assert bench.emulator.device.mode == Mode.OFF
    bench.run(2000)
    assert len(bench.groups) - sent <= 1, "what the UART holds is on the line"
    assert bench.packets == []
    assert bench.emulator.next_event_ns() is None, "no frame is exposed either: nothing goes on"


def test_the_frame_grid_begins_anew_with_power_and_there_is_one(new_bench: MakeBench) -> None:
    bench = new_bench(parameters={"autonomous_start": 1})
    bench.run_to(1030)
    for number in range(4):
        bench.forget()
        cycle(bench, off_ms=37 + 11 * number)
        on_ms = bench.now_ms
        bench.run(3000)
        reports = bench.of("attitude_report")
        indices = [report["frame_index"] for report in reports]
        assert indices == list(range(indices[0], indices[0] + len(indices))), "each frame once"
        assert indices[0] == 2, "the first one whose exposure begins when the unit runs"
        assert len(indices) == int(3000 / PERIOD_MS) - 2
        for report in reports:
            coarse, fine = report["mid_exposure_time"]
            mid_ms = report["frame_index"] * PERIOD_MS + 50
            onboard_ms = coarse * 1e3 + fine * 1e3 / 2**24
            assert onboard_ms == pytest.approx(mid_ms, abs=1e-3), "time counts from there"
        (booted,) = bench.events("BOOT_COMPLETED")
        assert booted == {"boot_count": number + 2, "reset_cause": 0}
        (event,) = [packet for packet in bench.packets if packet.fields.get("event_id") == 1]
        assert event.decoded["sequence_count"] == 0
        assert event.t_ns / MS >= on_ms + bench.emulator.profile.timing.boot_ms


def test_twice_on_and_twice_off_are_once(new_bench: MakeBench) -> None:
    bench = new_bench(parameters={"autonomous_start": 1})
    bench.emulator.device.power_on()
    bench.run(1500)
    bench.emulator.device.power_on()
    bench.run(1500)
    assert len(bench.events("BOOT_COMPLETED")) == 1
    indices = [report["frame_index"] for report in bench.of("attitude_report")]
    assert indices == sorted(set(indices))
    bench.emulator.device.power_off()
    bench.emulator.device.power_off()
    assert bench.emulator.device.mode == Mode.OFF


def test_power_leads_out_of_a_shutdown(bench: Bench) -> None:
    bench.function("SHUTDOWN", ack=0)
    bench.run(500)
    assert bench.emulator.device.mode == Mode.OFF
    bench.emulator.device.power_on()  # it was never away
    bench.run(1000)
    assert bench.emulator.device.mode == Mode.OFF
    cycle(bench)
    bench.forget()
    bench.run(700)
    assert bench.emulator.device.mode == Mode.STANDBY
    count = bench.send("ping")
    bench.run(50)
    assert bench.stages(count)[-1] == "completion_success"


@pytest.mark.parametrize("mode", ["SELF_TEST", "LOST_IN_SPACE", "TRACKING", "FAULT"])
def test_from_every_mode(bench: Bench, mode: str) -> None:
    bench.to_mode(mode)
    bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 1000})
    bench.function("CAPTURE_IMAGE")
    bench.run(15)
    bench.broken = []
    cycle(bench)
    bench.forget()
    bench.run(2500)
    assert bench.emulator.device.mode == Mode.STANDBY
    assert {packet.name for packet in bench.packets} <= {"event_info", "hk_report"}, "nothing of before"
    assert bench.events("MODE_CHANGED") == []


def test_parameters_stay_and_all_else_goes(bench: Bench) -> None:
    bench.set_parameters(exposure_us=70_000)
    bench.send("set_time", {"time": (2_000_000_000, 0)})
    load = {"memory_id": 1, "start_address": 0, "data": b"abc", "checksum": 0x514A}
    bench.send("memory_load", load)
    bench.send("event_disable", {"event_ids": [1]})
    bench.run(400)
    cycle(bench)
    bench.run(600)
    assert len(bench.events("BOOT_COMPLETED")) == 1, "its event is enabled again"
    assert bench.parameter("exposure_us") == 70_000
    status = bench.housekeeping(1)
    assert status["time_status"] == 0
    assert status["boot_count"] == 2
    bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 3}, ack=0)
    bench.run(30)
    assert bench.of("memory_dump_report")[0]["data"] == bytes(3)


def test_on_a_can_bus() -> None:
    bench = make_can(parameters={"autonomous_start": 1})
    bench.run_to(2000)
    for _ in range(3):
        cycle(bench, 55)
        bench.forget()
        bench.run(400)
        assert bench.peer.frames == [], "nothing in BOOT"
        bench.run(1800)
        counters = [values["counter"] for _, values in bench.frames("heartbeat")]
        assert counters == [0, 1]
        indices = [values["counter"] for _, values in bench.frames("status")]
        assert indices == list(range(2, 2 + len(indices)))
        assert bench.of("attitude_report")
        assert bench.emulator.device.mode == MODE["TRACKING"]
