"""`st-emulator budget`: exit status, figures with bounds, the same again, gone on with, run again."""

from __future__ import annotations

import contextlib
import functools
import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from st_emulator.budget import samples, sweeps
from st_emulator.budget.figures import ROWS
from st_emulator.firmware_model.work import STAGES

FEW = ("--n", "3", "--evaluations", "12", "--workers", "1")


@pytest.fixture(autouse=True)
def few_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sweeps of a few points and skies."""
    monkeypatch.setattr(sweeps, "FEWEST_SKIES", 2)
    monkeypatch.setattr(sweeps, "FALSE_STAR_COUNTS", (0, 50))
    monkeypatch.setattr(sweeps, "RATES_DEG_S", (0.0, 0.5, 2.0))
    monkeypatch.setattr(sweeps, "WINDOW_RATES_DEG_S", (0.5, 2.0))
    monkeypatch.setattr(sweeps, "REFINEMENTS", 1)


def report(command, *arguments: object) -> tuple[int, dict[str, Any]]:
    outcome = command(*arguments, *FEW, "--json", "-")
    assert outcome.status in (0, 1), outcome.err
    return outcome.status, json.loads(outcome.out)


def figures_of(node: Any, path: str = "") -> list[tuple[str, dict[str, float]]]:
    """Every object that has a value."""
    found = []
    if isinstance(node, dict):
        if "value" in node and isinstance(node["value"], (int, float)) and "points" not in path[-20:]:
            found.append((path, node))
        for name, item in node.items():
            found += figures_of(item, f"{path}.{name}")
    elif isinstance(node, list):
        for item in node:
            found += figures_of(item, path)
    return found


def test_a_unit_that_fits(command):
    status, found = report(command, "roja1")
    assert status == 0
    assert found["fits"] is True
    assert found["unit"] == "roja1"
    assert (found["clock_hz"], found["cache_kib"], found["line_fill"]) == (400_000_000, 32, "nominal")
    assert found["budget_cycles"] == 100_000_000
    assert re.fullmatch(r"[0-9a-f]{64}", found["cycle_costs_sha256"])
    assert found["command"].startswith("st-emulator budget roja1 --n 3 --seed 1 --evaluations 12")
    for mode in ("lost_in_space", "tracking"):
        cycles = found[mode]["as_flown"]["cycles"]
        assert list(cycles) == list(ROWS)
        for which in ("median", "p99", "worst"):
            assert cycles["frame"]["worst"]["value"] > 0
            for row in ROWS:
                figure = cycles[row][which]
                assert figure["low"] <= figure["value"] <= figure["high"]
        assert cycles["threshold"]["p99"]["low"] < cycles["threshold"]["p99"]["high"]
    assert found["lost_in_space"]["frames"] == 3
    assert found["tracking"]["frames"] == 6
    assert set(found["sweeps"]) == {
        *("false stars", "angular rate", "window size", "frames lost"),
        "false stars after lost frames",
    }
    assert {item["name"] for item in found["checks"]} >= {"tracking", "memory"}
    assert all(item["holds"] for item in found["checks"])


def test_a_unit_that_does_not_fit(command):
    """At 25 MHz roja1 has 6.25 million cycles: its threshold alone takes most of them."""
    status, found = report(command, "roja1", "--clock", "25000000")
    assert status == 1
    assert found["fits"] is False
    assert found["budget_cycles"] == 6_250_000
    late = [item for item in found["verdict"]["requirements"] if not item["fits"]]
    assert late
    assert any(not item["holds"] for item in found["checks"])
    first = found["verdict"]["breaks_first"]
    assert first["stage"] in STAGES
    needed = found["verdict"]["least_clock"]["nominal_hz"]
    assert 25e6 < needed < 400e6
    assert found["lost_in_space"]["as_flown"]["late"]["late"]["value"] > 0


def test_no_figure_without_bounds(command):
    _, found = report(command, "roja1", "--line-fill", "high", "--cache", "8")
    assert (found["line_fill"], found["cache_kib"]) == ("high", 8)
    figures = [
        (path, node)
        for path, node in figures_of(found)
        if not path.startswith(".checks") and "holds" not in node
    ]
    points = [item for item in figures if set(item[1]) > {"value", "low", "high"}]
    assert all("lost_in_space" in node or "tracking" in node for _, node in points)  # points of sweeps
    plain = [(path, node) for path, node in figures if set(node) == {"value", "low", "high"}]
    assert len(plain) > 500
    assert len(plain) + len(points) == len(figures)
    for path, node in plain:
        assert node["low"] <= node["value"] <= node["high"], path


def test_text_has_bounds_and_says_how_sure_it_is(command):
    outcome = command("roja1", *FEW)
    assert outcome.status == 0
    frame = [line for line in outcome.out.splitlines() if line.startswith("│ frame   ")]
    assert len(frame) == 2
    for line in frame:
        assert len(re.findall(r"\d \([\d.]+\.\.[\d.]+\)", line)) == 3
    assert "Bounds:" in outcome.out
    assert "roja1 fits" in outcome.out
    assert max(map(len, outcome.out.splitlines())) <= 80


def test_the_same_seed_gives_the_same_report(command):
    _, one = report(command, "roja1", "--seed", "4")
    _, two = report(command, "roja1", "--seed", "4")
    assert one == two
    _, other = report(command, "roja1", "--seed", "5")
    assert other["lost_in_space"] != one["lost_in_space"]


def test_a_stopped_run_goes_on(command, tmp_path, monkeypatch):
    from st_emulator.budget import assessment

    kept = tmp_path / "kept.jsonl"
    _, whole = report(command, "roja1")
    looked = 0
    whole_look = samples.look

    @functools.wraps(whole_look)
    def stops_after_eight(*arguments):
        nonlocal looked
        looked += 1
        if looked == 9:
            raise KeyboardInterrupt
        return whole_look(*arguments)

    monkeypatch.setattr(assessment, "look", stops_after_eight)
    with contextlib.suppress(KeyboardInterrupt):
        stopped = command("roja1", *FEW, "--results", kept, "--json", "-")
        assert stopped.status not in (0, 1) or not stopped.out
    assert len(kept.read_text().splitlines()) > 1
    monkeypatch.setattr(assessment, "look", whole_look)
    outcome = command("roja1", *FEW, "--results", kept, "--json", "-")
    assert json.loads(outcome.out) == whole
    assert re.search(r"5 of \d+ were there", outcome.err)  # one batch was through
    again = command("roja1", *FEW, "--seed", "2", "--results", kept)
    assert again.status == 2
    assert "seed differ" in again.err


class Sources(HTMLParser):
    """What a page refers to, and its text."""

    def __init__(self) -> None:
        super().__init__()
        self.sources: list[str] = []
        self.words: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def test_page_and_plot(command, tmp_path):
    page, plot = tmp_path / "budget.html", tmp_path / "budget.png"
    outcome = command("roja1", *FEW, "--html", page, "--plot", plot)
    assert outcome.status == 0
    with Image.open(plot) as picture:
        assert picture.size[0] > 1000
        assert len(picture.convert("RGB").getcolors(1 << 24) or ()) > 100
    parser = Sources()
    parser.feed(page.read_text(encoding="utf-8"))
    assert len(parser.sources) == 3
    assert all(source.startswith("data:image/svg+xml;base64,") for source in parser.sources)
    text = " ".join(parser.words)
    for words in ("roja1 fits", "Not modelled", "38 MB", "Worst frames", "line fill", "--rerun"):
        assert words in text
    assert len(re.findall(r"\([-\d.]+\.\.[-\d.]+\)", text)) > 100


def test_the_page_of_a_unit_that_does_not_fit_says_so(command, tmp_path):
    page = tmp_path / "late.html"
    outcome = command("roja1", *FEW, "--clock", 25_000_000, "--html", page)
    assert outcome.status == 1
    assert "does not fit" in page.read_text(encoding="utf-8")
    assert 'class="verdict bad"' in page.read_text(encoding="utf-8")


def test_worst_frames_of_a_report_are_run_again(command, tmp_path):
    kept = tmp_path / "report.json"
    assert command("roja1", *FEW, "--json", kept).status == 0
    again = command("roja1", "--rerun", kept)
    assert again.status == 0
    assert again.out.count("the same") == 3
    document = json.loads(kept.read_text())
    document["worst_cases"][1]["cycles"]["frame"]["value"] += 1
    kept.write_text(json.dumps(document))
    other = command("roja1", "--rerun", kept)
    assert other.status == 1
    assert other.out.count("the same") == 2


SCENARIO = """
schema = 1
name = "turn"
duration_s = 5.0
[trajectory]
kind = "constant_rate"
ra_deg = 83.0
dec_deg = -3.0
rate_deg_s = [0.1, 0.0, 0.0]
[parameters]
pipelined = 0
"""


def test_a_scenario_drives_the_frames(command, tmp_path):
    path = tmp_path / "turn.toml"
    path.write_text(SCENARIO)
    kept = tmp_path / "report.json"
    _, found = report(command, "roja1", "--scenario", path)
    kept.write_text(json.dumps(found))
    assert command("roja1", "--rerun", kept).status == 2
    assert command("roja1", "--rerun", kept, "--scenario", path).status == 0
    assert found["pipelined"] is False
    assert found["parameters_changed"] == {"pipelined": 0}
    assert found["lost_in_space"]["as_flown"]["budget_ms"] == pytest.approx(133.3)
    assert "angular rate" not in found["sweeps"]
    for case in found["worst_cases"]:
        assert 0 <= case["inputs"]["instant"]["start_ns"] < 5e9


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("nothing",), "no unit 'nothing'"),
        (("roja1", "--clock", "5"), "--clock"),
        (("roja1", "--cache", "7"), "--cache 7"),
        (("roja1", "--line-fill", "quick"), "low, nominal, high"),
        (("roja1", "--scenario", "/nowhere/at/all.toml"), "all.toml"),
        (("roja1", "--html", "/nowhere/page.html"), "--html"),
        (("roja1", "--plot", "/nowhere/plot.png"), "--plot"),
        (("roja1", "--plot", "plot.txt"), "--plot"),
        (("roja1", "--json", "/nowhere/x.json"), "--json"),
        (("roja1", "--results", "/nowhere/x.jsonl"), "--results"),
        (("roja1", "--rerun", "/nowhere/x.json"), "--rerun"),
        (("roja1", "--results", "x.jsonl", "--restart"), "--restart"),
    ],
)
def test_bad_input_is_refused_at_once(command, arguments, says):
    outcome = command(*arguments, *FEW)
    assert outcome.status == 2
    assert says in outcome.err
    assert len(outcome.err.splitlines()) == 1


def test_a_report_that_is_none(command, tmp_path):
    path = tmp_path / "x.json"
    for text in ("[]", "{}", '{"worst_cases": [{"mode": "tracking"}]}', "no JSON"):
        path.write_text(text)
        outcome = command("roja1", "--rerun", path)
        assert outcome.status == 2
        assert "is no report" in outcome.err


def test_the_help_tells_the_exit_status(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    outcome = command("--help")
    assert outcome.status == 0
    text = " ".join(outcome.out.split())
    assert "0 where the unit fits" in text
    assert "1 where it does not" in text
    assert sys.argv[1] == "budget"
    assert Path(sys.argv[0]).name == "st-emulator"
