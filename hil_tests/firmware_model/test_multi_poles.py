"""Improved multi-poles: its equations, its plain version, the truth of thousands of skies, its edges.

Equation numbers: Schiattarella, Spiller & Curti 2020, section 5.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_tests.firmware_model import reference_multi_poles
from hil_tests.firmware_model.multi_poles_scenes import (
    CAMERA,
    FINE,
    PARAMETERS,
    catalogued,
    chosen,
    is_right,
    measure,
    sky,
    solve,
)
from hil_tests.firmware_model.synthetic_sky import (
    ARCSEC,
    SyntheticSky,
    random_attitude,
    turn_between,
    vectors_of,
)
from st_emulator.firmware_model.catalogue.pairs import build_pair_catalogue
from st_emulator.firmware_model.catalogue.star_catalogue import build_star_catalogue
from st_emulator.firmware_model.catalogue.tables import StarTables
from st_emulator.firmware_model.geometry import CameraGeometry
from st_emulator.firmware_model.identification.interface import (
    IdentificationParameters,
    MultiPolesParameters,
    Spikes,
)
from st_emulator.firmware_model.identification.judgement import COUNT_NAMES
from st_emulator.firmware_model.identification.multi_poles import (
    acceptance_kernel,
    feasible_kernel,
    identify,
    recognised_kernel,
)
from st_emulator.firmware_model.image.detection import DetectionParameters, detect
from st_emulator.firmware_model.reasons import Reason
from st_emulator.firmware_model.work import Work

# -- the equations


def test_31_unit_vector_of_a_centroid() -> None:
    f_mm, pixel_mm = 52.0, 0.018
    for x_px, y_px in ((511.5, 511.5), (0.0, 1023.0), (700.25, 12.5)):
        c_y, c_z = (x_px - 511.5) * pixel_mm, (y_px - 511.5) * pixel_mm
        u = np.array([f_mm, -c_y, -c_z]) / math.sqrt(c_y**2 + c_z**2 + f_mm**2)
        ours = CAMERA.unit_vectors(np.array([x_px]), np.array([y_px]))[0]
        # the paper's first axis is the boresight, its others run against the focal plane's
        np.testing.assert_allclose([ours[2], -ours[0], -ours[1]], u, atol=1e-12)


def test_32_magnitude_of_a_cluster(render_stars, expose) -> None:  # type: ignore[no-untyped-def]
    g0, t_exp_s, electrons_per_dn = 7.3e6, 0.2, 20.0
    parameters = DetectionParameters(zero_point_dn_per_s=g0 / electrons_per_dn, exposure_s=t_exp_s)
    energies = np.array([9.0e4, 4.0e4, 1.0e4])
    places = [(30.2, 40.7), (60.0, 20.4), (90.5, 88.1)]
    electrons = render_stars((128, 128), [(x, y, e) for (x, y), e in zip(places, energies, strict=True)])
    image = expose(
        electrons,
        np.random.default_rng(1),
        background_electrons=6100.0,
        noise_electrons=50.0,
        electrons_per_dn=electrons_per_dn,
    )
    spots, _ = detect(image, parameters)
    np.testing.assert_allclose(spots.magnitude, -2.5 * np.log10(energies / (g0 * t_exp_s)), atol=0.1)


def test_34_spikes_are_taken_by_ascending_magnitude_in_whatever_order_they_come() -> None:
    rng = np.random.default_rng(2)
    q = random_attitude(rng)
    b, magnitude, _ = measure(rng, sky().view(q), false=10)
    first, first_work = solve(b, magnitude)
    assert first.reason == Reason.NONE
    for _ in range(5):
        order = rng.permutation(len(b))
        again, work = solve(b[order], magnitude[order])
        assert work == first_work
        np.testing.assert_array_equal(again.star_index, first.star_index[order])


@pytest.mark.parametrize(
    ("pole_star", "neighbour_star", "fits", "compared"),
    [
        (2.0, 4.0, True, 2),
        (2.69, 4.69, True, 2),
        (2.7, 4.0, False, 1),
        (2.0, 3.3, False, 2),
        (4.0, 2.0, False, 1),
    ],
)
def test_38_one_way_round(pole_star: float, neighbour_star: float, fits: bool, compared: int) -> None:
    counts = np.zeros(len(COUNT_NAMES), np.int64)
    assert feasible_kernel(pole_star, neighbour_star, 2.0, 4.0, 0.7, counts) is fits
    assert counts[COUNT_NAMES.index("magnitudes_compared")] == compared


def small_sky() -> tuple[StarTables, np.ndarray, np.ndarray]:
    """A pole (row 0), four neighbours, a sixth star that stands like the first neighbour but is too dim."""
    plane = np.array([[0.0, 0.0], [0.02, 0.0], [0.0, 0.05], [-0.08, 0.01], [-0.03, -0.1], [0.0, -0.02]])
    b = np.concatenate([plane, np.ones((6, 1))], axis=1)
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    magnitude = np.array([2.0, 3.0, 3.5, 4.0, 4.5, 5.2])
    catalogue = build_star_catalogue(np.arange(1, 7), b, magnitude, 6.0, 0.0)
    return StarTables(catalogue, build_pair_catalogue(catalogue, 0.4)), b, magnitude


def accept(
    tables: StarTables, b: np.ndarray, magnitude: np.ndarray, pole: int, tolerance_mag: float = 0.7
) -> tuple[int, list[int], Work]:
    counts = np.zeros(len(COUNT_NAMES), np.int64)
    accepted = np.zeros(len(b), np.int32)
    pairs, stars = tables.pairs, len(tables.catalogue)
    found = acceptance_kernel(
        pole,
        b,
        magnitude,
        tables.catalogue.hp_mag,
        (pairs.cos_angle, pairs.brighter, pairs.dimmer, pairs.kvector.slope, pairs.kvector.offset,
         pairs.kvector.count_below),
        30 * ARCSEC,
        tolerance_mag,
        0,
        np.zeros(stars, np.int32),
        np.full(stars, -1, np.int64),
        np.zeros(stars, np.int32),
        accepted,
        counts,
    )  # fmt: skip
    return found, accepted.tolist(), Work(dict(zip(COUNT_NAMES, counts.tolist(), strict=True)))


def test_35_to_43_the_accepted_stars_of_a_pole() -> None:
    tables, b, magnitude = small_sky()
    false = np.array([[0.3, 0.1, 1.0]]) / np.linalg.norm([0.3, 0.1, 1.0])
    seen = np.concatenate([b[:5], false])
    found, accepted, work = accept(tables, seen, np.append(magnitude[:5], 5.0), 0)
    assert (found, accepted) == (5, [0, 1, 2, 3, 4, -1])
    # one range search of each neighbour; the pairs 0-1 and 0-5 are equally long, the others alone
    assert (work["angles_computed"], work["kvector_queries"], work["kvector_hits"]) == (5, 5, 5)
    assert work["votes"] == 4
    # without its magnitude the star that stands as far from the pole as another could not be told from it
    assert accept(tables, seen, np.append(magnitude[:5], 5.0), 0, 9.0)[2]["votes"] > 4
    # (38) the other way round: here the pole is the dimmer star of each pair
    found, accepted, _ = accept(tables, seen[:5], magnitude[:5], 4)
    assert (found, accepted) == (5, [0, 1, 2, 3, 4])


def test_41_a_pole_that_two_stars_could_be_is_not_accepted() -> None:
    tables, b, magnitude = small_sky()
    assert accept(tables, b[:2], magnitude[:2], 0, 9.0)[0] == 0  # two stars alone: both get one vote
    assert accept(tables, b[:2], magnitude[:2], 0)[0] == 2  # unless their magnitudes tell them apart
    far = np.array([[0.0, 0.6, 0.8]])
    assert accept(tables, np.concatenate([b[:1], far]), magnitude[:2], 0)[0] == 0  # no pair fits at all


def test_41_a_vote_of_each_neighbour_and_42_the_partner_that_fits_best() -> None:
    """Two stars of like magnitude, 20 arcsec different in their distance from the pole, and one spike."""
    plane = np.array([[0.0, 0.0], [0.05, 0.0], [0.0, 0.05 + 20 * ARCSEC], [-0.08, 0.01], [-0.03, -0.1]])
    b = np.concatenate([plane, np.ones((5, 1))], axis=1)
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    magnitude = np.array([2.0, 4.0, 4.0, 4.0, 4.5])
    catalogue = build_star_catalogue(np.arange(5), b, magnitude, 6.0, 0.0)
    tables = StarTables(catalogue, build_pair_catalogue(catalogue, 0.4))
    for neighbour in (1, 2):
        rows = [0, neighbour, 3, 4]
        found, accepted, work = accept(tables, b[rows], magnitude[rows], 0)
        assert (found, accepted) == (4, rows)
        assert (work["kvector_hits"], work["votes"]) == (4, 3)


def test_44_and_45_what_two_sets_agree_on() -> None:
    counts = np.zeros(len(COUNT_NAMES), np.int64)
    recognised = np.empty(6, np.int32)
    one, other = np.array([[3, 0, -1, 7, 8, -1], [3, 0, -1, -1, 9, 5]], np.int32)
    assert (
        recognised_kernel(one, other, recognised, counts) == 2
    )  # row 0 is a star, two false markers are not
    assert recognised.tolist() == [3, 0, -1, -1, -1, -1]
    assert counts[COUNT_NAMES.index("pairs_compared")] == 6


@pytest.mark.parametrize(("false", "runs"), [([], 2), ([0], 3), ([1], 2), ([0, 1], 4), ([1, 2], 2)])
def test_next_pole(false: list[int], runs: int) -> None:
    """From the neighbours accepted last, else the next brightest: counted by the searches."""
    rng = np.random.default_rng(11)
    view = catalogued(sky().view(random_attitude(rng)))
    x, y = view.x_px.copy(), view.y_px.copy()
    x[false], y[false] = rng.uniform(300, 700, (2, len(false)))
    found, work = solve(vectors_of(CAMERA, x, y), view.magnitude, FINE, least_seen_share=0.0)
    assert found.reason == Reason.NONE
    assert work["kvector_queries"] == runs * (len(x) - 1)


def test_44_too_few_in_both_sets_is_another_run() -> None:
    rng = np.random.default_rng(12)
    view = catalogued(sky().view(random_attitude(rng)))
    b = vectors_of(CAMERA, view.x_px, view.y_px)
    for least in (5, len(b), len(b) + 1):
        found, work = solve(b, view.magnitude, FINE, multi_poles=MultiPolesParameters(0.7, least))
        assert found.reason == Reason.NONE
    # with one false spike not all can be in both sets, whichever the poles
    x = view.x_px.copy()
    x[3] = x[3] + 100 if x[3] < 500 else x[3] - 100
    b = vectors_of(CAMERA, x, view.y_px)
    found, work = solve(b, view.magnitude, FINE, multi_poles=MultiPolesParameters(0.7, len(b)))
    assert found.reason == Reason.NO_MATCH
    assert work["kvector_queries"] == len(b) * (len(b) - 1)


# -- against the plain version


@pytest.mark.parametrize("seed", range(80))
def test_the_compiled_loop_gives_what_the_plain_version_gives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = CameraGeometry(512, 512, 1440.0)
    made = SyntheticSky.make(seed // 10, 800, camera, 6.0)
    view = made.view(random_attitude(rng))
    seen = chosen(view, rng.random(len(view)) >= (0.5 if seed % 3 == 0 else 0.1))
    b, magnitude, _ = measure(rng, seen, 0.1, false=(seed % 5) * 4, camera=camera)
    tolerance = (100 if seed % 2 else 400) * ARCSEC
    least = 3 + seed % 4
    parameters = IdentificationParameters(
        tolerance,
        magnitude_tolerance=99.0,
        most_false_solutions=1e-3,
        multi_poles=MultiPolesParameters(0.6, least),
    )
    found, work = identify(Spikes(b, magnitude), made.tables, parameters)
    reason, star, counted = reference_multi_poles.identify(
        b,
        magnitude,
        made.catalogue.unit_vectors,
        made.catalogue.hp_mag,
        tolerance,
        max_angle=made.pairs.max_angle_rad,
        tolerance_mag=0.6,
        least_recognised=least,
        most_false=1e-3,
    )
    assert found.reason.name == reason
    np.testing.assert_array_equal(found.star_index, star)
    for name in ("kvector_queries", "kvector_hits", "votes"):
        assert work[name] == counted[name], name


# -- against the truth


@pytest.mark.parametrize(("false", "least_right"), [(0, 1.0), (1, 1.0), (10, 0.995), (50, 0.97)])
@pytest.mark.parametrize("arcsec", [25, 100])
def test_hundreds_of_skies_are_solved_and_none_wrongly(false: int, least_right: float, arcsec: int) -> None:
    rng = np.random.default_rng(100 + false)
    eligible = right = 0
    for _ in range(400):
        q = random_attitude(rng)
        view = sky().view(q)
        b, magnitude, row = measure(rng, view, false=false)
        found, _ = solve(b, magnitude, tolerance_rad=arcsec * ARCSEC)
        stars = len(catalogued(view))
        eligible += stars >= 8
        if found.reason != Reason.NONE:
            assert found.verified == 0
            assert (found.star_index == -1).all()
            continue
        assert found.verified == (found.star_index >= 0).sum() >= 4
        assert is_right(found, q)
        named = found.star_index >= 0
        # a false or a dim spot may lie next to a star by chance
        assert (sky().catalogue.hip[found.star_index[named]] != row[named] + 1).sum() <= 0.2 * named.sum()
        right += stars >= 8
    assert eligible > 380
    assert right >= least_right * eligible


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    false=st.integers(0, 50),
    dropped=st.floats(0, 0.8),
    noise_px=st.floats(0, 1.0),
    arcsec=st.floats(10, 300),
    tolerance_mag=st.floats(0.2, 3.0),
    least=st.integers(3, 8),
)
def test_an_attitude_is_right_or_not_given(
    seed: int, false: int, dropped: float, noise_px: float, arcsec: float, tolerance_mag: float, least: int
) -> None:
    rng = np.random.default_rng(seed)
    q = random_attitude(rng)
    view = sky().view(q)
    b, magnitude, _ = measure(rng, chosen(view, rng.random(len(view)) >= dropped), noise_px, false)
    found, _ = solve(
        b, magnitude, tolerance_rad=arcsec * ARCSEC, multi_poles=MultiPolesParameters(tolerance_mag, least)
    )
    assert found.verified == (found.star_index >= 0).sum()
    if found.reason == Reason.NONE:
        assert found.verified >= 4
        assert found.false_solutions <= PARAMETERS.most_false_solutions
        assert found.q_icrs_to_sensor is not None
        error = turn_between(q, found.q_icrs_to_sensor)
        assert (np.abs(error[:2]) < 360 * ARCSEC).all()  # what the paper calls right
    elif found.reason == Reason.UNCONFIRMED:
        assert found.verified == 3
    else:
        assert found.q_icrs_to_sensor is None
        assert found.verified == 0


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_whatever_comes_in_there_is_an_answer(data: st.DataObject) -> None:
    """NaN, infinities, zeros, equal vectors, doubles: a reason or the right attitude."""
    rng = np.random.default_rng(data.draw(st.integers(0, 2**31)))
    q = random_attitude(rng)
    view = sky().view(q)
    b, magnitude, _ = measure(rng, view, false=data.draw(st.integers(0, 10)))
    b, magnitude = b[: data.draw(st.integers(0, len(b)))], magnitude[: len(b)].copy()
    magnitude = magnitude[: len(b)]
    for _ in range(data.draw(st.integers(0, 6)) if len(b) else 0):
        spike, other = data.draw(st.integers(0, len(b) - 1)), data.draw(st.integers(0, len(b) - 1))
        kind = data.draw(st.sampled_from(["nan", "inf", "zero", "twin", "double", "nan_mag", "opposite"]))
        if kind in ("nan", "inf", "zero"):
            b[spike] = {"nan": np.nan, "inf": np.inf, "zero": 0.0}[kind]
        elif kind == "twin":
            b[spike] = b[other]
        elif kind == "double":
            v = b[other] + rng.normal(0, 0.2 / CAMERA.focal_px, 3)
            with np.errstate(invalid="ignore"):  # of one that is infinite already
                b[spike] = v / np.linalg.norm(v)
        elif kind == "opposite":
            b[spike] = -b[other]
        else:
            magnitude[spike] = np.nan
    unusable = ~(np.isfinite(b).all(axis=1) & np.isfinite(magnitude) & b.any(axis=1))
    found, _ = solve(b, magnitude)
    assert len(found.star_index) == len(b)
    assert (found.star_index[unusable] == -1).all()
    if found.reason == Reason.NONE:
        assert is_right(found, q)
