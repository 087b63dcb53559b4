"""Faults of the power, exercised."""

from __future__ import annotations

from itertools import pairwise

from hil_tests.faults.exercise import Exercise, Seen
from hil_tests.faults.exercises_memory import checked
from hil_tests.unit.conftest import MS, Bench
from hil_tests.vectors import reference_decoder as wire

RAM = 1
WHOLE = {"transaction_id": 7, "first_part": 0, "parts": 0}


def boots(seen: Seen) -> list[tuple[float, int]]:
    """(time, boot_count) of each BOOT_COMPLETED after the fault's start."""
    found = [
        (one.t_ns / MS, one.fields["data"]) for one in seen.bench.packets
        if one.fields.get("event_id") == 1 and one.t_ns > seen.start_ms * MS
    ]  # fmt: skip
    assert all(data["reset_cause"] == 0 for _, data in found), "POWER_ON"
    return [(t_ms, data["boot_count"]) for t_ms, data in found]


def silence_ms(seen: Seen) -> float:
    """The longest after the fault's start."""
    times = [seen.start_ms, *(one.t_ns / MS for one in seen.sent if one.t_ns > seen.start_ms * MS)]
    return max(later - earlier for earlier, later in pairwise(times))


def cut(seen: Seen) -> str:
    assert seen.between(seen.start_ms + 10, seen.end_ms + 400) == []
    ((_, count),) = boots(seen)
    assert count == 2
    (packet,) = [one for one in seen.after() if one.fields.get("event_id") == 1]
    assert packet.decoded["sequence_count"] == 0
    return f"silence for {silence_ms(seen):.0f} ms, then BOOT_COMPLETED with boot_count {count}"


def write_a_parameter(bench: Bench, seen: Seen) -> None:
    bench.run(100)
    seen.figures["count"] = bench.send("parameter_set", {"settings": [{"parameter_id": 1, "value": 90_000}]})
    bench.run(2500)
    seen.figures["exposure_us"] = bench.parameter("exposure_us")


def parameter_old(seen: Seen) -> str:
    assert seen.bench.stages(seen.figures["count"]) == [], "the acceptance report is on the line, and cut off"
    ((_, count),) = boots(seen)
    assert seen.figures["exposure_us"] == 100_000
    return (
        f"no report but its first octets; silence for {silence_ms(seen):.0f} ms, BOOT_COMPLETED with "
        f"boot_count {count}; "
        "exposure_us is the old 100000"
    )


def load_memory(bench: Bench, seen: Seen) -> None:
    bench.function("GO_STANDBY", ack=0)
    bench.run(50)
    data = bytes(range(100, 132))
    load = {"memory_id": RAM, "start_address": 64, "data": data, "checksum": wire.crc16(data)}
    seen.figures["count"] = bench.send("memory_load", load)
    bench.run(2000)
    seen.figures["check"] = checked(bench, RAM, 64, 32)


def memory_old(seen: Seen) -> str:
    assert seen.bench.stages(seen.figures["count"]) == [], "the acceptance report is on the line, and cut off"
    assert seen.figures["check"] == wire.crc16(bytes(32))
    ((_, count),) = boots(seen)
    return (
        f"no report but its first octets; silence for {silence_ms(seen):.0f} ms, BOOT_COMPLETED with "
        f"boot_count {count}; "
        "RAM is empty as after a start"
    )


def download(bench: Bench, seen: Seen) -> None:
    bench.function("CAPTURE_IMAGE", ack=0)
    bench.run(600)
    seen.figures["count"] = bench.function("DOWNLOAD_IMAGE", WHOLE)


def download_ends(seen: Seen) -> str:
    bench = seen.bench
    stages = bench.stages(seen.figures["count"])
    assert stages[:2] == ["acceptance_success", "start_success"]
    assert "completion_success" not in stages
    parts = [one for one in bench.packets if one.name in ("image_first_part", "image_part")]
    assert parts
    assert not [one for one in bench.packets if one.name == "image_last_part"]
    ((_, count),) = boots(seen)
    return (
        f"whole parts: {len(parts)}; the next one is cut off; BOOT_COMPLETED with boot_count {count}, no "
        "image any more"
    )


def ask_for_the_image(bench: Bench, seen: Seen) -> None:
    download(bench, seen)
    bench.run_until(lambda: len(bench.events("BOOT_COMPLETED")) > 1)
    count = bench.function("DOWNLOAD_IMAGE", WHOLE)
    bench.run(50)
    assert "acceptance_failure" in bench.stages(count), "NO_IMAGE"


def boot_loop_in_silence(seen: Seen) -> str:
    assert seen.between(seen.start_ms + 10, seen.end_ms) == []
    ((_, count),) = boots(seen)
    assert count == 11
    return f"silence for {silence_ms(seen):.0f} ms, then BOOT_COMPLETED with boot_count {count}"


def boot_loop(seen: Seen) -> str:
    found = boots(seen)
    counts = [count for _, count in found]
    assert counts == [2, 3, 4]
    gaps = [later - earlier for (earlier, _), (later, _) in pairwise(found)]
    assert all(abs(gap - 1000) < 1 for gap in gaps)
    return (
        f"BOOT_COMPLETED {len(counts)} times, {gaps[0]:.0f} ms apart, boot_count {counts[0]} to {counts[-1]}"
    )


CUT, LOOP = {"kind": "power.cut"}, {"kind": "power.brown_out"}
EXERCISES = (
    Exercise(CUT, cut, lasts_ms=1000, reboots=True),
    Exercise(CUT, cut, on_can=True, lasts_ms=1000, reboots=True),
    Exercise(
        CUT | {"during": "parameter_write", "at_octet": 20, "off_s": 0.5}, parameter_old,
        "in a parameter write", reboots=True, meanwhile=write_a_parameter,
    ),
    Exercise(
        CUT | {"during": "memory_load", "at_octet": 17, "off_s": 0.5}, memory_old, "in a memory load",
        reboots=True, meanwhile=load_memory,
    ),
    Exercise(
        CUT | {"during": "image_download", "at_octet": 5000, "off_s": 0.5}, download_ends,
        "in an image download", reboots=True, meanwhile=ask_for_the_image,
    ),
    Exercise(
        CUT | {"during": "image_download", "at_octet": 5000, "off_s": 0.5}, download_ends,
        "in an image download", on_can=True, reboots=True, meanwhile=ask_for_the_image,
    ),
    Exercise(
        LOOP | {"after_ms": 200, "off_ms": 100}, boot_loop_in_silence, "in the boot", reboots=True,
    ),
    Exercise(
        LOOP | {"after_ms": 900, "off_ms": 100, "times": 3}, boot_loop, "after the boot", reboots=True,
        lasts_ms=3000,
    ),
)  # fmt: skip
