"""Geometric voting: against its plain version, vote for vote, and against the truth of many skies."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hil_tests.firmware_model import reference_voting
from hil_tests.firmware_model.reference_pyramid import angles
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
from st_emulator.firmware_model.identification.algorithms import ALGORITHMS
from st_emulator.firmware_model.identification.geometric_voting import (
    MOST_IDENTITIES,
    cast_votes_kernel,
    first_identities_kernel,
    identify,
    runners_up_kernel,
)
from st_emulator.firmware_model.identification.interface import IdentificationParameters, Spikes
from st_emulator.firmware_model.identification.judgement import COUNT_NAMES
from st_emulator.firmware_model.reasons import Reason

WIDE = CameraGeometry(1024, 1024, 43.3 / 0.015)  # as paper Z: 20 x 20 deg, 71.4 arcsec a pixel
PARAMETERS = IdentificationParameters(25 * ARCSEC, field_normals=WIDE.field_normals(-6.0))
NO_LIMIT = PARAMETERS.work_limit
OFF_LIMITS = (Reason.TOO_FEW_STARS, Reason.NO_MATCH, Reason.AMBIGUOUS, Reason.WORK_LIMIT)


@cache
def sky() -> SyntheticSky:
    """As many stars as paper Z has brighter than 5.0."""
    return SyntheticSky.make(2, 1500, WIDE, 5.0)


def image(
    rng: np.random.Generator, view: View, noise_px: float = 0.07, false: int = 0
) -> tuple[Spikes, np.ndarray]:
    """Spikes, brightest first, and their rows of the sky (-1: false)."""
    x = np.concatenate([view.x_px + rng.normal(0, noise_px, len(view)), rng.uniform(3, 1020, false)])
    y = np.concatenate([view.y_px + rng.normal(0, noise_px, len(view)), rng.uniform(3, 1020, false)])
    magnitude = np.concatenate([view.magnitude + rng.normal(0, 0.2, len(view)), rng.uniform(2, 5, false)])
    order = np.argsort(magnitude, kind="stable")
    row = np.concatenate([view.row, np.full(false, -1)])
    return Spikes(vectors_of(WIDE, x, y)[order], magnitude[order]), row[order]


def some(view: View, count: int) -> View:
    return View(view.row[:count], view.x_px[:count], view.y_px[:count], view.magnitude[:count])


def tables_of(vectors: np.ndarray, max_angle_rad: float = 0.5) -> StarTables:
    catalogue = build_star_catalogue(np.arange(len(vectors)), vectors, np.full(len(vectors), 4.0), 5.0, 0.0)
    return StarTables(catalogue, build_pair_catalogue(catalogue, max_angle_rad))


def votes_for(b: np.ndarray, tables: StarTables, tolerance_rad: float) -> np.ndarray:
    spots, pairs = len(b), tables.pairs
    votes = np.zeros((spots, len(tables.catalogue)), np.int32)
    bounds = np.empty((2, spots, spots))
    line = pairs.kvector.slope, pairs.kvector.offset, pairs.kvector.count_below
    assert cast_votes_kernel(
        b,
        0,
        spots,
        tolerance_rad,
        (pairs.cos_angle, pairs.brighter, pairs.dimmer, *line),
        NO_LIMIT,
        *bounds,
        votes,
        np.zeros(len(COUNT_NAMES), np.int64),
    )
    return votes


def test_the_name_in_unit_files() -> None:
    assert ALGORITHMS["geometric_voting"] is identify


@pytest.mark.parametrize("seed", range(120))
def test_the_compiled_loops_give_what_the_plain_version_gives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = CameraGeometry(512, 512, 1440.0)
    made = SyntheticSky.make(seed // 10, 800, camera, 6.0)
    view = made.view(random_attitude(rng))
    kept = rng.random(len(view)) > (0.0, 0.3, 0.6, 0.8)[seed % 4]
    x, y = view.x_px[kept], view.y_px[kept]
    false = seed % 5 if seed % 3 else 10 * (seed % 4)
    x = np.concatenate([x, rng.uniform(3, 508, false)]) + rng.normal(0, 0.1, len(x) + false)
    y = np.concatenate([y, rng.uniform(3, 508, false)]) + rng.normal(0, 0.1, len(y) + false)
    mixed = rng.permutation(len(x))
    b = vectors_of(camera, x, y)[mixed]
    tolerance = 100 * ARCSEC
    parameters = IdentificationParameters(
        tolerance, max_spots=8, magnitude_tolerance=99.0, most_false_solutions=1e-3, most_false_triangles=0.3
    )
    found, work = identify(Spikes(b, np.full(len(b), 5.0)), made.tables, parameters)
    reason, star, election = reference_voting.identify(
        b,
        made.catalogue.unit_vectors,
        tolerance,
        max_angle=made.pairs.max_angle_rad,
        max_spots=8,
        most_false=1e-3,
        most_false_triangles=0.3,
    )
    assert found.reason.name == reason
    np.testing.assert_array_equal(found.star_index, star)
    assert work["kvector_hits"] == election.hits
    assert work["kvector_queries"] == work["angles_computed"] == election.queries
    assert work["votes"] == election.counted


def test_the_first_vote_of_the_papers_example() -> None:
    """Spots i, j like stars E, F; i, k like E, G; j, k like no pair."""
    e, f, g = (np.array([math.cos(t), math.sin(t), 0.0]) for t in (0.0, 0.10, -0.17))
    i, j = e, f
    k = np.array([math.cos(0.17), 0.0, math.sin(0.17)])
    votes = votes_for(np.stack([i, j, k]), tables_of(np.stack([e, f, g])), 1e-4)
    np.testing.assert_array_equal(votes, [[2, 1, 1], [1, 1, 0], [1, 0, 1]])


def test_every_pair_within_the_tolerance_votes_with_both_stars_for_both_spots() -> None:
    rng = np.random.default_rng(1)
    vectors = random_directions(rng, 300)
    b = random_directions(rng, 2000)
    b = b[b[:, 2] > 0.95][:12]
    tolerance = 0.002
    votes = votes_for(b, tables_of(vectors), tolerance)
    expected: Counter[tuple[int, int]] = Counter()
    between, measured = angles(vectors, vectors), angles(b, b)
    for i in range(len(b)):
        for j in range(i):
            for one in range(300):
                for other in range(one):
                    if between[one, other] <= 0.5 and abs(between[one, other] - measured[i, j]) <= tolerance:
                        expected.update([(i, one), (i, other), (j, one), (j, other)])
    assert sum(expected.values()) > 500
    assert {(i, s): int(votes[i, s]) for i, s in np.argwhere(votes)} == dict(expected)


def named(votes: list[int], most: int | None = None) -> list[int]:
    star = np.empty(len(votes), np.int32)
    counts = np.zeros(len(COUNT_NAMES), np.int64)
    given = np.array(votes, np.int32)
    found = (
        first_identities_kernel(given, star, counts)
        if most is None
        else runners_up_kernel(given, most, star, counts)
    )
    assert counts[COUNT_NAMES.index("votes")] == len(votes) * (1 if most is None else 2)
    return star[:found].tolist()


def test_who_leads_a_vote() -> None:
    assert named([0, 3, 1, 5, 2]) == [3]
    assert named([0, 5, 1, 5, 5]) == [1, 3, 4]
    assert named([1, 1, 0, 1]) == []  # one vote is that of every pair of the angle
    assert named([2] * MOST_IDENTITIES) == list(range(MOST_IDENTITIES))
    assert named([2] * (MOST_IDENTITIES + 1)) == []
    assert named([2] * (MOST_IDENTITIES + 1) + [3]) == [MOST_IDENTITIES + 1]


def test_runners_up_of_a_vote() -> None:
    votes = [0, 3, 1, 5, 2, 3, 40]
    assert named(votes, 1) == [6]
    assert named(votes, 2) == [3, 6]
    assert named(votes, 3) == [3, 6]  # two share the next place: both or none
    assert named(votes, 4) == [1, 3, 5, 6]
    assert named(votes, 32) == [1, 3, 4, 5, 6]
    assert named([0, 0], 32) == []


@pytest.mark.parametrize("false", [0, 1, 10, 50])
def test_hundreds_of_skies_are_solved_and_none_wrongly(false: int) -> None:
    rng = np.random.default_rng(100 + false)
    eligible = right = 0
    for _ in range(300):
        q = random_attitude(rng)
        view = sky().view(q)
        spikes, row = image(rng, view, false=false)
        found, _ = identify(spikes, sky().tables, PARAMETERS)
        eligible += len(view) >= 4
        if not found.identified:
            assert found.verified == 0
            assert (found.star_index == -1).all()
            assert found.q_icrs_to_sensor is None
            continue
        assert found.q_icrs_to_sensor is not None
        assert np.linalg.norm(turn_between(q, found.q_icrs_to_sensor)[:2]) < 30 * ARCSEC
        name = found.star_index >= 0
        assert found.verified == name.sum() >= (4 if found.reason == Reason.NONE else 3)
        wrong = sky().catalogue.hip[found.star_index[name]] != row[name] + 1
        assert wrong.sum() <= 0.1 * name.sum()  # a false spot may lie on a star, two stars on each other
        right += len(view) >= 4 and found.reason == Reason.NONE
    assert eligible > 280
    assert right >= (0.95 if false == 50 else 0.995) * eligible


def test_a_triangle_alone_is_unconfirmed() -> None:
    rng = np.random.default_rng(7)
    unconfirmed = 0
    for _ in range(100):
        q = random_attitude(rng)
        spikes, row = image(rng, some(sky().view(q), 3))
        found, _ = identify(spikes, sky().tables, replace(PARAMETERS, field_normals=None))
        assert found.reason in (Reason.UNCONFIRMED, Reason.AMBIGUOUS, Reason.NO_MATCH)
        if found.reason != Reason.UNCONFIRMED:
            continue
        unconfirmed += 1
        assert found.identified
        assert found.verified == 3
        assert found.q_icrs_to_sensor is not None
        assert PARAMETERS.most_false_solutions < found.false_solutions <= PARAMETERS.most_false_triangles
        assert (sky().catalogue.hip[found.star_index] == row + 1).all()
    assert unconfirmed >= 95


def test_three_true_stars_and_a_false_one_are_unconfirmed() -> None:
    rng = np.random.default_rng(8)
    right = 0
    for _ in range(100):
        spikes, row = image(rng, some(sky().view(random_attitude(rng)), 3), false=1)
        found, _ = identify(spikes, sky().tables, replace(PARAMETERS, field_normals=None))
        assert found.reason != Reason.NONE
        if found.reason == Reason.UNCONFIRMED:
            right += bool((found.star_index >= 0).sum() == 3 and found.star_index[row < 0][0] == -1)
    assert right >= 95


@pytest.mark.parametrize(("stars", "copies", "reason"), [
    (3, 1, Reason.UNCONFIRMED),
    (3, 2, Reason.AMBIGUOUS),
    (5, 1, Reason.NONE),
    (5, 2, Reason.AMBIGUOUS),
])  # fmt: skip
def test_a_pattern_that_stands_twice_in_the_sky(stars: int, copies: int, reason: Reason) -> None:
    rng = np.random.default_rng(9)
    b = vectors_of(WIDE, rng.uniform(40, 980, stars), rng.uniform(40, 980, stars))
    here = [b @ matrix(random_attitude(rng)) for _ in range(copies)]
    tables = tables_of(np.concatenate([*here, random_directions(rng, 500)]))
    parameters = IdentificationParameters(25 * ARCSEC, certain_false_solutions=1e-30)
    found, _ = identify(Spikes(b, np.full(stars, 4.0)), tables, parameters)
    assert found.reason == reason
    assert (found.star_index >= 0).all() == found.identified


def test_a_mirrored_sky_and_random_spots_are_not_recognised() -> None:
    """A triangle may fit by chance, and a flat one is its own mirror image: but no more than three stars."""
    rng = np.random.default_rng(10)
    triangles = 0
    for _ in range(60):
        spikes, _ = image(rng, sky().view(random_attitude(rng)))
        mirrored = Spikes(spikes.b_vectors * [-1.0, 1.0, 1.0], spikes.magnitudes)
        count = int(rng.integers(5, 40))
        b = vectors_of(WIDE, rng.uniform(0, 1024, count), rng.uniform(0, 1024, count))
        for not_the_sky in (mirrored, Spikes(b, np.sort(rng.uniform(2, 5, count)))):
            found, _ = identify(not_the_sky, sky().tables, PARAMETERS)
            assert found.reason in (Reason.NO_MATCH, Reason.UNCONFIRMED)
            triangles += found.reason == Reason.UNCONFIRMED
    assert triangles <= 3


def test_work_ends_at_its_limit() -> None:
    rng = np.random.default_rng(11)
    b = vectors_of(WIDE, rng.uniform(0, 1024, 60), rng.uniform(0, 1024, 60))
    spikes = Spikes(b, np.linspace(2, 5, 60))
    whole = identify(spikes, sky().tables, PARAMETERS)[1].operations()
    # One step: the range of a pair of spots, the table of a spot, an identity's second votes, or a trial.
    for share in (0.0, 0.01, 0.2, 0.5, 0.9, 0.99):
        limit = int(share * whole)
        found, work = identify(spikes, sky().tables, replace(PARAMETERS, max_operations=limit))
        assert found.reason == Reason.WORK_LIMIT
        assert (found.star_index == -1).all()
        assert limit <= work.operations() <= limit + 20_000
    assert identify(spikes, sky().tables, replace(PARAMETERS, max_operations=whole + 1))[0].reason == (
        Reason.NO_MATCH
    )


def test_a_solution_found_before_the_limit_stands() -> None:
    rng = np.random.default_rng(12)
    spikes, _ = image(rng, some(sky().view(random_attitude(rng)), 6))
    uncertain = replace(PARAMETERS, certain_false_solutions=0.0, field_normals=None)
    found, work = identify(spikes, sky().tables, uncertain)
    assert found.reason == Reason.NONE
    short, less = identify(
        spikes, sky().tables, replace(uncertain, max_operations=work.operations() * 6 // 10)
    )
    assert less.operations() < work.operations()
    np.testing.assert_array_equal(short.star_index, found.star_index)


COORDINATE = st.one_of(
    st.floats(-1.0, 1.0), st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e300, 1e-300])
)


@settings(max_examples=150, deadline=None)
@given(
    st.lists(st.tuples(COORDINATE, COORDINATE, COORDINATE, COORDINATE), max_size=30),
    st.sampled_from([1e-5, 1e-4, 5e-3, 0.09]),
    st.booleans(),
)
# One query of 22,000 pairs went past the limit by more than a tenth of it.
@example(
    [
        *[(0.0, 0.0, 0.0, 0.0)] * 12,
        *[(0.0, 0.0, 1.0, 0.0)] * 2,
        *[(0.0, 1.0, 0.0, 0.0)] * 2,
        (0.0, 0.875, 0.375, 0.0),
    ],
    0.09,
    True,
)
def test_whatever_comes_in_has_a_reason(
    rows: list[tuple[float, float, float, float]], tolerance_rad: float, normed: bool
) -> None:
    given_rows = np.array(rows, np.float64).reshape(-1, 4)
    b = given_rows[:, :3]
    if normed:
        with np.errstate(all="ignore"):
            b = b / np.linalg.norm(b, axis=1, keepdims=True)
    parameters = replace(PARAMETERS, tolerance_rad=tolerance_rad, max_operations=300_000)
    found, work = identify(Spikes(b, given_rows[:, 3]), sky().tables, parameters)
    assert len(found.star_index) == len(b)
    assert found.identified or found.reason in OFF_LIMITS
    assert work.operations() < 300_000 + 100_000
    unusable = ~np.isfinite(given_rows).all(axis=1)
    assert (found.star_index[unusable] == -1).all()


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    kept=st.floats(0.2, 1.0),
    false=st.integers(0, 25),
    doubled=st.integers(0, 4),
    broken=st.integers(0, 3),
    noise_px=st.sampled_from([0.0, 0.07, 0.3, 1.0]),
)
def test_no_attitude_is_ever_wrong(
    seed: int, kept: float, false: int, doubled: int, broken: int, noise_px: float
) -> None:
    """Stars missing, false ones, doubles at the same place or closer than a pixel, NaN."""
    rng = np.random.default_rng(seed)
    q = random_attitude(rng)
    view = sky().view(q)
    chosen = rng.random(len(view)) < kept
    seen = View(*(part[chosen] for part in (view.row, view.x_px, view.y_px, view.magnitude)))
    spikes, _ = image(rng, seen, noise_px, false)
    again = rng.integers(0, max(1, len(spikes)), doubled if len(spikes) else 0)
    twins = spikes.b_vectors[again] + rng.choice([0.0, 1e-4], (len(again), 1)) * random_directions(
        rng, len(again)
    )
    b = np.concatenate([spikes.b_vectors, twins / np.linalg.norm(twins, axis=1, keepdims=True)])
    magnitudes = np.concatenate([spikes.magnitudes, spikes.magnitudes[again]])
    for spot in rng.integers(0, max(1, len(b)), broken if len(b) else 0):
        (b[spot] if rng.random() < 0.5 else magnitudes[spot : spot + 1])[:] = math.nan
    found, _ = identify(Spikes(b, magnitudes), sky().tables, PARAMETERS)
    assert (found.star_index[~np.isfinite(b).all(axis=1) | ~np.isfinite(magnitudes)] == -1).all()
    if found.reason == Reason.NONE:
        assert found.q_icrs_to_sensor is not None
        off = turn_between(q, found.q_icrs_to_sensor) / ARCSEC
        allowed = 60 + 4 * 71.4 * noise_px  # the right stars of a bad image
        assert np.linalg.norm(off[:2]) < allowed
        assert abs(off[2]) < 20 * allowed
    named_rows = found.star_index[found.star_index >= 0]
    assert len(set(named_rows.tolist())) == len(named_rows)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_spots(count: int) -> None:
    rng = np.random.default_rng(13)
    spikes, _ = image(rng, some(sky().view(random_attitude(rng)), count))
    found, work = identify(spikes, sky().tables, PARAMETERS)
    assert found.reason == Reason.TOO_FEW_STARS
    assert work.operations() == 0


def test_spots_in_a_line_equal_spots_and_a_thousand() -> None:
    rng = np.random.default_rng(14)
    line = vectors_of(WIDE, np.linspace(20, 1000, 15), np.full(15, 512.0))
    equal = np.repeat(vectors_of(WIDE, np.array([300.0]), np.array([700.0])), 9, axis=0)
    crowd = vectors_of(WIDE, rng.uniform(0, 1024, 1000), rng.uniform(0, 1024, 1000))
    for b in (line, equal, crowd):
        found, work = identify(Spikes(b, np.full(len(b), 4.0)), sky().tables, PARAMETERS)
        assert found.reason == Reason.NO_MATCH
        assert work.operations() < 20_000_000


def test_the_input_is_left_alone() -> None:
    rng = np.random.default_rng(15)
    spikes, _ = image(rng, sky().view(random_attitude(rng)), false=3)
    kept = spikes.b_vectors.copy(), spikes.magnitudes.copy()
    first, first_work = identify(spikes, sky().tables, PARAMETERS)
    second, second_work = identify(spikes, sky().tables, PARAMETERS)
    np.testing.assert_array_equal(spikes.b_vectors, kept[0])
    np.testing.assert_array_equal(spikes.magnitudes, kept[1])
    np.testing.assert_array_equal(first.star_index, second.star_index)
    assert first_work == second_work
