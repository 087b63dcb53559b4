"""Packets by ISO-TP on the CAN bus, and the cyclic frames beside them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from ..clock import ScheduledEvent, VirtualClock
from ..protocol.can_bits import frame_duration_ns
from ..protocol.can_frames import CanFrame, RecordDecoder, encode_record
from ..protocol.can_messages import TELECOMMAND, CanIdentifiers, decode_can_message, encode_can_message
from ..protocol.can_transport import (
    FrameIgnored,
    IsoTpConnection,
    IsoTpEvent,
    IsoTpSettings,
    PduReceived,
    PduSent,
    ReceptionFailed,
    TransmissionFailed,
)
from ..protocol.enumerations import CanState, TransferFailure
from ..protocol.packets import MAX_TELECOMMAND_BYTES
from ..protocol.services.large_data import MAX_PART_BYTES
from .can_bus import CanBus, CanBusSettings, Disturbance
from .port import CanObserver, PortClient

FLOW_CONTROL = 3  # ISO 15765-2 table 9: high nibble of the first byte
FIRST_FRAME = 1
FROM_OBC = ("sync", "time_at_sync")
RECEIVER_GONE = (TransferFailure.TIMEOUT_A, TransferFailure.TIMEOUT_BS)


@dataclass(frozen=True)
class CanPortSettings:
    """Of one unit on one bus. ``timeout_ns`` stands for N_As, N_Ar, N_Bs and N_Cr."""

    identifiers: CanIdentifiers
    bus: CanBusSettings
    fd: bool = False
    padding: int | None = 0xCC
    block_size: int = 0
    separation_time_us: int = 0
    timeout_ns: int = 1_000_000_000

    @property
    def frame_bytes(self) -> int:
        """Data bytes of a full frame of a packet."""
        return 64 if self.fd else 8

    def transport(self) -> IsoTpSettings:
        """The unit's end of the connection."""
        return IsoTpSettings(
            transmit_identifier=self.identifiers.telemetry,
            receive_identifier=self.identifiers.telecommand,
            extended=self.identifiers.extended,
            fd=self.fd,
            frame_bytes=self.frame_bytes,
            padding=self.padding,
            block_size=self.block_size,
            separation_time_us=self.separation_time_us,
            max_receive_bytes=MAX_TELECOMMAND_BYTES,
            n_as_ns=self.timeout_ns,
            n_bs_ns=self.timeout_ns,
            n_cr_ns=self.timeout_ns,
        )


@dataclass
class CanPortCounters:
    """What the transport and the controller do not count themselves."""

    cyclic_overruns: int = 0
    packets_lost: int = 0


@dataclass
class _Handles:
    """Frames in the controller that may have to be taken back."""

    data: int | None = None
    flow_control: int | None = None
    cyclic: dict[str, int] = field(default_factory=dict)


class CanPort:
    """The unit's CAN port (see :class:`~st_emulator.wire.port.UnitPort`).

    Packets wait for the receiver's flow control. When none comes within N_Bs, or the controller does not get
    a frame out within N_As, there is no receiver: the packet under way is lost, and so are those that have
    waited for longer than that, so that an OBC that comes back does not read old telemetry first.

    Args:
        clock: the virtual clock.
        settings: identifiers, transport and bus.
        transmit: called with the record of each frame at the virtual time at which it goes over to the link;
            False when the link cannot take it now.
        client: the unit.
        disturbance: the seam where faults of the bus enter.
    """

    part_bytes = MAX_PART_BYTES

    def __init__(
        self,
        clock: VirtualClock,
        settings: CanPortSettings,
        transmit: Callable[[bytes], bool],
        client: PortClient,
        disturbance: Disturbance | None = None,
    ) -> None:
        self._clock = clock
        self.settings = settings
        self._client = client
        self._observer: CanObserver | None = None
        self._decoder = RecordDecoder()
        self.connection = IsoTpConnection(settings.transport())
        self.bus = CanBus(
            clock,
            settings.bus,
            lambda frame: transmit(encode_record(frame)),
            self._received,
            on_state=self._state_changed,
            disturbance=disturbance,
        )
        self.counters = CanPortCounters()
        self._queue: deque[tuple[bytes, int]] = deque()
        self._waiting_bytes = 0
        self._under_way_bytes = 0
        self._handles = _Handles()
        self._timer: ScheduledEvent | None = None
        self._lost = 0
        self._lost_reason = TransferFailure.TIMEOUT_BS
        full = CanFrame(
            settings.identifiers.telemetry,
            bytes(range(1, settings.frame_bytes + 1)),
            settings.identifiers.extended,
            settings.fd,
            settings.fd,
        )
        self._frame_ns = frame_duration_ns(full, settings.bus.bitrate, settings.bus.data_bitrate)

    def observe(self, observer: CanObserver) -> None:
        """Tell ``observer`` from now on."""
        self._observer = observer

    # -- UnitPort
    # --------------------------------------------------------------------------------------------------

    @property
    def queued_bytes(self) -> int:
        return self._waiting_bytes + self._under_way_bytes

    def queue(self, packet: bytes, limit_bytes: int) -> int:
        if self.queued_bytes + len(packet) > limit_bytes:
            return 0
        self._queue.append((packet, self._clock.now_ns))
        self._waiting_bytes += len(packet)
        self._pump()
        return len(packet)

    def drain_ns(self, count: int) -> int:
        return -(-count // (self.settings.frame_bytes - 1)) * self._frame_ns

    def restart(self) -> None:
        self.bus.reset()
        self.connection.reset()
        self._queue.clear()
        self._waiting_bytes = self._under_way_bytes = self._lost = 0
        self._handles = _Handles()
        self._schedule()

    def arrive(self, data: bytes) -> None:
        for frame in self._decoder.receive(data):
            self.bus.arrive(frame)

    # -- cyclic frames
    # ---------------------------------------------------------------------------------------------

    def send_message(self, name: str, fields: Mapping[str, Any]) -> None:
        """Send a cyclic frame. One of the same name that still waits is replaced by it, and counted."""
        pending = self._handles.cyclic.pop(name, None)
        if pending is not None and self.bus.cancel(pending):
            self.counters.cyclic_overruns += 1
        identifiers = self.settings.identifiers
        frame = CanFrame(identifiers.identifier(name), encode_can_message(name, fields), identifiers.extended)
        handle = self.bus.send(frame, partial(self._message_sent, name))
        self._handles.cyclic[name] = handle

    def _message_sent(self, name: str) -> None:
        self._handles.cyclic.pop(name, None)

    # -- frames in
    # -------------------------------------------------------------------------------------------------

    def _received(self, frame: CanFrame) -> None:
        if self._client.silent or frame.remote:
            return
        name = self.settings.identifiers.name_of(frame.identifier, frame.extended)
        if name == TELECOMMAND:
            if self._client.listening:
                self._client.bytes_received(len(frame.data))
            self._handle(self.connection.receive(frame, self._clock.now_ns))
            self._pump()
        elif name in FROM_OBC and self._observer is not None and self._client.listening:
            fields = decode_can_message(name, frame.data)
            if fields is None:
                self._observer.frame_ignored()
            else:
                self._observer.message_received(name, fields)

    def _state_changed(self, before: CanState, now: CanState) -> None:
        if self._observer is not None and not self._client.silent:
            self._observer.state_changed(before, now)

    # -- the transport
    # ---------------------------------------------------------------------------------------------

    def _pump(self) -> None:
        """Hand over what may go out now and wait for what comes next."""
        now_ns = self._clock.now_ns
        connection = self.connection
        while True:
            if not connection.sending and self._queue:
                packet, _ = self._queue.popleft()
                self._waiting_bytes -= len(packet)
                self._under_way_bytes = len(packet)
                connection.send(packet, now_ns)
            frame = connection.next_frame(now_ns)
            if frame is None:
                break
            handle = self.bus.send(frame, partial(self._frame_sent, frame))
            if frame.data[0] >> 4 == FLOW_CONTROL:
                self._handles.flow_control = handle
            else:
                self._handles.data = handle
        self._schedule()

    def _schedule(self) -> None:
        due_ns = self.connection.next_deadline_ns()
        if self._timer is not None:
            if due_ns == self._timer.at_ns and not self._timer.cancelled:
                return
            self._timer.cancel()
            self._timer = None
        if due_ns is not None:
            self._timer = self._clock.at(max(due_ns, self._clock.now_ns), self._timer_due)

    def _timer_due(self) -> None:
        self._timer = None
        self._handle(self.connection.poll(self._clock.now_ns))
        self._pump()

    def _frame_sent(self, frame: CanFrame) -> None:
        kind = frame.data[0] >> 4
        if kind == FLOW_CONTROL:
            self._handles.flow_control = None
        else:
            self._handles.data = None
            payload = len(frame.data) - (2 if kind == FIRST_FRAME else 1)
            self._under_way_bytes = max(self._under_way_bytes - payload, 0)
        self._handle(self.connection.confirmed(frame, self._clock.now_ns))
        self._pump()

    def _handle(self, events: list[IsoTpEvent]) -> None:
        for event in events:
            if isinstance(event, PduReceived):
                if self._client.listening:
                    self._client.packet_received(event.data)
            elif isinstance(event, PduSent):
                self._under_way_bytes = 0
                self._report_lost()
            elif isinstance(event, TransmissionFailed):
                self._transmission_failed(event.reason)
            elif isinstance(event, (ReceptionFailed, FrameIgnored)):
                self._take_back(self._handles.flow_control, event.reason)
                if self._observer is not None and self._client.listening:
                    self._observer.transfer_failed(event.reason)

    def _take_back(self, handle: int | None, reason: TransferFailure) -> None:
        """A frame that the controller could not send in time must not go out later."""
        if handle is not None and reason == TransferFailure.TIMEOUT_A:
            self.bus.cancel(handle)

    def _transmission_failed(self, reason: TransferFailure) -> None:
        self._take_back(self._handles.data, reason)
        self._handles.data = None
        self._under_way_bytes = 0
        lost = 1
        if reason in RECEIVER_GONE:
            oldest_ns = self._clock.now_ns - self.settings.timeout_ns
            while self._queue and self._queue[0][1] <= oldest_ns:
                packet, _ = self._queue.popleft()
                self._waiting_bytes -= len(packet)
                lost += 1
        if not self._lost:
            self._lost_reason = reason
        self._lost += lost
        self.counters.packets_lost += lost

    def _report_lost(self) -> None:
        if self._lost and self._observer is not None:
            lost, self._lost = self._lost, 0
            self._observer.packets_lost(self._lost_reason, lost)
