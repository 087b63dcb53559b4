"""Frames on their way out: one at a time to the controller, in the order in which they were made.

So a TPDO of a low identifier does not overtake the ones before it, as with the queue of the real card's
driver (ASSUMED); against frames of other nodes each takes part by its identifier.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

from ...firmware_model.link_work import packet_work
from ...firmware_model.work import Work
from ...protocol.can.bits import frame_duration_ns
from ...protocol.can.frames import CanFrame
from ...protocol.canopen.node import LATEST_ONLY, NodeFrame
from ...wire.can.bus import CanBus

MOST_WAITING: Final = 512  # ASSUMED: four blocks of a transfer


class Transmitter:
    """The queue.

    Args:
        bus: takes a frame and says when it has left.
        on_left: called then, and told how many frames were lost before.
    """

    def __init__(self, bus: CanBus, on_left: Callable[[NodeFrame], None]) -> None:
        self._bus = bus
        self._on_left = on_left
        self._waiting: deque[NodeFrame] = deque()
        self._under_way: NodeFrame | None = None
        self._work = Work()
        self.frames = 0
        self.lost = 0

    def reset(self) -> None:
        """What waits is forgotten; the bus is reset by whoever holds it."""
        self._waiting.clear()
        self._under_way = None

    def clear_counters(self) -> None:
        """Count from 0."""
        self.frames = self.lost = 0

    def queue(self, frame: NodeFrame) -> None:
        """Behind those that wait. A PDO or heartbeat that still waits is replaced by a newer one; a frame for
        which there is no room is lost.
        """
        if frame.kind in LATEST_ONLY:
            older = [
                one for one in self._waiting if (one.identifier, one.kind) == (frame.identifier, frame.kind)
            ]
            for one in older:
                self._waiting.remove(one)
                self.lost += 1
        if len(self._waiting) >= MOST_WAITING:
            self.lost += 1
            return
        self._waiting.append(frame)
        self._next()

    def _next(self) -> None:
        if self._under_way is None and self._waiting:
            self._under_way = self._waiting.popleft()
            self._bus.send(CanFrame(self._under_way.identifier, self._under_way.data), self._left)

    def _left(self) -> None:
        frame, self._under_way = self._under_way, None
        assert frame is not None
        self.frames += 1
        self._work += packet_work(len(frame.data))
        self._next()
        self._on_left(frame)

    def drain_ns(self) -> int:
        """Time that the frames that wait take on an idle bus."""
        frames = [*self._waiting] if self._under_way is None else [self._under_way, *self._waiting]
        settings = self._bus.settings
        return sum(
            frame_duration_ns(CanFrame(one.identifier, one.data), settings.bitrate, settings.data_bitrate)
            for one in frames
        )

    def take_work(self) -> Work:
        """The processor's work for frames that have left since the last call."""
        work, self._work = self._work, Work()
        return work
