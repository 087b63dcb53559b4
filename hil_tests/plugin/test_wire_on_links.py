"""The tests of hil_tests/wire unchanged on other links: by ISO-TP, on a pty, on what stands for hardware."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from hil_tests.cli.live import LiveUnit

from .conftest import TIMEOUT_S, Project

ROOT = Path(__file__).parents[2]


def wire(project: Project, *arguments: str) -> str:
    """What a run of them says last; it must have passed."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "hil_tests/wire", *arguments]
    run = subprocess.run(
        command,
        cwd=ROOT,
        env=project.environment,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        stdin=subprocess.DEVNULL,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout


def test_by_iso_tp(project: Project) -> None:
    said = wire(project, "--st-link", "memory:can", "-k", "verification or parameters or cyclic")
    assert "left out" not in said


def test_on_a_pty(project: Project) -> None:
    chosen = "frame_start or gap or kept_through_a_reset or power_comes_back or turned_off"
    said = wire(project, "--st-link", "pty:", "-k", chosen)
    assert "6 passed" in said
    assert project.left() == []


def test_on_a_unit_that_is_there(project: Project) -> None:
    device = project.runtime / "hardware"
    with LiveUnit("roja1", "--link", f"pty:{device}", "--store", "none") as unit:
        unit.await_running()
        chosen = "frame_start or gap or kept_through_a_reset or power_comes_back or true or heart"
        said = wire(project, "--st-link", f"serial:{device}", "-k", chosen)
        unit.stop(15)
    assert "4 passed, 3 skipped" in said
    assert "3 tests left out: need a CAN bus (1), a power switch (1), a truth (1)" in said
