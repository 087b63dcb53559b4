"""examples/overrun.toml over the wire: a late attitude, the dropped frame, the events and the counters.

Everything is read from the raw bytes by the decoder that shares no code with ours.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from hil_tests.vectors import reference_decoder
from st_emulator.bench.journal import read_journal

SCENARIO = Path(__file__).parents[2] / "examples" / "overrun.toml"
PERIOD_US, EXPOSURE_US, READOUT_US = 250_000, 100_000, 16_700  # roja1
SLOW_FROM, SLOW_UNTIL = 20, 36  # frame numbers at 5 and 9 s
SLOW_HZ, FAST_HZ = 24_000_000, 400_000_000
FRAME_OVERRAN, FRAME_DROPPED = 4, 5
OVERRUN, DROPPED = 16, 64  # reasons
STATUS, TIMING = 1, 3


@pytest.fixture(scope="module")
def packets(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    folder = tmp_path_factory.mktemp("overrun")
    journal = folder / "journal.jsonl"
    command = [sys.executable, "-m", "st_emulator", "run", "roja1", "--scenario", str(SCENARIO)]
    command += ["--speed", "max", "--journal", str(journal)]
    subprocess.run(command, check=True, env=os.environ | {"XDG_STATE_HOME": str(folder)})
    line = reference_decoder.slip_frames(read_journal(journal).bytes_of("tx"))
    return [reference_decoder.decode_telemetry(frame)["fields"] for frame in line]


def reports(packets: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [fields for fields in packets if "frames_dropped_before" in fields]


def events(packets: list[dict[str, Any]], event_id: int) -> list[dict[str, Any]]:
    return [fields["data"] for fields in packets if fields.get("event_id") == event_id]


def housekeeping(packets: list[dict[str, Any]], structure_id: int) -> dict[str, Any]:
    """The last report of a structure."""
    return [fields["values"] for fields in packets if fields.get("structure_id") == structure_id][-1]


def test_late_attitudes_say_so_and_come_late(packets: list[dict[str, Any]]) -> None:
    late = [report for report in reports(packets) if report["late"]]
    assert len(late) >= 3
    overran = events(packets, FRAME_OVERRAN)
    assert [event["frame_index"] for event in overran] == [report["frame_index"] for report in late]
    for report, event in zip(late, overran, strict=True):
        assert SLOW_FROM <= report["frame_index"] < SLOW_UNTIL
        assert report["valid"]
        assert report["cycles"] == event["cycles"] > event["budget"] == SLOW_HZ // 4
        processing_us = report["cycles"] * 1e6 / SLOW_HZ
        assert event["late_us"] == pytest.approx(processing_us - PERIOD_US, abs=2)
        assert report["latency_us"] == pytest.approx(EXPOSURE_US / 2 + READOUT_US + processing_us, abs=2)


def test_frames_that_find_the_processor_busy_are_dropped_and_told(packets: list[dict[str, Any]]) -> None:
    dropped = [report for report in reports(packets) if report["reasons"] & DROPPED]
    assert len(dropped) >= 3
    assert all(report["reasons"] == DROPPED | OVERRUN and not report["valid"] for report in dropped)
    told = [event["frame_index"] for event in events(packets, FRAME_DROPPED)]
    assert told == [report["frame_index"] for report in dropped]
    # Each frame has exactly one report, whatever became of it; a late one only comes after those it cost.
    indices = sorted(report["frame_index"] for report in reports(packets))
    assert indices == list(range(indices[0], indices[-1] + 1))
    by_frame = {report["frame_index"]: report for report in reports(packets)}
    for index, report in by_frame.items():
        before = 0
        while by_frame.get(index - 1 - before, {"reasons": 0})["reasons"] & DROPPED:
            before += 1
        assert report["frames_dropped_before"] == before


def test_the_counters_agree_and_all_is_well_again(packets: list[dict[str, Any]]) -> None:
    seen = reports(packets)
    status, timing = housekeeping(packets, STATUS), housekeeping(packets, TIMING)
    assert status["frames_late"] == sum(report["late"] for report in seen)
    assert status["frames_dropped"] == sum(bool(report["reasons"] & DROPPED) for report in seen)
    after = [report for report in seen if report["frame_index"] > SLOW_UNTIL + 4]
    assert len(after) >= 10
    assert all(report["valid"] and not report["late"] for report in after)
    assert timing["clock_hz"] == FAST_HZ
    assert timing["margin_us"] > 200_000
    stages = ("threshold", "clustering", "centroid", "identification", "tracking", "attitude", "telemetry")
    assert sum(timing[f"cycles_{stage}"] for stage in stages) == timing["cycles_total"]
    assert 0 < timing["cycles_memory"] < timing["cycles_total"]
