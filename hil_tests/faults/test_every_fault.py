"""Every fault of the list is exercised over the wire: what the OBC must see, and what comes after.

The table of docs/faults.md is that of these runs: ``python -m hil_tests.faults.table --write`` writes it.
"""

from __future__ import annotations

import re

import pytest

from hil_tests.faults.exercise import Exercise, judge
from hil_tests.faults.table import DOCUMENT, Row, document, exercises, row_of, written_rows
from st_emulator.faults.catalogue import FAULTS

EXERCISES = exercises()


@pytest.mark.parametrize("exercise", EXERCISES, ids=lambda one: one.title)
def test_fault(exercise: Exercise) -> None:
    row = row_of(exercise, *judge(exercise))
    assert row.line in written_rows(), "the table is out of date: python -m hil_tests.faults.table --write"


def test_every_fault_is_exercised() -> None:
    assert {exercise.fault["kind"] for exercise in EXERCISES} == set(FAULTS)


def test_the_table_has_these_rows_and_no_others() -> None:
    titles = [re.split(r" \| ", line.removeprefix("| "))[0] for line in written_rows()]
    assert sorted(titles) == sorted(exercise.title for exercise in EXERCISES)
    assert len(set(titles)) == len(titles)
    rows = [
        Row(title, FAULTS[str(exercise.fault["kind"])].seam, ("",))
        for title, exercise in zip(titles, EXERCISES, strict=True)
    ]
    beside = [line for line in document(rows).splitlines() if not line.startswith("|  |")]
    text = DOCUMENT.read_text(encoding="utf-8")
    assert [line for line in text.splitlines() if line not in written_rows()] == beside
