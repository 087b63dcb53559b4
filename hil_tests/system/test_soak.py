"""tools/soak: a few minutes of it, that it can be stopped, and that it sees what is wrong."""

from __future__ import annotations

import gzip
import io
import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from st_emulator.bench.journal import JournalEntry, JournalReader
from st_emulator.clock import NS_PER_S
from st_emulator.firmware_model.modes import Mode
from tools.soaking.judging import count, growth_kib_per_hour, replayed
from tools.soaking.run import Grid, Outcome, Soak

ROOT = Path(__file__).parents[2]
HOURS = 0.03
COMMAND = [sys.executable, "-m", "tools.soaking"]


def soak(*arguments: str, **more: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, *arguments], cwd=ROOT, capture_output=True, text=True, check=False, **more
    )


def test_three_minutes() -> None:
    done = soak("--hours", "0.05", "--seed", "2", "--json", "-")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["hours"] == 0.05
    assert 650 <= found["frames"] <= 721, (
        "180 s of 4 Hz, the first and the last instant too, less what was without power"
    )
    assert found["faults"] >= 5
    assert found["frames_in_quiet_stretches"] > 100
    assert found["attitude_reports"] >= found["frames_in_quiet_stretches"]
    assert found["first_difference"] == "none"
    assert all(one["holds"] for one in found["checks"])
    assert {one["name"] for one in found["checks"]} == {
        "hours_missing", "clock_error", "frames_missing", "attitude_reports_missing", "never_back",
        "replay_differences",
    }  # fmt: skip


def test_it_can_be_stopped_and_judges_what_ran(tmp_path: Path) -> None:
    journal, out = tmp_path / "journal.jsonl.gz", tmp_path / "figures.json"
    arguments = ["--hours", "24", "--no-replay", "--journal", str(journal), "--json", str(out)]
    process = subprocess.Popen([*COMMAND, *arguments], cwd=ROOT, stderr=subprocess.DEVNULL)
    try:
        limit = time.monotonic() + 120
        while not (journal.exists() and journal.stat().st_size > 30_000):
            assert time.monotonic() < limit
            assert process.poll() is None
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 1
    finally:
        if process.poll() is None:
            process.kill()
    found = json.loads(out.read_text())
    assert found["stopped"] is True
    assert 0 < found["hours"] < 24
    assert [one["name"] for one in found["checks"] if not one["holds"]] == ["hours_missing"]
    reader = JournalReader(journal)
    assert sum(1 for _ in reader) > 100
    assert reader.ended


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--unit", "nothing"), "nothing"),
        (("--journal", "x.jsonl"), "--journal x.jsonl: allowed is a name that ends in .gz"),
        (("--journal", "no/where.gz"), "--journal no/where.gz: cannot be written"),
        (("--json", "no/where.json"), "no/where.json"),
    ],
)
def test_what_is_refused(arguments: tuple[str, ...], says: str) -> None:
    done = soak(*arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    assert re.fullmatch(r"tools/soak: [^\n]+\n", done.stderr)
    assert says in done.stderr


# -- what is wrong is seen


@pytest.fixture(scope="module")
def journal(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome]:
    path = tmp_path_factory.mktemp("soak") / "journal.jsonl.gz"
    with gzip.open(path, "wt", encoding="utf-8", newline="\n") as file:
        outcome = Soak("roja1", HOURS, 5, file).run()
    assert outcome.stretches
    return path, outcome


def lines_of(path: Path) -> list[str]:
    with gzip.open(path, "rt", encoding="utf-8") as file:
        return file.readlines()


def changed(journal: Path, to: Path, number: int, text: str | None) -> Path:
    """With another line, or without it."""
    lines = lines_of(journal)
    lines[number : number + 1] = [] if text is None else [text]
    with gzip.open(to, "wt", encoding="utf-8", newline="\n") as file:
        file.writelines(lines)
    return to


def test_what_is_right(journal: tuple[Path, Outcome]) -> None:
    path, outcome = journal
    counted = count(path, outcome.stretches)
    assert counted.in_stretch == [stretch.frames for stretch in outcome.stretches]
    assert replayed(path, lambda hours: None) is None


def test_a_lost_group_and_another_octet_are_found(journal: tuple[Path, Outcome], tmp_path: Path) -> None:
    path, outcome = journal
    stretch = outcome.stretches[0]
    entries = [
        (number, line)
        for number, line in enumerate(lines_of(path))
        if '"tx"' in line and stretch.start_ns < json.loads(line)["t_ns"] < stretch.end_ns
    ]
    number, line = entries[2]
    lost = changed(path, tmp_path / "lost.gz", number, None)
    assert sum(count(lost, outcome.stretches).in_stretch) < sum(one.frames for one in outcome.stretches)
    assert replayed(lost, lambda hours: None) is not None
    item = json.loads(line)
    item["tx"] = bytes([bytes.fromhex(item["tx"])[0] ^ 1]).hex() + item["tx"][2:]
    other = changed(path, tmp_path / "other.gz", number, json.dumps(item) + "\n")
    difference = replayed(other, lambda hours: None)
    assert difference is not None
    assert f"{item['t_ns'] / 1e9:.9f}" in difference


def test_another_note_is_found(journal: tuple[Path, Outcome], tmp_path: Path) -> None:
    path, _ = journal
    number, line = next((number, line) for number, line in enumerate(lines_of(path)) if '"note"' in line)
    count = len(lines_of(path)) - 1
    other = changed(path, tmp_path / "note.gz", number, line.replace("begins", "begin"))
    assert replayed(other, lambda hours: None) == (
        f"the bytes are the same, the lines are not ({count} against {count})"
    )


def test_the_same_seed_is_the_same_run(journal: tuple[Path, Outcome], tmp_path: Path) -> None:
    path, _ = journal
    again = tmp_path / "again.gz"
    with gzip.open(again, "wt", encoding="utf-8", newline="\n") as file:
        Soak("roja1", HOURS, 5, file).run()
    assert lines_of(again) == lines_of(path)


def test_the_slope_of_a_memory() -> None:
    flat = [(hour / 10, 200.0) for hour in range(100)]
    assert growth_kib_per_hour(flat) == 0
    grows = [(hour / 10, 200.0 + hour / 10) for hour in range(100)]
    assert growth_kib_per_hour(grows) == pytest.approx(1024)
    warmed_up = [(hour / 10, min(200.0 + hour, 210.0)) for hour in range(100)]
    assert growth_kib_per_hour(warmed_up) == 0
    assert growth_kib_per_hour(flat[:5]) is None


def test_the_frames_that_there_must_be() -> None:
    grid = Grid(250)
    grid.on(100)
    grid.off(100 + 1)
    assert grid.expected == 1, "the first begins with power"
    grid.on(1000)
    grid.off(1250)
    assert grid.expected == 2
    grid.on(2000)
    grid.off(2251)
    assert grid.expected == 4
    grid.off(9999)
    assert grid.expected == 4
    grid.on(3000)
    grid.begins(3250)
    grid.off(3250)
    assert grid.expected == 6, "it had begun when power went"


def test_a_clock_that_is_wrong_and_a_frame_too_many_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    class Nowhere:
        def write(self, text: str) -> int:
            return len(text)

        def flush(self) -> None:
            pass

    soak = Soak("roja1", 0.02, 5, Nowhere())
    apply = soak.emulator.device.time.apply

    def one_more(t_ns: int) -> tuple[int, int] | None:
        change = apply(t_ns)
        if change is not None:
            soak.emulator.device.time.jump(1)
        return change

    monkeypatch.setattr(soak.emulator.device.time, "apply", one_more)
    outcome = soak.run()
    assert outcome.most_clock_error_ns == 1
    assert soak.grid.started == soak.grid.expected
    soak.emulator.device.frame_started(0)
    assert soak.grid.started == soak.grid.expected + 1


def test_a_unit_that_hangs_does_not_track() -> None:
    """Its mode stays what it was until the watchdog resets it: a stretch that begins then is not quiet."""
    soaking = Soak("roja1", 0.1, 1, io.StringIO())
    soaking.emulator.advance(3 * NS_PER_S)
    assert soaking._tracks()
    soaking.emulator.faults.inject({"kind": "processor.stuck", "watchdog_ms": 9000})
    soaking.emulator.advance(4 * NS_PER_S)
    assert soaking.emulator.device.mode == Mode.TRACKING
    assert not soaking._tracks()
    soaking.emulator.advance(16 * NS_PER_S)
    assert soaking._tracks()


def test_the_unit_end_of_a_stretch_is_between_frames(journal: tuple[Path, Outcome]) -> None:
    """Nothing is on the line there: what is counted is told."""
    path, outcome = journal
    times = [entry.t_ns for entry in JournalReader(path) if isinstance(entry, JournalEntry)]
    for stretch in outcome.stretches:
        assert stretch.end_ns > stretch.start_ns
        assert stretch.frames > 0
        assert all(abs(stretch.end_ns - t_ns) > 10_000 for t_ns in times)
