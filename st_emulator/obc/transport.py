"""What carries packets over a link, without any link: packets and a time in, bytes out, and the other way.

On a serial line it is SLIP (here), on a CAN bus ISO-TP beside cyclic frames (`can_transport`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Protocol

from ..protocol.can.frames import CanFrame
from ..protocol.can.transport import FrameIgnored, ReceptionFailed
from ..protocol.framing import END, FrameDiscarded, SlipDecoder, slip_encode
from ..protocol.pus.enumerations import TransferFailure
from ..protocol.pus.packets import MAX_TELEMETRY_BYTES
from .counters import Counters

# The largest packet, and as much again for what a damaged END may join to it; more is noise.
MAX_FRAME_BYTES = 2 * MAX_TELEMETRY_BYTES


@dataclass(frozen=True)
class PacketReceived:
    """What was sent as one packet; its last byte came at `time_ns`.

    begun_unheard: it may be the rest of one that was under way when we began to listen.
    """

    data: bytes
    time_ns: int
    begun_unheard: bool = False


@dataclass(frozen=True)
class PacketNotDelivered:
    """A packet of ours that the unit did not take off the bus."""

    packet: bytes
    reason: TransferFailure
    time_ns: int


@dataclass(frozen=True)
class CanFrameSeen:
    """A frame of the bus, ours (`sent`) or another's."""

    frame: CanFrame
    sent: bool
    time_ns: int


@dataclass(frozen=True)
class CanFrameLost:
    """A frame of ours outside of any packet that the link did not take in time."""

    frame: CanFrame
    time_ns: int


@dataclass(frozen=True)
class CyclicReceived:
    """A cyclic frame of the unit, decoded (see `st_emulator.protocol.can.cyclic`)."""

    name: str
    values: dict[str, Any]
    raw: bytes
    time_ns: int


@dataclass(frozen=True)
class CyclicMalformed:
    """A frame with the identifier of a cyclic frame and another length."""

    name: str
    raw: bytes
    time_ns: int


TransportEvent = (
    PacketReceived
    | FrameDiscarded
    | PacketNotDelivered
    | CanFrameSeen
    | CanFrameLost
    | CyclicReceived
    | CyclicMalformed
    | ReceptionFailed
    | FrameIgnored
)


class Transport(Protocol):
    """Packets to bytes of a link and back. `now_ns` is of whatever clock the caller keeps."""

    @property
    def counters(self) -> Counters:
        """What happens on the wire; shared with whoever counts packets."""
        ...

    @property
    def settled(self) -> bool:
        """Whether it is clear which unit is meant."""
        ...

    @property
    def description(self) -> Mapping[str, Any]:
        """What there is to say of it beside the link's name, for records and JSON."""
        ...

    def encode(self, packet: bytes, now_ns: int) -> bytes:
        """Send a packet: bytes to write to the link at once, b"" where they come out of `outgoing`."""
        ...

    def receive(self, data: bytes, now_ns: int) -> Sequence[TransportEvent]:
        """The link brought `data`."""
        ...

    def poll(self, now_ns: int) -> Sequence[TransportEvent]:
        """What time alone brings."""
        ...

    def outgoing(self, now_ns: int) -> bytes:
        """Bytes to write to the link now, b"" for none; `written` must follow."""
        ...

    def written(self, count: int, now_ns: int) -> Sequence[TransportEvent]:
        """The link took so many bytes of what `outgoing` gave."""
        ...

    def next_deadline_ns(self) -> int | None:
        """When `poll` or `outgoing` has something to do; None: nothing until something comes or is sent."""
        ...

    def withdraw(self, packet: bytes) -> str:
        """Nobody waits for what this packet brings any more: one that has not begun to leave is not sent.
        Where it is, in words; "" when it has left.
        """
        ...

    def settle(self) -> None:
        """The first packet is about to leave. UnitNotChosenError when it is not clear to whom."""
        ...

    def check_choice(self) -> None:
        """UnitNotChosenError when telemetry may be of one of several units."""
        ...

    def transfer_ns(self, length: int) -> int:
        """How long a packet of `length` bytes takes on the wire by itself, where that is known, else 0."""
        ...


class SlipTransport:
    """Packets as SLIP frames (RFC 1055); what the link does not take is lost, as on a line.

    baud: of the line; None where it is not known.
    """

    settled = True
    description: Mapping[str, Any] = MappingProxyType({})

    def __init__(self, baud: int | None = None) -> None:
        self.counters = Counters()
        self._baud = baud
        self._decoder = SlipDecoder(MAX_FRAME_BYTES)
        self._begun_unheard: bool | None = None

    def encode(self, packet: bytes, now_ns: int) -> bytes:
        """The packet's frame."""
        line = slip_encode(packet)
        self.counters.sent_bytes += len(line)
        return line

    def receive(self, data: bytes, now_ns: int) -> Sequence[TransportEvent]:
        """The frames that `data` completes."""
        if data and self._begun_unheard is None:
            # Whoever begins to listen in the middle of a frame hears its rest; frames begin with END.
            self._begun_unheard = data[0] != END
        self.counters.received_bytes += len(data)
        events: list[TransportEvent] = []
        for frame in self._decoder.receive(data, now_ns):
            begun_unheard, self._begun_unheard = bool(self._begun_unheard), False
            if not isinstance(frame, FrameDiscarded):
                events.append(PacketReceived(frame.data, frame.time_ns, begun_unheard))
            elif begun_unheard:
                self.counters.startup_fragments += 1
            else:
                events.append(frame)
        return events

    def poll(self, now_ns: int) -> Sequence[TransportEvent]:
        """Nothing."""
        return ()

    def outgoing(self, now_ns: int) -> bytes:
        """Nothing: a frame leaves at once."""
        return b""

    def written(self, count: int, now_ns: int) -> Sequence[TransportEvent]:
        """Nothing."""
        return ()

    def next_deadline_ns(self) -> int | None:
        """None."""
        return None

    def withdraw(self, packet: bytes) -> str:
        """It has left."""
        return ""

    def settle(self) -> None:
        """A line has one unit."""

    def check_choice(self) -> None:
        """A line has one unit."""

    def transfer_ns(self, length: int) -> int:
        """Ten bits a byte (8N1), the two ENDs counted in; escapes are left out."""
        return (length + 2) * 10 * 1_000_000_000 // self._baud if self._baud else 0
