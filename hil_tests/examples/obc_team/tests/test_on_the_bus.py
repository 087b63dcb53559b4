"""Our flight computer on the spacecraft's CAN bus."""

from __future__ import annotations

import pytest

pytestmark = [pytest.mark.vcan, pytest.mark.st_link("can:socketcan/vcan0")]


def test_it_points_by_cyclic_frames(flight, bench, truth):
    bench.within(5, lambda: flight.state == "POINTING")
    bench.until(lambda: len(flight.attitudes) > 8)
    for frame, quaternion in flight.attitudes[:8]:
        assert truth(frame).error_arcsec(quaternion) < 150


def test_a_power_cut_makes_it_safe_until_the_tracker_is_back(star_tracker, flight, bench):
    bench.until(lambda: flight.state == "POINTING")
    star_tracker.power_off()
    bench.within(4, lambda: flight.state == "SAFE silence")
    star_tracker.power_on()
    bench.within(5, lambda: flight.state == "POINTING")


def test_it_hears_its_own_of_two_trackers(star_tracker, flight, start, bench):
    other = bench.unit()
    backup = start(other)
    bench.until(lambda: flight.state == backup.state == "POINTING")
    star_tracker.power_off()
    bench.within(4, lambda: flight.state == "SAFE silence")
    bench.never(lambda: backup.state != "POINTING", for_s=1)
