"""The pair catalogue and its k-vector, against scipy's spatial search and plain comparison."""

from __future__ import annotations

import io

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from hil_tests.firmware_model.synthetic_sky import random_directions
from st_emulator.firmware_model.catalogue.kvector import build_kvector, range_kernel
from st_emulator.firmware_model.catalogue.pairs import PairCatalogue, build_pair_catalogue, cosine_range
from st_emulator.firmware_model.catalogue.star_catalogue import build_star_catalogue

MAX_ANGLE = np.radians(12.0)
RNG = np.random.default_rng(3)
CATALOGUE = build_star_catalogue(
    np.arange(1, 2001), random_directions(RNG, 2000), RNG.uniform(0, 6, 2000).astype(np.float32), 6.5, 0.0
)
PAIRS = build_pair_catalogue(CATALOGUE, MAX_ANGLE)


def test_the_pairs_are_those_that_scipy_finds() -> None:
    tree = cKDTree(CATALOGUE.unit_vectors)
    expected = tree.query_pairs(2 * np.sin(MAX_ANGLE / 2))
    found = {
        (min(a, b), max(a, b)) for a, b in zip(PAIRS.brighter.tolist(), PAIRS.dimmer.tolist(), strict=True)
    }
    assert found == expected
    assert len(PAIRS) == len(expected)


def test_pairs_are_sorted_and_hold_their_cosines_brighter_star_first() -> None:
    u = CATALOGUE.unit_vectors
    cosine = np.einsum("ij,ij->i", u[PAIRS.brighter], u[PAIRS.dimmer])
    np.testing.assert_allclose(PAIRS.cos_angle, cosine, atol=1e-15)
    assert (np.diff(PAIRS.cos_angle) >= 0).all()
    assert (CATALOGUE.hp_mag[PAIRS.brighter] <= CATALOGUE.hp_mag[PAIRS.dimmer]).all()


@settings(max_examples=300, deadline=None)
@given(st.floats(0.0, 1.2 * MAX_ANGLE), st.floats(1e-7, 0.01))
@example(0.0, 1e-3)
@example(MAX_ANGLE, 1e-4)
def test_a_query_gives_all_pairs_within_the_tolerance_and_no_others(angle: float, tolerance: float) -> None:
    first, end = PAIRS.query(angle, tolerance)
    chord = np.linalg.norm(
        CATALOGUE.unit_vectors[PAIRS.brighter] - CATALOGUE.unit_vectors[PAIRS.dimmer], axis=1
    )
    off = np.abs(2 * np.arcsin(chord / 2) - angle)
    inside = np.zeros(len(PAIRS), bool)
    inside[first:end] = True
    clear = np.abs(off - tolerance) > 1e-10  # at the bound itself rounding may decide
    np.testing.assert_array_equal(inside[clear], (off <= tolerance)[clear])
    brighter, dimmer = PAIRS.query_pairs(angle, tolerance)
    assert len(brighter) == len(dimmer) == end - first


values = st.lists(st.floats(-1.0, 1.0).map(lambda v: round(v, 4)), min_size=0, max_size=60)


@settings(max_examples=300, deadline=None)
@given(values, st.floats(-1.2, 1.2), st.floats(-1.2, 1.2))
@example([0.5], 0.5, 0.5)
@example([0.25] * 10, 0.25, 0.25)
@example([], 0.0, 1.0)
def test_kvector_ranges_equal_binary_search(numbers: list[float], one: float, other: float) -> None:
    ascending = np.sort(np.array(numbers, np.float64))
    kvector = build_kvector(ascending)
    lowest, highest = min(one, other), max(one, other)
    first, end, _ = range_kernel(
        ascending, kvector.slope, kvector.offset, kvector.count_below, lowest, highest
    )
    assert end - first == ((ascending >= lowest) & (ascending <= highest)).sum()
    if end > first:
        assert first == np.searchsorted(ascending, lowest, "left")
    for value in numbers:  # a bound on a value itself
        first, end, _ = range_kernel(
            ascending, kvector.slope, kvector.offset, kvector.count_below, value, value
        )
        assert end - first == numbers.count(value)


def test_the_kvector_counts_values_below_its_line() -> None:
    ascending = np.array([0.1, 0.2, 0.2, 0.7, 0.9])
    kvector = build_kvector(ascending)
    line = kvector.slope * np.arange(6) + kvector.offset  # Z (11), from index 0
    assert line[0] < 0.1
    assert line[-1] > 0.9
    assert kvector.count_below.tolist() == [(ascending < y).sum() for y in line]


def test_a_query_compares_few_values() -> None:
    compared = []
    for angle in np.linspace(0.01, MAX_ANGLE - 0.001, 200):
        lowest, highest = cosine_range(angle, 1e-4)
        k = PAIRS.kvector
        compared.append(range_kernel(PAIRS.cos_angle, k.slope, k.offset, k.count_below, lowest, highest)[2])
    assert np.mean(compared) < 8  # binary search in as many pairs takes 2 x 14


def test_arrays_survive_a_file() -> None:
    file = io.BytesIO()
    np.savez(file, **PAIRS.to_arrays())
    file.seek(0)
    loaded = PairCatalogue.from_arrays(np.load(file, allow_pickle=False))
    assert loaded.max_angle_rad == PAIRS.max_angle_rad
    for angle in np.linspace(0.0, MAX_ANGLE, 50):
        assert loaded.query(angle, 1e-4) == PAIRS.query(angle, 1e-4)


def test_bad_input_is_refused() -> None:
    for angle in (0.0, -1.0, 2.0):
        with pytest.raises(ValueError, match="max_angle_rad"):
            build_pair_catalogue(CATALOGUE, angle)
    arrays = PAIRS.to_arrays()
    with pytest.raises(ValueError, match="lengths"):
        PairCatalogue.from_arrays(arrays | {"pair_dimmer": arrays["pair_dimmer"][1:]})
    with pytest.raises(KeyError):
        PairCatalogue.from_arrays({})
