"""On a CAN bus: recordings that other tools read, the command line, live view."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest
from rich.console import Console
from typer.testing import CliRunner, Result

from hil_tests.obc.can_unit import (
    ATTITUDE_1,
    ATTITUDE_2,
    HEARTBEAT,
    STATUS,
    SYNC_TIME,
    TELEMETRY,
    CanUnit,
    clock,
    half,
    heartbeat,
    status,
)
from st_emulator.links import memory_link_pair
from st_emulator.obc import CanTransport, Obc, Recorder, SteppedReader, read_recording
from st_emulator.obc.cli import obc_app
from st_emulator.obc.watching import live_table
from st_emulator.protocol.can.cyclic import CanIdentifiers
from st_emulator.units.profile import load_unit

Run = Callable[..., Result]


@pytest.fixture
def unit(wire: Any) -> CanUnit:
    unit_link, obc_link = memory_link_pair(1 << 20, ("unit", "can:memory/vcan7@1000000,fd"))
    unit = CanUnit(wire, unit_link)
    unit.fake.answer((17, 1), lambda request: unit.fake.send(17, 2))
    unit.obc_link = obc_link  # type: ignore[attr-defined]
    return unit


def connected(unit: Any, folder: Path | None = None, node: int | None = 10, **options: Any) -> Obc:
    return Obc(
        unit.obc_link,
        apid=options.get("apid", 0x123),
        recorder=None if folder is None else Recorder(folder),
        reader=SteppedReader(unit.step),
        transport=CanTransport(None if node is None else CanIdentifiers(node)),
    )


# Recordings


def recorded(unit: CanUnit, folder: Path) -> None:
    with connected(unit, folder) as obc:
        obc.wait(0.5)
        unit.put(HEARTBEAT + 10, heartbeat(3, mode=4))
        unit.put(STATUS + 10, status(9, valid=0, reasons=4))
        unit.put(STATUS + 11, status(8))
        unit.put(STATUS + 10, b"\x01")
        unit.put(TELEMETRY + 10, b"\x21" + bytes(7))
        obc.ping()
        obc.sync(7)


def test_the_log_is_candumps(unit: CanUnit, tmp_path: Path) -> None:
    recorded(unit, tmp_path)
    messages = list(can.CanutilsLogReader(tmp_path / "can.log"))
    said = [f"{message.arbitration_id:X}#{message.data.hex()}" for message in messages]
    assert said[:3] == [
        "70A#0304c00100000007",
        "48A#09040000040c1400",
        "48B#08048000000c1400",
    ]
    assert said[-1] == "80#07"
    # 2026-01-01 00:00:00.5 UTC: the stepped reader's epoch and half a second.
    assert messages[0].timestamp == pytest.approx(1_767_225_600.5, abs=1e-6)
    assert {message.channel for message in messages} == {"vcan7"}
    sent = [message for message in messages if not message.is_rx]
    assert {message.arbitration_id for message in sent} == {0x60A, 0x080}
    # The unit heard all of them but SYNC, after which no time went on.
    assert [(m.arbitration_id, bytes(m.data)) for m in sent[:-1]] == [heard[1:] for heard in unit.heard]


def test_cyclic_frames_are_recorded(unit: CanUnit, tmp_path: Path) -> None:
    recorded(unit, tmp_path)
    lines = [json.loads(line) for line in (tmp_path / "cyclic.jsonl").read_text().splitlines()]
    assert [(line["received_s"], line["name"], line["raw"]) for line in lines] == [
        (0.5, "heartbeat", "0304c00100000007"),
        (0.5, "status", "09040000040c1400"),
    ]
    assert lines[1]["fields"]["reasons"] == 4
    (row,) = (tmp_path / "cyclic_status.csv").read_text().splitlines()[1:]
    assert row.split(",")[:3] == ["0.5", "9", "4"]


def test_what_went_wrong_is_recorded(unit: CanUnit, tmp_path: Path) -> None:
    recorded(unit, tmp_path)
    anomalies = [json.loads(line) for line in (tmp_path / "anomalies.jsonl").read_text().splitlines()]
    assert [(entry["kind"], entry.get("reason")) for entry in anomalies] == [
        ("cyclic_malformed", None),
        ("transfer_frame_ignored", "UNEXPECTED_PDU"),
    ]
    assert next(entry.telemetry.name for entry in read_recording(tmp_path)) == "pong"
    sent = json.loads((tmp_path / "telecommands.jsonl").read_text().splitlines()[0])
    assert bytes.fromhex(sent["raw"]) == unit.fake.requests[0].packet
    assert "wire" not in sent
    session = json.loads((tmp_path / "session.json").read_text())
    assert (session["node"], session["started_utc"]) == (10, "2026-01-01T00:00:00+00:00")


def test_a_telecommand_that_did_not_arrive_is_recorded_as_such(unit: CanUnit, tmp_path: Path) -> None:
    unit.flow_control = None
    with connected(unit, tmp_path) as obc:
        obc.begin("ping")
        obc.wait(2)
    _, finished = map(json.loads, (tmp_path / "telecommands.jsonl").read_text().splitlines())
    assert (finished["state"], finished["finished_s"]) == ("not delivered", 1.0)
    assert "TIMEOUT_BS" in finished["transfer"]


# The command line


@pytest.fixture
def run(unit: CanUnit) -> Run:
    """The command line with a unit on a bus; `run.asked` is what it would have connected to."""
    asked: list[dict[str, Any]] = []

    def connect(link: str, *, record: Path | None = None, **options: Any) -> Obc:
        asked.append({"link": link, **options})
        return connected(unit, record, options.get("node", 10))

    def invoke(*arguments: str, typed: str | None = None) -> Result:
        return CliRunner().invoke(obc_app, list(arguments), input=typed, obj=connect)

    invoke.asked = asked  # type: ignore[attr-defined]
    return invoke


def commands(*lines: str) -> list[str]:
    return [word for line in lines for word in ("--command", line)]


def test_unit_and_node_from_the_command_line(run: Run) -> None:
    result = run("--link", "can:socketcan/vcan0", "--unit", "roja1", "--node", "77", *commands("wait 0"))
    assert result.exit_code == 0, result.output
    (asked,) = run.asked  # type: ignore[attr-defined]
    assert (asked["link"], asked["unit"], asked["node"]) == ("can:socketcan/vcan0", "roja1", 77)
    assert asked["apid"] == load_unit("roja1").apid
    assert run("--node", "128").exit_code == 2
    assert "can:socketcan/vcan0" in run("--help").stdout


def test_json_has_node_and_counters_of_the_bus(run: Run, tmp_path: Path) -> None:
    assert run("--json", str(tmp_path / "out.json"), *commands("ping")).exit_code == 0
    out = json.loads((tmp_path / "out.json").read_text())
    assert (out["node"], out["counters"]["telecommands_verified"]) == (10, 1)
    assert (out["counters"]["transfers_sent"], out["counters"]["timeout_bs"]) == (1, 0)


def test_cyclic_frames_in_words(run: Run, unit: CanUnit) -> None:
    unit.put(HEARTBEAT + 10, heartbeat(3, mode=4))
    unit.put(STATUS + 10, status(9, valid=0, reasons=6))
    unit.put(ATTITUDE_1 + 10, half(9, 0.0, 0.0))
    unit.put(ATTITUDE_2 + 10, half(9, 0.0, 1.0))
    result = run(*commands("wait 0.1", "cyclic", "cyclic status", "cyclic attitude"))
    assert result.exit_code == 0, result.output
    lines = [" ".join(line.split()) for line in result.stdout.splitlines() if not line.startswith(">")]
    assert lines[0].startswith("heartbeat 0.100 s ago counter 3 mode TRACKING attitude_valid 1")
    assert "can_state ERROR_ACTIVE" in lines[0]
    assert "reasons NO_MATCH|BLINDED" in lines[-2]
    assert lines[-2].startswith("status")
    assert lines[-1].startswith("counter 9 ra ")
    assert lines[-1].endswith("not valid: NO_MATCH|BLINDED")


def test_cyclic_frames_that_do_not_come(run: Run) -> None:
    result = run(*commands("cyclic", "cyclic attitude", "cyclic rates"))
    assert result.exit_code == 1
    assert "no cyclic frames" in result.stdout
    assert "no attitude came" in result.stdout
    assert "cyclic frame rates: did not come within 2 s; none came" in result.stderr


def test_sync_and_frames_from_the_command_line(run: Run, unit: CanUnit) -> None:
    def on_frame(identifier: int, data: bytes) -> None:
        if identifier == 0x080:
            unit.put(SYNC_TIME + 10, clock(data[0], 2_000_000_000, 1 << 23))
        elif identifier == 0x100:
            unit.fake.event(12, unit.wire.CUC + data[1:8], after_ms=5)

    unit.on_frame = on_frame
    result = run(*commands("sync", "sync 1958-01-02T00:00:00Z", "can 123 00 ff", "can 1FFFFFFF", "wait 0.01"))
    assert result.exit_code == 0, result.output
    said = [line for line in result.stdout.splitlines() if not line.startswith(">")]
    assert said[0] == "SYNC 0: on-board time 2000000000.500000 s"
    assert "TIME_SET" in said[1]
    assert said[2:] == ["123#00FF sent", "1FFFFFFF# sent"]
    sent = [(identifier, data) for _, identifier, data in unit.heard if identifier < 0x200]
    assert sent == [
        (0x080, b"\x00"),
        (0x080, b"\x01"),
        (0x100, b"\x01" + struct.pack(">I", 86_410) + bytes(3)),
        (0x123, b"\x00\xff"),
    ]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("cyclic weather", "'weather' is no cyclic frame; there are heartbeat, attitude_1"),
        ("sync yesterday", "'yesterday' is no time"),
        ("can 12 00", "'12' is no identifier; write 3 hexadecimal digits"),
        ("can xyz", "'xyz' is no identifier"),
        ("can FFF 00", "identifier = 4095"),
        ("can 123 " + "00" * 9, "data = "),
    ],
)
def test_a_wrong_line_is_refused_before_anything_is_sent(
    run: Run, unit: CanUnit, line: str, message: str
) -> None:
    if line.endswith("00" * 9):
        result = run(*commands("ping", line))
        assert message in result.stderr
        assert result.exit_code == 2
        return
    result = run(*commands("ping", line))
    assert result.exit_code == 2
    assert message in result.stderr
    assert unit.heard == []


def test_expectations_of_the_bus(run: Run) -> None:
    result = run(*commands("ping", "expect counters.transfers_sent == 1", "expect counters.timeout_cr == 0"))
    assert result.exit_code == 0, result.output


def test_a_unit_that_is_not_chosen_ends_a_script(run: Run, unit: CanUnit) -> None:
    for node in (10, 11):
        unit.put(HEARTBEAT + node, heartbeat())
    result = CliRunner().invoke(
        obc_app, commands("ping"), obj=lambda link, record=None: connected(unit, None, None)
    )
    assert result.exit_code == 1
    assert "several units are on the bus: nodes 10, 11; name the one that is meant" in result.stderr


def test_the_live_view_shows_bus_and_node(unit: CanUnit) -> None:
    with connected(unit) as obc:
        unit.put(STATUS + 11, status(1))
        obc.ping()
        console = Console(width=120, file=io.StringIO())
        console.print(live_table(obc))
        text = console.file.getvalue()  # type: ignore[attr-defined]
    assert "vcan7@1000000,fd, node 10, APID 0x123" in text
    assert "1 of others" in text
    assert "3 received, 1 sent, 0 failed" in text


def test_on_a_serial_line_bus_commands_say_so(link_pair: Any) -> None:
    def connect(link: str, record: Any = None) -> Obc:
        return Obc(link_pair[1], reader=SteppedReader(lambda now_ns: None))

    for line in ("cyclic", "cyclic attitude", "sync", "can 123", "expect counters.timeout_bs == 0"):
        result = CliRunner().invoke(obc_app, commands(line), obj=connect)
        assert result.exit_code == 1
        assert "memory (obc) is no CAN bus" in result.stderr
