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


_STUDENT_95 = (12.706204736, 4.302652730, 3.182446305, 2.776445105)


def student_95(freedom: int) -> float:
    """Two-sided 95 % of Student's distribution, within 3e-4; inf without a degree of freedom.

    From 5 degrees on its expansion about the normal distribution (Abramowitz & Stegun 26.7.5).
    """
    if freedom < 1:
        return math.inf
    if freedom <= len(_STUDENT_95):
        return _STUDENT_95[freedom - 1]
    x = Z_95
    terms = (
        (x**3 + x) / 4,
        (5 * x**5 + 16 * x**3 + 3 * x) / 96,
        (3 * x**7 + 19 * x**5 + 17 * x**3 - 15 * x) / 384,
        (79 * x**9 + 776 * x**7 + 1482 * x**5 - 1920 * x**3 - 945 * x) / 92160,
    )
    return x + float(sum(term / freedom ** (power + 1) for power, term in enumerate(terms)))


def clustered_share(counts: Sequence[int], cases: Sequence[int]) -> Share:
    """Share of cases that come in groups which have something in common: ``counts[g]`` of ``cases[g]``.

    The interval is Wilson's at the effective number of cases: that of a plain sample with the variance of the
    groups' (ratio estimator, Student's factor for few groups), never more than there are cases; where all
    groups agree, as many as there are groups. ValueError: no cases.
    """
    count, total, groups = sum(counts), sum(cases), len(cases)
    whole = share(count, total)
    p = whole.value
    residual = sum((c - p * n) ** 2 for c, n in zip(counts, cases, strict=True))
    if groups < 2 or residual == 0.0:
        return Share(p, *wilson(p * groups, groups), total)
    variance = residual / (total * total) * groups / (groups - 1) * (student_95(groups - 1) / Z_95) ** 2
    effective = min(p * (1.0 - p) / variance, float(total))
    return Share(p, *wilson(p * effective, effective), total)
