"""The first run of all: kernels are compiled by a child, so that the unit's process stays small."""

import subprocess

import pytest

from st_emulator.commands import warm_up
from st_emulator.units.profile import load_unit


@pytest.fixture
def child_runs(monkeypatch):
    runs = []
    monkeypatch.setattr(warm_up.subprocess, "run", lambda command, **how: runs.append((command, how)))
    return runs


def test_without_compiled_kernels_a_child_compiles_them(monkeypatch, tmp_path, child_runs):
    monkeypatch.setattr(warm_up, "keep_compiled_kernels", lambda: tmp_path)
    warm_up.compile_apart(load_unit("roja1"))
    [(command, how)] = child_runs
    # With the kernels that the tests have compiled already, what the child is told to do takes seconds.
    monkeypatch.undo()
    done = subprocess.run(command, **how | {"stderr": subprocess.PIPE})
    assert done.returncode == 0, done.stderr


def test_with_compiled_kernels_no_child_is_started(child_runs):
    warm_up.warm_up(load_unit("roja1"))
    warm_up.compile_apart(load_unit("roja1"))
    assert child_runs == []
