"""What the identification kernels in C share: ranges, matches, the final judgement; what Q30 would save."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hil_tests.arm.identification_scenes import PARAMETERS, seen, sky
from hil_tests.firmware_model.synthetic_sky import ARCSEC, matrix, random_attitude, random_directions
from st_emulator.firmware_model.catalogue.kvector import build_kvector, range_kernel
from st_emulator.firmware_model.catalogue.pairs import PairCatalogue
from st_emulator.firmware_model.catalogue.tables import star_arrays
from st_emulator.firmware_model.identification import solutions, verification
from st_emulator.firmware_model.identification.interface import Spikes
from tools.arm_timing.machine import ArmMachine
from tools.calibration.steps import identification as binding
from tools.calibration.struct_layout import layout_of, place_struct, read_struct

Array = NDArray[np.float64]
EMPTY = {"q": np.zeros((2, 4)), "chance": [math.inf] * 2}  # members of two st_solution
EMPTY |= {name: [0, 0] for name in ("matched", "expected", "seen", "rivals")}


def pairs_of(cosines: Array) -> PairCatalogue:
    rows = np.zeros(len(cosines), np.int32)
    return PairCatalogue(cosines, rows, rows, 0.3, build_kvector(cosines))


@cache
def pair_lists() -> dict[str, PairCatalogue]:
    rng = np.random.default_rng(1)
    return {
        "catalogue": sky("wide").pairs,
        "random": pairs_of(np.sort(rng.uniform(0.9, 1.0, 700))),
        "lumped": pairs_of(np.sort(rng.choice(rng.uniform(0.9, 1.0, 40), 600))),
        "one": pairs_of(np.array([0.97])),
        "none": pairs_of(np.zeros(0)),
    }


def ranges(machine: ArmMachine, pairs: PairCatalogue, windows: Array) -> NDArray[np.int32]:
    table, first, end = binding.place_pair_table(machine, pairs), machine.reserve(4), machine.reserve(4)
    found = np.empty((len(windows), 2), np.int32)
    for row, (lowest, highest) in enumerate(windows):
        machine.call("st_range", table, float(lowest), float(highest), first, end)
        found[row] = machine.read(first, np.int32, 1)[0], machine.read(end, np.int32, 1)[0]
    return found


@pytest.mark.parametrize("name", ["catalogue", "random", "lumped", "one", "none"])
def test_a_range_holds_the_values_within_the_window(machine: ArmMachine, name: str) -> None:
    """Random windows, windows that end on values or one bit beside them, and windows beyond the list."""
    pairs = pair_lists()[name]
    rng = np.random.default_rng(2)
    values = pairs.cos_angle
    low = values[0] if len(values) else 0.9
    windows = [np.sort(rng.uniform(low - 0.01, 1.0, 2)) for _ in range(300)]
    windows += [np.array([-1.0, low - 1e-3]), np.array([-1.0, 1.0]), np.array([1.0, 1.0])]
    windows += [np.array([0.99, 0.98])]  # turned round: nothing
    for _ in range(300 if len(values) else 0):
        ends = np.sort(rng.choice(values, 2))
        nudged = np.nextafter(ends, ends + rng.choice([-1.0, 0.0, 1.0], 2))
        windows.append(nudged)
    found = ranges(machine, pairs, np.array(windows))
    for (lowest, highest), (first, end) in zip(windows, found.tolist(), strict=True):
        inside = (values >= lowest) & (values <= highest)
        assert end - first == inside.sum()
        assert inside[first:end].all()


def test_a_range_is_that_of_the_python_stage(machine: ArmMachine) -> None:
    pairs = sky("wide").pairs
    rng = np.random.default_rng(3)
    angles = rng.uniform(0.001, pairs.max_angle_rad, 400)
    windows = np.stack([np.cos(angles + 1e-4), np.cos(angles - 1e-4)], axis=1)
    for window, found in zip(windows, ranges(machine, pairs, windows).tolist(), strict=True):
        kvector = pairs.kvector
        expected = range_kernel(pairs.cos_angle, kvector.slope, kvector.offset, kvector.count_below, *window)
        assert tuple(found) == expected[:2]


def test_angles_and_their_windows(machine: ArmMachine) -> None:
    """Against numpy, from arc seconds to opposite directions; cosines to two bits, clamped at 0 and pi."""
    rng = np.random.default_rng(4)
    low, high = machine.reserve(8), machine.reserve(8)
    for _ in range(200):
        one = random_directions(rng, 1)[0]
        turn = 10.0 ** rng.uniform(-6, 0.49)
        axis = np.cross(one, random_directions(rng, 1)[0])
        other = Rotation.from_rotvec(turn * axis / np.linalg.norm(axis)).apply(one)
        angle = machine.call("st_angle", machine.place(one), machine.place(other)).result_pair
        assert angle == pytest.approx(turn, abs=2e-15 + 2e-16 / math.cos(0.5 * turn))
        tolerance = float(rng.choice([1e-4, 0.5, 2.0]))
        machine.call("st_cosine_range", angle, tolerance, low, high)
        expected = np.cos([min(np.pi, angle + tolerance), max(0.0, angle - tolerance)])
        found = [machine.read(address, np.float64, 1)[0] for address in (low, high)]
        np.testing.assert_allclose(found, expected, rtol=0, atol=3e-16)
        machine.release()
        low, high = machine.reserve(8), machine.reserve(8)
    opposite = machine.place(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]))
    assert machine.call("st_angle", opposite, opposite + 24).result_pair == pytest.approx(math.pi)


def test_the_handedness_is_bit_for_bit(machine: ArmMachine) -> None:
    vectors = random_directions(np.random.default_rng(5), 60)
    placed = machine.place(vectors)
    for i in range(0, 60, 3):
        found = machine.call("st_volume", placed, i, i + 1, i + 2).result_pair
        assert found == solutions.volume_kernel(vectors, i, i + 1, i + 2)
        assert found == pytest.approx(np.linalg.det(vectors[i : i + 3]), abs=1e-15)


@pytest.mark.parametrize("name", ["narrow", "wide"])
@pytest.mark.parametrize("searched", [1.0, 2.0])
@pytest.mark.parametrize("widened", [1, 100])
def test_matches_are_those_of_the_python_stage(
    machine: ArmMachine, name: str, searched: float, widened: int
) -> None:
    """With stars thought known (a tenth wrongly) and what an earlier search left of them.

    A hundred times the tolerance reaches two stars or more about many a spike.
    """
    tables, tolerance = sky(name).tables, widened * PARAMETERS[name].tolerance_rad
    catalogue = tables.catalogue
    separation = verification.separation_kernel(tables.pairs.cos_angle)
    rng = np.random.default_rng(6)
    all_matched = 0
    for seed in range(12):
        scene = seen(name, 50 + seed, stars=20, false=3, noise_px=0.15)
        spots = len(scene.spikes)
        q = attitude_near(scene.spikes.b_vectors, scene.true_rows, catalogue.unit_vectors, rng, tolerance)
        known = np.where(rng.random(spots) < 0.6, scene.true_rows, -1).astype(np.int32)
        wrong = rng.random(spots) < 0.1
        known[wrong] = rng.integers(0, len(catalogue), int(wrong.sum()))
        angle = np.where(rng.random(spots) < 0.5, rng.uniform(0, 2 * tolerance, spots), np.inf)
        star_index, counts = known.copy(), verification.first_counts(spots)
        cells = catalogue.cells
        only_star, only_angle = known.copy(), angle.copy()
        matched = verification.match_spots_kernel(
            scene.spikes.b_vectors, q, catalogue.unit_vectors, cells.band_height_rad, cells.band_first_cell,
            cells.cell_start, cells.cell_star, separation, tolerance, searched * tolerance,
            only_star, only_angle, star_index, counts,
        )  # fmt: skip
        placed = [machine.place(array) for array in (known, angle, known)]
        call = machine.call(
            "st_match_spots",
            binding.place_spikes(machine, scene.spikes),
            machine.place(q),
            binding.place_star_table(machine, catalogue),
            float(separation),
            float(tolerance),
            float(searched * tolerance),
            *placed,
        )
        assert call.result == matched
        all_matched += matched
        np.testing.assert_array_equal(machine.read(placed[2], np.int32, spots), star_index)
        np.testing.assert_array_equal(machine.read(placed[0], np.int32, spots), only_star)
        np.testing.assert_allclose(machine.read(placed[1], np.float64, spots), only_angle, atol=1e-12)
        machine.release()
    assert all_matched > 60


def attitude_near(
    b: Array, rows: NDArray[np.intp], unit_vectors: Array, rng: np.random.Generator, tolerance_rad: float
) -> Array:
    """The attitude of the true stars, turned by about a third of the tolerance."""
    true = rows >= 0
    rotation, _ = Rotation.align_vectors(unit_vectors[rows[true]], b[true])
    turned = rotation * Rotation.from_rotvec(rng.normal(0, tolerance_rad / 3, 3))
    q = turned.as_quat()
    return np.asarray(q if q[3] >= 0 else -q)


def test_a_match_is_the_nearest_star_of_the_whole_sky(machine: ArmMachine) -> None:
    """Against plain numpy over all stars; spikes apart, so that no two meet at one star."""
    catalogue = sky("wide").catalogue
    rng = np.random.default_rng(7)
    radius = 600 * ARCSEC
    for _ in range(6):
        q = random_attitude(rng)
        b = random_directions(rng, 40)
        away = np.linalg.norm((b @ matrix(q))[:, np.newaxis] - catalogue.unit_vectors, axis=2)
        nearest = away.argmin(axis=1)
        b, nearest = b[np.unique(nearest, return_index=True)[1]], np.unique(nearest)
        near = np.linalg.norm((b @ matrix(q)) - catalogue.unit_vectors[nearest], axis=1)
        expected = np.where(2 * np.arcsin(near / 2) <= radius, nearest, -1)
        unknown, index = machine.place(np.full(len(b), -1, np.int32)), machine.reserve(4 * len(b))
        call = machine.call(
            "st_match_spots",
            binding.place_spikes(machine, Spikes(b, np.zeros(len(b)))),
            machine.place(q),
            binding.place_star_table(machine, catalogue),
            0.0,
            radius,
            2 * radius,
            unknown,
            machine.place(np.full(len(b), np.inf)),
            index,
        )
        np.testing.assert_array_equal(machine.read(index, np.int32, len(b)), expected)
        assert call.result == (expected >= 0).sum()
        machine.release()


@pytest.mark.parametrize("name", ["narrow", "wide"])
def test_the_stars_expected_are_those_in_the_field(machine: ArmMachine, name: str) -> None:
    """All stars of the catalogue against the four planes, by numpy."""
    world = sky(name)
    normals = PARAMETERS[name].normals
    rng = np.random.default_rng(8)
    for _ in range(10):
        q = random_attitude(rng)
        inside = np.flatnonzero((world.catalogue.unit_vectors @ matrix(q).T @ normals.T > 0).all(axis=1))
        if len(inside) < 5:
            continue
        index = np.full(len(inside) + 4, -1, np.int32)
        kept = rng.permutation(len(inside))[: max(3, len(inside) // 2)]
        index[kept] = inside[kept]
        magnitudes = np.sort(world.catalogue.hp_mag[index[index >= 0]])
        limit = magnitudes[(len(magnitudes) - 1) // 2]
        expected, seen_ = machine.reserve(4), machine.reserve(4)
        machine.call(
            "st_expected",
            machine.place(q),
            machine.place(normals),
            binding.place_star_table(machine, world.catalogue),
            machine.place(index),
            len(index),
            expected,
            seen_,
        )
        bright = inside[world.catalogue.hp_mag[inside] <= limit]
        assert machine.read(expected, np.int32, 1)[0] == len(bright)
        assert machine.read(seen_, np.int32, 1)[0] == np.isin(bright, index).sum()
        machine.release()


def test_odd_brightness_counts_what_is_far_from_the_median(machine: ArmMachine) -> None:
    catalogue = sky("wide").catalogue
    rng = np.random.default_rng(9)
    hp_mag = machine.place(catalogue.hp_mag, keep=True)
    for count in (0, 1, 2, 3, 4, 5, 9):
        for _ in range(8):
            index = rng.integers(0, len(catalogue), count + 2).astype(np.int32)
            index[:2] = -1
            rng.shuffle(index)
            magnitudes = rng.normal(4.0, 1.5, len(index))
            off = magnitudes[index >= 0] - catalogue.hp_mag[index[index >= 0]].astype(float)
            expected = (np.abs(off - np.median(off)) > 1.5).sum() if count else 0
            placed = machine.place(magnitudes), hp_mag, machine.place(index)
            assert machine.call("st_odd_brightness", *placed, len(index), 1.5).result == expected
            machine.release()


@pytest.mark.parametrize("certain", [1e-30, 1e-9])
def test_trials_are_judged_as_in_python(machine: ArmMachine, certain: float) -> None:
    """Trials of one image one after the other: what is kept of them, and how the search would go on."""
    tables = sky("wide").tables
    rng = np.random.default_rng(11)
    outcomes = set()
    for seed in range(8):
        scene = seen("wide", seed, stars=7, false=2, noise_px=0.35)
        spots = len(scene.spikes)
        parameters = replace(
            scene.parameters, certain_false_solutions=certain, most_false_solutions=1.0, field_normals=None
        )
        spread = verification.spread_kernel(scene.spikes.b_vectors, spots)
        kept = solutions.no_solutions(spots)
        spikes, stars = (
            binding.place_spikes(machine, scene.spikes),
            binding.place_star_table(machine, tables.catalogue),
        )
        limits = binding.place_limits(machine, parameters, tables.pairs)
        rows = [machine.reserve(4 * spots) for _ in range(2)]
        kept_in_c = layout_of(machine, "st_solution").pack_array(2, **EMPTY, star_index=rows)
        placed = place_struct(machine, "st_solutions", kept=kept_in_c)
        machine.call("st_no_solutions", placed, spots)
        for _ in range(12):
            trial = np.full(spots, -1, np.int32)
            chosen = rng.choice(np.flatnonzero(scene.true_rows >= 0), 3, replace=False)
            trial[chosen] = scene.true_rows[chosen]
            address = machine.place(trial)
            judged = solutions.judge_kernel(
                scene.spikes.b_vectors, scene.spikes.magnitudes, spread, star_arrays(tables.catalogue),
                solutions.limits_of(parameters, tables.pairs), trial, np.empty(4), kept,
                verification.first_counts(spots),
            )  # fmt: skip
            call = machine.call("st_judge", spikes, float(spread), stars, limits, address, placed)
            assert call.result == judged
            outcomes.add(int(judged))
            np.testing.assert_array_equal(machine.read(address, np.int32, spots), trial)
            for place in range(2):
                found = read_struct(machine, "st_solutions", placed)["kept"][place]
                np.testing.assert_allclose(found["q"], kept[1][place], atol=1e-11)
                numbers = [found[name] for name in ("matched", "expected", "seen", "rivals")]
                assert numbers == kept[2][place].tolist()
                assert found["chance"] == pytest.approx(kept[3][place], rel=1e-9)
                stars_kept = machine.read(rows[place], np.int32, spots)
                np.testing.assert_array_equal(stars_kept, kept[0][place])
        machine.release()
    assert solutions.NOTHING in outcomes


def test_a_rival(machine: ArmMachine) -> None:
    """A rival is another star for a spike, or a turn over the limit; less than that is the same solution."""
    q = np.array([0.0, 0.0, 0.0, 1.0])
    index = np.array([5, -1, 7, 9], np.int32)
    kept = place_struct(
        machine,
        "st_solution",
        q=q,
        chance=1e-8,
        matched=3,
        expected=0,
        seen=0,
        rivals=0,
        star_index=machine.place(index),
    )

    def rival(trial: list[int], turn_rad: float) -> int:
        turned = Rotation.from_rotvec([turn_rad, 0.0, 0.0]).as_quat()
        placed = machine.place(np.array(trial, np.int32)), 4, machine.place(turned)
        return machine.call("st_rival", kept, *placed, 1e-3).result

    assert rival([5, -1, 7, 9], 0.0) == 0
    assert rival([5, 3, -1, 9], 0.9e-3) == 0
    assert rival([5, -1, 7, 9], 1.1e-3) == 1
    assert rival([5, -1, 8, 9], 0.0) == 1


def test_a_dot_product_in_fixed_point_takes_a_tenth_of_the_time(machine: ArmMachine) -> None:
    """What Q30 would save where 3e-9 of precision suffices: soft double takes over ten times as long."""
    rng = np.random.default_rng(10)
    one, other = random_directions(rng, 100), random_directions(rng, 100)
    double = machine.place(one), machine.place(other)
    fixed = tuple(machine.place(np.rint(v * 2**30).astype(np.int32)) for v in (one, other))
    slow, fast = [], []
    for row in range(100):
        exact = machine.call("st_dot", double[0] + 24 * row, double[1] + 24 * row)
        short = machine.call("st_dot_q30", fixed[0] + 12 * row, fixed[1] + 12 * row)
        a, b = one[row], other[row]
        assert exact.result_pair == a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
        assert np.int32(np.uint32(short.result)) / 2**30 == pytest.approx(exact.result_pair, abs=3e-9)
        slow.append(exact.cost.core_cycles)
        fast.append(short.cost.core_cycles)
    assert 10 * np.median(fast) < np.median(slow)
