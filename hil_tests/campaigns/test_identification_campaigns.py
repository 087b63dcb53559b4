"""zy3-table3 and false-stars: what their tables are made of."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from st_emulator.campaigns import false_stars, zy3_table3
from st_emulator.campaigns.campaign import CampaignRequest
from st_emulator.campaigns.star_identification import BAD, FAILURE, SUCCESS, Attempt, verdict_of
from st_emulator.campaigns.star_scenes import MagnitudeNoise, SceneSettings, make_scene, stars_in_field
from st_emulator.campaigns.zy3_table3 import PAPER, SCENARIOS, STRATA, Case
from st_emulator.firmware_model.identification.algorithms import ALGORITHMS
from st_emulator.firmware_model.identification.interface import Identification
from st_emulator.firmware_model.reasons import Reason
from st_emulator.units.profile import load_unit
from st_emulator.world import quaternion

RESOLUTION = 214.5
SHARES = zy3_table3.sky_shares(RESOLUTION)


def test_shares_of_the_sky():
    """Against random boresights; the paper's 140 of 10,000 is that of a circular field of 20 deg."""
    stars = zy3_table3.tables_of(RESOLUTION).catalogue.unit_vectors
    rng = np.random.default_rng(1)
    v = rng.normal(size=(20_000, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    counts = np.sum(v @ stars.T > np.cos(np.radians(10)), axis=1)
    for share, (low, high) in zip(SHARES, STRATA, strict=True):
        assert share == pytest.approx(np.mean((counts >= low) & (counts <= high)), abs=0.006)
    assert 0.012 < SHARES[0] < 0.0145
    assert 0.99 < sum(SHARES) < 1.0  # fewer than three stars are rare


def test_weights():
    small, small_false, large = (zy3_table3.weights_of(item, SHARES) for item in SCENARIOS)
    assert small == small_false
    assert small[0] == 0.014
    assert large[0] == 0.0
    for weights in (small, large):
        assert sum(weights) == pytest.approx(1.0)
        assert weights[2] / weights[1] == pytest.approx(SHARES[2] / SHARES[1])


@pytest.mark.parametrize("n", [1, 3, 10, 997, 10_000])
def test_cases_over_the_strata(n):
    weights = zy3_table3.weights_of(SCENARIOS[0], SHARES)
    numbers = zy3_table3.cases_of(n, weights)
    assert all(number >= 1 for number in numbers)
    assert sum(numbers) == max(n, 5) or sum(numbers) <= n + 4
    if n == 10_000:
        assert sum(numbers) == n
        assert numbers[0] > 1000  # of 140 in a plain sample
    assert zy3_table3.cases_of(n, zy3_table3.weights_of(SCENARIOS[2], SHARES))[0] == 0


@pytest.mark.parametrize("stratum", range(len(STRATA)))
def test_orientations_of_a_stratum(stratum):
    catalogue = zy3_table3.tables_of(RESOLUTION).catalogue
    low, high = STRATA[stratum]
    found = [zy3_table3.orientation(1, stratum, number, RESOLUTION) for number in range(5)]
    for q in found:
        assert low <= len(stars_in_field(catalogue, q, SceneSettings(20.0, circular=True))) <= high
    assert len({tuple(q) for q in found}) == 5
    assert np.array_equal(found[3], zy3_table3.orientation(1, stratum, 3, RESOLUTION))


def test_the_papers_figures():
    """Table 3 prints the success in percent too: the counts must give it."""
    printed = {
        "brightness_referenced": (99.82, 98.76, 99.70),
        "pyramid": (99.91, 99.25, 100.0),
        "geometric_voting": (98.72, 97.87, 99.14),
    }
    for name, shares in printed.items():
        for place, percent in enumerate(shares):
            assert zy3_table3.paper_success(name, place).value == pytest.approx(percent / 100, abs=5e-5)
    assert set(printed) == set(PAPER)
    assert zy3_table3.paper_success("multi_poles", 0) is None


def scene():
    settings = SceneSettings(20.0, circular=True, false_stars=1, most_spikes=10)
    return make_scene(zy3_table3.tables_of(RESOLUTION).catalogue, settings, 4, 12)


def right_answer(star_scene) -> Identification:
    index = star_scene.true_rows.copy()
    return Identification(index, int(np.sum(index >= 0)), Reason.NONE, star_scene.q)


def test_verdicts():
    given = scene()
    right = right_answer(given)
    assert verdict_of(right, given) == SUCCESS
    assert verdict_of(dataclasses.replace(right, reason=Reason.UNCONFIRMED), given) == SUCCESS
    assert verdict_of(dataclasses.replace(right, reason=Reason.NO_MATCH), given) == FAILURE
    for spot in range(len(given.true_rows)):
        misnamed = right.star_index.copy()
        misnamed[spot] = 7 if misnamed[spot] != 7 else 8  # the false star's among them
        assert verdict_of(dataclasses.replace(right, star_index=misnamed), given) == BAD
        left_out = right.star_index.copy()
        left_out[spot] = -1
        assert verdict_of(dataclasses.replace(right, star_index=left_out), given) == SUCCESS
    for degrees, verdict in ((0.4, SUCCESS), (0.6, BAD)):
        q = quaternion.multiply(quaternion.from_rotation_vector([0, 0, np.radians(degrees)]), given.q)
        assert verdict_of(dataclasses.replace(right, q_icrs_to_sensor=q), given) == verdict


def test_an_orientation_is_the_same_in_every_scenario():
    ours = [zy3_table3.look(2, RESOLUTION, Case(place, MagnitudeNoise.NORMAL, 3, 5)) for place in (0, 1, 2)]
    for outcome in ours:
        assert len(outcome) == len(ALGORITHMS)
        assert all(item.operations > 0 and item.time_ns > 0 for item in outcome)
    without_time = [[dataclasses.replace(item, time_ns=0) for item in outcome] for outcome in ours]
    assert without_time[1] == without_time[2]  # the same attitude, noise and false star
    again = zy3_table3.look(2, RESOLUTION, Case(1, MagnitudeNoise.NORMAL, 3, 5))
    assert [dataclasses.replace(item, time_ns=0) for item in again] == without_time[1]


def attempt(verdict: str, reason: Reason = Reason.NONE, operations: int = 10) -> Attempt:
    return Attempt(verdict, int(reason), operations, 1_000_000)


def test_a_cell_is_weighted():
    tried = [
        [attempt(SUCCESS), attempt(FAILURE, Reason.NO_MATCH, 30)],
        [attempt(SUCCESS)] * 4,
        [attempt(SUCCESS)],
        [],
        [attempt(SUCCESS)] * 9 + [attempt(BAD)],
    ]
    cell = zy3_table3._cell(tried, [0.1, 0.2, 0.3, 0.0, 0.4])
    assert cell.success.value == pytest.approx(0.1 * 0.5 + 0.2 + 0.3 + 0.4 * 0.9)
    assert cell.failure.value == pytest.approx(0.05)
    assert cell.bad.value == pytest.approx(0.04)
    assert cell.bad_cases == 1
    assert cell.operations == pytest.approx(0.1 * 20 + 0.9 * 10)
    assert [row["stars"] for row in cell.by_stratum] == [[3, 3], [4, 4], [5, 6], [10, 99]]


def test_right_and_wrong_among_false_stars():
    cell = false_stars._cell(
        [
            attempt(SUCCESS),
            attempt(SUCCESS, Reason.UNCONFIRMED),  # no valid attitude: neither
            attempt(BAD, Reason.UNCONFIRMED),
            attempt(FAILURE, Reason.AMBIGUOUS),
            attempt(BAD),
        ]
    )
    assert (cell.right, cell.wrong, cell.cases) == (1, 1, 5)


def test_the_best_is_the_one_that_is_never_wrong():
    cells = {
        (name, field, false): false_stars.Cell(right, wrong, 200, 100.0, 1.0, 1.0)
        for name, right, wrong in (
            ("pyramid", 190, 0),
            ("brightness_referenced", 200, 1),
            ("geometric_voting", 195, 0),
            ("multi_poles", 195, 0),
        )
        for field in (0, 1)
        for false in false_stars.FALSE_STARS
    }
    assert false_stars.best_algorithm(cells) in ("geometric_voting", "multi_poles")
    cells["multi_poles", 1, 50] = dataclasses.replace(cells["multi_poles", 1, 50], right=196)
    assert false_stars.best_algorithm(cells) == "multi_poles"


def test_fields():
    wide, narrow = false_stars.FIELDS
    assert wide.noise_arcsec == pytest.approx(5.0, abs=0.05)
    assert narrow.pixel_arcsec == pytest.approx(26.4, abs=0.1)
    for field in (wide, narrow):
        angles = np.arccos(field.tables().pairs.cos_angle)
        assert np.degrees(angles.max()) == pytest.approx(field.field_deg * np.sqrt(2), rel=0.02)


def test_table_3_with_few_cases(workers):
    request = CampaignRequest(load_unit("zy3"), 60, 5, workers(1))
    result = zy3_table3.run(request)
    rows = {
        (row["algorithm"], row["scenario"], row["magnitude_noise"]): row for row in result.figures["rows"]
    }
    assert len(rows) == len(ALGORITHMS) * 3 * 2
    for (name, scenario, _), row in rows.items():
        shares = [row[verdict]["value"] for verdict in (SUCCESS, FAILURE, BAD)]
        assert sum(shares) == pytest.approx(1.0)
        assert row["bad_cases"] == 0, (name, scenario)
        if name in ("brightness_referenced", "geometric_voting"):
            assert row["success"]["high"] > zy3_table3.paper_success(name, 0).low
    assert result.figures["operations_ratio_geometric_voting"] >= 35
    assert {check.name for check in result.checks} >= {"bad: brightness", "pyramid, 1 of >= 5, flight"}
    assert [table.title for table in result.tables] == [item.name for item in SCENARIOS]


def test_few_attitudes_among_false_stars(workers):
    result = false_stars.run(CampaignRequest(load_unit("zy3"), 8, 5, workers(1)))
    assert [check.name for check in result.checks if not check.holds] == []
    assert sum(row["wrong"] for row in result.figures["rows"]) == 0
    assert len(result.figures["rows"]) == len(ALGORITHMS) * 2 * 4
