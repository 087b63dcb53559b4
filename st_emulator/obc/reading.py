"""How an OBC listens: beside its caller in a thread, or step by step under somebody else's clock."""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Protocol

from ..clock import NS_PER_S
from ..links import Link, LinkError

POLL_INTERVAL_S = 0.001
STEPPED_EPOCH = datetime(2026, 1, 1, tzinfo=UTC)
TakeBytes = Callable[[bytes, int], bool]
NextDeadline = Callable[[], int | None]
WAKE_BYTES = 512
HELD_UP_NS = 20_000_000
"""Later than this after a deadline: the thread was held up."""
LONGEST_EXCUSE_NS = NS_PER_S
"""A deadline that passed in the meantime is put off by as long as the thread was held up, at most by this."""


def never() -> int | None:
    """No deadline."""
    return None


class Reader(Protocol):
    """Brings what arrives on a link to `take(data, now_ns)` and lets a caller wait for what comes of it.

    `take` is called with `lock` held, and never twice at the same time; with b"" when nothing arrived by the
    time that `next_deadline_ns` gives. It says whether anything came of it that a caller may wait for.
    """

    lock: threading.RLock

    def now_ns(self) -> int:
        """The reader's time, nanoseconds from an arbitrary start."""
        ...

    def utc_now(self) -> datetime:
        """The civil time that belongs to `now_ns()`."""
        ...

    def start(self, link: Link, take: TakeBytes, next_deadline_ns: NextDeadline = never) -> None:
        """Begin to listen. `next_deadline_ns` is called with `lock` held."""
        ...

    def wake(self) -> None:
        """Somebody else than `take` has brought the next deadline forward."""
        ...

    def wait(self, done: Callable[[], bool], deadline_ns: int) -> bool:
        """Listen until `done()` (True) or `deadline_ns` (False); `done` is called with `lock` held.

        LinkError when the link has gone.
        """
        ...

    def stop(self) -> None:
        """Listen no more; the link itself stays open."""
        ...


class LiveReader:
    """Listens in a thread of its own, in real time: a byte's time is when it was read."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self._changed = threading.Condition(self.lock)
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self._failure: Exception | None = None
        self._wake_fd = -1

    def now_ns(self) -> int:
        """The computer's monotonic clock."""
        return time.monotonic_ns()

    def utc_now(self) -> datetime:
        """The computer's civil time."""
        return datetime.now(UTC)

    def start(self, link: Link, take: TakeBytes, next_deadline_ns: NextDeadline = never) -> None:
        """Begin to listen."""
        wake_read_fd, self._wake_fd = os.pipe()
        os.set_blocking(self._wake_fd, False)
        self._thread = threading.Thread(
            target=self._listen,
            args=(link, take, next_deadline_ns, wake_read_fd),
            name="obc-reader",
            daemon=True,
        )
        self._thread.start()

    def wake(self) -> None:
        """Let the thread look at the deadline anew."""
        with contextlib.suppress(OSError):  # it is awake already, or has ended
            os.write(self._wake_fd, b"w")

    def wait(self, done: Callable[[], bool], deadline_ns: int) -> bool:
        """Sleep until `done()` or the deadline; what the thread could not do is raised here."""
        with self._changed:
            while not done():
                if self._failure is not None:
                    raise self._failure
                left_ns = deadline_ns - self.now_ns()
                if left_ns <= 0:
                    return False
                self._changed.wait(left_ns / 1e9)
            return True

    def stop(self) -> None:
        """End the thread."""
        if self._thread is None:
            return
        self._stopping.set()
        os.close(self._wake_fd)  # its other end becomes readable
        self._wake_fd = -1
        self._thread.join()
        self._thread = None

    def _listen(self, link: Link, take: TakeBytes, next_deadline_ns: NextDeadline, wake_fd: int) -> None:
        try:
            fd = link.fileno()
            waited_for = [wake_fd] if fd is None else [fd, wake_fd]
            most_s = POLL_INTERVAL_S if fd is None else None
            excused: tuple[int, int] | None = None  # a deadline, and when it ends instead
            while not self._stopping.is_set():
                with self.lock:
                    due_ns = next_deadline_ns()
                ends_ns = due_ns
                if excused is not None and excused[0] == due_ns:
                    ends_ns = excused[1]
                timeout_s = most_s
                if ends_ns is not None:
                    left_s = max(0, ends_ns - self.now_ns()) / 1e9
                    timeout_s = left_s if most_s is None else min(left_s, most_s)
                ready, _, _ = select.select(waited_for, [], [], timeout_s)
                if wake_fd in ready:
                    os.read(wake_fd, WAKE_BYTES)
                data = link.read()
                now_ns = self.now_ns()
                if data and due_ns is not None and now_ns - due_ns > HELD_UP_NS:
                    # It came while the computer did not let this thread run, nobody knows when: no timeout
                    # passes while its answer waits here.
                    with self._changed:
                        take(data, due_ns - 1)
                        self._changed.notify_all()
                    continue
                if due_ns is not None and due_ns == ends_ns and now_ns - due_ns > HELD_UP_NS:
                    # Who is to answer may run on this computer, and was held up as well.
                    excused = due_ns, now_ns + min(now_ns - due_ns, LONGEST_EXCUSE_NS)
                    continue
                if data or (ends_ns is not None and now_ns >= ends_ns):
                    with self._changed:
                        if take(data, now_ns):
                            self._changed.notify_all()
        except Exception as error:  # whatever it is, it must reach the caller: nobody looks at a thread
            with self._changed:
                self._failure = error
                self._changed.notify_all()
        finally:
            os.close(wake_fd)


class SteppedReader:
    """Listens only while somebody waits, and makes the time itself: `step(now_ns)` runs the other side.

    Nothing depends on the computer's clock, so that a run gives the same every time. With `next_event_ns`,
    which tells when the other side has something to do next, a step goes from event to event, and what
    comes is seen when it comes; without it a step takes `step_ns`. `epoch` is the civil time at the start,
    `now_ns` the time then.
    """

    def __init__(
        self,
        step: Callable[[int], None],
        step_ns: int = 1_000_000,
        *,
        next_event_ns: NextDeadline | None = None,
        epoch: datetime = STEPPED_EPOCH,
        now_ns: int = 0,
    ) -> None:
        self.lock = threading.RLock()
        self._step = step
        self._step_ns = step_ns
        self._next_event_ns = next_event_ns
        self._epoch = epoch
        self._begun_ns = self._now_ns = now_ns
        self._link: Link | None = None
        self._take: TakeBytes | None = None
        self._next_deadline_ns: NextDeadline = never

    def now_ns(self) -> int:
        """Steps so far, as time."""
        return self._now_ns

    def utc_now(self) -> datetime:
        """Steps so far, counted from the epoch."""
        return self._epoch + timedelta(microseconds=(self._now_ns - self._begun_ns) // 1000)

    def start(self, link: Link, take: TakeBytes, next_deadline_ns: NextDeadline = never) -> None:
        """Begin to listen."""
        self._link, self._take, self._next_deadline_ns = link, take, next_deadline_ns

    def wake(self) -> None:
        """Nothing: the deadline is looked at before each step."""

    def wait(self, done: Callable[[], bool], deadline_ns: int) -> bool:
        """Make steps until `done()` or the deadline; a step ends early where `next_deadline_ns` says so."""
        if self._link is None or self._take is None:
            raise LinkError("stepped: the reader is not listening to any link")
        while True:
            data = self._link.read()
            due_ns = self._next_deadline_ns()
            if data or (due_ns is not None and due_ns <= self._now_ns):
                self._take(data, self._now_ns)
            if done():
                return True
            if self._now_ns >= deadline_ns:
                return False
            next_ns = min(self._end_of_step_ns(), deadline_ns)
            due_ns = self._next_deadline_ns()
            if due_ns is not None and self._now_ns < due_ns < next_ns:
                next_ns = due_ns
            self._now_ns = next_ns
            self._step(next_ns)

    def _end_of_step_ns(self) -> int:
        if self._next_event_ns is None:
            return self._now_ns + self._step_ns
        self._step(self._now_ns)  # what was written to the other side may bring its next event forward
        event_ns = self._next_event_ns()
        return self._now_ns + NS_PER_S if event_ns is None else max(event_ns, self._now_ns)

    def stop(self) -> None:
        """Listen no more."""
        self._link = self._take = None
