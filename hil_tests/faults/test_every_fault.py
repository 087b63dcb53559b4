"""Every fault of the list is exercised over the wire: what the OBC must see, and what comes after."""

from __future__ import annotations

import pytest

from hil_tests.faults import (
    exercises_bus,
    exercises_clock,
    exercises_line,
    exercises_memory,
    exercises_power,
    exercises_processor,
    exercises_sensor,
    exercises_telemetry,
)
from hil_tests.faults.exercise import Exercise, judge
from st_emulator.faults.catalogue import FAULTS

EXERCISES = [
    *exercises_line.EXERCISES,
    *exercises_bus.EXERCISES,
    *exercises_telemetry.EXERCISES,
    *exercises_sensor.EXERCISES,
    *exercises_processor.EXERCISES,
    *exercises_memory.EXERCISES,
    *exercises_clock.EXERCISES,
    *exercises_power.EXERCISES,
]


@pytest.mark.parametrize("exercise", EXERCISES, ids=lambda one: one.title)
def test_fault(exercise: Exercise) -> None:
    judge(exercise)


def test_every_fault_is_exercised() -> None:
    assert {exercise.fault["kind"] for exercise in EXERCISES} == set(FAULTS)
