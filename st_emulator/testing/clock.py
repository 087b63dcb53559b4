"""The time of a bench: virtual, from event to event, or the computer's. All waiting is by one of them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Protocol

from ..clock import NS_PER_S
from ..links import Link
from ..obc.reading import NextDeadline, TakeBytes, never

POLL_S = 0.005
"""ASSUMED: a condition that holds for less is none that an OBC could see."""
HELD_UP_NS = 20_000_000
"""ASSUMED: less is no delay but the asking itself."""
Done = Callable[[], object]


class BenchClock(Protocol):
    """The bench's time: nanoseconds since it was made."""

    @property
    def now_ns(self) -> int: ...

    def run_until(self, done: Done, deadline_ns: int) -> bool:
        """Let time go on until ``done()`` holds (True) or the deadline is reached (False). It is asked at
        once, after each event, and at the deadline."""


class Timed(Protocol):
    """Whatever lives in virtual time. Times are the bench's."""

    def take_in(self) -> bool:
        """Take what has come at the present time; whether there was anything."""

    def next_event_ns(self) -> int | None:
        """When it has to be looked at next though nothing comes."""

    def advance(self, until_ns: int) -> None:
        """Go on to a time that is not behind its next event."""


class VirtualBenchClock:
    """Jumps from event to event; nothing in it looks at the computer's clock, unless it is to be slower.

    ``speed``: at most so many times real time; None: as fast as the computer can. ``events`` counts steps.
    """

    def __init__(self, speed: float | None = None) -> None:
        self.speed = speed
        self.events = 0
        self._now_ns = 0
        self._members: list[Timed] = []
        self._from_ns = 0
        self._from_wall_ns = time.monotonic_ns()

    @property
    def now_ns(self) -> int:
        return self._now_ns

    def join(self, member: Timed) -> None:
        """Who lives in this time from now on."""
        self._members.append(member)

    def leave(self, member: Timed) -> None:
        """Who lives in it no more."""
        self._members.remove(member)

    def run_until(self, done: Done, deadline_ns: int) -> bool:
        """As the contract says."""
        while True:
            self._settle()
            if done():
                return True
            if self._now_ns >= deadline_ns:
                return False
            due_ns = [
                event_ns for member in self._members if (event_ns := member.next_event_ns()) is not None
            ]
            self._advance(max(self._now_ns, min([*due_ns, deadline_ns])))

    def _settle(self) -> None:
        """All that has been said arrives before time goes on."""
        while any([member.take_in() for member in self._members]):
            pass

    def _advance(self, until_ns: int) -> None:
        if self.speed is not None:
            self._wait_for(until_ns, self.speed)
        self.events += 1
        self._now_ns = until_ns
        for member in self._members:
            member.advance(until_ns)

    def _wait_for(self, until_ns: int, speed: float) -> None:
        ahead_ns = (until_ns - self._from_ns) / speed - (time.monotonic_ns() - self._from_wall_ns)
        if ahead_ns > 0:
            time.sleep(ahead_ns / NS_PER_S)
        else:  # the test took its time: what is lost is not made up
            self._from_ns, self._from_wall_ns = until_ns, time.monotonic_ns()


class BenchReader:
    """How an OBC listens that lives in virtual time (:class:`st_emulator.obc.reading.Reader`).

    ``epoch``: the civil time at ``epoch_ns()``, the bench's time at the unit's power-on.
    """

    def __init__(self, clock: VirtualBenchClock, epoch: datetime, epoch_ns: Callable[[], int]) -> None:
        self.lock = threading.RLock()
        self._clock = clock
        self._epoch = epoch
        self._epoch_ns = epoch_ns
        self._link: Link | None = None
        self._take: TakeBytes = lambda data, now_ns: False
        self._next_deadline_ns: NextDeadline = never

    def now_ns(self) -> int:
        """The bench's time."""
        return self._clock.now_ns

    def utc_now(self) -> datetime:
        """Bench time, counted from the epoch."""
        return self._epoch + timedelta(microseconds=(self._clock.now_ns - self._epoch_ns()) // 1000)

    def start(self, link: Link, take: TakeBytes, next_deadline_ns: NextDeadline = never) -> None:
        """Begin to listen."""
        self._link, self._take, self._next_deadline_ns = link, take, next_deadline_ns
        self._clock.join(self)

    def wake(self) -> None:
        """Nothing: the deadline is looked at before each step."""

    def wait(self, done: Callable[[], bool], deadline_ns: int) -> bool:
        """Let time go on."""
        return self._clock.run_until(done, deadline_ns)

    def stop(self) -> None:
        """Listen no more."""
        if self._link is not None:
            self._clock.leave(self)
        self._link = None

    def take_in(self) -> bool:
        """Bring what has come, or what is due, to the OBC."""
        if self._link is None:
            return False
        data, due_ns = self._link.read(), self._next_deadline_ns()
        is_due = due_ns is not None and due_ns <= self._clock.now_ns
        if data or is_due:
            with self.lock:
                self._take(data, self._clock.now_ns)
        return bool(data) or (is_due and self._next_deadline_ns() != due_ns)

    def next_event_ns(self) -> int | None:
        """The OBC's next deadline; one that has passed was told."""
        due_ns = self._next_deadline_ns()
        return due_ns if due_ns is not None and due_ns > self._clock.now_ns else None

    def advance(self, until_ns: int) -> None:
        """It does nothing by itself."""


class RealBenchClock:
    """The computer's clock. A condition is looked at each few milliseconds; it may itself wait.

    ``watch`` is called as often: it raises when a unit has gone. ``behind_ns`` tells how far units are behind
    the computer's clock: one that the computer did not let run is given that time as well.
    """

    def __init__(
        self, watch: Callable[[], None] = lambda: None, behind_ns: Callable[[], int] = lambda: 0
    ) -> None:
        self._origin_ns = time.monotonic_ns()
        self._watch = watch
        self._behind_ns = behind_ns

    @property
    def now_ns(self) -> int:
        return time.monotonic_ns() - self._origin_ns

    def run_until(self, done: Done, deadline_ns: int) -> bool:
        """As the contract says."""
        behind_ns = self._behind_ns() if deadline_ns > self.now_ns else 0
        while not done():
            left_ns = deadline_ns - self.now_ns
            if left_ns <= 0:
                more_ns = self._behind_ns() - behind_ns
                if more_ns <= HELD_UP_NS:
                    return bool(done())  # while it was asked something may have come
                behind_ns += more_ns
                deadline_ns += more_ns
                continue
            self._watch()
            time.sleep(min(POLL_S, left_ns / NS_PER_S))
        return True
