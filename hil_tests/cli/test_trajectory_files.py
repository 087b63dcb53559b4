"""Scenarios whose trajectory is a file: run, replayed without the file, refused when it is wrong."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hil_tests.world.test_attitude_files import AEM_1
from st_emulator.world.quaternion import quaternion_from_pointing

SCENARIO = """
start_utc = 2026-01-15T00:00:00Z
[parameters]
autonomous_start = 1
[trajectory]
kind = "file"
path = "sky/attitude.{suffix}"
{more}
"""


def put(folder: Path, text: str, suffix: str = "csv", more: str = "") -> Path:
    (folder / "sky").mkdir()
    (folder / "sky" / f"attitude.{suffix}").write_text(text)
    path = folder / "scenario.toml"
    path.write_text(SCENARIO.format(suffix=suffix, more=more))
    return path


def csv_text() -> str:
    """A slow turn in right ascension over 6 s."""
    rows = ["t_s,q_x,q_y,q_z,q_w"]
    for t in range(7):
        rows.append(",".join(repr(float(x)) for x in (t, *quaternion_from_pointing(83 + 0.1 * t, -3, 0))))
    return "\n".join(rows)


def test_a_file_trajectory_is_run_to_its_end_and_replayed_without_the_file(command, tmp_path):
    scenario = put(tmp_path, csv_text())
    journal, truth = tmp_path / "j.jsonl", tmp_path / "t.jsonl"
    run = command(
        *("run", "roja1", "--scenario", scenario, "--speed", "max", "--journal", journal, "--truth", truth)
    )
    assert run.status == 0, run.err
    assert "stopped at 6.000 s" in run.err
    lines = [json.loads(line) for line in truth.read_text().splitlines()]
    assert lines[-1]["exposure_end_ns"] <= 6_000_000_000
    for line in lines:
        assert line["ra_deg"] == pytest.approx(83 + 0.1e-9 * line["exposure_mid_ns"], abs=1e-6)
        assert line["rate_rad_s"] == pytest.approx(
            [0, -np.radians(0.1) * np.cos(np.radians(3)), -np.radians(0.1) * np.sin(np.radians(3))], abs=1e-6
        ) or np.linalg.norm(line["rate_rad_s"]) == pytest.approx(np.radians(0.1), rel=1e-5)
    (tmp_path / "sky" / "attitude.csv").unlink()
    again = command("replay", journal)
    assert again.status == 0, again.err


def test_an_aem_is_run(command, tmp_path):
    pytest.importorskip("ccsds_ndm")
    scenario = put(tmp_path, AEM_1, "aem")
    run = command("run", "roja1", "--scenario", scenario, "--speed", "max", "--seconds", "2")
    assert run.status == 0, run.err


@pytest.mark.parametrize(
    ("text", "more", "says"),
    [
        ("t_s,q_x,q_y,q_z,q_w\n0,0,0,0,1\n5,0,0,x,1", "", ("attitude.csv (csv): line 3: q_z: found 'x'",)),
        ("t_s,q_x,q_y,q_z,q_w\n0,0,0,0,1", "", ("1 attitudes; allowed are 2",)),
        ("t_s,q_x,q_y,q_z,q_w\n3,0,0,0,1\n9,0,0,0,1", "", ("reaches from 3 s to 9 s", "start_utc")),
        ("utc,q_x,q_y,q_z,q_w\n2020-01-01T00:00:00Z,0,0,0,1\n2020-01-01T01:00:00Z,0,0,0,1", "", ("reaches",)),
        ("", "", ("an empty file",)),
        ("x", 'format = "aem"', ("(aem): no AEM that can be read",)),
        ("x", 'format = "oem"', ("trajectory.format", "'aem', 'csv'")),
        ("x", "q_body_to_sensor = [0, 0, 0, 0]", ("not all zero",)),
        ("x", "q_body_to_sensor = [0, 0, 0]", ("trajectory.q_body_to_sensor",)),
    ],
)
def test_a_wrong_file_is_one_line(refused, tmp_path, text, more, says):
    scenario = put(tmp_path, text, more=more)
    refused("run", "roja1", "--scenario", scenario, "--speed", "max", says=(str(scenario), *says))


def test_a_file_that_is_not_there_or_no_text(refused, tmp_path):
    scenario = put(tmp_path, "x")
    (tmp_path / "sky" / "attitude.csv").unlink()
    refused("run", "roja1", "--scenario", scenario, "--speed", "max", says=("attitude.csv", "No such file"))
    (tmp_path / "sky" / "attitude.csv").write_bytes(b"\xff\xfe\x00")
    refused(
        "run", "roja1", "--scenario", scenario, "--speed", "max", says=("attitude.csv", "not a text file")
    )


def test_a_run_that_is_to_last_longer_than_its_truth_is_refused(refused, tmp_path):
    scenario = put(tmp_path, csv_text())
    refused(
        *("run", "roja1", "--scenario", scenario, "--speed", "max", "--seconds", "7"),
        says=("to last 7 s", "file 6 s"),
    )


POINTING = "kind = '{kind}'\naltitude_km = 500\ninclination_deg = 97\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (POINTING.format(kind="target"), ("latitude_deg and longitude_deg", "hip")),
        (POINTING.format(kind="target") + "ra_deg = 5", ("needs one of",)),
        (POINTING.format(kind="target") + "ra_deg = 5\ndec_deg = 1\nhip = 3", ("needs one of",)),
        (POINTING.format(kind="target") + "latitude_deg = 91\nlongitude_deg = 1", ("latitude_deg", "to 90")),
        (POINTING.format(kind="target") + "hip = 421", ("hip = 421", "no star")),
        (POINTING.format(kind="nadir") + "boresight = [0, 0, 0]", ("boresight", "not all zero")),
        (POINTING.format(kind="sun") + "ra_deg = 5", ("trajectory.ra_deg", "not a known key", "boresight")),
        (
            "kind = 'detumble'\nra_deg = 1\ndec_deg = 1\nrate_deg_s = [1, 2, 3]",
            ("time_constant_s", "missing"),
        ),
    ],
)
def test_wrong_pointings_are_one_line(refused, tmp_path, text, says):
    scenario = tmp_path / "scenario.toml"
    scenario.write_text("[trajectory]\n" + text)
    refused("run", "roja1", "--scenario", scenario, "--speed", "max", "--seconds", "1", says=says)
