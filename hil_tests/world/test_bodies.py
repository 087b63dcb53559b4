"""Sun, Moon and Earth: eclipses and equinoxes of the almanac, and what the baffle lets through."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import erfa
import numpy as np
import pytest
from numpy.typing import NDArray

from st_emulator.tai import tai_ns_from_utc
from st_emulator.world import quaternion, time_scales
from st_emulator.world.bodies import Earth, Moon, ObserverState, Stray, Sun
from st_emulator.world.camera import CameraModel
from st_emulator.world.orbit import OrbitTrajectory, orbit
from st_emulator.world.scene import SceneRenderer
from st_emulator.world.stars import StarField
from st_emulator.world.trajectory import Trajectory, earth_fixed, inertial

CENTRE = inertial(ra_deg=0.0, dec_deg=0.0)
EXPOSURE_NS = 200_000_000


def at(utc: str, trajectory: Trajectory = CENTRE, t_ns: int = 0) -> ObserverState:
    return ObserverState.at(trajectory, t_ns, tai_ns_from_utc(utc))


def unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    return vector / np.linalg.norm(vector)


def separation_deg(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(np.degrees(np.arccos(np.clip(unit(a) @ unit(b), -1.0, 1.0))))


@pytest.mark.parametrize(
    ("utc", "longitude_deg"),
    # equinoxes and solstices of 2026 (Astronomical Almanac)
    [
        ("2026-03-20T14:46Z", 0.0),
        ("2026-06-21T08:25Z", 90.0),
        ("2026-09-23T00:05Z", 180.0),
        ("2026-12-21T20:50Z", 270.0),
    ],
)
def test_seasons_begin_on_the_minute(utc: str, longitude_deg: float) -> None:
    state = at(utc)
    jd = time_scales.tt_jd(state.tai_ns)
    of_date = np.asarray(erfa.ecm06(*jd)) @ state.sun_km
    found = np.degrees(np.arctan2(of_date[1], of_date[0]))
    # without light time and aberration (20.5 arcsec); a minute is 2.5 arcsec
    assert abs((found - longitude_deg + 180.0) % 360.0 - 180.0) < 0.008


def test_moon_stands_opposite_the_sun_in_a_lunar_eclipse() -> None:
    # total eclipse of 2026-03-03, greatest at 11:33:37 UT; the shadow's axis passes 0.377 Earth radii off
    state = at("2026-03-03T11:33:37Z")
    moon = state.moon_km()
    miss_km = np.linalg.norm(moon) * np.sin(np.radians(180.0 - separation_deg(moon, state.sun_km)))
    assert miss_km / 6378.137 == pytest.approx(0.377, abs=0.02)


def test_moon_hides_the_sun_where_the_eclipse_is_total() -> None:
    # total solar eclipse of 2026-08-12, 17:46 UT, off Iceland at 65.2 N 25.2 W
    start = tai_ns_from_utc("2026-08-12T17:45:53Z")
    there = earth_fixed(ra_deg=0.0, dec_deg=0.0, start_tai_ns=start, latitude_deg=65.2, longitude_deg=-25.2)
    state = ObserverState.at(there, 0, start)
    assert separation_deg(state.moon_km(), state.sun_km) < 0.02
    centre = ObserverState.at(CENTRE, 0, start)
    assert separation_deg(centre.moon_km(), centre.sun_km) > 0.7


def test_velocity_adds_the_observers_own() -> None:
    low = orbit(altitude_km=400.0, inclination_deg=51.6)
    state, centre = at("2026-05-01T00:00Z", low), at("2026-05-01T00:00Z")
    np.testing.assert_allclose(state.velocity_km_s - centre.velocity_km_s, low.velocity_km_s(0), atol=1e-12)
    np.testing.assert_allclose(state.barycentric_km - centre.barycentric_km, low.position_km(0), atol=1e-5)
    np.testing.assert_allclose(state.moon_km() - centre.moon_km(), -low.position_km(0), atol=1e-6)


def pointing_at(direction: NDArray[np.float64], angle_deg: float) -> NDArray[np.float64]:
    """A boresight angle_deg away from a direction."""
    aside = unit(np.cross(direction, [0.0, 0.3, 1.0]))
    return np.cos(np.radians(angle_deg)) * unit(direction) + np.sin(np.radians(angle_deg)) * aside


def sun_light(camera: CameraModel, angle_deg: float, sun: Sun) -> Stray:
    state = at("2026-05-01T00:00Z")
    stray = sun.stray(state, pointing_at(state.sun_km, angle_deg), EXPOSURE_NS, camera, 0.01)
    assert stray is not None
    assert stray.angle_deg == pytest.approx(angle_deg, abs=1e-9)
    return stray


def test_stray_light_by_angle(camera: CameraModel) -> None:
    sun = Sun(30.0, 500.0, falloff=2.5, saturation_deg=10.0)
    filled = 2.0 * 30000.0 / 0.2
    assert sun_light(camera, 30.0, sun).electrons_s == pytest.approx(500.0)
    assert sun_light(camera, 60.0, sun).electrons_s == pytest.approx(500.0 * 2.0**-2.5)
    assert sun_light(camera, 10.0, sun).electrons_s == pytest.approx(filled)
    assert sun_light(camera, 0.0, sun).electrons_s == pytest.approx(filled)
    middle = sun_light(camera, np.sqrt(300.0), sun).electrons_s  # half way in log-log
    assert middle == pytest.approx(np.sqrt(500.0 * filled))
    levels = [sun_light(camera, angle, sun).electrons_s for angle in np.linspace(1.0, 179.0, 90)]
    assert np.all(np.diff(levels) <= 0.0)


def test_slope_across_the_image_is_that_of_the_law(camera: CameraModel) -> None:
    sun = Sun(30.0, 500.0, saturation_deg=10.0)
    for angle in (15.0, 29.0, 31.0, 90.0):
        step = 1e-4
        near = sun_light(camera, angle - step, sun).electrons_s
        far = sun_light(camera, angle + step, sun).electrons_s
        slope = np.log(near / far) / np.radians(2.0 * step)
        assert sun_light(camera, angle, sun).slope_per_rad == pytest.approx(slope, rel=1e-5)
    assert sun_light(camera, 5.0, sun).slope_per_rad == 0.0


def test_default_saturation_is_when_the_disc_enters_the_image(camera: CameraModel) -> None:
    sun = Sun(30.0, 500.0)
    edge_deg = np.degrees(0.01) + 0.264  # the Sun's radius in May: 0.2645 deg
    assert sun_light(camera, edge_deg, sun).electrons_s == pytest.approx(300_000.0, rel=1e-9)
    assert sun_light(camera, edge_deg + 0.05, sun).electrons_s < 300_000.0 * 0.99


def test_moonlight_goes_with_the_phase(camera: CameraModel) -> None:
    moon = Moon(20.0, 1000.0)
    full, new = at("2026-03-03T11:33Z"), at("2026-08-12T17:46Z")
    levels = []
    for state in (full, new):
        stray = moon.stray(state, pointing_at(state.moon_km(), 20.0), EXPOSURE_NS, camera, 0.01)
        assert stray is not None
        levels.append(stray.electrons_s)
    assert levels[0] == pytest.approx(1000.0, rel=1e-3)
    assert levels[1] < 1.0


def along_orbit() -> tuple[OrbitTrajectory, list[int]]:
    low = orbit(altitude_km=500.0, inclination_deg=20.0)
    period_ns = round(2.0 * np.pi / low.mean_motion_rad_s * 1e9)
    return low, [period_ns * k // 60 for k in range(60)]


def test_earth_hides_the_sun_for_a_third_of_a_low_orbit(camera: CameraModel) -> None:
    low, instants = along_orbit()
    lit = 0
    for t_ns in instants:
        state = at("2026-03-20T12:00Z", low, t_ns)
        stray = Sun(30.0, 500.0).stray(state, np.array([0.0, 0.0, 1.0]), EXPOSURE_NS, camera, 0.01)
        position = low.position_km(t_ns)
        assert position is not None
        sunward = unit(state.sun_km)
        # the cylinder of shadow
        shadowed = position @ sunward < 0 and np.linalg.norm(np.cross(position, sunward)) < 6378.137
        assert (stray is None) == shadowed
        lit += stray is not None
    assert 35 < lit < 42


def test_earth_is_measured_from_its_limb_and_lit_by_day(camera: CameraModel) -> None:
    low, instants = along_orbit()
    limb_deg = np.degrees(np.arcsin(6378.137 / 6878.137))
    levels = []
    for t_ns in instants:
        state = at("2026-03-20T12:00Z", low, t_ns)
        position = low.position_km(t_ns)
        assert position is not None
        stray = Earth(25.0, 700.0).stray(
            state, pointing_at(-position, limb_deg + 25.0), EXPOSURE_NS, camera, 0.01
        )
        assert stray is not None
        assert stray.angle_deg == pytest.approx(25.0, abs=1e-9)
        day = 0.5 * (1.0 + unit(position) @ unit(state.earth_to_sun_km))
        assert stray.electrons_s == pytest.approx(700.0 * day)
        levels.append(stray.electrons_s)
    assert max(levels) > 650.0
    assert min(levels) < 50.0


def test_earth_is_no_body_without_a_place_or_on_the_ground(camera: CameraModel) -> None:
    start = tai_ns_from_utc("2026-03-20T12:00Z")
    site = earth_fixed(ra_deg=0.0, dec_deg=0.0, start_tai_ns=start, latitude_deg=50.0, longitude_deg=10.0)
    boresight = np.array([1.0, 0.0, 0.0])
    for trajectory in (CENTRE, site):
        state = ObserverState.at(trajectory, 0, start)
        assert Earth(25.0, 700.0).stray(state, boresight, EXPOSURE_NS, camera, 0.01) is None


def test_sun_below_the_horizon_of_a_site_gives_no_light(camera: CameraModel) -> None:
    boresight = np.array([0.0, 0.0, 1.0])
    for utc, up in (("2026-06-21T12:00Z", True), ("2026-06-21T00:00Z", False)):
        start = tai_ns_from_utc(utc)
        site = earth_fixed(ra_deg=0.0, dec_deg=0.0, start_tai_ns=start, latitude_deg=30.0, longitude_deg=0.0)
        stray = Sun(30.0, 1.0).stray(ObserverState.at(site, 0, start), boresight, EXPOSURE_NS, camera, 0.01)
        assert (stray is not None) == up


def test_stars_behind_the_earth_are_hidden(hipparcos: StarField, camera: CameraModel) -> None:
    wide = dataclasses.replace(camera, focal_px=200.0, k1=0.0, k2=0.0, p1=0.0, p2=0.0)
    # boresight to the limb: half the picture is the Earth
    limb = np.arcsin(6378.137 / 6878.137)
    low = orbit(altitude_km=500.0, boresight=(np.sin(limb), 0.0, np.cos(limb)))
    scene = SceneRenderer(wide, hipparcos, low, aberration=False, bodies=[Earth(1e-3, 0.0)])
    bare = SceneRenderer(wide, hipparcos, low, aberration=False)
    frame = scene.frame(0, 0, 1_000_000)
    seen = {star.hip for star in scene.truth(frame, 6.0).stars}
    all_of_them = {star.hip for star in bare.truth(bare.frame(0, 0, 1_000_000), 6.0).stars}
    position = low.position_km(frame.exposure_mid_ns)
    assert position is not None
    hidden = {
        hip
        for hip in all_of_them
        if hipparcos.unit_vectors[np.searchsorted(hipparcos.hip, hip)] @ -unit(position) > np.cos(limb)
    }
    assert seen == all_of_them - hidden
    assert len(hidden) > 20
    assert len(seen) > 20


Make = Callable[..., StarField]


def test_the_picture_brightens_towards_the_body(camera: CameraModel, make_field: Make) -> None:
    start = tai_ns_from_utc("2026-05-01T00:00Z")
    sun = unit(at("2026-05-01T00:00Z").sun_km)
    boresight = pointing_at(sun, 32.0)
    ra, dec = erfa.c2s(boresight)
    pointing = inertial(ra_deg=float(np.degrees(ra)), dec_deg=float(np.degrees(dec)), roll_deg=70.0)
    wide = dataclasses.replace(camera.without_noise(), focal_px=1000.0, k1=0.0, k2=0.0, p1=0.0, p2=0.0)
    scene = SceneRenderer(
        wide, make_field(np.zeros((0, 3)), []), pointing, start_tai_ns=start, bodies=[Sun(32.0, 5000.0)]
    )
    frame = scene.frame(0, 0)
    mean = frame.mean_electrons().astype(np.float64)
    assert mean[59:61, 79:81].mean() == pytest.approx(5000.0 * 0.2, rel=0.01)
    towards = quaternion.rotate(pointing.q_icrs_to_sensor(0), sun)
    gradient = np.array([mean[:, -1].mean() - mean[:, 0].mean(), mean[-1].mean() - mean[0].mean()])
    gradient /= [159.0, 119.0]
    assert unit(gradient) @ unit(towards[:2]) > 0.999
    # a pixel 5 degrees nearer gets about (32 / 27)^3 of it
    away = round(1000.0 * np.tan(np.radians(3.0)))
    x, y = np.round(np.array([79.5, 59.5]) + away * unit(towards[:2])).astype(int)
    assert mean[y, x] / (5000.0 * 0.2) == pytest.approx((32.0 / 29.0) ** 3, rel=0.05)
    assert scene.truth(frame).bodies["sun"]["angle_deg"] == pytest.approx(32.0, abs=1e-6)


def test_looking_at_the_sun_fills_every_pixel(hipparcos: StarField, camera: CameraModel) -> None:
    start = tai_ns_from_utc("2026-05-01T00:00Z")
    ra, dec = erfa.c2s(at("2026-05-01T00:00Z").sun_km)
    pointing = inertial(ra_deg=float(np.degrees(ra)), dec_deg=float(np.degrees(dec)) + 0.3)
    small_well = dataclasses.replace(camera, full_well_electrons=20000.0)
    scene = SceneRenderer(small_well, hipparcos, pointing, start_tai_ns=start, bodies=[Sun(30.0, 100.0)])
    assert scene.frame(0, 0).full().min() == 4095


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"exclusion_deg": 0.0, "stray_electrons_s": 1.0}, "sun exclusion_deg is 0.0"),
        ({"exclusion_deg": 30.0, "stray_electrons_s": -1.0}, "sun stray_electrons_s is -1.0"),
        ({"exclusion_deg": 30.0, "stray_electrons_s": 1.0, "falloff": -2.0}, "sun falloff is -2.0"),
        (
            {"exclusion_deg": 30.0, "stray_electrons_s": 1.0, "saturation_deg": 31.0},
            "saturation_deg is 31",
        ),
    ],
)
def test_an_impossible_exclusion_is_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Sun(**values)
