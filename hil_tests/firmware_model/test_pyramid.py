"""The pyramid: against its plain version, against the truth of thousands of skies, and at its edges."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hil_tests.firmware_model import reference_pyramid
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
from st_emulator.firmware_model.identification.interface import (
    Identification,
    IdentificationParameters,
    Spikes,
)
from st_emulator.firmware_model.identification.judgement import false_solutions_kernel
from st_emulator.firmware_model.identification.pyramid import identify
from st_emulator.firmware_model.reasons import Reason
from st_emulator.firmware_model.work import Work

NARROW = CameraGeometry(752, 480, 41.1 / 0.006)  # as paper R: 6.3 x 4.0 deg, 30.1 arcsec a pixel
WIDE = CameraGeometry(1024, 1024, 43.3 / 0.015)  # as paper Z: 20 x 20 deg, 71.4 arcsec a pixel
PARAMETERS = {
    "narrow": IdentificationParameters(8 * ARCSEC, field_normals=NARROW.field_normals(-6.0)),
    "wide": IdentificationParameters(25 * ARCSEC, field_normals=WIDE.field_normals(-6.0)),
}


@cache
def sky(name: str) -> SyntheticSky:
    if name == "narrow":
        return SyntheticSky.make(1, 12_500, NARROW, 6.9)
    return SyntheticSky.make(2, 2617, WIDE, 5.5, deeper_mag=1.0)


def measure(
    rng: np.random.Generator, camera: CameraGeometry, view: View, noise_px: float = 0.05, false: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(directions, magnitudes, true rows or -1), brightest first, with noise and false spots."""
    x = np.concatenate(
        [view.x_px + rng.normal(0, noise_px, len(view)), rng.uniform(3, camera.width_px - 4, false)]
    )
    y = np.concatenate(
        [view.y_px + rng.normal(0, noise_px, len(view)), rng.uniform(3, camera.height_px - 4, false)]
    )
    magnitude = np.concatenate([view.magnitude + rng.normal(0, 0.2, len(view)), rng.uniform(3, 6.9, false)])
    row = np.concatenate([view.row, np.full(false, -1)])
    order = np.argsort(magnitude, kind="stable")
    return vectors_of(camera, x, y)[order], magnitude[order], row[order]


def solve(name: str, b: np.ndarray, magnitude: np.ndarray, **changes: object) -> tuple[Identification, Work]:
    parameters = replace(PARAMETERS[name], **changes)  # type: ignore[arg-type]
    return identify(Spikes(b, magnitude), sky(name).tables, parameters)


def some(view: View, count: int) -> View:
    return View(view.row[:count], view.x_px[:count], view.y_px[:count], view.magnitude[:count])


@pytest.mark.parametrize("seed", range(80))
def test_the_compiled_loop_gives_what_the_plain_version_gives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = CameraGeometry(512, 512, 1440.0)
    made = SyntheticSky.make(seed // 10, 800, camera, 6.0)
    view = made.view(random_attitude(rng))
    missing = rng.random(len(view)) < (0.5 if seed % 3 == 0 else 0.1)
    seen = View(*(part[~missing] for part in (view.row, view.x_px, view.y_px, view.magnitude)))
    b, magnitude, _ = measure(rng, camera, seen, 0.1, false=seed % 5)
    tolerance = 100 * ARCSEC
    parameters = IdentificationParameters(tolerance, magnitude_tolerance=99.0, most_false_solutions=1e-3)
    found, _ = identify(Spikes(b, magnitude), made.tables, parameters)
    reason, star = reference_pyramid.identify(
        b, made.catalogue.unit_vectors, tolerance, max_angle=made.pairs.max_angle_rad, most_false=1e-3
    )
    assert found.reason.name == reason
    np.testing.assert_array_equal(found.star_index, star)


@pytest.mark.parametrize(("name", "false"), [("narrow", 0), ("narrow", 3), ("wide", 0), ("wide", 8)])
def test_hundreds_of_skies_are_solved_and_none_wrongly(name: str, false: int) -> None:
    rng = np.random.default_rng(100 + false)
    eligible = right = 0
    for _ in range(400):
        q = random_attitude(rng)
        view = sky(name).view(q)
        b, magnitude, row = measure(rng, sky(name).camera, view, false=false)
        found, _ = solve(name, b, magnitude)
        catalogued = int((view.magnitude < np.float32(sky(name).limit_mag)).sum())
        eligible += catalogued >= 5
        if found.reason == Reason.UNCONFIRMED:
            assert found.verified == (found.star_index >= 0).sum() == 3
            continue
        if found.reason != Reason.NONE:
            assert found.verified == 0
            assert (found.star_index == -1).all()
            continue
        assert found.verified == (found.star_index >= 0).sum() >= 4
        assert found.q_icrs_to_sensor is not None
        assert np.linalg.norm(turn_between(q, found.q_icrs_to_sensor)[:2]) < 10 * ARCSEC
        named = found.star_index >= 0
        hip = sky(name).catalogue.hip[found.star_index[named]]
        wrong = hip != row[named] + 1
        assert wrong.sum() <= 0.1 * named.sum()  # a false spot may lie on a star that is hidden or dim
        right += catalogued >= 5
    assert eligible > 300
    assert right >= 0.995 * eligible


def test_fields_with_four_stars_only_are_solved() -> None:
    rng = np.random.default_rng(4)
    solved = tried = 0
    while tried < 100:
        view = sky("narrow").view(random_attitude(rng))
        if len(view) < 4:
            continue
        tried += 1
        b, magnitude, row = measure(rng, NARROW, some(view, 4))
        found, _ = solve("narrow", b, magnitude, least_seen_share=0.0)
        if found.reason == Reason.NONE:
            assert (sky("narrow").catalogue.hip[found.star_index] == row + 1).all()
            solved += 1
    assert solved >= 98


def test_spots_at_random_places_are_no_stars() -> None:
    rng = np.random.default_rng(5)
    for _ in range(150):
        for name, count in (("narrow", 9), ("wide", 25)):
            camera = sky(name).camera
            x, y = rng.uniform(0, camera.width_px, count), rng.uniform(0, camera.height_px, count)
            found, work = solve(name, vectors_of(camera, x, y), np.sort(rng.uniform(3, 6, count)))
            assert found.reason == Reason.NO_MATCH
            assert work["triads_tested"] == math.comb(min(count, 20), 3)


def test_a_mirrored_sky_is_not_recognised() -> None:
    rng = np.random.default_rng(6)
    refused = tested = 0
    for _ in range(50):
        b, magnitude, _ = measure(rng, NARROW, sky("narrow").view(random_attitude(rng)))
        if len(b) < 6:
            continue
        found, work = solve("narrow", b * [-1.0, 1.0, 1.0], magnitude)
        assert found.reason == Reason.NO_MATCH
        refused += 1
        tested += work["pyramids_tested"]
    assert refused > 20
    assert tested < 5 * refused  # the handedness of the triangle tells, before any fourth star is looked for


def test_a_spot_off_by_more_than_the_tolerance_is_not_matched() -> None:
    rng = np.random.default_rng(16)
    view = sky("wide").view(random_attitude(rng))
    pixel_arcsec = 1 / WIDE.focal_px / ARCSEC
    for off_arcsec, matched in ((15.0, True), (40.0, False)):
        x = view.x_px.copy()
        x[5] += off_arcsec / pixel_arcsec
        found, _ = solve("wide", vectors_of(WIDE, x, view.y_px), view.magnitude)
        assert bool(found.star_index[5] >= 0) == matched
        assert found.star_index[4] >= 0


def test_a_triangle_alone_is_never_valid() -> None:
    rng = np.random.default_rng(7)
    for count in (0, 1, 2):
        view = some(sky("narrow").view(random_attitude(rng)), count)
        b, magnitude, _ = measure(rng, NARROW, view)
        found, work = solve("narrow", b, magnitude)
        assert found.reason == Reason.TOO_FEW_STARS
        assert work["triads_tested"] == 0
    for _ in range(50):
        view = some(sky("narrow").view(random_attitude(rng)), 3)
        b, magnitude, _ = measure(rng, NARROW, view, false=3)
        found, _ = solve("narrow", b, magnitude)
        assert found.reason == Reason.NO_MATCH
    with pytest.raises(ValueError, match="triangle"):
        IdentificationParameters(1e-4, min_stars=3)


@pytest.mark.parametrize("false", [0, 1])
def test_three_stars_are_identified_but_unconfirmed(false: int) -> None:
    """Alone or with a false one beside them: told with their attitude, of which chance is not excluded."""
    rng = np.random.default_rng(17)
    right = tried = 0
    while tried < 200:
        q = random_attitude(rng)
        view = sky("wide").view(q)
        if len(view) < 3:
            continue
        tried += 1
        b, magnitude, row = measure(rng, WIDE, some(view, 3), false=false)
        found, _ = solve("wide", b, magnitude)
        assert found.reason in (Reason.UNCONFIRMED, Reason.AMBIGUOUS)
        if found.reason == Reason.AMBIGUOUS:
            assert (found.star_index == -1).all()
            continue
        assert found.identified
        assert found.verified == 3
        assert 1e-5 < found.false_solutions < 1e-2
        if (sky("wide").catalogue.hip[found.star_index[row >= 0]] == row[row >= 0] + 1).all():
            assert (found.star_index[row < 0] == -1).all()
            assert np.linalg.norm(turn_between(q, found.q_icrs_to_sensor)[:2]) < 30 * ARCSEC
            right += 1
    assert right >= 0.98 * tried


def twin_catalogue(rng: np.random.Generator, stars: int) -> tuple[np.ndarray, np.ndarray]:
    """A pattern of stars that stands twice in the sky, and the pattern in the sensor frame."""
    x, y = rng.uniform(40, 700, stars), rng.uniform(40, 440, stars)
    b = vectors_of(NARROW, x, y)
    here, there = matrix(random_attitude(rng)), matrix(random_attitude(rng))
    return np.concatenate([b @ here, b @ there, random_directions(rng, 2000)]), b


def test_a_pattern_that_stands_twice_in_the_sky_is_ambiguous() -> None:
    rng = np.random.default_rng(8)
    for stars in (4, 5):
        vectors, b = twin_catalogue(rng, stars)
        catalogue = build_star_catalogue(
            np.arange(len(vectors)), vectors, np.full(len(vectors), 5.0), 6.9, 0.0
        )
        pairs = build_pair_catalogue(catalogue, 2 * NARROW.half_diagonal_rad)
        parameters = IdentificationParameters(8 * ARCSEC, certain_false_solutions=1e-30)
        found, _ = identify(Spikes(b, np.full(stars, 5.0)), StarTables(catalogue, pairs), parameters)
        assert found.reason == Reason.AMBIGUOUS
        assert (found.star_index == -1).all()
        one_of_them = build_star_catalogue(
            np.arange(len(vectors) - stars), vectors[stars:], np.full(len(vectors) - stars, 5.0), 6.9, 0.0
        )
        pairs = build_pair_catalogue(one_of_them, 2 * NARROW.half_diagonal_rad)
        assert (
            identify(Spikes(b, np.full(stars, 5.0)), StarTables(one_of_them, pairs), parameters)[0].reason
            == Reason.NONE
        )


def test_work_ends_at_its_limit() -> None:
    rng = np.random.default_rng(9)
    x, y = rng.uniform(0, 752, 12), rng.uniform(0, 480, 12)
    b, magnitude = vectors_of(NARROW, x, y), np.linspace(3, 6, 12)
    found, work = solve("narrow", b, magnitude, max_triads=7)
    assert found.reason == Reason.WORK_LIMIT
    assert work["triads_tested"] == 7
    found, work = solve("narrow", b, magnitude, max_pairs_compared=500)
    assert found.reason == Reason.WORK_LIMIT
    assert work["pairs_compared"] < 500 + 2000  # stops at the first triad after the limit


def test_a_solution_found_before_the_limit_stands() -> None:
    rng = np.random.default_rng(10)
    view = some(sky("narrow").view(random_attitude(rng)), 4)
    b, magnitude, row = measure(rng, NARROW, view)
    found, _ = solve("narrow", b, magnitude, max_triads=2, least_seen_share=0.0)
    assert found.reason == Reason.NONE
    assert (sky("narrow").catalogue.hip[found.star_index] == row + 1).all()


@pytest.mark.parametrize("places", [(0, 1, 2, 3), (0, 2, 4, 5), (1, 3, 4, 6), (2, 3, 5, 6)])
def test_triads_come_in_mortaris_order(places: tuple[int, ...]) -> None:
    """With four true spots among seven, the first triad of three true ones finds the sky."""
    rng = np.random.default_rng(sum(places))
    view = sky("narrow").view(random_attitude(rng))
    while len(view) < 4:
        view = sky("narrow").view(random_attitude(rng))
    true = vectors_of(NARROW, view.x_px[:4], view.y_px[:4])
    b = vectors_of(NARROW, rng.uniform(0, 752, 7), rng.uniform(0, 480, 7))
    b[list(places)] = true
    found, work = solve(
        "narrow",
        b,
        np.full(7, 5.0),
        least_seen_share=0.0,
        certain_false_solutions=1.0,
        magnitude_tolerance=9.0,
    )
    assert found.reason == Reason.NONE
    # i, j, k as printed: for dj, for dk, for i
    order = [
        (i, i + dj, i + dj + dk) for dj in range(1, 6) for dk in range(1, 7 - dj) for i in range(7 - dj - dk)
    ]
    first = next(number for number, triad in enumerate(order, 1) if set(triad) <= set(places))
    assert work["triads_tested"] == first


def test_few_matches_of_impossible_brightness_are_refused() -> None:
    rng = np.random.default_rng(12)
    view = sky("narrow").view(random_attitude(rng))
    while len(view) < 5:
        view = sky("narrow").view(random_attitude(rng))
    b = vectors_of(NARROW, view.x_px[:5], view.y_px[:5])
    right = view.magnitude[:5]
    assert solve("narrow", b, right)[0].reason == Reason.NONE
    assert solve("narrow", b, right + 3.0)[0].reason == Reason.NONE  # the zero point does not matter
    assert (
        solve("narrow", b, right + np.array([0, 3.0, 0, 0, 0]))[0].reason == Reason.NONE
    )  # one saturated star neither
    assert solve("narrow", b, right + np.array([0, 3.0, -3.0, 0, 0]))[0].reason == Reason.NO_MATCH


def test_stars_that_must_be_seen_are_missed() -> None:
    """The dimmest stars of a rich field alone are no image of it: the brighter ones would be there too."""
    rng = np.random.default_rng(13)
    view = sky("wide").view(random_attitude(rng))
    catalogued = int((view.magnitude < 5.5).sum())
    dim = slice(catalogued - 8, catalogued)
    b = vectors_of(WIDE, view.x_px[dim], view.y_px[dim])
    assert solve("wide", b, view.magnitude[dim])[0].reason == Reason.NO_MATCH
    found, _ = identify(
        Spikes(b, view.magnitude[dim]),
        sky("wide").tables,
        replace(PARAMETERS["wide"], field_normals=None),
    )
    assert found.reason == Reason.NONE
    whole, _ = solve("wide", vectors_of(WIDE, view.x_px, view.y_px), view.magnitude)
    assert whole.reason == Reason.NONE
    assert whole.seen >= 0.9 * whole.expected > 5


def test_false_solutions_are_counted_as_the_formula_says() -> None:
    for stars, spots, matched in ((12_500, 8, 4), (2600, 60, 6), (500, 5, 5)):
        expected = reference_pyramid.chance(stars, spots, matched, 0.1, 8 * ARCSEC)
        assert false_solutions_kernel(stars, spots, matched, 0.1, 8 * ARCSEC) == pytest.approx(
            expected, rel=1e-9
        )
    assert false_solutions_kernel(100, 5, 6, 0.1, 1e-4) == math.inf


def test_false_solutions_of_random_images_are_as_many_as_expected() -> None:
    """Random spots in a crowded sky: solutions of four stars by chance, their number against the formula."""
    rng = np.random.default_rng(14)
    crowded = SyntheticSky.make(3, 12_500, NARROW, 6.9)
    tolerance = 150 * ARCSEC
    parameters = IdentificationParameters(
        tolerance, most_false_solutions=math.inf, certain_false_solutions=math.inf, magnitude_tolerance=99.0
    )
    images, spots, solved, expected = 300, 5, 0, 0.0
    for _ in range(images):
        b = vectors_of(NARROW, rng.uniform(0, 752, spots), rng.uniform(0, 480, spots))
        found, _ = identify(Spikes(b, np.full(spots, 5.0)), crowded.tables, parameters)
        solved += found.verified >= 4
        expected += reference_pyramid.chance(12_500, spots, 4, 0.05, tolerance)
    assert expected / 5 < solved < expected * 5  # an order of magnitude is what the formula is for


def test_the_input_is_left_alone() -> None:
    rng = np.random.default_rng(15)
    b, magnitude, _ = measure(rng, NARROW, sky("narrow").view(random_attitude(rng)))
    kept = b.copy(), magnitude.copy()
    first, first_work = solve("narrow", b, magnitude)
    second, second_work = solve("narrow", b, magnitude)
    np.testing.assert_array_equal(b, kept[0])
    np.testing.assert_array_equal(magnitude, kept[1])
    np.testing.assert_array_equal(first.star_index, second.star_index)
    assert first_work == second_work


def test_bad_parameters_are_refused() -> None:
    with pytest.raises(ValueError, match="tolerance_rad"):
        IdentificationParameters(0.0)
    with pytest.raises(ValueError, match="max_spots"):
        IdentificationParameters(1e-4, max_spots=3)
