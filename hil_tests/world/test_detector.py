"""What the detector makes of the light, seen through whole frames."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from st_emulator.world.camera import CameraModel
from st_emulator.world.false_spots import FalseSpots
from st_emulator.world.scene import SceneRenderer
from st_emulator.world.stars import StarField
from st_emulator.world.trajectory import InertialTrajectory, quaternion_from_pointing

Q = quaternion_from_pointing(10.0, 20.0, 30.0)
Make = Callable[..., StarField]
Place = Callable[..., NDArray[np.float64]]


def dark_sky(camera: CameraModel, make_field: Make, **changes: object) -> SceneRenderer:
    return SceneRenderer(dataclasses.replace(camera, **changes), make_field(np.zeros((0, 3)), []),
                         InertialTrajectory(Q), seed=6)  # fmt: skip


EVEN = {"prnu": 0.0, "dark_nonuniformity": 0.0, "hot_pixel_fraction": 0.0}


def test_background_mean_and_noise_follow_from_the_unit_file(camera: CameraModel, make_field: Make) -> None:
    scene = dark_sky(camera, make_field, **EVEN)
    frames = np.array([scene.frame(i, 0).full() for i in range(40)], dtype=np.float64)
    electrons = (400.0 + 900.0) * 0.2
    n = frames.size
    variance = (electrons + 81.0) / 16.0 + 1.0 / 12.0
    assert abs(frames.mean() - (40.0 + electrons / 4.0)) < 4.5 * np.sqrt(variance / n)
    assert abs(frames.var() / variance - 1.0) < 4.5 * np.sqrt(2.0 / n)
    assert abs(stats.skew(frames.ravel()) - electrons / (electrons + 81.0) ** 1.5) < 4.5 * np.sqrt(6.0 / n)
    # the mean of a pixel over the frames tells nothing of it: no fixed pattern is left
    assert abs(frames.mean(axis=0).var() / (variance / 40.0) - 1.0) < 4.5 * np.sqrt(2.0 / 19200)
    assert abs(np.corrcoef(frames[0].ravel(), frames[1].ravel())[0, 1]) < 4.5 / np.sqrt(19200)
    centred = frames - frames.mean()
    for shifted in (centred[:, :, 1:] * centred[:, :, :-1], centred[:, 1:] * centred[:, :-1]):
        assert abs(shifted.mean() / variance) < 4.5 / np.sqrt(n)


def test_exposure_scales_light_and_dark_current(camera: CameraModel, make_field: Make) -> None:
    scene = dark_sky(camera, make_field, **EVEN)
    for exposure_ns in (10_000_000, 50_000_000, 400_000_000):
        mean = scene.frame(0, 0, exposure_ns).mean_electrons()
        np.testing.assert_allclose(mean, 1300.0 * exposure_ns * 1e-9, rtol=1e-6)


def test_fixed_pattern_is_the_detectors(camera: CameraModel, make_field: Make) -> None:
    scene = dark_sky(camera, make_field)
    again = dark_sky(camera, make_field)
    np.testing.assert_array_equal(scene.response, again.response)
    np.testing.assert_array_equal(scene.dark_electrons_s, again.dark_electrons_s)
    # what stays after averaging many frames is the pattern: stray light x response + dark current
    average = np.mean([scene.frame(i, i * 10**9).full() for i in range(200)], axis=0, dtype=np.float64)
    pattern = 40.0 + (900.0 * scene.response + scene.dark_electrons_s) * 0.2 / 4.0
    assert np.corrcoef(average.ravel(), pattern.ravel())[0, 1] > 0.98
    steady = pattern < 300.0  # shot noise of the hottest is larger
    assert np.abs(average - pattern)[steady].max() < 6.0 * np.sqrt(400.0 / 16.0 / 200.0) * 2.0


def test_hot_pixels_stay_and_grow_with_time(camera: CameraModel, make_field: Make) -> None:
    scene = dark_sky(camera, make_field, prnu=0.0, dark_nonuniformity=0.0)
    hot = scene.dark_electrons_s > 400.1
    assert 0.005 < hot.mean() < 0.015
    hottest = np.unravel_index(np.argmax(scene.dark_electrons_s), hot.shape)
    for index in (0, 5, 900):
        frame = scene.frame(index, index * 250_000_000).full()
        assert np.unravel_index(np.argmax(frame), frame.shape) == hottest
    short = scene.frame(0, 0, 100_000_000).mean_electrons()
    long = scene.frame(0, 0, 200_000_000).mean_electrons()
    np.testing.assert_allclose(long, 2.0 * short, rtol=1e-5)
    other = SceneRenderer(scene.camera, scene.stars, InertialTrajectory(Q), seed=7)
    assert np.mean((other.dark_electrons_s > 400.1) & hot) < 0.001


def test_response_scales_light_but_not_dark_current(camera: CameraModel, make_field: Make) -> None:
    scene = dark_sky(camera, make_field, dark_nonuniformity=0.0, hot_pixel_fraction=0.0, prnu=0.05)
    np.testing.assert_allclose(scene.frame(0, 0).mean_electrons(), 180.0 * scene.response + 80.0, rtol=1e-5)


def test_full_well_saturates(camera: CameraModel, make_field: Make, place_stars: Place) -> None:
    well = dataclasses.replace(camera, full_well_electrons=9000.0)  # 2250 + 40 DN of 4095
    sky = make_field(place_stars(Q, camera, [80.0, 60.0]), [-1.0])
    frame = SceneRenderer(well, sky, InertialTrajectory(Q), aberration=False).frame(0, 0)
    core = frame.full()[59:62, 79:82].astype(np.float64)
    assert np.all(frame.mean_electrons((79, 59, 82, 62)) > 9000.0 * 2)
    # only read-out noise is left: 9 electrons, 2.25 DN
    assert np.abs(core - 2290.0).max() < 4.5 * 2.5
    assert core.std() > 0.5


def test_converter_clips_at_its_bits_and_at_zero(
    camera: CameraModel, make_field: Make, place_stars: Place
) -> None:
    sky = make_field(place_stars(Q, camera, [80.0, 60.0]), [-1.0])
    eight = dataclasses.replace(camera, bits=8, offset_dn=0.0, stray_electrons_s=0.0, dark_electrons_s=0.0)
    frame = SceneRenderer(eight, sky, InertialTrajectory(Q), aberration=False).frame(0, 0).full()
    assert frame.max() == 255
    assert np.all(frame[59:62, 79:82] == 255)
    assert 0.5 < np.mean(frame == 0) < 0.65  # read-out noise about zero: half, and what rounds to zero


def test_photometry_of_a_noisy_star(camera: CameraModel, make_field: Make, place_stars: Place) -> None:
    """Total of a star in numbers put out: its electrons over the gain, on average over frames."""
    sky = make_field(place_stars(Q, camera, [80.3, 60.6]), [5.0])
    calm = dataclasses.replace(camera, **EVEN)
    scene = SceneRenderer(calm, sky, InertialTrajectory(Q), aberration=False)
    boxes = np.array([scene.frame(i, 0).windows([[73, 53, 88, 68]])[0] for i in range(300)], dtype=np.float64)
    total = (boxes - 40.0 - 1300.0 * 0.2 / 4.0).sum(axis=1)
    expected = 2e7 * 0.2 * 0.01 / 4.0
    scatter = np.sqrt(2e7 * 0.2 * 0.01 + 225 * (260.0 + 81.0)) / 4.0
    assert abs(total.mean() - expected) < 4.5 * scatter / np.sqrt(300)
    assert abs(total.std() / scatter - 1.0) < 0.15


def test_false_spots_come_and_go_and_some_stay(camera: CameraModel, make_field: Make) -> None:
    spots = FalseSpots(5, 2.0, 4.0, persistent=[(20.25, 30.5, 3.0), (100.0, 90.0, 1.0)])
    scene = SceneRenderer(
        camera.without_noise(),
        make_field(np.zeros((0, 3)), []),
        InertialTrajectory(Q),
        seed=4,
        false_spots=spots,
    )
    seen = []
    for index in range(200):
        truth = scene.truth(scene.frame(index, 0))
        assert truth.false_spots[:2] == ((20.25, 30.5, 3.0), (100.0, 90.0, 1.0))
        assert len(truth.false_spots) == 7
        assert truth.stars == ()
        seen.append(truth.false_spots[2:])
    moving = np.array(seen).reshape(-1, 3)
    assert len(np.unique(moving[:, 0])) == 1000
    for column, low, span in ((0, -0.5, 160.0), (1, -0.5, 120.0), (2, 2.0, 2.0)):
        assert stats.kstest(moving[:, column], "uniform", args=(low, span)).pvalue > 0.01
    image = scene.frame(17, 0).mean_electrons()
    assert image[27:35, 16:25].sum() >= 4e6 * 10 ** (-0.4 * 3.0) * 0.999


@pytest.mark.parametrize(
    ("values", "message"),
    [({"per_frame": -1}, "per_frame is -1"), ({"brightest_mag": 9.0}, "is fainter than")],
)
def test_impossible_false_spots_are_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        FalseSpots(**values)  # type: ignore[arg-type]
