"""Reports of each telecommand: the stages that its flags ask for; a failure with its code and data."""

from __future__ import annotations

from typing import Any

import pytest

from hil_tests.vectors import reference_decoder as wire

from .conftest import FUNCTION, STANDBY, STATUS, Wire

ACCEPTANCE, START, PROGRESS, COMPLETION = 8, 4, 2, 1
UNKNOWN_APID, UNKNOWN_SERVICE, UNKNOWN_SUBSERVICE, BAD_FIELDS = 1, 4, 5, 6
NOT_ALLOWED, OUT_OF_RANGE, UNKNOWN_ID, READ_ONLY, NO_IMAGE, BAD_CHECKSUM, ADDRESS = 7, 8, 9, 10, 12, 13, 14
DATA = b"patch"
LOAD = {"memory_id": 1, "start_address": 16, "data": DATA, "checksum": wire.crc16(DATA)}

AT_ONCE: dict[str, tuple[str, dict[str, Any], list[str]]] = {
    "ping": ("ping", {}, ["pong"]),
    "hk_one_shot": ("hk_one_shot", {"structure_ids": [3, 1, 2]}, ["hk_report"] * 3),
    "hk_set_interval": ("hk_set_interval", {"intervals": [{"structure_id": 1, "interval_ms": 250}]}, []),
    "event_report_disabled": ("event_report_disabled", {}, ["event_disabled_list"]),
    "memory_load": ("memory_load", LOAD, []),
    "memory_dump": (
        "memory_dump", {"memory_id": 1, "start_address": 0, "length": 1024}, ["memory_dump_report"],
    ),
    "parameter_report": ("parameter_report", {"parameter_ids": [21, 1]}, ["parameter_values"]),
    "GO_STANDBY": ("function", {"function_id": FUNCTION["GO_STANDBY"], "arguments": {}}, []),
    "ABORT_DOWNLOAD": ("function", {"function_id": FUNCTION["ABORT_DOWNLOAD"], "arguments": {}}, []),
}  # fmt: skip


@pytest.mark.parametrize("name", AT_ONCE)
def test_done_at_once(line: Wire, name: str) -> None:
    telecommand, fields, answers = AT_ONCE[name]
    count = line.send(telecommand, fields)
    assert line.await_end(count) == ["acceptance_success", "completion_success"]
    assert [packet.name for packet in line.packets] == ["acceptance_success", *answers, "completion_success"]


def test_flags_choose_the_reports(line: Wire) -> None:
    counts = []
    for ack in range(16):
        counts.append(line.send("ping", ack=ack))
        line.await_(lambda: len(line.of("pong")) == len(counts))
    line.run(0.1)
    for ack, count in enumerate(counts):
        wanted = ["acceptance_success"] * bool(ack & ACCEPTANCE)
        assert line.stages(count) == wanted + ["completion_success"] * bool(ack & COMPLETION)


@pytest.mark.parametrize("ack", [0, ACCEPTANCE, START, PROGRESS, COMPLETION, 15])
def test_flags_choose_the_reports_of_what_takes_time(line: Wire, ack: int) -> None:
    count = line.function("START_SELF_TEST", ack=ack)
    line.await_(lambda: line.events("SELF_TEST_COMPLETED"))
    line.run(0.1)
    assert line.stages(count) == (
        ["acceptance_success"] * bool(ack & ACCEPTANCE)
        + ["start_success"] * bool(ack & START)
        + ["progress"] * 4 * bool(ack & PROGRESS)
        + ["completion_success"] * bool(ack & COMPLETION)
    )


REFUSED: dict[str, tuple[str, dict[str, Any], tuple[int, int]]] = {
    "structure": ("hk_enable", {"structure_ids": [1, 9]}, (UNKNOWN_ID, 9)),
    "no structure": ("hk_one_shot", {"structure_ids": []}, (OUT_OF_RANGE, 0)),
    "interval": (
        "hk_set_interval", {"intervals": [{"structure_id": 2, "interval_ms": 249}]}, (OUT_OF_RANGE, 2),
    ),
    "event": ("event_disable", {"event_ids": [1, 99]}, (UNKNOWN_ID, 99)),
    "read-only memory": ("memory_load", LOAD | {"memory_id": 2}, (READ_ONLY, 2)),
    "past the end": ("memory_load", LOAD | {"start_address": 65532}, (ADDRESS, 65532)),
    "checksum": ("memory_load", LOAD | {"checksum": 1}, (BAD_CHECKSUM, wire.crc16(DATA))),
    "rate": ("time_report_rate", {"rate_exponent": 9}, (OUT_OF_RANGE, 0)),
    "parameter": ("parameter_report", {"parameter_ids": [1, 24]}, (UNKNOWN_ID, 24)),
    "read-only parameter": (
        "parameter_set", {"settings": [{"parameter_id": 21, "value": 0}]}, (READ_ONLY, 21),
    ),
    "reset": ("function", {"function_id": 4, "arguments": {"kind": 2}}, (OUT_OF_RANGE, 4)),
    "no image": (
        "function",
        {"function_id": 6, "arguments": {"transaction_id": 1, "first_part": 0, "parts": 0}},
        (NO_IMAGE, 0),
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_refused_with_code_and_data(line: Wire, kind: str) -> None:
    name, fields, (code, data) = REFUSED[kind]
    count = line.send(name, fields, ack=0)
    assert line.await_end(count) == ["acceptance_failure"], "asked for or not"
    assert line.failure(count) == ("acceptance_failure", code, data)
    assert line.housekeeping(STATUS)["mode"] == STANDBY


@pytest.mark.parametrize(
    ("service", "subservice", "code"), [(99, 1, UNKNOWN_SERVICE), (17, 99, UNKNOWN_SUBSERVICE)]
)
def test_what_is_not_served_is_refused(line: Wire, service: int, subservice: int, code: int) -> None:
    line.put(wire.telecommand_packet(service, subservice, b"", line.profile.apid, 77, 0x2A, 15))
    assert line.await_end(77) == ["acceptance_failure"]
    assert line.failure(77)[:2] == ("acceptance_failure", code)


def test_reports_go_to_the_source(line: Wire) -> None:
    count = line.done("ping", source_id=0xBEEF)
    assert {packet.decoded["destination_id"] for packet in line.packets} == {0xBEEF}
    assert line.reports(count)[0].decoded["apid"] == line.profile.apid


def test_a_wrong_crc_is_an_event_and_costs_nothing_that_follows(line: Wire) -> None:
    raw = bytearray(line.packet("ping"))
    raw[-1] ^= 1
    line.put(bytes(raw))
    line.await_(lambda: line.events("TC_CRC_FAILED"))
    assert line.events("TC_CRC_FAILED") == [{"count": 1, "length": len(raw)}]
    assert line.reports(line.count) == []
    line.done("ping")


def test_a_packet_longer_than_it_says_is_an_event(line: Wire) -> None:
    raw = line.packet("ping") + b"\0"
    line.put(raw)
    line.await_(lambda: line.events("TC_MALFORMED"))
    (event,) = line.events("TC_MALFORMED")
    assert (event["reason"], event["length"]) == (3, len(raw))
    line.done("ping")


def test_a_gap_in_the_sequence_is_told(line: Wire) -> None:
    line.done("ping")
    line.done("ping", count=line.count + 4)
    (gap,) = line.events("TC_SEQUENCE_GAP_DETECTED")
    assert gap["received"] - gap["expected"] == 3
