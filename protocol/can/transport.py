"""Packets over CAN frames: ISO-TP (ISO 15765-2:2016) without input or output of its own.

The caller moves the frames and keeps the clock: every method that needs the time takes it in nanoseconds of
any one clock that does not run backwards.

    connection.send(packet, now_ns)
    frame = connection.next_frame(now_ns)       # to the controller; later connection.confirmed(frame, ...)
    events = connection.receive(frame, now_ns)  # from the bus
    events = connection.poll(now_ns)            # no later than connection.next_deadline_ns()

Functional addressing, extended and mixed addresses are not used here: each side has one identifier.
"""

from __future__ import annotations

from ..errors import LocalProtocolError
from .frames import CanFrame
from .receiving import PduReceiver
from .sending import PduSender
from .transfer import (
    CONSECUTIVE,
    FIRST,
    FLOW_CONTROL,
    MAX_PDU_BYTES,
    NEVER_NS,
    SINGLE,
    FrameIgnored,
    IsoTpCounters,
    IsoTpEvent,
    IsoTpSettings,
    PduReceived,
    PduSent,
    ReceptionFailed,
    TransmissionFailed,
)
from .vocabulary import TransferFailure

__all__ = [
    "FrameIgnored",
    "IsoTpConnection",
    "IsoTpCounters",
    "IsoTpEvent",
    "IsoTpSettings",
    "PduReceived",
    "PduSent",
    "ReceptionFailed",
    "TransmissionFailed",
]


class IsoTpConnection:
    """One end of a connection, full duplex: a PDU may come while another goes (9.8.3).

    A timer that ends at t is over for everything that happens at t or later, whether :meth:`poll` was called
    then or not: a frame that comes too late rescues nothing, and a late poll harms nothing as long as what
    came before was handed over before, with its time.

    Whatever stands on the identifier is a value: progress of a PDU, or an event in the list that is returned,
    counted in ``counters``.
    """

    def __init__(self, settings: IsoTpSettings) -> None:
        self.settings = settings
        self.counters = IsoTpCounters()
        self._receiver = PduReceiver(settings, self.counters)
        self._sender = PduSender(settings, self.counters)
        self._receive_identifier = settings.receive_identifier
        self._extended = settings.extended
        self._fd = settings.fd

    def receive(self, frame: CanFrame, now_ns: int) -> list[IsoTpEvent]:
        """A frame came at ``now_ns``. Frames with other identifiers, remote and error frames are not for us.

        ASSUMED: a connection of CAN FD also takes classic frames, which ISO keeps apart (N_TAtype); one
        of classic CAN ignores those of CAN FD, as its controller would.
        """
        if (
            frame.identifier != self._receive_identifier
            or frame.extended != self._extended
            or frame.remote
            or frame.error
        ):
            return []
        events = self._expire(now_ns)
        data = frame.data
        kind = data[0] >> 4 if data else None
        if kind is None:
            events.append(FrameIgnored(TransferFailure.BAD_LENGTH, now_ns))
        elif frame.fd and not self._fd:
            events.append(FrameIgnored(TransferFailure.BAD_PCI, now_ns))
        elif kind == CONSECUTIVE:
            events += self._receiver.consecutive(data, now_ns)
        elif kind == FLOW_CONTROL:
            event = self._sender.flow_control(data, now_ns)
            if event is not None:
                events.append(event)
        elif kind == SINGLE:
            events += self._receiver.single(data, now_ns)
        elif kind == FIRST:
            events += self._receiver.first(data, now_ns)
        else:
            events.append(FrameIgnored(TransferFailure.BAD_PCI, now_ns))
        return self._counted(events)

    def send(self, data: bytes, now_ns: int) -> None:
        """Begin a PDU; its frames come out of :meth:`next_frame`.

        Raises:
            LocalProtocolError: one is still under way (see ``sending``), ``data`` is empty or has more bytes
                than FF_DL can say.
        """
        if self._sender.sending:
            raise LocalProtocolError("IsoTpConnection", "data", data, "nothing while a PDU is being sent")
        if not 0 < len(data) <= MAX_PDU_BYTES:
            raise LocalProtocolError("IsoTpConnection", "data", data, f"1 to {MAX_PDU_BYTES} bytes")
        self._sender.send(bytes(data), now_ns)

    @property
    def sending(self) -> bool:
        """A PDU of ours is under way."""
        return self._sender.sending

    @property
    def unconfirmed(self) -> tuple[CanFrame, ...]:
        """The frames handed over whose confirmation matters still. Any other one that waits in the
        controller, after a failure or a reset, is to be taken out of its queue.
        """
        handed_over = (self._receiver.handed_over, self._sender.handed_over)
        return tuple(frame for frame in handed_over if frame is not None)

    def next_frame(self, now_ns: int) -> CanFrame | None:
        """The next frame for the controller, flow control first; None: nothing now.

        It is handed over by this call, and N_As or N_Ar runs. Of each kind, flow control and others, there is
        never a second one before the first was confirmed.
        """
        return self._receiver.next_frame(now_ns) or self._sender.next_frame(now_ns)

    def confirmed(self, frame: CanFrame, now_ns: int, *, left_ns: int | None = None) -> list[IsoTpEvent]:
        """``frame``, handed over before, has left: the bus acknowledged it. One that is not awaited (any
        more) changes nothing.

        ``left_ns`` is for whoever learns of it late (None: at once): no timer that ends between the two times
        fails by this call, and what begins with the confirmation begins at ``now_ns``.
        """
        events = self._expire(now_ns if left_ns is None else left_ns)
        if frame is self._sender.handed_over or frame == self._sender.handed_over:
            event = self._sender.confirmed(now_ns)
            if event is not None:
                events.append(event)
        elif frame == self._receiver.handed_over:
            self._receiver.confirmed(now_ns)
        return self._counted(events)

    def poll(self, now_ns: int) -> list[IsoTpEvent]:
        """The failures of timers that are over, in the order of their ends."""
        return self._counted(self._expire(now_ns))

    def next_deadline_ns(self) -> int | None:
        """The earliest time at which :meth:`poll` or :meth:`next_frame` has something to do, which may be
        past; None: only a frame, a confirmation or a PDU changes anything.
        """
        receiver, sender = self._receiver, self._sender
        earliest_ns = min(
            receiver.ready_ns,
            receiver.reception_deadline_ns,
            receiver.flow_control_deadline_ns,
            sender.ready_ns,
            sender.deadline_ns,
        )
        return earliest_ns if earliest_ns < NEVER_NS else None

    def reset(self) -> None:
        """Forget everything under way in both directions; the counters stay."""
        self._receiver.clear()
        self._sender.clear()

    def abort_sending(self) -> None:
        """Give up the PDU under way, counted as ABORTED; the other side's N_Cr ends its reception."""
        if self._sender.sending:
            self._counted([self._sender.fail(TransferFailure.ABORTED, 0)])

    def _expire(self, now_ns: int) -> list[IsoTpEvent]:
        receiver = self._receiver
        events: list[IsoTpEvent] = []
        if now_ns >= receiver.reception_deadline_ns or now_ns >= receiver.flow_control_deadline_ns:
            events += receiver.expire(now_ns)
        if now_ns >= self._sender.deadline_ns:
            event = self._sender.expire(now_ns)
            if event is not None:
                events.append(event)
                events.sort(key=lambda event: event.time_ns)
        return events

    def _counted(self, events: list[IsoTpEvent]) -> list[IsoTpEvent]:
        for event in events:
            self.counters.count(event)
        return events
