"""Improved multi-poles at its edges: few spikes, two skies, repeated patterns, the limit of work."""

from __future__ import annotations

import numpy as np

from hil_tests.firmware_model.multi_poles_scenes import (
    CAMERA,
    FINE,
    catalogued,
    chosen,
    is_right,
    measure,
    sky,
    solve,
)
from hil_tests.firmware_model.synthetic_sky import (
    ARCSEC,
    matrix,
    random_attitude,
    random_directions,
    vectors_of,
)
from st_emulator.firmware_model.catalogue.pairs import build_pair_catalogue
from st_emulator.firmware_model.catalogue.star_catalogue import build_star_catalogue
from st_emulator.firmware_model.catalogue.tables import StarTables
from st_emulator.firmware_model.identification.algorithms import ALGORITHMS
from st_emulator.firmware_model.identification.interface import IdentificationParameters, Spikes
from st_emulator.firmware_model.identification.multi_poles import identify
from st_emulator.firmware_model.reasons import Reason


def test_two_spikes_are_too_few_three_unconfirmed_four_enough() -> None:
    rng = np.random.default_rng(7)
    reasons: dict[int, list[Reason]] = {count: [] for count in range(7)}
    for _ in range(40):
        q = random_attitude(rng)
        view = catalogued(sky().view(q))
        for count in reasons:
            b, magnitude, row = measure(rng, chosen(view, slice(count)), 0.02)
            found, work = solve(b, magnitude, FINE, tolerance_rad=10 * ARCSEC, least_seen_share=0.0)
            reasons[count].append(found.reason)
            assert found.verified == (count if found.identified else 0)
            if found.identified:
                assert (sky().catalogue.hip[found.star_index] == row + 1).all()
                assert is_right(found, q)
            if count < 3:
                assert work.operations() == 0
    for count in (0, 1, 2):
        assert set(reasons[count]) == {Reason.TOO_FEW_STARS}
    # three brightest stars, once in a while with a catalogue pair that lets two stars be the pole
    assert reasons[3].count(Reason.UNCONFIRMED) > 30
    assert Reason.NONE not in reasons[3]
    assert all(reasons[count].count(Reason.NONE) > 35 for count in (4, 5, 6))


def test_three_spikes_are_not_named_where_chance_would_name_them_too() -> None:
    rng = np.random.default_rng(8)
    view = catalogued(sky().view(random_attitude(rng)))
    b, magnitude, _ = measure(rng, chosen(view, slice(3)), 0.02)
    assert solve(b, magnitude, FINE, most_false_triangles=1e-12)[0].reason == Reason.NO_MATCH
    # and three of many spikes are never looked at
    found, _ = solve(*measure(rng, chosen(view, slice(3)), 0.02, false=6)[:2], FINE)
    assert found.reason == Reason.NO_MATCH


def test_two_skies_in_one_image_are_ambiguous() -> None:
    rng = np.random.default_rng(9)
    views = [chosen(catalogued(sky().view(random_attitude(rng))), slice(6)) for _ in range(2)]
    parts = [measure(rng, view, 0.02) for view in views]
    b, magnitude = np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])
    loose = {"least_seen_share": 0.0, "most_false_solutions": 1.0}
    found, _ = solve(b, magnitude, FINE, certain_false_solutions=0.0, **loose)
    assert found.reason == Reason.AMBIGUOUS
    assert (found.star_index == -1).all()
    assert solve(*parts[0][:2], FINE, certain_false_solutions=0.0, **loose)[0].reason == Reason.NONE


def test_a_pattern_that_stands_twice_in_the_sky_names_no_pole() -> None:
    rng = np.random.default_rng(10)
    b = vectors_of(CAMERA, *rng.uniform(100, 900, (2, 9)))
    skies = [b @ matrix(random_attitude(rng)) for _ in range(2)]
    for count, reason in ((2, Reason.NO_MATCH), (1, Reason.NONE)):
        vectors = np.concatenate([*skies[:count], random_directions(rng, 2000)])
        catalogue = build_star_catalogue(
            np.arange(len(vectors)), vectors, np.full(len(vectors), 5.0), 5.5, 0.0
        )
        pairs = build_pair_catalogue(catalogue, 2 * CAMERA.half_diagonal_rad)
        found, _ = identify(
            Spikes(b, np.full(9, 5.0)), StarTables(catalogue, pairs), IdentificationParameters(5 * ARCSEC)
        )
        assert found.reason == reason


def test_spots_at_random_places_and_a_mirrored_sky_are_no_stars() -> None:
    rng = np.random.default_rng(5)
    for count in (6, 25, 60):
        for _ in range(30):
            x, y = rng.uniform(0, 1024, (2, count))
            found, work = solve(vectors_of(CAMERA, x, y), np.sort(rng.uniform(1, 5.5, count)))
            assert found.reason == Reason.NO_MATCH
            assert work["kvector_queries"] == count * (count - 1)  # each was a pole
    for _ in range(50):
        b, magnitude, _ = measure(rng, sky().view(random_attitude(rng)))
        found, _ = solve(b * [-1.0, 1.0, 1.0], magnitude)
        assert found.reason == Reason.NO_MATCH


def test_spikes_in_line_and_spikes_on_one_place() -> None:
    line = vectors_of(CAMERA, np.linspace(100, 900, 20), np.full(20, 400.0))
    for b in (line, np.repeat(line[:1], 20, axis=0), np.repeat(line[:2], 10, axis=0)):
        for magnitude in (np.full(20, 4.0), np.linspace(2, 5, 20)):
            assert solve(b, magnitude)[0].reason == Reason.NO_MATCH


def test_work_ends_at_its_limit() -> None:
    rng = np.random.default_rng(13)
    x, y = rng.uniform(0, 1024, (2, 1000))
    b, magnitude = vectors_of(CAMERA, x, y), np.sort(rng.uniform(-1, 5.5, 1000))
    found, work = solve(b, magnitude, max_operations=2_000_000)
    assert found.reason == Reason.WORK_LIMIT
    one_pole = solve(b, magnitude, max_operations=1)[1].operations()
    assert 2_000_000 <= work.operations() < 2_000_000 + 3 * one_pole
    assert solve(b, magnitude, max_operations=0)[1].operations() == 0
    # what was found before the limit stands
    q = random_attitude(rng)
    b, magnitude, _ = measure(rng, sky().view(q))
    enough = solve(b, magnitude)[1].operations()
    assert solve(b, magnitude, max_operations=enough)[0].reason == Reason.NONE
    assert solve(b, magnitude, max_operations=enough // 3)[0].reason == Reason.WORK_LIMIT


def test_the_input_is_left_alone_and_the_algorithm_has_its_name() -> None:
    assert ALGORITHMS["multi_poles"] is identify
    rng = np.random.default_rng(15)
    b, magnitude, _ = measure(rng, sky().view(random_attitude(rng)))
    order = rng.permutation(len(b))
    b, magnitude = b[order], magnitude[order]
    kept = b.copy(), magnitude.copy()
    first, first_work = solve(b, magnitude)
    second, second_work = solve(b, magnitude)
    np.testing.assert_array_equal(b, kept[0])
    np.testing.assert_array_equal(magnitude, kept[1])
    np.testing.assert_array_equal(first.star_index, second.star_index)
    assert first_work == second_work
