"""Equations (9) to (15) of Zhang et al. 2014, with numbers worked out by hand or by the paper's own indices.

(1) to (6), the centroids, are in test_centroid.py and test_interpolation.py.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_tests.firmware_model import reference_brightness
from hil_tests.firmware_model.synthetic_sky import ARCSEC, random_directions
from st_emulator.firmware_model.catalogue.kvector import build_kvector, range_kernel
from st_emulator.firmware_model.catalogue.pairs import build_pair_catalogue, cosine_range
from st_emulator.firmware_model.catalogue.star_catalogue import build_star_catalogue
from st_emulator.firmware_model.catalogue.tables import StarTables
from st_emulator.firmware_model.image.spots import Spots

DEG = math.pi / 180


def on_the_equator(*ra_deg: float) -> np.ndarray:
    ra = np.radians(ra_deg)
    return np.stack([np.cos(ra), np.sin(ra), np.zeros(len(ra))], axis=1)


def test_9_intensities_are_in_the_ratio_of_the_magnitudes() -> None:
    spots = Spots.at(np.arange(4.0), np.arange(4.0), np.array([1.0, 2.0, 3.5, 6.0]))
    # In_m = In_k 2.512^(k - m), by hand: 2.512^1, 2.512^2.5, 2.512^5
    for place, ratio in ((1, 2.512), (2, 10.0013), (3, 100.023)):
        assert spots.flux_dn[0] / spots.flux_dn[place] == pytest.approx(ratio, rel=4e-4)


def test_10_pairs_stand_in_ascending_order_of_the_cosine_brighter_star_in_i() -> None:
    # Stars at 0, 3, 8 and 30 degrees along a circle; pairs under 20 degrees are 0-3, 3-8 and 0-8.
    catalogue = build_star_catalogue(
        [10, 20, 30, 40], on_the_equator(0, 3, 8, 30), np.array([4.0, 2.5, 3.0, 1.0]), 5.0, 0.0
    )
    pairs = build_pair_catalogue(catalogue, 20 * DEG)
    np.testing.assert_allclose(pairs.cos_angle, [0.990268069, 0.996194698, 0.998629535], atol=1e-9)
    assert catalogue.hip[pairs.brighter].tolist() == [30, 20, 20]
    assert catalogue.hip[pairs.dimmer].tolist() == [10, 30, 10]
    np.testing.assert_allclose(catalogue.hp_mag[pairs.brighter], [3.0, 2.5, 2.5])  # B_I
    np.testing.assert_allclose(catalogue.hp_mag[pairs.dimmer], [4.0, 3.0, 4.0])  # B_J


def test_10_the_whole_list_is_the_papers() -> None:
    rng = np.random.default_rng(1)
    vectors, magnitude = random_directions(rng, 150), rng.uniform(0, 5, 150).round(1).astype(np.float32)
    catalogue = build_star_catalogue(np.arange(150), vectors, magnitude, 6.0, 0.0)
    pairs = build_pair_catalogue(catalogue, 20 * DEG)
    plain = reference_brightness.pair_catalogue(vectors, magnitude, 20 * DEG)
    assert len(pairs) == len(plain) > 200
    np.testing.assert_allclose(pairs.cos_angle, [p for p, _, _ in plain], atol=1e-15)
    assert list(zip(pairs.brighter.tolist(), pairs.dimmer.tolist(), strict=True)) == [
        (i, j) for _, i, j in plain
    ]


def test_11_12_line_and_k_vector_of_a_list_worked_by_hand() -> None:
    p = [0.90, 0.91, 0.95, 0.965, 1.00]
    # a = (1.00 - 0.90) / 4, b = (5 x 0.90 - 1.00) / 4
    assert reference_brightness.line(p) == pytest.approx((0.025, 0.875))
    # y = 0.900, 0.925, 0.950, 0.975, 1.000
    assert reference_brightness.k_vector(p) == [1, 2, 3, 4, 5]
    kvector = build_kvector(np.array(p))
    # Ours runs from 0 over m steps instead of m - 1: y = 0.90, 0.92, 0.94, 0.96, 0.98, 1.00, and counts
    # what is below.
    assert (kvector.slope, kvector.offset) == pytest.approx((0.02, 0.90), abs=1e-9)
    assert kvector.count_below.tolist() == [0, 2, 2, 3, 4, 5]


def test_13_14_a_range_worked_by_hand() -> None:
    angle_deg = [5.0, 6.0, 8.0, 8.05, 8.1, 12.0]
    p = sorted(math.cos(a * DEG) for a in angle_deg)  # 12, 8.1, 8.05, 8, 6, 5 deg
    theta, epsilon = 8.04 * DEG, 0.035 * DEG  # 2 epsilon: from 7.97 to 8.11 deg
    start, end = reference_brightness.index_range(p, theta, epsilon)
    assert start <= 2  # the pairs of 8.1, 8.05 and 8 degrees are within, from 1
    assert end >= 4
    kvector = build_kvector(np.array(p))
    lowest, highest = cosine_range(theta, 2 * epsilon)
    first, stop, _ = range_kernel(
        np.array(p), kvector.slope, kvector.offset, kvector.count_below, lowest, highest
    )
    assert (first, stop) == (1, 4)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 1000), st.floats(0.5, 19.5), st.floats(2.0, 400.0))
def test_13_14_the_papers_range_holds_ours_and_hardly_more(
    seed: int, theta_deg: float, epsilon_arcsec: float
) -> None:
    rng = np.random.default_rng(seed)
    p = np.sort(rng.uniform(math.cos(20 * DEG), 1.0, 400))
    theta, epsilon = theta_deg * DEG, epsilon_arcsec * ARCSEC
    start, end = reference_brightness.index_range(p.tolist(), theta, epsilon)
    kvector = build_kvector(p)
    first, stop, _ = range_kernel(
        p, kvector.slope, kvector.offset, kvector.count_below, *cosine_range(theta, 2 * epsilon)
    )
    if stop > first:
        assert start - 1 <= first
        assert end >= stop
    # floor and ceil widen the range by up to one step of the line at each end, with what stands in it
    step = (p[-1] - p[0]) / (len(p) - 1)
    widest = cosine_range(theta, 2 * epsilon)
    assert end - start + 1 <= ((p > widest[0] - step) & (p <= widest[1] + step)).sum()


def mismatch_probability(stars: int, precision_rad: float, sines: tuple[float, float, float]) -> float:
    """Equation (15): how many catalogue stars fit three angles from a pivot by chance.

    rho = N [(N - 1) sin(k sigma)]^3 sin(th_ij) sin(th_ik) sin(th_il), with N stars evenly over the sky,
    k sigma = precision_rad the largest error of an angle, and the sines of the angles. It says nothing of
    the angles between the partners.
    """
    return float(stars * ((stars - 1) * math.sin(precision_rad)) ** 3 * math.prod(sines))


def test_15_mismatch_probability_by_hand() -> None:
    # N = 1471, k sigma = 10 arcsec, three angles of 10 deg:
    # 1470 sin(10") = 0.0712682; its cube 3.61982e-4; times sin(10 deg)^3 = 5.23606e-3; times 1471
    sine = math.sin(10 * DEG)
    assert mismatch_probability(1471, 10 * ARCSEC, (sine, sine, sine)) == pytest.approx(2.78810e-3, rel=1e-4)
    assert mismatch_probability(1, 10 * ARCSEC, (sine, sine, sine)) == 0.0


def test_15_counts_what_chance_gives_in_random_skies() -> None:
    """(star, three partners at the angles) in random skies, by plain counting."""
    rng = np.random.default_rng(15)
    stars, precision = 400, 0.005
    theta = np.array([6.0, 11.0, 17.0]) * DEG
    found = 0.0
    skies = 100
    for _ in range(skies):
        vectors = random_directions(rng, stars)
        angle = np.arccos(np.clip(vectors @ vectors.T, -1, 1))
        fitting = [(np.abs(angle - one) <= precision).sum(axis=1) for one in theta]
        found += float(np.prod(fitting, axis=0).sum()) / skies
    a, b, c = np.sin(theta).tolist()
    assert found == pytest.approx(mismatch_probability(stars, precision, (a, b, c)), rel=0.1)


def test_reference_pairs_are_those_with_a_bright_star_and_are_searched_alike() -> None:
    rng = np.random.default_rng(2)
    catalogue = build_star_catalogue(
        np.arange(800), random_directions(rng, 800), rng.uniform(1, 5, 800), 6.0, 0.0
    )
    tables = StarTables(catalogue, build_pair_catalogue(catalogue, 20 * DEG))
    bright = tables.reference_pairs(3.0)
    assert tables.reference_pairs(3.0) is bright
    kept = [
        (i, j)
        for i, j in zip(tables.pairs.brighter.tolist(), tables.pairs.dimmer.tolist(), strict=True)
        if catalogue.hp_mag[i] < 3.0
    ]
    assert list(zip(bright.brighter.tolist(), bright.dimmer.tolist(), strict=True)) == kept
    assert 0 < len(kept) < len(tables.pairs)
    for angle in np.linspace(0.001, 20 * DEG, 60):
        whole = zip(*(part.tolist() for part in tables.pairs.query_pairs(angle, 1e-3)), strict=True)
        part = zip(*(part.tolist() for part in bright.query_pairs(angle, 1e-3)), strict=True)
        assert list(part) == [pair for pair in whole if catalogue.hp_mag[pair[0]] < 3.0]
    assert len(tables.reference_pairs(0.5)) == 0
