"""docs/adding_a_dialect.md: its excerpts are the template's, its commands run, its errors come."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hil_tests.architecture.source_tree import ROOT
from hil_tests.dialects.command_line import modules_apart, run_in
from st_emulator.dialects.registry import dialect_names

PAGE = ROOT / "docs/adding_a_dialect.md"
TEMPLATE = ROOT / "examples/my_dialect"
BLOCK = re.compile(r"^<!-- (.*?) -->\n```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
BLOCKS = BLOCK.findall(PAGE.read_text(encoding="utf-8"))
EXCERPTS = [(mark, text) for mark, _, text in BLOCKS if mark not in ("run", "errors")]
COPY = shutil.ignore_patterns("__pycache__")


def environment(folder: Path) -> dict[str, str]:
    """That of a user who has installed st-emulator."""
    for name, command in (("st-emulator", "-m st_emulator"), ("python", "")):
        script = folder / "bin" / name
        script.parent.mkdir(exist_ok=True)
        script.write_text(f'#!/bin/sh\nexec "{sys.executable}" {command} "$@"\n')
        script.chmod(0o755)
    path = f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT), "ST_EMULATOR": str(ROOT)}


def run(command: list[str], folder: Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command,
        cwd=cwd,
        env=environment(folder),
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )


def test_every_block_is_held_by_something():
    fences = re.findall(r"^```\w+$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert len(fences) == len(BLOCKS) > 20


@pytest.mark.parametrize(
    ("file", "text"), EXCERPTS, ids=[f"{n}-{mark}" for n, (mark, _) in enumerate(EXCERPTS)]
)
def test_excerpt(file, text):
    assert text in (TEMPLATE / file).read_text(encoding="utf-8")


def test_every_file_of_the_template_is_shown():
    shown = {file for file, _ in EXCERPTS}
    package = {f"my_dialect/{path.name}" for path in (TEMPLATE / "my_dialect").glob("[!_]*.py")}
    assert shown == package | {"my_unit.toml"}


def test_links_lead_somewhere():
    links = re.findall(r"\]\(([^)#]+)\)", PAGE.read_text(encoding="utf-8"))
    assert "../st_emulator/dialects/dialect.py" in links
    assert [link for link in links if not (PAGE.parent / link).exists()] == []


@pytest.mark.slow
def test_the_commands(tmp_path):
    (text,) = [text for mark, kind, text in BLOCKS if (mark, kind) == ("run", "sh")]
    ended = run(["sh", "-euc", text], tmp_path, tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert "1 passed" in ended.stdout
    assert "differences" in ended.stdout
    assert "3 telecommands" in ended.stderr
    assert "arcsec from the truth" in ended.stdout


@pytest.mark.parametrize(
    "text",
    [text for mark, kind, text in BLOCKS if (mark, kind) == ("run", "python")],
    ids=["status", "settings", "mutations"],
)
def test_python(text, tmp_path):
    project = Path(shutil.copytree(TEMPLATE, tmp_path / "my_project", ignore=COPY))
    with modules_apart(), contextlib.chdir(project):
        exec(compile(text, str(PAGE), "exec"), {})


CHANGES = (
    ("my_dialect.definition:DIALECT", "my_dialect", "none"),
    ("my_dialect.definition:DIALECT", "my_dialekt.definition:DIALECT", "none"),
    ("my_dialect.definition:DIALECT", "my_dialect.definition:DIALEKT", "none"),
    ("address = 7", "adress = 7", "none"),
    ("address = 7", "address = 255", "none"),
    ("address = 7", "address = 7", "can:virtual/x"),
)
(ERRORS,) = [text.splitlines() for mark, _, text in BLOCKS if mark == "errors"]


def test_there_is_a_change_for_each_error():
    assert len(ERRORS) == len(CHANGES)


@pytest.mark.parametrize(("line", "change"), list(zip(ERRORS, CHANGES, strict=False)))
def test_error(line, change, tmp_path):
    project = Path(shutil.copytree(TEMPLATE, tmp_path / "my_project", ignore=COPY))
    old, new, link = change
    unit = project / "my_unit.toml"
    unit.write_text(unit.read_text().replace(old, new))
    ended = run_in(project, "run", "./my_unit.toml", "--link", link)
    wanted = line.replace("FOLDER", str(project)).replace("SHIPPED", ", ".join(dialect_names()))
    assert (ended.status, ended.out, ended.err) == (2, "", wanted + "\n")
