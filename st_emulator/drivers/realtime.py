"""The pacer: virtual time against the computer's clock. The only place that looks at it while a unit runs.

The loop waits in ``select`` for the OBC's bytes or the next event. Frames are computed in a worker thread,
started at their exposure, so that no telecommand waits for pixels.
"""

from __future__ import annotations

import contextlib
import gc
import os
import select
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from types import FrameType
from typing import Any, Protocol

from ..bench.emulator import Emulator
from ..clock import NS_PER_S
from ..links import Link
from .control_server import ControlServer

POLL_S = 0.02  # for links that cannot be waited for
LONGEST_WAIT_S = 0.5
HELD_UP_NS = 20_000_000  # later than this after what was due: the computer did not let the loop run
CATCH_UP = 1.25  # ASSUMED: little enough that who answers in time at the unit's own pace still does
SWITCH_INTERVAL_S = 0.0005  # the worker gives way to the loop this soon
LOOP_PRIORITY = 1  # the least of the real-time priorities


class FrameWorker:
    """Computes frames in order in a thread beside the loop."""

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="frame", initializer=behind_the_loop)

    def submit(self, compute: Callable[[], Any]) -> Future[Any]:
        return self._executor.submit(compute)

    def close(self) -> None:
        self._executor.shutdown(wait=True, cancel_futures=True)


class StopSignal:
    """SIGINT and SIGTERM end a run at once and cleanly: they wake the loop and set a flag."""

    def __init__(self) -> None:
        self.stopped = False
        self._interrupts = False
        self._read, self._write = socket.socketpair()
        self._read.setblocking(False)
        self._write.setblocking(False)

    def fileno(self) -> int:
        return self._read.fileno()

    def stop(self) -> None:
        self.stopped = True
        with contextlib.suppress(OSError):
            self._write.send(b"x")

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.stop()
        if self._interrupts:
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def interrupting(self) -> Iterator[None]:
        """In the block a signal raises KeyboardInterrupt: for work that does not look at the flag."""
        if self.stopped:
            raise KeyboardInterrupt
        self._interrupts = True
        try:
            yield
        finally:
            self._interrupts = False

    @contextlib.contextmanager
    def installed(self) -> Iterator[StopSignal]:
        """Handle the signals while in the block."""
        before = {number: signal.signal(number, self._handle) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def close(self) -> None:
        self._read.close()
        self._write.close()


@contextlib.contextmanager
def quick_switching() -> Iterator[None]:
    """Short thread switches and no collection of long-lived objects while in real time."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)


@contextlib.contextmanager
def ahead_of_others() -> Iterator[bool]:
    """The calling thread goes before other work on the computer where the system lets it (root, or a limit on
    real-time priority), for a woken loop waits for milliseconds on a busy machine. Yields whether it does.
    Threads that it starts meanwhile do so too.
    """
    try:
        policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(LOOP_PRIORITY))
    except (AttributeError, OSError):  # no such thing here, or not for us
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, policy, parameters)


def behind_the_loop() -> None:
    """The calling thread, started by the loop, goes with other work: it may compute for long."""
    with contextlib.suppress(AttributeError, OSError):
        if os.sched_getscheduler(0) == os.SCHED_FIFO:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


class Pace:
    """Virtual time by the computer's clock: ``speed`` times as fast.

    When the computer did not let the loop run, what was due then comes late, but one after the other at
    ``CATCH_UP`` times the pace until the delay is made up. At once it would be a burst that no line carries,
    and timeouts of the unit would pass before anybody could have answered what it has just sent.
    """

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._origin_ns = time.monotonic_ns()
        self._from_ns: int | None = None  # the computer's clock where catching up began
        self._reached_ns = 0  # virtual, there

    def now_ns(self) -> int:
        """Virtual time."""
        wall_ns = time.monotonic_ns()
        now_ns = int((wall_ns - self._origin_ns) * self._speed)
        if self._from_ns is not None:
            late_ns = self._reached_ns + int((wall_ns - self._from_ns) * self._speed * CATCH_UP)
            if late_ns < now_ns:
                return late_ns
            self._from_ns = None
        return now_ns

    def wait_s(self, due_ns: int) -> float:
        """How long it takes until ``due_ns``."""
        pace = self._speed if self._from_ns is None else self._speed * CATCH_UP
        return (due_ns - self.now_ns()) / pace / NS_PER_S

    def held_up(self, emulator: Emulator) -> bool:
        """Whether the computer did not let the loop run when something was due; if so, catch up from there.

        What came meanwhile came nobody knows when. It counts before what was due: a timeout of the unit must
        not pass while its answer waits in the link.
        """
        due_ns = emulator.next_event_ns()
        if due_ns is None or self.now_ns() - due_ns <= HELD_UP_NS * max(1.0, self._speed):
            return False
        self._from_ns, self._reached_ns = time.monotonic_ns(), max(due_ns, emulator.now_ns)
        return True


class Beside(Protocol):
    """Who is attended to between two events: ``fileno`` becomes readable when there is something to do."""

    def fileno(self) -> int: ...

    def attend(self) -> None: ...


def run_paced(
    emulator: Emulator,
    link: Link,
    *,
    stop: StopSignal,
    speed: float = 1.0,
    until_ns: int | None = None,
    on_wait: Callable[[], None] = lambda: None,
    control: ControlServer | None = None,
    beside: Beside | None = None,
) -> None:
    """Run at ``speed`` times real time until ``until_ns`` (virtual) or a signal.

    ``on_wait`` is called about twice a second when nothing is due (progress, flushing of files). ``control``
    is served between events; ``beside`` is attended to at the present time when it asks for it.
    """
    descriptor = link.fileno()
    pace = Pace(speed)
    last_wait_ns = time.monotonic_ns()
    # Only where somebody listens in real time: the loop then sleeps nearly always.
    priority = ahead_of_others() if speed == 1 and descriptor is not None else contextlib.nullcontext()
    with quick_switching(), priority:
        while not stop.stopped:
            if pace.held_up(emulator) and (data := link.read()):
                emulator.receive(data)
            now_ns = pace.now_ns()
            if until_ns is not None and now_ns >= until_ns:
                emulator.advance(until_ns)
                break
            emulator.advance(now_ns)
            due_ns = emulator.next_event_ns()
            if until_ns is not None:
                due_ns = until_ns if due_ns is None else min(due_ns, until_ns)
            wall_ns = time.monotonic_ns()
            wait_s = LONGEST_WAIT_S if due_ns is None else pace.wait_s(due_ns)
            if wall_ns - last_wait_ns > NS_PER_S // 2 and wait_s > 0.002:
                last_wait_ns = wall_ns
                on_wait()
                continue
            wait_s = min(max(wait_s, 0.0), LONGEST_WAIT_S if descriptor is not None else POLL_S)
            waited_for: list[Any] = [item for item in (stop, descriptor, beside) if item is not None]
            readers, writers = ([], []) if control is None else (control.readers(), control.writers())
            ready, writable, _ = select.select([*waited_for, *readers], writers, [], wait_s)
            asked = bool(writable) or any(one is beside or one in readers for one in ready)
            if asked and not pace.held_up(emulator):
                emulator.advance(pace.now_ns())  # what a client sees and does is of now
            if control is not None:
                control.serve()
            if beside is not None and beside in ready:
                beside.attend()
            if descriptor is None or descriptor in ready:
                data = link.read()
                if data:
                    if not pace.held_up(emulator):
                        # Everything due before the bytes came is done before they count.
                        emulator.advance(pace.now_ns())
                    emulator.receive(data)


def run_lockstep(
    emulator: Emulator,
    control: ControlServer,
    *,
    stop: StopSignal,
    until_ns: int | None = None,
    on_wait: Callable[[], None] = lambda: None,
) -> None:
    """Let a client of ``control`` step the unit until ``until_ns`` (virtual) or a signal.

    ``on_wait`` is called when it has been silent for a while.
    """
    while not stop.stopped and (until_ns is None or emulator.now_ns < until_ns):
        try:
            with stop.interrupting():  # a step may be long
                served = control.serve(LONGEST_WAIT_S, stop)
        except KeyboardInterrupt:
            break
        if not served:
            on_wait()


def run_unpaced(
    emulator: Emulator,
    *,
    stop: StopSignal,
    until_ns: int,
    on_step: Callable[[], None] = lambda: None,
) -> None:
    """Run as fast as the computer can until ``until_ns`` (virtual) or a signal."""
    step_ns = NS_PER_S
    while not stop.stopped and emulator.now_ns < until_ns:
        emulator.advance(min(until_ns, emulator.now_ns + step_ns))
        on_step()
