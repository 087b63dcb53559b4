"""`--dialect`: what a user of another language than PUS meets on the command line."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path

import pytest

from st_emulator.dialects.registry import SHIPPED

OTHERS = [definition.name for definition in SHIPPED if definition.name != "pus"]
ROJA1 = (resources.files("st_emulator") / "units/roja1.toml").read_text(encoding="utf-8")


def unit_file(folder: Path, dialect: str) -> Path:
    path = folder / "unit.toml"
    path.write_text(ROJA1.replace("[wire]\n", f'[wire]\ndialect = "{dialect}"\n'))
    return path


@pytest.mark.parametrize("dialect", OTHERS)
def test_demo(command, dialect: str) -> None:
    outcome = command("demo", "--dialect", dialect, "--json", "-")
    assert outcome.status == 0, outcome.err
    report = json.loads(outcome.out)
    assert report["dialect"] == dialect
    assert report["octets_from_the_unit"] > 0
    assert len(report["checks"]) >= 5
    assert all(check["holds"] for check in report["checks"])


def test_demo_of_a_unit_file_is_in_its_language(command, tmp_path: Path) -> None:
    outcome = command("demo", "--unit", unit_file(tmp_path, "nos3"), "--json", "-")
    assert outcome.status == 0, outcome.err
    assert json.loads(outcome.out)["dialect"] == "nos3"


@pytest.mark.parametrize("dialect", OTHERS)
def test_a_run_its_journal_and_its_replay(command, tmp_path: Path, dialect: str) -> None:
    journal = tmp_path / "journal.jsonl"
    run = ("run", "zy3", "--dialect", dialect, "--speed", "max", "--seconds", "3", "--journal", journal)
    outcome = command(*run)
    assert outcome.status == 0, outcome.err
    first = journal.read_text()
    assert json.loads(first.splitlines()[0])["unit"]["wire"]["dialect"] == dialect
    assert command(*run).status == 0
    assert journal.read_text() == first, "the same again"
    assert command("replay", journal).status == 0


def test_what_is_refused(refused, tmp_path: Path) -> None:
    refused("run", "roja1", "--dialect", "klingon", says=("klingon", "pus", "sagitta", "module:NAME"))
    refused("demo", "--dialect", "klingon", says=("klingon", "pus"))
    can = ("--link", "can:virtual/x")
    refused("run", "roja1", "--dialect", "sagitta", *can, says=("sagitta", "no CAN bus", "another dialect"))
    refused("run", "roja1", "--dialect", "canopen", "--link", "pty", says=("canopen", "no serial line"))
    path = unit_file(tmp_path, "sagitta")
    refused("obc", "--unit", path, "ping", says=(str(path), "speaks sagitta", "pus alone"))


def test_journals_of_another_door_are_refused(refused, tmp_path: Path) -> None:
    """A scenario's telecommands on a CAN bus came in behind the transport once."""
    path = tmp_path / "old.jsonl"
    header = '{"format": "st-emulator journal 1"}'
    path.write_text(f'{header}\n{{"t_ns": 5, "packet": "00"}}\n')
    refused("replay", path, says=(str(path), "line 2", "recorded anew"))
