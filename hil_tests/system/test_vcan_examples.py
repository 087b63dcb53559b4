"""What the README shows on vcan0, run as it stands there."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.vcan, pytest.mark.slow]

ROOT = Path(__file__).parents[2]
TIMEOUT_S = 300.0  # only bounds a hang


def test_the_integration_test_in_ten_lines() -> None:
    example = ROOT / "examples/test_on_vcan.py"
    subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(example)],
        check=True, timeout=TIMEOUT_S, stdin=subprocess.DEVNULL,
    )  # fmt: skip


def test_the_readme_shows_the_example() -> None:
    text = (ROOT / "examples/test_on_vcan.py").read_text(encoding="utf-8")
    shown = text[text.index("LINK =") :]
    assert shown in (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("unit", ["roja1", "zy3"])
def test_the_demo_holds_on_a_can_bus_as_on_the_line(unit: str, tmp_path: Path) -> None:
    result = tmp_path / "result.json"
    subprocess.run(
        [
            sys.executable, "-m", "st_emulator", "demo", "--unit", unit, "--link", "can:socketcan/vcan0",
            "--seconds", "14", "--out", str(tmp_path / "out"), "--json", str(result),
        ],
        check=False, timeout=TIMEOUT_S, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    # Its own checks are of time, too: those depend on what else the computer does.
    figures = json.loads(result.read_text(encoding="utf-8"))
    assert figures["crc_errors"] == figures["malformed"] == figures["sequence_gaps"] == 0
    assert figures["telecommands_verified"] == figures["telecommands_sent"] == 7
    assert figures["tracking_share"] > 0.9
    assert (tmp_path / "out/telemetry/can.log").stat().st_size > 10_000
