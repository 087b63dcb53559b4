"""Hand-made processors and skies, a folder of state that is the test's own, and the command line."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rich.console import Console

from st_emulator import cli
from st_emulator.budget.samples import NAMES
from st_emulator.campaigns.workers import Progress, Workers
from st_emulator.firmware_model.cycle_table import Coefficient, CycleTable, MemoryTiming
from st_emulator.firmware_model.processor import ProcessorProfile
from st_emulator.firmware_model.work import COUNTS
from st_emulator.units.profile import UnitProfile, load_unit


@dataclass(frozen=True)
class Outcome:
    """What a command left."""

    status: int
    out: str
    err: str


@pytest.fixture(autouse=True)
def own_state_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """Runs `st-emulator budget` with arguments in this process."""

    def run(*arguments: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["st-emulator", "budget", *map(str, arguments)])
        capsys.readouterr()
        try:
            cli.main()
            status = 0
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else int(end.code is not None)
        out, err = capsys.readouterr()
        return Outcome(status, out, err)

    return run


@pytest.fixture(scope="session")
def roja1() -> UnitProfile:
    return load_unit("roja1")


@pytest.fixture
def one_process() -> Workers:
    return Workers(1, Progress(Console(quiet=True), "test"))


def hand_made(
    clock_hz: int = 100_000_000,
    *,
    core: float = 1.0,
    fills: float = 0.0,
    core_uncertainty: float = 0.0,
    fill_ns: tuple[float, float, float] = (60.0, 120.0, 180.0),
    special: dict[str, float] | None = None,
) -> ProcessorProfile:
    """A processor where one of every count takes ``core`` cycles (but of those in ``special``) and ``fills``
    line fills."""
    coefficients = {
        name: Coefficient((special or {}).get(name, core), {32: fills}, "assumed", "test") for name in COUNTS
    }
    timing = MemoryTiming(dict(zip(("low", "nominal", "high"), fill_ns, strict=True)))
    table = CycleTable("hand made", clock_hz, coefficients, timing, core_uncertainty)
    return ProcessorProfile(table)


def counts(**numbers: int) -> NDArray[np.int64]:
    """Counts of work in the order of the samples'."""
    assert set(numbers) <= set(NAMES)
    return np.array([numbers.get(name, 0) for name in NAMES], np.int64)
