"""Equations (1) to (6) of Zhang et al. 2014 one by one, and Gaussian interpolation on simulated stars.

The numbers to compare with come from scipy (integrals, root search) or from arithmetic on the page.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import dblquad, quad
from scipy.optimize import brentq
from scipy.special import erf

from st_emulator.firmware_model.configuration import CentroidError
from st_emulator.firmware_model.image.detection import DetectionParameters, detect
from st_emulator.firmware_model.image.interpolation import (
    DEVELOPED_AT_PX,
    gaussian_share,
    interpolation_errors,
    interpolation_terms,
    offset_from_ratio,
    place_on_axis,
)
from st_emulator.firmware_model.image.spots import Spots
from st_emulator.firmware_model.image.windows import detect_in_windows

Render = Callable[..., NDArray[np.float64]]
Expose = Callable[..., NDArray[np.uint16]]
SIGMAS = [0.5, 0.6, 0.75, 0.9, 1.2, 2.0]
ZERO_POINT = 675.0 * 10 ** (0.4 * 6)
NONE = 1e6  # a place beyond this means that there is none


def found(image: NDArray[np.uint16], centroid: str = "gaussian", **changes: Any) -> Spots:
    """Spots of an image."""
    settings: dict[str, Any] = {"zero_point_dn_per_s": ZERO_POINT, "exposure_s": 1.0, "tau_min_dn": 20.0}
    return detect(image, DetectionParameters(**{**settings, "centroid": centroid, **changes}))[0]


def dn(signal: NDArray[np.float64], background_dn: float = 1000.0) -> NDArray[np.uint16]:
    """A noise-free image."""
    return np.rint(signal + background_dn).astype(np.uint16)


def light(x: float, sigma: float, low: float, high: float) -> float:
    """Integral of the normal density from low to high, by scipy's error function."""
    scale = math.sqrt(2.0) * sigma
    return float(0.5 * (erf((high - x) / scale) - erf((low - x) / scale)))


def test_equations_1_to_3_by_hand() -> None:
    """DN = 100 + 300 + 200 + 100 + 500 + 300 = 1500; sum x DN / DN and sum y DN / DN worked out by hand."""
    image = np.full((41, 41), 1000, np.uint16)
    for column, row, signal in [
        (19, 20, 100), (20, 20, 500), (21, 20, 300), (20, 19, 300), (20, 21, 200), (21, 21, 100),
    ]:  # fmt: skip
        image[row, column] += signal
    spots = found(image, "com")
    # x: (-100 + 300 + 100) / 1500; y: (-300 + 200 + 100) / 1500
    assert spots.flux_dn == pytest.approx([1500.0], abs=1e-9)  # (3)
    assert spots.x_px == pytest.approx([20.0 + 300.0 / 1500.0], abs=1e-12)  # (1)
    assert spots.y_px == pytest.approx([20.0], abs=1e-12)  # (2)


@pytest.mark.parametrize("sigma", SIGMAS)
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.3, -0.45), (-0.5, 0.2)])
def test_equation_4_is_the_light_on_a_pixel(sigma: float, place: tuple[float, float]) -> None:
    """I_k = (I0 / pi) g g against the integral of the density over the pixel's area."""
    x, y = place
    for column, row in [(0, 0), (-1, 0), (1, 2)]:
        integral, _ = dblquad(
            lambda v, u: math.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * sigma**2)) / (2 * math.pi * sigma**2),
            column - 0.5, column + 0.5, row - 0.5, row + 0.5, epsabs=1e-12,
        )  # fmt: skip
        across = gaussian_share(x, sigma, column - 0.5, column + 0.5)
        down = gaussian_share(y, sigma, row - 0.5, row + 0.5)
        assert 7000.0 / math.pi * across * down == pytest.approx(7000.0 * integral, abs=1e-6)


@pytest.mark.parametrize("sigma", SIGMAS)
def test_equation_5_is_the_difference_of_two_error_functions(sigma: float) -> None:
    for x, low, high in [(0.0, -0.5, 0.5), (0.31, -1.5, -0.5), (-0.49, 0.5, 1.5), (0.2, -2.0, 3.0)]:
        by_erf = math.sqrt(math.pi) / 2 * (
            erf((high - x) / (math.sqrt(2) * sigma)) - erf((low - x) / (math.sqrt(2) * sigma))
        )  # fmt: skip
        scale = math.sqrt(2) * sigma
        integral, _ = quad(lambda t: math.exp(-t * t), (low - x) / scale, (high - x) / scale, epsabs=1e-13)
        assert gaussian_share(x, sigma, low, high) == pytest.approx(by_erf, abs=1e-14)
        assert gaussian_share(x, sigma, low, high) == pytest.approx(integral, abs=1e-12)


@pytest.mark.parametrize("sigma", SIGMAS)
def test_equation_6_develops_both_columns_to_second_order(sigma: float) -> None:
    """Value, slope and half the second derivative against differences of scipy's integrals."""
    terms = interpolation_terms(sigma)
    at, step = DEVELOPED_AT_PX, 1e-3
    root_pi = math.sqrt(math.pi)
    for (low, high), given_terms in {
        (-1.5, -0.5): (terms.first_0, terms.first_1, terms.first_2),
        (-0.5, 0.5): (terms.second_0, terms.second_1, terms.second_2),
    }.items():
        before, here, after = (root_pi * light(at + d, sigma, low, high) for d in (-step, 0.0, step))
        assert given_terms[0] == pytest.approx(here, abs=1e-13)
        assert given_terms[1] == pytest.approx((after - before) / (2 * step), abs=1e-5)
        assert given_terms[2] == pytest.approx((after - 2 * here + before) / (2 * step**2), abs=1e-5)


@pytest.mark.parametrize("sigma", SIGMAS)
def test_equation_6_is_the_lower_root_of_the_quadratic(sigma: float) -> None:
    terms = interpolation_terms(sigma)
    for x in np.linspace(-0.5, 0.0, 11):
        first, second = light(x, sigma, -1.5, -0.5), light(x, sigma, -0.5, 0.5)
        roots = np.roots(
            [
                first * terms.second_2 - second * terms.first_2,
                first * terms.second_1 - second * terms.first_1,
                first * terms.second_0 - second * terms.first_0,
            ]
        )
        assert np.isrealobj(roots)
        expected = DEVELOPED_AT_PX + roots.min()
        assert offset_from_ratio(first, second, terms) == pytest.approx(expected, abs=1e-12)
        # A is eliminated: the star's brightness does not matter
        assert offset_from_ratio(777 * first, 777 * second, terms) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("sigma", "worst"), [(0.5, 0.0135), (0.6, 0.012), (0.75, 0.0095), (0.9, 0.0075), (2.0, 0.002)]
)
def test_equation_6_finds_the_star_up_to_the_third_order(sigma: float, worst: float) -> None:
    """The place where the exact ratio is that of the two columns, found by bisection, is the true one."""
    terms = interpolation_terms(sigma)
    for x in np.linspace(-0.5, 0.5, 101):
        columns = [light(x, sigma, k - 0.5, k + 0.5) for k in (-1, 0, 1)]
        side = -1 if columns[0] >= columns[2] else 1
        ratio = max(columns[0], columns[2]) / columns[1]
        exact = brentq(
            lambda t, k, r: light(t, sigma, k - 0.5, k + 0.5) - r * light(t, sigma, -0.5, 0.5),
            -1.0,
            1.0,
            args=(side, ratio),
        )
        assert exact == pytest.approx(x, abs=1e-9)
        assert place_on_axis(*columns, terms) == pytest.approx(exact, abs=worst)


@settings(max_examples=500, deadline=None)
@given(
    st.tuples(*[st.floats(-1e6, 1e6) | st.sampled_from([0.0, 1e-300, 1.0, 1e150]) for _ in range(3)]),
    st.sampled_from(SIGMAS),
)
def test_any_three_columns_give_a_place_in_reach_or_none(
    columns: tuple[float, float, float], sigma: float
) -> None:
    x = place_on_axis(*columns, interpolation_terms(sigma))
    assert not math.isnan(x)
    assert abs(x) <= 0.75 or x > NONE


@pytest.mark.parametrize(
    "columns", [(0.0, 0.0, 0.0), (-5.0, 10.0, -3.0), (3.0, -1.0, 2.0), (10.0, 10.0, 10.0), (900.0, 1.0, 0.0)]
)
def test_columns_of_no_star_give_no_place(columns: tuple[float, float, float]) -> None:
    assert place_on_axis(*columns, interpolation_terms(0.75)) > NONE


def test_a_mirrored_spot_has_the_mirrored_place(render_stars: Render) -> None:
    terms = interpolation_terms(0.75)
    columns = [light(0.17, 0.75, k - 0.5, k + 0.5) for k in (-1, 0, 1)]
    assert place_on_axis(*columns, terms) == -place_on_axis(*columns[::-1], terms)
    image = dn(render_stars((41, 41), [(20.17, 19.62, 20000)]))
    spot, mirrored, turned = found(image), found(image[:, ::-1]), found(image.T)
    assert mirrored.x_px[0] == pytest.approx(40 - spot.x_px[0], abs=1e-9)
    assert (turned.x_px[0], turned.y_px[0]) == pytest.approx((spot.y_px[0], spot.x_px[0]), abs=1e-9)


@settings(max_examples=150, deadline=None)
@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.sampled_from([0.6, 0.75, 0.9]))
def test_a_bright_star_is_found_wherever_it_lies(
    render_stars: Render, dx: float, dy: float, sigma: float
) -> None:
    """The error is that of the second order: under 0.013 px, on each axis."""
    image = dn(render_stars((41, 41), [(20 + dx, 20 + dy, 60000)], sigma_px=sigma), 100)
    spots = found(image, psf_sigma_px=sigma)
    assert len(spots) == 1
    assert (spots.x_px[0], spots.y_px[0]) == pytest.approx((20 + dx, 20 + dy), abs=0.013)
    com = found(image, "com")
    assert (spots.flux_dn[0], spots.magnitude[0]) == (com.flux_dn[0], com.magnitude[0])


def errors(render_stars: Render, expose: Expose, electrons: float, centroid: str) -> NDArray[np.float64]:
    """Errors of both axes of some 800 stars in one noisy image, and how many were not found."""
    rng = np.random.default_rng(7)
    places = np.array([(x + rng.uniform(-0.5, 0.5), y + rng.uniform(-0.5, 0.5)) for y in range(20, 470, 20)
              for x in range(20, 740, 20)])  # fmt: skip
    signal = render_stars((480, 752), [(x, y, electrons) for x, y in places])
    image = expose(signal, rng, noise_electrons=60.0, maximum_dn=65535)
    spots = found(image, centroid)
    assert len(spots) == len(places)
    distance = np.hypot(spots.x_px[:, None] - places[:, 0], spots.y_px[:, None] - places[:, 1])
    nearest = distance.argmin(axis=1)
    assert len(set(nearest)) == len(places)
    return np.concatenate([spots.x_px - places[nearest, 0], spots.y_px - places[nearest, 1]])


@pytest.mark.parametrize("electrons", [300_000.0, 30_000.0, 5400.0])
def test_the_errors_are_those_expected(render_stars: Render, expose: Expose, electrons: float) -> None:
    """What the unit takes for the error of a star is its error in simulated images."""
    error = errors(render_stars, expose, electrons, "gaussian")
    expected = CentroidError(0.0036, 0.75, 8.0, 2, interpolated=True)
    sigma = expected.sigma_px(np.array([electrons / 8.0]), 60.0 / 8.0)[0]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(sigma, rel=0.1)
    assert abs(error.mean()) < 4 * sigma / math.sqrt(len(error))


def test_com_is_better_for_bright_stars_and_interpolation_for_dim_ones(
    render_stars: Render, expose: Expose
) -> None:
    """COM averages over more of the photons, and lets in more of the background (7.1 against 4.7 noise)."""
    com = [np.std(errors(render_stars, expose, electrons, "com")) for electrons in (300_000.0, 5400.0)]
    gauss = [np.std(errors(render_stars, expose, electrons, "gaussian")) for electrons in (300_000.0, 5400.0)]
    assert com[0] < 0.8 * gauss[0]
    assert gauss[1] < 0.9 * com[1]


@pytest.mark.parametrize("half_height", [0, 1])
def test_expected_errors_against_a_simulation_of_three_columns(half_height: int) -> None:
    """Photons alone and background alone, 3 x 3 px about the largest, the exact ratio solved by a table."""
    rng = np.random.default_rng(3)
    photon_factor, noise_factor = interpolation_errors(0.75, half_height)
    places = rng.uniform(-0.5, 0.5, (40_000, 2))
    scale = math.sqrt(2.0) * 0.75
    edges = np.arange(-1.5, 2.0)
    shares = [0.5 * np.diff(erf((edges - p[:, None]) / scale), axis=1) for p in places.T]
    images = 1e6 * shares[1][:, :, None] * shares[0][:, None, :]
    table = np.linspace(-0.7, 0.2, 20_001)
    ratio = [light(t, 0.75, -1.5, -0.5) / light(t, 0.75, -0.5, 0.5) for t in table]
    for noisy, expected in (
        (rng.poisson(images).astype(float), photon_factor / 1e3),
        (images + rng.normal(0.0, 500.0, images.shape), noise_factor * 500.0 / 1e6),
    ):
        columns = noisy[:, 1 - half_height : 2 + half_height].sum(axis=1)
        left = shares[0][:, 0] > shares[0][:, 2]
        first = np.where(left, columns[:, 0], columns[:, 2])
        place = np.interp(first / columns[:, 1], ratio[::-1], table[::-1])
        error = np.where(left, place, -place) - places[:, 0]
        assert error.std() == pytest.approx(expected, rel=0.04)


@pytest.mark.parametrize("place", [(20.0, 20.0), (20.3, 19.8), (19.52, 20.47)])
def test_one_row_of_two_pixels_gives_the_same_place_without_noise(
    render_stars: Render, place: tuple[float, float]
) -> None:
    """The other axis cancels in the ratio; only the rounding to DN differs."""
    image = dn(render_stars((41, 41), [(*place, 60000)]), 100)
    for half_height in (0, 1):
        spots = found(image, interpolation_half_height_px=half_height)
        assert (spots.x_px[0], spots.y_px[0]) == pytest.approx(place, abs=0.0105)


def test_a_saturated_star_keeps_its_centre_of_mass(render_stars: Render) -> None:
    image = np.minimum(dn(render_stars((61, 61), [(30.4, 29.7, 400_000)], sigma_px=1.2), 100), 3100)
    spots, com = found(image, saturation_dn=3100), found(image, "com", saturation_dn=3100)
    assert len(spots) == 1
    assert spots.saturated[0]
    assert (spots.x_px[0], spots.y_px[0]) == (com.x_px[0], com.y_px[0])


@pytest.mark.parametrize("streak", [(15.0, 0.0), (0.0, 15.0), (11.0, -11.0), (4.0, 14.0), (3.0, 0.0)])
def test_a_streak_keeps_its_centre_of_mass(render_stars: Render, streak: tuple[float, float]) -> None:
    for phase in np.linspace(-0.5, 0.5, 9):
        image = dn(render_stars((80, 80), [(40 + phase, 39.6, 20000)], streak_px=streak))
        spots, com = found(image), found(image, "com")
        assert len(spots) == 1
        assert (spots.x_px[0], spots.y_px[0]) == (com.x_px[0], com.y_px[0])


@pytest.mark.parametrize("separation", [0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
@pytest.mark.parametrize("ratio", [1.0, 0.5, 0.2])
def test_a_blend_lies_between_its_stars(render_stars: Render, separation: float, ratio: float) -> None:
    """Two stars in one spot: near their photocentre, and never outside of them."""
    for phase in np.linspace(-0.5, 0.5, 7):
        x = 30 + phase
        image = dn(render_stars((60, 60), [(x, 30.2, 20000), (x + separation, 30.2, 20000 * ratio)]))
        spots = found(image)
        assert len(spots) == 1
        assert x - 0.05 <= spots.x_px[0] <= x + separation + 0.05
        photocentre = x + separation * ratio / (1 + ratio)
        assert spots.x_px[0] == pytest.approx(photocentre, abs=0.15)
        assert spots.y_px[0] == pytest.approx(30.2, abs=0.03)


@pytest.mark.parametrize("separation", [6.0, 7.0, 8.0])
def test_a_neighbour_does_not_pull(render_stars: Render, separation: float) -> None:
    image = dn(render_stars((60, 60), [(25.2, 30.4, 700), (25.2 + separation, 30.4, 7000)]))
    spots = found(image)
    assert spots.x_px == pytest.approx([25.2 + separation, 25.2], abs=0.02)
    assert spots.y_px == pytest.approx([30.4, 30.4], abs=0.02)


def test_at_the_edge_a_spot_is_right_or_rejected(render_stars: Render) -> None:
    kept = 0
    for x in np.arange(-1.0, 6.0, 0.1):
        image = dn(render_stars((40, 40), [(x, 20.0, 30000)]))
        spots, com = found(image, tau_min_dn=600.0), found(image, "com", tau_min_dn=600.0)
        assert len(spots) == len(com)
        if len(spots):
            assert abs(spots.x_px[0] - x) < 0.015
            kept += 1
    assert kept > 30


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.sampled_from(["pixels", "blocks", "saturated"]))
def test_no_image_gives_nan_or_a_place_outside_of_its_spot(seed: int, half_window: int, kind: str) -> None:
    rng = np.random.default_rng(seed)
    image = rng.poisson(100.0, (48, 56)).astype(np.uint16)
    for _ in range(rng.integers(1, 12)):
        y, x = rng.integers(0, 48), rng.integers(0, 56)
        h, w = (1, 1) if kind == "pixels" else rng.integers(1, 6, 2)
        image[y : y + h, x : x + w] = 65535 if kind == "saturated" else rng.integers(101, 65535, (1, 1))
    spots = found(image, centroid_half_window_px=half_window, saturation_dn=65535, max_peak_fraction=1.0)
    com = found(image, "com", centroid_half_window_px=half_window, saturation_dn=65535, max_peak_fraction=1.0)
    assert np.isfinite([spots.x_px, spots.y_px, spots.flux_dn, spots.magnitude]).all()
    assert np.hypot(spots.x_px - com.x_px, spots.y_px - com.y_px).max(initial=0.0) <= 0.5 * math.sqrt(2)


def test_windows_interpolate_as_the_full_frame_does(render_stars: Render) -> None:
    image = dn(render_stars((60, 60), [(25.31, 30.44, 20000)]))
    rect = np.array([[15, 20, 36, 41]], np.int32)
    window = np.ascontiguousarray(image[20:41, 15:36]).ravel()
    parameters = DetectionParameters(zero_point_dn_per_s=ZERO_POINT, exposure_s=1.0, centroid="gaussian")
    offsets = np.array([0, window.size])
    result, work = detect_in_windows(window, offsets, rect, parameters, width_px=60, height_px=60)
    spots = found(image)
    assert result.spots.x_px == pytest.approx(spots.x_px, abs=0.002)
    assert result.spots.y_px == pytest.approx(spots.y_px, abs=0.002)
    assert work["centroid_interpolations"] == 2
    both = np.concatenate([window, window])
    offsets = np.array([0, window.size, 2 * window.size])
    _, twice = detect_in_windows(both, offsets, np.repeat(rect, 2, 0), parameters, width_px=60, height_px=60)
    for name, once, then in (
        ("centroid_interpolations", 2, 4),
        ("interpolated_tables", 1, 2),
        ("first_interpolations", 1, 1),
        ("frames_measured", 0, 0),
    ):
        assert (work[name], twice[name]) == (once, then), name


def test_work_is_counted_for_both_axes(render_stars: Render) -> None:
    image = dn(render_stars((60, 60), [(15.2, 30.4, 7000), (40.1, 20.2, 7000)]))
    for centroid, expected in (("gaussian", 4), ("com", 0)):
        parameters = DetectionParameters(zero_point_dn_per_s=ZERO_POINT, exposure_s=1.0, centroid=centroid)
        spots, work = detect(image, parameters)
        assert len(spots) == 2
        assert work["centroid_interpolations"] == expected
        assert work["interpolated_tables"] == work["first_interpolations"] == expected // 4
        assert work["centroid_stars"] == 4
        assert work["frames_measured"] == 1


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"centroid": "mean"}, "com, gaussian"),
        ({"interpolation_half_height_px": 2}, "0 or 1"),
        ({"psf_sigma_px": 0.0}, "psf_sigma_px"),
        ({"psf_sigma_px": math.nan}, "psf_sigma_px"),
        ({"psf_sigma_px": math.inf}, "psf_sigma_px"),
    ],
)
def test_bad_parameters_are_refused(changes: dict[str, Any], expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        DetectionParameters(**changes)
