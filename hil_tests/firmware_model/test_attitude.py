"""The q-method and the quaternions' arithmetic, against scipy, numpy and Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hil_tests.firmware_model.synthetic_sky import (
    ARCSEC,
    matrix,
    random_attitude,
    random_directions,
    turn_between,
    turned,
)
from hil_tests.firmware_model.wahba import q_method
from st_emulator.firmware_model.attitude import (
    angular_rate,
    attitude_matrix,
    largest_eigenvector_kernel,
    quaternion_product,
    robust_q_method,
    rotation_between,
)


def field_of_stars(rng: np.random.Generator, count: int, radius_rad: float) -> np.ndarray:
    """Directions in the sensor frame within about radius_rad of the boresight."""
    v = np.column_stack([rng.uniform(-radius_rad, radius_rad, (count, 2)), np.ones(count)])
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def noisy(rng: np.random.Generator, vectors: np.ndarray, sigma_rad: np.ndarray) -> np.ndarray:
    """Directions with Gaussian errors across them."""
    noise = rng.normal(size=vectors.shape) * sigma_rad[:, None]
    moved = vectors + noise - np.einsum("ij,ij->i", noise, vectors)[:, None] * vectors
    return np.asarray(moved / np.linalg.norm(moved, axis=1, keepdims=True))


@settings(max_examples=200, deadline=None)
@given(
    st.integers(0, 2**31),
    st.integers(2, 30),
    st.sampled_from([0.02, 0.07, 0.25, 1.0]),
    st.sampled_from([0.0, 1.0, 100.0, 3600.0]),
)
def test_the_q_method_solves_wahbas_problem_as_scipy_does(
    seed: int, count: int, radius: float, noise_arcsec: float
) -> None:
    rng = np.random.default_rng(seed)
    q = random_attitude(rng)
    b = field_of_stars(rng, count, radius)
    r = b @ matrix(q)
    sigma = ARCSEC * rng.uniform(0.3, 3.0, count)
    b = noisy(rng, b, noise_arcsec * sigma)
    spread = min(np.linalg.norm(v[:, None] - v[None, :], axis=2).max() for v in (b, r))
    if spread < 0.005:
        return  # two stars on top of each other
    solution, _ = q_method(b, r, sigma)
    assert solution is not None
    expected, _ = Rotation.align_vectors(r, b, weights=1 / sigma**2)  # takes sensor to ICRS
    difference = np.linalg.norm(turn_between(expected.as_quat(), solution.q_icrs_to_sensor))
    assert difference < 1e-11 / spread**2
    assert solution.q_icrs_to_sensor[3] >= 0.0
    assert np.linalg.norm(solution.q_icrs_to_sensor) == pytest.approx(1.0, abs=1e-14)
    turned_back = r @ matrix(solution.q_icrs_to_sensor).T
    sine = np.linalg.norm(np.cross(b, turned_back), axis=1)
    residuals = np.arctan2(sine, np.einsum("ij,ij->i", b, turned_back))
    np.testing.assert_allclose(solution.residuals_rad, residuals, atol=1e-13)
    assert solution.degrees_of_freedom == 2 * count - 3
    assert solution.residual_rms_rad == pytest.approx(np.sqrt(np.mean(solution.residuals_rad**2)))


def test_the_attitude_matrix_is_passive() -> None:
    """A sensor turned by 90 deg about z sees the old x axis along its own -y axis."""
    quarter = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    np.testing.assert_allclose(attitude_matrix(quarter) @ [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], atol=1e-15)
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = random_attitude(rng)
        np.testing.assert_allclose(attitude_matrix(q), matrix(q), atol=1e-15)


@pytest.mark.parametrize("radius", [0.06, 0.17])
def test_the_covariance_is_that_of_many_trials(radius: float) -> None:
    rng = np.random.default_rng(11)
    q = random_attitude(rng)
    b = field_of_stars(rng, 7, radius)
    r = b @ matrix(q)
    sigma = ARCSEC * np.array([0.5, 0.8, 1.0, 1.5, 2.0, 2.5, 3.0])
    errors, covariances = [], []
    for _ in range(3000):
        solution, _ = q_method(noisy(rng, b, sigma), r, sigma)
        assert solution is not None
        errors.append(turn_between(q, solution.q_icrs_to_sensor))
        if solution.chi_square <= solution.degrees_of_freedom:
            covariances.append(solution.covariance_rad2)
    sample = np.cov(np.array(errors).T)
    predicted = np.mean(covariances, axis=0)
    scale = np.sqrt(np.outer(np.diag(predicted), np.diag(predicted)))
    np.testing.assert_allclose(sample / scale, predicted / scale, atol=0.1)


def test_scatter_beyond_the_sigmas_widens_the_covariance() -> None:
    rng = np.random.default_rng(12)
    q = random_attitude(rng)
    b = field_of_stars(rng, 40, 0.1)
    sigma = np.full(40, ARCSEC)
    measured = noisy(rng, b, 5.0 * sigma)
    trusted, _ = q_method(measured, b @ matrix(q), sigma)
    honest, _ = q_method(measured, b @ matrix(q), 5.0 * sigma)
    assert trusted is not None
    assert honest is not None
    ratio = trusted.chi_square / trusted.degrees_of_freedom
    assert ratio == pytest.approx(25.0, rel=0.3)
    np.testing.assert_allclose(trusted.covariance_rad2 / ratio, honest.covariance_rad2 / 25, rtol=0.35)


@pytest.mark.parametrize(
    "vectors",
    [
        np.zeros((0, 3)),
        [[0.0, 0.0, 1.0]],
        [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]],
        [[0.0, 0.6, 0.8], [0.0, -0.6, -0.8]],
        [[0.0, 0.0, 1.0], [1e-6, 0.0, 1.0]],
    ],
    ids=["none", "one", "one twice", "opposite", "0.2 arcsec apart"],
)
def test_degenerate_geometry_has_no_attitude(vectors: list[list[float]]) -> None:
    v = np.array(vectors).reshape(-1, 3)
    solution, _ = q_method(v, v, np.full(len(v), ARCSEC))
    assert solution is None
    solution, _, _ = robust_q_method(v, v, np.full(len(v), ARCSEC), 10 * ARCSEC, 2)
    assert solution is None


def test_two_stars_are_enough() -> None:
    rng = np.random.default_rng(13)
    q = random_attitude(rng)
    b = field_of_stars(rng, 2, 0.1)
    solution, _ = q_method(b, b @ matrix(q), np.full(2, ARCSEC))
    assert solution is not None
    assert np.linalg.norm(turn_between(q, solution.q_icrs_to_sensor)) < 1e-11


def test_a_bright_star_in_the_wrong_place_does_not_pull_the_attitude() -> None:
    """Its small sigma makes the plain q-method believe it and doubt the others."""
    rng = np.random.default_rng(14)
    q = random_attitude(rng)
    b = field_of_stars(rng, 8, 0.05)
    r = b @ matrix(q)
    sigma = ARCSEC * np.array([0.1, 1, 1, 1, 1, 1, 1, 1])
    measured = noisy(rng, b, sigma)
    measured[0] = b[0] + [30 * ARCSEC, 0, 0]
    measured[0] /= np.linalg.norm(measured[0])
    plain, _ = q_method(measured, r, sigma)
    robust, kept, work = robust_q_method(measured, r, sigma, 12 * ARCSEC, 3)
    assert plain is not None
    assert robust is not None
    assert kept.tolist() == [1, 2, 3, 4, 5, 6, 7]
    assert len(robust.residuals_rad) == 7
    assert np.linalg.norm(turn_between(q, plain.q_icrs_to_sensor)[:2]) > 20 * ARCSEC
    assert np.linalg.norm(turn_between(q, robust.q_icrs_to_sensor)[:2]) < 2 * ARCSEC
    assert work["qmethod_solves"] == 2 + 3


def test_a_star_off_within_the_tolerance_counts_for_little() -> None:
    rng = np.random.default_rng(15)
    q = random_attitude(rng)
    errors = []
    for _ in range(100):
        b = field_of_stars(rng, 8, 0.05)
        sigma = ARCSEC * np.array([0.3, 1, 1, 1, 1, 1, 1, 1])
        measured = noisy(rng, b, sigma)
        measured[0] = measured[0] + [8 * ARCSEC, 0, 0]
        measured[0] /= np.linalg.norm(measured[0])
        solutions = (
            q_method(measured, b @ matrix(q), sigma)[0],
            robust_q_method(measured, b @ matrix(q), sigma, 12 * ARCSEC, 3)[0],
        )
        errors.append([np.linalg.norm(turn_between(q, s.q_icrs_to_sensor)[:2]) for s in solutions if s])
    plain, robust = np.sqrt(np.mean(np.square(errors), axis=0)) / ARCSEC
    assert plain > 3.0
    assert robust < 1.5


def test_good_stars_are_weighted_as_the_plain_q_method_does() -> None:
    rng = np.random.default_rng(16)
    q = random_attitude(rng)
    b = field_of_stars(rng, 8, 0.05)
    sigma = ARCSEC * rng.uniform(1.0, 3.0, 8)
    measured = noisy(rng, b, 0.3 * sigma)
    plain, _ = q_method(measured, b @ matrix(q), sigma)
    robust, kept, _ = robust_q_method(measured, b @ matrix(q), sigma, 20 * ARCSEC, 3)
    assert plain is not None
    assert robust is not None
    assert len(kept) == 8
    np.testing.assert_allclose(robust.q_icrs_to_sensor, plain.q_icrs_to_sensor, atol=1e-14)
    np.testing.assert_allclose(robust.covariance_rad2, plain.covariance_rad2, rtol=1e-12)


def test_too_few_stars_that_fit_give_no_attitude() -> None:
    rng = np.random.default_rng(17)
    b = field_of_stars(rng, 6, 0.05)
    scrambled = field_of_stars(rng, 6, 0.05)
    solution, kept, _ = robust_q_method(b, scrambled, np.full(6, ARCSEC), 10 * ARCSEC, 5)
    assert solution is None
    assert len(kept) == 4


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**31))
def test_the_eigenvector_is_numpys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    k = rng.normal(size=(4, 4))
    k += k.T
    expected = np.linalg.eigh(k)[1][:, 3]
    vector = np.empty(4)
    largest_eigenvector_kernel(k.copy(), vector)
    assert abs(vector @ expected) == pytest.approx(1.0, abs=1e-12)


def test_rotations_are_counted_where_there_is_something_to_rotate() -> None:
    vector = np.empty(4)
    assert largest_eigenvector_kernel(np.diag([1.0, 2.0, 3.0, 4.0]), vector) == 0
    block = np.diag([1.0, 2.0, 3.0, 4.0])
    block[0, 3] = block[3, 0] = 0.5
    assert largest_eigenvector_kernel(block, vector) == 1
    rng = np.random.default_rng(21)
    k = rng.normal(size=(4, 4))
    rotations = largest_eigenvector_kernel(k + k.T, vector)
    assert rotations % 6 == 0
    assert 12 <= rotations <= 42  # quadratic convergence: two sweeps at least, about five as a rule


def test_work_of_a_robust_solution_adds_the_rotations_of_its_solves() -> None:
    rng = np.random.default_rng(22)
    b = field_of_stars(rng, 8, 0.07)
    q = random_attitude(rng)
    sigma = np.full(8, ARCSEC)
    _, work = q_method(noisy(rng, b, sigma), b @ matrix(q), sigma)
    assert work["qmethod_solves"] == 1
    assert 12 <= work["jacobi_rotations"] <= 42
    _, _, robust = robust_q_method(noisy(rng, b, sigma), b @ matrix(q), sigma, 12 * ARCSEC, 3)
    assert robust["qmethod_solves"] == 4
    assert 4 * 12 <= robust["jacobi_rotations"] <= 4 * 42


def test_products_are_in_the_order_of_the_matrices() -> None:
    rng = np.random.default_rng(18)
    for _ in range(50):
        p, q = random_attitude(rng), random_attitude(rng)
        product = quaternion_product(p, q)
        np.testing.assert_allclose(matrix(product), matrix(p) @ matrix(q), atol=1e-14)
        assert product[3] >= 0.0


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([0.0, 1e-12, 1e-6, 1e-3, 0.5, 3.0]))
def test_the_turn_between_attitudes_is_in_sensor_axes(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    q = random_attitude(rng)
    turn = angle * random_directions(rng, 1)[0]
    np.testing.assert_allclose(rotation_between(q, turned(q, turn)), turn, atol=1e-14)


def test_the_rate_moves_the_stars_the_other_way() -> None:
    """dv/dt = -omega x v for a fixed direction in the frame of a turning sensor."""
    rng = np.random.default_rng(19)
    q = random_attitude(rng)
    omega = np.array([0.003, -0.002, 0.001])
    after = turned(q, omega * 0.25)
    rate = angular_rate(q, after, 0.25)
    np.testing.assert_allclose(rate, omega, atol=1e-13)
    star = random_directions(rng, 1)[0]
    moved = (matrix(after) - matrix(q)) @ star / 0.25
    np.testing.assert_allclose(moved, -np.cross(rate, matrix(q) @ star), atol=1e-5)
