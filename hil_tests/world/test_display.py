"""The display behind a collimator: where its pixels put the light, when, and how bright."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
import pytest

from st_emulator.world.bodies import Sun
from st_emulator.world.camera import CameraModel
from st_emulator.world.display import Display, DisplayRenderer
from st_emulator.world.false_spots import FalseSpots
from st_emulator.world.sampled import SampledTrajectory, TruthSample
from st_emulator.world.scene import SceneRenderer
from st_emulator.world.stars import StarField
from st_emulator.world.trajectory import ConstantRateTrajectory

MS = 1_000_000
CAMERA = CameraModel(
    width_px=640, height_px=512, focal_px=1720.0, psf_sigma_px=0.8, electrons_per_s_mag0=2e6,
    electrons_per_dn=12.0, full_well_electrons=12000.0, read_noise_electrons=10.0, bits=10,
    exposure_ns=80 * MS,
)  # fmt: skip
AHEAD = np.array([0.0, 0.0, 0.0, 1.0])  # +z of ICRS on the boresight


def field(*tangents: tuple[float, float], magnitudes: tuple[float, ...] | None = None) -> StarField:
    """Stars whose directions have these tangents (x/z, y/z)."""
    u = np.array([[x, y, 1.0] for x, y in tangents])
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    count = len(u)
    return StarField(
        hip=np.arange(1, count + 1, dtype=np.int32),
        unit_vectors=u,
        hp_mag=np.array(magnitudes or (3.0,) * count, np.float32),
        parallax_rad=np.zeros(count, np.float32),
        epoch_jyear=2026.0,
    )


def renderer(stars: StarField, rate_deg_s: tuple[float, float, float], display: Display) -> DisplayRenderer:
    trajectory = ConstantRateTrajectory(AHEAD, np.radians(rate_deg_s))
    return DisplayRenderer(display, CAMERA, stars, trajectory, aberration=False)


def middle(scene: SceneRenderer, start_ns: int = 0) -> tuple[np.ndarray, np.ndarray]:
    light = scene.frame(0, start_ns).light
    order = np.argsort(scene._index.hip[light.number])
    return light.xs[order].mean(axis=1), light.ys[order].mean(axis=1)


def test_a_star_at_rest_is_in_the_middle_of_its_display_pixel() -> None:
    display = Display()
    pixel = display.pixel_tangent
    assert np.degrees(pixel) == pytest.approx(0.011, abs=1e-4)  # F table 2
    places = [(0.31, 0.02), (12.49, -7.1), (-30.9, 40.2)]  # display pixels from the middle
    scene = renderer(field(*[(x * pixel, y * pixel) for x, y in places]), (0, 0, 0), display)
    x, y = middle(scene)
    cx, cy = CAMERA.principal_point_px
    # an even number of columns: pixel k is from k to k + 1, in tangents
    np.testing.assert_allclose(x, [cx + 1720 * pixel * (np.floor(a) + 0.5) for a, _ in places], atol=0.02)
    np.testing.assert_allclose(y, [cy + 1720 * pixel * (np.floor(b) + 0.5) for _, b in places], atol=0.02)


def test_a_display_pixel_has_a_size() -> None:
    display = dataclasses.replace(Display(), pitch_mm=4.0)  # 5.3 px of the camera
    scene = renderer(field((0.0011, 0.0011)), (0, 0, 0), display)
    light = scene.frame(0, 0).light
    wide = 1720 * 4.0 / 1300
    for places in (light.xs[0], light.ys[0]):
        assert np.ptp(places) == pytest.approx(wide, rel=0.1)
        assert places.std() == pytest.approx(wide / np.sqrt(12), rel=0.05)  # evenly lit


def test_a_moving_star_is_the_strip_of_a_scene_and_stands_still_between_two() -> None:
    """At 5 deg/s a scene of 0.1 s shows half a degree at once, for as long as the scene is on."""
    display = dataclasses.replace(Display(), update_hz=10.0)
    scene = renderer(field((0.0, 0.0)), (0.0, 5.0, 0.0), display)
    early, late = scene.frame(0, 0, 10 * MS).light, scene.frame(1, 90 * MS, 10 * MS).light
    following = scene.frame(2, 100 * MS, 10 * MS).light
    strip = 1720 * np.radians(0.5)
    assert np.ptp(early.xs[0]) == pytest.approx(strip, rel=0.1)
    assert early.xs[0].mean() == pytest.approx(late.xs[0].mean(), abs=0.3)
    assert abs(following.xs[0].mean() - early.xs[0].mean()) == pytest.approx(strip, rel=0.03)


def test_with_fine_pixels_and_quick_scenes_it_is_the_sky() -> None:
    display = dataclasses.replace(
        Display(), pitch_mm=0.0025, columns=256_000, rows=160_000, update_hz=2000.0, levels=10**7
    )
    stars = field((0.01, 0.02), (-0.05, 0.03), (0.06, -0.07))
    rate = (1.0, -2.0, 3.0)
    shown = renderer(stars, rate, display)
    sky = SceneRenderer(CAMERA, stars, ConstantRateTrajectory(AHEAD, np.radians(rate)), aberration=False)
    np.testing.assert_allclose(middle(shown), middle(sky), atol=0.05)
    one, other = (scene.frame(0, 0).mean_electrons() for scene in (shown, sky))
    assert np.abs(one - other).max() < 0.05 * other.max()
    assert one.sum() == pytest.approx(other.sum(), rel=1e-3)


def test_brightness_goes_in_steps() -> None:
    display = Display()
    of_mag0 = 160_000.0
    step = of_mag0 * 10 ** (-0.4) / 255
    magnitudes = np.array([-1.0, 1.0, 3.0, 6.9, 7.9])
    shown = display.shown(of_mag0 * 10 ** (-0.4 * magnitudes), of_mag0) / step
    np.testing.assert_allclose(shown, [255, 255, 40, 1, 0], atol=0.5)
    assert shown == pytest.approx(np.rint(shown))


def test_a_star_too_faint_for_a_step_or_off_the_display_is_not_shown() -> None:
    display = dataclasses.replace(Display(), columns=400)  # +- 0.0385
    stars = field((0.01, 0.0), (0.02, 0.0), (0.05, 0.0), magnitudes=(3.0, 9.0, 3.0))
    light = renderer(stars, (0, 0, 0), display).frame(0, 0).light
    assert light.number.tolist() == [0]


def test_windows_are_cut_from_the_same_frame() -> None:
    scene = renderer(field((0.01, 0.0), (-0.03, 0.02)), (0.0, 3.0, 0.0), Display())
    rects = np.array([[300, 200, 360, 300], [0, 0, 640, 512]], np.int32)
    flat, offsets = scene.frame(4, 0).windows(rects)
    full = scene.frame(4, 0).full()
    assert (flat[: offsets[1]].reshape(100, 60) == full[200:300, 300:360]).all()
    assert (flat[offsets[1] :].reshape(512, 640) == full).all()


@pytest.mark.parametrize("name", ["columns", "rows", "pitch_mm", "focal_mm", "update_hz", "levels"])
def test_what_makes_no_display_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        Display(**{name: 0})


def test_what_is_known_of_a_shown_star_is_that_stars() -> None:
    """A star that the display leaves out must not move the truth of the others."""
    stars = field((0.05, 0.0), (0.01, 0.02), (-0.03, 0.01), magnitudes=(3.0, 9.0, 4.0))
    scene = renderer(stars, (1.0, 0.5, 0.0), Display())
    truth = scene.truth(scene.frame(0, 0))
    assert [star.hip for star in truth.stars] == [1, 3]
    sky = SceneRenderer(CAMERA, stars, scene.trajectory, aberration=False)
    middles = {star.hip: (star.x_mid_px, star.y_mid_px) for star in sky.truth(sky.frame(0, 0)).stars}
    for star in truth.stars:
        assert (star.x_mid_px, star.y_mid_px) == middles[star.hip]
        assert (star.x_px, star.y_px) == pytest.approx(middles[star.hip], abs=0.6)


def test_false_spots_are_the_detectors_and_stay() -> None:
    trajectory = ConstantRateTrajectory(AHEAD, np.radians([0.0, 1.0, 0.0]))
    spots = FalseSpots(5, 2.0, 4.0)
    made = [
        kind(CAMERA, field((0.01, 0.0)), trajectory, aberration=False, false_spots=spots)
        for kind in (partial(DisplayRenderer, Display()), SceneRenderer)
    ]
    shown, sky = (scene.truth(scene.frame(3, 0)).false_spots for scene in made)
    assert shown == sky
    assert len(shown) == 5
    light = made[0].frame(3, 0).light
    assert (light.number == -1).sum() == 5
    assert (np.ptp(light.xs[light.number == -1], axis=1) == 0.0).all()


ROLLING = dataclasses.replace(CAMERA, rolling_readout_ns=60 * MS)


@pytest.mark.parametrize("rate_deg_s", [(0.0, 0.0, 0.0), (0.4, -0.2, 0.0), (2.0, 3.0, 5.0)])
def test_a_rolling_shutter_sees_of_a_fine_display_what_it_sees_of_the_sky(
    rate_deg_s: tuple[float, float, float],
) -> None:
    display = dataclasses.replace(
        Display(), pitch_mm=0.0025, columns=256_000, rows=160_000, update_hz=500.0, levels=10**7
    )
    stars = field((0.01, 0.02), (-0.05, 0.03), (0.06, -0.07))
    trajectory = ConstantRateTrajectory(AHEAD, np.radians(rate_deg_s))
    shown = DisplayRenderer(display, ROLLING, stars, trajectory, aberration=False)
    sky = SceneRenderer(ROLLING, stars, trajectory, aberration=False)
    one, other = (scene.frame(0, 0).mean_electrons() for scene in (shown, sky))
    assert np.abs(one - other).max() < 0.06 * other.max()
    assert one.sum() == pytest.approx(other.sum(), rel=2e-3)


def test_a_rolling_shutter_sees_all_of_a_strip_at_once() -> None:
    """A scene of 0.2 s at 2 deg/s: a row that is exposed for 5 ms of it sees the whole strip of 0.4 deg."""
    camera = dataclasses.replace(CAMERA, exposure_ns=5 * MS, rolling_readout_ns=50 * MS)
    display = dataclasses.replace(Display(), update_hz=5.0)
    trajectory = ConstantRateTrajectory(AHEAD, np.radians([0.0, 2.0, 0.0]))
    scene = DisplayRenderer(display, camera, field((0.0, 0.0)), trajectory, aberration=False)
    seen = scene.frame(0, 0).mean_electrons()
    lit = np.flatnonzero(seen.max(axis=0) > 0.2 * seen.max())
    assert np.ptp(lit) == pytest.approx(1720 * np.radians(0.4), rel=0.1)


def test_of_what_is_to_come_nothing_is_asked() -> None:
    """Samples from outside end with the exposure; a scene that is on then would go on."""
    samples = [
        TruthSample(
            t_ns, tuple(ConstantRateTrajectory(AHEAD, np.radians([0.0, 1.0, 0.0])).q_icrs_to_sensor(t_ns))
        )
        for t_ns in (93 * MS, 173 * MS)
    ]
    scene = DisplayRenderer(
        Display(), CAMERA, field((0.0, 0.0)), SampledTrajectory(samples), aberration=False
    )
    light = scene.frame(0, 93 * MS).light
    assert len(light.xs) == 1


def test_a_dark_room_has_no_sun() -> None:
    with pytest.raises(ValueError, match="dark room"):
        DisplayRenderer(
            Display(), CAMERA, field((0.0, 0.0)), ConstantRateTrajectory(AHEAD, np.zeros(3)),
            bodies=[Sun(30.0, 100.0)],
        )  # fmt: skip
