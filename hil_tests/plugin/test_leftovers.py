"""Nothing is left behind: no process, port, link or lock; not by workers side by side, nor after a kill."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable

import pytest

from .conftest import Project

PATIENCE_S = 120.0  # only bounds a hang
LIVE = """
import pytest
from pathlib import Path
pytestmark = pytest.mark.st_link("pty")

@pytest.mark.parametrize("number", range(3))
def test_it(star_tracker, obc, bench, number):
    assert obc.ping() < 5
    path = Path(star_tracker.device)
    assert path.is_symlink()
    with (Path(__file__).parent / "paths.txt").open("a") as file:
        file.write(f"{path}\\n")

def test_two_on_one_bench(bench):
    a, b = bench.unit(obc=True), bench.unit(obc=True)
    assert a.device != b.device
    bench.until(lambda: a.mode == b.mode == "STANDBY")
    assert a.obc.ping() < 5 and b.obc.ping() < 5

def test_that_fails(star_tracker, obc):
    assert star_tracker.mode == "NEVER"
"""
HANGS = """
import pytest
from pathlib import Path

@pytest.mark.st_link("pty")
@pytest.mark.parametrize("number", range(2))
def test_it(star_tracker, obc, bench, number):
    star_tracker.boot()
    (Path(__file__).parent / f"hangs-{number}").touch()
    bench.run(3600)
"""


def test_two_workers_side_by_side(project: Project) -> None:
    project.write("test_it.py", LIVE)
    assert project.left() == []
    run = project.run("-q", "-n", "2")
    assert "1 failed, 4 passed" in run.last, run.text
    paths = (project.folder / "paths.txt").read_text().split()
    assert len(set(paths)) == 3, "a link of its own for each test"
    assert "active faults: none" in run.text
    assert project.left() == []


def await_(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.parametrize("workers", [0, 2])
def test_after_a_kill_all_ends_by_itself(project: Project, workers: int) -> None:
    project.write("test_it.py", HANGS)
    process = project.start("-q", *(["-n", str(workers)] if workers else []))
    hanging = max(workers, 1)
    await_(lambda: len(list(project.folder.glob("hangs-*"))) == hanging)
    left = project.left()
    assert sum(".lock" in entry for entry in left) == hanging
    assert sum("unit_server" in entry for entry in left) == 2 * hanging, (
        "servers and the units forked from them"
    )
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    await_(lambda: project.left() == [])


TOLD = """
import os, signal
import pytest
from pathlib import Path
WANTED = os.environ["WANTED"]

@pytest.mark.parametrize("number", range(2))
@pytest.mark.st_link(f"pty:{WANTED}")
def test_one_link_is_used_again_and_again(star_tracker, number):
    assert star_tracker.device == WANTED

@pytest.mark.st_link("pty:/nosuch/folder/x")
def test_no_link(star_tracker):
    pass

@pytest.mark.st_link("pty")
def test_that_dies(star_tracker, bench):
    os.kill(star_tracker.process.pid, signal.SIGKILL)
    bench.run(60)
"""


def test_links_that_cannot_be_and_units_that_die_are_told(project: Project) -> None:
    project.write("test_it.py", TOLD)
    run = project.run("-q", WANTED=str(project.runtime / "tracker"))
    assert "1 failed, 2 passed, 1 error" in run.last, run.text
    assert "the folder /nosuch/folder does not exist" in run.text
    assert "UnitDiedError: the unit has ended" in run.text
    assert "mode: no mode (the unit has ended" in run.text
    assert project.left() == []
