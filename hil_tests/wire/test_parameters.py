"""Parameters: read, set all or none, kept through a reset."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from .conftest import BOOT, Wire

EXPOSURE_US, SIGMA, MIN_STARS, VELOCITY_Y, BOOT_COUNT = 1, 2, 10, 15, 21
OUT_OF_RANGE, READ_ONLY = 8, 10
CHANGED: dict[int, float] = {EXPOSURE_US: 50_000, SIGMA: 7.25, MIN_STARS: 4, VELOCITY_Y: -7.5}
Set = Callable[[dict[int, float]], None]


def test_read_in_the_order_asked(line: Wire) -> None:
    numbers = [MIN_STARS, EXPOSURE_US, MIN_STARS]
    answer = line.answer("parameter_report", {"parameter_ids": numbers}, "parameter_values")
    assert [entry["parameter_id"] for entry in answer["values"]] == numbers
    assert answer["values"][0] == answer["values"][2]


def test_the_exposure_is_that_of_the_unit_file(line: Wire) -> None:
    assert line.parameters(EXPOSURE_US) == {EXPOSURE_US: round(line.profile.timing.exposure_ms * 1000)}


def test_set_and_stored(line: Wire, keeping_parameters: Set) -> None:
    keeping_parameters(CHANGED)
    assert line.parameters(*CHANGED) == CHANGED
    assert line.events("PARAMETERS_STORED") == [{"count": len(CHANGED)}]


@pytest.mark.parametrize("kind", [0, 1], ids=["warm", "cold"])
def test_kept_through_a_reset(line: Wire, keeping_parameters: Set, kind: int) -> None:
    keeping_parameters(CHANGED)
    boots = line.parameters(BOOT_COUNT)[BOOT_COUNT]
    line.function("RESET", {"kind": kind})
    line.await_(lambda: line.events("BOOT_COMPLETED"))
    assert line.mode() != BOOT
    assert line.parameters(*CHANGED, BOOT_COUNT) == CHANGED | {BOOT_COUNT: boots + 1}


@pytest.mark.parametrize(
    ("wrong", "code"), [({MIN_STARS: 21}, OUT_OF_RANGE), ({SIGMA: float("nan")}, OUT_OF_RANGE),
                        ({BOOT_COUNT: 0}, READ_ONLY)],
)  # fmt: skip
def test_of_several_none_is_set_when_one_is_wrong(line: Wire, wrong: dict[int, float], code: int) -> None:
    before = line.parameters(*CHANGED)
    settings = [{"parameter_id": n, "value": v} for n, v in (CHANGED | wrong).items()]
    count = line.send("parameter_set", {"settings": settings})
    assert line.await_end(count) == ["acceptance_failure"]
    assert line.failure(count) == ("acceptance_failure", code, next(iter(wrong)))
    assert line.parameters(*CHANGED) == before
