"""Intervals against scipy's, and their coverage."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest, kurtosis, skew
from scipy.stats import t as student

from st_emulator.campaigns.confidence import clustered_share, share, stratified_share, student_95
from st_emulator.campaigns.spreads import LEAST_GROUPS, Moments, Spread


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


@pytest.mark.parametrize("freedom", [1, 2, 3, 4, 5, 6, 9, 25, 199, 10_000])
def test_students_quantile(freedom):
    assert student_95(freedom) == pytest.approx(student.ppf(0.975, freedom), abs=3e-4)


def test_no_freedom():
    assert student_95(0) == np.inf


def coverage(drawn, true: float) -> float:
    return float(np.mean([item.low <= true <= item.high for item in drawn]))


def test_a_clustered_share_covers_the_truth():
    """Groups that differ: 26 cases of one share their group's own probability."""
    rng = np.random.default_rng(5)
    groups, plain = [], []
    for _ in range(400):
        p = rng.beta(1.0, 1.5, 40)  # mean 0.4
        counts = rng.binomial(26, p)
        groups.append(clustered_share(counts.tolist(), [26] * 40))
        plain.append(share(int(counts.sum()), 26 * 40))
    assert coverage(groups, 0.4) == pytest.approx(0.95, abs=0.03)
    assert coverage(plain, 0.4) < 0.6  # as if the cases had nothing in common


def test_groups_that_all_agree_are_one_case_each():
    ours, whole = clustered_share([26] * 8, [26] * 8), share(8, 8)
    assert (ours.value, ours.low, ours.high, ours.cases) == (1.0, whole.low, 1.0, 208)


def test_cases_of_their_own_are_a_plain_sample():
    ours, plain = clustered_share([1] * 300 + [0] * 700, [1] * 1000), share(300, 1000)
    assert (ours.low, ours.high) == pytest.approx((plain.low, plain.high), abs=2e-3)


def test_a_spread_is_scipys():
    rng = np.random.default_rng(2)
    parts = [rng.gamma(2.0, 1.0 + group / 5, 30 + group) for group in range(8)]
    found = Spread.of((group, Moments.of(part)) for group, part in enumerate(parts))
    whole = np.concatenate(parts)
    assert found.count == len(whole)
    assert (found.mean, found.std) == pytest.approx((whole.mean(), whole.std()))
    assert found.skewness == pytest.approx(skew(whole))
    assert found.kurtosis == pytest.approx(kurtosis(whole, fisher=False))


@pytest.mark.parametrize("scatter", [0.0, 0.6])
def test_a_spreads_interval_covers_the_truth(scatter):
    """Groups whose errors are of different size; those with none at all."""
    rng = np.random.default_rng(3)
    true = np.sqrt(np.exp(2 * scatter**2))
    hits = []
    for _ in range(300):
        sizes = np.exp(scatter * rng.normal(size=40))
        found = Spread.of((group, Moments.of(size * rng.normal(size=20))) for group, size in enumerate(sizes))
        hits.append(abs(found.std - true) <= found.std_half)
    assert np.mean(hits) > 0.85  # linearised: a little short where a few groups have most of the spread


def test_few_groups_say_nothing():
    parts = [np.array([-1.0, 1.0])] * (LEAST_GROUPS - 1)
    found = Spread.of((group, Moments.of(part)) for group, part in enumerate(parts))
    assert found.std == 1.0
    assert found.std_half == np.inf
    assert Spread.of([(0, Moments.of(np.array([1.0])))]) is None
