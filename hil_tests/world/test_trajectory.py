"""Trajectories: rates against finite differences, the Earth's rotation against SOFA, orbits by Kepler."""

from __future__ import annotations

import erfa
import numpy as np
import pytest

from st_emulator.tai import tai_ns_from_utc
from st_emulator.world import quaternion, time_scales
from st_emulator.world.orbit import orbit
from st_emulator.world.slew import Hold, RateAxis, SlewTo, slew
from st_emulator.world.trajectory import (
    EARTH_RATE_RAD_S,
    Trajectory,
    constant_rate,
    earth_fixed,
    inertial,
    pointing_from_quaternion,
    quaternion_from_pointing,
)

NS = 1_000_000_000
START = tai_ns_from_utc("2026-03-20T12:00:00Z")

MANOEUVRES = slew(
    ra_deg=40.0,
    dec_deg=-20.0,
    roll_deg=10.0,
    segments=[
        Hold(3.0),
        SlewTo(75.0, 30.0, -150.0, 12.0),
        RateAxis((0.5, -1.0, 2.0), 6.0, ramp_s=1.5),
        Hold(1.0),
        RateAxis((0.0, 3.0, 0.0), 4.0, ramp_s=2.0),
        SlewTo(40.0, -20.0, 10.0, 10.0),
    ],
    start_ns=2 * NS,
)
TRAJECTORIES: dict[str, Trajectory] = {
    "inertial": inertial(ra_deg=10.0, dec_deg=20.0, roll_deg=30.0),
    "constant rate": constant_rate(ra_deg=10.0, dec_deg=20.0, roll_deg=30.0, rate_deg_s=(1.0, -2.0, 0.5)),
    "earth": earth_fixed(ra_deg=12.76, dec_deg=20.0, roll_deg=30.0),
    "site": earth_fixed(
        ra_deg=12.0, dec_deg=50.0, start_tai_ns=START, latitude_deg=35.7, longitude_deg=51.4, height_m=1200.0
    ),
    "slew": MANOEUVRES,
    "orbit": orbit(altitude_km=500.0, inclination_deg=97.4, raan_deg=30.0, argument_deg=70.0, roll_deg=25.0),
    "spinning in orbit": orbit(
        altitude_km=500.0, inclination_deg=50.0, boresight=(0.3, -1.0, -0.5), spin_deg_s=(1.0, 0.0, -1.0)
    ),
}


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_rate_is_the_derivative_of_the_attitude(name: str) -> None:
    trajectory = TRAJECTORIES[name]
    half_ns = 500_000
    for t_ns in np.linspace(0.2e9, 45e9, 61).astype(np.int64).tolist():
        after, before = (
            trajectory.q_icrs_to_sensor(t_ns + half_ns),
            trajectory.q_icrs_to_sensor(t_ns - half_ns),
        )
        found = quaternion.error_rotation_vector(after, before) / (2 * half_ns * 1e-9)
        np.testing.assert_allclose(trajectory.rate_sensor(t_ns), found, atol=2e-7)


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_one_instant_and_many_are_the_same(name: str) -> None:
    trajectory = TRAJECTORIES[name]
    instants = np.array([0, 1, 2 * NS, 7 * NS, 30 * NS, 1_000 * NS], dtype=np.int64)
    many = trajectory.q_icrs_to_sensor(instants)
    rates = trajectory.rate_sensor(instants)
    assert many.shape == (6, 4)
    assert rates.shape == (6, 3)
    for i, t_ns in enumerate(instants.tolist()):
        np.testing.assert_array_equal(many[i], trajectory.q_icrs_to_sensor(t_ns))
        np.testing.assert_array_equal(rates[i], trajectory.rate_sensor(t_ns))
        position = trajectory.position_km(t_ns)
        if position is not None:
            everywhere = trajectory.position_km(instants)
            assert everywhere is not None
            np.testing.assert_allclose(everywhere[i], position, rtol=1e-15)


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_attitude_is_canonical_and_continuous(name: str) -> None:
    instants = np.arange(0, 45 * NS, 10_000_000, dtype=np.int64)
    q = TRAJECTORIES[name].q_icrs_to_sensor(instants)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-14)
    assert np.all(q[:, 3] >= 0.0)
    steps = np.linalg.norm(quaternion.error_rotation_vector(q[1:], q[:-1]), axis=1)
    speeds = np.linalg.norm(TRAJECTORIES[name].rate_sensor(instants), axis=1)
    assert np.all(steps < 0.01 * np.maximum(speeds[1:], speeds[:-1]) * 1.001 + 1e-7)


@pytest.mark.parametrize("name", ["site", "orbit", "spinning in orbit"])
def test_velocity_is_the_derivative_of_the_position(name: str) -> None:
    trajectory = TRAJECTORIES[name]
    for t_ns in (0, 100 * NS, 5000 * NS):
        after, before = trajectory.position_km(t_ns + 1_000_000), trajectory.position_km(t_ns - 1_000_000)
        velocity = trajectory.velocity_km_s(t_ns)
        assert after is not None
        assert before is not None
        assert velocity is not None
        np.testing.assert_allclose(velocity, (after - before) / 2e-3, atol=1e-5)


@pytest.mark.parametrize("name", ["inertial", "constant rate", "earth", "slew"])
def test_without_a_place_there_is_none(name: str) -> None:
    assert TRAJECTORIES[name].position_km(0) is None
    assert TRAJECTORIES[name].velocity_km_s(0) is None


def test_constant_rate_starts_where_and_when_it_is_told() -> None:
    trajectory = constant_rate(ra_deg=200.0, dec_deg=5.0, roll_deg=-7.0, rate_deg_s=(0, 0, 2.0), start_ns=NS)
    assert pointing_from_quaternion(trajectory.q_icrs_to_sensor(NS)) == pytest.approx((200.0, 5.0, -7.0))
    # about +Z the camera turns from +X (right) to +Y (down), clockwise in the picture: up goes from north
    # to west, the position angle falls
    assert pointing_from_quaternion(trajectory.q_icrs_to_sensor(4 * NS)) == pytest.approx((200.0, 5.0, -13.0))


def test_earth_rate_has_the_published_magnitude() -> None:
    # one turn in a mean sidereal day of 86164.0905 s, the equinox's; the stellar day is 8.4 ms longer
    for name in ("earth", "site"):
        rate = np.degrees(np.linalg.norm(TRAJECTORIES[name].rate_sensor(123 * NS)))
        assert abs(rate - 0.00417807) < 5e-9
        assert abs(360.0 / rate - 86164.0989) < 1e-4


def test_earth_fixed_boresight_stays_put_in_the_terrestrial_frame() -> None:
    """Over 10 minutes by SOFA's full celestial-to-terrestrial transformation."""
    trajectory = TRAJECTORIES["site"]

    def terrestrial(t_ns: int) -> np.ndarray:
        tai_ns = START + t_ns
        matrix = erfa.c2t06a(*time_scales.tt_jd(tai_ns), *time_scales.ut1_jd(tai_ns), 0.0, 0.0)
        return matrix @ quaternion.attitude_matrix(trajectory.q_icrs_to_sensor(t_ns)).T

    drift_arcsec = np.degrees(np.abs(terrestrial(600 * NS) - terrestrial(0))).max() * 3600.0
    assert drift_arcsec < 2e-3  # against 9025 arcsec of rotation


def test_earth_fixed_moves_east_in_right_ascension() -> None:
    trajectory = earth_fixed(ra_deg=12.76, dec_deg=0.0, roll_deg=77.0)
    ra, dec, _ = pointing_from_quaternion(trajectory.q_icrs_to_sensor(200 * NS))
    assert ra - 12.76 == pytest.approx(200.0 * 0.00417807, abs=2e-6)
    assert abs(dec) < 1e-12


def test_site_against_sofa() -> None:
    """Position and velocity by SOFA's pvtob (in the intermediate system) and the matrix of the date."""
    trajectory = TRAJECTORIES["site"]
    angle = erfa.era00(*time_scales.ut1_jd(START))
    state = erfa.pvtob(np.radians(51.4), np.radians(35.7), 1200.0, 0.0, 0.0, 0.0, angle)
    to_icrs = np.asarray(erfa.c2i06a(*time_scales.tt_jd(START))).T
    position, velocity = trajectory.position_km(0), trajectory.velocity_km_s(0)
    assert position is not None
    assert velocity is not None
    np.testing.assert_allclose(position, to_icrs @ state["p"] / 1000.0, atol=1e-6)
    np.testing.assert_allclose(velocity, to_icrs @ state["v"] / 1000.0, atol=1e-8)


def test_site_needs_date_and_both_angles() -> None:
    with pytest.raises(ValueError, match="needs start_tai_ns"):
        earth_fixed(ra_deg=0.0, dec_deg=0.0, latitude_deg=1.0, longitude_deg=2.0)
    with pytest.raises(ValueError, match="both latitude_deg and longitude_deg"):
        earth_fixed(ra_deg=0.0, dec_deg=0.0, start_tai_ns=START, latitude_deg=1.0)
    with pytest.raises(ValueError, match="latitude_deg is 91"):
        earth_fixed(ra_deg=0.0, dec_deg=0.0, start_tai_ns=START, latitude_deg=91.0, longitude_deg=0.0)


def test_slew_reaches_its_pointings_at_rest() -> None:
    at = MANOEUVRES.q_icrs_to_sensor
    assert pointing_from_quaternion(at(0)) == pytest.approx((40.0, -20.0, 10.0))
    assert pointing_from_quaternion(at(5 * NS)) == pytest.approx((40.0, -20.0, 10.0))
    assert pointing_from_quaternion(at(17 * NS)) == pytest.approx((75.0, 30.0, -150.0))
    assert MANOEUVRES.end_ns == 38 * NS
    for late in (38 * NS, 100 * NS):
        assert pointing_from_quaternion(at(late)) == pytest.approx((40.0, -20.0, 10.0))
        np.testing.assert_array_equal(MANOEUVRES.rate_sensor(late), 0.0)


def test_slew_turns_about_one_axis_with_a_versine() -> None:
    target = quaternion_from_pointing(75.0, 30.0, -150.0)
    start = quaternion_from_pointing(40.0, -20.0, 10.0)
    whole = quaternion.error_rotation_vector(target, start)
    halfway = MANOEUVRES.q_icrs_to_sensor(11 * NS)
    np.testing.assert_allclose(quaternion.error_rotation_vector(halfway, start), whole / 2, atol=1e-12)
    np.testing.assert_allclose(MANOEUVRES.rate_sensor(11 * NS), whole / 12.0 * 2.0, atol=1e-12)
    for t_ns in (5 * NS, 17 * NS):
        np.testing.assert_allclose(MANOEUVRES.rate_sensor(t_ns), 0.0, atol=1e-12)


def test_rate_segment_holds_its_rate_between_its_ramps() -> None:
    # from 17 s to 23 s, ramps of 1.5 s
    expected = np.radians([0.5, -1.0, 2.0])
    for t_s in (18.5, 20.0, 21.5):
        np.testing.assert_allclose(MANOEUVRES.rate_sensor(int(t_s * NS)), expected, atol=1e-9)
    np.testing.assert_allclose(MANOEUVRES.rate_sensor(int(17.75 * NS)), expected / 2, atol=1e-9)
    np.testing.assert_allclose(MANOEUVRES.rate_sensor(int(22.25 * NS)), expected / 2, atol=1e-9)
    # the angle of a trapezoid: rate x (duration - ramp)
    turned = quaternion.error_rotation_vector(
        MANOEUVRES.q_icrs_to_sensor(23 * NS), MANOEUVRES.q_icrs_to_sensor(17 * NS)
    )
    np.testing.assert_allclose(turned, expected * 4.5, atol=1e-12)


def test_a_ramp_of_nothing_steps_the_rate() -> None:
    stepped = slew(ra_deg=0, dec_deg=0, segments=[RateAxis((0, 1.0, 0), 2.0, ramp_s=0.0)], start_ns=NS)
    np.testing.assert_array_equal(stepped.rate_sensor(NS - 1), 0.0)
    np.testing.assert_allclose(stepped.rate_sensor(NS), np.radians([0, 1.0, 0]))
    np.testing.assert_array_equal(stepped.rate_sensor(3 * NS), 0.0)


@pytest.mark.parametrize(
    ("segment", "message"),
    [
        (Hold(0.0), r"segment 2 \(Hold\): duration_s is 0.0"),
        (SlewTo(0, 0, 0, -1.0), r"segment 2 \(SlewTo\): duration_s is -1.0"),
        (RateAxis((1, 0, 0), 1.0, ramp_s=0.6), r"segment 2 \(RateAxis\): ramp_s is 0.6"),
        (RateAxis((1, 0), 1.0), r"segment 2 \(RateAxis\): rate_deg_s has to be three finite numbers"),
    ],
)
def test_a_bad_segment_is_named(segment: Hold | SlewTo | RateAxis, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        slew(ra_deg=0.0, dec_deg=0.0, segments=[Hold(1.0), segment])


def test_orbit_obeys_kepler_and_looks_to_the_zenith() -> None:
    trajectory = orbit(altitude_km=500.0, inclination_deg=60.0, raan_deg=40.0, argument_deg=10.0)
    period_s = 2.0 * np.pi * np.sqrt(6878.137**3 / 398600.4418)
    normal = np.array(
        [
            np.sin(np.radians(60)) * np.sin(np.radians(40)),
            -np.sin(np.radians(60)) * np.cos(np.radians(40)),
            np.cos(np.radians(60)),
        ]
    )
    for t_s in (0.0, 1000.0, 4321.0):
        t_ns = int(t_s * NS)
        position, velocity = trajectory.position_km(t_ns), trajectory.velocity_km_s(t_ns)
        assert position is not None
        assert velocity is not None
        assert np.linalg.norm(position) == pytest.approx(6878.137)
        assert np.linalg.norm(velocity) == pytest.approx(2.0 * np.pi * 6878.137 / period_s)
        np.testing.assert_allclose(
            np.cross(position, velocity) / np.linalg.norm(np.cross(position, velocity)), normal, atol=1e-12
        )
        matrix = quaternion.attitude_matrix(trajectory.q_icrs_to_sensor(t_ns))
        np.testing.assert_allclose(matrix[2], position / np.linalg.norm(position), atol=1e-12)
        np.testing.assert_allclose(matrix[0], velocity / np.linalg.norm(velocity), atol=1e-12)
    again = trajectory.q_icrs_to_sensor(round(period_s * NS))
    assert np.linalg.norm(quaternion.error_rotation_vector(again, trajectory.q_icrs_to_sensor(0))) < 1e-8


def test_argument_and_node_place_the_spacecraft() -> None:
    position = orbit(altitude_km=622.0, inclination_deg=90.0, raan_deg=90.0, argument_deg=90.0).position_km(0)
    assert position is not None
    np.testing.assert_allclose(position / np.linalg.norm(position), [0.0, 0.0, 1.0], atol=1e-12)


def test_orbital_rate_is_about_axis_two_backwards() -> None:
    trajectory = orbit(altitude_km=500.0, boresight=(0.0, 0.0, 1.0))
    # boresight to nadir, +X along the velocity: the sensor frame is the orbital frame
    np.testing.assert_allclose(
        trajectory.rate_sensor(77 * NS), [0.0, -trajectory.mean_motion_rad_s, 0.0], atol=1e-15
    )
    assert np.degrees(trajectory.mean_motion_rad_s) == pytest.approx(360.0 / 5676.98, rel=1e-5)


def test_positive_roll_turns_the_sensor_about_its_boresight() -> None:
    unrolled = orbit(altitude_km=500.0, boresight=(0.2, -1.0, -0.3)).q_icrs_to_sensor(0)
    rolled = orbit(altitude_km=500.0, boresight=(0.2, -1.0, -0.3), roll_deg=25.0).q_icrs_to_sensor(0)
    np.testing.assert_allclose(
        quaternion.error_rotation_vector(rolled, unrolled), [0.0, 0.0, np.radians(25.0)], atol=1e-12
    )


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"altitude_km": 50.0}, "altitude_km is 50.0"),
        ({"altitude_km": 500.0, "boresight": (0, 0, 0)}, "boresight has to be three finite numbers"),
        ({"altitude_km": 500.0, "spin_deg_s": (0, 1)}, "spin_deg_s has to be three finite numbers"),
    ],
)
def test_an_impossible_orbit_is_refused(values: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        orbit(**values)  # type: ignore[arg-type]


def test_a_bad_rate_is_refused() -> None:
    with pytest.raises(ValueError, match="rate_deg_s has to be three finite numbers"):
        constant_rate(ra_deg=0.0, dec_deg=0.0, rate_deg_s=(1.0, float("nan"), 0.0))


def test_earth_rate_constant_is_iers() -> None:
    assert pytest.approx(7.292115146706979e-5, rel=1e-12) == EARTH_RATE_RAD_S
