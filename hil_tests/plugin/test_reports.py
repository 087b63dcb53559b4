"""What a failed test tells, and how what was left out is counted."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from rich.console import Console

from st_emulator.commands.replaying import replay_journal

from .conftest import Project

FAILS = """
import pytest

@pytest.mark.st_fault("line.bits_flipped", probability=1e-9)
def test_it(star_tracker, obc, bench):
    obc.ping()
    bench.within(2, lambda: star_tracker.mode == "TRACKING")

def test_never(star_tracker, bench):
    bench.never(lambda: star_tracker.mode == "STANDBY", for_s=3)

def test_until(star_tracker, bench):
    def it_sings():
        return False
    bench.until(it_sings, limit_s=2)

def test_passes(star_tracker, bench):
    assert bench.within(1, lambda: star_tracker.mode == "STANDBY") == 0.4
    assert bench.until(lambda: "value") == "value"
"""


def test_a_failed_test_tells_of_its_unit(project: Project) -> None:
    project.write("test_it.py", FAILS)
    run = project.run("-q", "--st-link", "memory")
    assert run.status == 1
    assert "3 failed, 1 passed" in run.last
    assert 'not within 2 s: star_tracker.mode == "TRACKING"' in run.text
    assert re.search(r"looked from 0\.4\d\d s to 2\.4\d\d s; roja1 is in STANDBY", run.text)
    assert 'after 0.400000 s, which must never be within 3 s: star_tracker.mode == "STANDBY"' in run.text
    assert "waited 2 s in vain: it_sings" in run.text
    first = run.text[: run.text.index("def test_never")]
    (section,) = re.findall(r"- star tracker roja1 -+\n(link.*?)\n[-_=]{5}", first, re.S)
    lines = section.splitlines()
    assert lines[:2] == ["link: memory", "mode: STANDBY"]
    assert lines[2] == "active faults: 0 line.bits_flipped (probability=1e-09)"
    assert "event (info) BOOT_COMPLETED boot_count=1 reset_cause=POWER_ON" in section
    assert re.search(r"0\.40\d{4}  acceptance_success of telecommand 0", section)
    assert re.search(r"1\.40\d{4}  hk_report STATUS mode=2", section)
    journal = Path(lines[-1].removeprefix("journal: "))
    assert journal.is_file()
    assert run.text.count("- star tracker roja1 -") == 3, "of the test that passed nothing is told"


def test_the_journal_lies_where_it_is_asked_for_and_is_a_run(project: Project, tmp_path: Path) -> None:
    project.write(
        "test_it.py",
        "def test_it(star_tracker, obc, bench):\n"
        "    obc.ping()\n    star_tracker.power_off()\n    bench.run(1)\n"
        "    star_tracker.power_on()\n    star_tracker.faults.inject('line.frames_lost', duration_s=2)\n"
        "    bench.run(4)\n    obc.ping()\n",
    )
    folder = tmp_path / "journals"
    assert project.run("-q", "--st-journal", str(folder)).status == 0
    (journal,) = folder.iterdir()
    assert journal.name == "test_it.py-test_it.journal.jsonl"
    text = journal.read_text()
    assert text.count('"power"') == 2
    assert '"inject"' in text
    assert replay_journal(journal, None, None, Console(quiet=True)) == 0


HARDWARE = """
import pytest

def test_plain(star_tracker, obc):
    assert obc.ping() < 1
    assert star_tracker.mode == "STANDBY"

def test_truth(star_tracker, truth):
    pass

def test_truth_found_out_on_the_way(star_tracker, obc):
    star_tracker.truth()

@pytest.mark.st_fault("line.frames_lost")
def test_fault(star_tracker):
    pass

@pytest.mark.st_scenario(seed=3)
def test_scenario(star_tracker):
    pass

@pytest.mark.st_link("can")
def test_bus(star_tracker):
    pass

@pytest.mark.st_link("pty")
def test_line(star_tracker):
    assert star_tracker.device.endswith("hardware")

def test_power(star_tracker):
    star_tracker.power_off()
"""


def test_on_hardware_what_it_cannot_do_is_left_out_and_counted(project: Project) -> None:
    """A serial port with a unit on it: here a pseudo-terminal that another process's unit made."""
    from hil_tests.cli.live import LiveUnit

    project.write("test_it.py", HARDWARE)
    device = project.runtime / "hardware"
    with LiveUnit("roja1", "--link", f"pty:{device}", "--store", "none") as unit:
        unit.await_running()
        run = project.run("-q", "--st-link", f"serial:{device}")
        unit.stop(15)
    assert run.status == 0, run.text
    assert "2 passed, 6 skipped" in run.last
    assert (
        "6 tests left out: need a CAN bus (1), a fault (1), a power switch (1), a scenario (1), a truth (2)"
        in run.text
    )


@pytest.mark.parametrize(
    ("chosen", "line"),
    [
        ("test_truth", "1 test left out: needs a truth"),
        ("test_truth or test_too", "2 tests left out: need a truth"),
    ],
)
def test_the_line_that_counts(project: Project, chosen: str, line: str) -> None:
    project.write("test_it.py", "def test_truth(truth):\n    pass\ndef test_too(truth):\n    pass\n")
    assert line in project.run("-q", "--st-link", "serial:/dev/null", "-k", chosen).text
    if " or " in chosen:
        assert line in project.run("-q", "--st-link", "serial:/dev/null", "-n", "2").text
