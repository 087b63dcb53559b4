"""Cyclic frames beside the packets: only on a CAN bus."""

from __future__ import annotations

import math

import pytest

from .conftest import STANDBY, Wire

pytestmark = pytest.mark.st_link("can")


def test_the_heart_beats(line: Wire, obc) -> None:
    period_s = line.profile.can.heartbeat_ms / 1000
    first = obc.wait_for_cyclic("heartbeat", timeout_s=2 * period_s)
    second = obc.wait_for_cyclic("heartbeat", timeout_s=2 * period_s)
    assert first.values["mode"] == second.values["mode"] == STANDBY
    assert (second.values["counter"] - first.values["counter"]) % 256 == 1


def test_the_halves_make_the_reports_attitude(line: Wire, obc) -> None:
    line.acquire()
    line.run(4 * line.period_s)
    reports = {fields["frame_index"] & 0xFF: fields for fields in line.of("attitude_report")}
    seen = obc.cyclic_attitudes()
    assert len(seen) >= 3
    for attitude in seen[:-1]:
        fields = reports[attitude.counter]
        for axis, part in zip("xyzw", attitude.q_icrs_to_sensor, strict=True):
            assert part == pytest.approx(fields[f"q_{axis}"], abs=2.0**-26)
        assert math.hypot(*attitude.q_icrs_to_sensor) == pytest.approx(1, abs=1e-7)


def test_time_comes_by_sync(line: Wire, obc) -> None:
    obc.set_time_by_sync()
    (event,) = line.events("TIME_SET")
    told = obc.time_at_sync(obc.sync())
    assert 0 <= told.to_ns() / 1e9 - event["new"][0] < 2
