"""The campaign aps-figure12: the model by hand, the light of a trace, and a limit that is found again."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

from st_emulator.bench.world_of import camera_model
from st_emulator.campaigns import aps_figure12
from st_emulator.campaigns.aps_figure12 import (
    WINDOW_MAG,
    Cell,
    Counted,
    Limit,
    Traces,
    look,
    made_up_sky,
    model_mag,
    own_r_psf,
)
from st_emulator.campaigns.campaign import CampaignRequest
from st_emulator.report import plain
from st_emulator.units.profile import load_unit
from st_emulator.world.scene import SceneRenderer
from st_emulator.world.stars import StarField
from st_emulator.world.trajectory import ConstantRateTrajectory

PROFILE = load_unit("aps_rs")


def test_the_model_by_hand():
    """M (24)-(30) step by step: 5 deg/s across: 50.4 px, 151 px covered, 9,660 e- of magnitude 0 each."""
    pixel = 18e-6 / 0.052
    length = math.radians(5.0) * 0.2
    covered = 3.0 * length / pixel
    electrons = 7.3e6 * 0.2 / covered
    expected = 2.5 * math.log10(electrons / 500.0)
    assert covered == pytest.approx(151, abs=1)
    found = model_mag(PROFILE, 5.0, np.radians([90.0, 30.0, 0.0]))
    assert found[0] == pytest.approx(expected, abs=1e-3)
    assert found[0] == pytest.approx(3.21, abs=0.01)
    assert found[1] - found[0] == pytest.approx(2.5 * math.log10(2.0))
    assert found[2] == np.inf
    assert model_mag(PROFILE, 1.0, np.radians([90.0]))[0] - found[0] == pytest.approx(2.5 * math.log10(5.0))


@pytest.mark.parametrize("sigma", [0.6, 0.75, 1.1])
def test_own_r_psf_is_the_light_of_a_trace(sigma):
    """A rendered trace along the columns' axis, in the middle of a row: the brightest row's share."""
    camera = dataclasses.replace(
        camera_model(PROFILE),
        psf_sigma_px=sigma, dark_electrons_s=0.0, stray_electrons_s=0.0, rolling_readout_ns=0,
    )  # fmt: skip
    x, y = 512.0, 512.0
    direction = np.array([x - 511.5, y - 511.5, camera.focal_px])
    star = StarField(
        np.array([1], np.int32), direction[np.newaxis] / np.linalg.norm(direction),
        np.array([2.0], np.float32), np.zeros(1, np.float32), 2000.0,
    )  # fmt: skip
    # about the axis that the star's own column stands upright to, so that it stays in its row
    rate = np.radians(5.0) * np.cross(direction, [1.0, 0.0, 0.0]) / np.linalg.norm(direction)
    half = ConstantRateTrajectory(np.array([0.0, 0.0, 0.0, 1.0]), rate)
    scene = SceneRenderer(camera, star, half, aberration=False)
    light = scene.frame(0, -100_000_000).mean_electrons()
    total = 7.3e6 * 0.2 * 10 ** (-0.8)
    assert light.sum() == pytest.approx(total, rel=1e-2)
    inner = light[512, 500:524]
    assert inner.std() < 0.01 * inner.mean()
    per_px = total / (math.radians(5.0) * 0.2 * camera.focal_px)
    assert inner.mean() == pytest.approx(per_px / own_r_psf(sigma), rel=0.02)


def test_a_limit_is_found_again():
    rng = np.random.default_rng(1)
    for true in (0.1, 0.8, 1.4):
        excess = rng.uniform(*WINDOW_MAG, 4000)
        seen = rng.random(4000) < 1.0 / (1.0 + np.exp((excess - true) / 0.1))
        found = Limit.of([Counted.of(excess[:2000], seen[:2000]), Counted.of(excess[2000:], seen[2000:])])
        assert abs(found.excess_mag - true) < 1.5 * found.half
        assert found.half < 0.06
        assert (found.bright, found.faint) == pytest.approx((1.0, 0.0), abs=0.01)
    assert Limit.of([Counted.of(excess[:10], seen[:10])]) is None


@pytest.mark.parametrize("beta_deg", [30.0, 90.0])
def test_spots_lie_on_the_traces(beta_deg):
    """Bright stars are found where the traces are said to be, and none where there is no star."""
    bench = aps_figure12._bench(PROFILE.model_dump_json(), 1)
    axis = np.array([math.sin(math.radians(beta_deg)), 0.0, math.cos(math.radians(beta_deg))])
    scene = bench.noisy
    scene.trajectory = ConstantRateTrajectory(np.array([0.1, 0.7, 0.2, 0.68]), np.radians(4.0) * axis)
    frame = scene.frame(3, 0)
    traces = Traces.of(scene, frame, axis)
    row_time_s = scene.camera.row_time_s
    seen = traces.detected(frame, bench.ungated, row_time_s)
    bright = traces.hp_mag < model_mag(PROFILE, 4.0, traces.alpha_rad) - 0.5
    assert bright.sum() >= 5
    assert seen[bright].all()
    # the same places in another sky's image
    scene.trajectory = ConstantRateTrajectory(np.array([0.7, 0.1, 0.68, 0.2]), np.radians(4.0) * axis)
    other = traces.detected(scene.frame(4, 0), bench.ungated, row_time_s)
    assert other[bright].mean() < 0.3


def test_the_made_up_sky_is_even():
    sky = made_up_sky(1)
    assert np.all(np.abs(sky.unit_vectors.mean(axis=0)) < 0.03)
    counts, _ = np.histogram(sky.hp_mag, bins=5)
    assert counts.min() > 0.85 * counts.max()


def test_an_image_does_not_depend_on_those_before():
    cell, other = Cell(90.0, 3.0, 1), Cell(30.0, 5.0, 0)
    profile = PROFILE.model_dump_json()
    first = look(profile, 1, 2, cell)
    look(profile, 1, 2, other)
    again = look(profile, 1, 2, cell)
    np.testing.assert_array_equal(first.noisy.detected, again.noisy.detected)
    assert first.faintest_mag == again.faintest_mag
    assert first.noisy.stars.sum() > 10


def test_few_cells(monkeypatch, workers, tmp_path):
    monkeypatch.setattr(aps_figure12, "BETAS_DEG", (30, 90))
    monkeypatch.setattr(aps_figure12, "RATES_DEG_S", (2.0, 5.0))
    result = aps_figure12.run(CampaignRequest(PROFILE, 4, 1, workers(1)))
    assert [item.name for item in result.checks if not item.holds] == []
    assert len(result.figures["rows"]) == 4
    for table in result.tables:
        assert table.rows
        assert all(len(row) == len(table.columns) for row in table.rows)
    for row in result.figures["rows"]:
        assert row["model_nearest_mag"] <= 6.0
    json.dumps(plain(result.figures))
    from st_emulator.campaigns.plotting import write_plot

    write_plot(tmp_path / "figure12.png", result.draw)
    assert (tmp_path / "figure12.png").stat().st_size > 20_000
