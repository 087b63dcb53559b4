"""The bench's clock in real time: a unit that the computer did not let run gets its time all the same."""

from __future__ import annotations

import time

import pytest

from st_emulator.testing.clock import RealBenchClock


@pytest.mark.parametrize("held_up_ms", [0, 200])
def test_a_deadline_moves_by_what_the_unit_was_held_up(held_up_ms: int) -> None:
    asked = []

    def behind_ns() -> int:
        asked.append(True)
        return 0 if len(asked) == 1 else held_up_ms * 1_000_000

    clock = RealBenchClock(behind_ns=behind_ns)
    begun_ns = time.monotonic_ns()
    assert not clock.run_until(lambda: False, clock.now_ns + 50_000_000)
    assert time.monotonic_ns() - begun_ns >= (50 + held_up_ms) * 1_000_000
    assert len(asked) == (2 if held_up_ms == 0 else 3), "it was no further behind at the new deadline"


def test_what_comes_at_the_last_moment_counts() -> None:
    come: list[bool] = []

    def behind_ns() -> int:
        come.append(True)
        return 0

    clock = RealBenchClock(behind_ns=behind_ns)
    assert clock.run_until(lambda: len(come) == 2, clock.now_ns + 10_000_000)
