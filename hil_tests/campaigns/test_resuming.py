"""A campaign that is stopped, however rudely, goes on with the same command and gives the same figures."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import matplotlib.image
import pytest

COMMAND = (sys.executable, "-m", "st_emulator", "campaign", "false-stars", "--n", "40", "--seed", "9")


def campaign(folder: Path, *more: str) -> subprocess.Popen:
    environment = os.environ | {"XDG_STATE_HOME": str(folder / "state"), "COLUMNS": "100"}
    return subprocess.Popen(
        [*COMMAND, *more],
        env=environment,
        cwd=folder,
        start_new_session=True,
        stderr=subprocess.PIPE,
        text=True,
    )


def kept(folder: Path) -> list[Path]:
    return list((folder / "state/st-emulator/campaigns").glob("*.jsonl"))


def figures(path: Path) -> str:
    """The JSON's bytes but for what a clock measured."""
    contents = json.loads(path.read_text())
    for name in ("timing", "elapsed_s"):
        del contents[name]
    return json.dumps(contents)


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory) -> str:
    folder = tmp_path_factory.mktemp("whole")
    process = campaign(folder, "--json", "whole.json", "--workers", "1")
    said = process.communicate(timeout=900)[1]
    assert process.returncode in (0, 1), said
    assert kept(folder) == []  # it is through
    return figures(folder / "whole.json")


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_stopped_campaign_goes_on(uninterrupted, tmp_path, how):
    stops = 0
    for _ in range(2):
        before = sum(path.stat().st_size for path in kept(tmp_path))
        process = campaign(tmp_path, "--workers", "2", "--json", "out.json")
        try:
            end = time.monotonic() + 600
            while process.poll() is None and sum(path.stat().st_size for path in kept(tmp_path)) <= before:
                assert time.monotonic() < end, "no outcome was kept"
                time.sleep(0.02)
            stops += process.poll() is None
            os.killpg(process.pid, how)
            said = process.communicate(timeout=60)[1]
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
        if how is signal.SIGINT:
            assert process.returncode == 130, said
            assert "Traceback" not in said
        assert len(kept(tmp_path)) == 1
    assert stops == 2  # it was stopped in its midst
    process = campaign(tmp_path, "--workers", "2", "--json", "out.json", "--plot", "out.png")
    assert process.wait(timeout=900) in (0, 1)
    assert figures(tmp_path / "out.json") == uninterrupted
    assert kept(tmp_path) == []
    assert matplotlib.image.imread(tmp_path / "out.png").shape[:2] > (500, 1000)


def test_a_named_file_is_gone_on_with_and_stays(tmp_path):
    arguments = ("--n", "1", "--results", "kept.jsonl")
    for number in range(2):
        process = campaign(tmp_path, *arguments, "--json", f"{number}.json")
        assert process.wait(timeout=900) in (0, 1)
    first, second = (json.loads((tmp_path / f"{number}.json").read_text()) for number in range(2))
    del first["elapsed_s"], second["elapsed_s"]
    assert first == second  # the times measured as well: nothing ran again
    process = campaign(tmp_path, "--n", "2", "--results", "kept.jsonl")
    assert "kept.jsonl: holds another campaign's outcomes: n differ" in process.communicate(timeout=900)[1]
    assert process.returncode == 2
