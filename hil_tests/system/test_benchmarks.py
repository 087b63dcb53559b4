"""No part of tools/bench breaks unseen: each runs once, in its shortest form. Figures are not judged here."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from hil_tests.architecture.source_tree import ROOT

BENCHMARKS = ROOT / "tools" / "benchmarks"
STAGES = {"render", "detect", "identify", "attitude", "firmware_rest", "packet", "rest"}


def run(*arguments: str) -> str:
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, timeout=600, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("search", ["lost_in_space", "tracking", "tracking_turning"])
def test_speed_with_its_stages(search: str) -> None:
    script = str(BENCHMARKS / "throughput.py")
    text = run(script, "roja1", search, "--rounds", "1", "--frames", "20", "--stages")
    (result,) = [json.loads(line) for line in text.splitlines()]
    assert result["frames"] >= 20
    assert result["valid"] >= 16
    spent = result["stages_ms"]
    assert set(spent) == STAGES
    for stage in STAGES - {"rest"}:
        assert spent[stage] > 0, f"{stage} was never called: it was moved away under the stopwatch"


SHORT = """
import json, sys
sys.path.insert(0, {folder!r})
import {module}
print(json.dumps({call}))
"""


def measured(module: str, call: str) -> dict[str, object]:
    text = run("-c", SHORT.format(folder=str(BENCHMARKS), module=module, call=call))
    found = json.loads(text.splitlines()[-1])
    assert isinstance(found, dict)
    return found


def test_real_time() -> None:
    found = measured("real_time", 'real_time.measure("roja1", 2.0, lambda: None)')
    assert found["frames"]


def test_start() -> None:
    found = measured("starting", '{"seconds": starting.warm_start_s("roja1")}')
    assert float(str(found["seconds"])) > 0


def test_can_image() -> None:
    found = measured("can_image", 'can_image.measure("roja1")')
    assert found["image_bytes"] == 23 + 2 * 752 * 480


@pytest.mark.vcan
@pytest.mark.slow
def test_can_on_vcan0() -> None:
    found = measured("vcan", 'vcan.measure("roja1", 3.0, lambda: None)')
    assert found["frames"]


@pytest.mark.slow
def test_the_command_itself(tmp_path: Path) -> None:
    """Its options, its checks and its JSON, over the part that takes least."""
    report = tmp_path / "bench.json"
    options = ("--quick", "--only", "start", "--unit", "roja1", "--json", str(report))
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS), *options], capture_output=True, text=True, timeout=600, cwd=ROOT
    )
    assert done.returncode in (0, 1), done.stderr
    (check,) = json.loads(report.read_text())["checks"]
    assert check["name"].endswith("start_s")
