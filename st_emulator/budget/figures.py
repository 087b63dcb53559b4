"""Figures with what they may be off by: nothing that is counted in cycles is printed without."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..firmware_model.processor import ProcessorProfile
from ..firmware_model.work import STAGES
from .samples import Counts, work_of

FRAME = "frame"  # the sum of the stages
ROWS = (*STAGES, FRAME)


@dataclass(frozen=True)
class Figure:
    """A figure with the least and the most that it may be."""

    value: float
    low: float
    high: float

    def __post_init__(self) -> None:
        if not self.low <= self.value <= self.high:
            raise ValueError(f"{self.value} is not between {self.low} and {self.high}")

    def scaled(self, factor: float) -> Figure:
        """The same in another unit; a negative factor turns the bounds round."""
        ends = sorted((self.low * factor, self.high * factor))
        return Figure(self.value * factor, ends[0], ends[1])

    def text(self) -> str:
        """``8.89 (7.62..9.15)``: three digits of the largest, as many behind the point in all."""
        largest = max(abs(self.low), abs(self.high))
        digits = 2 if largest < 9.995 else 1 if largest < 99.95 else 0
        return f"{self.value:.{digits}f} ({self.low:.{digits}f}..{self.high:.{digits}f})"

    def as_dict(self) -> dict[str, float]:
        return {"value": self.value, "low": self.low, "high": self.high}


@dataclass(frozen=True)
class Cost:
    """Cycles of one frame on a processor, by ROWS, each with its bounds."""

    by_row: Mapping[str, Figure]

    @property
    def frame(self) -> Figure:
        return self.by_row[FRAME]


class Costing:
    """Turns counts into cycles on one processor; the same counts are costed once."""

    def __init__(self, processor: ProcessorProfile) -> None:
        self.processor = processor
        self._known: dict[bytes, Cost] = {}

    def cost(self, counts: Counts) -> Cost:
        """Cycles of one frame with these counts."""
        key = counts.tobytes()
        found = self._known.get(key)
        if found is None:
            work = work_of(counts)
            nominal = self.processor.cycles(work)
            low, high = self.processor.bounds(work)
            figures = {
                stage: _ordered(nominal.by_stage[stage], low.by_stage[stage], high.by_stage[stage])
                for stage in STAGES
            }
            figures[FRAME] = _ordered(nominal.total, low.total, high.total)
            found = self._known[key] = Cost(figures)
        return found

    def ms(self, cycles: Figure) -> Figure:
        """Time of cycles, ms."""
        low, value, high = (
            cycle * 1e3 / self.processor.clock_hz for cycle in (cycles.low, cycles.value, cycles.high)
        )
        return Figure(value, low, high)


def _ordered(value: float, low: float, high: float) -> Figure:
    """Low and high line fill bound the nominal one; a run at another line fill than the nominal one may lie
    on a bound."""
    return Figure(value, min(low, value), max(high, value))


@dataclass(frozen=True)
class Distribution:
    """Median, 99th percentile and worst of n frames; the percentile is a frame's own figure, the next above.

    Each bound is that of the frames' bounds.
    """

    n: int
    median: Figure
    p99: Figure
    worst: Figure

    def as_dict(self) -> dict[str, object]:
        return {
            "n": self.n,
            "median": self.median.as_dict(),
            "p99": self.p99.as_dict(),
            "worst": self.worst.as_dict(),
        }


def distribution(figures: Sequence[Figure]) -> Distribution:
    """Of figures of frames. ValueError: there are none."""
    if not figures:
        raise ValueError("no frames")
    values = np.array([(item.low, item.value, item.high) for item in figures])

    def statistic(of: Callable[[NDArray[np.float64]], float]) -> Figure:
        low, value, high = (of(values[:, column]) for column in range(3))
        return Figure(value, low, high)

    return Distribution(
        len(figures),
        statistic(lambda column: float(np.median(column))),
        statistic(p99),
        statistic(lambda column: float(np.max(column))),
    )


def p99(values: NDArray[np.float64]) -> float:
    """99th percentile: the least of the values that 99 % do not exceed."""
    return float(np.quantile(values, 0.99, method="inverted_cdf"))


def by_row(costs: Iterable[Cost]) -> dict[str, Distribution]:
    """The distribution of each stage and of the frame."""
    known = list(costs)
    return {row: distribution([cost.by_row[row] for cost in known]) for row in ROWS}
