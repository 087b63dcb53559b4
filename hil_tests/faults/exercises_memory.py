"""Faults of the memory, exercised."""

from __future__ import annotations

import math
from statistics import mean

from hil_tests.faults.exercise import Exercise, Seen
from hil_tests.unit.conftest import MS, PARAMETER, Bench, Packet
from hil_tests.vectors import reference_decoder as wire

CATALOGUE_DAMAGED, PROGRAM_DAMAGED = 4, 6
PARAMETER_STORE, BAD_CHECKSUM = 4, 3
RAM, PROGRAM = 1, 4
FOUND_MS = 2500  # by then a check has come round, and the OBC has answered
STAR = 24 * 2679  # HIP 26311, 1.6 mag, in view; its x is 0.10
ADDRESS, BIT = 1000, 3
ARCSEC = math.pi / 180 / 3600


def wait_for_fault(bench: Bench, seen: Seen) -> None:
    """The OBC takes FAULT for what it is, and starts the unit anew."""
    bench.run_until(lambda: bool(bench.events("FAULT_ENTERED")))
    seen.figures["fault_ms"] = bench.now_ms - seen.start_ms
    bench.run(30)
    bench.function("RESET", {"kind": 0}, ack=0)


def in_fault(cause: int, name: str) -> object:
    def look(seen: Seen) -> str:
        bench = seen.bench
        assert [event["cause"] for event in bench.events("FAULT_ENTERED")] == [cause], "and not again"
        (at_ms,) = [
            one.t_ns / MS - seen.start_ms for one in seen.during() if one.fields.get("event_id") == 13
        ]
        assert at_ms <= 2010
        entered = seen.start_ms + at_ms
        booted = [one.t_ns / MS for one in bench.packets if one.fields.get("event_id") == 1][-1]
        assert seen.between(entered, booted, "attitude_report") == []
        return f"FAULT_ENTERED with {name} after {at_ms:.0f} ms, no more attitudes until the OBC's RESET"

    return look


def self_test(bench: Bench) -> int:
    """The parts that fail; the unit is in STANDBY or FAULT then."""
    bench.function("GO_STANDBY", ack=0)
    bench.run(20)
    bench.function("START_SELF_TEST", ack=0)
    number = len(bench.events("SELF_TEST_COMPLETED"))
    bench.run_until(lambda: len(bench.events("SELF_TEST_COMPLETED")) > number)
    result: int = bench.events("SELF_TEST_COMPLETED")[-1]["result"]
    return result


def checked(bench: Bench, memory: int, start: int, length: int) -> int:
    """Check sum of a memory, by service 6."""
    number = len(bench.of("memory_check_report"))
    fields = {"memory_id": memory, "start_address": start, "length": length}
    bench.send("memory_check", fields, ack=0)
    bench.run_until(lambda: len(bench.of("memory_check_report")) > number)
    result: int = bench.of("memory_check_report")[number]["checksum"]
    return result


def dumped(bench: Bench, memory: int, start: int, length: int) -> bytes:
    number = len(bench.of("memory_dump_report"))
    fields = {"memory_id": memory, "start_address": start, "length": length}
    bench.send("memory_dump", fields, ack=0)
    bench.run_until(lambda: len(bench.of("memory_dump_report")) > number)
    result: bytes = bench.of("memory_dump_report")[number]["data"]
    return result


def loaded(bench: Bench, memory: int, start: int, data: bytes) -> list[str]:
    count = bench.send(
        "memory_load",
        {"memory_id": memory, "start_address": start, "data": data, "checksum": wire.crc16(data)},
    )
    bench.run(40)
    return bench.stages(count)


def reset(bench: Bench) -> None:
    number = len(bench.events("BOOT_COMPLETED"))
    bench.function("RESET", {"kind": 0}, ack=0)
    bench.run_until(lambda: len(bench.events("BOOT_COMPLETED")) > number)
    bench.run(30)


def look_into_the_program(bench: Bench, seen: Seen) -> None:
    bench.run(2300)
    seen.figures["octet"] = dumped(bench, PROGRAM, ADDRESS, 1)[0]
    seen.figures["check"] = checked(bench, PROGRAM, ADDRESS - 8, 64)
    seen.figures["self-test"] = self_test(bench)
    reset(bench)
    seen.figures["octet as stored"] = dumped(bench, PROGRAM, ADDRESS, 1)[0]
    seen.figures["check as stored"] = checked(bench, PROGRAM, ADDRESS - 8, 64)


def unseen_in_program(seen: Seen) -> str:
    figures = seen.figures
    assert figures["octet"] ^ figures["octet as stored"] == 1 << BIT
    assert figures["check"] != figures["check as stored"]
    assert figures["self-test"] == 0
    assert seen.bench.events("FAULT_ENTERED") == []
    assert all(
        one.fields["valid"] for one in seen.between(seen.start_ms, seen.start_ms + 2300, "attitude_report")
    )
    return (
        "no event, self-test passes, attitudes valid; another check sum by service 6; as stored after RESET"
    )


def quaternion(report: Packet) -> tuple[float, ...]:
    return tuple(report.fields[name] for name in ("q_x", "q_y", "q_z", "q_w"))


def turned_arcsec(one: Packet, other: Packet) -> tuple[float, float, float]:
    """The small turn between two attitudes, about each axis."""
    ax, ay, az, aw = quaternion(one)
    bx, by, bz, bw = quaternion(other)
    sign = 1.0 if ax * bx + ay * by + az * bz + aw * bw > 0 else -1.0
    x = aw * bx - ax * bw - ay * bz + az * by
    y = aw * by + ax * bz - ay * bw - az * bx
    z = aw * bz - ax * by + ay * bx - az * bw
    return 2 * sign * x / ARCSEC, 2 * sign * y / ARCSEC, 2 * sign * z / ARCSEC


def star_missing(seen: Seen) -> str:
    before = [one.fields["stars_identified"] for one in seen.before("attitude_report")[-6:]]
    after = [one.fields["stars_identified"] for one in seen.after("attitude_report")[2:]]
    assert seen.bench.events("FAULT_ENTERED") == []
    assert all(one.fields["valid"] for one in seen.after("attitude_report"))
    assert max(after) < min(before)
    return (
        f"stars_identified at most {max(after)} instead of at least {min(before)}, attitudes valid, no event"
    )


def star_not_missed(seen: Seen) -> str:
    before, after = seen.before("attitude_report")[-8:], seen.after("attitude_report")[2:]
    assert seen.bench.events("FAULT_ENTERED") == []
    assert all(one.fields["valid"] for one in after)
    reference = before[0]
    shift = math.dist(
        *(
            [mean(turned_arcsec(reference, one)[axis] for one in part) for axis in (0, 1)]
            for part in (before, after)
        )
    )
    assert shift < 1.0
    assert seen.figures["self-test"] == 0
    counts = {one.fields["stars_identified"] for one in before + after[:8]}
    assert len(counts) == 1, "it is taken for a good one"
    return "nothing: as many stars, attitudes valid and less than 1 arcsec away; no event, self-test passes"


def test_and_go_on(bench: Bench, seen: Seen) -> None:
    bench.run(2500)
    seen.figures["self-test"] = self_test(bench)
    bench.function("START_ACQUISITION", ack=0)


def start_anew(bench: Bench, seen: Seen) -> None:
    """The parameters are read at a start. Factory parameters do not start by themselves."""
    bench.run(100)
    seen.figures["before"] = {name: bench.parameter(name) for name in PARAMETER}
    reset(bench)
    seen.figures["after"] = {name: bench.parameter(name) for name in PARAMETER}
    bench.function("START_ACQUISITION", ack=0)


def factory_parameters(seen: Seen) -> str:
    before, after = seen.figures["before"], seen.figures["after"]
    (event,) = seen.bench.events("PARAMETER_STORE_INVALID")
    assert event["cause"] == BAD_CHECKSUM
    assert before["exposure_us"] == 90_000
    assert after["exposure_us"] == 100_000
    assert after["boot_count"] == 1
    return "at the OBC's RESET PARAMETER_STORE_INVALID with BAD_CHECKSUM, factory parameters, boot_count 1"


def another_parameter(seen: Seen) -> str:
    before, after = seen.figures["before"], seen.figures["after"]
    assert seen.bench.events("PARAMETER_STORE_INVALID") == []
    changed = {
        name: (before[name], after[name])
        for name in PARAMETER
        if after[name] != before[name] + (name == "boot_count")
    }
    ((name, (old, new)),) = changed.items()
    assert name == "exposure_us"
    return f"after the OBC's RESET {name} is {new:.0f} instead of {old:.0f}, and no event"


def load_ram(bench: Bench, seen: Seen) -> None:
    bench.function("GO_STANDBY", ack=0)
    bench.run(30)
    data = bytes(range(64))
    seen.figures["stages"] = loaded(bench, RAM, 256, data)
    seen.figures["check"] = checked(bench, RAM, 256, 64), wire.crc16(data)
    seen.figures["other"] = sum(
        one != other for one, other in zip(dumped(bench, RAM, 256, 64), data, strict=True)
    )
    bench.function("START_ACQUISITION", ack=0)


def ram_struck(seen: Seen) -> str:
    found, sent = seen.figures["check"]
    assert seen.figures["stages"][-1] == "completion_success"
    assert found != sent
    assert seen.figures["other"] > 0
    return (
        f"the load completes; another check sum by service 6, {seen.figures['other']} of 64 octets are others"
    )


def load_program(bench: Bench, seen: Seen) -> None:
    bench.function("GO_STANDBY", ack=0)
    bench.run(30)
    data = dumped(bench, PROGRAM, 256, 64)
    assert loaded(bench, PROGRAM, 256, data)[-1] == "completion_success"
    wait_for_fault(bench, seen)


def write_parameters(bench: Bench, seen: Seen) -> None:
    bench.set_parameters(exposure_us=90_000)
    seen.figures["in force"] = bench.parameter("exposure_us")
    seen.figures["self-test"] = self_test(bench)
    bench.run(20)
    start_anew(bench, seen)


def written_spoilt(seen: Seen) -> str:
    assert seen.figures["in force"] == 90_000
    assert seen.figures["self-test"] == PARAMETER_STORE
    return "90000 is in force; the self-test fails with PARAMETER_STORE; " + factory_parameters(seen)


def written_other(seen: Seen) -> str:
    assert seen.figures["in force"] == 90_000
    assert seen.figures["self-test"] == 0
    return "90000 is in force and the self-test passes; " + another_parameter(seen)


def upset(**settings: object) -> dict[str, object]:
    return {"kind": "memory.bit_upset"} | settings


def struck(**settings: object) -> dict[str, object]:
    return {"kind": "memory.upset_while_written"} | settings


STORED = {"parameters": {"autonomous_start": 1, "exposure_us": 90_000}}
EXERCISES = (
    Exercise(
        upset(memory="program"), in_fault(PROGRAM_DAMAGED, "PROGRAM_DAMAGED"), "program, caught",
        lasts_ms=FOUND_MS, reboots=True, meanwhile=wait_for_fault,
    ),
    Exercise(
        upset(memory="program", address=ADDRESS, bit=BIT, caught=False), unseen_in_program,
        "program, not caught", lasts_ms=FOUND_MS, reboots=True, meanwhile=look_into_the_program,
    ),
    Exercise(
        upset(memory="catalogue"), in_fault(CATALOGUE_DAMAGED, "CATALOGUE_DAMAGED"), "catalogue, caught",
        lasts_ms=FOUND_MS, reboots=True, meanwhile=wait_for_fault,
    ),
    Exercise(
        upset(memory="catalogue", address=STAR + 5, bit=5, caught=False), star_missing,
        "catalogue, a star 101 arcsec off, not caught", lasts_ms=0,
    ),
    Exercise(
        upset(memory="catalogue", address=STAR + 5, bit=1, caught=False), star_not_missed,
        "catalogue, a star 6 arcsec off, not caught", lasts_ms=0, meanwhile=test_and_go_on,
    ),
    Exercise(
        upset(memory="parameters"), factory_parameters, "parameters, caught", scenario=STORED,
        lasts_ms=FOUND_MS, reboots=True, meanwhile=start_anew,
    ),
    Exercise(
        upset(memory="parameters", caught=False, seed=3), another_parameter, "parameters, not caught",
        scenario=STORED, lasts_ms=FOUND_MS, reboots=True, meanwhile=start_anew,
    ),
    Exercise(struck(memory="ram", probability=0.1), ram_struck, "RAM", meanwhile=load_ram),
    Exercise(
        struck(memory="program", probability=0.1), in_fault(PROGRAM_DAMAGED, "PROGRAM_DAMAGED"), "program",
        reboots=True, meanwhile=load_program,
    ),
    Exercise(
        struck(memory="parameters", probability=0.1), written_spoilt, "parameters, caught",
        reboots=True, meanwhile=write_parameters,
    ),
    Exercise(
        struck(memory="parameters", probability=0.1, caught=False, seed=5), written_other,
        "parameters, not caught", reboots=True, meanwhile=write_parameters,
    ),
)  # fmt: skip
