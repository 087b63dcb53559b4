"""The renderer's light: how much, where, and the same from every side."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable

import erfa
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from st_emulator.tai import tai_ns_from_utc
from st_emulator.world import quaternion, stars, time_scales
from st_emulator.world.bodies import Moon, Sun
from st_emulator.world.camera import CameraModel
from st_emulator.world.false_spots import FalseSpots
from st_emulator.world.orbit import orbit
from st_emulator.world.scene import SceneRenderer
from st_emulator.world.stars import StarField
from st_emulator.world.trajectory import (
    ConstantRateTrajectory,
    InertialTrajectory,
    constant_rate,
    inertial,
    quaternion_from_pointing,
)

Q = quaternion_from_pointing(83.0, -5.0, 25.0)
Place = Callable[..., NDArray[np.float64]]
Make = Callable[..., StarField]


def quiet(camera: CameraModel) -> CameraModel:
    return camera.without_noise()


def gaussian_pixels(n: int, centre: float, sigma: float) -> NDArray[np.float64]:
    """Share of a Gaussian on each of n pixels of one axis, by scipy."""
    edges = np.arange(n + 1) - 0.5
    return np.diff(stats.norm.cdf(edges, centre, sigma))


@given(st.floats(20.0, 139.0), st.floats(20.0, 99.0), st.floats(-1.0, 9.0))
@settings(max_examples=40, deadline=None)
def test_a_star_at_rest_is_an_integrated_gaussian(
    camera: CameraModel, make_field: Make, place_stars: Place, x: float, y: float, mag: float
) -> None:
    sky = make_field(place_stars(Q, camera, [x, y]), [mag])
    scene = SceneRenderer(quiet(camera), sky, InertialTrajectory(Q), aberration=False)
    image = scene.frame(0, 0, 200_000_000).mean_electrons().astype(np.float64)
    electrons = 2e7 * 0.2 * 10.0 ** (-0.4 * float(np.float32(mag)))
    expected = electrons * np.outer(gaussian_pixels(120, y, 0.7), gaussian_pixels(160, x, 0.7))
    np.testing.assert_allclose(image, expected, atol=electrons * 4e-6)
    assert image.sum() == pytest.approx(electrons, rel=1.5e-5)
    columns, rows = np.arange(160), np.arange(120)
    assert (image.sum(axis=0) @ columns) / image.sum() == pytest.approx(x, abs=3e-5)
    assert (image.sum(axis=1) @ rows) / image.sum() == pytest.approx(y, abs=3e-5)


def test_smear_is_the_point_spread_along_the_path(
    camera: CameraModel, make_field: Make, place_stars: Place
) -> None:
    """Uniform motion along the columns: the integral of a Gaussian over pixel and path, in closed form."""
    plain = dataclasses.replace(quiet(camera), k1=0.0, k2=0.0, p1=0.0, p2=0.0, focal_px=1e5)
    middle = place_stars(Q, plain, [80.0, 60.0])
    length_px = 23.4
    # a camera turning about its +Y takes the picture to the left
    rate = length_px / 1e5 / 0.25
    scene = SceneRenderer(
        plain,
        make_field(middle, [4.0]),
        ConstantRateTrajectory(Q, (0.0, rate, 0.0), 125_000_000),
        aberration=False,
    )
    frame = scene.frame(0, 0, 250_000_000)
    image = frame.mean_electrons().astype(np.float64)
    sigma = 0.7
    centre_x, centre_y = 80.0, 60.0

    def primitive(t: NDArray[np.float64]) -> NDArray[np.float64]:
        return t * stats.norm.cdf(t) + stats.norm.pdf(t)

    edges = (np.arange(161) - 0.5 - centre_x) / sigma
    half = length_px / 2.0 / sigma
    smeared = np.diff((primitive(edges + half) - primitive(edges - half)) / (2.0 * half))
    expected = frame.light.electrons[0] * np.outer(gaussian_pixels(120, centre_y, sigma), smeared)
    # steps h of half a pixel: at the streak's ends the midpoint rule errs by h^2 / 24 times the slope of the
    # point spread, 0.242 / sigma^2
    assert np.abs(image - expected).max() < 0.25 / 24.0 * 0.242 / sigma**2 * expected.max()
    assert image.sum() == pytest.approx(expected.sum(), rel=1e-4)
    truth = scene.truth(frame)
    assert truth.sub_steps >= length_px / 0.5
    assert truth.stars[0].x_px == pytest.approx(centre_x, abs=1e-3)
    # which way the picture moves: an early short exposure finds the star on the right
    early = scene.truth(scene.frame(0, 0, 1_000_000)).stars[0]
    assert early.x_px == pytest.approx(centre_x + length_px / 2.0, abs=0.1)
    assert early.y_px == pytest.approx(centre_y, abs=0.05)


def test_smear_follows_a_curved_path(camera: CameraModel, make_field: Make, place_stars: Place) -> None:
    """Turning about the boresight a star draws an arc: its centre of light is the mean of the true path."""
    plain = dataclasses.replace(quiet(camera), k1=0.0, k2=0.0, p1=0.0, p2=0.0)
    sky = make_field(place_stars(Q, plain, [130.0, 59.5]), [3.0])
    turn = np.radians(60.0)
    scene = SceneRenderer(
        plain, sky, ConstantRateTrajectory(Q, (0.0, 0.0, turn / 0.2), 100_000_000), aberration=False
    )
    frame = scene.frame(0, 0, 200_000_000)
    image = frame.mean_electrons().astype(np.float64)
    radius = 130.0 - 79.5
    mean_x = 79.5 + radius * np.sin(turn / 2) / (turn / 2)
    assert (image.sum(axis=0) @ np.arange(160)) / image.sum() == pytest.approx(mean_x, abs=0.01)
    assert (image.sum(axis=1) @ np.arange(120)) / image.sum() == pytest.approx(59.5, abs=0.01)
    star = scene.truth(frame).stars[0]
    assert star.x_px == pytest.approx(mean_x, abs=0.01)
    assert scene.truth(frame).sub_steps >= radius * turn / 0.5


def test_projection_is_the_cameras_and_roll_the_conventions(
    camera: CameraModel, make_field: Make, place_stars: Place
) -> None:
    rng = np.random.default_rng(5)
    xy = rng.uniform([2.0, 2.0], [157.0, 117.0], (30, 2))
    sky = make_field(place_stars(Q, camera, xy), np.linspace(2.0, 7.0, 30))
    scene = SceneRenderer(camera, sky, InertialTrajectory(Q), aberration=False)
    truth = scene.truth(scene.frame(3, 77))
    assert [star.hip for star in truth.stars] == list(range(1, 31))
    found = np.array([(star.x_px, star.y_px) for star in truth.stars])
    np.testing.assert_allclose(found, xy, atol=1e-9)
    assert (truth.ra_deg, truth.dec_deg, truth.roll_deg) == pytest.approx((83.0, -5.0, 25.0))


def test_stars_stand_where_aberration_puts_them(hipparcos: StarField, camera: CameraModel) -> None:
    """By SOFA: the Earth's velocity by epv00 plus the orbit's own, applied by ab; then attitude and lens."""
    trajectory = orbit(altitude_km=500.0, inclination_deg=97.4, raan_deg=80.0, argument_deg=12.0)
    start = tai_ns_from_utc("2026-09-01T00:00:00Z")
    scene = SceneRenderer(camera, hipparcos, trajectory, start_tai_ns=start)
    frame = scene.frame(0, 17_000_000_000, 1_000_000)
    truth = scene.truth(frame)
    assert len(truth.stars) >= 1
    _, earth = erfa.epv00(*time_scales.tt_jd(start + frame.exposure_mid_ns))
    own = trajectory.velocity_km_s(frame.exposure_mid_ns)
    assert own is not None
    beta = np.array(earth["v"]) * 149597870.7 / 86400.0 / 299792.458 + own / 299792.458
    for star in truth.stars:
        catalogued = hipparcos.unit_vectors[np.searchsorted(hipparcos.hip, star.hip)]
        apparent = erfa.ab(catalogued, beta, 1e12, np.sqrt(1.0 - beta @ beta))
        x, y, _ = camera.project(quaternion.rotate(truth.q_icrs_to_sensor, apparent))
        assert star.x_px == pytest.approx(float(x), abs=2e-4)  # the smear of 1 ms in orbit
        assert star.y_px == pytest.approx(float(y), abs=2e-4)
    still = SceneRenderer(camera, hipparcos, trajectory, start_tai_ns=start, aberration=False)
    geometric = {star.hip: star for star in still.truth(still.frame(0, 17_000_000_000, 1_000_000)).stars}
    shifts = [np.hypot(s.x_px - geometric[s.hip].x_px, s.y_px - geometric[s.hip].y_px) for s in truth.stars
              if s.hip in geometric]  # fmt: skip
    assert 0.02 < max(shifts) < 1.4  # up to 26 arcsec, 20 arcsec a pixel


def test_parallax_moves_near_stars_only_when_wanted(hipparcos: StarField, camera: CameraModel) -> None:
    # Sirius, HIP 32349: 0.379 arcsec
    row = int(np.searchsorted(hipparcos.hip, 32349))
    ra, dec = erfa.c2s(hipparcos.unit_vectors[row])
    pointing = {"ra_deg": float(np.degrees(ra)), "dec_deg": float(np.degrees(dec))}
    start = tai_ns_from_utc("2026-03-30T00:00:00Z")
    places = []
    for parallax in (False, True):
        scene = SceneRenderer(
            camera, hipparcos, inertial(**pointing), start_tai_ns=start, aberration=False, parallax=parallax
        )
        (sirius,) = [star for star in scene.truth(scene.frame(0, 0)).stars if star.hip == 32349]
        places.append((sirius.x_px, sirius.y_px))
    bary = np.array(erfa.epv00(*time_scales.tt_jd(start))[1]["p"])
    away = hipparcos.unit_vectors[row]
    expected_arcsec = 0.379 * np.linalg.norm(np.cross(away, bary))
    moved_arcsec = np.hypot(*np.subtract(*places)) * np.degrees(3600.0 / camera.focal_px)
    assert moved_arcsec == pytest.approx(expected_arcsec, rel=0.02)
    assert moved_arcsec > 0.3


def everything(camera: CameraModel, hipparcos: StarField, seed: int = 9) -> SceneRenderer:
    """All that the renderer can do, at once."""
    return SceneRenderer(
        camera,
        hipparcos,
        constant_rate(ra_deg=84.0, dec_deg=-1.2, roll_deg=33.0, rate_deg_s=(0.2, -0.3, 1.0)),
        seed=seed,
        bodies=[Sun(40.0, 800.0), Moon(80.0, 20000.0)],
        false_spots=FalseSpots(8, 1.0, 6.0, persistent=[(30.2, 40.7, 2.0)]),
    )


edges_x, edges_y = st.integers(0, 160), st.integers(0, 120)


@given(
    st.lists(st.tuples(edges_x, edges_y, edges_x, edges_y), min_size=1, max_size=8),
    st.integers(0, 1000),
)
@settings(max_examples=60, deadline=None)
def test_a_window_is_the_same_bits_as_the_full_frame(
    camera: CameraModel, hipparcos: StarField, corners: list[tuple[int, int, int, int]], index: int
) -> None:
    scene = _cached_scene(camera, hipparcos)
    rects = np.array([(min(a, c), min(b, d), max(a, c), max(b, d)) for a, b, c, d in corners])
    flat, offsets = scene.frame(index, index * 250_000_000).windows(rects)
    full = scene.frame(index, index * 250_000_000).full()
    assert flat.dtype == full.dtype == np.uint16
    assert offsets[0] == 0
    assert offsets[-1] == flat.size
    for i, (x0, y0, x1, y1) in enumerate(rects):
        np.testing.assert_array_equal(
            flat[offsets[i] : offsets[i + 1]].reshape(y1 - y0, x1 - x0), full[y0:y1, x0:x1]
        )


_SCENES: dict[int, SceneRenderer] = {}


def _cached_scene(camera: CameraModel, hipparcos: StarField) -> SceneRenderer:
    if 0 not in _SCENES:
        _SCENES[0] = everything(camera, hipparcos)
    return _SCENES[0]


def test_windows_of_a_blinded_frame_are_the_same_too(camera: CameraModel, hipparcos: StarField) -> None:
    """Near saturation every pixel takes the other road through the noise."""
    bright = dataclasses.replace(camera, stray_electrons_s=148_000.0)
    scene = SceneRenderer(bright, hipparcos, inertial(ra_deg=84.0, dec_deg=-1.2), seed=2)
    full = scene.frame(1, 0).full()
    flat, _ = scene.frame(1, 0).windows([[33, 7, 90, 51]])
    np.testing.assert_array_equal(flat.reshape(44, 57), full[7:51, 33:90])


def test_windows_after_the_full_frame_are_cut_from_it(camera: CameraModel, hipparcos: StarField) -> None:
    frame = everything(camera, hipparcos).frame(4, 0)
    before, _ = frame.windows([[3, 4, 50, 60], [0, 0, 160, 120]])
    frame.full()
    after, offsets = frame.windows([[3, 4, 50, 60], [0, 0, 160, 120]])
    np.testing.assert_array_equal(before, after)
    assert offsets.tolist() == [0, 47 * 56, 47 * 56 + 160 * 120]


def test_mean_of_a_rectangle_is_the_same_bits_too(camera: CameraModel, hipparcos: StarField) -> None:
    frame = everything(camera, hipparcos).frame(4, 0)
    np.testing.assert_array_equal(
        frame.mean_electrons((13, 20, 77, 95)), frame.mean_electrons()[20:95, 13:77]
    )


def test_the_same_arguments_give_the_same_frames(camera: CameraModel, hipparcos: StarField) -> None:
    one, two = everything(camera, hipparcos), everything(camera, hipparcos)
    late = one.frame(7, 1_750_000_000).full()
    early = one.frame(3, 750_000_000).full()
    np.testing.assert_array_equal(early, two.frame(3, 750_000_000).full())
    np.testing.assert_array_equal(late, two.frame(7, 1_750_000_000).full())
    assert one.truth(one.frame(3, 750_000_000)) == two.truth(two.frame(3, 750_000_000))
    other_seed = everything(camera, hipparcos, seed=10).frame(3, 750_000_000).full()
    other_index = one.frame(4, 750_000_000).full()
    assert np.mean(other_seed == early) < 0.2
    assert np.mean(other_index == early) < 0.2


def test_frame_interface(camera: CameraModel, hipparcos: StarField) -> None:
    frame = everything(camera, hipparcos).frame(3, 10)
    assert (frame.width_px, frame.height_px, frame.bits) == (160, 120, 12)
    assert frame.full().shape == (120, 160)
    assert frame.full().dtype == np.uint16
    assert frame.full() is frame.full()
    assert not frame.full().flags.writeable
    assert (frame.frame_index, frame.exposure_start_ns, frame.exposure_ns) == (3, 10, 200_000_000)
    assert frame.exposure_mid_ns == 100_000_010
    flat, offsets = frame.windows(np.zeros((0, 4), dtype=np.int32))
    assert flat.size == 0
    assert offsets.tolist() == [0]


@pytest.mark.parametrize("rect", [[-1, 0, 5, 5], [0, 0, 161, 5], [0, -2, 5, 5], [0, 0, 5, 121], [9, 0, 5, 5]])
@pytest.mark.parametrize("rendered", [False, True])
def test_a_window_outside_the_image_is_refused(
    camera: CameraModel, hipparcos: StarField, rect: list[int], rendered: bool
) -> None:
    frame = _cached_scene(camera, hipparcos).frame(0, 0)
    if rendered:
        frame.full()
    with pytest.raises(ValueError, match="not inside the image of 160 x 120 px"):
        frame.windows([[0, 0, 3, 3], rect])


def test_no_exposure_of_nothing(camera: CameraModel, hipparcos: StarField) -> None:
    with pytest.raises(ValueError, match="exposure_ns is 0"):
        _cached_scene(camera, hipparcos).frame(0, 0, 0)


def test_truth_survives_json(camera: CameraModel, hipparcos: StarField) -> None:
    scene = everything(camera, hipparcos)
    truth = scene.truth(scene.frame(6, 1_500_000_000))
    record = json.loads(truth.to_json())
    assert tuple(record["q_icrs_to_sensor"]) == truth.q_icrs_to_sensor
    assert tuple(record["rate_rad_s"]) == truth.rate_rad_s
    assert record["exposure_end_ns"] - record["exposure_start_ns"] == 200_000_000
    assert [star["hip"] for star in record["stars"]] == [star.hip for star in truth.stars]
    assert record["stars"][0]["x_px"] == truth.stars[0].x_px
    assert set(record["bodies"]) <= {"sun", "moon"}
    np.testing.assert_allclose(truth.rate_rad_s, np.radians([0.2, -0.3, 1.0]))
    q = scene.trajectory.q_icrs_to_sensor(1_600_000_000)
    np.testing.assert_array_equal(truth.q_icrs_to_sensor, q)


def test_truth_lists_the_stars_in_the_image_by_brightness(hipparcos: StarField, camera: CameraModel) -> None:
    scene = SceneRenderer(camera, hipparcos, inertial(ra_deg=84.0, dec_deg=-1.2), aberration=False)
    truth = scene.truth(scene.frame(0, 0), limit_mag=9.0)
    magnitudes = [star.hp_mag for star in truth.stars]
    assert magnitudes == sorted(magnitudes)
    x, y, ahead = camera.project(quaternion.rotate(truth.q_icrs_to_sensor, hipparcos.unit_vectors))
    inside = ahead & (np.abs(x - 79.5) <= 80.0) & (np.abs(y - 59.5) <= 60.0) & (hipparcos.hp_mag < 9.0)
    assert sorted(star.hip for star in truth.stars) == hipparcos.hip[inside].tolist()
    assert len(truth.stars) >= 3
    for star in truth.stars:
        assert star.electrons == pytest.approx(2e7 * 0.2 * 10 ** (-0.4 * star.hp_mag), rel=1e-6)


def test_no_star_that_matters_is_left_out(hipparcos: StarField) -> None:
    """Over the whole sky: the stars listed are those that a search through all of them finds."""
    wide = CameraModel(
        width_px=256,
        height_px=256,
        focal_px=721.67,
        psf_sigma_px=0.6,
        electrons_per_s_mag0=7.3e6,
        electrons_per_dn=10.0,
        full_well_electrons=60000.0,
        read_noise_electrons=50.0,
        dark_electrons_s=500.0,
        stray_electrons_s=30000.0,
    )
    rng = np.random.default_rng(8)
    pointings = [(0.0, 90.0), (123.0, -90.0), (359.9, 0.1)]
    pointings += [(rng.uniform(0, 360), np.degrees(np.arcsin(rng.uniform(-1, 1)))) for _ in range(12)]
    for ra, dec in pointings:
        scene = SceneRenderer(
            wide, hipparcos, inertial(ra_deg=ra, dec_deg=dec, roll_deg=ra), aberration=False
        )
        frame = scene.frame(0, 0)
        truth = scene.truth(frame)
        x, y, ahead = wide.project(quaternion.rotate(truth.q_icrs_to_sensor, hipparcos.unit_vectors))
        inside = ahead & (np.abs(x - 127.5) <= 128.0) & (np.abs(y - 127.5) <= 128.0)
        missing = set(hipparcos.hip[inside].tolist()) - {star.hip for star in truth.stars}
        noise = np.sqrt(30500.0 * 0.2 + 50.0**2)
        for hip in missing:
            electrons = 7.3e6 * 0.2 * 10 ** (-0.4 * hipparcos.hp_mag[np.searchsorted(hipparcos.hip, hip)])
            assert electrons * gaussian_pixels(1, 0.0, 0.6)[0] ** 2 < 0.051 * noise
        assert len(missing) < 0.02 * inside.sum()


def test_an_empty_sky_renders(camera: CameraModel, make_field: Make) -> None:
    empty = make_field(np.zeros((0, 3)), [])
    scene = SceneRenderer(camera, empty, InertialTrajectory(Q))
    assert scene.truth(scene.frame(0, 0)).stars == ()
    assert abs(scene.frame(0, 0).full().mean() - (40.0 + (900.0 + 400.0 + 90.0) * 0.2 / 4.0)) < 1.0


def test_light_from_outside_the_image_reaches_its_edge(
    camera: CameraModel, make_field: Make, place_stars: Place
) -> None:
    sky = make_field(place_stars(Q, camera, [-1.0, 50.0]), [0.0])
    scene = SceneRenderer(quiet(camera), sky, InertialTrajectory(Q), aberration=False)
    frame = scene.frame(0, 0)
    expected = 4e6 * stats.norm.sf(0.5 / 0.7)
    assert frame.mean_electrons()[:, :].sum() == pytest.approx(expected, rel=1e-3)
    assert scene.truth(frame).stars == ()


def test_the_kernel_aberrates_as_the_function_does(camera: CameraModel, make_field: Make) -> None:
    """The kernel's own aberration against `stars.aberrate`, for an observer far faster than any."""

    class Fast(InertialTrajectory):
        def position_km(self, t_ns: object) -> NDArray[np.float64]:
            return np.array([7000.0, 0.0, 0.0])

        def velocity_km_s(self, t_ns: object) -> NDArray[np.float64]:
            return np.array([100.0, 200.0, -50.0])

    direction = quaternion.attitude_matrix(Q)[2]
    scene = SceneRenderer(
        camera, make_field(direction, [3.0]), Fast(Q), start_tai_ns=2_145_916_837_000_000_000
    )
    _, _, earth = time_scales.earth_position_velocity(2_145_916_837_100_000_000)
    apparent = stars.aberrate(direction, earth + np.array([100.0, 200.0, -50.0]))
    x, y, _ = camera.project(quaternion.rotate(Q, apparent))
    (star,) = scene.truth(scene.frame(0, 0)).stars
    assert (star.x_px, star.y_px) == pytest.approx((float(x), float(y)), abs=1e-9)
