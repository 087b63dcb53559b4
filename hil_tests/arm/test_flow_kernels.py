"""Optical flow in C: lit pixels, stars and shifts to the bit, plain numpy beside, cycles from counts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from hil_tests.arm.flow_scenes import FloatArray, Image, picture, star_field
from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.image.lit_pixels import DN_PARTS, FlowFrame, FlowParameters, light_up
from st_emulator.firmware_model.image.optical_flow import flow_between
from st_emulator.firmware_model.work import COUNTS
from tools.arm_timing.machine import ArmMachine
from tools.calibration.steps import lit_pixels, optical_flow
from tools.calibration.steps.step import MismatchError, StageRun

(LIGHT,) = lit_pixels.STEPS
(FLOW,) = optical_flow.STEPS
ROWS, COLUMNS = 200, 256
PARAMETERS = FlowParameters(largest_shift_px=20, max_runs=4000)
SHARED_MACHINE = settings(
    deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def lit(machine: ArmMachine, image: Image, **changes: Any) -> FlowFrame:
    """A frame that the kernels lit up, held to the Python stage's on the way."""
    parameters = replace(PARAMETERS, **changes)
    found, _ = lit_pixels.run_light_up(machine, image, parameters)
    machine.release()
    lit_pixels.require_equal_frames(found, light_up(image, parameters)[0])
    return found


def dense(frame: FlowFrame) -> NDArray[np.int64]:
    """The lit pixels' values in their places, else 0."""
    found = np.zeros((frame.height_px, frame.width_px), np.int64)
    for (row, first, end), place in zip(frame.runs, frame.offsets, strict=True):
        found[row, first:end] = frame.values[place : place + end - first]
    return found


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
@pytest.mark.parametrize(("rows", "columns"), [(200, 256), (120, 161), (77, 130), (40, 31), (9, 7)])
def test_lit_pixels_are_those_over_mean_and_three_sigma(
    machine: ArmMachine, rows: int, columns: int, bits: int
) -> None:
    """Widths that are no whole blocks, rows that begin within a word, pixels wider than half a sum."""
    image = picture(star_field(rows, 15, rows, columns), rows, columns, bits, bits=bits)
    found = lit(machine, image)
    mean, sigma = image.mean(), image.std()
    assert found.mean_dn == pytest.approx(mean, rel=1e-12)
    assert found.sigma_dn == pytest.approx(sigma, rel=1e-6)
    values = dense(found)
    assert np.array_equal(values > 0, image > mean + 3.0 * sigma)
    level = np.floor(mean * DN_PARTS)
    assert np.array_equal(values[values > 0], DN_PARTS * image[values > 0].astype(np.int64) - level)


@SHARED_MACHINE
@given(
    arrays(np.uint16, st.tuples(st.integers(1, 6), st.integers(1, 70)), elements=st.integers(0, 65535)),
    st.floats(0.05, 3.0),
)
def test_any_small_image(machine: ArmMachine, image: Image, sigma_factor: float) -> None:
    lit(machine, image, sigma_factor=sigma_factor, min_pixels=1)


@pytest.mark.parametrize("value", [0, 700, 65535])
def test_an_image_without_anything(machine: ArmMachine, value: int) -> None:
    found = lit(machine, np.full((50, 64), value, np.uint16))
    assert (len(found.runs), len(found), found.mean_dn, found.sigma_dn) == (0, 0, value, 0.0)


def test_runs_across_the_blocks_of_a_row(machine: ArmMachine) -> None:
    image = np.full((40, 160), 20, np.uint16)
    image[10, 30:67] = 900
    image[20, 32:64] = 900
    image[30, 127:129] = 900
    image[31, 159] = 900
    assert lit(machine, image).runs.tolist() == [[10, 30, 67], [20, 32, 64], [30, 127, 129], [31, 159, 160]]


def test_a_full_table_of_runs(machine: ArmMachine) -> None:
    image = picture(star_field(4, 60, ROWS, COLUMNS), ROWS, COLUMNS, 1)
    whole = lit(machine, image)
    found = lit(machine, image, max_runs=50)
    assert found.overflowed
    assert (len(found.runs), len(found)) == (50, 0)
    assert np.array_equal(found.runs, whole.runs[:50])
    assert not lit(machine, image, max_runs=len(whole.runs)).overflowed


def test_the_brightest_stars_are_kept_and_those_of_odd_sizes_are_not(machine: ArmMachine) -> None:
    image = picture(star_field(5, 80, ROWS, COLUMNS), ROWS, COLUMNS, 2)
    every = lit(machine, image)
    assert np.all(np.diff(every.flux_dn) <= 0.0)
    some = lit(machine, image, max_stars=7)
    assert np.array_equal(some.flux_dn, every.flux_dn[:7])
    assert np.all(lit(machine, image, min_pixels=9).pixels >= 9)
    assert len(lit(machine, image, max_pixels=8)) < len(every)
    assert len(lit(machine, image, max_extent_px=3)) < len(every)


def test_of_stars_as_bright_as_each_other_the_upper_one_is_first(machine: ArmMachine) -> None:
    image = np.full((60, 90), 30, np.uint16)
    for x, y in ((70, 10), (20, 30), (40, 30), (60, 50)):
        image[y - 1 : y + 2, x - 1 : x + 2] = 500
    found = lit(machine, image)
    assert list(zip(found.x_px, found.y_px, strict=True)) == [(70, 10), (20, 30), (40, 30), (60, 50)]


def pair(seed: int, shift: tuple[float, float], **changes: Any) -> tuple[FlowFrame, FlowFrame]:
    table = star_field(seed, 30, ROWS, COLUMNS)
    return (
        light_up(picture(table, ROWS, COLUMNS, seed, **changes), PARAMETERS)[0],
        light_up(picture(table, ROWS, COLUMNS, seed + 100, shift, **changes), PARAMETERS)[0],
    )


def flow_record(
    before: FlowFrame, after: FlowFrame, foreseen: FloatArray | None = None, **changes: Any
) -> StepRecord:
    arguments = {
        "before": before,
        "after": after,
        "parameters": replace(PARAMETERS, **changes),
        "foreseen_px": foreseen,
    }
    return StepRecord("flow", arguments, *flow_between(**arguments))


SHIFTS: list[tuple[float, float]] = [(0.0, 0.0), (3.3, -1.6), (-17.2, 12.4), (19.6, 0.2), (0.4, -30.0)]


@pytest.mark.parametrize("streak", [(0.0, 0.0), (9.0, 0.0), (0.0, 9.0), (8.0, -7.0)])
@pytest.mark.parametrize("shift", SHIFTS)
def test_stars_are_found_where_python_finds_them(
    machine: ArmMachine, shift: tuple[float, float], streak: tuple[float, float]
) -> None:
    before, after = pair(3, shift, streak=streak)
    record = flow_record(before, after)
    (run,) = FLOW.run(machine, record)
    assert (run.stage, run.work["stars_followed"]) == ("tracking", len(before))
    if max(map(abs, shift)) <= PARAMETERS.largest_shift_px:
        found = record.result
        moved = np.array([found.x_px - found.x_before_px, found.y_px - found.y_before_px])
        assert len(found) >= 5
        assert np.median(moved, axis=1) == pytest.approx(shift, abs=0.3)


@pytest.mark.parametrize("margin", [1, 4, 8])
def test_a_foreseen_shift(machine: ArmMachine, margin: int) -> None:
    """Off by up to one pixel and a half, and beyond the edges."""
    before, after = pair(6, (-17.2, 31.4))
    rng = np.random.default_rng(margin)
    foreseen = np.array([-17.2, 31.4]) + rng.uniform(-1.5, 1.5, (len(before), 2))
    foreseen[0] = (1000.0, -1000.0)
    record = flow_record(before, after, foreseen, prediction_margin_px=margin)
    FLOW.run(machine, record)
    assert 0 not in record.result.star
    assert len(record.result) >= 3


@pytest.mark.parametrize("shift", [(3.3, -1.6), (-11.0, 6.0)])
def test_coarse_shifts_are_the_least_sums_of_squared_differences(
    machine: ArmMachine, shift: tuple[float, float]
) -> None:
    """Every shift of every star by whole images, in plain numpy: neither Python's kernel nor the C one."""
    before, after = pair(9, shift, streak=(4.0, 3.0))
    reach = PARAMETERS.largest_shift_px
    first, second = dense(before), np.pad(dense(after), reach)
    found, _ = optical_flow.run_flow(machine, before, after, PARAMETERS)
    mismatch = dict(zip(found.star.tolist(), found.mismatch.tolist(), strict=True))
    assert len(mismatch) >= 5
    for star, (x0, x1, y0, y1) in enumerate(before.box):
        own = first[y0 : y1 + 1, x0 : x1 + 1]
        least = np.inf
        for dy in range(2 * reach + 1):
            for dx in range(2 * reach + 1):
                there = second[y0 + dy : y1 + 1 + dy, x0 + dx : x1 + 1 + dx]
                if (own * there).any():
                    least = min(least, int(((own - there) ** 2).sum()))
        energy = int((own**2).sum())
        if star in mismatch:
            assert mismatch[star] == least / energy
        else:  # nothing there, or too near the edge
            near = min(x0, y0, COLUMNS - 1 - x1, ROWS - 1 - y1) <= reach + PARAMETERS.margin_px
            assert least >= energy or near


def test_an_equal_shift_that_is_nearer_to_the_foreseen_one_wins(machine: ArmMachine) -> None:
    """Two pictures of one star, alike to the bit."""
    first, second = (np.full((80, 120), 30, np.uint16) for _ in range(2))
    star = np.outer([1, 3, 1], [1, 3, 1]).astype(np.uint16) * 40
    first[39:42, 59:62] += star
    for x in (52, 66):
        second[39:42, x - 1 : x + 2] += star
    before, after = (light_up(image, PARAMETERS)[0] for image in (first, second))
    for foreseen, expected in ((5.6, 66.0), (-5.4, 52.0)):
        record = flow_record(before, after, np.array([[foreseen, 0.0]]), prediction_margin_px=15)
        FLOW.run(machine, record)
        assert record.result.x_px.tolist() == [expected]


def test_frames_without_stars(machine: ArmMachine) -> None:
    empty = light_up(np.full((ROWS, COLUMNS), 30, np.uint16), PARAMETERS)[0]
    before, _ = pair(3, (0.0, 0.0))
    for one, other in ((empty, before), (before, empty), (empty, empty)):
        record = flow_record(one, other)
        FLOW.run(machine, record)
        assert len(record.result) == 0


@pytest.mark.parametrize("field", ["star", "x_px", "y_px", "mismatch", "length_px", "noise"])
def test_another_flow_is_refused(machine: ArmMachine, field: str) -> None:
    record = flow_record(*pair(3, (3.3, -1.6)))
    values = getattr(record.result, field).copy()
    values[0] = np.nextafter(values[0], 9.0) if values.dtype == np.float64 else values[0] + 1
    with pytest.raises(MismatchError, match=field):
        FLOW.run(machine, replace(record, result=replace(record.result, **{field: values})))


@pytest.mark.parametrize("field", ["runs", "row_start", "offsets", "values", "x_px", "box", "sigma_dn"])
def test_another_frame_is_refused(machine: ArmMachine, field: str) -> None:
    image = picture(star_field(5, 30, ROWS, COLUMNS), ROWS, COLUMNS, 2)
    frame, work = light_up(image, PARAMETERS)
    spoiled = replace(frame, **{field: getattr(frame, field) + 1})
    record = StepRecord("flow_light", {"image": image, "parameters": PARAMETERS}, spoiled, work)
    with pytest.raises(MismatchError, match=field):
        LIGHT.run(machine, record)


def worst_error(runs: list[StageRun]) -> float:
    """Of the best non-negative coefficients of the runs' counts, as a share of the runs' core cycles."""
    from scipy.optimize import nnls

    names = sorted({name for run in runs for name in run.work.counts})
    cycles = np.array([run.cost.core_cycles for run in runs], float)
    rows = np.array([[run.work[name] for name in names] for run in runs]) / cycles[:, None]
    found, _ = nnls(rows / np.linalg.norm(rows, axis=0), np.ones(len(runs)))
    return float(np.abs(rows / np.linalg.norm(rows, axis=0) @ found - 1.0).max())


def test_lighting_up_costs_what_its_counts_say(machine: ArmMachine) -> None:
    """Rows as long as a sensor's: what a row takes by itself is not counted."""
    runs = []
    for seed, (rows, columns) in enumerate([(64, 1280), (200, 640), (100, 1024), (160, 960)] * 2):
        image = picture(star_field(seed, 5 + 6 * seed, rows, columns), rows, columns, seed)
        arguments = {"image": image, "parameters": PARAMETERS}
        light = LIGHT.run(machine, StepRecord("flow_light", arguments, *light_up(**arguments)))
        assert [run.stage for run in light] == ["threshold", "clustering", "centroid"]
        for run in light:
            assert {COUNTS[name].stage for name in run.work.counts} == {run.stage}
        runs.append(light[0])
    assert worst_error(runs) < 0.03


def test_following_costs_what_its_counts_say(machine: ArmMachine) -> None:
    runs = []
    for seed in range(24):
        streak = (0.7 * (seed % 12), 0.5 * (seed % 7))
        before, after = pair(seed, (3.0, -2.0), streak=streak)
        foreseen = np.tile([2.8, -2.3], (len(before), 1)) if seed % 3 else None
        runs += FLOW.run(machine, flow_record(before, after, foreseen, largest_shift_px=10 + 2 * (seed % 6)))
    assert worst_error(runs) < 0.10
