"""The figures that the units are held to, on fewer cases than the campaigns' own defaults."""

from __future__ import annotations

import pytest
from rich.console import Console

from st_emulator.campaigns.campaign import CampaignRequest, CampaignResult
from st_emulator.campaigns.registry import campaigns
from st_emulator.campaigns.tracking_rate import turn
from st_emulator.campaigns.workers import Progress, Workers
from st_emulator.firmware_model.reasons import Reason
from st_emulator.units.profile import load_unit


def campaign(name: str, unit: str, n: int) -> CampaignResult:
    with Progress(Console(quiet=True), name) as progress:
        return campaigns()[name].run(CampaignRequest(load_unit(unit), n, 11, Workers(1, progress)))


@pytest.mark.parametrize(("unit", "arcsec"), [("roja1", 0.61), ("zy3", 1.67), ("aps_rs", 2.0)])
def test_accuracy(unit: str, arcsec: float) -> None:
    figures = campaign("accuracy", unit, 15).figures
    assert figures["tracked"] == 15
    assert figures["cross_boresight_arcsec_median"] <= arcsec


@pytest.mark.parametrize(("unit", "coverage"), [("roja1", 0.75), ("zy3", 0.99), ("aps_rs", 0.99)])
def test_lost_in_space(unit: str, coverage: float) -> None:
    figures = campaign("lost-in-space", unit, 200).figures
    assert figures["wrong"] == 0
    assert figures["eligible_right"] >= 0.995 * figures["eligible"]
    assert figures["coverage"] >= coverage
    assert figures["right"] + figures["wrong"] + figures["unsolved"] == 200


@pytest.mark.parametrize("unit", ["roja1", "zy3", "aps_rs"])
def test_tracking_holds_at_the_largest_rate_and_is_lost_over_it(unit: str) -> None:
    figures = campaign("tracking-rate", unit, 26).figures
    assert (figures["held_at_rate"], figures["lost_over_rate"], figures["back_in_time"]) == (26, 26, 26)
    assert figures["worst_valid_error_px"] < 2.0


def test_a_rate_over_the_windows_is_told_where_they_still_hold_stars() -> None:
    """Direction 20: at 1.5 times the rate enough of the stars stay in their windows for right attitudes."""
    outcome = turn(load_unit("aps_rs"), 1, 20)
    assert outcome.lost
    assert Reason(outcome.reasons) & Reason.RATE_TOO_HIGH


def test_centroids() -> None:
    figures = campaign("centroids", "roja1", 40).figures
    assert figures["stars"] > 50
    assert figures["centroid_rms_px"] <= 0.04
    assert figures["centroid_rms_px_faintest_bin"] <= 0.04


def test_detection() -> None:
    figures = campaign("detection", "roja1", 150).figures
    assert figures["stars_at_limit"] > 200
    assert 0.4 <= figures["share_detected_at_limit"] <= 0.6
    assert figures["false_clusters_per_frame"] <= 1


def test_earth_rate() -> None:
    figures = campaign("earth-rate", "roja1", 200).figures
    assert figures["attitudes"] > 780
    assert figures["rate_error_deg_s"] <= 4e-6


def test_the_papers_star_quadruples_are_identified() -> None:
    figures = campaign("star-quadruples", "roja1", 3).figures
    assert figures["identified"] == 3
    assert all(row["edge_distance_px"] > 5 for row in figures["quadruples"])
