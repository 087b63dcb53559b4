"""Housekeeping at its intervals, events on and off, memory."""

from __future__ import annotations

from itertools import pairwise

import pytest

from hil_tests.vectors import reference_decoder as wire
from hil_tests.vectors.received import EVENT

from .conftest import LINK, STATUS, Wire


def stamps_s(line: Wire, structure: int) -> list[float]:
    """On-board times of the reports of a structure."""
    return [
        packet.decoded["time"][0] + packet.decoded["time"][1] / 2**24
        for packet in line.packets
        if packet.name == "hk_report" and packet.fields["structure_id"] == structure
    ]


def test_at_its_interval_by_the_units_own_clock(line: Wire) -> None:
    line.done("hk_set_interval", {"intervals": [{"structure_id": LINK, "interval_ms": 333}]})
    line.done("hk_enable", {"structure_ids": [LINK]})
    line.await_(lambda: len(stamps_s(line, LINK)) >= 4)
    times = stamps_s(line, LINK)
    steps = [later - earlier for earlier, later in pairwise(times)]
    assert steps == [pytest.approx(0.333, abs=1e-4)] * len(steps)
    line.done("hk_disable", {"structure_ids": [LINK]})
    line.forget()
    line.run(1.5)
    assert line.of("hk_report") == []


def test_one_shot_answers_in_the_order_asked(line: Wire) -> None:
    line.done("hk_one_shot", {"structure_ids": [3, 1, 3]})
    assert [fields["structure_id"] for fields in line.of("hk_report")] == [3, 1, 3]


def test_uptime_goes_on(line: Wire) -> None:
    first = line.housekeeping(STATUS)["uptime_ms"]
    line.run(2)
    assert 2000 <= line.housekeeping(STATUS)["uptime_ms"] - first < 2500


def test_counters_count_telecommands(line: Wire) -> None:
    before = line.housekeeping(LINK)
    line.done("ping")
    refused = line.send("hk_enable", {"structure_ids": [99]})
    line.await_end(refused)
    after = line.housekeeping(LINK)
    assert after["tc_received"] - before["tc_received"] == 3
    assert after["tc_accepted"] - before["tc_accepted"] == 2
    assert after["tc_rejected"] - before["tc_rejected"] == 1


def test_disabled_events_are_silent_and_listed(line: Wire) -> None:
    line.done("event_disable", {"event_ids": [EVENT["SELF_TEST_COMPLETED"]]})
    line.done("event_report_disabled")
    assert line.of("event_disabled_list") == [{"event_ids": [EVENT["SELF_TEST_COMPLETED"]]}]
    assert line.await_end(line.function("START_SELF_TEST"))[-1] == "completion_success"
    line.run(0.2)
    assert line.events("SELF_TEST_COMPLETED") == []
    line.done("event_enable", {"event_ids": [EVENT["SELF_TEST_COMPLETED"]]})
    assert line.await_end(line.function("START_SELF_TEST"))[-1] == "completion_success"
    line.await_(lambda: len(line.events("SELF_TEST_COMPLETED")) == 1)


@pytest.mark.parametrize("start", [0, 65536 - 256])
def test_memory_is_loaded_dumped_and_checked(line: Wire, start: int) -> None:
    data = bytes(range(256))
    area = {"memory_id": 1, "start_address": start}
    line.done("memory_load", area | {"data": data, "checksum": wire.crc16(data)})
    dumped = line.answer("memory_dump", area | {"length": 256}, "memory_dump_report")
    assert dumped == area | {"data": data, "checksum": wire.crc16(data)}
    checked = line.answer("memory_check", area | {"length": 256}, "memory_check_report")
    assert checked == area | {"length": 256, "checksum": wire.crc16(data)}
