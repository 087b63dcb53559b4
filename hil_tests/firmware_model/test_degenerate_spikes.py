"""Spikes that no sky gives: a reason or a right answer, never an exception, in bounded work."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil_tests.firmware_model.synthetic_sky import (
    ARCSEC,
    SyntheticSky,
    random_attitude,
    turn_between,
    vectors_of,
)
from st_emulator.firmware_model.geometry import CameraGeometry
from st_emulator.firmware_model.identification.algorithms import ALGORITHMS
from st_emulator.firmware_model.identification.interface import (
    Identification,
    IdentificationParameters,
    Spikes,
)
from st_emulator.firmware_model.reasons import Reason
from st_emulator.firmware_model.work import Work

CAMERA = CameraGeometry(1024, 1024, 43.3 / 0.015)  # 20 x 20 deg
PIXEL = 1.0 / CAMERA.focal_px
OPERATIONS = 2_000_000
PARAMETERS = IdentificationParameters(
    25 * ARCSEC, field_normals=CAMERA.field_normals(-6.0), max_operations=OPERATIONS
)
EACH = pytest.mark.parametrize("name", ALGORITHMS)
REASONS = {
    Reason.NONE,
    Reason.UNCONFIRMED,
    Reason.TOO_FEW_STARS,
    Reason.NO_MATCH,
    Reason.AMBIGUOUS,
    Reason.WORK_LIMIT,
}


@cache
def sky() -> SyntheticSky:
    return SyntheticSky.make(2, 2617, CAMERA, 5.5)


def scene(seed: int, least: int = 12) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(directions, magnitudes, rows, attitude) of a field of so many stars or more, brightest first."""
    rng = np.random.default_rng(seed)
    while True:
        q = random_attitude(rng)
        view = sky().view(q)
        if len(view) >= least:
            return vectors_of(CAMERA, view.x_px, view.y_px), view.magnitude, view.row, q


def solve(name: str, b: np.ndarray, magnitude: np.ndarray, **changes: object) -> tuple[Identification, Work]:
    """One run, and what holds for all of them."""
    found, work = ALGORITHMS[name](Spikes(b, magnitude), sky().tables, replace(PARAMETERS, **changes))
    assert found.reason in REASONS
    assert found.star_index.shape == (len(b),)
    assert found.star_index.dtype == np.int32
    assert found.verified == (found.star_index >= 0).sum()
    assert found.identified == (found.verified > 0) == (found.q_icrs_to_sensor is not None)
    assert (found.reason == Reason.UNCONFIRMED) <= (found.verified == 3)
    assert (found.reason == Reason.NONE) <= (found.verified >= 4)
    named = found.star_index[found.star_index >= 0]
    assert len(set(named.tolist())) == len(named)  # no star twice
    if found.q_icrs_to_sensor is not None:
        assert np.linalg.norm(found.q_icrs_to_sensor) == pytest.approx(1.0)
        assert np.isfinite(found.false_solutions)
    assert work.operations() <= 1.5 * OPERATIONS
    return found, work


def right(found: Identification, q: np.ndarray) -> bool:
    assert found.q_icrs_to_sensor is not None
    return bool(np.linalg.norm(turn_between(q, found.q_icrs_to_sensor)) < 5 * PIXEL)


@EACH
@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few(name: str, count: int) -> None:
    b, magnitude, _, _ = scene(1)
    found, work = solve(name, b[:count], magnitude[:count])
    assert found.reason == Reason.TOO_FEW_STARS
    assert work.operations() == 0
    # so are many of which no more than two can be matched
    b = np.concatenate([b[:count], np.full((20, 3), np.nan)])
    found, work = solve(name, b, np.concatenate([magnitude[:count], np.full(20, 3.0)]))
    assert found.reason == Reason.TOO_FEW_STARS
    assert work.operations() == 0


@EACH
@pytest.mark.parametrize("tilt_deg", [0.0, 0.001, 30.0])
def test_all_in_line(name: str, tilt_deg: float) -> None:
    """Evenly and unevenly spaced, and so that neither handedness nor roll can be told well."""
    rng = np.random.default_rng(2)
    across = np.array([np.cos(np.radians(tilt_deg)), np.sin(np.radians(tilt_deg))])
    for along in (np.linspace(20, 1000, 30), np.sort(rng.uniform(20, 1000, 30))):
        x, y = 511.5 + (along - 511.5)[:, np.newaxis].T * across[:, np.newaxis]
        found, _ = solve(name, vectors_of(CAMERA, x, y), np.linspace(3, 5.5, 30))
        assert found.reason in (Reason.NO_MATCH, Reason.WORK_LIMIT)


@EACH
def test_true_stars_nearly_in_line_are_right_or_refused(name: str) -> None:
    """Of a field those six that are nearest to a line through its middle."""
    for seed in range(20):
        b, magnitude, _, q = scene(100 + seed, least=25)
        line = np.argsort(np.abs(b[:, 1]))[:6]
        line.sort()
        found, _ = solve(name, b[line], magnitude[line], least_seen_share=0.0)
        assert found.reason != Reason.NONE or right(found, q)


@EACH
@pytest.mark.parametrize("apart_px", [0.0, 1e-6, 0.3, 0.9])
def test_doubles_closer_than_a_pixel(name: str, apart_px: float) -> None:
    """Every star twice: at most one of the two is the star, and the attitude is right."""
    solved = 0
    for seed in range(10):
        b, magnitude, row, q = scene(200 + seed)
        beside = b + apart_px * PIXEL * np.array([0.6, 0.8, 0.0])
        beside /= np.linalg.norm(beside, axis=1, keepdims=True)
        both = np.concatenate([b, beside])
        order = np.argsort(np.concatenate([magnitude, magnitude + 0.1]), kind="stable")
        found, _ = solve(name, both[order], np.concatenate([magnitude, magnitude + 0.1])[order])
        assert found.reason != Reason.UNCONFIRMED
        if found.reason == Reason.NONE:
            assert right(found, q)
            named = found.star_index >= 0
            np.testing.assert_array_equal(
                sky().catalogue.hip[found.star_index[named]], np.concatenate([row, row])[order][named] + 1
            )
            solved += 1
    assert solved >= 8


@EACH
def test_all_at_one_place(name: str) -> None:
    for count in (3, 4, 5, 60):
        b = np.tile([0.0, 0.0, 1.0], (count, 1))
        found, _ = solve(name, b, np.full(count, 4.0))
        assert not found.identified


@EACH
def test_equal_magnitudes(name: str) -> None:
    """All saturated: the order of brightness says nothing."""
    solved = 0
    for seed in range(10):
        b, _, _, q = scene(300 + seed)
        found, _ = solve(name, b, np.full(len(b), 2.0))
        assert not found.identified or right(found, q)
        solved += found.reason == Reason.NONE
    if name == "pyramid":  # needs no brightness
        assert solved == 10


@EACH
def test_a_thousand_spikes(name: str) -> None:
    rng = np.random.default_rng(4)
    b = vectors_of(CAMERA, *rng.uniform(5, 1018, (2, 1000)))
    magnitude = np.sort(rng.uniform(0, 5.5, 1000))
    found, _ = solve(name, b, magnitude)
    assert not found.identified
    # and a true field among them
    true, true_magnitude, _, q = scene(5)
    together = np.concatenate([true, b])
    order = np.argsort(np.concatenate([true_magnitude - 2.0, magnitude]), kind="stable")
    magnitudes = np.concatenate([true_magnitude - 2.0, magnitude])[order]
    found, _ = solve(name, together[order], magnitudes)
    assert found.reason != Reason.NONE or right(found, q)


@EACH
def test_infinite_and_undefined_spikes_are_never_matched(name: str) -> None:
    rng = np.random.default_rng(6)
    for seed in range(10):
        b, magnitude, _, q = scene(400 + seed, least=16)
        b, magnitude = b.copy(), magnitude.copy()
        bad = rng.permutation(len(b))[:5]
        b[bad[0], 1] = np.nan
        b[bad[1]] = np.inf
        magnitude[bad[2]] = np.nan
        magnitude[bad[3]] = -np.inf
        b[bad[4]] = 0.0
        found, _ = solve(name, b, magnitude)
        assert (found.star_index[bad] == -1).all()
        assert not found.identified or right(found, q)
    b, magnitude, _, _ = scene(400)
    assert solve(name, np.full_like(b, np.nan), magnitude)[0].reason == Reason.TOO_FEW_STARS
    assert solve(name, b, np.full_like(magnitude, np.nan))[0].reason == Reason.TOO_FEW_STARS


@EACH
def test_opposite_directions(name: str) -> None:
    """No camera sees them together: the angle of pi and a mean direction of nothing."""
    b, magnitude, _, _ = scene(7)
    found, _ = solve(name, np.concatenate([b, -b]), np.concatenate([magnitude, magnitude + 1.0]))
    assert found.reason in REASONS
    v = np.eye(3)
    found, _ = solve(name, np.concatenate([v, -v]), np.full(6, 4.0))
    assert not found.identified


DIRECTIONS = st.tuples(
    *[st.one_of(st.floats(-1, 1), st.sampled_from([0.0, -0.0, 1e-300, float("nan"), float("inf")]))] * 3
)
PLACES = st.tuples(st.floats(0, 1023), st.floats(0, 1023))
MAGNITUDES = st.one_of(st.floats(-2, 8), st.sampled_from([float("nan"), float("inf"), 1e308]))


@EACH
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    seed=st.integers(0, 5),
    true=st.integers(0, 12),
    places=st.lists(st.tuples(PLACES, MAGNITUDES, st.integers(1, 3)), max_size=20),
    directions=st.lists(st.tuples(DIRECTIONS, MAGNITUDES), max_size=6),
)
def test_any_input(
    name: str,
    seed: int,
    true: int,
    places: list[tuple[tuple[float, float], float, int]],
    directions: list[tuple[tuple[float, float, float], float]],
) -> None:
    """Some true stars, false ones of which some stand several times at one place, and nonsense."""
    b, magnitude, _, q = scene(500 + seed)
    vectors, magnitudes = [*b[:true]], [*magnitude[:true]]
    for (x, y), mag, times in places:
        vectors += [*vectors_of(CAMERA, np.full(times, x), np.full(times, y))]
        magnitudes += [mag] * times
    for direction, mag in directions:
        vectors.append(np.array(direction))
        magnitudes.append(mag)
    order = np.argsort(np.array(magnitudes), kind="stable").astype(int)
    found, _ = solve(
        name, np.array(vectors).reshape(-1, 3)[order], np.array(magnitudes)[order], max_operations=200_000
    )
    if found.reason == Reason.NONE:
        assert right(found, q)
