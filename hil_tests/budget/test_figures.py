"""Cycles of hand-made work with their bounds, against sums done here."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_tests.budget.conftest import counts, hand_made
from st_emulator.budget.figures import FRAME, Cost, Costing, Figure, by_row, distribution
from st_emulator.budget.samples import counts_of, work_of
from st_emulator.firmware_model.work import COUNTS, STAGES, Work


def test_cost_of_work_by_stage_with_bounds():
    # 3 cycles a count and half a fill of 10/20/40 ns at 100 MHz: 0.5, 1 and 2 cycles
    processor = hand_made(
        core=3.0, fills=0.5, core_uncertainty=0.1, fill_ns=(10.0, 20.0, 40.0), special={"runs": 50.0}
    )
    cost = Costing(processor).cost(counts(runs=1000, clusters=10, crc_bytes=200))
    clustering = cost.by_row["clustering"]
    assert clustering.value == 1000 * 50 + 10 * 3 + 1010 * 0.5 * 2
    assert clustering.low == round(0.9 * (1000 * 50 + 10 * 3) + 1010 * 0.5 * 1)
    assert clustering.high == round(1.1 * (1000 * 50 + 10 * 3) + 1010 * 0.5 * 4)
    assert cost.by_row["telemetry"].value == 200 * 3 + 200 * 0.5 * 2
    assert cost.frame.value == clustering.value + cost.by_row["telemetry"].value
    assert cost.frame.high == clustering.high + cost.by_row["telemetry"].high
    assert {row for row, figure in cost.by_row.items() if figure.value} == {"clustering", "telemetry", FRAME}


def test_at_the_high_line_fill_the_figure_lies_on_its_bound():
    processor = hand_made(core=0.0, fills=1.0, fill_ns=(10.0, 20.0, 40.0)).with_line_fill("high")
    figure = Costing(processor).cost(counts(runs=1000)).frame
    assert (figure.low, figure.value, figure.high) == (1000, 4000, 4000)


def test_counts_and_work_are_the_same():
    work = Work({"runs": 3, "frames": 1, "votes": 10**12})
    assert work_of(counts_of(work)) == work
    assert counts_of(work).sum() == 10**12 + 4


@given(st.lists(st.tuples(*(st.floats(0, 1e9) for _ in range(3))), min_size=1, max_size=250))
def test_distribution_of_frames(values):
    figures = [Figure(middle, low, high) for low, middle, high in map(sorted, values)]
    found = distribution(figures)
    for which in ("low", "value", "high"):
        ordered = sorted(getattr(item, which) for item in figures)
        n = len(ordered)
        middle = (ordered[(n - 1) // 2] + ordered[n // 2]) / 2
        assert getattr(found.median, which) == pytest.approx(middle)
        # the least that at least 99 in 100 do not exceed
        at = next(value for value in ordered if 100 * sum(item <= value for item in ordered) >= 99 * n)
        assert getattr(found.p99, which) == at
        assert getattr(found.worst, which) == ordered[-1]


def test_rows_are_the_stages_and_their_sum():
    costing = Costing(hand_made())
    rows = by_row([costing.cost(counts(runs=number, votes=2 * number)) for number in (1, 2, 3)])
    assert list(rows) == [*STAGES, FRAME]
    assert rows["clustering"].median.value == 2
    assert rows["identification"].worst.value == 6
    assert rows[FRAME].worst.value == 9


@pytest.mark.parametrize(
    ("figure", "text"),
    [
        (Figure(1.234, 1.0, 2.0), "1.23 (1.00..2.00)"),
        (Figure(22.06, 19.84, 27.31), "22.1 (19.8..27.3)"),
        (Figure(-12.0, -140.0, 3.0), "-12 (-140..3)"),
        (Figure(0.0, 0.0, 0.0), "0.00 (0.00..0.00)"),
    ],
)
def test_a_figure_is_printed_with_its_bounds(figure, text):
    assert figure.text() == text


def test_a_figure_outside_its_bounds_is_none():
    with pytest.raises(ValueError, match="between"):
        Figure(1.0, 2.0, 3.0)
    with pytest.raises(ValueError, match="no frames"):
        distribution([])


@given(st.floats(-1e6, 1e6), st.floats(0, 1e3), st.floats(0, 1e3), st.floats(-10, 10))
def test_scaling_keeps_the_bounds_round_the_figure(value, below, above, factor):
    scaled = Figure(value, value - below, value + above).scaled(factor)
    assert scaled.low <= scaled.value <= scaled.high
    assert scaled.value == value * factor


def test_the_same_counts_are_costed_once():
    costing = Costing(hand_made())
    first = costing.cost(counts(runs=5))
    assert costing.cost(counts(runs=5)) is first
    assert isinstance(first, Cost)
    assert np.array_equal(counts(runs=5), counts(runs=5))
    assert len(COUNTS) == len(counts())
