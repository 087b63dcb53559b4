"""`st-emulator replay`: a journal alone gives the same bytes at the same times again."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest

from hil_tests.cli.live import LiveUnit
from hil_tests.vectors import reference_decoder
from st_emulator.bench.journal import read_journal
from st_emulator.obc import Obc

PARAMETER_STORE_INVALID = 14
FAST = ("--speed", "max", "--seconds", "1.5")


def record_live(link: Path, journal: Path, *more: str, kill: bool) -> None:
    """About four seconds with an OBC that does what OBCs do, then SIGTERM or SIGKILL."""
    arguments = ("zy3", "--link", f"pty:{link}", "--journal", journal, *more)
    with LiveUnit(*arguments) as unit:
        unit.await_running()
        with Obc.connect(f"pty:{link}") as obc:
            obc.wait_for("hk_report", lambda telemetry: True, timeout_s=60)
            obc.set_time()
            obc.set_parameter("detection_sigma", 6.0)
            obc.acquire(timeout_s=60)
            obc.link.write(b"\x00garbage\xc0")
            obc.ping()
            obc.housekeeping("TIMING")
            obc.wait(1.0)
        if kill:
            unit.await_lines(journal, 200)
        assert unit.stop(signal.SIGKILL if kill else signal.SIGTERM) == (-signal.SIGKILL if kill else 0)


def test_a_run_with_a_live_obc(command, tmp_path):
    journal, again, store = (tmp_path / name for name in ("journal.jsonl", "again.jsonl", "store"))
    store.write_text("no store at all")  # the unit says so in an event, and so does its replay
    record_live(tmp_path / "tracker", journal, "--store", str(store), kill=False)
    frames = reference_decoder.slip_frames(read_journal(journal).bytes_of("tx"))
    names = [reference_decoder.decode_telemetry(frame) for frame in frames]
    assert PARAMETER_STORE_INVALID in [packet["fields"].get("event_id") for packet in names]
    outcome = command("replay", journal, "--write", again, "--json", "-")
    assert outcome.status == 0, outcome.err
    figures = json.loads(outcome.out)
    assert figures["ended"] is True
    assert figures["tx_bytes"] == figures["tx_bytes_replayed"] > 1000
    assert figures["rx_bytes"] > 50
    assert figures["first_difference"] == "none"
    assert figures["checks"] == [
        {"name": "differences", "value": 0, "target": "== 0", "unit": "", "holds": True}
    ]
    first, second = read_journal(journal), read_journal(again)
    assert first.entries == second.entries
    assert first.end_ns == second.end_ns
    assert command("replay", again).status == 0  # a journal like any other


def test_a_run_that_was_killed(command, tmp_path):
    journal = tmp_path / "journal.jsonl"
    record_live(tmp_path / "tracker", journal, "--store", "none", kill=True)
    assert not read_journal(journal).ended
    assert command("replay", journal, "--json", "-").status == 0
    # Wherever the last line was cut.
    whole = journal.read_bytes()
    end = whole.rstrip(b"\n").rfind(b"\n")
    for cut in (end + 1, end + 2, (end + len(whole)) // 2, len(whole) - 2):
        journal.write_bytes(whole[:cut])
        outcome = command("replay", journal, "--json", "-")
        assert outcome.status == 0, outcome.err
        assert json.loads(outcome.out)["ended"] is False


@pytest.fixture
def journal(command, tmp_path) -> Path:
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(
        "[parameters]\ndetection_sigma = 7.5\n[[telecommands]]\nat_s = 0.6\nname = 'ping'\n"
        "[[telecommands]]\nat_s = 0.6\nname = 'function'\nfields = {function_id = 'START_ACQUISITION'}\n"
        "[[telecommands]]\nat_s = 1.0\nname = 'parameter_report'\nfields = {parameter_ids = [2, 1]}\n"
    )
    path = tmp_path / "journal.jsonl"
    arguments = (*FAST, "--scenario", scenario, "--seed", "9", "--journal", path)
    assert command("run", "roja1", *arguments).status == 0
    return path


def test_a_run_of_a_scenario_without_its_files(command, journal, tmp_path):
    (tmp_path / "scenario.toml").unlink()
    assert command("replay", journal).status == 0


def changed(journal: Path, number: int, **change: object) -> None:
    """Change one line of a journal."""
    lines = journal.read_text().splitlines()
    lines[number] = json.dumps(json.loads(lines[number]) | change)
    journal.write_text("\n".join(lines) + "\n")


def test_what_is_not_the_same_is_told(command, journal):
    entries = read_journal(journal).entries
    number = next(n for n, entry in enumerate(entries) if entry.direction == "tx" and entry.t_ns > 1e9)
    changed(journal, number + 1, t_ns=entries[number].t_ns + 1)
    outcome = command("replay", journal, "--json", "-")
    assert outcome.status == 1
    figures = json.loads(outcome.out)
    assert figures["checks"][0]["holds"] is False
    assert f"{entries[number].t_ns / 1e9:.9f}"[:-1] in figures["first_difference"]


@pytest.mark.parametrize("change", [{"seed": 10}, {"baud": 9600}])
def test_another_unit_gives_other_bytes(change, command, journal):
    changed(journal, 0, **change)
    assert command("replay", journal).status == 1


def test_a_lost_telecommand_is_a_difference(command, journal):
    lines = journal.read_text().splitlines()
    journal.write_text("\n".join(line for line in lines if '"rx"' not in line) + "\n")
    assert command("replay", journal).status == 1


def test_a_missing_end_is_no_difference_but_a_missing_middle_is(command, journal):
    lines = journal.read_text().splitlines()
    journal.write_text("\n".join(lines[:-5]) + "\n")
    assert command("replay", journal).status == 0
    journal.write_text("\n".join(lines[:-9] + lines[-5:]) + "\n")
    assert command("replay", journal).status == 1
