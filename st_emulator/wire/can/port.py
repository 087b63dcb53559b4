"""Packets by ISO-TP on the CAN bus, and the cyclic frames beside them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from ...clock import ScheduledEvent, VirtualClock
from ...protocol.can.bits import INTERMISSION_BITS, bits_duration_ns, frame_duration_ns
from ...protocol.can.cyclic import TELECOMMAND, CanIdentifiers, decode_can_message, encode_can_message
from ...protocol.can.frames import CanFrame, RecordDecoder, encode_record
from ...protocol.can.transfer import payload_bytes, single_frame_bytes
from ...protocol.can.transport import (
    IsoTpConnection,
    IsoTpEvent,
    IsoTpSettings,
    PduReceived,
    PduSent,
    TransmissionFailed,
)
from ...protocol.can.vocabulary import CanState, TransferFailure
from ...protocol.pus.packets import MAX_TELECOMMAND_BYTES, MAX_TELEMETRY_BYTES
from ...protocol.pus.services.large_data import MAX_PART_BYTES
from ..port import CanObserver, PortClient
from ..seam import PLAIN, MessageSeam
from .bus import CanBus, CanBusSettings, Disturbance, always

FROM_OBC = ("sync", "time_at_sync")
RECEIVER_GONE = (TransferFailure.TIMEOUT_A, TransferFailure.TIMEOUT_BS, TransferFailure.WAIT_LIMIT)


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

    @property
    def single_frame_bytes(self) -> int:
        """The longest packet that is a single frame: no flow control answers it."""
        return single_frame_bytes(self.frame_bytes, self.fd)

    def transport_of_the_other_end(self) -> IsoTpSettings:
        """That of an OBC which asks for no flow control of its own."""
        own = self.transport()
        return replace(
            own,
            transmit_identifier=own.receive_identifier,
            receive_identifier=own.transmit_identifier,
            block_size=0,
            separation_time_us=0,
            max_receive_bytes=MAX_TELEMETRY_BYTES,
        )

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
    malformed_records: int = 0


@dataclass(frozen=True, slots=True)
class _Packet:
    """``reports``: it is the event that tells of so many lost packets."""

    data: bytes
    queued_ns: int
    reports: int = 0


@dataclass(slots=True, eq=False)
class _HandedOver:
    """A frame of a packet that the controller has. ``given_up``: its transfer is over without it."""

    frame: CanFrame
    handle: int = 0
    given_up: bool = False


class CanPort:
    """The unit's CAN port (see :class:`~st_emulator.wire.port.UnitPort`).

    Packets wait for the receiver's flow control. When none comes within N_Bs, or nothing but WAIT, or the
    controller does not get a frame out within N_As, there is no receiver: the packet under way is lost, and
    so are those that have waited for longer than that, so that an OBC that comes back does not read old
    telemetry first.

    The unit's receiver is off from :meth:`restart` to :meth:`listen`.

    Args:
        clock: the virtual clock.
        settings: identifiers, transport and bus.
        transmit: called with the record of each frame at the virtual time at which it goes over to the link;
            False when the link cannot take it now.
        client: the unit.
        disturbance: the seam where faults of the bus enter.
        messages: the seam of whole packets, outside the transport.
        recovers: asked before a controller that is bus-off comes back.
    """

    part_bytes = MAX_PART_BYTES

    def __init__(
        self,
        clock: VirtualClock,
        settings: CanPortSettings,
        transmit: Callable[[bytes], bool],
        client: PortClient,
        disturbance: Disturbance | None = None,
        messages: MessageSeam = PLAIN,
        recovers: Callable[[], bool] = always,
    ) -> None:
        self._messages = messages
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
            recovers=recovers,
        )
        self.counters = CanPortCounters()
        self._queue: deque[_Packet] = deque()
        self._waiting_bytes = 0
        self._under_way: _Packet | None = None
        self._under_way_bytes = 0
        self._handed_over: list[_HandedOver] = []
        self._cyclic: dict[str, list[int]] = {}  # in the controller
        self._timer: ScheduledEvent | None = None
        self._lost = 0
        self._lost_reason = TransferFailure.TIMEOUT_BS
        self._reporting = 0
        self._handling = False
        self._heard = False  # the OBC, since the last failure
        self._intermission_ns = 0
        if not settings.bus.hardware:  # the modelled bus gives a frame to its receivers behind it
            self._intermission_ns = bits_duration_ns(INTERMISSION_BITS, settings.bus.bitrate)
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
        reports, self._reporting = self._reporting, 0
        if self.queued_bytes + len(packet) > limit_bytes:
            self._lost += reports
            return 0
        self._messages.to_obc(packet, partial(self._put, reports))
        return len(packet)

    def _put(self, reports: int, packet: bytes) -> None:
        self._queue.append(_Packet(packet, self._clock.now_ns, reports))
        self._waiting_bytes += len(packet)
        self._pump()

    def drain_ns(self, count: int) -> int:
        return -(-count // (self.settings.frame_bytes - 1)) * self._frame_ns

    def restart(self) -> None:
        self.bus.listening = False
        self.bus.reset()
        self.connection.reset()
        self._queue.clear()
        self._waiting_bytes = self._under_way_bytes = self._lost = 0
        self._under_way = None
        self._handed_over.clear()
        self._cyclic.clear()

    def listen(self) -> None:
        """The unit has started: frames of other nodes are received from now on."""
        self.bus.listening = True

    def where(self) -> str:
        bus = self.settings.bus
        fd = f" (CAN FD, data {bus.data_bitrate} bit/s)" if self.settings.fd else ""
        return f"{bus.bitrate} bit/s{fd}, node {self.settings.identifiers.node}"

    def arrive(self, data: bytes) -> None:
        for frame in self._decoder.receive(data):
            self.bus.arrive(frame)
        if self._decoder.incomplete:  # a link brings whole records: what follows starts with one
            self._decoder.reset()
        self.counters.malformed_records = self._decoder.malformed

    # -- cyclic frames
    # ---------------------------------------------------------------------------------------------

    def send_message(self, name: str, fields: Mapping[str, Any]) -> None:
        """Send a cyclic frame. One of the same name that still waits is replaced by it, and counted."""
        handles = self._cyclic.setdefault(name, [])
        for pending in [handle for handle in handles if self.bus.cancel(handle)]:
            handles.remove(pending)
            self.counters.cyclic_overruns += 1
        identifiers = self.settings.identifiers
        frame = CanFrame(identifiers.identifier(name), encode_can_message(name, fields), identifiers.extended)
        # One that is on the wire now stays in the list: an error may bring it back among those that wait. The
        # first of the list leaves first.
        handles.append(self.bus.send(frame, partial(self._message_sent, handles)))

    @staticmethod
    def _message_sent(handles: list[int]) -> None:
        del handles[0]

    @property
    def _last_bit_ns(self) -> int:
        """Of the frame that is being received now."""
        return max(self._clock.now_ns - self._intermission_ns, 0)

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
            readable = self.settings.fd or not frame.fd
            fields = decode_can_message(name, frame.data) if readable else None
            if fields is None:
                self._observer.frame_ignored()
            else:
                self._observer.message_received(name, fields, self._last_bit_ns)

    def _state_changed(self, before: CanState, now: CanState) -> None:
        if self._observer is not None and not self._client.silent:
            self._observer.state_changed(before, now)

    # -- the transport
    # ---------------------------------------------------------------------------------------------

    def _pump(self) -> None:
        """Hand over what may go out now and wait for what comes next."""
        if self._handling:  # what one event makes the unit send waits for the others of its instant
            return
        now_ns = self._clock.now_ns
        connection = self.connection
        self._take_back()
        while True:
            if not connection.sending and self._queue:
                packet = self._under_way = self._queue.popleft()
                self._waiting_bytes -= len(packet.data)
                self._under_way_bytes = len(packet.data)
                connection.send(packet.data, now_ns)
            frame = connection.next_frame(now_ns)
            if frame is None:
                break
            handed_over = _HandedOver(frame)
            handed_over.handle = self.bus.send(frame, partial(self._frame_sent, handed_over))
            self._handed_over.append(handed_over)
        self._schedule()

    def _take_back(self) -> None:
        """A frame whose transfer was given up must not go out later."""
        if not self._handed_over:
            return
        awaited = self.connection.unconfirmed
        for item in [item for item in self._handed_over if not any(item.frame is frame for frame in awaited)]:
            self._handed_over.remove(item)
            item.given_up = True
            self.bus.give_up(item.handle)

    def _schedule(self) -> None:
        """Wake up at the next deadline. A timer that is too early stays: deadlines move with each frame."""
        due_ns = self.connection.next_deadline_ns()
        if due_ns is None or (self._timer is not None and self._timer.at_ns <= due_ns):
            return
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._clock.at(max(due_ns, self._clock.now_ns), self._timer_due)

    def _timer_due(self) -> None:
        self._timer = None
        self._handle(self.connection.poll(self._clock.now_ns))
        self._pump()

    def _frame_sent(self, item: _HandedOver) -> None:
        if item.given_up:  # it was on the wire already
            return
        self._handed_over.remove(item)
        self._under_way_bytes = max(self._under_way_bytes - payload_bytes(item.frame.data), 0)
        self._handle(self.connection.confirmed(item.frame, self._clock.now_ns))
        self._pump()

    def _take(self, packet: bytes) -> None:
        if self._client.listening:
            self._client.packet_received(packet, self._last_bit_ns)

    def _handle(self, events: list[IsoTpEvent]) -> None:
        """To be followed by :meth:`_pump`."""
        self._handling = True
        for event in events:
            if isinstance(event, PduReceived):
                self._heard = True
                self._messages.to_unit(event.data, self._take)
            elif isinstance(event, PduSent):
                self._under_way = None
                self._under_way_bytes = 0
                # A single frame alone does not show that anybody takes packets.
                if self._heard or event.length > self.settings.single_frame_bytes:
                    self._report_lost()
            elif isinstance(event, TransmissionFailed):
                self._transmission_failed(event.reason)
            elif self._observer is not None and self._client.listening:
                self._observer.transfer_failed(event.reason)
        self._handling = False

    def _transmission_failed(self, reason: TransferFailure) -> None:
        packet, self._under_way = self._under_way, None
        self._under_way_bytes = 0
        if packet is not None:
            if not self._lost and not packet.reports:
                self._lost_reason = reason
            self._lose(packet)
        if reason in RECEIVER_GONE:
            self._heard = False
            self._lose_old()

    def _lose(self, packet: _Packet) -> None:
        self._lost += 1 + packet.reports  # which nobody has read
        self.counters.packets_lost += 1

    def _lose_old(self) -> None:
        oldest_ns = self._clock.now_ns - self.settings.timeout_ns
        while self._queue and self._queue[0].queued_ns <= oldest_ns:
            packet = self._queue.popleft()
            self._waiting_bytes -= len(packet.data)
            self._lose(packet)

    def _report_lost(self) -> None:
        if self._lost and self._observer is not None:
            if self._lost_reason in RECEIVER_GONE:
                self._lose_old()  # behind the one that the controller has kept
            self._reporting, self._lost = self._lost, 0
            self._observer.packets_lost(self._lost_reason, self._reporting)
            self._reporting = 0  # nobody wants to know
