"""Attitude reports: what they say of themselves, and, where somebody knows it, whether it is true."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from .conftest import TRACKING, Wire

TURNING = {
    "kind": "constant_rate", "ra_deg": 83.0, "dec_deg": -3.0, "rate_deg_s": [0.05, -0.1, 0.2],
}  # fmt: skip


def quaternion(fields) -> list[float]:
    return [fields[f"q_{axis}"] for axis in "xyzw"]


def test_one_a_frame_each_of_unit_norm(line: Wire) -> None:
    line.acquire()
    line.forget()
    line.await_(lambda: len(line.of("attitude_report")) >= 6)
    reports = line.of("attitude_report")
    frames = [fields["frame_index"] for fields in reports]
    assert frames == list(range(frames[0], frames[0] + len(frames)))
    for fields in reports:
        assert (fields["valid"], fields["mode"], fields["reasons"]) == (1, TRACKING, 0)
        assert math.hypot(*quaternion(fields)) == pytest.approx(1, abs=1e-9)
        assert fields["stars_identified"] >= 3
        assert all(fields[f"covariance_{axis}{axis}"] > 0 for axis in "xyz")
        assert fields["covariance_zz"] > fields["covariance_xx"], "coarser about the boresight"


def test_exposures_are_a_frame_period_apart(line: Wire) -> None:
    line.acquire()
    line.forget()
    line.await_(lambda: len(line.of("attitude_report")) >= 5)
    times = [time[0] + time[1] / 2**24 for time in
             (fields["mid_exposure_time"] for fields in line.of("attitude_report"))]  # fmt: skip
    steps = [later - earlier for earlier, later in pairwise(times)]
    assert steps == [pytest.approx(line.period_s, abs=1e-5)] * len(steps)


def test_the_report_can_be_turned_off(line: Wire, keeping_parameters) -> None:
    line.acquire()
    keeping_parameters({17: 0})
    line.run(2 * line.period_s)
    line.forget()
    line.run(4 * line.period_s)
    assert line.of("attitude_report") == []
    assert line.mode() == TRACKING


@pytest.mark.st_scenario(trajectory=TURNING)
def test_attitudes_and_rates_are_true(line: Wire, obc, truth) -> None:
    obc.set_time()  # before it is, aberration is not corrected: 20 arcsec
    line.acquire()
    line.forget()
    line.await_(lambda: len([fields for fields in line.of("attitude_report") if fields["rate_valid"]]) >= 4)
    for fields in line.of("attitude_report"):
        true = truth(fields["frame_index"])
        assert true.error_arcsec(fields) < 100  # about the boresight 20 times coarser than across it
        if fields["rate_valid"]:
            for axis, rate_rad_s in zip("xyz", true.rate_rad_s, strict=True):
                assert fields[f"rate_{axis}"] == pytest.approx(rate_rad_s, abs=math.radians(0.02))


def test_a_hint_is_taken(line: Wire) -> None:
    line.acquire()
    last = line.of("attitude_report")[-1]
    count = line.function("TRACK_FROM", {f"q_{axis}": last[f"q_{axis}"] for axis in "xyzw"})
    assert line.await_end(count) == ["acceptance_success", "start_success", "completion_success"]
