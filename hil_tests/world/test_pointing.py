"""Pointings against geometry that is computed another way: astropy, the almanac's formula, known stars."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units
from astropy.coordinates import GCRS, EarthLocation
from astropy.time import Time
from astropy.utils import iers
from scipy.spatial.transform import Rotation

from st_emulator.bench.scenario import parse_scenario
from st_emulator.bench.world_of import trajectory_of
from st_emulator.tai import tai_ns_from_utc
from st_emulator.world.trajectory import Trajectory

S = 1_000_000_000
START = "2026-03-20T12:00:00Z"
AT_NS = np.array([0, 7 * S, 600 * S, 3000 * S, 5400 * S, 86_400 * S])
ORBIT = "altitude_km = 500\ninclination_deg = 97.4\nraan_deg = 40\nargument_deg = 10\n"


def made(text: str) -> Trajectory:
    scenario = parse_scenario(f"start_utc = {START}\n[trajectory]\n{text}", "here")
    return trajectory_of(scenario, tai_ns_from_utc(START))


def boresights(trajectory: Trajectory, at_ns: np.ndarray = AT_NS) -> np.ndarray:
    """Axis 3 of the sensor in ICRS, by scipy: our quaternion is passive."""
    return Rotation.from_quat(trajectory.q_icrs_to_sensor(at_ns)).apply([0, 0, 1])


def angles_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    a, b = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in np.broadcast_arrays(a, b))
    return np.degrees(2 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)))


def place_km(trajectory: Trajectory) -> np.ndarray:
    place = trajectory.position_km(AT_NS)
    assert place is not None
    return place


def test_nadir():
    trajectory = made(f'kind = "nadir"\n{ORBIT}')
    place = place_km(trajectory)
    assert np.linalg.norm(place, axis=1) == pytest.approx(np.full(6, 6878.137))
    assert angles_deg(boresights(trajectory), -place) == pytest.approx(np.zeros(6), abs=1e-9)
    velocity = trajectory.velocity_km_s(AT_NS)
    x_axes = Rotation.from_quat(trajectory.q_icrs_to_sensor(AT_NS)).apply([1, 0, 0])
    assert angles_deg(x_axes, velocity) == pytest.approx(np.zeros(6), abs=1e-9)


def test_a_tracker_on_a_nadir_pointing_spacecraft_sits_where_it_is_mounted():
    trajectory = made(f'kind = "nadir"\n{ORBIT}boresight = [0.0, -1.0, -1.0]\nroll_deg = 30')
    place = place_km(trajectory)
    normal = np.cross(place, trajectory.velocity_km_s(AT_NS))
    looks = boresights(trajectory)
    assert angles_deg(looks, place) == pytest.approx(np.full(6, 45), abs=1e-9)
    assert angles_deg(looks, normal) == pytest.approx(np.full(6, 45), abs=1e-9)
    old = made(f'kind = "orbit"\n{ORBIT}boresight = [0.0, -1.0, -1.0]\nroll_deg = 30')
    assert trajectory.q_icrs_to_sensor(AT_NS) == pytest.approx(old.q_icrs_to_sensor(AT_NS), abs=1e-12)
    assert trajectory.rate_sensor(AT_NS) == pytest.approx(old.rate_sensor(AT_NS), abs=1e-9)


def test_a_place_on_the_earth_is_where_astropy_has_it():
    trajectory = made(f'kind = "target"\n{ORBIT}latitude_deg = 52.2\nlongitude_deg = 21.0\nheight_m = 110')
    with iers.conf.set_temp("auto_download", False), iers.conf.set_temp("iers_degraded_accuracy", "ignore"):
        times = Time(START.removesuffix("Z"), scale="utc") + AT_NS / S * units.s
        site = EarthLocation.from_geodetic(21.0, 52.2, 110 * units.m).get_gcrs(times)
    towards = site.cartesian.xyz.to_value("km").T - place_km(trajectory)
    assert isinstance(site, GCRS)
    # UT1 is taken as UTC: up to 0.9 s of the Earth's turn, 420 m at this place
    error_km = np.radians(angles_deg(boresights(trajectory), towards)) * np.linalg.norm(towards, axis=1)
    assert np.max(error_km) < 0.42


def almanac_sun(utc: str, after_s: float) -> np.ndarray:
    """The Sun's apparent direction by the almanac's low-precision formula (0.01 deg, 1950 to 2050), equator
    and equinox of date.
    """
    n = Time(utc.removesuffix("Z"), scale="utc").jd - 2451545.0 + after_s / 86400
    mean, anomaly = np.radians((280.460 + 0.9856474 * n) % 360), np.radians((357.528 + 0.9856003 * n) % 360)
    longitude = mean + np.radians(1.915 * np.sin(anomaly) + 0.020 * np.sin(2 * anomaly))
    obliquity = np.radians(23.439 - 4e-7 * n)
    return np.array(
        [
            np.cos(longitude),
            np.cos(obliquity) * np.sin(longitude),
            np.sin(obliquity) * np.sin(longitude),
        ]
    )


def of_j2000(vector: np.ndarray, years: float) -> np.ndarray:
    """From the equator and equinox of date, by the general precession in longitude (50.29 arcsec a year)."""
    obliquity = np.radians(23.439)
    to_ecliptic = Rotation.from_rotvec([-obliquity, 0, 0])
    back = Rotation.from_rotvec([0, 0, -np.radians(50.29 / 3600 * years)])
    return to_ecliptic.inv().apply(back.apply(to_ecliptic.apply(vector)))


def test_the_sun_is_where_the_almanac_has_it():
    trajectory = made(f'kind = "sun"\n{ORBIT}')
    for at_ns, looks in zip(AT_NS, boresights(trajectory), strict=True):
        sun = of_j2000(almanac_sun(START, at_ns / S), 26.2)
        assert angles_deg(looks, sun) < 0.02


@pytest.mark.parametrize(
    ("target", "ra_deg", "dec_deg"),
    [
        ("ra_deg = 10\ndec_deg = -60", 10, -60),
        ("hip = 32349", 101.2872, -16.7161),  # Sirius, J2000
        ("hip = 11767", 37.9546, 89.2641),  # Polaris
    ],
)
def test_a_star(target, ra_deg, dec_deg):
    trajectory = made(f'kind = "target"\n{ORBIT}{target}')
    ra, dec = np.radians([ra_deg, dec_deg])
    star = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    moved_deg = 0.012 if target == "hip = 32349" else 0.001  # Sirius: 1.34 arcsec a year
    assert np.max(angles_deg(boresights(trajectory), star)) < moved_deg
    q = trajectory.q_icrs_to_sensor(AT_NS)
    assert q == pytest.approx(np.tile(q[0], (6, 1)), abs=1e-12)
    assert trajectory.rate_sensor(AT_NS) == pytest.approx(np.zeros((6, 3)), abs=1e-9)


KINDS = {
    "nadir": f'kind = "nadir"\n{ORBIT}',
    "sun": f'kind = "sun"\n{ORBIT}boresight = [0.3, 0.1, -1.0]',
    "place": f'kind = "target"\n{ORBIT}latitude_deg = 52\nlongitude_deg = 21\n',
    "detumble": 'kind = "detumble"\nra_deg = 10\ndec_deg = 20\nrate_deg_s = [3, -2, 1]\ntime_constant_s = 40',
}


@pytest.mark.parametrize("name", KINDS)
def test_the_rate_is_that_of_the_attitude(name):
    trajectory = made(KINDS[name])
    half_ns = 50_000_000
    for at_ns in AT_NS[1:4]:
        around = np.array([at_ns - half_ns, at_ns + half_ns])
        a, b = Rotation.from_quat(trajectory.q_icrs_to_sensor(around))
        turned = (b.inv() * a).as_rotvec() / (2e-9 * half_ns)  # A(t + h) A(t - h)^T = exp(-[w x] 2 h)
        assert -turned == pytest.approx(trajectory.rate_sensor(int(at_ns)), abs=3e-7)
        one = trajectory.q_icrs_to_sensor(int(at_ns))
        assert one.shape == (4,)
        assert np.linalg.norm(one) == pytest.approx(1)


def test_a_tumble_dies_away_by_its_time_constant():
    trajectory = made(KINDS["detumble"])
    speed = np.linalg.norm(trajectory.rate_sensor(np.array([0, 40 * S, 400 * S])), axis=1)
    assert np.degrees(speed) == pytest.approx(np.sqrt(14) * np.exp([0, -1, -10]))
    a, b = Rotation.from_quat(trajectory.q_icrs_to_sensor(np.array([0, 4000 * S])))
    whole = Rotation.from_rotvec(np.radians(40 * np.array([3, -2, 1])))  # rate x time constant
    assert (b.inv() * a * whole).magnitude() == pytest.approx(0, abs=1e-9)
