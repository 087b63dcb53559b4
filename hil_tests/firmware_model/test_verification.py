"""The final judgement: its shortcuts change nothing, and its matches are those of a plain version."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil_tests.firmware_model.reference_pyramid import angles, match
from hil_tests.firmware_model.synthetic_sky import ARCSEC, matrix, random_attitude, random_directions
from st_emulator.firmware_model.catalogue.pairs import PairCatalogue, build_pair_catalogue
from st_emulator.firmware_model.catalogue.star_catalogue import StarCatalogue, build_star_catalogue
from st_emulator.firmware_model.identification.judgement import (
    CATALOGUE_ANGLES,
    COUNT_NAMES,
    match_spots_kernel,
    separation_kernel,
    verify_kernel,
)

STARS = 3000


@cache
def crowded(apart_arcsec: float) -> tuple[StarCatalogue, PairCatalogue]:
    """Random stars, one in ten with a companion 20 to 200 arcsec away, none closer than apart_arcsec."""
    rng = np.random.default_rng(1)
    vectors = random_directions(rng, STARS)
    beside = vectors[: STARS // 10] + rng.normal(0, 60 * ARCSEC, (STARS // 10, 3))
    vectors = np.concatenate([vectors, beside / np.linalg.norm(beside, axis=1, keepdims=True)])
    close = np.triu(angles(vectors, vectors) < max(apart_arcsec, 20.0) * ARCSEC, 1)
    vectors = vectors[~close.any(axis=0)]
    catalogue = build_star_catalogue(np.arange(len(vectors)), vectors, np.full(len(vectors), 4.0), 5.0, 0.0)
    return catalogue, build_pair_catalogue(catalogue, 0.05)


def arrays(catalogue: StarCatalogue) -> tuple[object, ...]:
    cells = catalogue.cells
    return cells.band_height_rad, cells.band_first_cell, cells.cell_start, cells.cell_star


@pytest.mark.parametrize("apart_arcsec", [20.0, 120.0])
def test_the_separation_is_that_of_the_closest_pair(apart_arcsec: float) -> None:
    catalogue, pairs = crowded(apart_arcsec)
    between = angles(catalogue.unit_vectors, catalogue.unit_vectors)
    closest = between[~np.eye(len(between), dtype=bool)].min()
    assert separation_kernel(pairs.cos_angle) == pytest.approx(closest, rel=1e-6)
    assert separation_kernel(np.zeros(0)) == 0.0


@pytest.mark.parametrize("apart_arcsec", [20.0, 120.0])
def test_shortcuts_change_no_match_and_save_work(apart_arcsec: float) -> None:
    """With the stars' separation given and some stars known (a tenth of them wrongly), and without either."""
    catalogue, pairs = crowded(apart_arcsec)
    separation = separation_kernel(pairs.cos_angle)
    rng = np.random.default_rng(2)
    angles_tested = np.zeros(2, np.int64)
    verified = 0
    for _ in range(300):
        q = random_attitude(rng)
        rows = np.flatnonzero(catalogue.unit_vectors @ matrix(q)[2] > np.cos(0.15))
        if len(rows) < 5:
            continue
        b = np.concatenate([catalogue.unit_vectors[rows] @ matrix(q).T, random_directions(rng, 2)])
        b += rng.normal(0, 5 * ARCSEC, b.shape)
        b /= np.linalg.norm(b, axis=1, keepdims=True)
        tolerance = rng.choice([15, 25, 50]) * ARCSEC
        off = Rotation.from_rotvec(rng.normal(0, rng.choice([0.2, 1, 2]) * tolerance, 3))
        trial = (Rotation.from_quat(q) * off).as_quat()
        known = np.where(rng.random(len(b)) < 0.5, np.append(rows, [-1, -1]), -1)
        known = np.where(
            (known >= 0) & (rng.random(len(b)) < 0.1), rng.integers(0, len(catalogue), len(b)), known
        )
        outcomes = []
        for way, (given, apart) in enumerate(((np.full(len(b), -1), 0.0), (known, separation))):
            star_index, found = given.astype(np.int32), trial.copy()
            counts = np.zeros(len(COUNT_NAMES), np.int64)
            result = verify_kernel(
                b, np.full(len(b), 4.0), found, catalogue.unit_vectors, catalogue.hp_mag, *arrays(catalogue),
                apart, tolerance, 4, np.zeros((0, 3)), 0.5, 99.0, star_index, counts,
            )  # fmt: skip
            angles_tested[way] += counts[CATALOGUE_ANGLES]
            outcomes.append((result, star_index, found))
        assert outcomes[0][0] == outcomes[1][0]
        if outcomes[0][0][0] > 0:
            verified += 1
            np.testing.assert_array_equal(outcomes[0][1], outcomes[1][1])
            np.testing.assert_allclose(outcomes[0][2], outcomes[1][2], atol=1e-12)
    assert verified > 150
    assert angles_tested[1] < angles_tested[0]


def test_matches_are_those_of_the_plain_version() -> None:
    catalogue, pairs = crowded(20.0)
    rng = np.random.default_rng(3)
    for _ in range(100):
        q = random_attitude(rng)
        rows = np.flatnonzero(catalogue.unit_vectors @ matrix(q)[2] > np.cos(0.15))
        b = catalogue.unit_vectors[rows] @ matrix(q).T + rng.normal(0, 8 * ARCSEC, (len(rows), 3))
        b /= np.linalg.norm(b, axis=1, keepdims=True)
        # no two spots with one nearest star: who gets it is not told by the plain version's order of spots
        nearest = np.argmin(angles(b @ matrix(q), catalogue.unit_vectors), axis=1)
        b = b[np.unique(nearest, return_index=True)[1]]
        star_index = np.full(len(b), -1, np.int32)
        counts = np.zeros(len(COUNT_NAMES), np.int64)
        matched = match_spots_kernel(
            b, q, catalogue.unit_vectors, *arrays(catalogue), separation_kernel(pairs.cos_angle),
            12 * ARCSEC, 24 * ARCSEC, star_index.copy(), np.full(len(b), np.inf), star_index, counts,
        )  # fmt: skip
        expected = match(b, matrix(q), catalogue.unit_vectors, 12 * ARCSEC)
        np.testing.assert_array_equal(star_index, expected)
        assert matched == (expected >= 0).sum()
