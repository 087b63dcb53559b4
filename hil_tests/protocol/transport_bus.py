"""A bus in virtual time between two ends of ISO-TP, whoever made them; what may happen to a frame on it."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

from st_emulator.protocol.can.frames import CanFrame
from st_emulator.protocol.can.transport import (
    IsoTpConnection,
    IsoTpEvent,
    IsoTpSettings,
    PduReceived,
    PduSent,
)

US = 1_000
MS = 1_000_000
S = 1_000_000_000
FRAME_NS = 100 * US  # about a classic frame of 8 bytes at 1 Mbit/s


class End(Protocol):
    """What the bus needs of a side."""

    def receive(self, frame: CanFrame, now_ns: int) -> None: ...
    def confirmed(self, frame: CanFrame, now_ns: int) -> None: ...
    def next_frame(self, now_ns: int) -> CanFrame | None: ...
    def poll(self, now_ns: int) -> None: ...
    def next_deadline_ns(self, now_ns: int) -> int | None: ...


class Ours:
    """An end of ours that keeps its events; ``to_send`` goes out one after the other."""

    def __init__(self, settings: IsoTpSettings) -> None:
        self.connection = IsoTpConnection(settings)
        self.events: list[IsoTpEvent] = []
        self.to_send: deque[bytes] = deque()
        self.received_from_bus = 0

    def receive(self, frame: CanFrame, now_ns: int) -> None:
        self.received_from_bus += 1
        self.events += self.connection.receive(frame, now_ns)

    def confirmed(self, frame: CanFrame, now_ns: int) -> None:
        self.events += self.connection.confirmed(frame, now_ns)

    def next_frame(self, now_ns: int) -> CanFrame | None:
        if self.to_send and not self.connection.sending:
            self.connection.send(self.to_send.popleft(), now_ns)
        return self.connection.next_frame(now_ns)

    def poll(self, now_ns: int) -> None:
        self.events += self.connection.poll(now_ns)

    def next_deadline_ns(self, now_ns: int) -> int | None:
        return self.connection.next_deadline_ns()

    @property
    def received(self) -> list[bytes]:
        return [event.data for event in self.events if isinstance(event, PduReceived)]

    @property
    def sent(self) -> list[int]:
        return [event.length for event in self.events if isinstance(event, PduSent)]

    @property
    def failures(self) -> list[tuple[str, str]]:
        """(kind of event, reason) of everything that did not go well, in its order."""
        return [
            (type(event).__name__, event.reason.name)
            for event in self.events
            if not isinstance(event, PduReceived | PduSent)
        ]

    def is_idle(self) -> bool:
        return not self.to_send and self.connection.next_deadline_ns() is None


@dataclass(frozen=True)
class Fate:
    """``acknowledged`` False: it never leaves, and its sender hears nothing. ``arrivals_ns``: how long after
    its end it comes to the other side, once each; none: it is lost there.
    """

    acknowledged: bool = True
    arrivals_ns: tuple[int, ...] = (0,)


GOOD = Fate()
LOST = Fate(arrivals_ns=())
TWICE = Fate(arrivals_ns=(0, 0))
NOT_ACKNOWLEDGED = Fate(acknowledged=False, arrivals_ns=())


@dataclass(frozen=True)
class OnWire:
    frame: CanFrame
    handed_over_ns: int
    ended_ns: int


@dataclass
class Bus:
    """One frame at a time; of two that wait the one with the lower arbitration key goes first. ``fate`` is
    asked with the number of each frame, from 0, and the frame.
    """

    ends: tuple[End, End]
    fate: Callable[[int, CanFrame], Fate] = lambda number, frame: GOOD
    frame_ns: int = FRAME_NS
    now_ns: int = 0
    log: list[OnWire] = field(default_factory=list)
    frames: int = 0

    def __post_init__(self) -> None:
        self._queues: tuple[deque[tuple[CanFrame, int]], ...] = (deque(), deque())
        self._wire: tuple[int, CanFrame, int, int] | None = None  # end, frame, handed over, ends at
        self._arrivals: list[tuple[int, int, int, CanFrame]] = []
        self._order = 0

    def run(self, until_ns: int = 60 * S) -> None:
        """Up to ``until_ns``, or when nothing will happen any more."""
        while True:
            self._work()
            times = [time for end in self.ends if (time := end.next_deadline_ns(self.now_ns)) is not None]
            assert all(time > self.now_ns for time in times), "a deadline that is over, and nothing was done"
            if self._wire:
                times.append(self._wire[3])
            if self._arrivals:
                times.append(self._arrivals[0][0])
            if not times or min(times) > until_ns:
                return
            self.now_ns = min(times)

    def _work(self) -> None:
        """Everything that happens at the present time."""
        if self._wire and self._wire[3] <= self.now_ns:
            self._finish(*self._wire)
        while self._arrivals and self._arrivals[0][0] <= self.now_ns:
            _, _, to, frame = heapq.heappop(self._arrivals)
            self.ends[to].receive(frame, self.now_ns)
        for end in self.ends:
            end.poll(self.now_ns)
        for end, queue in zip(self.ends, self._queues, strict=True):
            while (frame := end.next_frame(self.now_ns)) is not None:
                queue.append((frame, self.now_ns))
        if self._wire is None and any(self._queues):
            waiting = [number for number, queue in enumerate(self._queues) if queue]
            sender = min(waiting, key=lambda number: self._queues[number][0][0].arbitration_key)
            frame, handed_over_ns = self._queues[sender].popleft()
            self._wire = (sender, frame, handed_over_ns, self.now_ns + self.frame_ns)

    def _finish(self, sender: int, frame: CanFrame, handed_over_ns: int, ended_ns: int) -> None:
        self._wire = None
        fate = self.fate(self.frames, frame)
        self.frames += 1
        if fate.acknowledged:
            self.log.append(OnWire(frame, handed_over_ns, ended_ns))
            self.ends[sender].confirmed(frame, ended_ns)
        for delay_ns in fate.arrivals_ns:
            self._order += 1
            heapq.heappush(self._arrivals, (ended_ns + delay_ns, self._order, 1 - sender, frame))


def pair(**choices: object) -> tuple[IsoTpSettings, IsoTpSettings]:
    """Settings of two ends that fit; ``choices`` are of both."""
    identifiers = (0x18DAF110, 0x18DA10F1) if choices.get("extended") else (0x58A, 0x60A)
    one = IsoTpSettings(*identifiers, **choices)  # type: ignore[arg-type]
    return one, replace(one, transmit_identifier=identifiers[1], receive_identifier=identifiers[0])
