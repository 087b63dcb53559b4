"""A unit and an OBC in one process share the clock and the date."""

from __future__ import annotations

import io
from datetime import UTC, datetime

import numpy as np
import pytest

from hil_tests.vectors import reference_decoder as wire
from st_emulator.bench.joined import JoinedBench
from st_emulator.bench.scenario import InertialTrajectory, Scenario
from st_emulator.tai import tai_ns_from_utc
from st_emulator.units.profile import load_unit
from st_emulator.wire.can.wiring import CanWiring

START = datetime(2026, 3, 20, 12, tzinfo=UTC)
SKY = Scenario(start_utc=START, trajectory=InertialTrajectory(ra_deg=84.0, dec_deg=-1.5, roll_deg=20.0))
ARCSEC = 180 / np.pi * 3600


def session(can: CanWiring | None) -> str:
    """The journal of a session that ends with attitudes; checks them on its way."""
    journal = io.StringIO()
    with JoinedBench(load_unit("roja1"), SKY, can=can, journal=journal) as bench:
        obc, emulator = bench.obc, bench.emulator
        obc.wait_for_event("BOOT_COMPLETED", timeout_s=2)
        assert obc.ping() < 0.02
        obc.set_time()
        obc.acquire(timeout_s=3)
        assert obc.now_ns() == emulator.now_ns
        assert emulator.scene is not None
        for _ in range(6):
            report = obc.next("attitude_report").fields
            assert report["valid"]
            onboard = report["mid_exposure_time"]
            mid_ns = report["frame_index"] * 250_000_000 + 50_000_000
            off_ns = onboard.to_ns() - (tai_ns_from_utc(START) + mid_ns)
            assert abs(off_ns) < 1_000_000, (
                "the time that the OBC has set is the sky's to under a millisecond"
            )
            truth = np.asarray(emulator.scene.trajectory.q_icrs_to_sensor(mid_ns))
            found = np.array([report[f"q_{name}"] for name in "xyzw"])
            error = 2 * np.arccos(min(1.0, abs(float(truth @ found)))) * ARCSEC
            assert error < 25, "about the boresight 20 times coarser; without the right date 20 more"
    return journal.getvalue()


@pytest.mark.parametrize("can", [None, CanWiring(), CanWiring(fd=True)], ids=["line", "can", "can fd"])
def test_the_same_twice_and_right(can: CanWiring | None) -> None:
    text = session(can)
    assert text == session(can)
    assert text.count('"rx"') >= 3


def test_the_obc_sees_octets_when_they_leave_the_unit() -> None:
    """Not on a grid of a millisecond."""
    with JoinedBench(load_unit("roja1"), SKY) as bench:
        bench.obc.wait_for_event("BOOT_COMPLETED", timeout_s=2)
        boot_ns = bench.emulator.profile.timing.boot_ms * 1_000_000
        packet = bench.obc.next("hk_report", timeout_s=3)
        sent = wire.slip_frame(packet.raw)
        rate_ns = 10 * 1_000_000_000 / bench.emulator.baud
        begun_ns = boot_ns + 1_000_000_000
        assert bench.emulator.now_ns == pytest.approx(begun_ns + len(sent) * rate_ns, abs=2)
