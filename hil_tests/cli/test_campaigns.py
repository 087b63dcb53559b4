"""`st-emulator campaign` with few cases: figures and checks complete, the same on any number of processes."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time

import pytest

from st_emulator.campaigns.registry import CAMPAIGNS, campaigns
from st_emulator.units.profile import load_unit

KEYS = {
    "accuracy": {"cross_boresight_arcsec_median", "cross_boresight_arcsec_p95"},
    "aps": {"runs", "wrong", "centroids", "speeds", "attitudes", "success"},
    "aps-best": {"runs", "wrong", "centroids", "speeds", "attitudes", "success"},
    "aps-figure12": {"rows", "r_psf", "own_r_psf", "own_mag"},
    "catalogue-counts": {"stars_under_5_mag", "pairs_under_20_deg", "reason", "by_magnitude"},
    "centroids": {"centroid_rms_px", "stars", "by_magnitude"},
    "detection": {"share_detected_at_limit", "false_clusters_per_frame", "by_magnitude"},
    "earth-rate": {"rate_error_deg_s", "rate_deg_s", "right_ascension_drift_deg_s"},
    "false-stars": {"best", "rows", "timing"},
    "iris-tables": {"settings", "exponent_of_stars", "exponent_of_ifov"},
    "lost-in-space": {"eligible", "right", "wrong", "unsolved", "coverage"},
    "star-quadruples": {"identified", "quadruples"},
    "tracking-rate": {"held_at_rate", "lost_over_rate", "back_in_time", "by_direction"},
    "zy3-table3": {"rows", "operations_ratio_pyramid", "operations_ratio_geometric_voting", "timing"},
    "zy3-centroids": {"tracks", "com_better_than_two_pixels_near_2.9_mag", "paper", "by_magnitude"},
}
SMALL = {
    "accuracy": 2,
    "aps-figure12": 1,
    "centroids": 4,
    "detection": 4,
    "earth-rate": 6,
    "false-stars": 2,
    "lost-in-space": 6,
    "tracking-rate": 2,
    "zy3-centroids": 2,
    "zy3-table3": 5,
}
# One attitude is 262 runs of up to 60 images, one of the display a hundred: hil_tests/campaigns has fewer.
LONG = {"aps", "aps-best", "iris-tables"}


def run(command, name: str, *more: str) -> tuple[int, dict]:
    count = ("--n", str(SMALL[name])) if name in SMALL else ()
    outcome = command("campaign", name, *count, "--json", "-", *more)
    assert outcome.status in (0, 1), outcome.err
    return outcome.status, json.loads(outcome.out)  # standard output holds nothing else


def test_every_campaign_has_its_row():
    assert set(CAMPAIGNS) == set(campaigns()) == set(KEYS)


@pytest.mark.parametrize("name", sorted(set(KEYS) - LONG))
def test_figures_and_checks(name, command):
    status, figures = run(command, name, "--workers", "1")
    assert figures["campaign"] == name
    assert figures["unit"] == (campaigns()[name].unit or "roja1")
    assert figures["seed"] == 1
    assert set(figures) >= KEYS[name]
    assert figures["checks"]
    for check in figures["checks"]:
        assert set(check) == {"name", "value", "target", "unit", "holds"}
        assert isinstance(check["holds"], bool)
        word, target = check["target"].split()
        value = check["value"]
        holds = value is not None and {"<=": value <= float(target), ">=": value >= float(target)}.get(
            word, value == float(target)
        )
        assert check["holds"] == holds, check
    assert status == (0 if all(check["holds"] for check in figures["checks"]) else 1)


def test_figures_do_not_depend_on_the_number_of_processes(command):
    one = run(command, "lost-in-space", "--workers", "1", "--seed", "3")[1]
    two = run(command, "lost-in-space", "--workers", "2", "--seed", "3")[1]
    other = run(command, "lost-in-space", "--workers", "1", "--seed", "4")[1]
    for figures in (one, two, other):
        figures.pop("elapsed_s")
    assert one == two
    assert one["cross_boresight_arcsec_median"] != other["cross_boresight_arcsec_median"]


def test_lost_in_space_counts_add_up(command):
    _, figures = run(command, "lost-in-space", "--unit", "zy3")
    assert figures["right"] + figures["wrong"] + figures["unsolved"] == figures["n"] == 6
    assert figures["coverage"] == figures["right"] / 6
    assert figures["eligible"] >= figures["eligible_right"]


def test_earth_rate_fit_recovers_a_known_rotation():
    import numpy as np
    from scipy.spatial.transform import Rotation

    from st_emulator.campaigns.earth_rate import fitted_rotation_deg_s

    t_s = np.arange(0, 200, 0.25)
    rate = np.array([0.001, -0.003, 0.0026])
    start = Rotation.from_rotvec([0.3, -1.2, 0.4])
    # A sensor that turns by rate in its own axes: body to ICRS grows from the right; ours is its inverse.
    body_to_icrs = start * Rotation.from_rotvec(np.radians(rate) * t_s[:, None])
    fitted = fitted_rotation_deg_s(t_s, body_to_icrs.as_quat())
    assert np.linalg.norm(fitted) == pytest.approx(np.linalg.norm(rate), rel=1e-6)


def test_a_unit_that_sees_nothing_fails_and_does_not_crash(command, tmp_path):
    from importlib import resources

    text = (resources.files("st_emulator") / "units/roja1.toml").read_text(encoding="utf-8")
    unit = tmp_path / "blind.toml"
    unit.write_text(text.replace("aperture_mm = 30.0", "aperture_mm = 0.5"))
    for name in ("accuracy", "centroids", "detection", "earth-rate", "lost-in-space", "star-quadruples"):
        status, figures = run(command, name, "--unit", str(unit), "--workers", "1")
        assert status == 1, name
        assert not all(check["holds"] for check in figures["checks"])


def test_a_field_too_poor_for_the_test_of_windows_is_refused(refused, tmp_path):
    from importlib import resources

    text = (resources.files("st_emulator") / "units/roja1.toml").read_text(encoding="utf-8")
    unit = tmp_path / "poor.toml"
    unit.write_text(text.replace("limit_mag = 6.9 ", "limit_mag = 4.0 "))
    refused("campaign", "tracking-rate", "--n", "1", "--unit", unit, says=("9 catalogue stars", "limit_mag"))


def test_units_of_the_requirements():
    assert load_unit("roja1").requirements.cross_boresight_arcsec == 0.61
    assert load_unit("zy3").requirements.cross_boresight_arcsec == 1.67
    assert load_unit("roja1").requirements.lost_in_space_coverage == 0.75
    assert load_unit("zy3").requirements.lost_in_space_coverage == 0.99


def test_an_interrupt_of_the_whole_process_group_ends_a_campaign_at_once():
    """As Ctrl-C in a terminal does: each process of the group gets it; none goes on or prints a traceback."""
    arguments = ("campaign", "lost-in-space", "--n", "100000", "--workers", "2")
    process = subprocess.Popen(
        [sys.executable, "-m", "st_emulator", *arguments],
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        time.sleep(4.0)  # well into its cases; any other moment must do as well
        os.killpg(process.pid, signal.SIGINT)
        said, _ = process.communicate(timeout=20)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 130
    assert "Traceback" not in said
