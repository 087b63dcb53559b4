"""What faults do later: hold back what passes, and do something again and again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from ..clock import NS_PER_S, ScheduledEvent
from ..device.reports import Report, Restarted, WentOff
from .fault import AtReports, Fault, Reach, SettingsT


def goes(direction: str, to_obc: bool) -> bool:
    """Whether a fault of ``direction`` strikes what goes this way."""
    return direction == "both" or (direction == "to_obc") is to_obc


@dataclass(eq=False)
class Held:
    action: Callable[[], None]
    to_obc: bool
    event: ScheduledEvent | None = None


class Holding(AtReports[SettingsT]):
    """Holds back what passes: for a time, or until something is done.

    At the fault's end everything goes on at once, in its order. What the unit has said before it restarts or
    goes off is lost then, as is what waits in its queue.
    """

    def __init__(self, settings: SettingsT, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        self._held: list[Held] = []

    def hold(self, action: Callable[[], None], to_obc: bool, delay_ns: int | None = None) -> Held:
        """Do ``action`` after ``delay_ns``; None: when it is let go."""
        held = Held(action, to_obc)
        self._held.append(held)
        if delay_ns is not None:
            held.event = self.reach.clock.after(delay_ns, partial(self.let_go, held))
        return held

    def let_go(self, held: Held) -> None:
        """It goes on now."""
        if self.drop(held):
            held.action()

    def drop(self, held: Held) -> bool:
        """It never goes on. False: it is gone."""
        if held not in self._held:
            return False
        self._held.remove(held)
        if held.event is not None:
            held.event.cancel()
        return True

    def report(self, report: Report) -> None:
        if isinstance(report, (Restarted, WentOff)):
            for held in [held for held in self._held if held.to_obc]:
                self.drop(held)

    def end(self) -> None:
        for held in list(self._held):
            self.let_go(held)


class Repeating(Fault[SettingsT]):
    """Does something at a rate while it lasts, first at its begin."""

    def rate_hz(self) -> float:
        raise NotImplementedError

    def once(self) -> None:
        """What it does each time."""
        raise NotImplementedError

    def begin(self) -> None:
        self._start_ns = self.reach.clock.now_ns
        self._number = 0
        self._next: ScheduledEvent | None = None
        self._again()

    def _again(self) -> None:
        due_ns = self._start_ns + round(self._number * NS_PER_S / self.rate_hz())  # no rounding adds up
        self._number += 1
        self._next = self.reach.clock.at(due_ns, self._due)

    def _due(self) -> None:
        self._again()
        if self.strikes():
            self.once()

    def end(self) -> None:
        if self._next is not None:
            self._next.cancel()
