"""The clock at which frames fit: the core's cycles get shorter with it, the memory's time stays.

Time of a frame at clock f: core cycles / f + memory time. Both parts come from costing the same work at two
clocks, so that they are the processor profile's own and not a second model of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..firmware_model.processor import ProcessorProfile
from .figures import FRAME, Costing, Figure, p99
from .samples import Counts, Lost

HIGHEST_HZ = 20e9
LOWEST_HZ = 1e5
STEP = 1.01  # the scan's; the clock found is then closed in to TOLERANCE
TOLERANCE = 1e-5
# of `firmware_model.processor.CycleBudget.for_search`: what of the budget a search and what is before it
# may take together, and what it is given in any case
SEARCH_SHARE, LEAST_SHARE = 0.9, 0.5

Floats = NDArray[np.float64]
WHICH = ("low", "value", "high")


@dataclass(frozen=True)
class Parts:
    """Core cycles and memory time (s) of n frames, at the nominal cost or at one of its bounds."""

    core_cycles: Floats
    memory_s: Floats

    def seconds(self, clock_hz: float) -> Floats:
        """Processing time of each frame at a clock."""
        return np.asarray(self.core_cycles / clock_hz + self.memory_s)


class Laws:
    """Splits work into parts on one kind of processor, whatever its clock."""

    def __init__(self, processor: ProcessorProfile) -> None:
        self._clock_hz = processor.clock_hz
        self._once = Costing(processor)
        self._twice = Costing(processor.with_clock(2 * processor.clock_hz))

    def parts(self, frames: Sequence[Counts]) -> dict[str, Parts]:
        """By WHICH: at the low bound, the nominal cost and the high bound.

        The bounds' spread of the coefficients is not quite a straight line in the clock; within a factor of
        ten of the processor's own the error is under 1 % of that spread.
        """
        found = {}
        for which in WHICH:
            once = np.array([getattr(self._once.cost(item).by_row[FRAME], which) for item in frames], float)
            twice = np.array([getattr(self._twice.cost(item).by_row[FRAME], which) for item in frames], float)
            memory_cycles = np.maximum(0.0, twice - once)
            found[which] = Parts(np.maximum(0.0, once - memory_cycles), memory_cycles / self._clock_hz)
        return found


def least_clock_hz(on_time: Callable[[float], bool]) -> float | None:
    """The least clock from which on frames are on time at every higher one; None: not even at the highest.

    Looked for downwards, as a search that is cut short at a low clock may be on time there again.
    """
    above = HIGHEST_HZ
    if not on_time(above):
        return None
    below = max(LOWEST_HZ, above / STEP)
    while on_time(below):
        if below == LOWEST_HZ:
            return LOWEST_HZ
        above, below = below, max(LOWEST_HZ, below / STEP)
    while above / below > 1.0 + TOLERANCE:
        middle = math.sqrt(above * below)
        if on_time(middle):
            above = middle
        else:
            below = middle
    return above


@dataclass(frozen=True)
class LeastClock:
    """Least clocks at the low, the nominal and the high cost; None: the memory alone takes longer."""

    low_hz: float | None
    nominal_hz: float | None
    high_hz: float | None

    def as_dict(self) -> dict[str, float | None]:
        return dict(self.__dict__)

    @property
    def figure_mhz(self) -> Figure | None:
        """In MHz, where there is one at each cost."""
        if self.low_hz is None or self.nominal_hz is None or self.high_hz is None:
            return None
        values = sorted((self.low_hz, self.nominal_hz, self.high_hz))
        return Figure(values[1] / 1e6, values[0] / 1e6, values[2] / 1e6)

    def text(self) -> str:
        """``88.1 (79.4..99.2) MHz``."""
        figure = self.figure_mhz
        if figure is not None:
            return f"{figure.text()} MHz"
        names = zip(("low", "nominal", "high"), (self.low_hz, self.nominal_hz, self.high_hz), strict=True)
        return ", ".join(
            f"{name} cost: {'none at any clock' if hz is None else f'{hz / 1e6:.0f} MHz'}"
            for name, hz in names
        )


def clock_for_frames(
    laws: Laws, frames: Sequence[Counts], budget_s: float, statistic: Callable[[Floats], float] = np.max
) -> LeastClock:
    """The clock at which the statistic (the worst, or `figures.p99`) of frames whose work does not depend on
    the clock fits the budget."""
    parts = laws.parts(frames)
    return _least(lambda which, hz: float(statistic(parts[which].seconds(hz))) <= budget_s)


def clock_as_flown(laws: Laws, frames: Sequence[Lost], budget_s: float) -> LeastClock:
    """The clock at which the worst of frames lost in space is on time with its search limited by that
    clock's budget. The limit is counted at the nominal cost, as on board; the time may be at a bound."""
    whole = laws.parts([frame.whole_counts for frame in frames])
    before = laws.parts([frame.before_counts for frame in frames])
    search = laws.parts([frame.search_counts for frame in frames])

    def on_time(which: str, hz: float) -> bool:
        nominal_before, nominal_search = before["value"].seconds(hz), search["value"].seconds(hz)
        limit = np.maximum(SEARCH_SHARE * budget_s - nominal_before, LEAST_SHARE * budget_s)
        cut = nominal_search > limit
        share = np.where(cut, limit / np.maximum(nominal_search, 1e-30), 1.0)
        taken_search = search[which].seconds(hz) * share
        complete = whole[which].seconds(hz)
        ended = before[which].seconds(hz) + taken_search
        return bool(np.all(np.where(cut, ended, complete) <= budget_s))

    return _least(on_time)


def _least(on_time: Callable[[str, float], bool]) -> LeastClock:
    low, nominal, high = (least_clock_hz(lambda hz, which=which: on_time(which, hz)) for which in WHICH)  # type: ignore[misc]
    return LeastClock(low, nominal, high)


__all__ = [
    "Laws",
    "LeastClock",
    "Parts",
    "clock_as_flown",
    "clock_for_frames",
    "least_clock_hz",
    "p99",
]
