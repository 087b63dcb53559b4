"""Workers that say nothing, and a folder of state that is the test's own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from rich.console import Console

from st_emulator.campaigns.results_file import ResultsFile
from st_emulator.campaigns.workers import Progress, Workers

IDENTITY = {"campaign": "squares", "seed": 1}


@pytest.fixture(autouse=True)
def own_state_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No test reads or writes the outcomes that the user who runs it has kept."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def workers() -> Iterator[Callable[..., Workers]]:
    """Makes workers with a quiet progress bar."""
    with Progress(Console(quiet=True), "test") as progress:
        yield lambda count=1, **more: Workers(count, progress, **more)


@pytest.fixture
def results(tmp_path: Path) -> Callable[..., ResultsFile]:
    """Opens the test's file of outcomes, anew each time."""
    return lambda identity=IDENTITY, named=True, **more: ResultsFile(
        tmp_path / "outcomes.jsonl", identity, named=named, **more
    )
