"""Reports of each telecommand: stages as its flags ask; failures with code and data, which change nothing."""

from itertools import product
from pathlib import Path
from typing import Any

import pytest

from hil_tests.vectors import reference_decoder as wire

from .conftest import FUNCTION, MODE, SOURCE, Bench
from .tumbling import tumble

ACCEPTANCE, START, PROGRESS, COMPLETION = 8, 4, 2, 1
NOT_ALLOWED, OUT_OF_RANGE, UNKNOWN_ID, READ_ONLY, BUSY, NO_IMAGE = 7, 8, 9, 10, 11, 12
BAD_CHECKSUM, ADDRESS, SUPERSEDED, SELF_TEST_FAILED, ABORTED = 13, 14, 15, 16, 17

DATA = b"patch"
LOAD = {"memory_id": 1, "start_address": 16, "data": DATA, "checksum": wire.crc16(DATA)}
Q = {"q_x": 0.0, "q_y": 0.0, "q_z": 0.0, "q_w": 1.0}

#: Telecommands that are done at once, with the telemetry that answers them.
AT_ONCE: dict[str, tuple[str, dict[str, Any], list[str]]] = {
    "ping": ("ping", {}, ["pong"]),
    "hk_enable": ("hk_enable", {"structure_ids": [2]}, []),
    "hk_disable": ("hk_disable", {"structure_ids": [1, 2]}, []),
    "hk_one_shot": ("hk_one_shot", {"structure_ids": [3, 1, 2]}, ["hk_report"] * 3),
    "hk_set_interval": ("hk_set_interval", {"intervals": [{"structure_id": 1, "interval_ms": 250}]}, []),
    "event_enable": ("event_enable", {"event_ids": [2]}, []),
    "event_disable": ("event_disable", {"event_ids": [2, 19]}, []),
    "event_report_disabled": ("event_report_disabled", {}, ["event_disabled_list"]),
    "memory_load": ("memory_load", LOAD, []),
    "memory_dump": (
        "memory_dump",
        {"memory_id": 1, "start_address": 0, "length": 1024},
        ["memory_dump_report"],
    ),
    "memory_check": (
        "memory_check",
        {"memory_id": 1, "start_address": 1, "length": 65535},
        ["memory_check_report"],
    ),
    "time_report_rate": ("time_report_rate", {"rate_exponent": 8}, []),
    "parameter_report": ("parameter_report", {"parameter_ids": [21, 1]}, ["parameter_values"]),
    "parameter_set": (
        "parameter_set",
        {"settings": [{"parameter_id": 13, "value": 0}]},
        ["event_info"],
    ),
    "GO_STANDBY": ("function", {"function_id": 1, "arguments": {}}, []),
    "ABORT_DOWNLOAD": ("function", {"function_id": 7, "arguments": {}}, []),
    "CLEAR_COUNTERS": ("function", {"function_id": 9, "arguments": {}}, []),
    "RESTORE_DEFAULT_PARAMETERS": ("function", {"function_id": 10, "arguments": {}}, ["event_info"]),
}


@pytest.mark.parametrize("name", AT_ONCE)
def test_done_at_once(bench: Bench, name: str) -> None:
    telecommand, fields, answers = AT_ONCE[name]
    count = bench.send(telecommand, fields, ack=15)
    bench.run(200)
    names = [packet.name for packet in bench.packets]
    assert names == ["acceptance_success", *answers, "completion_success"]
    assert bench.stages(count) == ["acceptance_success", "completion_success"]


def test_flags_choose_the_reports(bench: Bench) -> None:
    for ack in range(16):
        count = bench.send("ping", ack=ack)
        bench.run(30)
        wanted = [
            report
            for flag, report in ((ACCEPTANCE, "acceptance_success"), (COMPLETION, "completion_success"))
            if ack & flag
        ]
        assert bench.stages(count) == wanted
    assert len(bench.of("pong")) == 16


@pytest.mark.parametrize("ack", range(16))
def test_flags_choose_the_reports_of_what_takes_time(bench: Bench, ack: int) -> None:
    count = bench.function("START_SELF_TEST", ack=ack)
    bench.run(700)
    assert bench.stages(count) == (
        ["acceptance_success"] * bool(ack & ACCEPTANCE)
        + ["start_success"] * bool(ack & START)
        + ["progress"] * 4 * bool(ack & PROGRESS)
        + ["completion_success"] * bool(ack & COMPLETION)
    )
    assert [r.fields["step"] for r in bench.reports(count) if r.name == "progress"] in ([], [1, 2, 3, 4])


@pytest.mark.parametrize(
    ("name", "fields", "wait_ms"),
    [
        ("function", {"function_id": 2, "arguments": {}}, 1500),
        ("function", {"function_id": 5, "arguments": {}}, 500),
        ("function", {"function_id": 8, "arguments": {}}, 100),
        ("set_time", {"time": (2_000_000_000, 0)}, 300),
    ],
)
def test_what_takes_time_reports_its_start(
    bench: Bench, name: str, fields: dict[str, Any], wait_ms: int
) -> None:
    count = bench.send(name, fields)
    bench.run(wait_ms)
    assert bench.stages(count) == ["acceptance_success", "start_success", "completion_success"]


def test_track_from_completes_with_an_attitude(bench: Bench) -> None:
    bench.to_mode("TRACKING")
    bench.run(300)
    last = bench.of("attitude_report")[-1]
    count = bench.function("TRACK_FROM", {name: last[name] for name in Q})
    bench.run(600)
    assert bench.stages(count) == ["acceptance_success", "start_success", "completion_success"]
    assert bench.of("attitude_report")[-1]["valid"] == 1


def test_reset_reports_its_start_and_no_completion(bench: Bench) -> None:
    count = bench.function("RESET", {"kind": 0})
    bench.run(600)
    assert bench.stages(count) == ["acceptance_success", "start_success"]
    assert len(bench.events("BOOT_COMPLETED")) == 1


def test_reports_go_to_the_source(bench: Bench) -> None:
    count = bench.send("hk_one_shot", {"structure_ids": [1]}, source_id=0xBEEF)
    bench.run(30)
    assert {p.decoded["destination_id"] for p in bench.packets} == {0xBEEF}
    assert all(p.decoded["apid"] == bench.apid for p in bench.packets)
    bench.forget()
    bench.function("CAPTURE_IMAGE", source_id=0xBEEF)
    bench.run(500)
    (event,) = [p for p in bench.packets if p.decoded["service"] == 5]
    assert event.decoded["destination_id"] == bench.emulator.profile.wire.source_id != SOURCE
    assert count >= 0


FAILURES: dict[str, tuple[str, dict[str, Any], tuple[int, int]]] = {
    "structure": ("hk_enable", {"structure_ids": [1, 9]}, (UNKNOWN_ID, 9)),
    "structure off": ("hk_disable", {"structure_ids": [0]}, (UNKNOWN_ID, 0)),
    "structure once": ("hk_one_shot", {"structure_ids": [1, 200]}, (UNKNOWN_ID, 200)),
    "no structure": ("hk_one_shot", {"structure_ids": []}, (OUT_OF_RANGE, 0)),
    "17 structures": ("hk_one_shot", {"structure_ids": [1] * 17}, (OUT_OF_RANGE, 0)),
    "interval structure": (
        "hk_set_interval",
        {"intervals": [{"structure_id": 9, "interval_ms": 1000}]},
        (UNKNOWN_ID, 9),
    ),
    "interval short": (
        "hk_set_interval",
        {"intervals": [{"structure_id": 1, "interval_ms": 500}, {"structure_id": 2, "interval_ms": 249}]},
        (OUT_OF_RANGE, 2),
    ),
    "interval long": (
        "hk_set_interval",
        {"intervals": [{"structure_id": 3, "interval_ms": 3_600_001}]},
        (OUT_OF_RANGE, 3),
    ),
    "event on": ("event_enable", {"event_ids": [0]}, (UNKNOWN_ID, 0)),
    "event off": ("event_disable", {"event_ids": [1, 99]}, (UNKNOWN_ID, 99)),
    "load memory": ("memory_load", LOAD | {"memory_id": 9}, (UNKNOWN_ID, 9)),
    "load read-only": ("memory_load", LOAD | {"memory_id": 2}, (READ_ONLY, 2)),
    "load past the end": ("memory_load", LOAD | {"start_address": 65532}, (ADDRESS, 65532)),
    "load far away": ("memory_load", LOAD | {"start_address": 0xFFFFFFFF}, (ADDRESS, 0xFFFFFFFF)),
    "load checksum": ("memory_load", LOAD | {"checksum": 1}, (BAD_CHECKSUM, wire.crc16(DATA))),
    "load nothing": ("memory_load", LOAD | {"data": b"", "checksum": 0xFFFF}, (OUT_OF_RANGE, 1)),
    "load too much": (
        "memory_load",
        LOAD | {"data": bytes(257), "checksum": wire.crc16(bytes(257))},
        (OUT_OF_RANGE, 1),
    ),
    "dump memory": ("memory_dump", {"memory_id": 0, "start_address": 0, "length": 1}, (UNKNOWN_ID, 0)),
    "dump nothing": ("memory_dump", {"memory_id": 2, "start_address": 0, "length": 0}, (OUT_OF_RANGE, 2)),
    "dump too much": ("memory_dump", {"memory_id": 1, "start_address": 0, "length": 1025}, (OUT_OF_RANGE, 1)),
    "dump past the end": (
        "memory_dump",
        {"memory_id": 1, "start_address": 65535, "length": 2},
        (ADDRESS, 65535),
    ),
    "dump no image": ("memory_dump", {"memory_id": 3, "start_address": 0, "length": 1}, (NO_IMAGE, 0)),
    "check past the end": (
        "memory_check",
        {"memory_id": 1, "start_address": 2, "length": 65535},
        (ADDRESS, 2),
    ),
    "check nothing": ("memory_check", {"memory_id": 1, "start_address": 2, "length": 0}, (OUT_OF_RANGE, 1)),
    "rate": ("time_report_rate", {"rate_exponent": 9}, (OUT_OF_RANGE, 0)),
    "report parameter": ("parameter_report", {"parameter_ids": [1, 24]}, (UNKNOWN_ID, 24)),
    "set out of range": (
        "parameter_set",
        {"settings": [{"parameter_id": 1, "value": 50_000}, {"parameter_id": 10, "value": 21}]},
        (OUT_OF_RANGE, 10),
    ),
    "set not a number": (
        "parameter_set",
        {"settings": [{"parameter_id": 1, "value": 50_000}, {"parameter_id": 2, "value": float("nan")}]},
        (OUT_OF_RANGE, 2),
    ),
    "set read-only": (
        "parameter_set",
        {"settings": [{"parameter_id": 1, "value": 50_000}, {"parameter_id": 21, "value": 0}]},
        (READ_ONLY, 21),
    ),
    "reset kind": ("function", {"function_id": 4, "arguments": {"kind": 2}}, (OUT_OF_RANGE, 4)),
    "no image": (
        "function",
        {"function_id": 6, "arguments": {"transaction_id": 1, "first_part": 0, "parts": 0}},
        (NO_IMAGE, 0),
    ),
    "norm": ("function", {"function_id": 11, "arguments": Q | {"q_x": 0.05}}, (OUT_OF_RANGE, 11)),
    "zero": ("function", {"function_id": 11, "arguments": Q | {"q_w": 0.0}}, (OUT_OF_RANGE, 11)),
    "nan": ("function", {"function_id": 11, "arguments": Q | {"q_w": float("nan")}}, (OUT_OF_RANGE, 11)),
    "huge": ("function", {"function_id": 11, "arguments": Q | {"q_w": 1e300}}, (OUT_OF_RANGE, 11)),
}


def state_of(bench: Bench) -> Any:
    """Everything a telecommand can change but the link's counters."""
    unit, dialect = bench.emulator.device, bench.emulator.dialect
    return (
        unit.mode,
        dict(unit.parameters._values),
        unit.parameters._store.load(),
        set(dialect.events._disabled),
        dict(dialect.housekeeping._intervals_ms),
        set(dialect.housekeeping._periodic),
        dialect.time._rate_exponent,
        bytes(unit.memories.ram),
        bytes(unit.memories.program),
        dialect.image.data,
        unit.image_memory.busy,
        unit.time._pending_offset_ns,
    )


@pytest.mark.parametrize("kind", FAILURES)
def test_refused_with_code_and_data_and_nothing_changed(bench: Bench, kind: str) -> None:
    name, fields, (code, data) = FAILURES[kind]
    before = state_of(bench)
    count = bench.send(name, fields, ack=0)
    bench.run(300)
    assert bench.failure(count) == ("acceptance_failure", code, data)
    assert [packet.name for packet in bench.packets] == ["acceptance_failure"]
    assert state_of(bench) == before
    assert bench.housekeeping(2)["bad_parameters"] == 1


def test_exposure_longer_than_the_frame_is_refused(bench: Bench) -> None:
    period_us = bench.emulator.profile.timing.frame_period_ms * 1000
    assert period_us == 250_000
    for value, stages in (
        (250_000, ["acceptance_success", "completion_success"]),
        (250_001, ["acceptance_failure"]),
    ):
        count = bench.send("parameter_set", {"settings": [{"parameter_id": 1, "value": value}]})
        bench.run(20)
        assert bench.stages(count) == stages


# -- modes ------------------------------------------------------------------------------------------------


def icd_modes() -> dict[str, set[str]]:
    """The table of the interface document: telecommand or 'function NAME' to modes."""
    text = (Path(__file__).parents[2] / "docs" / "interface_control_document.md").read_text()
    table = text.split("| telecommand | allowed in |")[1].split("\n\n")[0]
    rows = [line.strip("| ").split(" | ") for line in table.splitlines()[2:]]
    return {name: set(modes.split(", ")) for name, modes in rows}


EXAMPLES: dict[str, tuple[str, dict[str, Any]]] = {
    **{name: (tc, fields) for name, (tc, fields, _) in AT_ONCE.items() if tc != "function"},
    "set_time": ("set_time", {"time": (2_000_000_000, 0)}),
}
ARGUMENTS = {
    "RESET": {"kind": 0},
    "DOWNLOAD_IMAGE": {"transaction_id": 1, "first_part": 0, "parts": 0},
    "TRACK_FROM": Q,
}
for function, number in FUNCTION.items():
    EXAMPLES[f"function {function}"] = (
        "function",
        {"function_id": number, "arguments": ARGUMENTS.get(function, {})},
    )
LISTENING = ("STANDBY", "LOST_IN_SPACE", "TRACKING", "RATE_ONLY", "SELF_TEST", "FAULT")


def test_the_interface_document_names_every_telecommand() -> None:
    assert set(icd_modes()) == set(EXAMPLES)
    assert set(wire.TELECOMMANDS) - {"function"} == {name for name in EXAMPLES if "function" not in name}


@pytest.mark.parametrize("mode", LISTENING)
def test_every_telecommand_in_every_mode(new_bench: Any, mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if mode == "RATE_ONLY":
        tumble(monkeypatch)
    table = icd_modes()
    # A unit that sees nothing when it has to stay in LOST_IN_SPACE.
    blind = {"blinded_background_dn": 1} if mode == "LOST_IN_SPACE" else {}
    bench = new_bench(timing={"self_test_ms": 60000}, detection=blind).boot()
    bench.to_mode(mode)
    unit = bench.emulator.device
    quiet_last = sorted(EXAMPLES, key=lambda name: table_order(name))
    for name in quiet_last:
        telecommand, fields = EXAMPLES[name]
        if mode in table[name] and name.startswith("function") and name.split()[1] in CHANGES_MODE:
            continue  # see below: it would lead out of the mode
        bench.forget()
        assert unit.mode == MODE[mode]
        count = bench.send(telecommand, fields)
        bench.run(300 if name == "memory_dump" else 40)
        stages = bench.stages(count)
        if mode in table[name] and name != "function DOWNLOAD_IMAGE":
            assert stages[0] == "acceptance_success", name
        elif mode in table[name]:
            assert bench.failure(count)[1] == NO_IMAGE
        else:
            assert stages == ["acceptance_failure"], name
            assert bench.failure(count) == ("acceptance_failure", NOT_ALLOWED, MODE[mode]), name
    refused = sum(mode not in table[name] for name in EXAMPLES)
    assert bench.emulator.dialect.receiver.counters.not_allowed_in_mode == refused


CHANGES_MODE = ("GO_STANDBY", "START_ACQUISITION", "START_SELF_TEST", "RESET", "SHUTDOWN", "TRACK_FROM")


def table_order(name: str) -> tuple[bool, str]:
    # CLEAR_COUNTERS first (the refusals are counted behind it), a capture last (it makes an image).
    return (name != "function CLEAR_COUNTERS", "zz" if "CAPTURE" in name else name)


TARGETS = {
    "GO_STANDBY": "STANDBY", "START_ACQUISITION": "LOST_IN_SPACE", "START_SELF_TEST": "SELF_TEST",
    "RESET": "BOOT", "SHUTDOWN": "OFF", "TRACK_FROM": "TRACKING",
}  # fmt: skip


@pytest.mark.parametrize(
    ("mode", "function"),
    [
        (mode, function)
        for mode, function in product(LISTENING, TARGETS)
        if mode in icd_modes()[f"function {function}"]
    ],
)
def test_functions_lead_where_the_table_says(
    new_bench: Any, mode: str, function: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if mode == "RATE_ONLY":
        tumble(monkeypatch)
    bench = new_bench(timing={"self_test_ms": 60000}).boot()
    bench.to_mode(mode)
    bench.run(30)
    bench.forget()
    count = bench.function(function, ARGUMENTS.get(function, {}))
    bench.run(60)
    assert bench.emulator.device.mode == MODE[TARGETS[function]]
    assert bench.stages(count)[0] == "acceptance_success"
    told = [event for event in bench.events("MODE_CHANGED") if event["to_mode"] == MODE[TARGETS[function]]]
    silent = TARGETS[function] in ("BOOT", "OFF") or mode == TARGETS[function]
    assert len(told) == (0 if silent else 1)
    for event in told:
        assert event["from_mode"] == MODE[mode]


def test_nothing_is_heard_in_boot_and_off(new_bench: Any) -> None:
    bench = new_bench()
    bench.run(100)
    bench.send("ping")
    bench.run(50)
    assert bench.packets == []
    assert bench.emulator.dialect.receiver.counters.tc_received == 0
    bench.boot()
    bench.function("SHUTDOWN")
    bench.run(100)
    bench.forget()
    bench.send("ping")
    bench.run(5000)
    assert bench.packets == []
