"""Detection in windows in C: the Python stage's outcomes, plain numpy, the truth, cycles from counts."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from hil_tests.firmware_model.synthetic_sky import ImageFrame
from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.image.background import window_statistics
from st_emulator.firmware_model.image.detection import DetectionParameters
from st_emulator.firmware_model.image.spots import Rejections, WindowSpots, WindowStatus
from st_emulator.firmware_model.image.windows import detect_in_windows, smoothed_runs
from st_emulator.firmware_model.work import COUNTS
from tools.arm_timing.machine import ArmMachine
from tools.calibration.steps import windows as binding
from tools.calibration.steps.detection import place_image, read_runs, read_statistics, spots_of_structs
from tools.calibration.steps.step import MismatchError
from tools.calibration.struct_layout import read_structs, reserve_structs

Image = NDArray[np.uint16]
ROWS, COLUMNS = 300, 400
PARAMETERS = DetectionParameters(
    zero_point_dn_per_s=4e6, exposure_s=0.1, magnitude_limit=6.0, saturation_dn=1023
)
SHARED_MACHINE = settings(
    deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
(WINDOWS,) = binding.STEPS


def placed_image(machine: ArmMachine, window: Image) -> int:
    return place_image(machine, machine.place(window), window.shape)


def statistics(machine: ArmMachine, window: Image) -> tuple[float, float]:
    out = reserve_structs(machine, "st_statistics")
    machine.call("st_window_statistics", placed_image(machine, window), out)
    found = read_statistics(machine, out)
    machine.release()
    return found


def sky(
    seed: int, stars: int = 40, noise_dn: float = 2.5, level_dn: float = 80.0, streak_px: float = 0.0
) -> tuple[Image, NDArray[np.float64]]:
    """An image of 10 bits with Gaussian stars, some of them saturated, and their (x, y, flux)."""
    rng = np.random.default_rng(seed)
    row, column = np.mgrid[0:ROWS, 0:COLUMNS]
    image = np.full((ROWS, COLUMNS), level_dn)
    table = np.column_stack(
        [
            rng.uniform(0, COLUMNS - 1, stars),
            rng.uniform(0, ROWS - 1, stars),
            10 ** rng.uniform(2, 4.2, stars),
        ]
    )
    for x, y, flux in table:
        for step in np.linspace(-0.5, 0.5, 1 + int(2 * streak_px)):
            square = (column - x - step * streak_px) ** 2 + (row - y) ** 2
            image += flux / (1 + int(2 * streak_px)) * np.exp(-square / (2 * 0.8**2)) / (2 * np.pi * 0.8**2)
    image += rng.normal(0.0, noise_dn, image.shape)
    return np.clip(np.rint(image), 0, 1023).astype(np.uint16), table


def rects_about(table: NDArray[np.float64], half_px: int, seed: int) -> NDArray[np.int32]:
    """Windows that have the stars anywhere in them, some clipped by the image's edge, one of them large."""
    rng = np.random.default_rng(seed)
    centre = np.rint(table[:, :2] + rng.uniform(-half_px, half_px, (len(table), 2))).astype(int)
    rects = np.column_stack([centre - half_px, centre + half_px + 1])
    rects = np.concatenate([rects, [[20, 30, 230, 190]]])
    rects = np.clip(rects, 0, [COLUMNS, ROWS, COLUMNS, ROWS])
    return rects[(rects[:, 2] > rects[:, 0] + 1) & (rects[:, 3] > rects[:, 1] + 1)].astype(np.int32)


def arguments_of(image: Image, rects: NDArray[np.int32], keep: int, **changes: Any) -> dict[str, Any]:
    flat, offsets = ImageFrame(image).windows(rects)
    return {
        "flat": flat,
        "offsets": offsets,
        "rects": rects,
        "parameters": replace(PARAMETERS, **changes),
        "width_px": COLUMNS,
        "height_px": ROWS,
        "keep": np.full(len(rects), keep, np.int32),
    }


def record_of(arguments: dict[str, Any]) -> StepRecord:
    found, work = detect_in_windows(**arguments)
    return StepRecord("windows", arguments, found, work)


@pytest.mark.parametrize("noise_dn", [0.0, 0.3, 1.0, 3.0, 15.0, 80.0])
def test_statistics_are_those_of_python(machine: ArmMachine, noise_dn: float) -> None:
    """Odd and even sizes, stars inside, values clipped at zero, levels over all of 12 bits."""
    rng = np.random.default_rng(int(10 * noise_dn))
    for _ in range(60):
        rows, columns = rng.integers(1, 45, 2)
        level = float(rng.choice([0, 2, 64, 300, 3000]))
        window = np.rint(level + noise_dn * rng.normal(size=(rows, columns)))
        for _ in range(rng.integers(3)):
            y, x = rng.integers(rows), rng.integers(columns)
            window[max(y - 2, 0) : y + 2, max(x - 2, 0) : x + 2] += rng.integers(2, rng.choice([9, 3000]))
        clipped = np.clip(window, 0, 4095).astype(np.uint16)
        background, noise, _ = window_statistics(clipped, np.empty(256))
        found = statistics(machine, clipped)
        assert found[0] == background  # to the last bit
        assert found[1] == pytest.approx(noise, rel=binding.NOISE_BOUND, abs=1e-9)


@pytest.mark.parametrize("least", [0, 1, 40])
@pytest.mark.parametrize("beyond", [126, 127, 128, 129, 255, 256])
def test_the_median_far_from_the_least_value(machine: ArmMachine, least: int, beyond: int) -> None:
    """Values are counted in parts of the range, those between two parts once: 502 +- 4 sigma is kept."""
    low = least + beyond
    window = np.array([[least, low, 500], [501, low, 502], [503, low, 504]], np.uint16)
    assert statistics(machine, window) == (502.0, pytest.approx(math.sqrt(2.0), rel=1e-9))


@SHARED_MACHINE
@given(arrays(np.uint16, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.integers(0, 65535)))
def test_statistics_of_any_small_window(machine: ArmMachine, window: Image) -> None:
    background, noise, _ = window_statistics(window, np.empty(256))
    assert statistics(machine, window) == (background, pytest.approx(noise, rel=1e-9, abs=1e-9))


def test_statistics_of_a_frame_of_12_bits(machine: ArmMachine) -> None:
    """The largest window that the sums are made for, half of it at either end of the range."""
    window = np.zeros((1024, 1024), np.uint16)
    window[512:] = 4095
    background, noise, _ = window_statistics(window, np.empty(256))
    assert (background, noise) == (2047.5, 2047.5)
    assert statistics(machine, window) == (2047.5, pytest.approx(2047.5, rel=1e-9))


def test_statistics_by_hand(machine: ArmMachine) -> None:
    """Median 100, deviations' median 1: sigma 1.4826, 94.07 to 105.93 are kept; then all but the star."""
    window = np.array([[99, 101, 100], [98, 103, 100], [100, 999, 101]], np.uint16)
    kept = window[window < 999]
    assert statistics(machine, window) == (kept.mean(), pytest.approx(kept.std(), rel=1e-9))


def runs_of(machine: ArmMachine, window: Image, limit: int, capacity: int) -> list[list[int]]:
    """Runs as rows (row, first, end), after a look at the starts of the rows."""
    rows = len(window)
    runs, starts = reserve_structs(machine, "st_run", capacity), machine.reserve(4 * (rows + 1))
    call = machine.call("st_smoothed_runs", placed_image(machine, window), limit, runs, capacity, starts)
    found = read_runs(machine, runs, call.result)
    begins = machine.read(starts, np.int32, rows + 1)
    machine.release()
    if call.result < capacity:
        assert begins.tolist() == np.searchsorted(found[:, 0], np.arange(rows + 1)).tolist()
    return [[int(value) for value in run] for run in found]


@SHARED_MACHINE
@given(
    arrays(np.uint16, st.tuples(st.integers(1, 12), st.integers(1, 12)), elements=st.integers(0, 60)),
    st.integers(0, 540),
)
def test_smoothed_runs_are_the_pixels_over_the_limit(machine: ArmMachine, window: Image, limit: int) -> None:
    """Against sums of shifted copies of the mirrored image."""
    wide = window.astype(int)
    for axis in (0, 1):
        mode = "reflect" if window.shape[axis] > 1 else "edge"
        padding = [(1, 1) if axis == side else (0, 0) for side in (0, 1)]
        wide = np.pad(wide, padding, mode=mode)
    rows, columns = window.shape
    total = sum(wide[i : i + rows, j : j + columns] for i in range(3) for j in range(3))
    over = np.zeros(window.shape, bool)
    found = runs_of(machine, window, limit, 200)
    for row, first, end in found:
        assert not over[row, max(first - 1, 0) : end + 1].any()  # runs of a row do not touch
        over[row, first:end] = True
    assert np.array_equal(over, total > limit)
    assert found == sorted(found)


def test_the_scan_stops_where_the_table_of_runs_is_full(machine: ArmMachine) -> None:
    window = np.zeros((12, 40), np.uint16)
    window[1::4, 1::5] = 500
    runs, starts = np.zeros((9, 3), np.int32), np.zeros(13, np.int32)
    count = smoothed_runs(window, 400, runs, starts, np.empty(40, np.int32))
    place, begins = reserve_structs(machine, "st_run", 9), machine.reserve(4 * 13)
    call = machine.call("st_smoothed_runs", placed_image(machine, window), 400, place, 9, begins)
    assert call.result == count == 9
    assert read_runs(machine, place, 9).tolist() == runs.tolist()
    assert machine.read(begins, np.int32, 13).tolist() == starts.tolist()


CASES: dict[str, dict[str, Any]] = {
    "at rest": {},
    "streaks": {"streak_px": 9.0},
    "noisy": {"noise_dn": 20.0},
    "clipped at zero": {"level_dn": 1.0, "noise_dn": 4.0},
    "many": {"stars": 300},
}


@pytest.mark.parametrize("centroid", ["com", "gaussian"])
@pytest.mark.parametrize("case", CASES)
def test_windows_give_the_spots_and_statuses_of_python(machine: ArmMachine, case: str, centroid: str) -> None:
    image, table = sky(len(case), **CASES[case])
    arguments = arguments_of(image, rects_about(table[:40], 9, 5), 3, centroid=centroid)
    runs = WINDOWS.run(machine, record_of(arguments))
    assert [run.stage for run in runs] == ["threshold", "clustering", "centroid"]
    for run in runs:
        assert {COUNTS[name].stage for name in run.work.counts} == {run.stage}


def test_every_status_occurs_and_is_the_same(machine: ArmMachine) -> None:
    seen: Counter[int] = Counter()
    for seed in range(4):
        image, table = sky(seed, streak_px=12.0 if seed % 2 else 0.0)
        arguments = arguments_of(image, rects_about(table, 6, seed), 2, min_pixels=6, magnitude_limit=4.6)
        record = record_of(arguments)
        WINDOWS.run(machine, record)
        seen.update(record.result.status.tolist())
    assert set(seen) == {int(status) for status in WindowStatus}


def test_true_stars_are_where_they_are(machine: ArmMachine) -> None:
    """No Python stage: bright stars at their true places, from the C kernels alone."""
    image, table = sky(11, stars=60)
    apart = [
        place
        for place, star in enumerate(table)
        if np.sort(np.hypot(*(table[:, :2] - star[:2]).T))[1] > 24 and 1e3 < star[2] < 3.5e3
    ]
    stars = table[apart]
    inside = (stars[:, :2] > 12).all(axis=1) & (stars[:, 0] < COLUMNS - 13) & (stars[:, 1] < ROWS - 13)
    stars = stars[inside]
    assert len(stars) >= 5
    centre = np.rint(stars[:, :2]).astype(np.int32)
    rects = np.column_stack([centre - 9, centre + 10]).astype(np.int32)
    found = binding.run_windows(machine, **arguments_of(image, rects, 1)).found
    assert found.window.tolist() == list(range(len(stars)))
    assert found.spots.x_px == pytest.approx(stars[:, 0], abs=0.05)
    assert found.spots.y_px == pytest.approx(stars[:, 1], abs=0.05)
    assert found.spots.flux_dn == pytest.approx(stars[:, 2], rel=0.05)


def test_windows_without_anything(machine: ArmMachine) -> None:
    image = np.full((ROWS, COLUMNS), 60, np.uint16)
    arguments = arguments_of(image, np.array([[5, 5, 20, 20], [30, 30, 61, 61]], np.int32), 1)
    (threshold,) = WINDOWS.run(machine, record_of(arguments))
    assert threshold.stage == "threshold"
    assert threshold.work["windows"] == 2
    assert binding.run_windows(machine, **arguments).found.status.tolist() == [0, 0]


def test_a_table_of_runs_that_overflows(machine: ArmMachine) -> None:
    image, table = sky(3, stars=200)
    arguments = arguments_of(image, rects_about(table[:5], 9, 1), 30, max_runs=40)
    record = record_of(arguments)
    assert record.result.spots.overflowed
    WINDOWS.run(machine, record)


def whole(machine: ArmMachine, arguments: dict[str, Any], expected_flux_dn: Any = None) -> WindowSpots:
    """``st_detect_in_windows`` in one call."""
    rects, keep, parameters = arguments["rects"], arguments["keep"], arguments["parameters"]
    windows = len(rects)
    pixels, starts = binding.padded(arguments["flat"], arguments["offsets"])
    limits, room_bytes = binding.place_window_parameters(machine, parameters, COLUMNS, ROWS)
    most = int(keep.sum())
    spots, window_of = reserve_structs(machine, "st_spot", most), machine.reserve(4 * most)
    status, levels = machine.reserve(windows), reserve_structs(machine, "st_statistics", windows)
    overflowed, medians = machine.reserve(4), reserve_structs(machine, "st_statistics")
    call = machine.call(
        "st_detect_in_windows",
        machine.place(pixels),
        machine.place(starts),
        binding.place_rects(machine, rects),
        windows,
        machine.place(keep),
        0 if expected_flux_dn is None else machine.place(np.asarray(expected_flux_dn, np.float64)),
        limits,
        binding.place_window_room(machine, parameters.max_runs, ROWS, room_bytes),
        spots,
        window_of,
        status,
        levels,
        overflowed,
    )
    machine.call("st_median_statistics", levels, windows, machine.reserve(8 * windows), medians)
    level, noise = read_statistics(machine, medians)
    of_windows = read_structs(machine, "st_statistics", levels, windows)
    found = WindowSpots(
        spots_of_structs(
            read_structs(machine, "st_spot", spots, call.result),
            Rejections(),
            level,
            noise,
            bool(machine.read(overflowed, np.int32, 1)[0]),
        ),
        machine.read(window_of, np.int32, call.result),
        machine.read(status, np.uint8, windows),
        of_windows["background_dn"],
        of_windows["noise_dn"],
    )
    machine.release()
    return found


def without_rejections(found: WindowSpots) -> WindowSpots:
    return replace(found, spots=replace(found.spots, rejected=Rejections()))


def test_all_windows_in_one_call_give_what_they_give_one_by_one(machine: ArmMachine) -> None:
    image, table = sky(7)
    arguments = arguments_of(image, rects_about(table, 8, 3), 2)
    assert len(arguments["rects"]) % 2  # the median of an odd number, and below of an even one
    binding.compare(whole(machine, arguments), without_rejections(detect_in_windows(**arguments)[0]))
    even = arguments_of(image, arguments["rects"][1:], 2)
    binding.compare(whole(machine, even), without_rejections(detect_in_windows(**even)[0]))


def test_the_spot_of_the_expected_brightness_is_taken(machine: ArmMachine) -> None:
    """In windows with several spots; where nothing is expected (nan) the brightest."""
    image, table = sky(9, stars=150)
    rects = rects_about(table[:30], 20, 2)
    arguments = arguments_of(image, rects, 1)
    rng = np.random.default_rng(4)
    expected = np.where(rng.uniform(size=len(rects)) < 0.3, np.nan, 10 ** rng.uniform(2, 4, len(rects)))
    python, _ = detect_in_windows(**arguments, expected_flux_dn=expected)
    brightest, _ = detect_in_windows(**arguments)
    assert np.count_nonzero(python.spots.flux_dn != brightest.spots.flux_dn) >= 3
    binding.compare(whole(machine, arguments, expected), without_rejections(python))
    # where more than one may be given, brightness alone counts
    two = arguments | {"keep": np.full(len(rects), 2, np.int32)}
    python, _ = detect_in_windows(**two, expected_flux_dn=expected)
    binding.compare(whole(machine, two, expected), without_rejections(python))


@pytest.mark.parametrize("expected", [None, [500.0]])
def test_of_spots_as_bright_as_each_other_the_upper_one_is_taken(
    machine: ArmMachine, expected: list[float] | None
) -> None:
    image = np.full((ROWS, COLUMNS), 60, np.uint16)
    for x, y in ((50, 40), (45, 55), (60, 70)):
        image[y - 1 : y + 2, x - 1 : x + 2] += np.outer([1, 3, 1], [90, 270, 90]).astype(np.uint16)
    arguments = arguments_of(image, np.array([[30, 30, 81, 81]], np.int32), 1)
    found = whole(machine, arguments, expected)
    assert (found.spots.x_px.tolist(), found.spots.y_px.tolist()) == ([50.0], [40.0])
    binding.compare(found, without_rejections(detect_in_windows(**arguments, expected_flux_dn=expected)[0]))


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("x_px", 0.002),
        ("y_px", -0.002),
        ("flux_dn", 5.0),
        ("pixels", 1),
        ("noise_dn", 1e-6),
        ("background_dn", 1e-9),
    ],
)
def test_another_outcome_is_refused(machine: ArmMachine, field: str, change: float) -> None:
    image, table = sky(7)
    record = record_of(arguments_of(image, rects_about(table[:6], 8, 3), 2))
    spots = record.result.spots
    spoiled = replace(spots, **{field: getattr(spots, field) + change})
    with pytest.raises(MismatchError, match=field):
        WINDOWS.run(machine, replace(record, result=replace(record.result, spots=spoiled)))
    status = record.result.status.copy()
    status[0] = (status[0] + 1) % len(WindowStatus)
    with pytest.raises(MismatchError, match="status"):
        WINDOWS.run(machine, replace(record, result=replace(record.result, status=status)))


def test_the_threshold_costs_what_its_counts_say(machine: ArmMachine) -> None:
    """Windows of 15 to 91 px a side fix the cycles of a sample, of a pixel in a pass, of a smoothed one."""
    image, table = sky(2)
    counts = ("windows", "window_samples", "window_noise_pixels", "window_pixels")
    rows, cycles = [], []
    for half in (7, 9, 12, 16, 21, 27, 35, 45):
        for seed in range(2):
            rects = rects_about(table[: 3 + 2 * seed], half, seed)[:-1]
            threshold = WINDOWS.run(machine, record_of(arguments_of(image, rects, 2)))[0]
            rows.append([threshold.work[name] for name in counts])
            cycles.append(threshold.cost.core_cycles)
    right = np.array(cycles, float)
    found = np.linalg.lstsq(np.array(rows) / right[:, None], np.ones(len(right)), rcond=None)[0]
    assert np.abs(np.array(rows) @ found / right - 1.0).max() < 0.03
    assert 8 <= found[2] <= 16
    assert 15 <= found[3] <= 30
