"""What we require of any star tracker, in virtual time: a minute of its life in the blink of an eye."""

from __future__ import annotations


def test_it_answers_within_20_ms_for_a_minute(obc, bench):
    for _ in range(60):
        assert obc.ping() < 0.020
        bench.run(1)


def test_it_never_leaves_standby_by_itself(star_tracker, obc, bench):
    bench.never(lambda: star_tracker.mode != "STANDBY", for_s=3600)


def test_an_attitude_within_three_seconds(star_tracker, obc, bench, truth):
    obc.set_time()
    obc.acquire(timeout_s=3)
    report = obc.next("attitude_report").fields
    assert truth(report["frame_index"]).error_arcsec(report) < 60
