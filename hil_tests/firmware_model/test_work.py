"""Work: counts by stage."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from st_emulator.firmware_model.work import COUNTS, STAGES, Work

counted = st.dictionaries(st.sampled_from(sorted(COUNTS)), st.integers(0, 10**9), max_size=12)


def test_every_count_has_a_stage_and_a_meaning() -> None:
    assert set(STAGES) == {definition.stage for definition in COUNTS.values()}
    assert all(name == definition.name and definition.meaning for name, definition in COUNTS.items())
    assert len({definition.meaning for definition in COUNTS.values()}) == len(COUNTS)


def test_counts_add_up() -> None:
    work = Work()
    work.add("runs")
    work.add("runs", 4)
    work.add("crc_bytes", 10)
    assert (work["runs"], work["crc_bytes"], work["clusters"]) == (5, 10, 0)
    assert work.by_stage() == {"clustering": {"runs": 5}, "telemetry": {"crc_bytes": 10}}


@given(counted, counted)
def test_sum_of_two_works(one: dict[str, int], other: dict[str, int]) -> None:
    expected = {name: one.get(name, 0) + other.get(name, 0) for name in COUNTS}
    left, right = Work(one), Work(other)
    total = left + right
    assert {name: total[name] for name in COUNTS} == expected
    assert total == right + left
    assert left == Work(one)  # a sum leaves its terms alone
    left += right
    assert left == total


def test_by_stage_leaves_out_what_is_zero_and_keeps_the_order() -> None:
    work = Work({"telemetry_bytes": 1, "threshold_pixels": 2, "clusters": 0})
    assert list(work.by_stage()) == ["threshold", "telemetry"]


def test_equality_ignores_zero_counts() -> None:
    assert Work({"runs": 0}) == Work()
    assert Work({"runs": 1}) != Work()
    assert Work() != {}


def test_unknown_counts_and_negative_numbers_are_refused() -> None:
    with pytest.raises(KeyError, match="pixels_admired"):
        Work().add("pixels_admired")
    with pytest.raises(KeyError, match="pixels_admired"):
        Work()["pixels_admired"]
    with pytest.raises(ValueError, match="runs = -1"):
        Work({"runs": -1})
