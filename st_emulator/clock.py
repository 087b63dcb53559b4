"""One virtual clock: integer nanoseconds since power-on, events ordered by (time, sequence).

Nothing here looks at the operating system's clock; :mod:`st_emulator.drivers.realtime` paces this clock
against it.
A delay is a scheduled event, never a sleep, so results do not depend on the size of the steps.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass, field

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
NS_PER_US = 1_000


@dataclass(order=True)
class ScheduledEvent:
    """An action due at a virtual time. ``cancel()`` makes it void."""

    at_ns: int
    sequence: int
    action: Callable[[], None] = field(compare=False)
    cancelled: bool = field(default=False, compare=False)

    def cancel(self) -> None:
        self.cancelled = True


class VirtualClock:
    """A queue of events and the present virtual time.

    ``now_ns`` only grows; ``actions`` counts those that were run. Two events of the same time run in the
    order in which they were scheduled.
    """

    def __init__(self) -> None:
        self.now_ns = 0
        self.actions = 0
        self._sequence = 0
        self._queue: list[ScheduledEvent] = []

    def at(self, at_ns: int, action: Callable[[], None]) -> ScheduledEvent:
        """Schedule ``action`` at ``at_ns``.

        Raises:
            ValueError: the time lies in the past (a cause cannot come after its effect).
        """
        if at_ns < self.now_ns:
            raise ValueError(f"cannot schedule at {at_ns} ns: the clock is at {self.now_ns} ns")
        self._sequence += 1
        event = ScheduledEvent(at_ns, self._sequence, action)
        heapq.heappush(self._queue, event)
        return event

    def after(self, delay_ns: int, action: Callable[[], None]) -> ScheduledEvent:
        """Schedule ``action`` ``delay_ns`` from now."""
        return self.at(self.now_ns + delay_ns, action)

    def next_ns(self) -> int | None:
        """Time of the next event, or None when nothing is scheduled."""
        while self._queue and self._queue[0].cancelled:
            heapq.heappop(self._queue)
        return self._queue[0].at_ns if self._queue else None

    def advance(self, until_ns: int) -> None:
        """Run every event due at or before ``until_ns`` and set the time to it.

        An action that raises stays due, the time stays at it: what it needed may be there the next time.
        """
        while (due := self.next_ns()) is not None and due <= until_ns:
            event = heapq.heappop(self._queue)
            self.now_ns = event.at_ns
            try:
                event.action()
            except Exception:
                heapq.heappush(self._queue, event)
                raise
            self.actions += 1
        if until_ns > self.now_ns:
            self.now_ns = until_ns
