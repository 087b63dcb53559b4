"""`export`, `units`, `--help`: what a user reads about the program."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from st_emulator.units.profile import load_unit, unit_names

ROOT = Path(__file__).parents[2]
DOCUMENTS = {
    "icd": "interface_control_document.md",
    "scenario-schema": "scenario.schema.json",
    "unit-schema": "unit.schema.json",
    "dbc": "units.dbc",
}


@pytest.mark.parametrize("name", DOCUMENTS)
def test_the_committed_document_is_up_to_date(name, command):
    committed = ROOT / "docs" / DOCUMENTS[name]
    outcome = command("export", name, "--check", "--out", committed)
    assert (outcome.status, outcome.err) == (0, ""), outcome
    assert outcome.out == f"{committed}: up to date\n"


@pytest.mark.parametrize("name", DOCUMENTS)
def test_written_then_stale(name, command, refused, tmp_path):
    path = tmp_path / "folder" / DOCUMENTS[name]
    refused("export", name, "--check", "--out", path, says=(str(path), "out of date", "without --check"))
    assert not path.exists()
    assert command("export", name, "--out", path).out == f"{path}\n"
    assert path.read_bytes() == (ROOT / "docs" / DOCUMENTS[name]).read_bytes()
    text = path.read_text(encoding="utf-8")
    for change in (text + "\n", text.replace("e", "E", 1), text.replace("\n", "\r\n"), ""):
        path.write_text(change, encoding="utf-8", newline="")
        refused("export", name, "--check", "--out", path, says=("out of date",))
        assert path.read_bytes() == change.encode()  # a check writes nothing
    path.write_bytes(b"\xff")
    refused("export", name, "--check", "--out", path, says=("out of date",))
    refused("export", name, "--check", "--out", tmp_path, says=(str(tmp_path), "cannot be read"))
    refused("export", name, "--out", path / "below", says=("below", "cannot be written"))


def test_without_out_documents_go_to_docs(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, file in DOCUMENTS.items():
        assert command("export", name).status == 0
        assert (tmp_path / "docs" / file).exists()
    shutil.rmtree(tmp_path / "docs")


def test_schemas_are_json_schemas_of_the_files():
    for name, keys in (
        ("unit", {"unit", "optics", "detector", "timing", "processor", "wire"}),
        ("scenario", {"schema", "start_utc", "trajectory", "sky", "telecommands", "parameters"}),
    ):
        schema = json.loads((ROOT / f"docs/{name}.schema.json").read_text(encoding="utf-8"))
        assert schema["additionalProperties"] is False
        assert set(schema["properties"]) >= keys


def test_units(command):
    outcome = command("units")
    assert outcome.status == 0
    assert [line.split()[0] for line in outcome.out.splitlines()] == unit_names()
    figures = json.loads(command("units", "--json", "-").out)
    assert figures["units"] == [
        {"name": name, "title": load_unit(name).unit.title, "apid": load_unit(name).apid}
        for name in unit_names()
    ]
    assert figures["checks"] == []
    assert len({unit["apid"] for unit in figures["units"]}) == len(figures["units"])


TEACHES = {
    (): (
        "run",
        "demo",
        "campaign",
        "solve",
        "replay",
        "faults",
        "units",
        "export",
        "obc",
        "prepare",
        "budget",
    ),
    ("run",): (
        *("--link", "pty:PATH", "serial:DEV@BAUD", "--scenario", "--speed", "max", "--seed", "--frames"),
        *(
            "PNG",
            "TIFF",
            "FITS",
            "--journal",
            "--truth",
            "--seconds",
            "--store",
            "Ctrl-C",
            "st-emulator units",
        ),
        "the computer's date (UTC)",
    ),
    ("demo",): ("--unit", "--seconds", "--json", "--out", "--seed", "real time"),
    ("campaign",): (
        *("earth-rate", "lost-in-space", "accuracy", "zy3-table3", "false-stars"),
        *("--n", "--workers", "--json", "--unit", "--dask", "--results", "--restart", "--plot"),
    ),
    ("budget",): (
        *("--n", "--scenario", "--clock", "--cache", "--line-fill", "--json", "--html", "--plot"),
        *("--results", "--restart"),
    ),
    ("solve",): ("PNG, TIFF or FITS", "--unit", "--json", "--picture"),
    ("replay",): ("--journal", "--write", "--json", "byte by byte"),
    ("units",): ("--json",),
    ("faults",): ("KIND", "--seam", "--json", "what the OBC must see", "TOML"),
    ("prepare",): ("Compile",),
    ("export",): ("icd", "scenario-schema", "unit-schema", "dbc", "dialects", "fmu"),
    ("export", "dialects"): ("--out", "--check", "docs/dialects"),
    ("export", "icd"): ("--out", "--check", "status 2"),
    ("export", "scenario-schema"): ("--out", "--check"),
    ("export", "unit-schema"): ("--out", "--check"),
    ("export", "fmu"): ("UNIT", "--out", "--scenario", "FMI 2.0", "power", "st-emulator[fmu]"),
    ("export", "dbc"): ("UNIT[:NODE]", "--output", "--fd", "--check", "docs/units.dbc", "standard output"),
    ("obc",): ("--link", "--apid", "--script", "--record", "--watch", "--json", "Exit status"),
}


@pytest.mark.parametrize("words", TEACHES, ids=lambda words: " ".join(words) or "(none)")
def test_help(words, command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "250")
    outcome = command(*words, "--help")
    assert outcome.status == 0
    assert outcome.err == ""
    assert f"Usage: {' '.join(['st-emulator', *words])}" in outcome.out
    text = " ".join(re.sub("[│╭╮╰╯─]", " ", outcome.out).split())
    for word in TEACHES[words]:
        assert word in text, word


def test_every_command_is_in_this_list(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "250")
    for group in ((), ("export",)):
        told = command(*group, "--help").out.split("Commands")[1]
        names = re.findall(r"^│ ([a-z-]+) ", told, re.MULTILINE)
        assert {(*group, name) for name in names} <= set(TEACHES)


def test_nothing_at_all_shows_the_help(command):
    outcome = command()
    assert "Usage: st-emulator" in outcome.out + outcome.err


# -- unit files and what is written about them

SECTION = re.compile(r"^\[[a-z_.]+\]$")
LINE = re.compile(r'^[a-z0-9_]+ = (?P<value>"[^"]*"|[^#"]+?)  # (?P<comment>\S.*)$')
ASSUMED = re.compile(r"^ASSUMED: \w.{4,}")  # with its reason
SOURCE = re.compile(r"^([A-Z])\b")  # a letter that the head of the file explains
PROJECT = re.compile(r"this project's target")


@pytest.mark.parametrize("name", unit_names())
def test_every_figure_of_a_shipped_unit_says_where_it_comes_from(name):
    lines = (ROOT / f"st_emulator/units/{name}.toml").read_text(encoding="utf-8").splitlines()
    head = " ".join(line for line in lines if line.startswith("#"))
    letters = set(re.findall(r'"([A-Z])"', head))
    assert letters
    figures = 0
    for number, line in enumerate(lines, start=1):
        if not line or line.startswith("#") or SECTION.match(line):
            continue
        where = f"{name}.toml, line {number}: {line}"
        match = LINE.match(line)
        assert match, f"{where}: no comment with a source or ASSUMED:"
        comment = match["comment"]
        source = SOURCE.match(comment)
        if source:
            assert source[1] in letters, f"{where}: the head of the file does not say what {source[1]} is"
        elif not match["value"].startswith('"'):
            assert ASSUMED.match(comment) or PROJECT.search(comment), f"{where}: no source and no reason"
        figures += 1
    assert figures > 40


def test_readme_and_interface_document_name_the_units_and_the_file_format():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    document = (ROOT / "docs/interface_control_document.md").read_text(encoding="utf-8")
    for name in unit_names():
        assert f"`{name}`" in readme
        assert f"| {name} |" in document
    assert "ASSUMED:" in readme
    for path in re.findall(r"\]\(([^)#:]+)\)", readme):
        assert (ROOT / path).exists(), path
    assert "interface_control_document.md" in readme
