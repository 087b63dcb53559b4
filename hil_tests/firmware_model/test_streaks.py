"""Clusters with their pixels, pieces of streaks, fusion of two frames: against scipy and brute force."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from st_emulator.firmware_model.image.detection import DetectionParameters, detect, detect_clusters
from st_emulator.firmware_model.image.spots import Spots
from st_emulator.firmware_model.image.streaks import StreakTable, fuse, streak_table

Render = Callable[..., NDArray[np.float64]]
BACKGROUND_DN = 100
PARAMETERS = DetectionParameters(
    tau_min_dn=20.0, max_pixels=2000, zero_point_dn_per_s=1e7, exposure_s=0.2, centroid="cluster"
)
EIGHT = np.ones((3, 3))


def picture(signal: NDArray[np.float64], seed: int = 0, noise_dn: float = 1.0) -> NDArray[np.uint16]:
    noise = np.random.default_rng(seed).normal(0.0, noise_dn, signal.shape)
    return np.clip(np.rint(signal + BACKGROUND_DN + noise), 0, 4095).astype(np.uint16)


def table_of(image: NDArray[np.uint16], parameters: DetectionParameters = PARAMETERS) -> StreakTable:
    return streak_table(detect_clusters(image, parameters)[0])[0]


def streaks_at(render: Render, seed: int, count: int, length: tuple[float, float]) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    stars = [(*rng.uniform(30, 226, 2), 10 ** rng.uniform(3.6, 4.5)) for _ in range(count)]
    return render((256, 256), stars, streak_px=length)


@pytest.mark.parametrize("length", [(0.0, 0.0), (14.0, 5.0), (-3.0, 24.0)])
def test_a_cluster_is_the_weighted_mean_of_all_its_pixels(
    render_stars: Render, length: tuple[float, float]
) -> None:
    """By scipy, over the pixels that are over the threshold: place, energy, number and extent."""
    image = picture(streaks_at(render_stars, 3, 12, length))
    table = table_of(image)
    over = image > BACKGROUND_DN + 20.0
    label, count = ndimage.label(over, EIGHT)
    light = image - float(BACKGROUND_DN)
    expected = []
    for number, (rows, columns) in enumerate(ndimage.find_objects(label), 1):
        inside = label == number
        if inside.sum() < 2:
            continue
        y, x = ndimage.center_of_mass(light, label, number)
        box = (columns.start, columns.stop - 1, rows.start, rows.stop - 1)
        expected.append((light[inside].sum(), x, y, int(inside.sum()), box))
    expected.sort(key=lambda entry: -entry[0])
    assert 5 < len(expected) <= count
    assert len(table) == len(expected)
    spots = table.spots
    # the firmware's moving average is lifted by stars of the same rows: by 1 DN at most, as its pixels show
    for place, (flux, x, y, pixels, box) in enumerate(expected):
        assert abs(int(spots.pixels[place]) - pixels) <= 3
        assert 0.0 <= flux - spots.flux_dn[place] + 25.0 <= 1.5 * pixels + 50.0
        assert abs(spots.x_px[place] - x) < 0.06
        assert abs(spots.y_px[place] - y) < 0.06
        assert np.abs(table.extent[place] - box).max() <= 1


def test_the_runs_kept_are_the_pixels_of_each_spot(render_stars: Render) -> None:
    image = picture(streaks_at(render_stars, 4, 15, (9.0, 12.0)))
    table = table_of(image)
    assert table.run_start[-1] == len(table.runs)
    for spot in range(len(table)):
        runs = table.runs[table.run_start[spot] : table.run_start[spot + 1]]
        assert (runs[:, 2] - runs[:, 1]).sum() == table.spots.pixels[spot]
        assert [runs[:, 1].min(), runs[:, 2].max() - 1, runs[0, 0], runs[-1, 0]] == table.extent[
            spot
        ].tolist()
        for row, first, end in runs.tolist():
            assert image[row, first:end].min() > BACKGROUND_DN + 15


def test_isolated_pixels_are_no_spots(render_stars: Render) -> None:
    signal = streaks_at(render_stars, 5, 6, (12.0, 0.0))
    before = len(table_of(picture(signal)))
    signal[10, 10] = signal[240, 100] = 900.0
    detected, _ = detect_clusters(picture(signal), PARAMETERS)
    assert len(detected.spots) == before
    assert detected.spots.rejected.small == 2


def test_other_centroids_give_the_spots_of_detect(render_stars: Render) -> None:
    image = picture(streaks_at(render_stars, 6, 20, (0.0, 0.0)))
    for kind in ("com", "gaussian", "cluster"):
        parameters = DetectionParameters(tau_min_dn=20.0, centroid=kind)
        spots, work = detect(image, parameters)
        detected, the_same = detect_clusters(image, parameters)
        assert np.array_equal(detected.spots.x_px, spots.x_px)
        assert work == the_same


def broken(render: Render, seed: int) -> NDArray[np.uint16]:
    """Streaks about the threshold: their light comes and goes along them."""
    rng = np.random.default_rng(seed)
    signal = streaks_at(render, seed, 6, (30.0, 12.0))
    faint = [(*rng.uniform(40, 216, 2), 3000.0) for _ in range(6)]
    return picture(signal + render((256, 256), faint, streak_px=(30.0, 12.0)), seed, 8.0)


@pytest.mark.parametrize("gap_px", [1, 3])
def test_pieces_are_those_with_small_gaps(render_stars: Render, gap_px: int) -> None:
    """At most gap_px pixels between them on either axis, by the graph of all runs."""
    joined_some = False
    for seed in range(4):
        image = broken(render_stars, seed)
        parameters = DetectionParameters(tau_min_dn=20.0, sigma_factor=2.5, centroid="cluster", min_pixels=1)
        plain, _ = detect_clusters(image, parameters)
        pieces, _ = detect_clusters(
            image,
            DetectionParameters(
                tau_min_dn=20.0, sigma_factor=2.5, centroid="cluster", min_pixels=1, piece_gap_px=gap_px
            ),
        )
        assert np.array_equal(plain.runs, pieces.runs)
        labels = graph_of_gaps(pieces.runs, gap_px)
        assert len(np.unique(labels)) == len(np.unique(pieces.label))
        pairs = set(zip(labels.tolist(), pieces.label.tolist(), strict=True))
        assert len(pairs) == len(np.unique(labels))
        joined_some |= len(np.unique(pieces.label)) < len(np.unique(plain.label))
    assert joined_some


def graph_of_gaps(runs: NDArray[np.int32], gap_px: int) -> NDArray[np.int64]:
    """Connected parts of the graph of runs with at most gap_px pixels between them."""
    rows = np.abs(runs[:, None, 0] - runs[None, :, 0]) <= gap_px + 1
    columns = (runs[:, None, 1] - runs[None, :, 2] <= gap_px) & (
        runs[None, :, 1] - runs[:, None, 2] <= gap_px
    )
    near = rows & columns
    label = np.arange(len(runs))
    while True:
        spread = np.where(near, label[None, :], len(runs)).min(axis=1)
        if np.array_equal(spread, label):
            return label
        label = spread


def test_nothing_is_joined_at_rest(render_stars: Render) -> None:
    """Two stars 6 px apart stay two where stars are spots, whatever gap streaks may have."""
    stars = [(60.0, 60.0, 9000.0), (66.0, 60.0, 9000.0), (150.0, 90.0, 9000.0), (90.0, 200.0, 5000.0)]
    image = picture(render_stars((256, 256), stars))
    parameters = DetectionParameters(tau_min_dn=20.0, centroid="cluster", piece_gap_px=5)
    assert len(detect(image, parameters)[0]) == 4


def table_of_runs(spots: list[list[tuple[int, int, int]]], magnitude: NDArray[np.float64]) -> StreakTable:
    runs = np.array([run for spot in spots for run in spot], np.int32)
    starts = np.cumsum([0] + [len(spot) for spot in spots]).astype(np.int32)
    extent = np.array(
        [
            [min(r[1] for r in s), max(r[2] for r in s) - 1, min(r[0] for r in s), max(r[0] for r in s)]
            for s in spots
        ],
        np.int32,
    )
    return StreakTable(Spots.at(np.zeros(len(spots)), np.zeros(len(spots)), magnitude), extent, runs, starts)


def random_table(rng: np.random.Generator, count: int) -> tuple[StreakTable, list[NDArray[np.int64]]]:
    """Slanting clusters at random and the pixels (row, column) of each."""
    spots, pixels = [], []
    for _ in range(count):
        row, column = rng.integers(0, 60, 2)
        spot = []
        for step in range(int(rng.integers(1, 6))):
            first = int(column + step * rng.integers(0, 2))
            spot.append((int(row) + step, first, first + int(rng.integers(1, 5))))
        spots.append(spot)
        pixels.append(np.array([(r, c) for r, first, end in spot for c in range(first, end)]))
    return table_of_runs(spots, np.sort(rng.uniform(1, 6, count))), pixels


@pytest.mark.parametrize("distance_px", [0.0, 1.5, 2.0, 4.0])
def test_fusion_is_the_mutual_nearest_by_brute_force(distance_px: float) -> None:
    """All distances of all pixels; of partners as near the one most alike in magnitude."""
    rng = np.random.default_rng(7)
    pairs = 0
    for _ in range(40):
        (before, first), (now, second) = random_table(rng, 18), random_table(rng, 18)
        distance = np.array(
            [[np.hypot(*np.moveaxis(a[:, None] - b[None], 2, 0)).min() for b in second] for a in first]
        )
        unlike = np.abs(before.spots.magnitude[:, None] - now.spots.magnitude[None])
        cost = np.where(distance <= distance_px, np.round(distance**2) * 1000.0 + unlike, np.inf)
        expected = {
            (i, int(j))
            for i, j in enumerate(cost.argmin(axis=1))
            if np.isfinite(cost[i, j]) and cost[:, j].argmin() == i
        }
        fusion, work = fuse(before, now, distance_px)
        assert set(zip(fusion.before.tolist(), fusion.now.tolist(), strict=True)) == expected
        assert np.all(np.diff(fusion.now) > 0)
        assert work["boxes_compared"] == 18 * 18
        pairs += len(expected)
    assert pairs > 20


def test_no_spots_fuse_to_nothing() -> None:
    some, _ = random_table(np.random.default_rng(1), 5)
    none = StreakTable(
        Spots.empty(), np.zeros((0, 4), np.int32), np.zeros((0, 3), np.int32), np.zeros(1, np.int32)
    )
    assert len(fuse(some, none, 2.0)[0]) == len(fuse(none, some, 2.0)[0]) == 0
