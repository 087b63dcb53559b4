"""Intervals against scipy's, and their coverage."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest

from st_emulator.campaigns.confidence import share, stratified_share


@pytest.mark.parametrize(
    ("count", "cases"), [(0, 10), (10, 10), (1, 7), (9982, 10_000), (10_000, 10_000), (3, 8)]
)
def test_wilsons_interval(count, cases):
    ours = share(count, cases)
    theirs = binomtest(count, cases).proportion_ci(0.95, method="wilson")
    assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high), abs=1e-12)
    assert ours.value == count / cases


@pytest.mark.parametrize(("count", "cases"), [(1, 0), (-1, 5), (6, 5)])
def test_no_share(count, cases):
    with pytest.raises(ValueError, match="no share"):
        share(count, cases)


def test_strata_in_proportion_are_a_plain_sample():
    """Many cases with the same share in every stratum, as many of each as it weighs."""
    plain = share(1600, 2000)
    ours = stratified_share([400, 1200], [500, 1500], [0.25, 0.75])
    assert ours.value == plain.value
    assert (ours.low, ours.high) == pytest.approx((plain.low, plain.high), abs=1e-3)


def test_a_stratum_without_a_miss_is_not_certain():
    ours = stratified_share([20, 5000], [20, 5000], [0.5, 0.5])
    assert ours.value == 1.0
    assert ours.low < 0.97  # twenty cases say little of a half of the whole
    many = stratified_share([5000, 5000], [5000, 5000], [0.5, 0.5])
    assert many.low > 0.999


def test_a_stratum_without_weight_is_left_out():
    assert stratified_share([0, 50], [0, 100], [0.0, 1.0]).value == 0.5
    with pytest.raises(ValueError, match="no cases"):
        stratified_share([0, 50], [0, 100], [0.1, 0.9])


def test_coverage_of_the_stratified_interval():
    """The true share lies in the interval about as often as promised (95 %)."""
    rng = np.random.default_rng(3)
    weights, shares, cases = [0.014, 0.1, 0.886], [0.7, 0.95, 0.999], [500, 1000, 4000]
    truth = float(np.dot(weights, shares))
    inside = 0
    for _ in range(2000):
        counts = [int(rng.binomial(number, p)) for number, p in zip(cases, shares, strict=True)]
        found = stratified_share(counts, cases, weights)
        inside += found.low <= truth <= found.high
    assert 0.93 <= inside / 2000 <= 0.995
