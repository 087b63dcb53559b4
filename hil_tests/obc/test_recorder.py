"""A recording holds everything that came, and can be read back."""

import csv
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from st_emulator.links import MemoryLink
from st_emulator.obc import Obc, Recorder, RecordingError, SteppedReader, VerificationError, read_recording


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "recording"


@pytest.fixture
def recorded(unit: Any, link_pair: tuple[MemoryLink, MemoryLink], folder: Path, wire: Any) -> Iterator[Obc]:
    reader = SteppedReader(unit.step)
    with Obc(link_pair[1], apid=wire.APID, recorder=Recorder(folder), reader=reader) as opened:
        yield opened


def lines_of(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_every_packet_is_there_with_its_raw_bytes(recorded: Obc, unit: Any, folder: Path, wire: Any) -> None:
    unit.count = 40
    unit.event(12, struct.pack(">IBH", 10, 0, 0) + struct.pack(">IBH", 20, 0x40, 0), after_ms=250)
    recorded.wait(0.5)
    recorded.close()
    (line,) = lines_of(folder / "telemetry.jsonl")
    raw = bytes.fromhex(line.pop("raw"))
    assert raw[-2:] == struct.pack(">H", wire.crc16(raw[:-2]))
    assert line == {
        "received_s": 0.25,
        "name": "event_info",
        "service": 5,
        "subservice": 1,
        "apid": wire.APID,
        "sequence_count": 40,
        "message_count": 7,
        "time_tai_ns": 2_000_000_000_500_000_000,
        "time_status": 1,
        "fields": {"event_id": 12, "data": {"old_tai_ns": 10_000_000_000, "new_tai_ns": 20_250_000_000}},
    }


def test_reading_back_believes_only_the_raw_bytes(recorded: Obc, unit: Any, folder: Path) -> None:
    unit.attitude(frame=1)
    unit.attitude(frame=2, after_ms=250)
    recorded.wait(0.5)
    recorded.close()
    path = folder / "telemetry.jsonl"
    path.write_text(path.read_text().replace('"frame_index":2', '"frame_index":99'))
    entries = list(read_recording(folder))
    assert [entry.telemetry.fields["frame_index"] for entry in entries] == [1, 2]
    assert [entry.received_s for entry in entries] == [0.001, 0.25]


def test_a_line_cut_short_by_a_kill_is_left_out(recorded: Obc, unit: Any, folder: Path) -> None:
    unit.attitude(frame=1)
    unit.attitude(frame=2)
    recorded.wait(0.01)
    path = folder / "telemetry.jsonl"
    path.write_bytes(path.read_bytes()[:-20])
    assert [entry.telemetry.fields["frame_index"] for entry in read_recording(folder)] == [1]


def test_a_damaged_recording_is_named_with_its_line(recorded: Obc, unit: Any, folder: Path) -> None:
    unit.attitude()
    recorded.wait(0.01)
    path = folder / "telemetry.jsonl"
    line = json.loads(path.read_text())
    line["raw"] = "00" + line["raw"][2:]
    path.write_text(json.dumps(line) + "\n")
    with pytest.raises(RecordingError, match=r"telemetry\.jsonl, line 1: BAD_CRC"):
        list(read_recording(folder))
    path.write_text("{}\n")
    with pytest.raises(RecordingError, match="line 1: no recorded packet"):
        list(read_recording(folder))
    with pytest.raises(RecordingError, match="No such file"):
        list(read_recording(folder / "elsewhere"))


def test_lines_are_whole_while_the_session_runs(recorded: Obc, unit: Any, folder: Path) -> None:
    unit.attitude()
    recorded.wait(0.01)
    assert (folder / "telemetry.jsonl").read_text().endswith("\n")
    assert len(table(folder / "attitude.csv")) == 1


def test_tables_hold_what_was_sent(recorded: Obc, unit: Any, folder: Path) -> None:
    covariance = (0.5, 0.25, -0.125, 1.0, 0.0, 2.0)
    unit.attitude(frame=6, q=(0.5, 0.5, -0.5, 0.5), rate=(0.25, 0, 0), rate_covariance=covariance)
    unit.status()
    unit.event(2, struct.pack(">BBB", 2, 3, 4))
    unit.answer((17, 1), lambda request: unit.send(17, 2))
    recorded.ping()
    (attitude,) = table(folder / "attitude.csv")
    assert [float(attitude[f"q_{axis}"]) for axis in "xyzw"] == [0.5, 0.5, -0.5, 0.5]
    assert (attitude["frame_index"], attitude["rate_x"], attitude["mode"]) == ("6", "0.25", "4")
    triangle = ("xx", "xy", "xz", "yy", "yz", "zz")
    assert tuple(float(attitude[f"rate_covariance_{axes}"]) for axes in triangle) == covariance
    assert attitude["rate_covariance_valid"] == "1"
    assert attitude["mid_exposure_time_tai_ns"] == "2000000000500000000"
    assert list(attitude)[:4] == ["received_s", "time_tai_ns", "time_status", "sequence_count"]
    assert attitude["packet_time_status"] == "1"  # the report's own, beside that of the packet's header
    (status,) = table(folder / "housekeeping_status.csv")
    assert (status["boot_count"], status["temperature_cdeg"]) == ("3", "-250")
    (event,) = table(folder / "events.csv")
    assert (event["severity"], event["event"]) == ("info", "MODE_CHANGED")
    assert json.loads(event["data"]) == {"from_mode": 2, "to_mode": 3, "cause": 4}
    reports = table(folder / "verification.csv")
    assert [(row["report"], row["tc_sequence_count"]) for row in reports] == [
        ("acceptance_success", "0"),
        ("completion_success", "0"),
    ]
    assert len(table(folder / "pong.csv")) == 1


def test_telecommands_are_there_when_sent_and_when_finished(
    recorded: Obc, unit: Any, folder: Path, wire: Any
) -> None:
    unit.handlers[(8, 1)] = lambda request: unit.fail(request, 2, 7, 5)
    with pytest.raises(VerificationError):
        recorded.function("START_ACQUISITION")
    recorded.begin("ping", timeout_s=0.1)
    recorded.wait(0.2)
    sent, failed, ping, timed_out = lines_of(folder / "telecommands.jsonl")
    assert (sent["name"], sent["sent_s"], sent["sequence_count"]) == ("function", 0.0, 0)
    assert wire.unslip(bytes.fromhex(sent["wire"])) == [unit.requests[0].packet]
    assert (failed["state"], failed["failure_name"], failed["finished_s"]) == (
        "failed",
        "NOT_ALLOWED_IN_MODE",
        0.001,
    )
    assert ping["name"] == "ping"
    assert (timed_out["state"], timed_out["missing"][0]) == ("timed out", "acceptance report")


def test_anomalies_are_kept_apart(recorded: Obc, unit: Any, folder: Path, wire: Any) -> None:
    unit.send(17, 2)
    unit.spoil = lambda packet: packet[:-1] + bytes([packet[-1] ^ 1])
    unit.send(17, 2)
    unit.spoil = lambda packet: packet
    unit.count = 5
    unit.send(17, 2)
    unit.send_line(b"\xc0\xdb\x00\xc0")
    recorded.wait(0.01)
    crc, gap, frame = lines_of(folder / "anomalies.jsonl")
    assert (crc["kind"], crc["reason"], len(bytes.fromhex(crc["raw"]))) == ("malformed", "BAD_CRC", 22)
    assert (gap["kind"], gap["expected"], gap["received"], gap["missing"]) == ("sequence_gap", 1, 5, 4)
    assert (frame["kind"], frame["reason"]) == ("frame_lost", "BAD_ESCAPE")
    assert len(list(read_recording(folder))) == 2


def test_the_session_says_what_it_was(recorded: Obc, folder: Path, wire: Any) -> None:
    session = json.loads((folder / "session.json").read_text())
    assert session["apid"] == wire.APID
    assert session["link"] == "memory (obc)"
    assert session["started_utc"] == "2026-01-01T00:00:00+00:00"


def test_a_recording_is_never_overwritten(recorded: Obc, folder: Path) -> None:
    with pytest.raises(RecordingError, match="holds a recording already"):
        Recorder(folder)


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(RecordingError, match=r"file/below: cannot record there: Not a directory"):
        Recorder(tmp_path / "file" / "below")
