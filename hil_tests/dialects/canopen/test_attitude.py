"""TPDO 3, 4 and 5: each solved image, in their order, right against the truth."""

from __future__ import annotations

import struct

import erfa
import numpy as np
import pytest

from hil_tests.dialects.canopen.bench import MS, START_UNIX_S, make
from hil_tests.dialects.canopen.client import STATES
from st_emulator.bench.scenario import InertialTrajectory, Scenario
from st_emulator.device.commands import SetParameters


@pytest.mark.parametrize("name", ["roja1", "zy3"])
def test_right_within_the_units_accuracy(name):
    bench = make(name).boot()
    bench.set_time()
    bench.ask_for("STAR_TRACK")
    bench.run(3000)
    found = bench.attitudes
    assert len(found) >= 9
    errors = bench.errors_arcsec(found)
    assert max(errors) < 3
    assert np.median(errors) < bench.emulator.profile.requirements.cross_boresight_arcsec
    assert {one.status for one in found} == {STATES["STAR_TRACK"]}
    assert {one.known for one in found} == {1}
    for one in found:
        assert np.linalg.norm((one.i, one.j, one.k, one.real)) == pytest.approx(1, abs=1e-6)


def test_one_of_each_frame_and_in_the_order_of_the_standard():
    bench = make().boot()
    bench.ask_for("STAR_TRACK")
    bench.run(400)
    bench.forget()
    bench.run(2500)
    times = np.array([one.t_ns for one in bench.attitudes])
    assert len(times) == 10
    assert np.all(np.abs(np.diff(times) - 250 * MS) < 5 * MS)
    attitude = {0x3AC, 0x4AC, 0x1AD}
    order = [identifier for _, identifier, _ in bench.sent if identifier in attitude]
    assert order == [0x3AC, 0x4AC, 0x1AD] * 10
    assert bench.of(0x1AC) == []  # TPDO 1 comes each 30 s


def test_none_where_nothing_is_solved_and_the_quirk_of_attitude_known():
    for stays in (True, False):
        bench = make(attitude_known_stays=stays).boot()
        bench.ask_for("STAR_TRACK")
        bench.run(1000)
        assert bench.sdo.number(0x4002, 6) == 1
        # Every pixel counts as blinded from the next exposure on.
        bench.emulator.device.execute(SetParameters({"blinded_background_dn": 1}))
        bench.run(600)
        bench.forget()
        bench.run(1500)
        assert bench.attitudes == []
        assert bench.sdo.number(0x4002, 6) == int(stays)


def sun_deg(jd_tt: float) -> tuple[float, float]:
    """Right ascension and declination of the Sun, by ERFA's epv00."""
    heliocentric, _ = erfa.epv00(jd_tt, 0.0)
    x, y, z = -np.asarray(heliocentric["p"])
    return float(np.degrees(np.arctan2(y, x)) % 360), float(np.degrees(np.arctan2(z, np.hypot(x, y))))


@pytest.mark.parametrize("name", ["roja1", "zy3"])
def test_blinded_by_the_sun(name):
    ra, dec = sun_deg(2461055.5)  # 2026-01-15
    near = Scenario(trajectory=InertialTrajectory(ra_deg=ra, dec_deg=dec + 15))
    bench = make(name, scenario=near).boot()
    bench.ask_for("STAR_TRACK")
    bench.run(2000)
    assert bench.attitudes == []
    # FF01h; register 81h: manufacturer and generic.
    assert bench.emergencies == [bytes.fromhex("01ff 81 0000000000")]
    assert bench.sdo.number(0x1001) == 0x81
    assert bench.sdo.number(0x1003, 1) == 0xFF01


@pytest.mark.parametrize("delay", [250, 251, 600, 1000])
def test_the_delay_between_images(delay):
    bench = make().boot()
    bench.sdo.write(0x4001, 2, delay.to_bytes(4, "little"))
    bench.ask_for("STAR_TRACK")
    bench.run(5000)
    times = np.array([one.t_ns for one in bench.attitudes])
    expected = -(-delay // 250) * 250
    assert len(times) >= 4
    assert np.all(np.abs(np.diff(times)[1:] - expected * MS) < 25 * MS)


def test_a_delay_begins_anew_with_the_state():
    bench = make().boot()
    bench.sdo.write(0x4001, 2, (60_000).to_bytes(4, "little"))
    for count in (1, 2):
        bench.ask_for("STAR_TRACK")
        bench.run(1500)
        assert len(bench.attitudes) == count
        bench.ask_for("STANDBY")


def test_a_delay_of_0_tracks_once():
    bench = make().boot()
    bench.sdo.write(0x4001, 2, bytes(4))
    bench.ask_for("STAR_TRACK")
    bench.run(2000)
    assert len(bench.attitudes) == 1
    assert bench.state == STATES["STANDBY"]
    bench.ask_for("STAR_TRACK")
    bench.run(2000)
    assert len(bench.attitudes) == 2


def test_the_quirk_of_whole_seconds():
    bench = make().boot()
    bench.set_time()
    bench.ask_for("STAR_TRACK")
    bench.run(1500)
    for one in bench.attitudes:
        assert one.since_midnight == START_UNIX_S + (one.t_ns - 130 * MS) // 10**9
    bench = make(whole_seconds_since_midnight=False).boot()
    bench.set_time()
    bench.ask_for("STAR_TRACK")
    bench.run(1500)
    frame_ms = bench.emulator.profile.timing.frame_period_ms
    for one in bench.attitudes:
        # Mid-exposure is 50 ms behind a frame's start, and the date begins with virtual time.
        assert abs((one.since_midnight - 50 + frame_ms / 2) % frame_ms - frame_ms / 2) <= 1
        assert 60 < one.t_ns / MS - one.since_midnight < 260


def test_a_clock_that_was_not_set_starts_in_1970():
    bench = make().boot()
    bench.ask_for("STAR_TRACK")
    bench.run(1500)
    assert {one.since_midnight for one in bench.attitudes} <= {0, 1}


def matrix(q: np.ndarray) -> np.ndarray:
    """Rows are the sensor's axes in ICRS, by the sandwich with the three unit vectors."""
    u, w = q[:3], q[3]
    turned = [v - 2 * np.cross(u, w * v - np.cross(u, v)) for v in np.eye(3)]
    return np.array(turned).T


def first_quaternion(**settings: object) -> np.ndarray:
    bench = make(**settings).boot()
    bench.ask_for("STAR_TRACK")
    bench.run_until(lambda: bench.attitudes)
    one = bench.attitudes[0]
    return np.array((one.i, one.j, one.k, one.real))


def test_other_axes_and_the_other_direction():
    own = first_quaternion()
    turned = first_quaternion(boresight="x")
    x, y, z = matrix(own)
    assert matrix(turned) == pytest.approx(np.array((z, -x, -y)), abs=1e-6)
    back = first_quaternion(direction="sensor_to_icrs")
    assert matrix(back) == pytest.approx(matrix(own).T, abs=1e-6)


def test_by_sdo_the_same_as_by_pdo():
    bench = make().boot()
    bench.ask_for("STAR_TRACK")
    bench.run_until(lambda: bench.attitudes)
    bench.ask_for("STANDBY")
    one = bench.attitudes[-1]
    told = [struct.unpack("<f", bench.sdo.read(0x4002, sub))[0] for sub in (1, 2, 3, 5)]
    assert told == [one.i, one.j, one.k, one.real]
    assert bench.sdo.number(0x4002, 4) == one.since_midnight
    assert bench.sdo.number(0x4001, 6) == one.since_midnight  # the last solved image is the last capture


def test_a_processor_that_is_short_of_cycles():
    bench = make(parameters={"clock_hz": 24_000_000}).boot()
    bench.ask_for("STAR_TRACK")
    bench.run(20_000)
    codes = [message[:2] for message in bench.emergencies]
    assert codes[0] == b"\x02\xff"
    assert bench.sdo.number(0x1001) & 0x80
    # and it is told when it is over
    bench.emulator.device.execute(SetParameters({"clock_hz": 400_000_000}))
    bench.run(10_000)
    assert bench.emergencies[-1] == bytes(8)
    assert bench.sdo.number(0x1001) == 0
