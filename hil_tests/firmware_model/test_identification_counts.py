"""Counts of identifications that are there for their cycles alone: against plain sums over the catalogue."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from hil_tests.firmware_model.synthetic_sky import ARCSEC, SyntheticSky, random_attitude, vectors_of
from st_emulator.firmware_model.catalogue.tables import StarTables
from st_emulator.firmware_model.geometry import CameraGeometry
from st_emulator.firmware_model.identification import brightness_referenced, geometric_voting, multi_poles
from st_emulator.firmware_model.identification.algorithms import ALGORITHMS
from st_emulator.firmware_model.identification.interface import IdentificationParameters, Spikes
from st_emulator.firmware_model.identification.judgement import MARKS_AT_HAND, scattered_kernel
from st_emulator.firmware_model.work import COUNTS, Work

CAMERA = CameraGeometry(1024, 1024, 43.3 / 0.015)
PARAMETERS = IdentificationParameters(25 * ARCSEC, field_normals=CAMERA.field_normals(-6.0))
FEW_STARS, MANY_STARS = 2617, 9000


@cache
def sky(stars: int) -> SyntheticSky:
    return SyntheticSky.make(2, stars, CAMERA, 5.5)


def spikes(stars: int, seed: int, most: int = 12) -> Spikes:
    """The brightest stars of a field."""
    view = sky(stars).view(random_attitude(np.random.default_rng(seed)))
    assert len(view) >= most
    b = vectors_of(CAMERA, view.x_px, view.y_px)[:most]
    return Spikes(np.ascontiguousarray(b), view.magnitude[:most])


def hits_of(given: Spikes, tables: StarTables) -> np.ndarray:
    """Catalogue pairs that fit each two of the spikes, int[n, n]: the angles of all pairs looked at."""
    angles = np.arccos(tables.pairs.cos_angle)
    measured = np.arccos(np.clip(given.b_vectors @ given.b_vectors.T, -1.0, 1.0))
    tolerance = PARAMETERS.tolerance_rad
    return np.array([[(np.abs(angles - angle) <= tolerance).sum() for angle in row] for row in measured])


@pytest.mark.parametrize(
    ("marks", "words", "expected"),
    [
        (1000, MARKS_AT_HAND, 0),  # the whole table is at hand
        (1000, 10, 0),
        (1000, 2 * MARKS_AT_HAND, 500),
        (1000, 4 * MARKS_AT_HAND, 750),
        (3, 2 * MARKS_AT_HAND, 2),
        (0, 4 * MARKS_AT_HAND, 0),
        (0, 0, 0),
    ],
)
def test_marks_that_are_not_at_hand(marks: int, words: int, expected: int) -> None:
    assert scattered_kernel(marks, words) == expected


@pytest.mark.parametrize("stars", [FEW_STARS, MANY_STARS])
def test_votes_are_cast_by_every_hit_into_lines_that_may_be_cold(stars: int) -> None:
    """Two stars of a pair for two spots; of the second spot's row each line is cold once."""
    given, tables = spikes(stars, 1), sky(stars).tables
    _, work = geometric_voting.identify(given, tables, PARAMETERS)
    hits = hits_of(given, tables)[np.triu_indices(len(given), 1)]
    catalogued = len(tables.catalogue)
    assert work["votes_cast"] == 4 * hits.sum() == 4 * work["kvector_hits"]
    away = 1.0 - min(catalogued, 4096) / catalogued
    cold = np.minimum(2 * hits, catalogued // 16)
    expected = (cold + away * (4 * hits - cold)).sum()
    assert expected <= work["marks_scattered"] <= expected + len(hits)  # each rounded up
    assert (stars == MANY_STARS) == (away > 0.0)


@pytest.mark.parametrize("stars", [FEW_STARS, MANY_STARS])
def test_a_pole_reads_two_magnitudes_of_every_hit(stars: int) -> None:
    given, tables = spikes(stars, 2), sky(stars).tables
    _, work = multi_poles.identify(given, tables, PARAMETERS)
    hits = hits_of(given, tables)
    np.fill_diagonal(hits, 0)
    poles = work["angles_computed"] // (len(given) - 1)
    assert poles == 2  # which agree: the brightest spike, then its brightest neighbour
    assert work["kvector_hits"] == hits[:2].sum()
    catalogued = len(tables.catalogue)
    expected = (2 * hits[:2].sum(axis=1) * (1.0 - min(catalogued, 4096) / catalogued)).sum()
    assert expected <= work["marks_scattered"] <= expected + poles
    # an entry is two of candidates_marked; the rest is the spikes looked at and the chains followed
    chained = work["candidates_marked"] - 2 * work["marks_stamped"]
    assert 0 < chained < 2 * work["marks_stamped"]
    assert work["votes"] <= work["marks_stamped"]


@pytest.mark.parametrize("stars", [FEW_STARS, MANY_STARS])
def test_marks_of_a_pivot_are_two_words(stars: int) -> None:
    given = spikes(stars, 10)
    # The brightness is wrong: a long search.
    shuffled = Spikes(given.b_vectors[::-1].copy(), given.magnitudes)
    _, work = brightness_referenced.identify(shuffled, sky(stars).tables, PARAMETERS)
    catalogued = len(sky(stars).catalogue)
    assert work["marks_stamped"] == work["candidates_marked"] > 1000
    away = 1.0 - min(2 * catalogued, 4096) / (2 * catalogued)
    assert away > 0.0
    assert work["marks_scattered"] == pytest.approx(work["candidates_marked"] * away, abs=1)
    # entries that this range has made itself, or that have the same star, have no third side
    assert 0 < work["third_sides"] < work["triangles_tested"]


@pytest.mark.parametrize("name", ALGORITHMS)
def test_they_are_no_steps(name: str) -> None:
    _, work = ALGORITHMS[name](spikes(MANY_STARS, 4), sky(MANY_STARS).tables, PARAMETERS)
    counted = {n for n in work.counts if COUNTS[n].stage == "identification"}
    steps = {n for n in counted if COUNTS[n].step}
    assert counted - steps >= {"identifications", "spikes_taken"}
    assert work.operations() == sum(work[n] for n in steps)
    assert Work({n: work[n] for n in steps}).operations() == work.operations()


@pytest.mark.parametrize("name", ALGORITHMS)
def test_a_catalogue_without_stars(name: str) -> None:
    """No star, no pair: nothing is found, and nothing is divided by their number."""
    nowhere = SyntheticSky.make(2, 0, CAMERA, 5.5)
    found, work = ALGORITHMS[name](spikes(FEW_STARS, 5), nowhere.tables, PARAMETERS)
    assert not found.identified
    assert work["marks_scattered"] == 0
