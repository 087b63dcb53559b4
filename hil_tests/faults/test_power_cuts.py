"""A power cut at each octet of a parameter write and of a memory load: then the old or the new value."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hil_tests.unit.conftest import MS, PARAMETER, Bench, make, make_can
from hil_tests.vectors import reference_decoder as wire
from st_emulator.device.store import FileStore

OLD = {"exposure_us": 80_000, "detection_sigma": 6.5}
NEW = {"exposure_us": 93_000, "detection_sigma": 7.25}
WRITE = {"settings": [{"parameter_id": PARAMETER[name], "value": value} for name, value in NEW.items()]}
DATA = bytes(range(0x80, 0xA0))
OFF_S = 0.05
BOOT_MS = 20
#: A unit that is quick to start, with parameters of its own; housekeeping stays away.
UNIT: dict[str, Any] = {"timing": {"boot_ms": BOOT_MS}, "wire": {"status_interval_ms": 0}}
Make = Callable[..., Bench]


def unit(make_bench: Make = make, **arguments: Any) -> Bench:
    """With the old parameters stored; it sends packets that are cut."""
    bench = make_bench(**UNIT, **arguments)
    bench.broken = []
    bench.run(BOOT_MS + 5)
    bench.set_parameters(**OLD)
    bench.forget()
    return bench


def values(bench: Bench) -> dict[str, float]:
    number = len(bench.of("parameter_values"))
    bench.send("parameter_report", {"parameter_ids": [PARAMETER[name] for name in OLD]}, ack=0)
    bench.run_until(lambda: len(bench.of("parameter_values")) > number)
    told = {item["parameter_id"]: item["value"] for item in bench.of("parameter_values")[number]["values"]}
    return {name: told[PARAMETER[name]] for name in OLD}


def octets_of(bench: Bench, memory: int, start: int) -> bytes:
    number = len(bench.of("memory_dump_report"))
    fields = {"memory_id": memory, "start_address": start, "length": len(DATA)}
    bench.send("memory_dump", fields, ack=0)
    bench.run_until(lambda: len(bench.of("memory_dump_report")) > number)
    report = bench.of("memory_dump_report")[number]
    assert report["checksum"] == wire.crc16(report["data"])
    return report["data"]


def through_the_cut(bench: Bench) -> None:
    """Power goes and comes back, and the unit has started by itself."""
    bench.run_until(lambda: bool(bench.events("BOOT_COMPLETED")), 400)
    assert bench.events("PARAMETER_STORE_INVALID") == []
    bench.run(5)


def load(memory: int, start: int, data: bytes = DATA) -> dict[str, Any]:
    return {"memory_id": memory, "start_address": start, "data": data, "checksum": wire.crc16(data)}


# -- in the memory


def write_cut_at(bench: Bench, octet: int) -> bool:
    """Write the new parameters, power goes at an octet. False: the write has no such octet."""
    number = bench.emulator.faults.inject(
        {
            "kind": "power.cut",
            "during": "parameter_write",
            "at_octet": octet,
            "off_s": OFF_S,
            "duration_s": 0.3,
        }
    )
    count = bench.send("parameter_set", WRITE)
    bench.run(15)
    if "completion_success" in bench.stages(count):
        bench.emulator.faults.clear(number)
        return False
    through_the_cut(bench)
    bench.run(400)
    assert bench.emulator.faults.active() == []
    return True


def every_octet(bench_of: Callable[[int], Bench], step: int = 1) -> list[dict[str, float]]:
    """The parameters after a cut at each octet of the write, until there is none."""
    after, octet = [], 0
    while write_cut_at(bench := bench_of(octet), octet):
        after.append(values(bench))
        octet += step
    return after


def test_each_octet_of_a_parameter_write() -> None:
    after = every_octet(lambda octet: unit())
    assert len(after) > 50
    assert after == [OLD] * (len(after) - 1) + [NEW], "with the last octet it is the new one"


def test_each_octet_of_a_parameter_write_on_can() -> None:
    after = every_octet(lambda octet: unit(make_can), step=7)
    assert len(after) > 8
    assert after in ([OLD] * len(after), [OLD] * (len(after) - 1) + [NEW])


READ = """
import json, sys
from st_emulator.device.store import FileStore
print(json.dumps([
    [contents.parameters, contents.boot_count, fault]
    for contents, fault in (FileStore(path, "roja1").load() for path in sys.argv[1:])
]))
"""


def test_each_octet_of_a_parameter_write_into_a_file(tmp_path: Path) -> None:
    paths: list[Path] = []

    def fresh(octet: int) -> Bench:
        paths.append(tmp_path / f"{octet}.json")
        return unit(store=FileStore(paths[-1], "roja1"))

    after = every_octet(fresh)
    done = subprocess.run([sys.executable, "-c", READ, *map(str, paths)], capture_output=True, check=True)
    found = json.loads(done.stdout)
    assert found[:-1] == [[values, 2, None] for values in after], "another process reads what the unit told"
    assert found[-1] == [NEW, 1, None], "the write that was not cut"
    for path in (paths[3], paths[-2]):
        bench = make(store=FileStore(path, "roja1")).boot()
        assert values(bench) in (OLD, NEW)


@pytest.mark.parametrize(("memory", "start"), [(1, 4096), (4, 1000)], ids=["RAM", "program"])
@pytest.mark.parametrize("make_bench", [make, make_can], ids=["serial", "can"])
def test_each_octet_of_a_memory_load(memory: int, start: int, make_bench: Make) -> None:
    for octet in range(len(DATA) + 1):
        bench = unit(make_bench)
        old = octets_of(bench, memory, start)
        bench.emulator.faults.inject(
            {
                "kind": "power.cut",
                "during": "memory_load",
                "at_octet": octet,
                "off_s": OFF_S,
                "duration_s": 0.3,
            }
        )
        count = bench.send("memory_load", load(memory, start))
        through_the_cut(bench)
        assert "completion_success" not in bench.stages(count)
        assert octets_of(bench, memory, start) == old, "operation memory is as after any start"
        assert values(bench) == OLD


def test_a_load_that_is_longer_than_where_the_cut_would_be_is_not_cut() -> None:
    bench = unit()
    bench.emulator.faults.inject({"kind": "power.cut", "during": "memory_load", "at_octet": len(DATA) + 1})
    count = bench.send("memory_load", load(1, 0))
    bench.run(50)
    assert bench.stages(count)[-1] == "completion_success"
    assert octets_of(bench, 1, 0) == DATA


# -- on the line


def octet_ns(bench: Bench) -> float:
    return 10 * 1e9 / bench.emulator.baud


@pytest.mark.parametrize("half", [0.0, 0.5], ids=["between octets", "in an octet"])
def test_each_octet_of_the_telecommand_of_a_parameter_write(half: float) -> None:
    """Up to the reports of its completion and behind."""
    bench = unit()
    octets = len(wire.slip_frame(bench.packet("parameter_set", WRITE)))
    latency = round(bench.emulator.profile.timing.telecommand_latency_us * 1000 / octet_ns(bench)) + 40
    seen = []
    for octet in range(0, octets + latency):
        bench = unit()
        start_ns = bench.emulator.now_ns + round((octet + half) * octet_ns(bench))
        bench.emulator.faults.inject({"kind": "power.cut", "start_s": start_ns / 1e9, "duration_s": OFF_S})
        bench.send("parameter_set", WRITE)
        through_the_cut(bench)
        after = values(bench)
        assert after in (OLD, NEW)
        seen.append(after == NEW)
        if octet < octets:
            assert after == OLD, "not even received"
    assert seen == sorted(seen), "old up to an instant, new from there on"
    assert seen[-1]


@pytest.mark.parametrize("memory", [1, 4])
def test_each_octet_of_the_telecommand_of_a_memory_load(memory: int) -> None:
    octets = len(wire.slip_frame(unit().packet("memory_load", load(memory, 64))))
    for octet in range(octets + 40):
        bench = unit()
        old = octets_of(bench, memory, 64)
        start_ns = bench.emulator.now_ns + round((octet + 0.5) * octet_ns(bench))
        bench.emulator.faults.inject({"kind": "power.cut", "start_s": start_ns / 1e9, "duration_s": OFF_S})
        bench.send("memory_load", load(memory, 64))
        through_the_cut(bench)
        assert octets_of(bench, memory, 64) == old


def test_while_the_frames_of_a_telecommand_are_on_the_bus() -> None:
    seen = []
    for step in range(0, 60):
        bench = unit(make_can)
        start_ns = bench.emulator.now_ns + step * 130_000  # about a frame of 1 Mbit/s
        bench.emulator.faults.inject({"kind": "power.cut", "start_s": start_ns / 1e9, "duration_s": OFF_S})
        bench.send("parameter_set", WRITE)
        through_the_cut(bench)
        bench.run(1100)  # what the OBC's end of the transfer waits for
        after = values(bench)
        assert after in (OLD, NEW)
        seen.append(after == NEW)
    assert seen == sorted(seen)
    assert not seen[0]
    assert seen[-1]


# -- the counting of a start is a write, too


def test_power_that_goes_while_a_start_counts_itself() -> None:
    bench = unit()
    bench.emulator.faults.inject(
        {"kind": "power.cut", "during": "parameter_write", "at_octet": 9, "off_s": OFF_S}
    )
    bench.emulator.faults.inject({"kind": "power.cut", "duration_s": OFF_S})
    bench.run(600)
    (booted,) = bench.events("BOOT_COMPLETED")
    assert booted["boot_count"] == 2, "the start that did not get there is not counted"
    assert values(bench) == OLD
    bench.run(2000)
    assert len(bench.events("BOOT_COMPLETED")) == 1
    assert bench.now_ms * MS == bench.emulator.now_ns
