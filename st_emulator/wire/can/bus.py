"""The CAN bus in virtual time, and the unit's controller on it.

A virtual interface such as vcan carries frames at once whatever the bit rate, so the emulator gives them the
time that they take on a wire: the bus carries one frame at a time, and of those that wait the one of the
lowest identifier goes first (ISO 11898-1). Frames of other nodes come from the link and take part like ours.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass

from ...clock import NS_PER_MS, NS_PER_S, ScheduledEvent, VirtualClock
from ...protocol.can.bits import (
    BUS_OFF_RECOVERY_BITS,
    SUSPEND_TRANSMISSION_BITS,
    bits_duration_ns,
    frame_duration_ns,
)
from ...protocol.can.frames import CanFrame
from ...protocol.can.vocabulary import CanState
from ...protocol.errors import LocalProtocolError
from .controller import (
    CLASS_CONTROLLER,
    CLASS_LOST_ARBITRATION,
    CONTROLLER_RX_OVERFLOW,
    BusError,
    FaultConfinement,
    failed_attempt_ns,
)

__all__ = ["BusError", "CanBus", "CanBusCounters", "CanBusSettings", "Disturbance"]

MOST_PENDING_FRAMES = 65_536  # of other nodes
RETRY_NS = NS_PER_MS  # ASSUMED: often enough beside frames of 0.1 ms, and no load while the link is stuck

Disturbance = Callable[[CanFrame, bool, int], BusError | None]


@dataclass(frozen=True)
class CanBusSettings:
    """Of a bus and the controller on it.

    ``bitrate`` and ``data_bitrate`` (of the data phase of CAN FD) in bit/s. ``hardware``: the link is a real
    bus, which takes its own time and has its own faults. ``bus_off_restart_ms``: from bus-off until the
    controller is told to recover.
    """

    bitrate: int
    data_bitrate: int
    hardware: bool = False
    bus_off_restart_ms: int = 100


@dataclass
class CanBusCounters:
    """Since power-on. ``error_frames`` are those of the modelled bus and the error messages of a real one."""

    tx_frames: int = 0
    rx_frames: int = 0
    error_frames: int = 0
    bus_off_count: int = 0
    arbitration_lost: int = 0
    tx_refused: int = 0
    rx_overruns: int = 0


@dataclass(slots=True)
class _Pending:
    """A frame of ours that has not left."""

    frame: CanFrame
    key: tuple[int, ...]
    handle: int
    on_sent: Callable[[], None]
    once: bool = False  # an attempt that fails is the last


_OthersFrame = tuple[tuple[int, ...], int, CanFrame]  # its key and the order of arrival decide


def _nothing() -> None:
    pass


def always() -> bool:
    """Nothing holds the bus."""
    return True


class CanBus:
    """The bus carries one frame or is idle; frames that come up in the same instant compete for it.

    Each frame takes its bits, the intermission included; at their end the receivers have it. A frame that an
    error destroyed is sent again until it gets through.

    Args:
        clock: the virtual clock.
        settings: bit rates and mode.
        transmit: hands a frame of ours to the link, at its end (hardware: at its start). False: the link
            cannot take it now; it is offered again each millisecond, and our other frames wait as long.
        receive: called with each frame of another node at its end.
        on_state: called with the state of the controller before and after a change; not by :meth:`reset`.
        disturbance: asked at the start of each attempt, with the frame, whether it is ours, and the time
            (ns); the error it returns destroys the attempt. Not asked with hardware.
        recovers: asked when the controller has been bus-off for long enough, and for as long again and again
            until it says that it comes back.
    """

    def __init__(
        self,
        clock: VirtualClock,
        settings: CanBusSettings,
        transmit: Callable[[CanFrame], bool],
        receive: Callable[[CanFrame], None],
        *,
        on_state: Callable[[CanState, CanState], None],
        disturbance: Disturbance | None = None,
        recovers: Callable[[], bool] = always,
    ) -> None:
        self._recovers = recovers
        self._clock = clock
        self.settings = settings
        self._transmit = transmit
        self._receive = receive
        self._on_state = on_state
        self._disturbance = None if settings.hardware else disturbance
        self.counters = CanBusCounters()
        self.listening = True
        self._faults = FaultConfinement()
        self._state = CanState.ERROR_ACTIVE
        self._recovery: ScheduledEvent | None = None
        self._sequence = 0
        self._own: dict[int, _Pending] = {}  # all that have not left, by handle
        self._waiting: list[tuple[tuple[int, ...], int]] = []  # a heap of those that can take part
        self._others: list[_OthersFrame] = []  # a heap
        self._busy = False
        self._on_wire: _Pending | None = None  # a frame of ours
        self._other_on_wire: _OthersFrame | None = None
        self._error: BusError | None = None  # that ends the attempt on the wire
        self._held: _Pending | None = None  # the link refused it
        self._retry: ScheduledEvent | None = None
        self._suspended_until_ns = 0
        self._arbitration: ScheduledEvent | None = None
        self._occupied_ns: dict[int, int] = {}  # by second

    # -- state

    @property
    def state(self) -> CanState:
        """Of the controller: error active, error passive or bus-off."""
        return self._state

    @property
    def transmit_error_count(self) -> int:
        return self._faults.transmit_error_count

    @property
    def receive_error_count(self) -> int:
        return self._faults.receive_error_count

    @property
    def queued_frames(self) -> int:
        """Frames of ours that have not left, one on the wire included."""
        return len(self._own)

    @property
    def load_permille(self) -> int:
        """How much of the last whole second the bus was occupied, in 0.1 %, error frames included."""
        busy_ns = self._occupied_ns.get(self._clock.now_ns // NS_PER_S - 1, 0)
        return min((busy_ns * 1000 + NS_PER_S // 2) // NS_PER_S, 1000)

    # -- frames in and out

    def send(self, frame: CanFrame, on_sent: Callable[[], None] = _nothing) -> int:
        """Give a frame to the controller; ``on_sent`` is called when the link has it and its bits are over.
        Frames of the same identifier leave in the order of these calls. Returns a handle for :meth:`cancel`.

        Raises:
            LocalProtocolError: an error message of SocketCAN, which no node can send.
        """
        if frame.error:
            raise LocalProtocolError("CAN frame", "error", True, "a frame that is on the bus")
        self._sequence += 1
        pending = _Pending(frame, frame.arbitration_key, self._sequence, on_sent)
        self._own[pending.handle] = pending
        self._enqueue(pending)
        return pending.handle

    def cancel(self, handle: int) -> bool:
        """Take a frame back. False: it is on the wire, or has left, or was taken back before."""
        pending = self._own.get(handle)
        if pending is None or pending is self._on_wire:
            return False
        del self._own[handle]
        if pending is self._held:
            self._forget_held()
            self._compete_at(self._clock.now_ns)
        else:
            self._waiting = [item for item in self._waiting if item[1] != handle]
            heapq.heapify(self._waiting)
        return True

    def give_up(self, handle: int) -> None:
        """As :meth:`cancel`; a frame that is on the wire is not sent again if this attempt fails."""
        if not self.cancel(handle) and (pending := self._own.get(handle)) is not None:
            pending.once = True

    def arrive(self, frame: CanFrame) -> None:
        """A frame, or an error message of the controller's driver, came from the link at the present time."""
        if frame.error:
            self._told(frame)
        elif self.settings.hardware:
            if self._state is CanState.BUS_OFF:  # a controller in bus-off receives nothing: it is back
                self._faults.reset()
                self._follow_faults()
            self._occupy(self._clock.now_ns, self._duration_ns(frame))
            if self.listening:
                self.counters.rx_frames += 1
                self._receive(frame)
        elif len(self._others) >= MOST_PENDING_FRAMES:
            self.counters.rx_overruns += 1
        else:
            self._sequence += 1
            heapq.heappush(self._others, (frame.arbitration_key, self._sequence, frame))
            self._compete_at(self._clock.now_ns)

    def reset(self) -> None:
        """Restart the controller: frames of ours that wait are forgotten and the error counters are 0. One on
        the wire is completed, but its sender is not told. Frames of other nodes and the counters stay.
        """
        self._own.clear()
        self._waiting.clear()
        self._forget_held()
        if self._recovery is not None:
            self._recovery.cancel()
            self._recovery = None
        self._suspended_until_ns = 0
        self._faults.reset()
        self._state = CanState.ERROR_ACTIVE

    # -- the bus

    def _duration_ns(self, frame: CanFrame) -> int:
        return frame_duration_ns(frame, self.settings.bitrate, self.settings.data_bitrate)

    def _enqueue(self, pending: _Pending) -> None:
        heapq.heappush(self._waiting, (pending.key, pending.handle))
        self._compete_at(self._clock.now_ns)

    def _compete_at(self, at_ns: int) -> None:
        """Have the bus given away at ``at_ns`` behind what else that instant brings."""
        if self._busy:
            return
        if self._arbitration is not None:
            if self._arbitration.at_ns <= at_ns:
                return
            self._arbitration.cancel()
        self._arbitration = self._clock.at(at_ns, self._arbitrate)

    def _arbitrate(self) -> None:
        self._arbitration = None
        own = self._waiting[0] if self._waiting and self._held is None else None
        if self._state is CanState.BUS_OFF:
            own = None
        others = self._others
        if own is not None and self._clock.now_ns < self._suspended_until_ns:
            own = None
            if not others:
                self._compete_at(self._suspended_until_ns)
        if others and (own is None or others[0][:2] < own):
            if own is not None:
                self.counters.arbitration_lost += 1
            self._other_on_wire = heapq.heappop(others)
            self._start(self._other_on_wire[2], own=False)
        elif own is not None:
            pending = self._own[heapq.heappop(self._waiting)[1]]
            if not self.settings.hardware or self._handed_over(pending):
                self._on_wire = pending
                self._start(pending.frame, own=True)

    def _start(self, frame: CanFrame, own: bool) -> None:
        now_ns = self._clock.now_ns
        self._busy = True
        self._error = None if self._disturbance is None else self._disturbance(frame, own, now_ns)
        if self._error is None:
            duration_ns = self._duration_ns(frame)
        else:
            rates = (self.settings.bitrate, self.settings.data_bitrate)
            duration_ns = failed_attempt_ns(frame, self._error, own, *rates)
        self._occupy(now_ns, duration_ns)
        self._clock.at(now_ns + duration_ns, self._end)

    def _end(self) -> None:
        self._busy = False
        if self._other_on_wire is not None:
            other, self._other_on_wire = self._other_on_wire, None
            self._others_frame_ended(other, self._error)
        elif self._on_wire is not None:
            self._own_frame_ended(self._on_wire, self._error)
        self._compete_at(self._clock.now_ns)

    def _others_frame_ended(self, other: _OthersFrame, error: BusError | None) -> None:
        if error is not None:
            heapq.heappush(self._others, other)  # its sender sends it again
        if not self.listening or self._state is CanState.BUS_OFF:
            return
        if error is None:
            self._faults.reception_succeeded()
            self._follow_faults()
            self.counters.rx_frames += 1
            self._receive(other[2])
        else:
            self.counters.error_frames += 1
            self._faults.reception_failed()
            self._follow_faults()

    def _own_frame_ended(self, pending: _Pending, error: BusError | None) -> None:
        if self.settings.hardware:
            self._on_wire = None
            self._left(pending)
            return
        if error is not None:
            self.counters.error_frames += 1
        sent = error is None and self._state is not CanState.BUS_OFF  # the link may have said so meanwhile
        if pending.handle in self._own:  # else a restart has forgotten it
            if error is not None:
                self._faults.transmission_failed(error)
            elif sent:
                self._faults.transmission_succeeded()
            if not sent and pending.once:
                del self._own[pending.handle]
            elif not sent:
                heapq.heappush(self._waiting, (pending.key, pending.handle))
            self._follow_faults()
            if self._state is CanState.ERROR_PASSIVE:
                pause_ns = bits_duration_ns(SUSPEND_TRANSMISSION_BITS, self.settings.bitrate)
                self._suspended_until_ns = self._clock.now_ns + pause_ns
        self._on_wire = None
        if sent and self._handed_over(pending):
            self._left(pending)

    # -- the link

    def _handed_over(self, pending: _Pending) -> bool:
        if self._transmit(pending.frame):
            self.counters.tx_frames += 1
            return True
        self.counters.tx_refused += 1
        if pending.once:
            self._own.pop(pending.handle, None)
        elif pending.handle in self._own:
            self._held = pending
            self._retry = self._clock.after(RETRY_NS, self._offer_again)
        return False

    def _offer_again(self) -> None:
        pending, self._retry = self._held, None
        if pending is None or self._state is CanState.BUS_OFF:  # the recovery offers it
            return
        self._held = None
        if self.settings.hardware:
            self._enqueue(pending)
        elif self._handed_over(pending):
            self._left(pending)
            self._compete_at(self._clock.now_ns)

    def _left(self, pending: _Pending) -> None:
        if self._own.pop(pending.handle, None) is not None:  # else a restart has forgotten it
            pending.on_sent()

    def _forget_held(self) -> None:
        self._held = None
        if self._retry is not None:
            self._retry.cancel()
            self._retry = None

    # -- faults

    def _told(self, message: CanFrame) -> None:
        self.counters.error_frames += 1
        if message.identifier & CLASS_LOST_ARBITRATION:
            self.counters.arbitration_lost += 1
        if message.identifier & CLASS_CONTROLLER and message.data[1] & CONTROLLER_RX_OVERFLOW:
            self.counters.rx_overruns += 1
        self._faults.told(message)
        self._follow_faults()

    def _follow_faults(self) -> None:
        before, self._state = self._state, self._faults.state
        if before is self._state:
            return
        if self._state is CanState.BUS_OFF:
            self.counters.bus_off_count += 1
            if not self.settings.hardware:  # a real controller says so when it is back
                # ASSUMED: nobody sends meanwhile; the real count stretches with the frames of others.
                wait_ns = bits_duration_ns(BUS_OFF_RECOVERY_BITS, self.settings.bitrate)
                wait_ns += self.settings.bus_off_restart_ms * NS_PER_MS
                self._recovery = self._clock.after(wait_ns, self._recover)
        elif before is CanState.BUS_OFF:
            if self._recovery is not None:
                self._recovery.cancel()
                self._recovery = None
            if self._held is not None and self._retry is None:
                self._retry = self._clock.after(0, self._offer_again)
            self._compete_at(self._clock.now_ns)
        self._on_state(before, self._state)

    def _recover(self) -> None:
        self._recovery = None
        if not self._recovers():  # it counts its eleven recessive bits anew
            wait_ns = bits_duration_ns(BUS_OFF_RECOVERY_BITS, self.settings.bitrate)
            self._recovery = self._clock.after(wait_ns, self._recover)
            return
        self._faults.reset()
        self._follow_faults()

    def _occupy(self, start_ns: int, duration_ns: int) -> None:
        second, offset_ns = divmod(start_ns, NS_PER_S)
        while duration_ns > 0:
            part_ns = min(duration_ns, NS_PER_S - offset_ns)
            self._occupied_ns[second] = self._occupied_ns.get(second, 0) + part_ns
            duration_ns -= part_ns
            second, offset_ns = second + 1, 0
        if len(self._occupied_ns) > 4:
            oldest = self._clock.now_ns // NS_PER_S - 1
            self._occupied_ns = {key: ns for key, ns in self._occupied_ns.items() if key >= oldest}
