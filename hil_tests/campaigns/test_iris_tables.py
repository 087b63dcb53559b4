"""The rate tables of the optical-flow paper, reduced: fewer frames, one run a case."""

from __future__ import annotations

import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from st_emulator.campaigns import iris_tables
from st_emulator.campaigns.campaign import CampaignRequest
from st_emulator.campaigns.iris_tables import CASES, MAIN, SCALING, Run, pooled
from st_emulator.campaigns.outcome_codec import decode, encode, outcome_type
from st_emulator.units.profile import load_unit
from st_emulator.world.quaternion import attitude_matrix
from st_emulator.world.zenith_orbit import ORBIT_RATE_DEG_S, ZenithOrbit


def run_of(errors: np.ndarray, sigma: float, stars: float, without: int = 0) -> Run:
    return Run(errors, np.full(errors.shape, sigma), stars, 9.0, 0.12, without)


def test_a_run_without_rates_does_not_make_the_others_stars_fewer() -> None:
    """It did: the law of the number of stars then had an exponent of -1.28."""
    errors = np.random.default_rng(1).normal(0.0, 1e-3, (50, 3))
    found = pooled([run_of(errors, 1e-3, 20.0), Run(np.empty((0, 3)), np.empty((0, 3)), 0.0, 0.0, 0.0, 50)])
    assert found is not None
    assert (found.stars, found.pixels, found.off_axis_rad) == (20.0, 9.0, 0.12)
    assert (found.rates, found.without) == (50, 50)


def test_errors_are_pooled_over_runs() -> None:
    chance = np.random.default_rng(2)
    runs = [run_of(chance.normal(0.01 * (k % 2), 1e-3, (200, 3)), 1e-3, 10.0 + k) for k in range(6)]
    found = pooled(runs)
    assert found is not None
    assert found.mean == pytest.approx(np.full(3, 0.005), abs=3e-4)
    assert found.std == pytest.approx(np.full(3, np.hypot(0.005, 1e-3)), rel=0.05)
    assert found.standard_error == pytest.approx(np.full(3, 0.005 / np.sqrt(5.0)), rel=0.1)
    assert found.within_3_sigma == pytest.approx(0.5, abs=0.02)
    assert pooled([run_of(np.empty((0, 3)), 1.0, 0.0, 100)]) is None


@pytest.mark.parametrize("case", range(4))
def test_the_orbit_is_that_of_the_papers_table_3(case: int) -> None:
    turn = CASES[case].turn_deg_s
    orbit = ZenithOrbit(40.0, turn)
    rate = np.degrees(orbit.rate_sensor(np.array([0])))[0]
    assert rate == pytest.approx([turn[0], -ORBIT_RATE_DEG_S, turn[2]], abs=1e-12)
    boresight = attitude_matrix(orbit.q_icrs_to_sensor(np.array([0]))[0])[2]
    assert boresight == pytest.approx([np.cos(np.radians(40.0)), np.sin(np.radians(40.0)), 0.0], abs=1e-12)
    # the rate is that of the attitude
    step_ns = 1_000_000
    before, after = (attitude_matrix(orbit.q_icrs_to_sensor(np.array([t]))[0]) for t in (-step_ns, step_ns))
    turned = (after - before) @ attitude_matrix(orbit.q_icrs_to_sensor(np.array([0]))[0]).T / 2e-3
    assert np.degrees([turned[1, 2], turned[2, 0], turned[0, 1]]) == pytest.approx(rate, abs=1e-3)


@pytest.mark.slow
def test_a_reduced_campaign(monkeypatch: pytest.MonkeyPatch) -> None:
    """31 frames of one run a case, by the calling process: standard deviations within the paper's, both
    sources; the display costs accuracy where stars stand still on its pixels; F's laws roughly.
    """
    monkeypatch.setattr(iris_tables, "FRAMES", 31)
    kept: list[Any] = []

    def map_here(function: Callable[[int], Any], cases: range) -> list[Any]:
        kept.extend(function(case) for case in cases)
        return kept

    here: Any = SimpleNamespace(map=map_here)
    result = iris_tables.run(CampaignRequest(load_unit("iris"), n=1, seed=1, workers=here))
    names = [check.name for check in result.checks]
    assert len(names) == len(set(names)) == 2 * 4 * 7 + 4 + 6
    short = [check for check in result.checks if not check.holds and " std" in check.name]
    assert short == []
    by_setting = {
        (row["case"], row["source"]): row
        for row in result.figures["settings"]
        if not row["paper_way"] and row["by_chance"] is None
    }
    assert len(result.figures["settings"]) == len(MAIN) + len(SCALING)
    for axis in (0, 1):
        shown, seen = (by_setting[3, source]["std_deg_s"][axis] for source in ("display", "sky"))
        assert shown > 1.1 * seen
    assert all(row["rates"] == 30 for row in by_setting.values())
    assert -0.9 < result.figures["exponent_of_stars"] < -0.2
    assert 0.6 < result.figures["exponent_of_ifov"] < 1.4
    # and a run that is interrupted goes on with the outcomes that are kept
    again = decode(outcome_type(iris_tables.run_once), json.loads(json.dumps(encode(kept[0]))))
    assert all(isinstance(run, Run) for run in again)
    assert [run.errors_deg_s.tolist() for run in again] == [run.errors_deg_s.tolist() for run in kept[0]]
