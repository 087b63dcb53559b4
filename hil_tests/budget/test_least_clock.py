"""The clock at which frames fit: closed forms, memory that no clock helps, and the firmware run there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hil_tests.budget.conftest import counts, hand_made
from st_emulator.budget.figures import Costing, p99
from st_emulator.budget.least_clock import (
    HIGHEST_HZ,
    LOWEST_HZ,
    Laws,
    clock_as_flown,
    clock_for_frames,
    least_clock_hz,
)
from st_emulator.budget.samples import Look, Lost, look
from st_emulator.budget.scenes import random_conditions
from st_emulator.budget.subject import Subject, subject_of
from st_emulator.units.profile import UnitProfile


@given(st.integers(10**4, 10**6), st.floats(1.0, 500.0), st.floats(0.0, 2.0))
def test_core_and_memory_apart(number, core, fills):
    # time = number (core / f + fills 100 ns); on time at f = number core / (budget - memory)
    processor = hand_made(core=core, fills=fills, fill_ns=(100.0, 100.0, 100.0))
    memory_s = number * fills * 100e-9
    budget_s = 0.25
    found = clock_for_frames(Laws(processor), [counts(runs=number)], budget_s).nominal_hz
    left_s = budget_s - memory_s
    # costings are of whole cycles: off by two of the core, and by two cycles' time of the memory
    assume(abs(left_s - number * core / HIGHEST_HZ) > 1e-6)
    if left_s < number * core / HIGHEST_HZ:
        assert found is None
        return
    wanted = max(LOWEST_HZ, number * core / left_s)
    assert found == pytest.approx(wanted, rel=2e-5 + 2 / (number * core) + 2e-8 / left_s)


def test_bounds_of_the_clock():
    processor = hand_made(core=100.0, fills=1.0, core_uncertainty=0.2, fill_ns=(50.0, 100.0, 200.0))
    found = clock_for_frames(Laws(processor), [counts(runs=100_000)], 0.1)
    assert found.nominal_hz == pytest.approx(1e7 / (0.1 - 0.01), rel=1e-4)
    assert found.low_hz == pytest.approx(0.8e7 / (0.1 - 0.005), rel=1e-4)
    assert found.high_hz == pytest.approx(1.2e7 / (0.1 - 0.02), rel=1e-4)
    assert found.text() == "111 (84..150) MHz"


def test_the_worst_frame_or_the_99th_percentile_decides():
    laws = Laws(hand_made(core=100.0))
    frames = [counts(runs=1000)] * 99 + [counts(runs=50_000)]
    assert clock_for_frames(laws, frames, 0.1, np.max).nominal_hz == pytest.approx(5e7, rel=1e-4)
    assert clock_for_frames(laws, frames, 0.1, p99).nominal_hz == pytest.approx(1e6, rel=1e-4)


def test_memory_alone_may_take_too_long():
    laws = Laws(hand_made(core=1.0, fills=1.0, fill_ns=(100.0, 100.0, 300.0)))
    found = clock_for_frames(laws, [counts(runs=1_000_000)], 0.25)
    assert found.nominal_hz is not None
    assert found.high_hz is None
    assert found.figure_mhz is None
    assert "high cost: none at any clock" in found.text()


def test_the_clock_is_that_above_which_all_is_well():
    """A search that is cut short may make a frame fit at a low clock which does not at a higher one."""
    islands = [(3e7, 4e7), (9e7, HIGHEST_HZ)]
    found = least_clock_hz(lambda hz: any(low <= hz <= high for low, high in islands))
    assert found == pytest.approx(9e7, rel=1e-4)
    assert least_clock_hz(lambda hz: False) is None
    assert least_clock_hz(lambda hz: True) == LOWEST_HZ
    near_the_end = least_clock_hz(lambda hz: hz >= 1.003 * LOWEST_HZ)
    assert near_the_end == pytest.approx(1.003 * LOWEST_HZ, rel=1e-4)


def lost_with(before: int, search: int, after: int) -> Lost:
    whole = counts(runs=before, votes=search, crc_bytes=after)
    return Lost(whole, 0, whole, 0, whole, 0, counts(runs=before), counts(votes=search), 10, 5)


def test_as_flown_the_search_is_cut_to_what_is_left():
    # 100 cycles a count; a budget of 0.1 s
    laws = Laws(hand_made(core=100.0, core_uncertainty=0.5))
    # A search without end: cut at 0.9 of the budget while what is before it takes less than 0.4 of it, else
    # given half: late once what is before takes more than half.
    endless = clock_as_flown(laws, [lost_with(1000, 10**9, 0)], 0.1)
    assert endless.nominal_hz == pytest.approx(1000 * 100 / (0.5 * 0.1), rel=1e-4)
    # at the high cost 0.9 of the budget takes 1.35 of it: only a clock where the search ends helps
    assert endless.high_hz is None or endless.high_hz > 1e10
    # A search that ends: late where its end comes within the limit but what follows does not.
    short = clock_as_flown(laws, [lost_with(1000, 1000, 1000)], 0.1)
    assert short.nominal_hz == pytest.approx(3 * 1000 * 100 / 0.1, rel=1e-4)


@pytest.fixture(scope="module")
def crowded(roja1: UnitProfile) -> tuple[Subject, Look]:
    """A sky whose search takes long: roja1 among 100 false stars."""
    unit = subject_of(roja1)
    heaviest = max(
        random_conditions(4, 3, false_stars=100),
        key=lambda item: look(roja1, None, Look(item)).lost.search_counts.sum(),
    )
    return unit, Look(heaviest)


@pytest.mark.parametrize("which", ["whole", "flown"])
def test_the_firmware_is_on_time_at_that_clock_and_late_below(roja1, crowded, which):
    """What was worked out from one run's counts, against runs at clocks above and below it."""
    unit, case = crowded
    laws = Laws(unit.processor)
    lost = look(roja1, None, case).lost
    budget_s = unit.budget_ns(True) * 1e-9
    if which == "whole":
        found = clock_for_frames(laws, [lost.whole_counts], budget_s).nominal_hz
    else:
        found = clock_as_flown(laws, [lost], budget_s).nominal_hz
    assert found is not None

    def processing_s(clock_hz: float) -> float:
        at = unit.with_parameters(clock_hz=round(clock_hz))
        sample = look(roja1, None, replace(case, changed=at.changed)).lost
        counted = sample.whole_counts if which == "whole" else sample.counts
        return Costing(at.processor).cost(counted).frame.value / at.processor.clock_hz

    # as flown the limit is passed by the search's last step, which no formula knows
    above = 1.001 if which == "whole" else 1.03
    assert processing_s(above * found) <= budget_s
    assert processing_s(0.97 * found) > budget_s
