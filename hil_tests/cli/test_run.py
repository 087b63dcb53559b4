"""`st-emulator run`: the same bytes at any speed, a clean end, the date of the world."""

from __future__ import annotations

import json
import signal
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from hil_tests.cli.live import LiveUnit
from hil_tests.vectors import reference_decoder
from st_emulator.bench.journal import read_journal
from st_emulator.obc import Obc

SCENARIO = """
name = "at rest, then turning"
duration_s = 4.0
start_utc = 2027-03-04T05:06:07Z
seed = 5
[trajectory]
kind = "slew"
ra_deg = 84.0
dec_deg = -1.5
roll_deg = 20.0
[[trajectory.segments]]
kind = "hold"
duration_s = 2.5
[[trajectory.segments]]
kind = "rate"
duration_s = 1.0
rate_deg_s = [0.1, 0.2, -0.3]
[[telecommands]]
at_s = 0.6
name = "ping"
[[telecommands]]
at_s = 0.75
name = "function"
fields = {function_id = "START_ACQUISITION"}
[[telecommands]]
at_s = 2.0
name = "hk_one_shot"
fields = {structure_ids = [1, 2, 3]}
[[telecommands]]
at_s = 3.01
raw_hex = "c0010203c0"
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "scenario.toml"
    path.write_text(SCENARIO)
    return path


def telemetry(journal: Path) -> list[dict]:
    line = read_journal(journal).bytes_of("tx")
    return [reference_decoder.decode_telemetry(frame) for frame in reference_decoder.slip_frames(line)]


def named(journal: Path, name: str) -> list[dict]:
    return [packet["fields"] for packet in telemetry(journal) if packet["name"] == name]


def test_the_same_bytes_as_fast_as_possible_and_in_real_time(command, scenario, tmp_path):
    arguments = ("run", "roja1", "--scenario", scenario)
    first, second, quick, live = (tmp_path / f"{name}.jsonl" for name in ("first", "second", "quick", "live"))
    truths = []
    for journal, speed in ((first, "max"), (second, "max"), (quick, "3.5")):
        truth = journal.with_suffix(".truth")
        outcome = command(*arguments, "--speed", speed, "--journal", journal, "--truth", truth)
        assert (outcome.status, outcome.out) == (0, "")
        truths.append(truth.read_bytes())
    link = tmp_path / "tracker"
    with LiveUnit(*arguments[1:], "--link", f"pty:{link}", "--journal", live) as unit:
        unit.await_running()
        assert link.is_symlink()
        assert unit.wait() == 0
    assert not link.exists() and not link.is_symlink()  # noqa: PT018
    assert first.read_bytes() == second.read_bytes() == quick.read_bytes() == live.read_bytes()
    assert truths[0] == truths[1] == truths[2]
    # And these bytes are of a unit that worked.
    reports = named(first, "attitude_report")
    assert sum(report["valid"] for report in reports) >= 10
    assert {report["structure_id"] for report in named(first, "hk_report")} == {1, 2, 3}
    assert len(named(first, "pong")) == 1
    assert 9 in [event["event_id"] for event in named(first, "event_low")]  # the raw bytes: TC_MALFORMED
    assert read_journal(first).ended
    assert read_journal(first).end_ns == 4_000_000_000


def test_seed(command, scenario, tmp_path):
    def run(*more: str) -> bytes:
        path = tmp_path / "journal.jsonl"
        arguments = ("--speed", "max", "--seconds", "1.5", "--journal", path)
        assert command("run", "roja1", "--scenario", scenario, *arguments, *more).status == 0
        return read_journal(path).bytes_of("tx")

    own = run()
    assert run("--seed", "5") == own  # the scenario's
    assert run("--seed", "6") != own


def test_seconds_go_before_the_scenarios_duration(command, scenario, tmp_path):
    journal = tmp_path / "journal.jsonl"
    arguments = ("--scenario", scenario, "--speed", "max", "--seconds", "1.25", "--journal", journal)
    outcome = command("run", "roja1", *arguments)
    assert outcome.status == 0
    assert "stopped at 1.250 s" in outcome.err
    assert read_journal(journal).end_ns == 1_250_000_000


def test_quiet(command, scenario):
    outcome = command("run", "roja1", "--scenario", scenario, "--speed", "max", "--seconds", "0.5", "-q")
    assert (outcome.status, outcome.out, outcome.err) == (0, "", "")


def test_a_unit_with_brackets_in_its_title_and_a_long_path(command, tmp_path):
    from importlib import resources

    text = (resources.files("st_emulator") / "units/roja1.toml").read_text(encoding="utf-8")
    lines = ['title = "a [bold] b [/] c"' if line.startswith("title") else line for line in text.splitlines()]
    folder = tmp_path / ("long-" * 20)
    folder.mkdir()
    unit = folder / "unit.toml"
    unit.write_text("\n".join(lines))
    store = folder / "[store]"
    outcome = command("run", unit, "--link", "none", "--speed", "max", "--seconds", "0.5", "--store", store)
    assert outcome.status == 0
    assert outcome.err.splitlines()[0] == "a [bold] b [/] c"
    assert f"non-volatile memory: {store}" in outcome.err.splitlines()  # in one piece


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_run_cleanly(number, tmp_path):
    link, journal = tmp_path / "tracker", tmp_path / "journal.jsonl"
    arguments = ("roja1", "--link", f"pty:{link}", "--journal", journal, "--store", "none")
    with LiveUnit(*arguments) as unit:
        unit.await_running()
        unit.await_lines(journal, 2)
        assert link.is_symlink()
        assert unit.stop(number) == 0, unit.said
        assert unit.said[-1].startswith("stopped at ")
    assert not link.is_symlink()
    assert not Path(f"{link}.lock").exists()
    assert read_journal(journal).ended


def test_a_signal_before_power_on_ends_as_cleanly(tmp_path):
    link = tmp_path / "tracker"
    with LiveUnit("roja1", "--link", f"pty:{link}", "--store", "none") as unit:
        while not link.is_symlink():  # made before the tables are loaded
            assert unit.process.poll() is None, unit.said
        assert unit.stop(signal.SIGINT) == 0, unit.said
        assert unit.said[-1].startswith("stopped ")
    assert not link.is_symlink()


def test_parameters_are_kept_in_the_store_and_a_scenario_starts_from_factory(command, scenario, tmp_path):
    store, journal = tmp_path / "store", tmp_path / "journal.jsonl"
    fast = ("--speed", "max")
    live = ("--link", f"pty:{tmp_path / 'tracker'}")

    def boot_count(*more: str | Path) -> int:
        assert command("run", "roja1", "--seconds", "0.6", "--journal", journal, *more).status == 0
        return named(journal, "event_info")[0]["data"]["boot_count"]

    assert [boot_count(*fast, "--store", store) for _ in range(3)] == [1, 2, 3]
    assert [boot_count(*fast, "--store", "none") for _ in range(2)] == [1, 1]
    assert [boot_count(*fast, "--scenario", scenario) for _ in range(2)] == [1, 1]
    assert [boot_count(*fast) for _ in range(2)] == [1, 1]  # nobody on the line: the same bytes each time
    assert [boot_count(*live) for _ in range(2)] == [1, 2]  # the user's state folder
    assert (tmp_path / "state/st-emulator/roja1.parameters.json").exists()


def start_of(journal: Path) -> datetime:
    return datetime.fromisoformat(read_journal(journal).header["scenario"]["start_utc"])


def test_the_date_of_the_world(command, scenario, tmp_path):
    journal = tmp_path / "journal.jsonl"
    fast = ("--seconds", "0.1", "--journal", journal, "--store", "none")
    assert command("run", "roja1", *fast, "--speed", "max").status == 0
    fixed = start_of(journal)
    assert fixed == datetime(2026, 1, 15, tzinfo=UTC)  # without an OBC every run is the same
    assert command("run", "roja1", *fast, "--scenario", scenario, "--speed", "max").status == 0
    assert start_of(journal) == datetime(2027, 3, 4, 5, 6, 7, tzinfo=UTC)
    before = datetime.now(UTC)
    outcome = command("run", "roja1", *fast, "--link", f"pty:{tmp_path / 'tracker'}")
    assert outcome.status == 0
    live = start_of(journal)  # an OBC will set the real time
    assert before <= live <= datetime.now(UTC)
    assert f"world: from {live:%Y-%m-%dT%H:%M:%SZ}" in outcome.err
    link = f"pty:{tmp_path / 'tracker'}"
    assert command("run", "roja1", *fast, "--scenario", scenario, "--link", link).status == 0
    assert start_of(journal) == datetime(2027, 3, 4, 5, 6, 7, tzinfo=UTC)


# -- recorded frames over the wire

RA_DEG, DEC_DEG, ROLL_DEG = 84.0, -1.5, 20.0


def render(path: Path, number: int) -> np.ndarray:
    """What roja1 sees at a pointing; saved in the format of the suffix. Gives the true attitude."""
    from astropy.io import fits
    from PIL import Image

    from st_emulator.bench.scenario import InertialTrajectory, Scenario, Sky
    from st_emulator.bench.world_of import scene_of
    from st_emulator.tai import tai_ns_from_utc
    from st_emulator.units.profile import load_unit

    pointing = InertialTrajectory(ra_deg=RA_DEG, dec_deg=DEC_DEG, roll_deg=ROLL_DEG)
    # The firmware does not know the date of a recorded frame, so it cannot correct aberration.
    scenario = Scenario(trajectory=pointing, sky=Sky(aberration=False))
    scene = scene_of(load_unit("roja1"), scenario, 7, tai_ns_from_utc(scenario.start_utc))
    pixels = scene.frame(number, number * 250_000_000).full()
    if path.suffix == ".fits":
        fits.PrimaryHDU(pixels).writeto(path)
    else:
        Image.fromarray(pixels).save(path)
    return np.asarray(scene.trajectory.q_icrs_to_sensor(0))


def angle_arcsec(q: np.ndarray, other: np.ndarray) -> float:
    return float(2 * np.arccos(min(1.0, abs(np.dot(q, other)))) * 180 / np.pi * 3600)


@pytest.mark.parametrize("suffix", ["png", "tiff", "fits"])
def test_recorded_frames_are_solved_over_the_wire(suffix, command, tmp_path):
    folder, journal = tmp_path / "frames", tmp_path / "journal.jsonl"
    folder.mkdir()
    for number in range(3):
        q_true = render(folder / f"frame{number}.{suffix}", number)
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(
        "duration_s = 3\n[[telecommands]]\nat_s = 0.6\nname = 'function'\n"
        "fields = {function_id = 'START_ACQUISITION'}\n"
    )
    outcome = command(
        *("run", "roja1", "--scenario", scenario, "--speed", "max", "--journal", journal),
        *("--frames", folder, "--hold", "1", "--truth", tmp_path / "truth.jsonl"),
    )
    assert outcome.status == 0
    reports = named(journal, "attitude_report")
    assert len(reports) >= 7
    assert all(report["valid"] for report in reports)
    for report in reports:
        q = np.array([report[f"q_{axis}"] for axis in "xyzw"])
        assert angle_arcsec(q, q_true) < 30  # roll included
    assert json.loads((tmp_path / "truth.jsonl").read_text().splitlines()[0])["recorded"] is True
    # The journal replays from any folder.
    assert command("replay", journal).status == 0
    # And the same pixels alone.
    solved = command("solve", folder / f"frame0.{suffix}", "--json", "-")
    assert solved.status == 0
    figures = json.loads(solved.out)
    cross = 3600 * np.hypot(
        (figures["ra_deg"] - RA_DEG) * np.cos(np.radians(DEC_DEG)), figures["dec_deg"] - DEC_DEG
    )
    assert cross < 3
    assert figures["roll_deg"] == pytest.approx(ROLL_DEG, abs=0.01)


def test_two_units_do_not_share_a_store(command, tmp_path):
    store = tmp_path / "store"
    with LiveUnit("roja1", "--link", f"pty:{tmp_path / 'tracker'}", "--store", store) as unit:
        unit.await_running()
        outcome = command(
            "run", "zy3", "--link", "none", "--speed", "max", "--seconds", "0.5", "--store", store
        )
        assert outcome.status == 2
        assert outcome.err.splitlines() == [
            f"st-emulator: --store {store}: another unit that runs has it; "
            "allowed are a file of its own or none"
        ]


def test_two_units_of_one_kind_have_a_store_each(tmp_path):
    with LiveUnit("roja1", "--link", f"pty:{tmp_path / 'a'}") as first:
        first.await_running()
        with LiveUnit("roja1", "--link", f"pty:{tmp_path / 'b'}") as second:
            second.await_running()
            assert any("/roja1.parameters.json" in line for line in first.said)
            assert any("/roja1-2.parameters.json" in line for line in second.said)
            assert second.stop(signal.SIGINT) == 0
        assert first.stop(signal.SIGINT) == 0


def test_a_unit_that_went_off_says_so(tmp_path):
    link = tmp_path / "tracker"
    with LiveUnit("roja1", "--link", f"pty:{link}", "--store", "none") as unit:
        unit.await_running()
        with Obc.connect(f"pty:{link}", apid=1073) as obc:
            obc.wait_for("hk_report", lambda telemetry: True, timeout_s=20)
            obc.shutdown()
            obc.wait(1.5)
        assert unit.stop(signal.SIGINT) == 0
    assert "the unit is off: nothing is sent any more (Ctrl-C ends)" in unit.said
