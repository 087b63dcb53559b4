"""Our flight computer on its serial line."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.st_link("pty")
TURNS_FAST_FROM_4_S = {
    "kind": "slew", "ra_deg": 83.0, "dec_deg": -3.0,
    "segments": [
        {"kind": "hold", "duration_s": 4.0},
        {"kind": "rate", "duration_s": 3.0, "rate_deg_s": [0.0, 15.0, 0.0], "ramp_s": 0.0},
        {"kind": "hold", "duration_s": 60.0},
    ],
}  # fmt: skip


@pytest.mark.st_off
def test_it_points_within_five_seconds_of_power_on(star_tracker, flight, bench):
    bench.never(lambda: flight.said != ["LISTENING"], for_s=0.5)
    star_tracker.power_on()
    bench.within(5, lambda: flight.state == "POINTING")
    assert star_tracker.mode == "TRACKING"


def test_the_attitudes_that_it_uses_are_true(flight, bench, truth):
    bench.until(lambda: len(flight.attitudes) > 8)
    for frame, quaternion in flight.attitudes:
        assert truth(frame).error_arcsec(quaternion) < 150


def test_it_goes_safe_when_the_tracker_falls_silent_and_comes_back(flight, bench, faults):
    bench.until(lambda: flight.state == "POINTING")
    faults.inject("line.frames_lost", duration_s=5)
    bench.within(4, lambda: "SAFE silence" in flight.said)
    bench.within(8, lambda: flight.state == "POINTING")


@pytest.mark.st_fault("line.bits_flipped", probability=2e-3, start_s=1, duration_s=4)
def test_a_damaged_frame_is_never_used(flight, bench, truth):
    bench.until(lambda: flight.said.count("BAD") >= 3)
    bench.within(10, lambda: flight.state == "POINTING")
    for frame, quaternion in flight.attitudes:
        assert truth(frame).error_arcsec(quaternion) < 150


@pytest.mark.st_scenario(trajectory=TURNS_FAST_FROM_4_S)
def test_it_goes_safe_in_a_turn_that_is_too_fast(flight, bench):
    bench.within(5, lambda: flight.state == "POINTING")
    bench.within(5, lambda: "SAFE invalid" in flight.said)
    bench.within(6, lambda: flight.state == "POINTING")
