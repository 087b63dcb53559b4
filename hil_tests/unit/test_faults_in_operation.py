"""FAULT without anybody's doing: a check in operation fails. What an OBC sees, and what leads out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from hil_tests.vectors import reference_decoder as wire
from st_emulator.device.memories import PROGRAM_BYTES

from .conftest import MODE, Bench, MakeBench
from .test_life import damaged

PROGRAM = 4
SENSOR_LOST, CATALOGUE_DAMAGED, PROGRAM_DAMAGED = 2, 4, 6
CHECKED_WITHIN_MS = 2100


def load(data: bytes, start: int = 1000, memory: int = PROGRAM) -> dict[str, Any]:
    return {"memory_id": memory, "start_address": start, "data": data, "checksum": wire.crc16(data)}


def dump(bench: Bench, start: int, length: int) -> bytes:
    number = len(bench.of("memory_dump_report"))
    bench.send("memory_dump", {"memory_id": PROGRAM, "start_address": start, "length": length}, ack=0)
    bench.run_until(lambda: len(bench.of("memory_dump_report")) > number)
    return bench.of("memory_dump_report")[number]["data"]


def faults(bench: Bench) -> list[int]:
    return [event["cause"] for event in bench.events("FAULT_ENTERED")]


@pytest.mark.parametrize("mode", ["STANDBY", "LOST_IN_SPACE", "TRACKING"])
def test_a_damaged_program(bench: Bench, mode: str) -> None:
    good = dump(bench, 1000, 4)
    count = bench.send("memory_load", load(bytes([good[0] ^ 1]) + good[1:]))
    bench.run(20)
    assert bench.stages(count)[-1] == "completion_success"
    if mode != "STANDBY":
        bench.function("START_ACQUISITION", ack=0)
    bench.forget()
    bench.run(CHECKED_WITHIN_MS)
    assert faults(bench) == [PROGRAM_DAMAGED]
    (change,) = [item for item in bench.events("MODE_CHANGED") if item["to_mode"] == MODE["FAULT"]]
    assert change["cause"] == 14
    bench.forget()
    bench.run(1000)
    assert bench.of("attitude_report") == []
    assert faults(bench) == [], "told once"


def test_a_program_written_over_with_itself_is_whole(bench: Bench) -> None:
    bench.send("memory_load", load(dump(bench, 1000, 4)), ack=0)
    bench.run(2 * CHECKED_WITHIN_MS)
    assert faults(bench) == []
    assert bench.emulator.device.mode == MODE["STANDBY"]


def test_the_self_test_finds_it_until_a_reset_copies_the_program_anew(bench: Bench) -> None:
    good = dump(bench, 0, 8)
    bench.send("memory_load", load(bytes(8), 0), ack=0)
    bench.run(CHECKED_WITHIN_MS)
    count = bench.function("START_SELF_TEST")
    bench.run(800)
    assert bench.failure(count) == ("completion_failure", 16, 64)
    assert bench.emulator.device.mode == MODE["FAULT"]
    bench.function("RESET", {"kind": 0}, ack=0)
    bench.run(800)
    assert bench.emulator.device.mode == MODE["STANDBY"]
    assert dump(bench, 0, 8) == good
    bench.run(CHECKED_WITHIN_MS)
    assert faults(bench) == [PROGRAM_DAMAGED, 1]


def test_a_repair_and_a_self_test_lead_out_as_well(bench: Bench) -> None:
    good = dump(bench, 0, 8)
    bench.send("memory_load", load(bytes(8), 0), ack=0)
    bench.run(CHECKED_WITHIN_MS)
    assert bench.emulator.device.mode == MODE["FAULT"]
    bench.send("memory_load", load(good, 0), ack=0)
    bench.function("START_SELF_TEST", ack=0)
    bench.run(900)
    assert bench.emulator.device.mode == MODE["STANDBY"]


def test_the_end_of_the_program_memory(bench: Bench) -> None:
    assert len(dump(bench, PROGRAM_BYTES - 3, 3)) == 3
    count = bench.send("memory_load", load(b"\0\0", PROGRAM_BYTES - 1))
    bench.run(20)
    assert bench.failure(count) == ("acceptance_failure", 14, PROGRAM_BYTES - 1)


def test_a_damaged_catalogue(bench: Bench) -> None:
    bench.to_mode("TRACKING")
    memories = bench.emulator.device.memories
    memories.overwrite_tables(damaged(memories.tables))
    bench.run(CHECKED_WITHIN_MS)
    assert faults(bench) == [CATALOGUE_DAMAGED]
    bench.function("RESET", {"kind": 0}, ack=0)
    bench.run(700)
    bench.to_mode("TRACKING")
    bench.run(CHECKED_WITHIN_MS)
    assert faults(bench) == [CATALOGUE_DAMAGED], "a start copies it anew"


class Dead:
    """A sensor that delivers ``frames`` frames and then none, until it is mended."""

    def __init__(self, source: Any, frames: int) -> None:
        self.source, self.left, self.mended = source, frames, False

    def frame(self, index: int, start_ns: int, exposure_ns: int) -> Any:
        self.left -= 1
        return self.source.frame(index, start_ns, exposure_ns) if self.left >= 0 or self.mended else None


def with_sensor(bench: Bench, frames: int) -> Dead:
    imaging = bench.emulator.device.imaging
    imaging._source = sensor = Dead(imaging._source, frames)
    return sensor


def test_a_dead_sensor(bench: Bench) -> None:
    sensor = with_sensor(bench, 6)
    bench.function("START_ACQUISITION", ack=0)
    bench.run(6 * 250 + 8 * 250 + 250)
    assert len(bench.events("FRAME_DROPPED")) == 7, "and with the eighth there is nothing more to wait for"
    assert faults(bench) == [SENSOR_LOST]
    bench.run(1000)
    count = bench.function("START_SELF_TEST")
    bench.run(800)
    assert bench.failure(count) == ("completion_failure", 16, 16)
    sensor.mended = True
    bench.function("START_SELF_TEST", ack=0)
    bench.run(800)
    assert bench.emulator.device.mode == MODE["STANDBY"]


def test_missed_frames_are_no_dead_sensor(bench: Bench) -> None:
    imaging = bench.emulator.device.imaging
    source = imaging._source

    class Stuttering:
        def frame(self, index: int, start_ns: int, exposure_ns: int) -> Any:
            return source.frame(index, start_ns, exposure_ns) if index % 8 == 0 else None

    imaging._source = Stuttering()
    bench.function("START_ACQUISITION", ack=0)
    bench.run(6000)
    assert faults(bench) == []


def test_a_capture_from_a_dead_sensor_ends(bench: Bench) -> None:
    with_sensor(bench, 0)
    count = bench.function("CAPTURE_IMAGE")
    bench.run(2500)
    assert faults(bench) == [SENSOR_LOST]
    assert bench.failure(count) == ("completion_failure", 17, 0)


def test_the_same_on_the_other_units(new_bench: MakeBench) -> None:
    for unit in ("zy3", "aps_rs"):
        bench = new_bench(unit).boot()
        with_sensor(bench, 0)
        bench.function("START_ACQUISITION", ack=0)
        bench.run(2500)
        assert faults(bench) == [SENSOR_LOST]


def test_an_undamaged_unit_is_never_in_fault(bench: Bench) -> None:
    tables = bench.emulator.device.memories.tables
    bench.emulator.device.memories.overwrite_tables(replace(tables))  # the same octets elsewhere
    bench.to_mode("TRACKING")
    bench.run(5000)
    assert faults(bench) == []


@pytest.mark.parametrize("later_ms", range(0, 2000, 250))
def test_the_self_test_is_not_cut_short_by_what_it_is_there_to_find(bench: Bench, later_ms: int) -> None:
    bench.send("memory_load", load(bytes(8), 0), ack=0)
    bench.run_until(lambda: bool(faults(bench)))
    bench.run(later_ms)
    count = bench.function("START_SELF_TEST")
    bench.run(900)
    assert bench.failure(count) == ("completion_failure", 16, 64)
    assert faults(bench) == [PROGRAM_DAMAGED, 1]
    assert bench.housekeeping(1)["self_test_result"] == 64


def test_a_dead_sensor_neither(bench: Bench) -> None:
    with_sensor(bench, 0)
    bench.function("START_ACQUISITION", ack=0)
    bench.run(7 * 250)  # one frame fewer than what is a dead sensor
    bench.function("GO_STANDBY", ack=0)
    count = bench.function("START_SELF_TEST")
    bench.run(900)
    assert bench.failure(count) == ("completion_failure", 16, 16)
    assert faults(bench) == [1]


def test_what_was_found_whole_is_not_looked_at_again(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """A hash over the whole catalogue each two seconds would slow every run down."""
    memories = bench.emulator.device.memories
    looks: list[int] = []
    whole = memories.catalogue_is_whole
    monkeypatch.setattr(memories, "catalogue_is_whole", lambda: looks.append(1) or whole())
    bench.send("memory_load", load(b"abc", 0, memory=1), ack=0)
    bench.run(2 * CHECKED_WITHIN_MS)
    assert looks == [], "the patch area is nobody's"
    bench.send("memory_load", load(dump(bench, 1000, 4)), ack=0)
    bench.run(4 * CHECKED_WITHIN_MS)
    assert looks == [1]
    bench.send("memory_load", load(bytes(4)), ack=0)
    bench.run(CHECKED_WITHIN_MS)
    assert faults(bench) == [PROGRAM_DAMAGED]
