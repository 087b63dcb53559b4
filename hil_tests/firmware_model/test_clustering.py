"""Threshold scan and run-length clustering against slow, plain versions and scipy.ndimage."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy import ndimage

from st_emulator.firmware_model.image import clustering
from st_emulator.firmware_model.image.background import frame_statistics, window_statistics
from st_emulator.firmware_model.image.clustering import BLOCK_PX, join_runs, sum_clusters, threshold_scan

Mask = NDArray[np.bool_]


def scan(
    image: NDArray[np.uint16], background: float, over: float, average_pixels: int = 256, room: int = 5000
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.int32], bool]:
    runs, averages = np.full((room, 3), -1, np.int32), np.full(room, np.nan)
    row_start = np.full(image.shape[0] + 1, -1, np.int32)
    count, overflowed, _ = threshold_scan(image, background, over, average_pixels, runs, averages, row_start)
    return runs[:count], averages[:count], row_start, overflowed


def mask_of(runs: NDArray[np.int32], shape: tuple[int, ...]) -> Mask:
    mask = np.zeros(shape, np.bool_)
    for row, first, end in runs:
        assert not mask[row, first:end].any()
        mask[row, first:end] = True
    return mask


def runs_of(mask: Mask) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Plain run-length code of a mask: runs and row_start."""
    runs, row_start = [], [0]
    for row, line in enumerate(mask):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(int)))
        runs += [(row, first, end) for first, end in zip(edges[::2], edges[1::2], strict=True)]
        row_start.append(len(runs))
    return np.array(runs, np.int32).reshape(-1, 3), np.array(row_start, np.int32)


def plain_scan(image: NDArray[np.uint16], background: float, over: float, average_pixels: int) -> Mask:
    """The moving average along the zigzag, pixel by pixel as the docstring defines it."""
    mask = np.zeros(image.shape, np.bool_)
    average = background
    for row in range(image.shape[0]):
        blocks = [slice(c, c + BLOCK_PX) for c in range(0, image.shape[1], BLOCK_PX)]
        for block in blocks if row % 2 == 0 else blocks[::-1]:
            pixels = image[row, block].astype(float)
            threshold = np.floor(average + over)
            mask[row, block] = pixels > average + over
            clipped = np.minimum(pixels, threshold)
            average += (clipped.sum() - len(pixels) * average) / max(average_pixels, BLOCK_PX)
    return mask


images = arrays(
    np.uint16,
    st.tuples(st.integers(1, 12), st.integers(1, 100)),
    elements=st.integers(0, 40) | st.just(65535),
)
masks = arrays(np.bool_, st.tuples(st.integers(1, 30), st.integers(1, 30)))


@settings(max_examples=200, deadline=None)
@given(images, st.floats(0, 50), st.floats(0.5, 30), st.sampled_from([1, 64, 256]))
def test_scan_equals_the_plain_version(
    image: NDArray[np.uint16], background: float, over: float, average_pixels: int
) -> None:
    runs, _, row_start, overflowed = scan(image, background, over, average_pixels)
    expected = plain_scan(image, background, over, average_pixels)
    assert (mask_of(runs, image.shape) == expected).all()
    expected_runs, expected_start = runs_of(expected)
    assert (runs == expected_runs).all()
    assert (row_start == expected_start).all()
    assert not overflowed


def test_scan_stops_when_the_run_table_is_full() -> None:
    image = np.zeros((4, 64), np.uint16)
    image[:, ::2] = 1000
    runs, _, row_start, overflowed = scan(image, 0.0, 500.0, room=40)
    assert overflowed
    assert len(runs) == 40
    assert row_start.tolist() == [0, 32, 40, 40, 40]
    exact, _, _, overflowed = scan(image, 0.0, 500.0, room=128)
    assert len(exact) == 128
    assert not overflowed


def test_a_star_hardly_lifts_the_average_and_a_step_is_followed() -> None:
    image = np.full((40, 640), 100, np.uint16)
    image[0, 100:106] = 60000
    image[20:] = 300
    image[:, 639] = 65000  # a run a row, to read the average there
    runs, averages, _, _ = scan(image, 100.0, 10.0)
    at_column_639 = averages[runs[:, 2] == 640]
    assert at_column_639[0] == pytest.approx(100.0, abs=6 * 10 / 256 + 0.2)
    assert at_column_639[-1] == pytest.approx(300.0, abs=1.0)


def test_the_average_follows_a_gradient_from_both_sides() -> None:
    """The zigzag: at the same column the average lags on the left in one row, on the right in the next."""
    image = np.tile(np.arange(1000, 1640, dtype=np.uint16), (20, 1))
    image[:, 320] += 5000
    _, averages, _, _ = scan(image, 1000.0, 1000.0)
    assert averages[10] < 1320 - 100
    assert averages[11] > 1320 + 100


@settings(max_examples=300, deadline=None)
@given(masks)
def test_labels_equal_scipy(mask: Mask) -> None:
    runs, row_start = runs_of(mask)
    label = np.full(len(runs), -1, np.int32)
    clusters, unions = join_runs(runs, len(runs), row_start, label)
    expected, number = ndimage.label(mask, structure=np.ones((3, 3)))
    assert clusters == number
    assert unions == len(runs) - number  # every union reduces the number of sets by one
    image = np.zeros(mask.shape, int)
    for (row, first, end), cluster in zip(runs, label, strict=True):
        image[row, first:end] = cluster + 1
    pairs = {(a, b) for a, b in zip(image.ravel(), expected.ravel(), strict=True)}
    assert len(pairs) == number + (not mask.all())  # one to one
    firsts = [int(np.flatnonzero(label == c)[0]) for c in range(clusters)]
    assert firsts == sorted(firsts)


@pytest.mark.parametrize(
    "picture",
    [
        "#.#\n#.#\n###",
        "#.#\n.#.\n#.#",
        "#..\n.#.\n..#",
        "..#\n.#.\n#..",
        "#.#.#\n#.#.#\n#####",
        "##.\n..#\n##.",
    ],
)
def test_shapes_that_need_the_union(picture: str) -> None:
    mask = np.array([[c == "#" for c in line] for line in picture.splitlines()])
    runs, row_start = runs_of(mask)
    label = np.zeros(len(runs), np.int32)
    clusters, _ = join_runs(runs, len(runs), row_start, label)
    assert clusters == 1
    assert not label.any()


@settings(max_examples=100, deadline=None)
@given(
    masks,
    st.integers(0, 2**32 - 1),
)
def test_cluster_sums_equal_scipy(mask: Mask, seed: int) -> None:
    rng = np.random.default_rng(seed)
    image = np.where(mask, rng.integers(50, 5000, mask.shape), 0).astype(np.uint16)
    runs, row_start = runs_of(mask)
    label = np.zeros(len(runs), np.int32)
    clusters, _ = join_runs(runs, len(runs), row_start, label)
    background = rng.uniform(0, 50, len(runs))
    table = sum_clusters(image, runs, len(runs), background, label, clusters)
    labels, _ = ndimage.label(mask, structure=np.ones((3, 3)))
    for cluster in range(clusters):
        first = int(np.flatnonzero(label == cluster)[0])
        row, column = runs[first, 0], runs[first, 1]
        here = labels == labels[row, column]
        value = (image - background[first])[here]
        y, x = np.nonzero(here)
        entry = table[cluster]
        assert entry[clustering.PIXELS] == here.sum()
        assert entry[clustering.BACKGROUND] == background[first]
        assert entry[clustering.SUM] == pytest.approx(value.sum())
        assert entry[clustering.SUM_X] == pytest.approx((value * x).sum())
        assert entry[clustering.SUM_Y] == pytest.approx((value * y).sum())
        assert entry[clustering.PEAK] == pytest.approx(value.max())
        box = [
            entry[i] for i in (clustering.FIRST_X, clustering.LAST_X, clustering.FIRST_Y, clustering.LAST_Y)
        ]
        assert box == [x.min(), x.max(), y.min(), y.max()]


@pytest.mark.parametrize("sigma", [0.6, 2.4, 30.0])
def test_frame_statistics_of_noise_with_stars_and_a_gradient(sigma: float) -> None:
    rng = np.random.default_rng(7)
    truth = 200.0 + np.linspace(0, 3 * sigma, 640)[None, :] + rng.normal(0, sigma, (480, 640))
    for _ in range(300):  # stars and their wings
        y, x = rng.integers(0, 476), rng.integers(0, 636)
        truth[y : y + 5, x : x + 5] += 40 * sigma
    background, noise, _ = frame_statistics(np.rint(truth).astype(np.uint16))
    with_quantisation = np.hypot(sigma, 12**-0.5)
    assert noise == pytest.approx(with_quantisation, rel=0.05)
    assert background == pytest.approx(200 + 1.5 * sigma, abs=0.25 * sigma + 0.05)


def test_frame_statistics_of_a_frame_clipped_at_zero() -> None:
    """Seven pixels of ten at 0 DN: the noise is what is left of it, not nothing."""
    rng = np.random.default_rng(8)
    clipped = np.clip(np.rint(rng.normal(-5.0, 10.0, (480, 640))), 0, None)
    assert np.mean(clipped == 0) > 0.6
    _, noise, _ = frame_statistics(clipped.astype(np.uint16))
    assert noise == pytest.approx(clipped.std(), rel=0.1)


@pytest.mark.parametrize("shape", [(1, 2), (2, 2), (3, 5), (1, 400), (400, 2)])
def test_frame_statistics_of_small_frames(shape: tuple[int, int]) -> None:
    background, noise, samples = frame_statistics(np.full(shape, 123, np.uint16))
    assert (background, noise) == (123.0, 0.0)
    assert samples > 0


@pytest.mark.parametrize(("side", "flux_sigma"), [(11, 100), (11, 3000), (33, 300), (61, 30000)])
def test_window_statistics_with_a_star_inside(side: int, flux_sigma: float) -> None:
    rng = np.random.default_rng(3)
    levels, noises = [], []
    profile = np.exp(-0.5 * ((np.arange(side) - side // 2) / 0.8) ** 2)
    star = 2.4 * flux_sigma * np.outer(profile, profile) / profile.sum() ** 2
    for _ in range(50):
        window = np.rint(100 + star + rng.normal(0, 2.4, (side, side))).astype(np.uint16)
        level, noise, _ = window_statistics(window, np.empty(256))
        levels.append(level)
        noises.append(noise)
    assert np.mean(levels) == pytest.approx(100.0, abs=0.3 * 2.4)
    assert np.mean(noises) == pytest.approx(2.42, rel=0.12)


def test_window_statistics_of_a_constant_window() -> None:
    assert window_statistics(np.full((9, 9), 50, np.uint16), np.empty(256)) == (50.0, 0.0, 1)
    assert window_statistics(np.full((1, 1), 50, np.uint16), np.empty(256))[0] == 50.0
