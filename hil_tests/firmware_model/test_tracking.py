"""Detection windows and their verification by the pivot, against plain geometry."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from hil_tests.firmware_model.synthetic_sky import (
    ARCSEC,
    SyntheticSky,
    matrix,
    random_attitude,
    turned,
    vectors_of,
)
from st_emulator.firmware_model.geometry import CameraGeometry
from st_emulator.firmware_model.image.spots import Spots, WindowSpots
from st_emulator.firmware_model.tracking import (
    TrackingParameters,
    TrackingPlan,
    plan_windows,
    window_half_width_px,
)
from st_emulator.firmware_model.verification import Verification, verify_by_pivot

CAMERA = CameraGeometry(512, 512, 1440.0)
SKY = SyntheticSky.make(21, 1500, CAMERA, 6.0)
CROWDED = SyntheticSky.make(22, 12_000, CAMERA, 6.0)
OMEGA = math.radians(1.0)
PARAMETERS = TrackingParameters(OMEGA, 60 * ARCSEC, max_windows=40)
REST = np.zeros(3)
DIRECTIONS = [
    np.array(v) / np.linalg.norm(v) for v in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(v)
]


def plan_for(
    sky: SyntheticSky, q: np.ndarray, parameters: TrackingParameters = PARAMETERS, pivot: int = -1
) -> TrackingPlan:
    return plan_windows(q, pivot, sky.catalogue, CAMERA, parameters, 0.25, 0.1, REST)[0]


def found_in(plan: TrackingPlan, x: np.ndarray, y: np.ndarray, magnitude: np.ndarray) -> WindowSpots:
    """Those of the spots that lie in a window, by window, brightest first in each."""
    r = plan.rects
    inside = (
        (x[:, None] >= r[:, 0]) & (x[:, None] < r[:, 2]) & (y[:, None] >= r[:, 1]) & (y[:, None] < r[:, 3])
    )
    seen = inside.any(axis=1)
    x, y, magnitude, window = x[seen], y[seen], magnitude[seen], inside[seen].argmax(axis=1)
    order = np.lexsort((magnitude, window))
    spots = Spots.at(x, y, magnitude)
    back = np.argsort(np.argsort(magnitude, kind="stable"), kind="stable")[order]
    number = len(r)
    return WindowSpots(
        spots.take(back),
        window[order].astype(np.int32),
        np.ones(number, np.uint8),
        np.zeros(number),
        np.ones(number),
    )


def verify(
    sky: SyntheticSky,
    plan: TrackingPlan,
    found: WindowSpots,
    parameters: TrackingParameters = PARAMETERS,
) -> Verification:
    b = vectors_of(CAMERA, found.spots.x_px, found.spots.y_px)
    return verify_by_pivot(plan, found, b, sky.catalogue, parameters)[0]


def true_spots(sky: SyntheticSky, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    view = sky.view(q)
    return view.x_px, view.y_px, view.magnitude, view.row


def named(
    sky: SyntheticSky, plan: TrackingPlan, verification: Verification, found: WindowSpots
) -> dict[int, tuple[float, float]]:
    """hip of each verified star: place of its spot."""
    return {
        int(sky.catalogue.hip[star]): (found.spots.x_px[spot], found.spots.y_px[spot])
        for star, spot in zip(plan.star, verification.spot, strict=True)
        if spot >= 0
    }


def test_half_widths_by_hand() -> None:
    """R (1)-(2): 480 px over 4.01 deg are 119.7 px/deg; 0.5 deg/s: 14.96 px in 0.25 s, 5.99 px in 0.1 s."""
    roja1 = CameraGeometry(752, 480, 41.1 / 0.006)
    parameters = TrackingParameters(math.radians(0.5), 1e-4, star_radius_px=3.0)
    assert window_half_width_px(parameters, roja1, 0.25, 0.1) == 15 + 6
    assert window_half_width_px(parameters, roja1, 0.50, 0.1) == 30 + 6  # after a dropped frame
    assert window_half_width_px(parameters, roja1, 0.0, 0.0) == 3
    zy3 = CameraGeometry(1024, 1024, 43.3 / 0.015)  # 1024 px over 20.12 deg: 50.9 px/deg
    assert window_half_width_px(replace(parameters, rate_rad_s=OMEGA), zy3, 0.25, 0.2) == 13 + 9


@pytest.mark.parametrize("seed", range(20))
def test_the_plan_holds_the_brightest_stars_of_the_image(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sky = SKY if seed % 2 else CROWDED
    q = random_attitude(rng)
    view = sky.view(q, border_px=-0.5)
    for pivot in (-1, int(view.row[0]), int(view.row[-1])):
        plan = plan_for(sky, q, pivot=pivot)
        expected = view.row[: PARAMETERS.max_windows]
        assert sky.catalogue.hip[plan.star].tolist() == (expected + 1).tolist()
        np.testing.assert_allclose(plan.x_px, view.x_px[: len(expected)], atol=1e-9)
        np.testing.assert_allclose(plan.y_px, view.y_px[: len(expected)], atol=1e-9)
        np.testing.assert_array_equal(plan.reference, sky.catalogue.unit_vectors[plan.star])


def merged_plainly(plan: TrackingPlan) -> set[tuple[int, ...]]:
    """Bounding boxes of windows that meet, again and again until none do."""
    half = plan.half_width_px
    boxes = []
    for x, y in zip(plan.x_px, plan.y_px, strict=True):
        column, row = round(float(x)), round(float(y))
        boxes.append(
            (max(column - half, 0), max(row - half, 0), min(column + half + 1, 512), min(row + half + 1, 512))
        )
    changed = True
    while changed:
        changed = False
        for a, b in itertools.combinations(boxes, 2):
            if a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]:
                boxes.remove(a)
                boxes.remove(b)
                boxes.append((min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])))
                changed = True
                break
    return set(boxes)


@pytest.mark.parametrize("seed", range(30))
def test_windows_are_clipped_and_merged_where_they_meet(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sky = (SKY, CROWDED, CROWDED)[seed % 3]
    parameters = replace(PARAMETERS, rate_rad_s=OMEGA * (1, 0.1, 0.4)[seed % 3])
    plan = plan_for(sky, random_attitude(rng), parameters)
    assert {tuple(rect) for rect in plan.rects.tolist()} == merged_plainly(plan)
    assert len(plan.window) == len(plan.star) == plan.stars_in_windows().sum()
    x, y = np.floor(plan.x_px + 0.5), np.floor(plan.y_px + 0.5)
    mine = plan.rects[plan.window]
    assert (mine[:, 0] <= np.maximum(x - plan.half_width_px, 0)).all()
    assert (mine[:, 1] <= np.maximum(y - plan.half_width_px, 0)).all()
    assert (mine[:, 2] >= np.minimum(x + plan.half_width_px + 1, 512)).all()
    assert (mine[:, 3] >= np.minimum(y + plan.half_width_px + 1, 512)).all()


def test_a_box_that_has_grown_meets_windows_it_did_not_meet_before() -> None:
    """The first window meets neither the second nor the third, but their common box."""
    q = random_attitude(np.random.default_rng(40))
    x, y = np.array([100.0, 122.0, 105.0, 400.0]), np.array([100.0, 118.0, 130.0, 400.0])
    made = SyntheticSky(vectors_of(CAMERA, x, y) @ matrix(q), np.arange(1, 5, dtype=np.float32), CAMERA, 6.0)
    parameters = replace(PARAMETERS, rate_rad_s=OMEGA / 1.6)
    plan = plan_for(made, q, parameters)
    assert plan.half_width_px == 9
    assert {tuple(rect) for rect in plan.rects.tolist()} == {(91, 91, 132, 140), (391, 391, 410, 410)}
    assert len(set(plan.window[:3].tolist())) == 1


def test_a_field_without_stars_has_no_windows() -> None:
    empty = SyntheticSky.make(23, 3, CAMERA, 6.0)
    away = next(
        q for q in (random_attitude(np.random.default_rng(i)) for i in range(99)) if not len(empty.view(q))
    )
    plan = plan_for(empty, away)
    assert len(plan.star) == len(plan.rects) == 0


@pytest.mark.parametrize("direction", DIRECTIONS, ids=str)
def test_at_the_largest_rate_the_stars_are_verified_in_every_direction(direction: np.ndarray) -> None:
    rng = np.random.default_rng(31)
    q = random_attitude(rng)
    for _ in range(10):
        plan = plan_for(SKY, q)
        q = turned(q, OMEGA * 0.25 * direction)
        x, y, magnitude, row = true_spots(SKY, q)
        found = found_in(plan, x + rng.normal(0, 0.05, len(x)), y, magnitude + rng.normal(0, 0.2, len(x)))
        verification = verify(SKY, plan, found)
        planned = set(SKY.catalogue.hip[plan.star].tolist())
        seen = {hip: (x[i], y[i]) for i, hip in enumerate((row + 1).tolist()) if hip in planned}
        by_name = named(SKY, plan, verification, found)
        assert verification.verified == len(by_name) >= 0.9 * len(seen)
        for hip, (found_x, found_y) in by_name.items():
            assert math.hypot(found_x - seen[hip][0], found_y - seen[hip][1]) < 0.5
        brightest = min(seen, key=lambda hip: SKY.magnitude[hip - 1])
        assert SKY.catalogue.hip[plan.star[verification.pivot]] == brightest


def test_another_star_becomes_pivot_when_the_pivot_is_gone() -> None:
    rng = np.random.default_rng(32)
    for _ in range(20):
        q = random_attitude(rng)
        plan = plan_for(SKY, q)
        x, y, magnitude, row = true_spots(SKY, q)
        if len(x) < 6:
            continue
        found = found_in(plan, x[2:], y[2:], magnitude[2:])
        verification = verify(SKY, plan, found)
        assert SKY.catalogue.hip[plan.star[verification.pivot]] == row[2] + 1
        assert verification.verified == len(x) - 2


def test_a_false_spot_in_the_pivots_window_is_found_out() -> None:
    rng = np.random.default_rng(33)
    tried = kept = 0
    while tried < 20:
        q = random_attitude(rng)
        plan = plan_for(SKY, q)
        x, y, magnitude, row = true_spots(SKY, q)
        if len(x) < 6 or plan.stars_in_windows()[plan.window[0]] > 1:
            continue
        tried += 1
        x = x.copy()
        x[0] += 7.0 if x[0] < 256 else -7.0
        verification = verify(SKY, plan, found_in(plan, x, y, magnitude))
        assert SKY.catalogue.hip[plan.star[verification.pivot]] == row[1] + 1
        kept += verification.spot[0] >= 0
    assert kept <= 3  # moved at right angles to the new pivot, it keeps its angle: the attitude rejects it


def test_false_spots_beside_the_stars_change_nothing() -> None:
    rng = np.random.default_rng(34)
    for _ in range(20):
        q = random_attitude(rng)
        plan = plan_for(SKY, q)
        moved = turned(q, rng.uniform(-0.5, 0.5, 3) * OMEGA * 0.25)
        x, y, magnitude, row = true_spots(SKY, moved)
        if len(x) < 6:
            continue
        near = rng.integers(0, len(x), len(x))
        false_x = x[near] + rng.choice([-1, 1], len(x)) * rng.uniform(3, 8, len(x))
        false_y = y[near] + rng.choice([-1, 1], len(x)) * rng.uniform(3, 8, len(x))
        false_magnitude = magnitude[near] + 1.0
        found = found_in(
            plan,
            np.concatenate([x, false_x]),
            np.concatenate([y, false_y]),
            np.concatenate([magnitude, false_magnitude]),
        )
        verification = verify(SKY, plan, found)
        by_name = named(SKY, plan, verification, found)
        truth = {hip: (x[i], y[i]) for i, hip in enumerate((row + 1).tolist())}
        right = [
            hip in truth and math.hypot(place[0] - truth[hip][0], place[1] - truth[hip][1]) < 0.5
            for hip, place in by_name.items()
        ]
        assert (
            sum(right) >= len(right) - 1
        )  # a false spot may fit the pivot by chance: the attitude rejects it
        assert sum(right) >= len(x) - 2


def test_verification_counts_its_angles() -> None:
    q = random_attitude(np.random.default_rng(36))
    plan = plan_for(SKY, q)
    x, y, magnitude, _ = true_spots(SKY, q)
    # a false spot beside each star of every second window
    found = found_in(
        plan,
        np.concatenate([x, x[::2] + 4.0]),
        np.concatenate([y, y[::2]]),
        np.concatenate([magnitude, magnitude[::2] + 1.0]),
    )
    b = vectors_of(CAMERA, found.spots.x_px, found.spots.y_px)
    verification, work = verify_by_pivot(plan, found, b, SKY.catalogue, PARAMETERS)
    pivot = verification.pivot
    others = np.arange(len(found.window)) != verification.spot[pivot]
    spots = np.bincount(found.window[others], minlength=len(plan.rects))[plan.window]
    spots[pivot] = 0
    assert work["pivots_tried"] == 1
    assert work["angles_compared"] == spots.sum() > np.count_nonzero(spots)
    of_others = np.isin(found.window, np.delete(plan.window, pivot)) & others
    assert work["angles_verified"] == np.count_nonzero(of_others)
    assert work["verified_entries"] == len(plan.star) + len(plan.rects) + len(found.window)
    assert work["reference_angles"] == np.count_nonzero(spots)


def test_spots_at_random_places_are_not_verified() -> None:
    rng = np.random.default_rng(35)
    parameters = replace(PARAMETERS, tolerance_rad=20 * ARCSEC)
    verified = 0
    for _ in range(300):
        plan = plan_for(SKY, random_attitude(rng), parameters)
        count = len(plan.star)
        half = plan.half_width_px
        x = plan.x_px + rng.uniform(-half, half, count)
        y = plan.y_px + rng.uniform(-half, half, count)
        found = found_in(plan, x, y, SKY.catalogue.hp_mag[plan.star].astype(float))
        verification = verify(SKY, plan, found, parameters)
        if verification.pivot < 0:
            assert (verification.spot == -1).all()
        else:
            verified += 1
    assert (
        verified <= 6
    )  # angles to the pivot alone, in fields of few stars; residuals are looked at afterwards


def test_stars_that_share_a_window_are_told_apart() -> None:
    """Two stars 9 px apart, nearly equal and measured in the wrong order of brightness."""
    rng = np.random.default_rng(36)
    q = random_attitude(rng)
    x, y = np.array([100.0, 109.0, 300.0, 400.0, 200.0]), np.array([200.0, 203.0, 400.0, 100.0, 300.0])
    magnitude = np.array([3.0, 3.1, 4.0, 4.5, 5.0], np.float32)
    made = SyntheticSky(vectors_of(CAMERA, x, y) @ matrix(q), magnitude, CAMERA, 6.0)
    plan = plan_for(made, q)
    assert plan.window[0] == plan.window[1]
    assert len(plan.rects) == 4
    measured = np.array([3.2, 2.9, 4.0, 4.5, 5.0])
    found = found_in(plan, x + 4.0, y - 3.0, measured)
    verification = verify(made, plan, found)
    assert verification.verified == 5
    for hip, (found_x, found_y) in named(made, plan, verification, found).items():
        assert (found_x, found_y) == (x[hip - 1] + 4.0, y[hip - 1] - 3.0)


def test_one_spot_is_given_to_one_star() -> None:
    rng = np.random.default_rng(37)
    q = random_attitude(rng)
    x, y = np.array([250.0, 100.0, 100.0, 400.0, 300.0]), np.array([250.0, 248.0, 252.0, 260.0, 400.0])
    magnitude = np.array([2.0, 3.0, 3.1, 4.0, 4.5], np.float32)
    made = SyntheticSky(vectors_of(CAMERA, x, y) @ matrix(q), magnitude, CAMERA, 6.0)
    plan = plan_for(made, q, replace(PARAMETERS, tolerance_rad=300 * ARCSEC))
    seen = [0, 1, 3, 4]  # the third star, as far from the pivot as the second, is missing
    found = found_in(plan, x[seen], y[seen], magnitude[seen].astype(float))
    verification = verify(made, plan, found, replace(PARAMETERS, tolerance_rad=300 * ARCSEC))
    assert verification.spot[2] == -1
    assert verification.verified == 4
    used = verification.spot[verification.spot >= 0]
    assert len(set(used.tolist())) == len(used)


def test_a_spot_of_the_wrong_brightness_is_not_the_star() -> None:
    rng = np.random.default_rng(38)
    q = random_attitude(rng)
    plan = plan_for(SKY, q)
    x, y, magnitude, _ = true_spots(SKY, q)
    assert len(x) >= 6
    dim = magnitude.copy()
    dim[3] += 2.5
    verification = verify(SKY, plan, found_in(plan, x, y, dim))
    assert verification.spot[3] == -1
    assert verification.verified == len(x) - 1


def test_fewer_stars_than_asked_for_are_not_verified() -> None:
    rng = np.random.default_rng(39)
    q = random_attitude(rng)
    plan = plan_for(SKY, q)
    x, y, magnitude, _ = true_spots(SKY, q)
    found = found_in(plan, x[:2], y[:2], magnitude[:2])
    assert verify(SKY, plan, found).pivot == -1
    assert verify(SKY, plan, found).found == 2
    assert verify(SKY, plan, found, replace(PARAMETERS, min_stars=2)).verified == 2


def test_bad_parameters_are_refused() -> None:
    with pytest.raises(ValueError, match="rate_rad_s"):
        TrackingParameters(0.0, 1e-4)
    with pytest.raises(ValueError, match="tolerance_rad"):
        TrackingParameters(0.01, 0.5)
    with pytest.raises(ValueError, match="2 stars"):
        TrackingParameters(0.01, 1e-4, min_stars=1)
