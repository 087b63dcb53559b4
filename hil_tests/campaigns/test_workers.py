"""Cases over processes: order, kept outcomes, workers that fail or die."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from hil_tests.campaigns import cases
from hil_tests.campaigns.conftest import IDENTITY
from st_emulator.campaigns.workers import CaseError
from st_emulator.errors import ConfigurationError

SQUARES = [index * index for index in range(40)]


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("batch", [1, 7, 100])
def test_outcomes_in_the_order_of_the_cases(workers, count, batch):
    assert workers(count).map(cases.square, range(40), batch=batch) == SQUARES


def test_no_case_at_all(workers):
    assert workers(2).map(cases.square, []) == []


def test_cases_run_in_several_processes(workers):
    found = set(workers(2).map(cases.process_number, range(12)))
    assert len(found) == 2
    assert os.getpid() not in found


@pytest.mark.parametrize("count", [1, 2])
def test_a_stopped_run_goes_on(workers, results, count):
    file = results()
    with pytest.raises(CaseError):
        workers(count, results=file).map(partial(cases.always_fails, 33), range(40), batch=4)
    there = results().kept(0)
    assert 4 <= len(there) < 40
    assert 33 not in there
    second = workers(count, results=results())
    assert second.map(cases.square, range(40), batch=3) == SQUARES
    assert second.resumed == len(there)
    third = workers(count, results=results())
    assert third.map(cases.refuses, range(40)) == SQUARES  # nothing is left to run
    assert third.resumed == 40


def test_stages_are_kept_apart(workers, results):
    first = workers(1, results=results())
    assert first.map(cases.square, range(5)) == SQUARES[:5]
    assert first.map(partial(cases.slow_square, 0.0), range(7)) == SQUARES[:7]
    again = workers(1, results=results())
    assert again.map(cases.refuses, range(5)) == SQUARES[:5]
    assert again.map(cases.refuses, range(7)) == SQUARES[:7]


def test_workers_that_die_lose_nothing(workers, results, tmp_path):
    marks = tmp_path / "marks"
    marks.mkdir()
    function = partial(cases.dies_once, str(marks), (3, 17, 18, 39))
    assert workers(2, results=results()).map(function, range(40), batch=5) == SQUARES
    assert {path.name for path in marks.iterdir()} == {"3", "17", "18", "39"}
    assert results().kept(0) == dict(enumerate(SQUARES))


def test_a_case_that_always_ends_its_worker_is_named(workers, results):
    with pytest.raises(CaseError, match=r"case 11 \(11\): its worker died"):
        workers(2, results=results()).map(partial(cases.always_dies, 11), range(40), batch=8)
    there = results().kept(0)
    assert 11 not in there
    assert all(there[index] == SQUARES[index] for index in there)


@pytest.mark.parametrize("count", [1, 2])
def test_cases_that_fail_run_again(workers, tmp_path, count):
    assert workers(count).map(partial(cases.fails_once, str(tmp_path)), range(40), batch=6) == SQUARES


@pytest.mark.parametrize("count", [1, 2])
def test_a_case_that_always_fails_is_named(workers, count):
    says = r"case 23 \(23\) failed 3 times: ArithmeticError: no such square \(cases.py, line \d+\)"
    with pytest.raises(CaseError, match=says):
        workers(count).map(partial(cases.always_fails, 23), range(40), batch=6)


@pytest.mark.parametrize("count", [1, 2])
def test_what_the_user_can_mend_is_told_at_once(workers, count):
    with pytest.raises(ConfigurationError, match=r"^the unit is none for this; allowed are others$"):
        workers(count).map(cases.refuses, range(40))


PROGRAM = """
import sys
from functools import partial
from pathlib import Path
from rich.console import Console
from hil_tests.campaigns import cases
from hil_tests.campaigns.conftest import IDENTITY
from st_emulator.campaigns.results_file import ResultsFile
from st_emulator.campaigns.workers import Progress, Workers
if __name__ == "__main__":
    with Progress(Console(quiet=True), "test") as progress:
        results = ResultsFile(Path(sys.argv[1]), IDENTITY, named=True)
        Workers(2, progress, results=results).map(partial(cases.slow_square, 0.05), range(4000))
"""


def children_of(process: int) -> list[int]:
    """Descendants of a process, by /proc."""
    parents = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if fields[0] != "Z":
            parents[int(folder.name)] = int(fields[1])
    found = [process]
    for known in found:
        found += [child for child, parent in parents.items() if parent == known]
    return found[1:]


def wait_until(condition, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.05)


def test_a_killed_run_leaves_its_outcomes_and_no_process(workers, results, tmp_path):
    script = tmp_path / "program.py"
    script.write_text(PROGRAM)
    path = results().path
    root = Path(__file__).parents[2]
    process = subprocess.Popen(
        [sys.executable, str(script), str(path)], env=os.environ | {"PYTHONPATH": str(root)}
    )
    try:
        wait_until(lambda: path.exists() and len(path.read_text().splitlines()) > 10)
        below = children_of(process.pid)
        assert len(below) >= 3  # the fork server, two workers
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    wait_until(lambda: all(is_gone(item) for item in below))
    there = results(IDENTITY).kept(0)
    assert 10 <= len(there) < 4000
    assert all(there[index] == index * index for index in there)


def is_gone(process: int) -> bool:
    try:
        return (Path("/proc") / str(process) / "stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True
