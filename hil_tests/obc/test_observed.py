"""Telemetry as numbers and names to work with."""

import struct
from datetime import datetime
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from st_emulator.naming import event_text, member, name_of, resolve_fields
from st_emulator.obc import Attitude, Mode, Obc, Reason
from st_emulator.obc.cuc_time import utc_from_cuc
from st_emulator.protocol.pus.enumerations import EventId, ParameterId
from st_emulator.protocol.pus.packets import CucTime
from st_emulator.protocol.pus.registry import parse_telemetry
from st_emulator.tai import tai_ns_from_utc
from st_emulator.world.quaternion import pointing_from_quaternion


def test_attitudes_as_numbers(obc: Obc, unit: Any) -> None:
    q = (0.5, -0.5, 0.5, 0.5)
    unit.attitude(frame=7, q=q, rate=(0.25, -0.5, 1.0))
    unit.attitude(frame=8, valid=0, reasons=3, rate=None, mode=3, late=1)
    obc.wait(0.01)
    first, second = obc.attitudes()
    assert (first.frame_index, first.mode, first.valid, first.reasons) == (7, Mode.TRACKING, True, Reason(0))
    assert first.time_ns == 2_000_000_000_500_000_000
    np.testing.assert_array_equal(first.q_icrs_to_sensor, q)
    # The fake unit sends xx, xy, xz, yy, yz, zz in this order.
    expected = np.array([[1e-12, 2e-13, 3e-13], [2e-13, 4e-12, 5e-13], [3e-13, 5e-13, 6e-11]])
    np.testing.assert_allclose(first.covariance_rad2, expected, rtol=1e-7)
    np.testing.assert_array_equal(first.rate_rad_s, [0.25, -0.5, 1.0])
    assert (first.spots_detected, first.stars_identified, first.window_half_width_px) == (20, 12, 9)
    assert (first.cycles, first.latency_us, first.residual_rms_arcsec) == (12_345_678, 150_000, 0.25)
    assert second.rate_rad_s is None
    assert second.late
    assert second.reasons == Reason.TOO_FEW_STARS | Reason.NO_MATCH
    assert obc.unit.frames_by_mode == {4: 1, 3: 1}


RATE_COVARIANCE = (4.0, 0.5, -0.25, 9.0, 0.125, 16.0)  # xx, xy, xz, yy, yz, zz


def test_the_accuracy_of_the_rate(obc: Obc, unit: Any) -> None:
    rate = (0.25, -0.5, 1.0)
    unit.attitude(frame=1, valid=0, reasons=8, mode=7, rate=rate, rate_covariance=RATE_COVARIANCE)
    unit.attitude(frame=2, rate=rate)
    unit.attitude(frame=3, rate=None, rate_covariance=RATE_COVARIANCE)
    unit.attitude(frame=4, rate=rate, rate_covariance=(-1.0, *RATE_COVARIANCE[1:]))
    obc.wait(0.01)
    alone, bare, none, wrong = obc.attitudes()
    assert (alone.mode, alone.valid) == (Mode.RATE_ONLY, False)
    np.testing.assert_array_equal(alone.rate_rad_s, rate)
    np.testing.assert_array_equal(
        alone.rate_covariance_rad2_s2, [[4.0, 0.5, -0.25], [0.5, 9.0, 0.125], [-0.25, 0.125, 16.0]]
    )
    np.testing.assert_array_equal(alone.rate_sigma_rad_s, [2.0, 3.0, 4.0])
    assert bare.rate_rad_s is not None
    assert (bare.rate_covariance_rad2_s2, bare.rate_sigma_rad_s) == (None, None)
    assert none.rate_covariance_rad2_s2 is None, "of a rate that is not valid"
    np.testing.assert_array_equal(wrong.rate_sigma_rad_s, [np.nan, 3.0, 4.0])
    assert obc.unit.mode is Mode.TRACKING
    assert obc.unit.frames_by_mode == {7: 1, 4: 3}


def test_an_older_unit_tells_no_accuracy_of_its_rate(obc: Obc, unit: Any) -> None:
    unit.attitude(frame=7, rate=(0.25, -0.5, 1.0), older=True)
    obc.wait(0.01)
    (attitude,) = obc.attitudes()
    assert (attitude.frame_index, attitude.valid, attitude.stars_identified) == (7, True, 12)
    np.testing.assert_array_equal(attitude.rate_rad_s, [0.25, -0.5, 1.0])
    assert (attitude.rate_covariance_rad2_s2, attitude.rate_sigma_rad_s) == (None, None)
    assert (obc.counters.malformed, obc.counters.packets) == (0, 1)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_pointing_of_a_quaternion(wire: Any, seed: int) -> None:
    rotation = Rotation.random(random_state=seed)
    q = tuple(rotation.as_quat())
    parsed = parse_telemetry(wire.telemetry_packet(130, 1, wire.attitude_data(q=q)))
    attitude = Attitude.from_fields(parsed.fields, 0)
    ra, dec, roll = attitude.pointing_deg
    # scipy's rotation is active: with a passive q_icrs_to_sensor it turns sensor components into ICRS ones.
    _, y_axis, boresight = rotation.as_matrix().T
    r, d, p = np.radians((ra, dec, roll))
    np.testing.assert_allclose(
        boresight, [np.cos(d) * np.cos(r), np.cos(d) * np.sin(r), np.sin(d)], atol=1e-12
    )
    north = np.array([-np.sin(d) * np.cos(r), -np.sin(d) * np.sin(r), np.cos(d)])
    east = np.array([-np.sin(r), np.cos(r), 0])
    np.testing.assert_allclose(-y_axis, np.cos(p) * north + np.sin(p) * east, atol=1e-12)
    assert 0 <= ra < 360
    assert 0 <= roll < 360
    world = pointing_from_quaternion(attitude.q_icrs_to_sensor)
    difference = (np.array(world) - (ra, dec, roll) + 180) % 360 - 180
    np.testing.assert_allclose(difference, 0, atol=1e-9)


def test_an_unknown_mode_is_a_number_and_no_mode(obc: Obc, unit: Any) -> None:
    # Received values are as they stand in the packet; the OBC must live with a newer unit.
    unit.attitude(mode=77)
    obc.wait(0.01)
    assert obc.attitudes()[0].mode == 77
    assert obc.unit.mode is None


def test_events_in_order_and_in_words(obc: Obc, unit: Any) -> None:
    unit.event(2, struct.pack(">BBB", 2, 3, 4))
    unit.event(6, struct.pack(">II", 9, 1 | 128), severity=2)
    unit.event(18, b"")
    obc.wait(0.01)
    assert [str(event) for event in obc.events()] == [
        "info: MODE_CHANGED from_mode=STANDBY to_mode=LOST_IN_SPACE cause=4",
        "low: TRACKING_LOST frame_index=9 reasons=TOO_FEW_STARS|PIVOT_LOST",
        "info: SHUTDOWN_STARTED",
    ]


def test_event_text_of_a_number_without_name() -> None:
    assert event_text(999, {}) == "999"


@pytest.mark.parametrize(
    ("text", "number"), [("exposure_us", 1), ("EXPOSURE_US", 1), ("exposure-us", 1), ("0x2", 2)]
)
def test_names_as_people_write_them(text: str, number: int) -> None:
    assert member(ParameterId, text) == number


def test_flags_by_name() -> None:
    assert member(Reason, "BLINDED|overrun") == 4 | 16
    assert name_of(Reason, 4 | 16) == "BLINDED|OVERRUN"
    assert name_of(Reason, 1 << 20 | 1) == "TOO_FEW_STARS|0x100000"
    assert name_of(Reason, 0) == "-"


def test_a_wrong_name_lists_the_right_ones() -> None:
    with pytest.raises(ValueError, match=r"'launch' is none of boot_completed, mode_changed, "):
        member(EventId, "launch")


def test_texts_become_what_the_encoder_takes() -> None:
    assert resolve_fields("function", {"function_id": "reset", "kind": "cold"}) == {
        "function_id": 4,
        "arguments": {"kind": 1},
    }
    assert resolve_fields("hk_enable", {"structure_ids": "status,0x3"}) == {"structure_ids": [1, 3]}
    assert resolve_fields("memory_load", {"memory_id": "ram", "start_address": "0x10", "data": "00 ff"}) == {
        "memory_id": 1,
        "start_address": 16,
        "data": b"\x00\xff",
    }
    assert resolve_fields(
        "parameter_set", {"settings": [{"parameter_id": "magnitude_limit", "value": "6.5"}]}
    ) == {"settings": [{"parameter_id": 5, "value": 6.5}]}
    assert resolve_fields("set_time", {"time": "1958-01-02T00:00:00Z"}) == {"time": CucTime(86_410, 0)}


@pytest.mark.parametrize(
    ("moment", "tai_s"),
    [
        # IERS Bulletin C: 36 s from 2015-07-01, 37 s from 2017-01-01
        ("2016-12-31T23:59:59+00:00", 21_550 * 86_400 - 1 + 36),
        ("2017-01-01T00:00:00+00:00", 21_550 * 86_400 + 37),
    ],
)
def test_leap_seconds(moment: str, tai_s: int) -> None:
    utc = datetime.fromisoformat(moment)
    assert tai_ns_from_utc(utc) == tai_s * 1_000_000_000
    assert utc_from_cuc(CucTime(tai_s, 0)) == utc
