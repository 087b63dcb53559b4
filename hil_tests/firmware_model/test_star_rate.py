"""The rate of stars that nobody has identified: against stars that turn, and statistics of its covariance."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_tests.firmware_model.streak_scenes import CAMERA, EXPOSURE_S, ROW_TIME_S, TurningCamera
from hil_tests.firmware_model.synthetic_sky import matrix, random_attitude
from st_emulator.firmware_model.star_rate import rate_of_pairs, turned_later

Array = NDArray[np.float64]
PIXEL = 1.0 / CAMERA.focal_px


def directions(x_px: Array, y_px: Array) -> Array:
    v = np.stack([(x_px - CAMERA.cx_px) * PIXEL, (y_px - CAMERA.cy_px) * PIXEL, np.ones(len(x_px))], axis=1)
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def scene(
    rng: np.random.Generator, rate_rad_s: Array, stars: int, interval_s: Array | float
) -> tuple[Array, Array, Array]:
    """Directions before and after the camera has turned, in sensor axes, and the time between."""
    camera = TurningCamera(random_attitude(rng), rate_rad_s)
    before = directions(rng.uniform(0, 1023, stars), rng.uniform(0, 1023, stars))
    fixed = before @ matrix(camera.q)
    spans = np.broadcast_to(np.asarray(interval_s, float), stars).copy()
    after = np.array([matrix(camera.attitude(t)) @ v for v, t in zip(fixed, spans, strict=True)])
    return before, after, spans


def rate_of(before: Array, after: Array, spans: Array, sigma_px: float = 0.1, stars: int = 2) -> object:
    sigma = np.full(len(before), sigma_px * PIXEL)
    return rate_of_pairs(before, after, spans, np.zeros(len(before)), sigma, sigma, 0.0, 1.5 * PIXEL, stars)[
        0
    ]


@pytest.mark.parametrize("rate_deg_s", [0.0, 0.01, 1.0, 5.0, 60.0])
@pytest.mark.parametrize("seed", range(4))
def test_a_turn_of_any_angle_is_exact(rate_deg_s: float, seed: int) -> None:
    """The sensor turns by its rate, sign and all, in its own axes."""
    rng = np.random.default_rng([seed, 1])
    axis = rng.normal(size=3)
    rate = np.radians(rate_deg_s) * axis / np.linalg.norm(axis)
    found = rate_of(*scene(rng, rate, 5, EXPOSURE_S))
    assert np.abs(found.rate_rad_s - rate).max() < 1e-9
    assert found.residuals_rad.max() < 1e-9
    assert found.degrees_of_freedom == 7


def test_each_star_has_its_own_interval() -> None:
    """Rows of a rolling shutter have their own times: up to a twentieth more or less than the period."""
    rng = np.random.default_rng(3)
    rate = np.radians([3.0, -3.5, 2.0])
    spans = EXPOSURE_S + rng.uniform(-60, 60, 8) * ROW_TIME_S
    before, after, spans = scene(rng, rate, 8, spans)
    found = rate_of(before, after, spans)
    assert np.abs(found.rate_rad_s - rate).max() < 1e-5 * np.linalg.norm(rate)
    wrong = rate_of(before, after, np.full(8, EXPOSURE_S))
    assert wrong is None or np.abs(wrong.rate_rad_s - rate).max() > 1e-3 * np.linalg.norm(rate)


@pytest.mark.parametrize("stars", [2, 3, 6, 20])
def test_errors_are_those_of_the_covariance(stars: int) -> None:
    """Normalised errors over many scenes with streaks' errors: along three times those across."""
    rng = np.random.default_rng([stars, 11])
    squares, over = [], 0
    for _ in range(600):
        axis = rng.normal(size=3)
        rate = np.radians(rng.uniform(0.5, 5.0)) * axis / np.linalg.norm(axis)
        before, after, spans = scene(rng, rate, stars, EXPOSURE_S)
        motion = after - before
        motion /= np.linalg.norm(motion, axis=1, keepdims=True)
        side = np.cross(after, motion)
        along = rng.uniform(0.1, 0.6, stars) * PIXEL
        across = along / 3.0
        noisy = after + rng.normal(size=(stars, 1)) * along[:, None] * motion
        noisy += rng.normal(size=(stars, 1)) * across[:, None] * side
        noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
        found, _ = rate_of_pairs(before, noisy, spans, np.zeros(stars), along, across, 0.0, 3.0 * PIXEL, 2)
        if found is None:
            continue
        error = found.rate_rad_s - rate
        squares.append(error @ np.linalg.solve(found.covariance_rad2_s2, error))
        over += int(np.sum(np.abs(error) > 3.0 * np.sqrt(np.diag(found.covariance_rad2_s2))))
    assert len(squares) > 550
    assert over / (3 * len(squares)) < 0.01
    # of three degrees of freedom; scaled by chi^2 it is never too small, and least so with many stars
    assert 1.2 < np.mean(squares) < 3.3


def test_bad_pairs_are_flagged_up_to_a_third() -> None:
    rng = np.random.default_rng(5)
    rate = np.radians([1.0, 2.0, -0.5])
    before, after, spans = scene(rng, rate, 9, EXPOSURE_S)
    noise = rng.normal(0.0, 0.05 * PIXEL, after.shape)
    for bad in (1, 3):
        broken = after + noise
        broken[:bad] = directions(
            *(np.array(after[:bad, :2] / after[:bad, 2:]).T / PIXEL + CAMERA.cx_px + 9.0)
        )
        found = rate_of(before, broken, spans)
        assert np.flatnonzero(~found.kept).tolist() == list(range(bad))
        assert found.residuals_rad[:bad].min() > 5.0 * PIXEL
        assert np.abs(found.rate_rad_s - rate).max() < 5.0 * np.sqrt(found.covariance_rad2_s2.max())
    broken = after + noise
    broken[:5] += rng.normal(0.0, 12.0 * PIXEL, (5, 3))
    assert rate_of(before, broken, spans) is None


def test_no_rate_of_too_little() -> None:
    rng = np.random.default_rng(6)
    before, after, spans = scene(rng, np.radians([1.0, 2.0, 0.0]), 3, EXPOSURE_S)
    assert rate_of(before[:1], after[:1], spans[:1]) is None
    assert rate_of(before[:2], after[:2], spans[:2]) is not None
    assert rate_of(before[:2], after[:2], spans[:2], stars=3) is None
    once_more = np.repeat(before[:1], 2, axis=0), np.repeat(after[:1], 2, axis=0)
    assert rate_of(*once_more, spans[:2]) is None  # nothing says how it turns about that direction


def test_turning_by_the_rate_is_the_camera_s_turn() -> None:
    rng = np.random.default_rng(8)
    rate = np.radians([-3.0, 2.0, 4.0])
    spans = rng.uniform(-0.2, 0.2, 20)
    before, after, _ = scene(rng, rate, 20, spans)
    assert np.abs(turned_later(before, rate, spans) - after).max() < 2e-11  # of a turn of 0.02 rad


@pytest.mark.parametrize("change_deg_s2", [0.0, 0.2, 1.0])
@pytest.mark.parametrize("stars", [4, 20])
def test_a_rate_that_changes_is_that_of_the_middle(change_deg_s2: float, stars: int) -> None:
    """Stars of a rolling shutter's rows turn at the rates of their own times; z is that of the covariance."""
    rng = np.random.default_rng([stars, int(10 * change_deg_s2)])
    sigma = np.full(stars, 0.1 * PIXEL)
    errors, changes, seen = [], [], []
    for _ in range(150):
        axis = rng.normal(size=3)
        rate = np.radians(2.0) * axis / np.linalg.norm(axis)
        change = np.radians(change_deg_s2) * rng.permutation([1.0, -1.0, 0.5])
        before = directions(rng.uniform(0, 1023, stars), rng.uniform(0, 1023, stars))
        later_s = rng.uniform(-0.1, 0.1, stars)
        after = np.empty((stars, 3))
        for i, late in enumerate(later_s):
            after[i] = (
                matrix(TurningCamera(np.array([0, 0, 0, 1.0]), rate + late * change).attitude(0.2))
                @ before[i]
            )
        after += rng.normal(0.0, 0.1 * PIXEL, after.shape)
        after /= np.linalg.norm(after, axis=1, keepdims=True)
        found, _ = rate_of_pairs(
            before, after, np.full(stars, 0.2), later_s, sigma, sigma, 0.0, 1.5 * PIXEL, 2
        )
        assert found is not None
        errors.append((found.rate_rad_s - rate) / np.sqrt(np.diag(found.covariance_rad2_s2)))
        changes.append(change)
        seen.append(found.change_rad_s2)
    spread = np.std(errors, axis=0)
    assert spread.max() < 1.15
    assert spread.min() > 0.4
    assert np.mean(np.abs(errors) < 3.0) > 0.985
    told = np.any(seen, axis=1)
    if change_deg_s2 == 0.0:
        assert told.mean() < 0.03
    elif stars == 20 and change_deg_s2 == 1.0:
        assert told.mean() > 0.9
        across = np.array(seen)[told][:, :2] - np.array(changes)[told][:, :2]
        assert np.abs(across).max() < np.radians(0.6)


def test_what_is_wrong_with_all_pairs_alike_does_not_average_out() -> None:
    rng = np.random.default_rng(12)
    before, after, spans = scene(rng, np.radians([1.0, 2.0, -0.5]), 30, EXPOSURE_S)
    sigma = np.full(30, 0.1 * PIXEL)
    arguments = (before, after, spans, np.zeros(30), sigma, sigma)
    alone, _ = rate_of_pairs(*arguments, 0.0, PIXEL, 2)
    wider, _ = rate_of_pairs(*arguments, 1e-4, PIXEL, 2)
    assert alone is not None
    assert wider is not None
    np.testing.assert_allclose(
        wider.covariance_rad2_s2 - alone.covariance_rad2_s2, 1e-8 * np.eye(3), atol=1e-16
    )


def test_a_mean_place_of_an_exposure_is_brought_to_its_middle() -> None:
    """The mean over 0.2 s of a turn that speeds up, against its middle, and from another row's time."""
    rng = np.random.default_rng(14)
    rate, change = np.radians([2.0, -1.0, 0.5]), np.radians([0.8, 0.4, -0.3])
    star = directions(rng.uniform(300, 700, 1), rng.uniform(300, 700, 1))[0]

    def place(t_s: float) -> Array:
        turn = rate + 0.5 * t_s * change  # mean since t = 0, about nearly one axis
        return np.asarray(matrix(TurningCamera(np.array([0, 0, 0, 1.0]), turn).attitude(t_s)) @ star)

    since_s, off_s = 0.1, 0.04  # the frame's time after that of the rate, the row's after the frame's
    times = since_s + off_s + np.linspace(-0.1, 0.1, 401)
    seen = np.mean([place(t) for t in times], axis=0)
    seen /= np.linalg.norm(seen)
    args = (seen[None], rate, np.array([-off_s]), change, since_s)
    wrong = np.abs(turned_later(*args)[0] - place(since_s)).max()
    right = np.abs(turned_later(*args, 0.2)[0] - place(since_s)).max()
    assert right < 0.05 * PIXEL
    assert right < 0.5 * wrong


@pytest.mark.parametrize("stars", [2, 3])
@pytest.mark.parametrize(("off_px", "given"), [(0.0, True), (0.2, True), (1.2, False)])
def test_few_pairs_that_contradict_each_other_give_no_rate(stars: int, off_px: float, given: bool) -> None:
    """One is another star, and which cannot be told; within their errors they may differ."""
    rng = np.random.default_rng(stars)
    before, after, spans = scene(rng, np.radians([0.0, 3.0, 0.0]), stars, EXPOSURE_S)
    after[0] += off_px * PIXEL * np.cross(before[0], [0.0, 1.0, 0.0])
    after[0] /= np.linalg.norm(after[0])
    assert (rate_of(before, after, spans) is not None) == given
