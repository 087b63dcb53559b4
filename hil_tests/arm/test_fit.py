"""The fit of coefficients: what is known is found again with its uncertainty, nothing is negative."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from tools.calibration.fit import connected, fit
from tools.calibration.samples import TARGETS, Sample, fills_target, total_cycles

TRUE = {
    "runs": {"core_cycles": 91.0, "fills": 0.4},
    "cluster_pixels": {"core_cycles": 14.5, "fills": 0.02},
    "clusters": {"core_cycles": 230.0, "fills": 1.5},
}


def synthetic(rng, sequences, noise=0.0, true=TRUE, stage="clustering", frames=2):
    """Samples of known coefficients: runs, pixels and clusters that vary by themselves."""
    samples = []
    for sequence in range(sequences):
        for frame in range(frames):
            runs = int(rng.integers(20, 2000))
            counts = {
                "runs": runs,
                "cluster_pixels": int(runs * rng.uniform(1.5, 6)),
                "clusters": int(runs * rng.uniform(0.1, 0.7)) + 1,
            }
            samples.append(sample(sequence, frame, stage, counts, true, 1 + noise * rng.normal()))
    return samples


def sample(sequence, frame, stage, counts, true, factor=1.0):
    core = sum(number * true[name]["core_cycles"] for name, number in counts.items()) * factor
    fills = sum(number * true[name]["fills"] for name, number in counts.items()) * factor
    values = {"core_cycles": core, "instructions": core / 2, "accesses": core / 4}
    values |= {target: fills for target in TARGETS if target.startswith("line_fills")}
    kept = tuple(sorted((name, number) for name, number in counts.items() if number))
    return Sample(sequence, frame, "tracking", "detect", stage, kept, tuple(values[t] for t in TARGETS))


def test_exact_samples_give_the_exact_coefficients():
    found = fit(synthetic(np.random.default_rng(1), 12), resamples=20)
    for name, true in TRUE.items():
        estimates = found.coefficients[name]
        assert estimates["core_cycles"].value == pytest.approx(true["core_cycles"], rel=1e-9)
        assert estimates["instructions"].value == pytest.approx(true["core_cycles"] / 2, rel=1e-9)
        assert estimates["line_fills_8"].value == pytest.approx(true["fills"], rel=1e-9)
        assert estimates["core_cycles"].sigma < 1e-6 * true["core_cycles"]
    assert found.frames == dict.fromkeys(sorted(TRUE), 24)


def test_sigma_covers_the_truth_as_often_as_it_says():
    """Over 60 sets of noisy samples the true value lies within one sigma in 68 %, within two in 95 %.

    Bounds: four sigma of the binomial shares of 60 independent sets; the bootstrap of 60 sequences is a
    little narrow at the most.
    """
    within = {1: 0, 2: 0}
    sets = 60
    for seed in range(sets):
        found = fit(synthetic(np.random.default_rng(100 + seed), 60, 0.05, frames=1), resamples=60)
        estimate = found.coefficients["cluster_pixels"]["core_cycles"]
        off = abs(estimate.value - TRUE["cluster_pixels"]["core_cycles"]) / estimate.sigma
        for sigmas in within:
            within[sigmas] += off < sigmas
    assert 0.44 <= within[1] / sets <= 0.92
    assert within[2] / sets >= 0.84


def test_more_samples_make_it_surer():
    few = fit(synthetic(np.random.default_rng(5), 25, 0.05), resamples=100)
    many = fit(synthetic(np.random.default_rng(5), 400, 0.05), resamples=100)
    ratio = few.coefficients["runs"]["core_cycles"].sigma / many.coefficients["runs"]["core_cycles"].sigma
    assert 2.0 < ratio < 8.0  # sqrt(16) = 4


def test_frames_of_one_sequence_are_not_taken_for_independent():
    """Sequences whose frames all have the same error: copies of a frame add no certainty."""
    rng = np.random.default_rng(6)
    single = synthetic(rng, 50, 0.05, frames=1)
    copies = [
        Sample(s.sequence, frame, s.kind, s.step, s.stage, s.counts, s.values)
        for s in single
        for frame in range(9)
    ]
    one, nine = fit(single, resamples=200), fit(copies, resamples=200)
    for name in TRUE:
        a, b = one.coefficients[name]["core_cycles"], nine.coefficients[name]["core_cycles"]
        assert b.value == pytest.approx(a.value, rel=1e-6)
        assert b.sigma == pytest.approx(a.sigma, rel=0.25)


def test_a_coefficient_that_would_be_negative_is_zero():
    """Samples made with a negative coefficient: the same as scipy's other solver for bounds has it."""
    true = TRUE | {"clusters": {"core_cycles": -40.0, "fills": 0.5}}
    samples = synthetic(np.random.default_rng(2), 40, true=true)
    found = fit(samples, resamples=10)
    assert found.coefficients["clusters"]["core_cycles"].value == 0.0
    names = sorted(TRUE)
    right = np.array([s.value("core_cycles") for s in samples], float)
    rows = np.array([[dict(s.counts).get(n, 0) for n in names] for s in samples]) / right[:, None]
    expected = lsq_linear(rows, np.ones(len(right)), bounds=(0, np.inf), tol=1e-14).x
    values = [found.coefficients[name]["core_cycles"].value for name in names]
    assert values == pytest.approx(expected, rel=1e-6, abs=1e-6)
    assert values[names.index("runs")] > 0


def test_a_count_without_cost_has_coefficient_zero():
    true = TRUE | {"clusters": {"core_cycles": 0.0, "fills": 0.0}}
    found = fit(synthetic(np.random.default_rng(3), 20, true=true), resamples=10)
    assert found.coefficients["clusters"]["core_cycles"].value == pytest.approx(0.0, abs=1e-6)
    assert found.coefficients["runs"]["core_cycles"].value == pytest.approx(91.0, rel=1e-6)


def test_small_runs_weigh_as_much_as_large_ones():
    """Relative errors: a large run that is off by 10 % moves the fit no more than a small one would."""
    rng = np.random.default_rng(4)
    true = {"crc_bytes": {"core_cycles": 8.0, "fills": 0.1}}
    small = [sample(n, 0, "telemetry", {"crc_bytes": int(rng.integers(10, 20))}, true) for n in range(9)]
    large = sample(9, 0, "telemetry", {"crc_bytes": 1_000_000}, true, 1.1)
    found = fit([*small, large], resamples=10).coefficients["crc_bytes"]["core_cycles"].value
    # rows x = n / y: minimise 9 (c / 8 - 1)^2 + (c / 8.8 - 1)^2
    expected = (9 / 8 + 1 / 8.8) / (9 / 64 + 1 / 8.8**2)
    assert found == pytest.approx(expected, rel=1e-3)


def test_line_fills_of_a_run_that_hardly_has_any_do_not_rule():
    """A fill too many in a run of a million cycles is nothing; the fit of fills weighs by whole cycles."""
    true = {"crc_bytes": {"core_cycles": 8.0, "fills": 0.125}}
    samples = [
        sample(n, 0, "telemetry", {"crc_bytes": size}, true) for n, size in enumerate((1000, 4000, 9000))
    ]
    warm = sample(3, 0, "telemetry", {"crc_bytes": 2000}, {"crc_bytes": {"core_cycles": 8.0, "fills": 0.0}})
    found = fit([*samples, warm], resamples=10).coefficients["crc_bytes"][fills_target(32)].value
    cold = 0.125 / (8 + 48 * 0.125)  # fills per cycle of the three alike, relative rows all the same
    weights = np.array([1 / (8 + 6), 1 / (8 + 6), 1 / (8 + 6), 1 / 8])
    expected = (weights[:3] * cold * 1).sum() / (weights**2).sum()
    assert found == pytest.approx(expected, rel=1e-6)
    values = dict(zip(TARGETS, warm.values, strict=True))
    assert total_cycles(values) == 16000


def test_collinear_counts_are_named():
    rng = np.random.default_rng(7)
    true = TRUE | {"rows_joined": {"core_cycles": 50.0, "fills": 0.1}}
    samples = []
    for number in range(40):
        counts = {"runs": int(rng.integers(1000, 2000)), "clusters": int(rng.integers(100, 900))}
        counts["rows_joined"] = counts["runs"] + int(rng.integers(0, 3))
        samples.append(sample(number, 0, "clustering", counts, true))
    found = fit(samples, resamples=10)
    assert len(found.collinear) == 1
    warning = found.collinear[0]
    assert warning.counts == ("rows_joined", "runs")
    assert warning.condition_index > 100
    assert min(warning.inflation) > 1000
    assert "rows_joined" in str(warning)
    assert "clusters" not in str(warning)
    # the sum is known all the same
    pair = [found.coefficients[name]["core_cycles"].value for name in ("rows_joined", "runs")]
    assert sum(pair) == pytest.approx(141.0, rel=1e-3)


def test_counts_that_vary_by_themselves_are_not_called_collinear():
    assert fit(synthetic(np.random.default_rng(8), 40), resamples=10).collinear == ()


def test_stages_that_share_a_count_are_fitted_together():
    rng = np.random.default_rng(9)
    true = {
        "qmethod_solves": {"core_cycles": 30_000.0, "fills": 20.0},
        "votes": {"core_cycles": 25.0, "fills": 0.3},
        "telemetry_bytes": {"core_cycles": 11.0, "fills": 0.1},
    }
    samples = []
    for number in range(20):
        samples.append(sample(number, 0, "attitude", {"qmethod_solves": 1}, true))
        counts = {"votes": int(rng.integers(10, 5000)), "qmethod_solves": int(rng.integers(0, 9))}
        samples.append(sample(number, 0, "identification", counts, true))
        samples.append(sample(number, 0, "telemetry", {"telemetry_bytes": 70 + number}, true))
    groups = connected(samples)
    assert [{s.stage for s in group} for group in groups] == [{"attitude", "identification"}, {"telemetry"}]
    found = fit(samples, resamples=10)
    for name in true:
        value = found.coefficients[name]["core_cycles"].value
        assert value == pytest.approx(true[name]["core_cycles"], rel=1e-9)


def test_the_same_samples_give_the_same_fit():
    samples = synthetic(np.random.default_rng(10), 15, 0.05)
    assert fit(samples, resamples=30) == fit(samples, resamples=30)
    other = fit(samples, seed=2, resamples=30)
    assert other != fit(samples, resamples=30)  # the bootstrap's chance
    values = [
        {name: targets["core_cycles"].value for name, targets in found.coefficients.items()}
        for found in (other, fit(samples, resamples=30))
    ]
    assert values[0] == values[1]


def test_predictions_are_sums_of_counts_times_coefficients():
    samples = synthetic(np.random.default_rng(11), 6)
    found = fit(samples, resamples=5)
    for item in samples:
        assert found.predict(item)["core_cycles"] == pytest.approx(item.value("core_cycles"), rel=1e-9)
    unknown = sample(0, 0, "clustering", {"votes": 3}, {"votes": {"core_cycles": 1.0, "fills": 0.0}})
    with pytest.raises(KeyError, match="votes"):
        found.predict(unknown)
