"""Images of the campaign aps: rendered where light falls, and elsewhere frames without stars. They must not
differ from full frames in anything that the firmware could notice."""

from __future__ import annotations

import dataclasses
import itertools
from functools import lru_cache

import numpy as np
import pytest

from st_emulator.campaigns import aps_runs
from st_emulator.campaigns.aps_runs import DIRECTIONS, attitude_of, bench_of
from st_emulator.firmware_model.image.detection import detect
from st_emulator.units.profile import load_unit
from st_emulator.world.trajectory import ConstantRateTrajectory

SEED = 3
FRAMES = 7
SIGMAS = 4.5  # differences of samples: one in 150,000 by chance


@lru_cache(maxsize=2)
def images(shutter: str) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """(the campaign's image, the full frame, where light falls) of turns of 2 deg/s over all the sky."""
    bench = bench_of(load_unit("aps_rs").model_dump_json(), shutter, SEED)
    made = []
    for number in range(FRAMES):
        axis = DIRECTIONS[(5 * number) % 26]
        bench.scene.trajectory = ConstantRateTrajectory(
            attitude_of(number, FRAMES), np.radians(2.0) * axis / np.linalg.norm(axis)
        )
        frame = bench.scene.frame(1000 + 7 * number, 200_000_000)
        image = bench.image(frame).copy()
        lit = np.zeros(image.shape, dtype=bool)
        for x0, y0, x1, y1 in frame.light.box:
            lit[y0:y1, x0:x1] = True
        made.append((image, frame.full(), lit))
    return made


def moments(counts: np.ndarray) -> tuple[float, float, float, int]:
    """Mean, variance and fourth central moment of numbers put out so many times each; how many there are."""
    values, number = np.arange(len(counts)), int(counts.sum())
    off = values - counts @ values / number
    return values.mean() - off.mean(), counts @ off**2 / number, counts @ off**4 / number, number


def alike(ours: np.ndarray, theirs: np.ndarray) -> None:
    """Counts of numbers put out with the same mean and variance, within what their size allows."""
    (mean_1, variance_1, fourth_1, n_1), (mean_2, variance_2, fourth_2, n_2) = map(moments, (ours, theirs))
    assert abs(mean_1 - mean_2) < SIGMAS * np.sqrt(variance_1 / n_1 + variance_2 / n_2)
    error = np.sqrt((fourth_1 - variance_1**2) / n_1 + (fourth_2 - variance_2**2) / n_2)
    assert abs(variance_1 - variance_2) < SIGMAS * error


@pytest.mark.parametrize("shutter", ["rolling", "global"])
def test_light_is_the_full_frames_to_the_bit(shutter):
    for image, full, lit in images(shutter):
        assert 0.001 < lit.mean() < 0.5
        np.testing.assert_array_equal(image[lit], full[lit])
        assert np.mean(image[~lit] == full[~lit]) < 0.2  # and elsewhere it is another noise


@pytest.mark.parametrize("shutter", ["rolling", "global"])
def test_noise_away_from_light(shutter):
    """Of every single frame, whichever of the kept ones is beneath, and of all."""
    ours, theirs = (
        np.array([np.bincount(item[place][~item[2]], minlength=4096) for item in images(shutter)])
        for place in (0, 1)
    )
    for one, other in zip(ours, theirs, strict=True):
        alike(one, other)
    alike(ours.sum(axis=0), theirs.sum(axis=0))


def test_unlike_noise_is_noticed():
    """2 % more noise, or a fifth of a number more of offset, in one frame of a million pixels."""
    rng = np.random.default_rng(1)
    noise = 308.0 + 3.7 * rng.normal(size=1_000_000)
    plain, more, higher = (
        np.bincount(np.rint(item).astype(int), minlength=4096)
        for item in (noise, 308.0 + 1.02 * (noise - 308.0), noise + 0.2)
    )
    alike(plain, np.bincount(np.rint(308.0 + 3.7 * rng.normal(size=1_000_000)).astype(int), minlength=4096))
    for other in (more, higher):
        with pytest.raises(AssertionError):
            alike(plain, other)


@pytest.mark.parametrize("shutter", ["rolling", "global"])
def test_neighbours_have_nothing_in_common(shutter):
    for image, full, lit in images(shutter)[:3]:
        both = ~(lit[:, 1:] | lit[:, :-1])
        for item in (image, full):
            left, right = item[:, :-1][both].astype(float), item[:, 1:][both].astype(float)
            assert abs(np.corrcoef(left, right)[0, 1]) < SIGMAS / np.sqrt(both.sum())


def detections(detection) -> tuple[int, int, int, int]:
    """(ours on light, ours elsewhere, those of full frames on light, elsewhere)."""
    counts = [0, 0, 0, 0]
    for image, full, lit in images("rolling"):
        for place, item in ((0, image), (2, full)):
            spots, _ = detect(item, detection)
            on = lit[np.rint(spots.y_px).astype(int), np.rint(spots.x_px).astype(int)]
            counts[place] += int(on.sum())
            counts[place + 1] += int((~on).sum())
    return counts[0], counts[1], counts[2], counts[3]


def test_as_many_false_detections():
    """At a threshold that single pixels of noise often pass, so that there is something to count."""
    detection = bench_of(load_unit("aps_rs").model_dump_json(), "rolling", SEED).configuration.detection
    low = dataclasses.replace(
        detection,
        sigma_factor=3.5,
        tau_min_dn=1.0,
        min_pixels=1,
        magnitude_limit=99.0,
        max_peak_fraction=100.0,
        max_spots=16000,
        piece_gap_px=0,
    )
    _, ours, _, theirs = detections(low)
    assert theirs > 200
    assert abs(ours - theirs) < SIGMAS * np.sqrt(ours + theirs)


def test_the_units_own_detections_are_the_same_stars():
    """At its own threshold noise makes next to none, and every star that is found is found in both."""
    detection = bench_of(load_unit("aps_rs").model_dump_json(), "rolling", SEED).configuration.detection
    on, ours, full_on, theirs = detections(detection)
    assert full_on > 60
    # the background about a star near the threshold is another noise, so that its average is
    assert abs(on - full_on) <= max(2, 0.02 * full_on)
    assert ours <= 3
    assert theirs <= 3


def test_all_kept_backgrounds_are_used_and_differ():
    bench = bench_of(load_unit("aps_rs").model_dump_json(), "rolling", SEED)
    kept = bench._backgrounds
    assert len(kept) == aps_runs.BACKGROUNDS
    for one, other in itertools.pairwise(kept):
        assert np.mean(one == other) < 0.2
