"""The example in which Basilisk, which is not ours, points a spacecraft by the telemetry of a unit."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).parents[2]
EXAMPLE = "examples/basilisk_closed_loop.py"
FLIGHT = ("--unit", "zy3", "--seconds", "240")  # its larger rate takes it home in half the time of roja1


def start(*arguments: str | Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, EXAMPLE, *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
def test_the_loop_closes_and_the_same_twice(tmp_path: Path) -> None:
    picture = tmp_path / "flight.png"
    flights = [start(*FLIGHT, "--json", "-", "--plot", picture), start(*FLIGHT, "--json", "-")]
    told = []
    for flight in flights:
        out, err = flight.communicate(timeout=600)
        assert flight.returncode == 0, err
        told.append(json.loads(out))
    one, other = told
    assert one == other
    assert len(one["telemetry_sha256"]) == 64
    assert one["start_off_deg"] == pytest.approx(30.0)
    assert one["cross_boresight_rms_arcsec"] <= 1.67  # Z table 1: 5 arcsec (3 sigma)
    assert 0.5 < one["largest_rate_deg_s"] <= 1.0
    assert one["valid_reports"] > 940
    assert all(check["holds"] for check in one["checks"])
    with Image.open(picture) as image:
        assert image.size[0] > 800


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--seconds", "5"), "--seconds"),
        (("--off-deg", "0"), "--off-deg"),
        (("--unit", "nounit"), "nounit"),
    ],
)
def test_what_it_cannot_fly_is_told(arguments: tuple[str, ...], said: str) -> None:
    flight = start(*arguments)
    _, err = flight.communicate(timeout=120)
    assert flight.returncode == 2
    assert said in err
    assert len(err.strip().splitlines()) == 1
