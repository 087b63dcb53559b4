"""Boot, self-test, resets, shutdown, fault: what is kept, what is told, what is silent."""

from dataclasses import replace

import numpy as np
import pytest

from hil_tests.vectors import reference_decoder as wire
from st_emulator.firmware_model.configuration import StarTables
from st_emulator.protocol.pus.enumerations import FaultCause, ResetCause

from .conftest import MODE, MS, Bench, MakeBench, Packet

ABORTED = 17


def test_boot(new_bench: MakeBench) -> None:
    bench = new_bench()
    bench.run(399)
    assert bench.packets == []
    assert bench.emulator.device.mode == MODE["BOOT"]
    bench.run(20)
    assert bench.events("BOOT_COMPLETED") == [{"boot_count": 1, "reset_cause": 0}]
    first = bench.packets[0].decoded
    assert (first["sequence_count"], first["message_count"]) == (0, 0)
    coarse, fine = first["time"]
    assert coarse + fine / 2**24 == pytest.approx(0.4, abs=1e-6)
    assert len(bench.packets) == 1


def test_counters_of_packets_and_of_each_message(bench: Bench) -> None:
    for _ in range(3):
        bench.send("ping")
        bench.run(20)
    counts = [packet.decoded["sequence_count"] for packet in bench.packets]
    assert counts == list(range(counts[0], counts[0] + 9))
    for name in ("acceptance_success", "pong", "completion_success"):
        numbers = [packet.decoded["message_count"] for packet in bench.packets if packet.name == name]
        assert numbers == [0, 1, 2]


@pytest.mark.parametrize(("kind", "cause"), [(0, 1), (1, 2)])
def test_reset(bench: Bench, kind: int, cause: int) -> None:
    bench.send("event_disable", {"event_ids": [2]}, ack=0)
    bench.send("time_report_rate", {"rate_exponent": 0}, ack=0)
    bench.run(20)
    before = bench.housekeeping(2)
    bench.function("RESET", {"kind": kind}, ack=0)
    bench.run(30)
    bench.forget()
    bench.run(450)
    assert bench.events("BOOT_COMPLETED") == [{"boot_count": 2, "reset_cause": cause}]
    assert bench.packets[0].decoded["sequence_count"] == 0, "counts start anew"
    bench.run(1200)
    assert bench.of("time_report") == []
    assert [fields["structure_id"] for fields in bench.of("hk_report")] == [1]
    status = bench.housekeeping(1)
    assert status["reset_cause"] == cause
    assert status["boot_count"] == 2
    assert status["uptime_ms"] < 1700
    link = bench.housekeeping(2)
    if kind == 0:
        assert link["tc_received"] == before["tc_received"] + 3  # RESET and two questions
        assert link["tx_bytes"] > before["tx_bytes"]
    else:
        assert link["tc_received"] == 2
        assert link["tx_packets"] < before["tx_packets"] + 3


def test_the_frame_grid_runs_through_a_reset(bench: Bench) -> None:
    bench.to_mode("TRACKING")
    bench.run(500)
    bench.function("RESET", {"kind": 1})
    bench.run(600)
    bench.forget()
    bench.to_mode("TRACKING")
    bench.run(500)
    for packet in bench.packets:
        if packet.name == "attitude_report":
            frame_start_ms = packet.fields["frame_index"] * 250
            assert 116.7 < packet.t_ns / MS - frame_start_ms < 500


def test_a_reset_lets_the_queue_run_empty_and_hears_nothing_meanwhile(bench: Bench) -> None:
    for _ in range(4):
        bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 1024})
    reset = bench.function("RESET", {"kind": 0})
    ping = bench.send("ping")
    bench.run(60)
    start_late = bench.function("START_ACQUISITION")
    bench.run(1500)
    names = [packet.name for packet in bench.packets]
    assert names.count("memory_dump_report") == 4, "whole, on the line before the reset"
    assert bench.stages(reset) == ["acceptance_success", "start_success"]
    assert bench.stages(ping) == bench.stages(start_late) == []
    assert bench.events("BOOT_COMPLETED") == [{"boot_count": 2, "reset_cause": 1}]
    assert bench.emulator.device.mode == MODE["STANDBY"]


def test_a_reset_ends_what_runs(bench: Bench) -> None:
    test = bench.function("START_SELF_TEST")
    bench.run(100)
    reset = bench.function("RESET", {"kind": 0})
    bench.run(2000)
    assert bench.failure(test) == ("completion_failure", ABORTED, 0)
    assert bench.stages(reset) == ["acceptance_success", "start_success"]
    assert bench.events("SELF_TEST_COMPLETED") == []
    assert bench.emulator.device.mode == MODE["STANDBY"]
    assert len(bench.events("BOOT_COMPLETED")) == 1


@pytest.mark.parametrize("mode", ["STANDBY", "TRACKING", "SELF_TEST", "FAULT"])
def test_shutdown_is_silent_behind_its_reports(bench: Bench, mode: str) -> None:
    bench.send("hk_enable", {"structure_ids": [1, 2]}, ack=0)
    bench.to_mode(mode)
    bench.run(30)
    bench.forget()
    count = bench.function("SHUTDOWN")
    bench.run(100)
    assert bench.stages(count) == ["acceptance_success", "start_success", "completion_success"]
    assert len(bench.events("SHUTDOWN_STARTED")) == 1
    assert bench.emulator.device.mode == MODE["OFF"]
    ended = [packet.name for packet in bench.packets if packet.name.startswith("completion")]
    assert ended == ["completion_failure"] * (mode == "SELF_TEST") + ["completion_success"]
    groups = len(bench.groups)
    frames = bench.emulator.device.frame_counters.frames_processed
    bench.run(20_000)
    assert len(bench.groups) == groups
    assert bench.emulator.device.frame_counters.frames_processed == frames


def test_autonomous_start(new_bench: MakeBench) -> None:
    bench = new_bench(parameters={"autonomous_start": 1})
    bench.run(2000)
    assert bench.events("MODE_CHANGED") == [
        {"from_mode": MODE["STANDBY"], "to_mode": MODE["LOST_IN_SPACE"], "cause": 11},
        {"from_mode": MODE["LOST_IN_SPACE"], "to_mode": MODE["TRACKING"], "cause": 12},
    ]
    assert bench.of("attitude_report")[0]["frame_index"] == 2, "the first frame that starts behind the boot"


def test_self_test_passes(bench: Bench) -> None:
    bench.run_to(1000)
    count = bench.function("START_SELF_TEST")
    bench.run(590)
    assert bench.housekeeping(1)["mode"] == MODE["SELF_TEST"]
    bench.run(60)
    assert bench.stages(count)[-1] == "completion_success"
    assert bench.events("SELF_TEST_COMPLETED") == [{"result": 0}]
    assert bench.events("MODE_CHANGED") == [
        {"from_mode": 2, "to_mode": 1, "cause": 8},
        {"from_mode": 1, "to_mode": 2, "cause": 3},
    ]
    steps = [packet for packet in bench.reports(count) if packet.name == "progress"]
    started = next(packet for packet in bench.reports(count) if packet.name == "start_success")

    def ms(packet: Packet) -> float:
        coarse, fine = packet.decoded["time"]
        return coarse * 1e3 + fine * 1e3 / 2**24

    assert [ms(step) - ms(started) for step in steps] == [
        pytest.approx(n * 150, abs=1e-3) for n in (1, 2, 3, 4)
    ]
    assert bench.housekeeping(1)["self_test_result"] == 0


def test_self_test_leaves_memory_as_it_was(bench: Bench) -> None:
    load = {"memory_id": 1, "start_address": 5, "data": b"keep me", "checksum": wire.crc16(b"keep me")}
    bench.send("memory_load", load, ack=0)
    bench.function("START_SELF_TEST", ack=0)
    bench.run(800)
    bench.send("memory_dump", {"memory_id": 1, "start_address": 5, "length": 7}, ack=0)
    bench.run(30)
    assert bench.of("memory_dump_report")[0]["data"] == b"keep me"


def damaged(tables: StarTables) -> StarTables:
    """One bit of one direction is another."""
    vectors = tables.catalogue.unit_vectors.copy()
    vectors.view(np.uint64)[7, 1] ^= 1
    return replace(tables, catalogue=replace(tables.catalogue, unit_vectors=vectors))


def test_self_test_sees_a_damaged_catalogue_and_a_repaired_one(bench: Bench) -> None:
    unit = bench.emulator.device
    good = unit.memories.tables
    unit.memories.overwrite_tables(damaged(good))
    count = bench.function("START_SELF_TEST")
    bench.run(700)
    assert bench.failure(count) == ("completion_failure", 16, 8)
    assert unit.mode == MODE["FAULT"]
    assert bench.events("MODE_CHANGED")[-1] == {"from_mode": 1, "to_mode": 5, "cause": 4}
    unit.memories.overwrite_tables(good)
    bench.forget()
    count = bench.function("START_SELF_TEST")
    bench.run(700)
    assert bench.stages(count)[-1] == "completion_success"
    assert unit.mode == MODE["STANDBY"], "a passed self-test leads out of FAULT"


@pytest.mark.parametrize("mode", ["STANDBY", "LOST_IN_SPACE", "TRACKING", "SELF_TEST"])
def test_fault_stops_everything(bench: Bench, mode: str) -> None:
    bench.to_mode(mode)
    bench.forget()
    bench.emulator.device.enter_fault(FaultCause.SENSOR_LOST)
    bench.emulator.device.enter_fault(FaultCause.SENSOR_LOST)  # once is enough
    bench.run(1500)
    assert bench.events("FAULT_ENTERED") == [{"cause": 2}]
    changes = bench.events("MODE_CHANGED")
    assert changes[-1] == {"from_mode": MODE[mode], "to_mode": MODE["FAULT"], "cause": 14}
    assert [change["to_mode"] for change in changes].count(MODE["FAULT"]) == 1
    assert bench.events("SELF_TEST_COMPLETED") == []
    assert len(bench.of("attitude_report")) <= 1, "one may still wait for the line"
    (event,) = [packet for packet in bench.packets if packet.fields.get("event_id") == 13]
    assert event.name == "event_high"
    bench.function("RESET", {"kind": 0})
    bench.run(600)
    assert bench.emulator.device.mode == MODE["STANDBY"]


def test_a_fault_ends_the_requests_that_run(bench: Bench) -> None:
    test = bench.function("START_SELF_TEST")
    bench.run(30)
    bench.emulator.device.enter_fault(FaultCause.COMMANDED)
    bench.run(1000)
    assert bench.failure(test) == ("completion_failure", ABORTED, 0)


def test_a_watchdog_reset_at_once_loses_what_waits(bench: Bench) -> None:
    for _ in range(4):
        bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 1024}, ack=0)
    bench.run(60)
    bench.broken = []
    bench.emulator.device.restart(ResetCause.WATCHDOG)
    bench.run(600)
    assert bench.of("memory_dump_report") == []
    assert len(bench.broken) == 1, "the one on the line is cut and costs no packet behind it"
    assert bench.events("BOOT_COMPLETED") == [{"boot_count": 2, "reset_cause": 3}]


def test_a_fault_in_the_boot_is_told_when_the_boot_is_over(new_bench: MakeBench) -> None:
    bench = new_bench(parameters={"autonomous_start": 1})
    bench.run(100)
    bench.emulator.device.enter_fault(FaultCause.COMMANDED)
    bench.emulator.device.enter_fault(FaultCause.SENSOR_LOST)  # the first is told
    bench.run(2000)
    told = [packet.fields["event_id"] for packet in bench.packets if packet.decoded["service"] == 5]
    assert told == [1, 2, 13], "BOOT_COMPLETED, MODE_CHANGED, FAULT_ENTERED"
    assert bench.events("MODE_CHANGED") == [{"from_mode": 2, "to_mode": 5, "cause": 14}]
    assert bench.events("FAULT_ENTERED") == [{"cause": int(FaultCause.COMMANDED)}]
    assert bench.of("attitude_report") == [], "no autonomous start"
    assert bench.housekeeping(1)["mode"] == MODE["FAULT"]
    bench.forget()
    bench.function("RESET", {"kind": 0}, ack=0)
    bench.run(600)
    assert bench.events("FAULT_ENTERED") == [], "it was of the boot before"
    assert bench.emulator.device.mode != MODE["FAULT"]
