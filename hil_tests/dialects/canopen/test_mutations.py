"""Nothing that a bus can bring makes the unit raise, and the next good command is answered."""

from __future__ import annotations

from hil_tests.dialects.canopen.mutations import mutate


def test_twenty_thousand_spoilt_frames():
    report = mutate(20_000, seed=1)
    assert report.frames == 20_000
    assert report.checks == 200
    assert report.sent > 2000
    assert report.resets > 0
