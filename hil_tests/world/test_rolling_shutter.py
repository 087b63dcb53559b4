"""Light on the rows of a rolling shutter, and on all rows while the camera does anything, against brute
force."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hil_tests.world.smear_oracle import Shaking, integrated
from st_emulator.world import quaternion
from st_emulator.world.bodies import Moon, Sun
from st_emulator.world.camera import CameraModel
from st_emulator.world.false_spots import FalseSpots
from st_emulator.world.scene import SceneRenderer
from st_emulator.world.slew import Hold, RateAxis, SlewTrajectory
from st_emulator.world.stars import StarField
from st_emulator.world.trajectory import (
    ConstantRateTrajectory,
    Trajectory,
    constant_rate,
    quaternion_from_pointing,
)

Array = NDArray[np.float64]
Place = Callable[..., Array]
Make = Callable[..., StarField]

Q = quaternion_from_pointing(83.0, -5.0, 25.0)
EXPOSURE_NS = 200_000_000
SIGMA = 0.75
PLAIN = CameraModel(  # 71 arcsec a pixel, as the paper's; nothing but light
    width_px=160,
    height_px=120,
    focal_px=2888.9,
    psf_sigma_px=SIGMA,
    electrons_per_s_mag0=1e6,
    electrons_per_dn=1.0,
    full_well_electrons=1e12,
    read_noise_electrons=0.0,
)


def turning(*rate_deg_s: float) -> ConstantRateTrajectory:
    return ConstantRateTrajectory(Q, np.radians(rate_deg_s))


def shaking(base: Trajectory, frequency_hz: float, from_ns: int = 0) -> Shaking:
    """By 3 px along the columns and 1.5 px along the rows."""
    return Shaking(base, np.array([1.5, 3.0, 0.0]) / PLAIN.focal_px, frequency_hz, from_ns)


MOTIONS: dict[str, tuple[Trajectory, tuple[float, float]]] = {
    "at rest": (turning(0.0, 0.0, 0.0), (70.3, 60.6)),
    "slow": (turning(0.03, 0.02, 0.0), (70.3, 60.6)),
    "1 px": (turning(0.1, 0.05, 0.0), (70.3, 60.6)),
    "with the shutter": (turning(5.0, 0.0, 0.0), (70.3, 60.6)),
    "against the shutter": (turning(-5.0, 0.0, 0.0), (70.3, 60.6)),
    "along the rows": (turning(0.0, 5.0, 0.0), (70.3, 60.6)),
    "across": (turning(3.0, 4.0, 0.0), (70.3, 60.6)),
    "curved by roll": (turning(0.0, 0.0, 200.0), (120.0, 60.0)),
    "50 Hz": (shaking(turning(0.0, 0.0, 0.0), 50.0), (70.3, 60.6)),
    # stands still at the five even instants, and at nine and seventeen
    "80 Hz": (shaking(turning(0.0, 0.0, 0.0), 80.0), (70.3, 60.6)),
    "50 Hz from within a slew": (shaking(turning(0.0, 1.0, 0.0), 50.0, 90_000_000), (70.3, 60.6)),
    "a slew that starts": (SlewTrajectory(Q, [Hold(0.17), RateAxis((3.0, 4.0, 0.0), 2.0, 0)]), (70.3, 60.6)),
    "a ramp": (SlewTrajectory(Q, [Hold(0.02), RateAxis((3.0, -2.0, 0.0), 2.0, 0.1)]), (70.3, 60.6)),
}  # fmt: skip
READOUTS_MS = (0, 50, 200)


def one_star(
    trajectory: Trajectory, xy: tuple[float, float], readout_ms: int, make_field: Make, place_stars: Place
) -> tuple[SceneRenderer, Array]:
    """A star of magnitude 0 that is at xy at the frame's mid-exposure; and its direction."""
    camera = dataclasses.replace(PLAIN, rolling_readout_ns=readout_ms * 1_000_000)
    middle_ns = (EXPOSURE_NS + camera.last_row_start_ns) // 2
    direction = place_stars(trajectory.q_icrs_to_sensor(middle_ns), camera, [xy])
    scene = SceneRenderer(camera, make_field(direction, [0.0]), trajectory, aberration=False)
    return scene, direction[0]


def centre(image: Array) -> tuple[float, float]:
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    return float((image * columns).sum() / image.sum()), float((image * rows).sum() / image.sum())


@pytest.mark.parametrize("readout_ms", READOUTS_MS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_light_is_that_of_brute_force(
    motion: str, readout_ms: int, make_field: Make, place_stars: Place
) -> None:
    trajectory, xy = MOTIONS[motion]
    scene, direction = one_star(trajectory, xy, readout_ms, make_field, place_stars)
    camera = scene.camera
    frame = scene.frame(0, 0, EXPOSURE_NS)
    image = frame.mean_electrons().astype(np.float64)
    starts = np.array([y * readout_ms * 1_000_000 // 120 for y in range(120)])
    expected = integrated(camera, trajectory, direction, 1e6, 0, EXPOSURE_NS, starts)
    # a step h, as a point in its middle: errs by h^2 / 24 times the slope of the point spread (of a streak)
    # or its curvature (of a spot)
    step_px = SIGMA if readout_ms else 0.5
    bound = step_px**2 / 24.0 * max(0.242 / SIGMA**2, 0.4 / SIGMA**3) * 1.1
    assert np.abs(image - expected).max() < bound * expected.max()
    assert image.sum() == pytest.approx(expected.sum(), rel=3e-4)
    assert centre(image) == pytest.approx(centre(expected), abs=4e-3)
    truth = scene.truth(frame)
    (star,) = truth.stars
    assert (star.x_px, star.y_px) == pytest.approx(centre(expected), abs=4e-3)
    assert star.electrons == pytest.approx(expected.sum(), rel=3e-4)
    assert (star.x_mid_px, star.y_mid_px) == pytest.approx(xy, abs=1e-6)
    x, y, _ = camera.project(quaternion.rotate(truth.q_icrs_to_sensor, direction))
    assert (star.x_mid_px, star.y_mid_px) == pytest.approx((float(x), float(y)), abs=1e-9)


@pytest.mark.parametrize("motion", ["with the shutter", "across", "50 Hz", "a slew that starts"])
def test_quick_light_of_a_global_shutter_is_that_of_brute_force_too(
    motion: str, make_field: Make, place_stars: Place
) -> None:
    trajectory, xy = MOTIONS[motion]
    plain, direction = one_star(trajectory, xy, 0, make_field, place_stars)
    quick = SceneRenderer(PLAIN, plain.stars, trajectory, aberration=False, quick_light=True)
    frame = quick.frame(0, 0, EXPOSURE_NS)
    image = frame.mean_electrons().astype(np.float64)
    expected = integrated(PLAIN, trajectory, direction, 1e6, 0, EXPOSURE_NS, np.zeros(120, np.int64))
    assert np.abs(image - expected).max() < SIGMA**2 / 24.0 * 0.45 / SIGMA**2 * expected.max()
    assert image.sum() == pytest.approx(expected.sum(), rel=1e-4)
    slow, fast = plain.truth(plain.frame(0, 0, EXPOSURE_NS)), quick.truth(frame)
    assert fast.exposure_mid_ns == slow.exposure_mid_ns
    assert fast.stars[0].x_px == pytest.approx(slow.stars[0].x_px, abs=2e-3)
    assert fast.stars[0].electrons == pytest.approx(slow.stars[0].electrons, rel=1e-4)


def test_a_star_that_goes_with_the_shutter_is_seen_for_longer(make_field: Make, place_stars: Place) -> None:
    """M (11), (14): it lights the detector for T / (1 - v t_l), v in rows, and less the other way."""
    rows_s = math.tan(math.radians(5.0)) * PLAIN.focal_px
    row_time_s = 0.2 / 120
    for motion, sign in (("with the shutter", 1.0), ("against the shutter", -1.0)):
        trajectory, xy = MOTIONS[motion]
        scene, _ = one_star(trajectory, xy, 200, make_field, place_stars)
        total = scene.frame(0, 0, EXPOSURE_NS).mean_electrons().sum()
        # which way a turn about +X moves the picture is the camera's affair: here to higher rows
        assert total == pytest.approx(2e5 / (1.0 - sign * rows_s * row_time_s), rel=0.01)


def test_the_frames_times(make_field: Make) -> None:
    scene = SceneRenderer(
        dataclasses.replace(PLAIN, rolling_readout_ns=200_000_000),
        make_field(np.zeros((0, 3)), []),
        turning(0.0, 0.0, 0.0),
    )
    frame = scene.frame(0, 1000, EXPOSURE_NS)
    last_ns = 119 * 200_000_000 // 120
    assert frame.exposure_mid_ns == 1000 + (EXPOSURE_NS + last_ns) // 2
    assert frame.exposure_end_ns == 1000 + EXPOSURE_NS + last_ns
    assert frame.row_time_s == pytest.approx(0.2 / 120)
    truth = scene.truth(frame)
    assert truth.exposure_mid_ns == frame.exposure_mid_ns
    assert truth.exposure_end_ns == frame.exposure_end_ns


_SCENES: dict[str, SceneRenderer] = {}


def everything(camera: CameraModel, hipparcos: StarField) -> SceneRenderer:
    """All that the renderer can do, at once, with a rolling shutter."""
    if "all" not in _SCENES:
        _SCENES["all"] = SceneRenderer(
            dataclasses.replace(camera, rolling_readout_ns=150_000_000),
            hipparcos,
            Shaking(
                constant_rate(ra_deg=84.0, dec_deg=-1.2, roll_deg=33.0, rate_deg_s=(0.2, -0.3, 1.0)),
                np.array([1e-4, 2e-4, 0.0]),
                30.0,
            ),
            seed=9,
            bodies=[Sun(40.0, 800.0), Moon(80.0, 20000.0)],
            false_spots=FalseSpots(8, 1.0, 6.0, persistent=[(30.2, 40.7, 2.0)]),
        )
    return _SCENES["all"]


edges_x, edges_y = st.integers(0, 160), st.integers(0, 120)


@given(st.lists(st.tuples(edges_x, edges_y, edges_x, edges_y), min_size=1, max_size=8), st.integers(0, 1000))
@settings(max_examples=60, deadline=None)
def test_a_window_is_the_same_bits_as_the_full_frame(
    camera: CameraModel, hipparcos: StarField, corners: list[tuple[int, int, int, int]], index: int
) -> None:
    scene = everything(camera, hipparcos)
    rects = np.array([(min(a, c), min(b, d), max(a, c), max(b, d)) for a, b, c, d in corners])
    flat, offsets = scene.frame(index, index * 250_000_000).windows(rects)
    full = scene.frame(index, index * 250_000_000).full()
    mean = scene.frame(index, index * 250_000_000).mean_electrons()
    for i, (x0, y0, x1, y1) in enumerate(rects):
        window = flat[offsets[i] : offsets[i + 1]].reshape(y1 - y0, x1 - x0)
        np.testing.assert_array_equal(window, full[y0:y1, x0:x1])
        if x1 > x0 and y1 > y0:
            part = scene.frame(index, index * 250_000_000).mean_electrons((x0, y0, x1, y1))
            np.testing.assert_array_equal(part, mean[y0:y1, x0:x1])


def test_false_spots_stand_still_for_an_exposure_of_each_row(
    camera: CameraModel, hipparcos: StarField
) -> None:
    for readout_ns in (0, 150_000_000):
        quiet = dataclasses.replace(camera.without_noise(), rolling_readout_ns=readout_ns)
        scene = SceneRenderer(
            quiet,
            hipparcos,
            constant_rate(ra_deg=84.0, dec_deg=-1.2, rate_deg_s=(0.0, 0.0, 0.0)),
            false_spots=FalseSpots(0, 1.0, 6.0, persistent=[(30.2, 40.7, -6.0)]),
        )
        near = scene.frame(0, 0, EXPOSURE_NS).mean_electrons((24, 34, 38, 48))
        assert near.sum() == pytest.approx(2e7 * 0.2 * 10 ** (0.4 * 6.0), rel=1e-4)


@pytest.mark.parametrize("readout_ms", [0, 200])
def test_all_light_stays_and_the_peak_falls_with_rate(
    readout_ms: int, make_field: Make, place_stars: Place
) -> None:
    """The total is the star's whatever the rate. The brightest pixel falls as 1 / rate: I0 = G0 IFOV /
    (r_psf sin(alpha) omega) of M (28), for a streak along the columns with r_psf pixels across, of which
    the brightest holds what the point spread gives it."""
    peaks = []
    rates = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0)
    for rate in rates:
        # along the rows, so that the time of exposure is the same for each row; y on a pixel's middle
        scene, _ = one_star(turning(0.0, rate, 0.0), (79.5, 60.0), readout_ms, make_field, place_stars)
        image = scene.frame(0, 0, EXPOSURE_NS).mean_electrons().astype(np.float64)
        assert image.sum() == pytest.approx(2e5, rel=1e-3)
        peaks.append(float(image.max()))
    assert peaks == sorted(peaks, reverse=True)
    ifov_rad = 1.0 / PLAIN.focal_px
    across = math.erf(0.5 / (SIGMA * math.sqrt(2.0)))  # of the streak's light on its middle row
    for rate, peak in zip(rates[1:], peaks[1:], strict=True):
        crossed_s = ifov_rad / math.radians(rate)  # one pixel
        length_px = 0.2 / crossed_s
        # the middle of a streak that is not much longer than the point spread lacks light
        inside = math.erf(length_px / 2.0 / (SIGMA * math.sqrt(2.0)))
        assert peak == pytest.approx(1e6 * crossed_s * across * inside, rel=0.02)
    # M takes the light as even over r_psf = 3 px across: the brightest holds 1.5 times as much
    assert peaks[-1] / (1e6 * ifov_rad / math.radians(5.0) / 3.0) == pytest.approx(3.0 * across, rel=0.01)


def test_stars_too_faint_while_drawn_out_are_kept_while_it_mostly_rests(
    make_field: Make, place_stars: Place
) -> None:
    """A slew of many pixels in the last tenth of the exposure: a star that a long streak would drown in noise
    is still a spot."""
    noisy = dataclasses.replace(PLAIN, read_noise_electrons=50.0, stray_electrons_s=30000.0)
    late = SlewTrajectory(Q, [Hold(0.18), RateAxis((0.0, 25.0, 0.0), 2.0, 0.0)])
    sky = make_field(place_stars(Q, PLAIN, [70.0, 60.0]), [10.0])  # 20 electrons; noise 92
    image = SceneRenderer(noisy, sky, late, aberration=False).frame(0, 0, EXPOSURE_NS).mean_electrons()
    assert image[55:66, 65:76].sum() - 30000.0 * 0.2 * 121 == pytest.approx(18.0, abs=2.0)
