"""What docs/testing_your_obc.md shows runs, and names what there is."""

from __future__ import annotations

import re
from pathlib import Path

from st_emulator import pytest_plugin

from .conftest import Project

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/testing_your_obc.md").read_text(encoding="utf-8")
OBC_TEAM = ROOT / "hil_tests/examples/obc_team"


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.S)


def test_the_first_example_runs(project: Project) -> None:
    first = blocks("python")[0]
    assert len(first.splitlines()) <= 10
    project.write("test_it.py", first)
    run = project.run("-q")
    assert run.status == 0, run.text


def test_the_projects_test_stands_there_as_it_is_shown() -> None:
    body = blocks("python")[1].split("\n", 1)[1]
    assert body in (OBC_TEAM / "tests/test_on_the_line.py").read_text(encoding="utf-8")


def test_all_options_markers_and_fixtures_are_named() -> None:
    for option in pytest_plugin.OPTIONS:
        assert f"--st-{option}" in PAGE
    for marker in pytest_plugin.MARKERS:
        assert f"`{re.split('[(:]', marker)[0]}" in PAGE
    for fixture in pytest_plugin.FIXTURES:
        assert f"`{fixture}`" in PAGE


def test_each_test_of_the_project_has_ten_lines_at_most() -> None:
    for path in (OBC_TEAM / "tests").glob("test_*.py"):
        for body in re.split(r"\n\n\n", path.read_text(encoding="utf-8")):
            if "def test_" in body:
                assert len(body.strip().splitlines()) <= 10, body
