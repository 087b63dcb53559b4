"""Noise: the generator against published numbers, distributions against scipy, pixels against each other."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from st_emulator.world import noise


def words(seed: int, n: int, stream: int = noise.STREAM_FRAME, number: int = 0) -> np.ndarray:
    out = np.empty(n, dtype=np.uint64)
    noise.words_of(noise.stream_key(seed, stream, number), 0, out)
    return out


def normals(of: np.ndarray) -> np.ndarray:
    out = np.empty(of.shape[0], dtype=np.float32)
    noise.normals_of(of, noise.NORMAL_TABLE, out)
    return out


def test_words_are_splitmix64() -> None:
    # The first outputs of SplitMix64 with seed 1234567, as published with Vigna's reference code.
    out = np.empty(5, dtype=np.uint64)
    noise.words_of(np.uint64(1234567), 1, out)
    assert out.tolist() == [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]


def test_words_can_be_made_from_any_pixel_on() -> None:
    key = noise.stream_key(5, noise.STREAM_FRAME, 9)
    whole, part = np.empty(100, dtype=np.uint64), np.empty(30, dtype=np.uint64)
    noise.words_of(key, 0, whole)
    noise.words_of(key, 41, part)
    np.testing.assert_array_equal(part, whole[41:71])


def test_keys_differ_by_seed_stream_and_frame() -> None:
    keys = {
        int(noise.stream_key(seed, stream, frame))
        for seed in (-1, 0, 1, 2**64 - 2, 12345)
        for stream in (1, 2, 3)
        for frame in (0, 1, 2, 1000)
    }
    assert len(keys) == 5 * 3 * 4
    assert noise.stream_key(-1, 1) == noise.stream_key(2**64 - 1, 1)


def test_deviates_are_the_quantiles_of_their_words() -> None:
    w = words(3, 200_000)
    place = (w & np.uint64(2**63 - 1)).astype(np.float64) / 2.0**63
    expected = stats.norm.isf(0.5 * (1.0 - place)) * np.where(w >> np.uint64(63), -1.0, 1.0)
    error = np.abs(normals(w) - expected)
    assert error.max() < 6e-4
    assert error[np.abs(expected) < 2.0].max() < 1e-5


@pytest.mark.parametrize("negative", [False, True])
def test_tails_are_exact_to_the_last_bit_of_the_word(negative: bool) -> None:
    left = np.array([0, 1, 2, 10, 1_000, 10**6, 10**9, 10**12, 10**15, 8 * 10**15], dtype=np.uint64)
    w = np.uint64(2**63 - 1) - left
    if negative:
        w |= np.uint64(2**63)
    expected = stats.norm.isf((left.astype(np.float64) + 0.5) / 2.0**64)
    found = normals(w)
    np.testing.assert_allclose(np.abs(found), expected, rtol=3e-7)
    assert np.all(found < 0.0) == negative
    assert expected[0] > 9.0


def test_deviates_are_normal() -> None:
    z = normals(words(11, 1_000_000)).astype(np.float64)
    assert stats.kstest(z, "norm").pvalue > 0.01
    assert abs(z.mean()) < 4e-3
    assert abs(z.var() - 1.0) < 6e-3
    assert abs(stats.skew(z)) < 0.01
    assert abs(stats.kurtosis(z)) < 0.02


@pytest.mark.parametrize("lag", [1, 2, 64, 1024])
def test_pixels_frames_and_seeds_do_not_know_each_other(lag: int) -> None:
    n = 400_000
    z = normals(words(7, n)).astype(np.float64)
    limit = 4.5 / np.sqrt(n)
    assert abs(np.corrcoef(z[:-lag], z[lag:])[0, 1]) < limit
    assert abs(np.corrcoef(np.abs(z[:-lag]), np.abs(z[lag:]))[0, 1]) < limit
    assert abs(np.corrcoef(z, normals(words(7, n, number=lag)))[0, 1]) < limit
    assert abs(np.corrcoef(z, normals(words(7 + lag, n)))[0, 1]) < limit


def digitised(
    mean: float, n: int, read: float, gain: float, offset: float, bits: int, well: float
) -> np.ndarray:
    w = words(21, n)
    out = np.empty(n, dtype=np.uint16)
    detector = noise.detector_constants(read, gain, offset, bits, well)
    noise.digitise(np.full(n, mean, dtype=np.float32), w, normals(w), noise.NORMAL_TABLE, detector, out)
    return out


def exact_distribution(
    mean: float, read: float, gain: float, offset: float, bits: int, well: float
) -> np.ndarray:
    """P(number put out) for 0 .. 2^bits - 1: Poisson charge capped at the well, plus Gaussian, digitised."""
    low, high = stats.poisson.ppf([1e-13, 1.0 - 1e-13], mean)
    charges = np.arange(low, high + 1)
    probability = stats.poisson.pmf(charges, mean)
    edges = (np.arange(1, 2**bits) - 0.5 - offset) * gain  # lower edge of each number from 1 on
    below = (
        stats.norm.cdf((edges[:, None] - np.minimum(charges, well)[None, :]) / max(read, 1e-9)) @ probability
    )
    return np.diff(np.concatenate(([0.0], below, [1.0])))


@pytest.mark.parametrize(
    ("mean", "read", "gain", "offset", "bits", "well"),
    [
        (0.0, 4.0, 1.0, 20.0, 8, 1e4),  # nothing but read-out noise
        (0.4, 3.0, 1.0, 12.0, 8, 1e4),  # drawn in two steps, exact Poisson
        (12.0, 1.5, 1.0, 6.0, 8, 1e4),
        (28.0, 0.5, 1.0, 5.0, 8, 1e4),
        (35.0, 0.5, 1.0, 5.0, 8, 1e4),  # in two steps, expanded Poisson
        (5.0, 7.0, 1.0, 30.0, 8, 1e4),  # in one step, mostly read-out noise
        (41.0, 1.0, 1.0, 5.0, 8, 1e4),  # in one step, mostly shot noise
        (120.0, 2.0, 1.0, 5.0, 8, 1e4),
        (3000.0, 30.0, 10.0, 20.0, 12, 1e5),
        (950.0, 5.0, 10.0, 5.0, 8, 1000.0),  # the well cuts the distribution
        (5000.0, 8.0, 10.0, 5.0, 8, 1000.0),  # full well
        (3.0, 6.0, 1.0, 2.0, 8, 1e4),  # clipped at zero
        (2500.0, 6.0, 10.0, 2.0, 8, 1e4),  # clipped at full scale
    ],
)
def test_numbers_put_out_have_the_exact_distribution(
    mean: float, read: float, gain: float, offset: float, bits: int, well: float
) -> None:
    n = 300_000
    found = np.bincount(digitised(mean, n, read, gain, offset, bits, well), minlength=2**bits)
    expected = n * exact_distribution(mean, read, gain, offset, bits, well)
    usual = expected >= 20.0
    if usual.sum() > 1:
        rest = n - expected[usual].sum()
        observed = np.append(found[usual], found[~usual].sum()) if rest > 20.0 else found[usual]
        wanted = np.append(expected[usual], rest) if rest > 20.0 else expected[usual]
        assert stats.chisquare(observed, wanted * observed.sum() / wanted.sum()).pvalue > 1e-3
    assert found[~usual].sum() < max(n - expected[usual].sum(), 0.0) * 2.0 + 20.0


def test_moments_of_shot_noise() -> None:
    """Mean, variance and skewness of Poisson plus Gaussian, from pixels."""
    for mean, read in ((45.0, 1.0), (400.0, 10.0), (20_000.0, 50.0)):
        n = 500_000
        x = digitised(mean, n, read, 1.0, 500.0, 16, 1e9).astype(np.float64) - 500.0
        variance = mean + read**2
        assert abs(x.mean() - mean) < 4.5 * np.sqrt(variance / n)
        assert abs(x.var() / (variance + 1.0 / 12.0) - 1.0) < 4.5 * np.sqrt(2.0 / n)
        assert abs(stats.skew(x) - mean / variance**1.5) < 4.5 * np.sqrt(6.0 / n)


def test_fixed_pattern_statistics() -> None:
    keys = np.array([noise.stream_key(1, s) for s in (2, 3, 4, 5)], dtype=np.uint64)
    response, dark = noise.fixed_pattern(keys, noise.NORMAL_TABLE, 700, 600, 0.02, 500.0, 0.1, 0.0, 0.0)
    assert response.shape == dark.shape == (600, 700)
    assert abs(response.mean() - 1.0) < 2e-4
    assert abs(response.std() / 0.02 - 1.0) < 0.01
    assert abs(dark.mean() / 500.0 - 1.0) < 1e-3
    assert abs(dark.std() / 50.0 - 1.0) < 0.01
    assert abs(np.corrcoef(response.ravel(), dark.ravel())[0, 1]) < 4.5 / np.sqrt(420_000)
    _, hot = noise.fixed_pattern(keys, noise.NORMAL_TABLE, 700, 600, 0.02, 500.0, 0.1, 0.01, 8000.0)
    extra = (hot.astype(np.float64) - dark).ravel()
    lit = extra[extra > 0.0]
    assert abs(lit.size / 4200.0 - 1.0) < 0.08
    assert stats.kstest(lit, "expon", args=(0.0, 8000.0)).pvalue > 0.01


def test_uniforms_are_uniform() -> None:
    u = noise.uniforms(noise.stream_key(4, noise.STREAM_FALSE_SPOTS, 2), 100_000)
    assert stats.kstest(u, "uniform").pvalue > 0.01
    assert u.min() > 0.0
    assert u.max() < 1.0
