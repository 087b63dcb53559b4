"""Mean, standard deviation, skewness and kurtosis of errors that come in groups, with the intervals that
follow."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .confidence import Z_95, student_95

Array = NDArray[np.float64]

LEAST_GROUPS = 5  # fewer say nothing of how much groups differ


@dataclass(frozen=True)
class Moments:
    """Of errors: how many, and the sums of their first four powers, float64[4]."""

    count: int
    sums: Array

    @classmethod
    def of(cls, errors: Array) -> Moments:
        """Of errors float64[n]."""
        return cls(len(errors), np.array([float((errors**power).sum()) for power in (1, 2, 3, 4)]))


@dataclass(frozen=True)
class Spread:
    """Mean, standard deviation, skewness and kurtosis of ``count`` errors.

    mean_half, std_half: half of the 95 % intervals of mean and standard deviation.
    """

    count: int
    mean: float
    std: float
    skewness: float
    kurtosis: float
    mean_half: float
    std_half: float

    @classmethod
    def of(cls, moments: Iterable[tuple[int, Moments]]) -> Spread | None:
        """Of all errors of (group, moments) together; None of fewer than two errors.

        The errors of one group may have something in common: the intervals follow from how the groups differ
        (linearised, Student's factor for few groups), are no narrower than those of errors that have nothing
        in common, and infinite with fewer than LEAST_GROUPS groups.
        """
        sums: dict[int, Array] = {}
        for group, item in moments:
            if item.count:
                entry = sums.setdefault(group, np.zeros(5))
                entry += np.concatenate([[item.count], item.sums])
        table = np.array(list(sums.values())).reshape(-1, 5)
        count = int(table[:, 0].sum())
        if count < 2:
            return None
        first, second, third, fourth = (float(value) for value in table[:, 1:].sum(axis=0) / count)
        variance = max(second - first * first, 0.0)
        std = math.sqrt(variance)
        if std == 0.0:
            return cls(count, first, 0.0, 0.0, 0.0, 0.0, 0.0)
        central_3 = third - 3 * first * second + 2 * first**3
        central_4 = fourth - 4 * first * third + 6 * first * first * second - 3 * first**4
        groups = len(table)
        mean_half = std_half = math.inf
        if groups >= LEAST_GROUPS:
            factor = student_95(groups - 1) * math.sqrt(groups / (groups - 1)) / count
            off = table[:, 1] - first * table[:, 0]
            squares = table[:, 2] - 2 * first * table[:, 1] + (first * first - variance) * table[:, 0]
            mean_half = max(factor * math.sqrt(float(off @ off)), Z_95 * std / math.sqrt(count))
            std_half = max(
                factor * math.sqrt(float(squares @ squares)) / (2 * std), Z_95 * std / math.sqrt(2 * count)
            )
        return cls(count, first, std, central_3 / std**3, central_4 / variance**2, mean_half, std_half)
