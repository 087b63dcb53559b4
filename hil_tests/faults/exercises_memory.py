"""Faults of the memory, exercised."""

from __future__ import annotations

from hil_tests.faults.exercise import Exercise

EXERCISES: tuple[Exercise, ...] = ()
