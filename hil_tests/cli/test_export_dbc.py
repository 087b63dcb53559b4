"""`export dbc`: which units, where to, and that cantools' own program decodes a log with it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cantools
import pytest

from hil_tests.vectors import reference_can_frames as reference
from st_emulator.units.profile import load_unit, unit_names, unit_text


def nodes(text: str) -> list[str]:
    return [node.name for node in cantools.database.load_string(text, database_format="dbc").nodes]


def test_units_that_are_named_go_to_standard_output(command):
    outcome = command("export", "dbc", "roja1", "roja1:20", "zy3:30")
    assert (outcome.status, outcome.err) == (0, "")
    assert nodes(outcome.out) == ["OBC", "roja1_10", "roja1_20", "zy3_30"]


def test_named_units_to_a_file_and_its_check(command, refused, tmp_path):
    path = tmp_path / "bus.dbc"
    assert command("export", "dbc", "zy3:2", "--output", path).out == f"{path}\n"
    assert nodes(path.read_text(encoding="utf-8")) == ["OBC", "zy3_2"]
    assert command("export", "dbc", "zy3:2", "--output", path, "--check").out == f"{path}: up to date\n"
    refused("export", "dbc", "zy3:3", "--output", path, "--check", says=(str(path), "out of date"))
    refused("export", "dbc", "zy3", "--check", says=("--check", "--output FILE"))


def test_the_shipped_units_have_node_numbers_of_their_own(command):
    out = command("export", "dbc", *unit_names()).out
    assert nodes(out) == ["OBC", *(f"{name}_{load_unit(name).can.node}" for name in unit_names())]
    committed = Path(__file__).parents[2] / "docs/units.dbc"
    assert out == committed.read_text(encoding="utf-8")


def test_periods_are_those_of_the_file(command, tmp_path):
    text = unit_text("roja1")[1]
    for old, new in (
        ("heartbeat_ms = 1000", "heartbeat_ms = 500"),
        ("attitude_frames = 1 ", "attitude_frames = 4 "),
        ("rates_frames = 1 ", "rates_frames = 0 "),
        ("frame_period_ms = 250", "frame_period_ms = 200"),
    ):
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "mine:7.toml"  # a colon that is no node number
    path.write_text(text, encoding="utf-8")
    for argument, node in ((path, 10), (f"{path}:3", 3)):
        database = cantools.database.load_string(command("export", "dbc", argument).out)
        cycles = {message.name: message.cycle_time for message in database.messages}
        assert cycles[f"roja1_{node}_heartbeat"] == 500
        assert cycles[f"roja1_{node}_attitude_2"] == 800
        assert cycles[f"roja1_{node}_rates"] is None
        assert cycles[f"roja1_{node}_mid_exposure_time"] == 200


def test_can_fd(command):
    database = cantools.database.load_string(command("export", "dbc", "roja1", "--fd").out)
    assert database.get_message_by_name("roja1_10_telemetry").length == 64
    assert command("export", "dbc", "--fd").out.startswith("VERSION")  # never over the committed file


@pytest.mark.parametrize(
    ("units", "says"),
    [
        (("roja2",), ("roja2", "aps_rs, iris, roja1, science_cam, zy3")),
        (("roja1:0",), ("roja1:0", "CAN node 0", "from 1 to 127")),
        (("roja1:-1",), ("CAN node -1",)),
        (("roja1:128",), ("CAN node 128",)),
        (("roja1:x",), ("no unit 'roja1:x'",)),
        (("roja1:99999999999",), ("no unit 'roja1:99999999999'",)),
        (("roja1", "roja1:10"), ("roja1_10", "each unit and node once", "UNIT:NODE")),
        (("roja1", "zy3:10"), ("zy3_10_heartbeat", "0x70A", "roja1_10_heartbeat", "UNIT:NODE")),
    ],
    ids=lambda value: " ".join(value),
)
def test_units_that_cannot_be(units, says, refused):
    refused("export", "dbc", *units, says=says)


def test_cantools_decodes_a_log_with_the_committed_file():
    """As a user does it: candump's log into `cantools decode`."""
    lines = []
    for second, (node, unit) in enumerate(((10, "roja1"), (11, "zy3"), (12, "science_cam"), (13, "aps_rs"))):
        assert load_unit(unit).can.node == node
        for name in (*reference.FRAMES, "telemetry", "telecommand"):
            number = reference.identifier(name, node)
            data = (
                reference.encode(name, {"counter": node})
                if name in reference.FRAMES
                else b"\x03abc\xcc\xcc\xcc\xcc"
            )
            lines.append(f"({second}.000000) vcan0 {number:03X}#{data.hex().upper()}")
    file = Path(__file__).parents[2] / "docs/units.dbc"
    run = subprocess.run(
        [sys.executable, "-m", "cantools", "decode", "--single-line", str(file)],
        input="\n".join(lines) + "\n",
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (run.returncode, run.stderr) == (0, "")
    decoded = run.stdout.splitlines()
    assert len(decoded) == len(lines) == 44
    for line in decoded:
        assert "Unknown frame id" not in line
        assert "rror" not in line.replace("ERROR_ACTIVE", ""), line
        assert "(" in line.split("::")[1], line
    assert decoded[1].endswith(":: roja1_10_attitude_1(counter: 10, q_x: 0.0, q_y: 0.0)"), decoded[1]
    assert "zy3_11_telemetry(pci_type: SINGLE_FRAME, sf_length: 3, sf_byte_1: 97" in run.stdout
