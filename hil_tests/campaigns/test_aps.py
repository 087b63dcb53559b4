"""The campaigns aps and aps-best: their errors obey the geometry, their tables are the paper's."""

from __future__ import annotations

import json
import math
import types

import numpy as np
import pytest

from st_emulator.campaigns import aps, aps_centroid_tables, aps_runs
from st_emulator.campaigns.aps_centroids import CentroidErrors
from st_emulator.campaigns.aps_paper import ATTITUDES, CENTROIDS, IMAGES, RATES_DEG_S, SUCCESS
from st_emulator.campaigns.aps_runs import DIRECTIONS, Case, Run, bench_of, run_case, with_false_objects
from st_emulator.campaigns.campaign import CampaignRequest
from st_emulator.campaigns.outcome_codec import decode, encode
from st_emulator.campaigns.spreads import Moments, Spread
from st_emulator.report import plain
from st_emulator.units.profile import load_unit

PROFILE = load_unit("aps_rs")
PROFILE_JSON = PROFILE.model_dump_json()
ATTITUDES_RUN = 8


def direction(x: int, y: int, z: int) -> int:
    return int(np.flatnonzero(np.all(np.array([x, y, z]) == DIRECTIONS, axis=1))[0])


def runs(shutter: str, rate: int, *axis: int) -> list[Run]:
    number = direction(*axis)
    return [
        run_case(PROFILE_JSON, 1, ATTITUDES_RUN, Case(shutter, False, rate, attitude, number))
        for attitude in range(ATTITUDES_RUN)
    ]


def std(items: list[Moments]) -> float:
    found = Spread.of(enumerate(items))
    assert found is not None
    return found.std


@pytest.mark.parametrize("way", ["unit", "paper"])
def test_errors_without_compensation_are_speed_times_row_time(way):
    """A turn about the rows' axis moves all stars alike along the columns' axis: their error is spread as
    their rows are, v T / sqrt(12)."""
    expected = math.radians(1.0) * PROFILE.focal_px * 0.2 / math.sqrt(12.0)
    errors = [getattr(run, way).fused for run in runs("rolling", 1, 0, 1, 0)]
    assert std([item.plain_x for item in errors]) == pytest.approx(expected, rel=0.1)
    assert std([item.plain_y for item in errors]) < 0.1 * expected
    assert std([item.compensated_x for item in errors]) < 0.25 * expected


def test_the_units_way_beats_the_papers_on_the_same_images():
    found = [run for axis in ((1, 0, 0), (0, 1, 0), (1, 1, 1)) for run in runs("rolling", 2, *axis)]
    for name in ("compensated_x", "compensated_y"):
        unit, paper = (
            std([getattr(getattr(run, way).fused, name) for run in found]) for way in ("unit", "paper")
        )
        assert unit < 0.7 * paper


def test_a_global_shutter_needs_no_compensation():
    for run in runs("global", 1, 0, 1, 0):
        for errors in (run.unit.fused, run.paper.fused):
            np.testing.assert_array_equal(errors.plain_x.sums, errors.compensated_x.sums)
    assert std([run.paper.fused.plain_x for run in runs("global", 1, 0, 1, 0)]) < 0.4


def test_recognised_are_among_the_fused():
    recognised = [0, 0]
    for run in runs("rolling", 1, 1, 0, 0):
        for way, errors in enumerate((run.unit, run.paper)):
            assert errors.recognised.plain_x.count <= errors.fused.plain_x.count
            recognised[way] += errors.recognised.plain_x.count
    assert min(recognised) >= 5 * ATTITUDES_RUN / 2  # five and more in most


def test_an_outcome_is_kept_to_the_bit():
    found = run_case(PROFILE_JSON, 1, 4, Case("rolling", False, 1, 2, 5))
    again = decode(Run, json.loads(json.dumps(encode(found))))
    assert encode(again) == encode(found)
    assert found.images == 2
    assert np.all(np.abs(found.error_arcsec) < 300)


def test_a_run_does_not_depend_on_those_before():
    case = Case("rolling", True, 2, 1, 3)
    first = run_case(PROFILE_JSON, 1, 4, case)
    run_case(PROFILE_JSON, 1, 4, Case("rolling", False, 5, 3, 0))
    assert encode(run_case(PROFILE_JSON, 1, 4, case)) == encode(first)


def test_false_objects():
    bench = bench_of(PROFILE_JSON, "rolling", 1)
    none = with_false_objects(aps_runs.Spots.empty(1.0, 1.0), np.random.default_rng(1), bench)
    assert len(none) == aps_runs.FALSE_OBJECTS == 50
    assert np.all(np.diff(none.magnitude) >= 0)
    more = with_false_objects(none, np.random.default_rng(2), bench)
    assert len(more) == 100
    assert set(none.x_px) < set(more.x_px)


def test_the_papers_tables_are_whole():
    assert set(ATTITUDES) == set(SUCCESS)
    for table in SUCCESS.values():
        assert np.array(table).shape == (len(IMAGES), len(RATES_DEG_S))
        assert np.all(np.diff(np.array(table), axis=0) >= 0)  # within more images no fewer
    assert all(np.array(table).shape == (len(RATES_DEG_S), 3, 2) for table in ATTITUDES.values())
    assert all(np.array(table).shape == (2, 5, 4) for table in CENTROIDS.values())


def test_cases():
    best = aps.cases_of(50, (False,))
    assert len(best) == len(set(best)) == 2 * 50 * (1 + 5 * 26)
    assert len(aps.cases_of(200, (False, True))) == 4 * 26_200


@pytest.fixture
def few(monkeypatch):
    """Two directions, one of them about the boresight, and at most four images."""
    chosen = (direction(0, 0, 1), direction(0, 1, 0))
    monkeypatch.setattr(aps, "DIRECTION_NUMBERS", chosen)
    monkeypatch.setattr(aps_runs, "MOST_IMAGES", 4)


def test_tables_3_to_13(few, workers, tmp_path):
    result = aps.run(CampaignRequest(PROFILE, 2, 1, workers(1)))
    assert result.figures["runs"] == 4 * 2 * (1 + 5 * 2)
    assert result.figures["wrong"] == 0
    titles = " ".join(table.title for table in result.tables)
    for number in range(3, 14):
        assert f"table {number}:" in titles
    for table in result.tables:
        assert table.rows, table.title
        assert all(len(row) == len(table.columns) for row in table.rows), table.title
    json.dumps(plain(result.figures))
    success = result.figures["success"]
    assert success["table 9, 2 images, 1 deg/s"]["value"] == 1.0
    assert success["table 13, 2 images, 5 deg/s"]["value"] < success["table 9, 2 images, 1 deg/s"]["value"]
    names = [check.name for check in result.checks]
    assert len(names) == len(set(names))
    from st_emulator.campaigns.plotting import write_plot

    write_plot(tmp_path / "aps.png", result.draw)
    assert (tmp_path / "aps.png").stat().st_size > 20_000


def errors_of(sizes: np.ndarray) -> CentroidErrors:
    moments = Moments.of(sizes)
    axis = types.SimpleNamespace(
        plain_x=moments, plain_y=moments, compensated_x=moments, compensated_y=moments
    )
    return types.SimpleNamespace(fused=axis, recognised=axis, astray=1)


@pytest.mark.parametrize(("factor", "holds"), [(1.0, True), (1.1, True), (1.5, False), (0.6, False)])
def test_errors_without_compensation_are_held_to_the_papers(factor, holds):
    """Made-up errors of so many times the paper's size."""
    rng = np.random.default_rng(4)
    by_key = {}
    for shutter in ("rolling", "global"):
        for place, rate in enumerate(RATES_DEG_S[1:]):
            size = CENTROIDS["table 5: rolling shutter, not compensated"][0][place][1] * factor
            by_key[shutter, False, rate] = [
                (
                    Case(shutter, False, rate, attitude, number),
                    types.SimpleNamespace(unit=(made := errors_of(size * rng.normal(size=40))), paper=made),
                )
                for attitude in range(30)
                for number in (0, direction(0, 0, 1))
            ]
    tables, checks, figures = [], [], {}
    aps_centroid_tables.centroid_tables(by_key, PROFILE, tables, checks, figures)
    plain_checks = [item for item in checks if "table 5" in item.name and "horizontal" in item.name]
    assert len(plain_checks) == 10
    assert all(item.holds == holds for item in plain_checks)
    assert figures["centroids"]["astray"][0]["unit"] == pytest.approx(1 / 41)
