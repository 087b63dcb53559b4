"""`st-emulator demo`: its figures from synthetic sessions, an emulator that dies, and one real run whose
figures are computed a second time from the raw bytes."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from hil_tests.vectors import reference_decoder
from st_emulator.bench.scenario import parse_scenario
from st_emulator.commands import demo
from st_emulator.commands.demo import Session, demo_scenario, evaluate, read_truth, run_demo
from st_emulator.obc import Attitude
from st_emulator.protocol.pus.enumerations import Mode, Reason
from st_emulator.units.profile import load_unit

ROJA1 = load_unit("roja1")
ARCSEC = math.pi / 180 / 3600
PROMISED_KEYS = {
    *("unit", "seconds", "frames", "frames_tracking", "lost_in_space_s", "cross_boresight_arcsec_rms"),
    *("roll_arcsec_rms", "telemetry_packets", "crc_errors", "telecommands_sent", "telecommands_verified"),
    *("overruns", "checks"),
}


# -- figures of a session made by hand


def turned(x_arcsec: float, y_arcsec: float, z_arcsec: float) -> np.ndarray:
    """A small rotation from the attitude (0, 0, 0, 1)."""
    half = np.array([x_arcsec, y_arcsec, z_arcsec]) * ARCSEC / 2
    return np.array([*half, math.sqrt(1 - half @ half)])


def attitude(index: int, error: tuple[float, float, float], mode: Mode = Mode.TRACKING) -> Attitude:
    fields = {name: 0 for name in Attitude.__dataclass_fields__}
    valid = mode in (Mode.TRACKING, Mode.LOST_IN_SPACE)
    return Attitude(
        **fields
        | {
            "frame_index": index,
            "received_ns": (index + 1) * 250_000_000,
            "mode": mode,
            "valid": valid,
            "reasons": Reason(0),
            "late": False,
            "q_icrs_to_sensor": turned(*error),
        }
    )


def truth(frames: int, moving: tuple[int, ...] = ()) -> dict:
    return {
        index: {
            "frame_index": index,
            "exposure_mid_ns": index * 250_000_000 + 50_000_000,
            "q_icrs_to_sensor": [0.0, 0.0, 0.0, 1.0],
            "rate_rad_s": [1e-3 if index in moving else 0.0, 0.0, 0.0],
        }
        for index in range(frames)
    }


ERRORS = [(0.3, -0.1, 4.0), (-0.2, 0.4, -3.0), (0.1, 0.1, 2.0), (9.0, 9.0, 90.0), (0.5, -0.6, 1.0)]


def session(**changes: object) -> Session:
    modes = [Mode.LOST_IN_SPACE] + [Mode.TRACKING] * 4
    attitudes = [attitude(n, error, mode) for n, (error, mode) in enumerate(zip(ERRORS, modes, strict=True))]
    made = Session(sent=7, verified=7, acquire_ns=0, packets=50, attitudes=attitudes)
    return replace(made, **changes)


def failing(checks: list) -> set[str]:
    return {check.name for check in checks if not check.holds}


def test_figures_of_a_session():
    figures, checks, series = evaluate(ROJA1, 12, session(), truth(5, moving=(3,)))
    rest = np.array([ERRORS[n] for n in (0, 1, 2, 4)])  # frame 3 was moving
    assert figures["frames"] == 5
    assert figures["frames_tracking"] == 4
    assert figures["frames_inertial"] == 4
    assert figures["tracking_share"] == 1.0
    assert figures["lost_in_space_s"] == 0.25
    expected = math.sqrt((np.mean(rest[:, 0] ** 2) + np.mean(rest[:, 1] ** 2)) / 2)
    assert figures["cross_boresight_arcsec_rms"] == pytest.approx(expected, rel=1e-6)
    assert figures["roll_arcsec_rms"] == pytest.approx(math.sqrt(np.mean(rest[:, 2] ** 2)), rel=1e-6)
    assert failing(checks) == set()
    assert set(figures) >= PROMISED_KEYS - {"checks"}
    assert series.at_rest.tolist() == [True, True, True, False, True]


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"crc_errors": 1}, {"crc_errors"}),
        ({"gaps": 2}, {"sequence_gaps"}),
        ({"verified": 6}, {"telecommands_verified"}),
        ({"acquire_ns": -2_000_000_000}, {"lost_in_space_s"}),
    ],
)
def test_each_check_can_fail(changes, named):
    _, checks, _ = evaluate(ROJA1, 12, session(**changes), truth(5, moving=(3,)))
    assert failing(checks) == named


def test_a_late_frame_is_an_overrun():
    made = session()
    made.attitudes[2] = replace(made.attitudes[2], late=True)
    figures, checks, _ = evaluate(ROJA1, 12, made, truth(5, moving=(3,)))
    assert figures["overruns"] == 1
    assert failing(checks) == {"overruns"}


def test_frames_without_a_report_count_as_not_tracked():
    made = session()
    del made.attitudes[2]
    figures, checks, _ = evaluate(ROJA1, 12, made, truth(5, moving=(3,)))
    assert figures["tracking_share"] == 0.75
    assert failing(checks) == {"tracking_share"}


def test_too_large_errors_fall_short_of_the_units_requirement():
    _, checks, _ = evaluate(ROJA1, 12, session(), truth(5))  # frame 3 counts now
    assert failing(checks) == {"cross_boresight_arcsec_rms"}


def test_a_session_without_attitudes_holds_nothing_but_is_told():
    figures, checks, _ = evaluate(ROJA1, 12, Session(problem="x"), {})
    assert figures["frames"] == 0
    assert figures["cross_boresight_arcsec_rms"] is None
    assert failing(checks) == {"lost_in_space_s", "tracking_share", "cross_boresight_arcsec_rms"}


def test_truth_that_is_cut_short_or_absent(tmp_path):
    path = tmp_path / "truth.jsonl"
    assert read_truth(path) == {}
    path.write_text("".join(json.dumps(record) + "\n" for record in truth(3).values())[:-20])
    assert list(read_truth(path)) == [0, 1]


@pytest.mark.parametrize("unit", ["roja1", "zy3", "science_cam", "aps_rs"])
@pytest.mark.parametrize("seconds", [12.0, 30.0, 3600.0])
def test_scenario_is_valid_and_turns_below_the_units_rate(unit, seconds):
    from st_emulator.bench.world_of import trajectory_of

    profile = load_unit(unit)
    scenario = parse_scenario(demo_scenario(profile, seconds, 3), "demo")
    assert scenario.seed == 3
    path = trajectory_of(scenario, 0)
    times_ns = (np.linspace(0, seconds, 400) * 1e9).astype(int)
    rates = np.degrees([np.linalg.norm(path.rate_sensor(int(t_ns))) for t_ns in times_ns])
    assert 0.05 * profile.tracking.rate_deg_s < rates.max() or seconds > 1000
    assert rates.max() < profile.tracking.rate_deg_s


# -- an emulator that does not do its part


@dataclass
class Said:
    text: str = ""

    def write(self, text: str) -> int:
        self.text += text
        return len(text)

    def flush(self) -> None:
        pass


def demo_with(monkeypatch: pytest.MonkeyPatch, program: str, out: Path) -> tuple[int, str]:
    """The demo with a Python program in the emulator's place; LINK is where it should appear."""
    from rich.console import Console

    start = subprocess.Popen
    text = program.replace("LINK", repr(str(out / "tracker")))

    def popen(arguments: list[str], **options: object) -> subprocess.Popen:
        assert arguments[1:4] == ["-m", "st_emulator", "run"]
        return start([sys.executable, "-c", text], **options)  # type: ignore[call-overload]

    monkeypatch.setattr(demo.subprocess, "Popen", popen)
    said = Said()
    console = Console(file=said, width=1000)  # type: ignore[arg-type]
    return run_demo("roja1", 12.0, str(out / "out.json"), out, None, console), said.text


def test_an_emulator_that_does_not_start(monkeypatch, command, tmp_path):
    from st_emulator.errors import ConfigurationError

    program = "import sys; sys.exit('st-emulator: no such thing')"
    with pytest.raises(ConfigurationError, match="did not start: st-emulator: no such thing"):
        demo_with(monkeypatch, program, tmp_path)


def test_a_link_that_never_appears(monkeypatch, tmp_path):
    from st_emulator.errors import ConfigurationError

    monkeypatch.setattr(demo, "START_TIMEOUT_S", 0.5)
    with pytest.raises(ConfigurationError, match=r"made no link .*tracker within 0\.5 s"):
        demo_with(monkeypatch, "import time; time.sleep(600)", tmp_path)


def test_a_link_left_behind_is_not_taken_for_the_emulators(monkeypatch, tmp_path):
    """A killed emulator leaves its link, and its number may be somebody else's terminal by now."""
    from st_emulator.errors import ConfigurationError

    (tmp_path / "tracker").symlink_to("/dev/null")
    monkeypatch.setattr(demo, "START_TIMEOUT_S", 0.5)
    with pytest.raises(ConfigurationError, match="made no link"):
        demo_with(monkeypatch, "import time; time.sleep(600)", tmp_path)


def test_an_emulator_that_dies_on_the_way(monkeypatch, tmp_path):
    program = """
import os, sys, time
from st_emulator.links.pty import PtyLink
link = PtyLink(LINK)
time.sleep(0.5)
link.close()
sys.exit("out of film")
"""
    (tmp_path / "truth.jsonl").write_text("of an earlier demo")
    status, said = demo_with(monkeypatch, program, tmp_path)
    assert status == 1
    assert "the emulator ended with status 1: out of film" in said
    figures = json.loads((tmp_path / "out.json").read_text())
    assert "out of film" in figures["problem"]
    assert figures["frames"] == 0
    assert figures["checks"]


def test_a_demo_that_is_stopped_leaves_no_emulator_behind(tmp_path):
    command = [sys.executable, "-m", "st_emulator", "demo", "--seconds", "3600", "--out", str(tmp_path)]
    link = tmp_path / "tracker"
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            deadline = time.monotonic() + 120
            while not link.is_symlink():
                assert process.poll() is None
                assert time.monotonic() < deadline
                time.sleep(0.05)
            process.terminate()
            assert process.wait(120) != 0
        finally:
            process.kill()
    assert not link.is_symlink()
    assert not Path(f"{link}.lock").exists()  # the emulator has let it go


def test_what_is_not_the_demos_stays(monkeypatch, tmp_path):
    (tmp_path / "telemetry").mkdir()
    mine = tmp_path / "telemetry/notes.txt"
    mine.write_text("mine")
    (tmp_path / "telemetry/telemetry.jsonl").write_text("{}")
    demo._clear(tmp_path)
    assert [path.name for path in (tmp_path / "telemetry").iterdir()] == ["notes.txt"]


# -- the real thing


@pytest.fixture(scope="module")
def real(tmp_path_factory) -> tuple[Path, dict]:
    """A demo of twelve seconds, as a user runs it."""
    out = tmp_path_factory.mktemp("demo")
    arguments = ("demo", "--seconds", "12", "--out", str(out), "--json", str(out / "out.json"))
    run = subprocess.run(
        [sys.executable, "-m", "st_emulator", *arguments],
        capture_output=True,
        text=True,
        timeout=400,
        env=os.environ | {"XDG_STATE_HOME": str(out / "state")},
    )
    assert run.returncode == 0, run.stdout + run.stderr
    return out, json.loads((out / "out.json").read_text())


@pytest.mark.slow
def test_a_real_demo_holds(real):
    out, figures = real
    assert set(figures) >= PROMISED_KEYS
    assert all(check["holds"] for check in figures["checks"])
    for check in figures["checks"]:
        assert set(check) == {"name", "value", "target", "unit", "holds"}
    assert figures["crc_errors"] == 0
    assert figures["telecommands_sent"] == figures["telecommands_verified"] >= 7
    assert figures["lost_in_space_s"] <= 2
    assert figures["problem"] is None
    assert (out / "demo.png").stat().st_size > 20_000
    assert not (out / "tracker").is_symlink()


def matrix(q: np.ndarray) -> np.ndarray:
    """v_sensor = A v_icrs, scalar last (Markley and Crassidis 2014, eq. 2.125)."""
    x, y, z, w = q
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    vector = np.array([x, y, z])
    return (w * w - vector @ vector) * np.eye(3) + 2 * np.outer(vector, vector) - 2 * w * cross


@pytest.mark.slow
def test_its_figures_follow_from_the_raw_bytes_and_the_truth(real):
    """SLIP, packets and attitudes decoded with struct alone; errors from direction cosine matrices."""
    out, figures = real
    received, sent = bytearray(), bytearray()
    for line in (out / "journal.jsonl").read_text().splitlines()[1:]:
        entry = json.loads(line)
        sent += bytes.fromhex(entry.get("tx", ""))
        received += bytes.fromhex(entry.get("rx", ""))
    packets = [reference_decoder.decode_telemetry(frame) for frame in reference_decoder.slip_frames(sent)]
    truths = {}
    for line in (out / "truth.jsonl").read_text().splitlines():
        record = json.loads(line)
        truths[record["frame_index"]] = record
    reports = [packet["fields"] for packet in packets if packet["name"] == "attitude_report"]
    errors = []
    for report in reports:
        record = truths[report["frame_index"]]
        if report["valid"] and not np.any(record["rate_rad_s"]):
            q = np.array([report[f"q_{axis}"] for axis in "xyzw"])
            difference = matrix(q) @ matrix(np.array(record["q_icrs_to_sensor"])).T
            errors.append([difference[1, 2], difference[2, 0], difference[0, 1]])
    error_arcsec = np.array(errors) / ARCSEC
    assert len(errors) == figures["frames_inertial"] >= 15
    cross = math.sqrt(np.mean(np.square(error_arcsec[:, :2])))
    assert figures["cross_boresight_arcsec_rms"] == pytest.approx(cross, rel=1e-3)
    assert figures["cross_boresight_arcsec_rms"] <= 0.61
    assert figures["roll_arcsec_rms"] == pytest.approx(
        math.sqrt(np.mean(np.square(error_arcsec[:, 2]))), rel=1e-3
    )
    tracking = [report for report in reports if report["valid"] and report["mode"] == 4]
    assert figures["frames_tracking"] == len(tracking)
    assert figures["frames"] == len(reports)
    assert figures["overruns"] == sum(report["late"] for report in reports)
    # What was sent before the OBC listened is not in its count.
    assert len(packets) - 5 <= figures["telemetry_packets"] <= len(packets)
    telecommands = reference_decoder.slip_frames(received)
    assert figures["telecommands_sent"] == len(telecommands)
    completed = [packet for packet in packets if packet["name"] == "completion_success"]
    assert figures["telecommands_verified"] == len(completed)
