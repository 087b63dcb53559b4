"""The rate of stars without names: truth from rotations made here, by scipy alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from st_emulator.firmware_model.frame_log import FrameLog
from st_emulator.firmware_model.geometry import CameraGeometry
from st_emulator.firmware_model.image.lit_pixels import FlowFrame, FlowParameters, light_up
from st_emulator.firmware_model.rate_from_flow import FlowSettings, rate_by_flow, rate_from_directions
from st_emulator.firmware_model.work import Work

INTERVAL_S = 0.1


def field(count: int, seed: int, half_deg: float = 10.0) -> np.ndarray:
    """Directions in a square field about +z."""
    chance = np.random.default_rng(seed)
    x, y = np.tan(np.radians(chance.uniform(-half_deg, half_deg, (2, count))))
    u = np.stack([x, y, np.ones(count)], axis=1)
    return u / np.linalg.norm(u, axis=1, keepdims=True)


def turned(u: np.ndarray, rate_rad_s: np.ndarray) -> np.ndarray:
    """Where a sensor that turns at a rate (own axes) sees what it saw at u: the stars go the other way."""
    return Rotation.from_rotvec(-np.asarray(rate_rad_s) * INTERVAL_S).apply(u)


def alike(count: int, sigma: float = 1e-4) -> np.ndarray:
    return np.full(count, sigma)


@settings(max_examples=60, deadline=None)
@given(
    rate=st.tuples(*[st.floats(-40.0, 40.0)] * 3),
    count=st.integers(2, 40),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_turn_of_any_size_is_found_exactly(rate: tuple[float, float, float], count: int, seed: int) -> None:
    true = np.radians(rate)
    before = field(count, seed)
    if count == 2 and np.linalg.norm(before[0] - before[1]) < 0.02:
        return
    found, _ = rate_from_directions(before, turned(before, true), INTERVAL_S, alike(count), alike(count))
    assert found is not None
    np.testing.assert_allclose(found.rate_rad_s, true, rtol=0, atol=2e-9)
    assert found.kept.all()


def test_a_sensor_that_turns_about_x_sees_the_stars_go_to_plus_y() -> None:
    """By hand: the boresight goes to -y of the old frame: a star on it is seen at +y of the new one."""
    before = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.1, 1.0]])
    before /= np.linalg.norm(before, axis=1, keepdims=True)
    angle = 0.01
    matrix = np.array(  # components of a fixed vector in a frame turned by angle about x
        [[1, 0, 0], [0, np.cos(angle), np.sin(angle)], [0, -np.sin(angle), np.cos(angle)]]
    )
    found, _ = rate_from_directions(before, before @ matrix.T, 0.1, alike(3), alike(3))
    assert found is not None
    np.testing.assert_allclose(found.rate_rad_s, [0.1, 0, 0], atol=1e-9)


@pytest.mark.parametrize("count", [6, 30])
def test_the_covariance_is_that_of_the_errors(count: int) -> None:
    sigma = 2e-5
    true = np.radians([1.0, -0.5, 2.0])
    chance = np.random.default_rng(count)
    scores = []
    for trial in range(400):
        before = field(count, 1000 + trial)
        after = turned(before, true)
        noisy = [u + chance.normal(0, sigma / np.sqrt(2), u.shape) for u in (before, after)]
        noisy = [u / np.linalg.norm(u, axis=1, keepdims=True) for u in noisy]
        found, _ = rate_from_directions(*noisy, INTERVAL_S, alike(count, sigma), alike(count, sigma))
        assert found is not None
        error = found.rate_rad_s - true
        scores.append(error @ np.linalg.solve(found.covariance_rad2_s2, error))
    # chi-square of 3 degrees: mean 3, standard deviation sqrt(6)
    assert np.mean(scores) == pytest.approx(3.0, abs=0.5)
    assert np.mean(np.array(scores) > 14.16) < 0.02  # 0.27 % beyond three sigma; few stars, heavier tails


def test_what_does_not_belong_is_left_out() -> None:
    true = np.radians([0.2, 0.1, -3.0])
    before = field(20, 5)
    after = turned(before, true)
    after[[3, 7, 11]] = field(3, 6)
    found, _ = rate_from_directions(before, after, INTERVAL_S, alike(20), alike(20))
    assert found is not None
    assert sorted(np.flatnonzero(~found.kept)) == [3, 7, 11]
    np.testing.assert_allclose(found.rate_rad_s, true, atol=1e-9)


def test_a_star_that_is_badly_known_along_its_way_still_says_where_it_goes() -> None:
    """Its error is put along the shift alone; told so, the rate is better than if all weighed alike."""
    true = np.radians([5.0, 0.0, 0.0])
    sigma, slide = 1e-5, 2e-3
    chance = np.random.default_rng(1)
    errors: dict[str, list[np.ndarray]] = {"told": [], "alike": []}
    for trial in range(100):
        before = field(12, trial)
        after = turned(before, true)
        way = after - before
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        bad = np.arange(12) < 6
        after = after + chance.normal(0, sigma, after.shape)
        after[bad] += way[bad] * chance.normal(0, slide, (6, 1))
        after /= np.linalg.norm(after, axis=1, keepdims=True)
        along, across = np.where(bad, slide, sigma), alike(12, sigma)
        for name, weights in (("told", (along, across)), ("alike", (alike(12, slide), alike(12, slide)))):
            found, _ = rate_from_directions(before, after, INTERVAL_S, *weights, true)
            assert found is not None
            errors[name].append(found.rate_rad_s - true)
    told, same = (np.sqrt(np.mean(np.square(errors[name]), axis=0)) for name in ("told", "alike"))
    assert (told < 0.2 * same).all()


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_stars_give_no_rate(count: int) -> None:
    before = field(count, 1)
    assert rate_from_directions(before, before, INTERVAL_S, alike(count), alike(count))[0] is None


def test_stars_in_one_place_give_no_rate() -> None:
    before = np.tile(field(1, 1), (5, 1))
    assert rate_from_directions(before, before, INTERVAL_S, alike(5), alike(5))[0] is None


def test_no_time_gives_no_rate() -> None:
    before = field(5, 1)
    assert rate_from_directions(before, before, 0.0, alike(5), alike(5))[0] is None


def test_three_stars_of_which_one_does_not_belong_are_no_rate() -> None:
    """Two of three always agree: which one is wrong cannot be told, so that a unit asks for four."""
    focal_px = 3440.0
    geometry = CameraGeometry(focal_px=focal_px, cx_px=639.5, cy_px=511.5, width_px=1280, height_px=1024)
    dark = np.full((1024, 1280), 30, np.uint16)
    places = [(300, 200), (900, 400), (500, 800), (1000, 900)]

    def image(count: int, shift: int) -> FlowFrame:
        drawn = dark.copy()
        for x, y in places[:count]:
            drawn[y + shift - 1 : y + shift + 2, x - 1 : x + 2] = 500
        return light_up(drawn, FlowParameters())[0]

    for count, known in ((3, False), (4, True)):
        _, rate = rate_by_flow(
            image(count, 0), image(count, 5), 0.1, 0.08, geometry, FlowParameters(),
            FlowSettings(min_stars=4), None, FrameLog(Work(), None),
        )  # fmt: skip
        assert (rate is not None) == known
        if rate is not None:
            assert np.degrees(rate.rate_rad_s[0]) == pytest.approx(np.degrees(5 / focal_px / 0.1), rel=0.02)


def test_a_rate_that_says_of_itself_that_it_is_worth_nothing_is_none() -> None:
    """Four stars close together: hardly anything is known about the boresight, and the sigma says so."""
    geometry = CameraGeometry(focal_px=3440.0, cx_px=639.5, cy_px=511.5, width_px=1280, height_px=1024)

    def image(shift: int) -> FlowFrame:
        drawn = np.full((1024, 1280), 30, np.uint16)
        for x, y in [(640, 500), (655, 500), (640, 515), (655, 515)]:
            drawn[y + shift - 1 : y + shift + 2, x - 1 : x + 2] = 500
        return light_up(drawn, FlowParameters())[0]

    sigmas = []
    for most in (math.inf, math.radians(2.75)):
        _, rate = rate_by_flow(
            image(0), image(5), 0.1, 0.08, geometry, FlowParameters(), FlowSettings(most_error_rad_s=most),
            None, FrameLog(Work(), None),
        )  # fmt: skip
        sigmas.append(None if rate is None else math.degrees(math.sqrt(rate.covariance_rad2_s2[2, 2])))
    assert sigmas[0] is not None
    assert sigmas[0] > 2.75
    assert sigmas[1] is None
