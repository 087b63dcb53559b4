"""The OBC on a CAN bus without any bus: packets by ISO-TP, the unit's cyclic frames, and which unit it is.

The link takes and brings records (`st_emulator.protocol.can.frames`). A frame counts as sent as soon as the
link has taken it: whether the bus acknowledged it is not told.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..protocol.can.bits import frame_duration_ns
from ..protocol.can.cyclic import CAN_MESSAGES_BY_NAME, NODES, TELEMETRY, CanIdentifiers, decode_can_message
from ..protocol.can.frames import CAN_FD_LENGTHS, CLASSIC_BYTES, CanFrame, RecordDecoder, encode_record
from ..protocol.can.transport import (
    FrameIgnored,
    IsoTpConnection,
    IsoTpEvent,
    IsoTpSettings,
    PduReceived,
    ReceptionFailed,
    TransmissionFailed,
)
from ..protocol.pus.packets import MAX_TELEMETRY_BYTES
from .counters import CanCounters
from .errors import UnitNotChosenError
from .transport import (
    CanFrameLost,
    CanFrameSeen,
    CyclicMalformed,
    CyclicReceived,
    PacketNotDelivered,
    PacketReceived,
    TransportEvent,
)

RETRY_NS = 1_000_000
"""A link that takes no frame has a full queue; eight frames leave it in this time at 1 Mbit/s."""
HEARTBEAT = "heartbeat"


@dataclass(frozen=True)
class CanSettings:
    """How packets travel. `timeout_ns` stands for N_As, N_Ar, N_Bs and N_Cr of ISO 15765-2; block size and
    separation time are what our flow control asks the unit for. The bit rates serve to know how long a frame
    takes.
    """

    fd: bool = False
    padding: int | None = 0xCC
    block_size: int = 0
    separation_time_us: int = 0
    timeout_ns: int = 1_000_000_000
    bitrate: int = 1_000_000
    data_bitrate: int = 4_000_000

    @property
    def frame_bytes(self) -> int:
        """Data bytes of a full frame."""
        return CAN_FD_LENGTHS[-1] if self.fd else CLASSIC_BYTES


class Outgoing:
    """A frame on its way to the link. `taken_ns`: when the link took it. `lost`: it was given up."""

    def __init__(self, frame: CanFrame, deadline_ns: int | None) -> None:
        self.frame = frame
        self.record = encode_record(frame)
        self.left = self.record
        """What the link has still to take; a link in memory may cut a record."""
        self.deadline_ns = deadline_ns
        """None: the frame is part of a packet, which has its own time limits."""
        self.taken_ns: int | None = None
        self.lost = False

    @property
    def begun(self) -> bool:
        """Whether a part of it has gone, so that the rest must follow."""
        return len(self.left) < len(self.record)


class CanTransport:
    """One OBC and one unit on one bus; everybody else's frames are counted and left alone.

    identifiers: of the unit. None: those of the first unit whose heartbeat is heard at the default
    identifiers (11 bits); of `table`, if given, which is a unit's table under any node number.
    """

    def __init__(
        self,
        identifiers: CanIdentifiers | None = None,
        settings: CanSettings | None = None,
        *,
        table: CanIdentifiers | None = None,
    ) -> None:
        self.counters = CanCounters()
        self.settings = CanSettings() if settings is None else settings
        self.identifiers = identifiers
        self.nodes_heard: set[int] = set()
        """Nodes whose heartbeats have come."""
        self.table = identifiers or table or CanIdentifiers(NODES[0])
        """The unit's identifiers; as long as the unit is not known, those of all nodes but for the number."""
        self.settled = identifiers is not None
        self._decoder = RecordDecoder()
        self._connection: IsoTpConnection | None = None
        self._packets: deque[bytes] = deque()
        self._under_way: bytes | None = None
        self._answered = False
        self._outbox: deque[Outgoing] = deque()
        self._retry_ns: int | None = None
        self._offered_ns = 0
        if identifiers is not None:
            self._choose(identifiers)

    @property
    def node(self) -> int | None:
        """The unit's node number, None as long as it is not known."""
        return None if self.identifiers is None else self.identifiers.node

    @property
    def description(self) -> Mapping[str, Any]:
        """The node."""
        return {"node": self.node}

    # Out

    def encode(self, packet: bytes, now_ns: int) -> bytes:
        """Queue a packet behind those that wait or are under way; its frames come out of `outgoing`."""
        self._packets.append(packet)
        return b""

    def send_frame(self, frame: CanFrame, now_ns: int) -> Outgoing:
        """Queue a frame that is part of no packet; it is given up when the link has not taken it in time."""
        outgoing = Outgoing(frame, now_ns + self.settings.timeout_ns)
        self._outbox.append(outgoing)
        return outgoing

    def outgoing(self, now_ns: int) -> bytes:
        """The next record, or what is left of it; b"" when there is none or the link is to be left alone."""
        self._collect(now_ns)
        if not self._outbox or (self._retry_ns is not None and now_ns < self._retry_ns):
            return b""
        self._offered_ns = now_ns
        return self._outbox[0].left

    def written(self, count: int, now_ns: int) -> Sequence[TransportEvent]:
        """The link took `count` bytes of the record."""
        head = self._outbox[0]
        head.left = head.left[count:]
        self.counters.sent_bytes += count
        if head.left:
            self.counters.frames_refused += 1
            self._retry_ns = now_ns + RETRY_NS
            return ()
        self._outbox.popleft()
        self._retry_ns = None
        self.counters.frames_sent += 1
        head.taken_ns = now_ns
        events: list[TransportEvent] = [CanFrameSeen(head.frame, True, now_ns)]
        if head.deadline_ns is None and self._connection is not None:
            # Where the computer held us up in between, the frame was on the bus all the same.
            left = self._connection.confirmed(head.frame, now_ns, left_ns=self._offered_ns)
            self._translate(left, events)
        return events

    def withdraw(self, packet: bytes) -> str:
        """See `Transport.withdraw`."""
        if any(packet is waiting for waiting in self._packets):
            self._packets = deque(waiting for waiting in self._packets if waiting is not packet)
            return "it was not sent, as the packet before it was not yet delivered"
        if packet is not self._under_way:
            return ""
        if self._outbox:
            return "the bus has not taken it so far"
        if not self._answered:
            return "the unit has sent no flow control so far"
        return "it is not yet delivered"

    def _collect(self, now_ns: int) -> None:
        """Move what may leave into the outbox."""
        connection = self._connection
        if connection is None:
            return
        while True:
            if not connection.sending and self._packets:
                self._under_way, self._answered = self._packets.popleft(), False
                connection.send(self._under_way, now_ns)
            frame = connection.next_frame(now_ns)
            if frame is None:
                return
            self._outbox.append(Outgoing(frame, None))

    # In

    def receive(self, data: bytes, now_ns: int) -> Sequence[TransportEvent]:
        """Packets, cyclic frames and failures of the unit, and every frame of the bus."""
        counters = self.counters
        counters.received_bytes += len(data)
        events: list[TransportEvent] = []
        for frame in self._decoder.receive(data):
            counters.frames_received += 1
            events.append(CanFrameSeen(frame, False, now_ns))
            if frame.error:
                counters.error_frames += 1
            elif frame.remote:
                counters.frames_of_others += 1
            else:
                self._take(frame, now_ns, events)
        counters.malformed_records = self._decoder.malformed
        return events

    def _take(self, frame: CanFrame, now_ns: int, events: list[TransportEvent]) -> None:
        self._hear(frame)
        name = None
        if self.identifiers is not None:
            name = self.identifiers.name_of(frame.identifier, frame.extended)
        if name == TELEMETRY and self._connection is not None:
            self._answered |= frame.data[:1] >= b"\x30"  # flow control (ISO 15765-2, table 9)
            self._translate(self._connection.receive(frame, now_ns), events)
            return
        message = CAN_MESSAGES_BY_NAME.get(name or "")
        if message is None or message.direction != "TM":
            self.counters.frames_of_others += 1
            return
        values = decode_can_message(message.name, frame.data)
        if values is None:
            self.counters.cyclic_malformed += 1
            events.append(CyclicMalformed(message.name, frame.data, now_ns))
        else:
            self.counters.cyclic_frames += 1
            events.append(CyclicReceived(message.name, values, frame.data, now_ns))

    # Time

    def poll(self, now_ns: int) -> Sequence[TransportEvent]:
        """Transfers and frames whose time is over."""
        events: list[TransportEvent] = []
        if self._connection is not None:
            self._translate(self._connection.poll(now_ns), events)
        for waiting in list(self._outbox):
            late = waiting.deadline_ns is not None and now_ns >= waiting.deadline_ns
            if late and not waiting.begun:
                self._outbox.remove(waiting)
                waiting.lost = True
                self.counters.frames_lost += 1
                events.append(CanFrameLost(waiting.frame, now_ns))
        return events

    def next_deadline_ns(self) -> int | None:
        """See `Transport.next_deadline_ns`."""
        times = [waiting.deadline_ns for waiting in self._outbox if waiting.deadline_ns is not None]
        if self._outbox and self._retry_ns is not None:
            times.append(self._retry_ns)
        due_ns = None if self._connection is None else self._connection.next_deadline_ns()
        if due_ns is not None:
            times.append(due_ns)
        return min(times, default=None)

    # Which unit

    def settle(self) -> None:
        """From now on it is this unit, whoever else is heard. UnitNotChosenError: none, or several."""
        self.check_choice()
        if self.identifiers is None:
            raise UnitNotChosenError(())
        self.settled = True

    def check_choice(self) -> None:
        """UnitNotChosenError when several units were heard before one was chosen."""
        if not self.settled and len(self.nodes_heard) > 1:
            raise UnitNotChosenError(sorted(self.nodes_heard))

    def transfer_ns(self, length: int) -> int:
        """Its frames one after the other on an idle bus, with the unit's flow control at once."""
        settings = self.settings
        full = CanFrame(
            self.table.telecommand,
            bytes(range(1, settings.frame_bytes + 1)),
            self.table.extended,
            fd=settings.fd,
            bit_rate_switch=settings.fd,
        )
        frames = 1
        if length > settings.frame_bytes - (2 if settings.fd else 1):
            frames = 2 - -(length - settings.frame_bytes + 2) // (settings.frame_bytes - 1)
        return frames * frame_duration_ns(full, settings.bitrate, settings.data_bitrate)

    def _hear(self, frame: CanFrame) -> None:
        """Who is there, by heartbeats; the first is the unit where nobody named one."""
        node = frame.identifier - self.table.bases[HEARTBEAT]
        if frame.extended != self.table.extended or node not in NODES:
            return
        self.nodes_heard.add(node)
        if self.identifiers is None:
            self._choose(CanIdentifiers(node, self.table.extended, self.table.bases))

    def _choose(self, identifiers: CanIdentifiers) -> None:
        settings = self.settings
        self.identifiers = self.table = identifiers
        self._connection = IsoTpConnection(
            IsoTpSettings(
                transmit_identifier=identifiers.telecommand,
                receive_identifier=identifiers.telemetry,
                extended=identifiers.extended,
                fd=settings.fd,
                frame_bytes=settings.frame_bytes,
                padding=settings.padding,
                block_size=settings.block_size,
                separation_time_us=settings.separation_time_us,
                max_receive_bytes=MAX_TELEMETRY_BYTES,
                n_as_ns=settings.timeout_ns,
                n_bs_ns=settings.timeout_ns,
                n_cr_ns=settings.timeout_ns,
            )
        )

    def _translate(self, happened: Iterable[IsoTpEvent], events: list[TransportEvent]) -> None:
        """What the connection says, as events of packets, and counted."""
        counters, connection = self.counters, self._connection
        assert connection is not None
        for event in happened:
            if isinstance(event, PduReceived):
                events.append(PacketReceived(event.data, event.time_ns))
            elif isinstance(event, TransmissionFailed):
                counters.count(event.reason)
                packet, self._under_way = self._under_way, None
                if packet is not None:
                    events.append(PacketNotDelivered(packet, event.reason, event.time_ns))
            elif isinstance(event, (ReceptionFailed, FrameIgnored)):
                counters.count(event.reason)
                events.append(event)
            else:
                self._under_way = None
        counted = connection.counters
        counters.transfers_received = counted.pdus_received
        counters.transfers_sent = counted.pdus_sent
        counters.receptions_failed = counted.receptions_failed
        counters.transmissions_failed = counted.transmissions_failed
        counters.transfer_frames_ignored = counted.frames_ignored
        counters.flow_controls_sent = counted.flow_controls_sent
        counters.wait_frames_received = counted.wait_frames_received
        # What belongs to a transfer that failed must not go out later.
        wanted = connection.unconfirmed
        stale = [
            waiting
            for waiting in self._outbox
            if waiting.deadline_ns is None and not waiting.begun and waiting.frame not in wanted
        ]
        for waiting in stale:
            self._outbox.remove(waiting)
