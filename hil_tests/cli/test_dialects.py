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
    refused("demo", "--dialect", "", says=("--dialect: found", "pus"))
    can = ("--link", "can:virtual/x")
    refused("run", "roja1", "--dialect", "sagitta", *can, says=("--dialect: sagitta", "no CAN bus"))
    refused("run", "roja1", "--dialect", "canopen", "--link", "pty", says=("canopen", "no serial line"))
    path = unit_file(tmp_path, "sagitta")
    refused("run", path, *can, says=(f"{path}: wire.dialect: sagitta has no CAN bus",))


def test_the_obc_simulator_refuses_a_unit_of_another_language(command, tmp_path: Path) -> None:
    path = unit_file(tmp_path, "sagitta")
    outcome = command("obc", "--unit", path, "-c", "ping")
    assert (outcome.status, outcome.out) == (2, "")
    (line,) = outcome.err.splitlines()
    assert line.startswith(
        f"st-emulator obc: unit {path}: speaks sagitta; the OBC simulator speaks pus alone"
    )


def test_a_demo_takes_no_option_that_it_would_ignore(refused, tmp_path: Path) -> None:
    for option, value in (("--seconds", "20"), ("--link", "pty"), ("--out", tmp_path / "out")):
        refused("demo", "--dialect", "nos3", option, value, says=(f"{option}:", "nos3", "--json"))
    path = unit_file(tmp_path, "sagitta")
    refused("demo", "--unit", path, "--seconds", "20", says=("--seconds:", "sagitta"))
    out = tmp_path / "out"
    refused("demo", "--unit", path, "--dialect", "pus", "--out", out, says=(str(path), "speaks sagitta"))
    assert not out.exists()


@pytest.mark.parametrize("value", ['"no"', "0", "1.0"])
@pytest.mark.parametrize(
    ("dialect", "setting"),
    [("sagitta", "boot_loader"), ("nos3", "autonomous"), ("canopen", "goes_operational")],
)
def test_a_switch_is_true_or_false(refused, tmp_path: Path, dialect: str, setting: str, value: str) -> None:
    path = unit_file(tmp_path, dialect)
    path.write_text(path.read_text() + f"\n[dialects.{dialect}]\n{setting} = {value}\n")
    run = ("run", path, "--link", "none", "--speed", "max", "--seconds", "1")
    refused(*run, says=(f"{setting}: found", "allowed is true or false"))


def test_a_table_of_nobody_names_each_dialect_once(refused, tmp_path: Path) -> None:
    path = unit_file(tmp_path, "nos3")
    path.write_text(path.read_text() + "\n[dialects.noss]\nlayout = 'code'\n")
    run = ("run", path, "--link", "none", "--speed", "max", "--seconds", "1")
    refused(*run, says=("dialects.noss", "allowed are nos3, pus, canopen, sagitta"))


def test_a_scenario_in_another_language_names_the_telecommand(refused) -> None:
    """What the language does not have is told, not what it has beside."""
    slew = Path(__file__).parents[2] / "examples" / "slew.toml"
    run = ("run", "roja1", "--scenario", slew, "--speed", "max", "--dialect")
    refused(*run, "nos3", says=("telecommands.0", "set_time", "noop, housekeeping, data"))
    refused(*run, "sagitta", says=("telecommands.0", "set_time: time", "utc or unix_us"))


def test_journals_of_another_door_are_refused(refused, command, tmp_path: Path) -> None:
    """A scenario's telecommands on a CAN bus came in behind the transport once."""
    path = tmp_path / "old.jsonl"
    run = ("run", "roja1", "--speed", "max", "--seconds", "1", "--journal", path, "--store", "none")
    assert command(*run).status == 0
    header = path.read_text().split("\n", 1)[0]
    path.write_text(f'{header}\n{{"t_ns": 5, "packet": "00"}}\n')
    refused("replay", path, says=(str(path), "line 2", "recorded anew"))
