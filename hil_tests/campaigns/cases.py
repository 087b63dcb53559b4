"""Functions of cases for the tests of campaigns: workers import them by name."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from st_emulator.errors import ConfigurationError


@dataclass(frozen=True)
class Pair:
    """An outcome with a value of every kind."""

    index: int
    share: float
    name: str
    good: bool
    none: float | None
    values: NDArray[np.float64]
    counts: NDArray[np.int64]
    rest: tuple[float, ...]
    mixed: tuple[int, str]
    inner: list[tuple[int, int]]


def pair(index: int) -> Pair:
    rng = np.random.default_rng([7, index])
    return Pair(
        index,
        float(rng.normal()),
        f"case {index}",
        index % 2 == 0,
        None,
        rng.normal(size=(index % 3, 4)),
        rng.integers(0, 100, 3),
        (0.1, float("nan"), float("inf")),
        (index, "x"),
        [(1, 2), (3, index)],
    )


def square(index: int) -> int:
    return index * index


def slow_square(seconds: float, index: int) -> int:
    time.sleep(seconds)
    return index * index


def _first_time(marks: str, index: int) -> bool:
    mark = Path(marks) / str(index)
    if mark.exists():
        return False
    mark.touch()
    return True


def dies_once(marks: str, victims: tuple[int, ...], index: int) -> int:
    """Ends the worker's process, as the kernel does when memory is short, at the first try of a victim."""
    if index in victims and _first_time(marks, index):
        os.kill(os.getpid(), signal.SIGKILL)
    return index * index


def always_dies(victim: int, index: int) -> int:
    if index == victim:
        os.kill(os.getpid(), signal.SIGKILL)
    return index * index


def fails_once(marks: str, index: int) -> int:
    if index % 5 == 0 and _first_time(marks, index):
        raise OSError("the disk was away")
    return index * index


def always_fails(victim: int, index: int) -> int:
    if index == victim:
        raise ArithmeticError("no such square")
    return index * index


def refuses(index: int) -> int:
    raise ConfigurationError("the unit is none for this; allowed are others")


def process_number(index: int) -> int:
    time.sleep(0.05)
    return os.getpid()
