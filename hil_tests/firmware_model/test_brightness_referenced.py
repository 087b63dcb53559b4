"""Brightness-referenced identification: against its plain version, its counts, many skies, any input."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_tests.firmware_model import reference_brightness
from hil_tests.firmware_model.synthetic_sky import (
    ARCSEC,
    SyntheticSky,
    View,
    matrix,
    random_attitude,
    random_directions,
    turn_between,
    vectors_of,
)
from st_emulator.firmware_model.catalogue.pairs import build_pair_catalogue
from st_emulator.firmware_model.catalogue.star_catalogue import build_star_catalogue
from st_emulator.firmware_model.catalogue.tables import StarTables
from st_emulator.firmware_model.geometry import CameraGeometry
from st_emulator.firmware_model.identification.brightness_referenced import identify
from st_emulator.firmware_model.identification.interface import (
    BrightnessParameters,
    Identification,
    IdentificationParameters,
    Spikes,
)
from st_emulator.firmware_model.identification.judgement import COUNT_NAMES, OPERATIONS
from st_emulator.firmware_model.reasons import Reason
from st_emulator.firmware_model.work import Work

WIDE = CameraGeometry(1024, 1024, 43.3 / 0.015)  # as paper Z: 20 x 20 deg, 71.4 arcsec a pixel
PARAMETERS = IdentificationParameters(25 * ARCSEC, max_spots=10)
NO_REFERENCE = BrightnessParameters(bright_limit_mag=-9.0)
REFUSED = (Reason.TOO_FEW_STARS, Reason.NO_MATCH, Reason.AMBIGUOUS, Reason.WORK_LIMIT)


@cache
def sky() -> SyntheticSky:
    """As many stars as paper Z has brighter than 5.0."""
    return SyntheticSky.make(2, 1471, WIDE, 5.0)


def image(
    rng: np.random.Generator,
    view: View,
    *,
    false: int = 0,
    noise_px: float = 0.07,
    noise_mag: float = 0.2,
    most: int = 10,
) -> tuple[Spikes, np.ndarray]:
    """Spikes, brightest first, and their rows of the sky (-1: false)."""
    x = np.concatenate([view.x_px + rng.normal(0, noise_px, len(view)), rng.uniform(3, 1020, false)])
    y = np.concatenate([view.y_px + rng.normal(0, noise_px, len(view)), rng.uniform(3, 1020, false)])
    magnitude = np.concatenate(
        [view.magnitude + rng.normal(0, noise_mag, len(view)), rng.uniform(0, 5, false)]
    )
    row = np.concatenate([view.row, np.full(false, -1)])
    order = np.argsort(magnitude, kind="stable")[:most]
    return Spikes(vectors_of(WIDE, x, y)[order], magnitude[order]), row[order]


def some(view: View, places: object) -> View:
    return View(*(part[places] for part in (view.row, view.x_px, view.y_px, view.magnitude)))  # type: ignore[index]


def solve(spikes: Spikes, **changes: object) -> tuple[Identification, Work]:
    return identify(spikes, sky().tables, replace(PARAMETERS, **changes))  # type: ignore[arg-type]


def rows_of(found: Identification, made: SyntheticSky | None = None) -> np.ndarray:
    """Rows of the sky of each spike, -1 where none."""
    hip = (made or sky()).catalogue.hip
    return np.where(found.star_index >= 0, hip[found.star_index] - 1, -1)


@pytest.mark.parametrize("seed", range(120))
def test_the_compiled_search_gives_what_the_plain_version_gives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = CameraGeometry(512, 512, 1440.0)
    made = SyntheticSky.make(seed // 20, 600, camera, 6.0)
    view = made.view(random_attitude(rng))
    view = some(view, np.flatnonzero(rng.random(len(view)) < (0.5 if seed % 3 == 0 else 0.9)))
    x = np.concatenate([view.x_px + rng.normal(0, 0.1, len(view)), rng.uniform(3, 509, seed % 4)])
    y = np.concatenate([view.y_px + rng.normal(0, 0.1, len(view)), rng.uniform(3, 509, seed % 4)])
    magnitude = np.concatenate([view.magnitude + rng.normal(0, 0.4, len(view)), rng.uniform(1, 6, seed % 4)])
    order = np.argsort(magnitude)[: 3 + seed % 8]
    b, magnitude = vectors_of(camera, x, y)[order], magnitude[order]
    tolerance, limit = 100 * ARCSEC, (3.0, 4.5)[seed % 2]
    parameters = IdentificationParameters(
        tolerance,
        magnitude_tolerance=99.0,
        most_false_solutions=1e-3,
        brightness=BrightnessParameters(bright_limit_mag=limit),
    )
    found, _ = identify(Spikes(b, magnitude), made.tables, parameters)
    reason, star = reference_brightness.identify(
        b,
        magnitude,
        made.catalogue.unit_vectors,
        made.catalogue.hp_mag,
        tolerance,
        max_angle=made.pairs.max_angle_rad,
        bright_limit=limit,
        most_false=1e-3,
    )
    assert found.reason.name == reason
    np.testing.assert_array_equal(found.star_index, star)


@pytest.mark.parametrize(
    ("false", "noise_mag", "most"), [(0, 0.2, 10), (1, 0.2, 10), (1, 0.5, 10), (4, 0.3, 20), (10, 0.2, 20)]
)
def test_hundreds_of_skies_are_solved_and_none_wrongly(false: int, noise_mag: float, most: int) -> None:
    rng = np.random.default_rng(100 + false)
    eligible = right = 0
    for _ in range(300):
        q = random_attitude(rng)
        spikes, row = image(rng, sky().view(q), false=false, noise_mag=noise_mag, most=most)
        found, _ = solve(spikes, max_spots=max(most, 4))
        eligible += (row >= 0).sum() >= 5
        if not found.identified:
            assert found.reason in REFUSED
            assert found.verified == 0
            continue
        named = found.star_index >= 0
        assert found.verified == named.sum()
        np.testing.assert_array_equal(rows_of(found)[named], row[named])
        if found.reason == Reason.NONE:
            assert found.q_icrs_to_sensor is not None
            assert np.linalg.norm(turn_between(q, found.q_icrs_to_sensor)[:2]) < 30 * ARCSEC
            right += (row >= 0).sum() >= 5
    assert eligible > 250
    assert right >= 0.995 * eligible


@settings(max_examples=150, deadline=None)
@given(
    st.integers(0, 10_000),
    st.integers(0, 12),
    st.floats(0.0, 1.0),
    st.floats(0.0, 2.0),
    st.floats(0.0, 2.0),
    st.booleans(),
)
def test_no_attitude_is_ever_wrong(
    seed: int, false: int, missing: float, noise_mag: float, gamma: float, whole_field: bool
) -> None:
    rng = np.random.default_rng(seed)
    q = random_attitude(rng)
    view = sky().view(q)
    view = some(view, np.flatnonzero(rng.random(len(view)) >= missing))
    spikes, row = image(rng, view, false=false, noise_mag=noise_mag)
    found, _ = solve(
        spikes,
        brightness=BrightnessParameters(distinct_mag=gamma),
        field_normals=WIDE.field_normals() if whole_field else None,
    )
    if found.reason == Reason.NONE:
        assert found.q_icrs_to_sensor is not None
        assert np.linalg.norm(turn_between(q, found.q_icrs_to_sensor)) < 0.005
        named = found.star_index >= 0
        assert named.sum() >= 4
        np.testing.assert_array_equal(rows_of(found)[named], row[named])
    elif found.reason == Reason.UNCONFIRMED:
        assert len(spikes) <= 4
        assert (found.star_index >= 0).sum() == 3
    else:
        assert found.reason in REFUSED
        assert (found.star_index == -1).all()
        assert found.q_icrs_to_sensor is None


@pytest.mark.parametrize("place", range(8))
def test_one_false_star_does_no_harm_wherever_it_is_in_the_order(place: int) -> None:
    rng = np.random.default_rng(place)
    tried = 0
    while tried < 25:
        spikes, row = image(rng, sky().view(random_attitude(rng)), most=7)
        if len(spikes) < 7:
            continue
        tried += 1
        lying = vectors_of(WIDE, rng.uniform(3, 1020, 1), rng.uniform(3, 1020, 1))
        magnitude = spikes.magnitudes
        between = np.concatenate([[magnitude[0] - 1], magnitude, [magnitude[-1] + 0.1]])[place : place + 2]
        found, _ = solve(
            Spikes(
                np.insert(spikes.b_vectors, place, lying, axis=0),
                np.insert(magnitude, place, between.mean()),
            )
        )
        assert found.reason == Reason.NONE
        np.testing.assert_array_equal(rows_of(found), np.insert(row, place, -1))


def plain_range(spikes: Spikes, pivot: int, spot: int, bright_mag: float) -> np.ndarray:
    """(brighter star, dimmer star) of the pairs that fit, in the order of the list."""
    catalogue, pairs = sky().catalogue, sky().pairs
    chord = np.linalg.norm(spikes.b_vectors[pivot] - spikes.b_vectors[spot])
    off = np.arccos(np.clip(pairs.cos_angle, -1, 1)) - 2 * np.arcsin(chord / 2)
    fit = (np.abs(off) <= PARAMETERS.tolerance_rad) & (catalogue.hp_mag[pairs.brighter] < bright_mag)
    return np.stack([pairs.brighter[fit], pairs.dimmer[fit]], axis=1)


@pytest.mark.parametrize("mode", ["reference", "four-star"])
def test_the_counts_are_the_entries_that_are_read(mode: str) -> None:
    """Scenes that the first two ranges solve: everything that is read and marked, counted by hand."""
    rng = np.random.default_rng(20)
    counted = 0
    while counted < 40:
        spikes, _ = image(rng, sky().view(random_attitude(rng)))
        mag = spikes.magnitudes
        reference = mag[0] < 3.0
        if len(spikes) < 10 or (mode == "reference") != reference or mag[7] - mag[0] <= 0.7:
            continue
        found, work = solve(spikes)
        if work["triads_tested"] != 1 or found.verified != 10 or work["triangles_tested"] != 1:
            continue
        counted += 1
        star = found.star_index
        cosine = spikes.b_vectors[[7, 8, 9]] @ spikes.b_vectors[0]
        near, far = (7 + np.argsort(-cosine))[:2].tolist()
        bright = 3.0 if reference else 99.0
        marked, read = (plain_range(spikes, 0, spot, bright) for spot in (near, far))
        assert star[0] in marked[:, 0]
        # From the middle outwards, the lower one first, up to the true pair.
        middle = len(read) // 2
        order = sorted(range(len(read)), key=lambda place: (abs(place - middle), place))
        steps = 1 + [tuple(read[place]) for place in order].index((star[0], star[far]))
        assert work["kvector_queries"] == 2
        assert work["kvector_hits"] == len(marked) + steps
        assert work["candidates_marked"] == len(marked) + steps
        assert work["angles_computed"] == 4  # to three partners, and between two
        assert work["magnitudes_compared"] == 2  # M_t, and the group's brightest against the pivot
        assert work["spots_confirmed"] == 10
        assert work.operations() == sum(work[name] for name in COUNT_NAMES[:OPERATIONS])


def test_reference_mode_reads_less_and_finds_the_same() -> None:
    rng = np.random.default_rng(21)
    with_it, without = [], []
    for _ in range(150):
        spikes, _ = image(rng, sky().view(random_attitude(rng)), noise_mag=0.0)
        if len(spikes) < 8 or not spikes.magnitudes[0] < 3.0:
            continue
        found, work = solve(spikes)
        four, four_work = solve(spikes, brightness=NO_REFERENCE)
        np.testing.assert_array_equal(found.star_index, four.star_index)
        with_it.append(work["kvector_hits"])
        without.append(four_work["kvector_hits"])
    assert len(with_it) > 80
    assert np.mean(without) > 2.0 * np.mean(with_it)


def test_a_brightness_wrong_by_more_than_gamma_delays_the_solution_only() -> None:
    """The order of all stars turned round: no group is left whose order is right."""
    rng = np.random.default_rng(22)
    tried = 0
    delayed = []
    while tried < 30:
        view = sky().view(random_attitude(rng))
        if len(view) < 6:
            continue
        tried += 1
        spikes, row = image(rng, some(view, slice(0, 6)), noise_mag=0.0)
        turned = Spikes(spikes.b_vectors[::-1].copy(), spikes.magnitudes.copy())  # the whole order reversed
        found, work = solve(turned, magnitude_tolerance=9.0)
        assert found.reason == Reason.NONE
        np.testing.assert_array_equal(rows_of(found), row[::-1])
        if (
            spikes.magnitudes[3] - spikes.magnitudes[0] > 0.7
            and spikes.magnitudes[5] - spikes.magnitudes[2] > 0.7
        ):
            delayed.append(work.operations() / solve(spikes)[1].operations())
    assert len(delayed) > 5
    assert min(delayed) > 2


def test_three_stars_are_identified_but_unconfirmed() -> None:
    rng = np.random.default_rng(23)
    right = 0
    for _ in range(60):
        q = random_attitude(rng)
        view = sky().view(q)
        spikes, row = image(rng, some(view, slice(0, 3)))
        if len(spikes) < 3:
            continue
        found, _ = solve(spikes)
        if found.reason != Reason.UNCONFIRMED:
            assert found.reason in (Reason.NO_MATCH, Reason.AMBIGUOUS)
            continue
        assert found.identified
        assert found.verified == 3
        assert found.q_icrs_to_sensor is not None
        assert 1e-9 < found.false_solutions <= PARAMETERS.most_false_triangles
        np.testing.assert_array_equal(rows_of(found), row)
        right += 1
    assert right >= 55


def test_three_stars_and_a_false_one_are_unconfirmed_and_more_false_ones_are_refused() -> None:
    rng = np.random.default_rng(24)
    named = 0
    for _ in range(60):
        view = some(sky().view(random_attitude(rng)), slice(0, 3))
        spikes, row = image(rng, view, false=1)
        found, _ = solve(spikes)
        assert found.reason in (Reason.UNCONFIRMED, Reason.NO_MATCH, Reason.AMBIGUOUS)
        if found.reason == Reason.UNCONFIRMED:
            np.testing.assert_array_equal(rows_of(found), row)
            named += 1
        spikes, _ = image(rng, view, false=2)
        assert solve(spikes)[0].reason == Reason.NO_MATCH
    assert named >= 55


def twice(rng: np.random.Generator, stars: int) -> tuple[StarTables, StarTables, np.ndarray]:
    """Tables where a pattern stands twice, where it stands once, and the pattern in the sensor frame."""
    b = vectors_of(WIDE, rng.uniform(40, 980, stars), rng.uniform(40, 980, stars))
    here, there = matrix(random_attitude(rng)), matrix(random_attitude(rng))
    vectors = np.concatenate([b @ here, b @ there, random_directions(rng, 500)])
    magnitude = np.concatenate(
        [np.linspace(2, 4.9, stars), np.linspace(2, 4.9, stars), rng.uniform(2, 5, 500)]
    )

    def tables(first: int) -> StarTables:
        catalogue = build_star_catalogue(
            np.arange(first, len(vectors)), vectors[first:], magnitude[first:], 5.0, 0.0
        )
        return StarTables(catalogue, build_pair_catalogue(catalogue, 2 * WIDE.half_diagonal_rad))

    return tables(0), tables(stars), b


@pytest.mark.parametrize("stars", [3, 4, 6])
def test_a_pattern_that_stands_twice_in_the_sky_is_ambiguous(stars: int) -> None:
    both, one, b = twice(np.random.default_rng(25), stars)
    spikes = Spikes(b, np.linspace(2, 4.9, stars))
    parameters = replace(PARAMETERS, certain_false_solutions=1e-30)
    assert identify(spikes, both, parameters)[0].reason == Reason.AMBIGUOUS
    expected = Reason.UNCONFIRMED if stars == 3 else Reason.NONE
    assert identify(spikes, one, parameters)[0].reason == expected


def test_a_mirrored_sky_is_not_recognised() -> None:
    rng = np.random.default_rng(26)
    for _ in range(40):
        spikes, _ = image(rng, sky().view(random_attitude(rng)))
        found, _ = solve(Spikes(spikes.b_vectors * [-1.0, 1.0, 1.0], spikes.magnitudes))
        assert found.reason in (Reason.NO_MATCH, Reason.TOO_FEW_STARS)


def test_spots_at_random_places_are_no_stars() -> None:
    rng = np.random.default_rng(27)
    for count in (5, 10, 40):
        for _ in range(60):
            b = vectors_of(WIDE, rng.uniform(0, 1024, count), rng.uniform(0, 1024, count))
            found, _ = solve(Spikes(b, np.sort(rng.uniform(1, 5, count))))
            assert found.reason == Reason.NO_MATCH


def test_work_ends_at_its_limit() -> None:
    rng = np.random.default_rng(28)
    b = vectors_of(WIDE, rng.uniform(0, 1024, 12), rng.uniform(0, 1024, 12))
    spikes = Spikes(b, np.linspace(2, 5, 12))
    found, work = solve(spikes, max_spots=12)
    whole = work.operations()
    assert found.reason == Reason.NO_MATCH
    for limit in (0, 1, 100, 500, whole // 2):
        found, work = solve(spikes, max_spots=12, max_operations=limit)
        assert found.reason == Reason.WORK_LIMIT
        assert limit <= work.operations() + 3
        assert work.operations() < limit + 400  # one range more at most
    assert solve(spikes, max_spots=12, max_operations=whole + 1)[0].reason == Reason.NO_MATCH


def test_degenerate_images_end_with_a_reason() -> None:
    rng = np.random.default_rng(29)
    spikes, row = image(rng, sky().view(random_attitude(rng)))
    b, magnitude = spikes.b_vectors, spikes.magnitudes
    for count in (0, 1, 2):
        found, work = solve(Spikes(b[:count], magnitude[:count]))
        assert found.reason == Reason.TOO_FEW_STARS
        assert len(found.star_index) == count
        assert work.operations() == 0
    spoilt = b.copy(), magnitude.copy()
    spoilt[0][1, 2] = np.nan
    spoilt[1][3] = np.nan
    found, _ = solve(Spikes(*spoilt))
    expected = row.copy()
    expected[[1, 3]] = -1
    assert found.reason == Reason.NONE
    np.testing.assert_array_equal(rows_of(found), expected)
    assert solve(Spikes(b * np.nan, magnitude))[0].reason == Reason.TOO_FEW_STARS
    assert solve(Spikes(np.repeat(b[:1], 20, axis=0), np.full(20, 3.0)))[0].reason in REFUSED
    in_line = vectors_of(WIDE, np.linspace(50, 950, 9), np.full(9, 500.0))
    assert solve(Spikes(in_line, np.full(9, 3.0)))[0].reason in REFUSED
    doubled = np.repeat(b, 2, axis=0) + rng.normal(0, 2 * ARCSEC, (2 * len(b), 3))
    doubled /= np.linalg.norm(doubled, axis=1, keepdims=True)
    found, _ = solve(Spikes(doubled, np.repeat(magnitude, 2)), max_spots=20)
    named = found.star_index >= 0
    assert found.reason == Reason.NONE
    np.testing.assert_array_equal(rows_of(found)[named], np.repeat(row, 2)[named])


def test_a_thousand_spikes_end_within_their_work() -> None:
    rng = np.random.default_rng(30)
    b = vectors_of(WIDE, rng.uniform(0, 1024, 1000), rng.uniform(0, 1024, 1000))
    found, work = solve(Spikes(b, np.sort(rng.uniform(0, 6, 1000))), max_spots=20)
    assert found.reason in REFUSED
    assert work.operations() < 100_000
    found, work = solve(
        Spikes(b, np.sort(rng.uniform(0, 6, 1000))), tolerance_rad=0.02, max_operations=50_000
    )
    assert found.reason == Reason.WORK_LIMIT
    assert work.operations() < 3_000_000


def test_the_input_is_left_alone_and_the_outcome_is_the_same_again() -> None:
    rng = np.random.default_rng(31)
    spikes, _ = image(rng, sky().view(random_attitude(rng)), false=2)
    kept = spikes.b_vectors.copy(), spikes.magnitudes.copy()
    first, first_work = solve(spikes)
    second, second_work = solve(spikes)
    np.testing.assert_array_equal(spikes.b_vectors, kept[0])
    np.testing.assert_array_equal(spikes.magnitudes, kept[1])
    np.testing.assert_array_equal(first.star_index, second.star_index)
    assert first_work == second_work
    assert not math.isinf(first.false_solutions)
