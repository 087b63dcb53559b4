"""Confidence intervals of shares."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

Z_95 = 1.959963984540054  # two-sided 95 % of the normal distribution


@dataclass(frozen=True)
class Share:
    """A share with its 95 % interval; ``cases`` is the number of cases it was counted on."""

    value: float
    low: float
    high: float
    cases: int

    def interval(self, digits: int = 2) -> str:
        """The interval in percent, as tables print it."""
        return f"{100 * self.low:.{digits}f}-{100 * self.high:.{digits}f}"


def wilson(count: float, cases: float) -> tuple[float, float]:
    """Wilson's score interval, 95 %, of ``count`` of ``cases`` (Wilson 1927); (0, 1) of no cases."""
    if cases <= 0:
        return 0.0, 1.0
    p, z2 = count / cases, Z_95 * Z_95
    middle = (p + z2 / (2 * cases)) / (1 + z2 / cases)
    half = Z_95 / (1 + z2 / cases) * math.sqrt(p * (1 - p) / cases + z2 / (4 * cases * cases))
    # at the ends the formula gives 0 and 1 but for rounding
    return (0.0 if count <= 0 else max(0.0, middle - half)), (
        1.0 if count >= cases else min(1.0, middle + half)
    )


def share(count: int, cases: int) -> Share:
    """``count`` of ``cases``. ValueError: no cases, or a count that is no part of them."""
    if not 0 <= count <= cases or cases == 0:
        raise ValueError(f"{count} of {cases} is no share")
    return Share(count / cases, *wilson(count, cases), cases)


def stratified_share(counts: Sequence[int], cases: Sequence[int], weights: Sequence[float]) -> Share:
    """Share of a population whose strata have the given weights (sum 1), counted in each stratum.

    The interval is Wilson's at the effective number of cases: that of a plain sample with the same variance
    (Korn & Graubard 1998, with Wilson's interval for theirs). The strata's variances use (count + 1/2) /
    (cases + 1), so that a stratum without a miss is not taken for certain. ValueError: a stratum with weight
    and without cases.
    """
    if any(weight > 0 and number == 0 for weight, number in zip(weights, cases, strict=True)):
        raise ValueError("a stratum with weight has no cases")
    value = smoothed = variance = 0.0
    for count, number, weight in zip(counts, cases, weights, strict=True):
        if weight <= 0:
            continue
        p = (count + 0.5) / (number + 1.0)
        value += weight * count / number
        smoothed += weight * p
        variance += weight * weight * p * (1.0 - p) / number
    effective = smoothed * (1.0 - smoothed) / variance
    return Share(value, *wilson(value * effective, effective), sum(cases))
