"""Frames against their time, and what late ones cost: beside a frame grid played through here."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_tests.budget.conftest import counts, hand_made
from st_emulator.budget.figures import Costing
from st_emulator.budget.margins import margin_of
from st_emulator.budget.subject import Subject, subject_of
from st_emulator.errors import ConfigurationError
from st_emulator.units.profile import load_unit

MS = 1_000_000
ROJA1 = Subject(load_unit("roja1"))  # 250 ms, 100 ms exposure, 16.7 ms read-out


def played(processing_ns: int, pipelined: bool, unit: Subject) -> int:
    """Frames that find the processor busy after one that takes so long, event by event."""
    free_at = unit.exposure_ns + unit.readout_ns + processing_ns
    dropped = 0
    start = unit.period_ns
    while True:
        looked_at = start + (unit.exposure_ns + unit.readout_ns if pipelined else 0)
        if free_at <= looked_at:
            return dropped
        dropped += 1
        start += unit.period_ns


@given(st.integers(0, 3000 * MS), st.booleans())
def test_frames_dropped(processing_ns, pipelined):
    assert ROJA1.frames_dropped(processing_ns, pipelined) == played(processing_ns, pipelined, ROJA1)
    late = processing_ns > ROJA1.budget_ns(pipelined)
    assert late == (played(processing_ns, pipelined, ROJA1) > 0)


@pytest.mark.parametrize("pipelined", [False, True])
def test_a_frame_that_takes_its_whole_time_is_not_late(pipelined):
    budget_ns = ROJA1.budget_ns(pipelined)
    assert ROJA1.frames_dropped(budget_ns, pipelined) == 0
    assert ROJA1.frames_dropped(budget_ns + 1, pipelined) == 1


def test_time_that_is_left():
    assert ROJA1.budget_ns(True) == 250 * MS
    assert ROJA1.budget_ns(False) == (250 - 100) * MS - 16_700_000
    aps_rs = Subject(load_unit("aps_rs"))
    assert (aps_rs.budget_ns(True), aps_rs.budget_ns(False)) == (200 * MS, 0)
    faster = ROJA1.with_parameters(exposure_us=50_000)
    assert faster.budget_ns(False) == 250 * MS - 50 * MS - 16_700_000


def test_the_firmwares_own_budget_is_the_same_time():
    for name in ("roja1", "zy3", "aps_rs"):
        unit = Subject(load_unit(name))
        for pipelined in (False, True):
            budget = unit.cycle_budget(pipelined)
            assert budget.cycles == unit.budget_ns(pipelined) * unit.processor.clock_hz // 10**9


def test_margin_of_frames_some_of_which_are_late():
    # 100 MHz: 25 million cycles are 250 ms
    costing = Costing(hand_made(core=1000.0, core_uncertainty=0.1))
    costs = [costing.cost(counts(runs=number)) for number in (1000, 20_000, 24_000, 26_000, 80_000)]
    margin = margin_of(ROJA1, costing, costs, True)
    assert margin.budget_ms == 250
    assert margin.time_ms.median.value == 240
    assert margin.left_ms(margin.time_ms.worst).value == -550
    assert margin.left_ms(margin.time_ms.worst).low == 250 - 880
    assert (margin.late.late.low, margin.late.late.value, margin.late.late.high) == (1, 2, 3)
    # 800 ms: frames 1 to 3 find it busy; 260 ms: frame 1; at the bounds 880, 286, 264 and 720 (234) ms
    assert margin.late.dropped.value == 3 + 1
    assert margin.late.dropped.high == 3 + 1 + 1
    assert margin.late.dropped.low == 2
    assert not margin.fits
    good = margin_of(ROJA1, costing, costs[:3], True)
    assert good.fits
    assert not good.fits_at_bound  # 264 ms
    assert margin_of(ROJA1, costing, costs[:2], True).fits_at_bound


def test_a_frame_of_exactly_its_time_is_counted_as_on_time():
    costing = Costing(hand_made(core=1000.0))
    margin = margin_of(ROJA1, costing, [costing.cost(counts(runs=25_000))], True)
    assert margin.late.late.value == 0
    assert margin.fits
    margin = margin_of(ROJA1, costing, [costing.cost(counts(runs=25_001))], True)
    assert margin.late.late.value == margin.late.dropped.value == 1


def test_where_no_time_is_left_nothing_fits():
    aps_rs = Subject(load_unit("aps_rs"))
    costing = Costing(hand_made())
    margin = margin_of(aps_rs, costing, [costing.cost(counts(runs=1))], False)
    assert margin.budget_ms == 0
    assert not margin.fits
    assert margin.late.late.value == 1


def test_options_of_the_processor():
    unit = subject_of(load_unit("zy3"), clock_hz=50_000_000, cache_kib=16, line_fill="high")
    assert (unit.processor.clock_hz, unit.processor.cache_kib, unit.processor.line_fill) == (
        50_000_000,
        16,
        "high",
    )
    assert unit.cycle_budget(True).cycles == 12_500_000
    assert unit.parameters["clock_hz"] == 50_000_000


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        ("clock_hz", 10, "--clock"),
        ("cache_kib", 5, "--cache 5"),
        ("line_fill", "middling", "low, nominal, high"),
    ],
)
def test_options_that_no_processor_has(option, value, says):
    with pytest.raises(ConfigurationError, match=says):
        subject_of(load_unit("zy3"), **{option: value})
