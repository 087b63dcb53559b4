"""A display as the sky of a scenario: what is refused, what is shown, and that a unit works before it."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest

from st_emulator.bench.emulator import Emulator
from st_emulator.bench.scenario import Scenario, load_scenario, parse_scenario
from st_emulator.bench.world_of import scene_of
from st_emulator.errors import ConfigurationError
from st_emulator.tai import tai_ns_from_utc
from st_emulator.units.profile import load_unit
from st_emulator.world.display import Display, DisplayRenderer

from .conftest import Command

EXAMPLE = Path(__file__).parents[2] / "examples" / "display.toml"
KEYS = "columns, rows, width_mm, collimator_mm, update_hz, levels, brightest_mag"


def sky(text: str) -> Scenario:
    return parse_scenario(f"[sky]\n{text}", "here")


def test_true_is_the_papers_display_and_false_is_the_sky() -> None:
    assert sky("").sky.display is None
    assert sky("display = false").sky.display is None
    shown = sky("display = true").sky.display
    assert shown is not None
    assert shown.display == Display()
    assert load_scenario(EXAMPLE).sky.display == shown


def test_a_display_of_ones_own() -> None:
    shown = sky(
        "[sky.display]\ncolumns = 1920\nrows = 1080\nwidth_mm = 480.0\ncollimator_mm = 500"
    ).sky.display
    assert shown is not None
    assert shown.display == Display(columns=1920, rows=1080, pitch_mm=0.25, focal_mm=500.0)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ('display = "yes"', ("sky.display", "found 'yes'", "true or false or a table", KEYS)),
        ("display = 1", ("sky.display", "found 1", "true or false")),
        ("[sky.display]\ncolums = 2560", ("sky.display.colums", "not a known key", KEYS)),
        ("[sky.display]\ncolumns = 8", ("sky.display.columns", "found 8", "a whole number from 16 to 32768")),
        ("[sky.display]\nrows = 100.5", ("sky.display.rows", "found 100.5", "a whole number")),
        ("[sky.display]\nwidth_mm = 0", ("sky.display.width_mm", "found 0", "a number from 1 to")),
        ("[sky.display]\ncollimator_mm = -1", ("sky.display.collimator_mm", "found -1", "a number from 1")),
        ("[sky.display]\nupdate_hz = 0", ("sky.display.update_hz", "found 0", "a number from 0.1")),
        ("[sky.display]\nupdate_hz = nan", ("sky.display.update_hz", "found nan", "a number from 0.1")),
        ("[sky.display]\nlevels = 0", ("sky.display.levels", "found 0", "a whole number from 1")),
        (
            '[sky.display]\nbrightest_mag = "x"',
            ("sky.display.brightest_mag", "found 'x'", "a number from -30"),
        ),
    ],
)
def test_what_makes_no_display_is_named(
    refused: Command, tmp_path: Path, text: str, named: tuple[str, ...]
) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(f"[sky]\n{text}\n")
    refused("run", "iris", "--scenario", path, "--speed", "max", says=(str(path), *named))


def test_the_schema_of_scenarios_knows_both() -> None:
    schema = Scenario.model_json_schema(by_alias=True)
    kinds = schema["$defs"]["Sky"]["properties"]["display"]["anyOf"]
    assert {"type": "boolean"} in kinds
    assert {"$ref": "#/$defs/DisplayedSky"} in kinds


@pytest.mark.parametrize("unit", ["roja1", "aps_rs", "iris"])
def test_any_unit_looks_at_the_display_without_bodies(unit: str) -> None:
    scenario = sky("display = true\nfalse_spots = 2")
    start = tai_ns_from_utc(scenario.start_utc)
    scene = scene_of(load_unit(unit), scenario, 1, start)
    assert isinstance(scene, DisplayRenderer)
    assert scene.bodies == ()
    under_the_sky = scene_of(load_unit(unit), sky("false_spots = 2"), 1, start)
    shown, seen = (s.truth(s.frame(0, 0)) for s in (scene, under_the_sky))
    assert shown.q_icrs_to_sensor == seen.q_icrs_to_sensor
    places = {star.hip: (star.x_px, star.y_px) for star in seen.stars}
    off = np.array([np.subtract((s.x_px, s.y_px), places[s.hip]) for s in shown.stars if s.hip in places])
    assert len(off) > 20
    # even over a pixel of the display
    pixel_px = scene.camera.focal_px * scene.display.pixel_tangent
    assert off.std() == pytest.approx(pixel_px / np.sqrt(12.0), rel=0.3)


def test_a_unit_tracks_before_the_display_and_a_replay_is_the_same_run() -> None:
    scenario = parse_scenario(EXAMPLE.read_text(), "here").model_copy(update={"duration_s": None})
    journals = []
    for given in (scenario, Scenario.model_validate_json(scenario.model_dump_json(by_alias=True))):
        journal = io.StringIO()
        emulator = Emulator(load_unit("iris"), given, journal=journal)
        emulator.advance(5_000_000_000)
        assert emulator.device.mode.name == "TRACKING"
        emulator.close()
        journals.append(journal.getvalue())
    assert journals[0] == journals[1]
    header = json.loads(journals[0].splitlines()[0])
    assert header["scenario"]["sky"]["display"]["columns"] == 2560


def test_where_the_file_is_no_table_is_said() -> None:
    with pytest.raises(ConfigurationError, match="here: sky: found 3"):
        parse_scenario("sky = 3", "here")
