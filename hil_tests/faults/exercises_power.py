"""Faults of the power, exercised."""

from __future__ import annotations

from hil_tests.faults.exercise import Exercise

EXERCISES: tuple[Exercise, ...] = ()
