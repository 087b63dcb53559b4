"""The OBC's side of the wire without any wire: bytes and a time in, typed events out, telecommands to bytes.

No port, no thread, no clock: `now_ns` is an argument everywhere, nanoseconds of whatever clock the caller
uses. Malformed input is an event and a counter, never an exception, and costs nothing that comes after it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from ..naming import resolve_fields, telecommand_label
from ..protocol.can.transport import FrameIgnored, ReceptionFailed
from ..protocol.framing import FrameDiscarded
from ..protocol.pus.enumerations import FramingReason, FunctionId, MalformedReason
from ..protocol.pus.packets import (
    ACK_ACCEPTANCE,
    ACK_COMPLETION,
    ACK_PROGRESS,
    ACK_START,
    SEQUENCE_MODULO,
    Malformed,
    RequestId,
    Telemetry,
)
from ..protocol.pus.registry import encode_telecommand, parse_telemetry
from .counters import CanCounters, Counters
from .transport import (
    MAX_FRAME_BYTES,
    CanFrameLost,
    CanFrameSeen,
    CyclicMalformed,
    CyclicReceived,
    PacketNotDelivered,
    PacketReceived,
    SlipTransport,
    Transport,
    TransportEvent,
)
from .verification import State, Verification, VerificationTracker, is_verification

__all__ = ["MAX_FRAME_BYTES", "Counters", "ObcEvent", "ObcProtocol"]

DEFAULT_APID = 0x64
ALL_ACKS = ACK_ACCEPTANCE | ACK_START | ACK_PROGRESS | ACK_COMPLETION
DEFAULT_TIMEOUT_NS = 5_000_000_000


@dataclass(frozen=True)
class TelemetryReceived:
    """A valid telemetry packet."""

    telemetry: Telemetry
    time_ns: int


@dataclass(frozen=True)
class VerificationUpdated:
    """A report came for one of our telecommands; or (`report` is None) its time is over, or it did not reach
    the unit.
    """

    verification: Verification
    report: Telemetry | None
    time_ns: int


@dataclass(frozen=True)
class SequenceGapDetected:
    """Telemetry packets of one APID are missing between two that came."""

    apid: int
    expected: int
    received: int
    time_ns: int

    @property
    def missing(self) -> int:
        """Number of packets that did not come."""
        return (self.received - self.expected) % SEQUENCE_MODULO


@dataclass(frozen=True)
class MalformedReceived:
    """A frame that is no telemetry packet of this interface."""

    malformed: Malformed
    time_ns: int


@dataclass(frozen=True)
class FrameLost:
    """Bytes that the framing could not make a frame of."""

    reason: FramingReason
    length: int
    time_ns: int


ObcEvent = (
    TelemetryReceived
    | VerificationUpdated
    | SequenceGapDetected
    | MalformedReceived
    | FrameLost
    | CanFrameSeen
    | CanFrameLost
    | CyclicReceived
    | CyclicMalformed
    | ReceptionFailed
    | FrameIgnored
)

_UNKNOWN = (MalformedReason.UNKNOWN_SERVICE, MalformedReason.UNKNOWN_SUBSERVICE, MalformedReason.UNKNOWN_ID)


def default_ack(fields: Mapping[str, Any]) -> int:
    """Acknowledgement flags for every report that the unit gives: of RESET only acceptance is certain to
    leave.
    """
    return ACK_ACCEPTANCE if fields.get("function_id") == FunctionId.RESET else ALL_ACKS


class ObcProtocol:
    """State of one OBC on one wire.

    apid: application process to talk to. None: telemetry of any APID is taken, and telecommands go to the
    APID of the first telemetry (0x64 before there is one). source_id: the OBC's own identity in its
    telecommands. transport: what carries packets; None is SLIP.
    """

    def __init__(
        self, apid: int | None = None, source_id: int = 0, transport: Transport | None = None
    ) -> None:
        self.apid = apid
        self.source_id = source_id
        self.transport: Transport = SlipTransport() if transport is None else transport
        self.counters: Counters = self.transport.counters
        self.verifications = VerificationTracker()
        self._learned_apid: int | None = None
        self._next_telemetry_count: dict[int, int] = {}
        self._next_telecommand_count: dict[int, int] = {}

    @property
    def apid_known(self) -> bool:
        """Whether the unit's APID was given or has been heard."""
        return self.apid is not None or self._learned_apid is not None

    @property
    def destination_apid(self) -> int:
        """Where telecommands go."""
        if self.apid is not None:
            return self.apid
        return DEFAULT_APID if self._learned_apid is None else self._learned_apid

    def receive(self, data: bytes, now_ns: int) -> list[ObcEvent]:
        """Everything that `data`, which has arrived at `now_ns`, and that time complete or end."""
        events: list[ObcEvent] = []
        self._take_all(self.transport.receive(data, now_ns), events)
        self._take_all(self.transport.poll(now_ns), events)
        events += self.expire(now_ns)
        return events

    def written(self, count: int, now_ns: int) -> list[ObcEvent]:
        """The link took `count` bytes of what `transport.outgoing` gave."""
        events: list[ObcEvent] = []
        self._take_all(self.transport.written(count, now_ns), events)
        return events

    def expire(self, now_ns: int) -> list[ObcEvent]:
        """Telecommands whose time is over at `now_ns`."""
        expired = self.verifications.expire(now_ns)
        self.counters.telecommands_timed_out += len(expired)
        for verification in expired:
            verification.transfer = self.transport.withdraw(verification.packet)
        return [VerificationUpdated(verification, None, now_ns) for verification in expired]

    def telecommand(
        self,
        name: str,
        fields: Mapping[str, Any] | None,
        now_ns: int,
        *,
        ack: int | None = None,
        timeout_ns: int = DEFAULT_TIMEOUT_NS,
        apid: int | None = None,
        strict: bool = True,
    ) -> tuple[bytes, Verification]:
        """Bytes to write to the link at once (b"" where the transport gives them bit by bit) and the
        telecommand's record, which later reports bring up to date.

        ack: flags for the reports asked for, None: all that the unit gives. strict: False lets values out
        that the interface does not allow. Enumerations may be given by name. Reports are waited for until
        `now_ns + timeout_ns`. LocalProtocolError when the message does not exist or a field cannot be sent;
        then no sequence count is used up.
        """
        destination = self.destination_apid if apid is None else apid
        count = self._next_telecommand_count.get(destination, 0)
        resolved = resolve_fields(name, fields or {})
        if ack is None:
            ack = default_ack(resolved)
        packet = encode_telecommand(
            name,
            resolved,
            apid=destination,
            sequence_count=count,
            source_id=self.source_id,
            ack=ack,
            strict=strict,
        )
        self._next_telecommand_count[destination] = (count + 1) % SEQUENCE_MODULO
        verification = Verification(
            request_id=RequestId.from_packet(packet),
            name=name,
            label=telecommand_label(name, resolved, destination, count),
            ack=ack,
            sent_ns=now_ns,
            deadline_ns=now_ns + timeout_ns,
            packet=packet,
        )
        self.verifications.sent(verification)
        self.counters.telecommands_sent += 1
        if verification.state is State.VERIFIED:
            self.counters.telecommands_verified += 1
        return self.transport.encode(packet, now_ns), verification

    def _take_all(self, happened: Iterable[TransportEvent], events: list[ObcEvent]) -> None:
        for event in happened:
            if isinstance(event, PacketReceived):
                self._take_packet(event, events)
            elif isinstance(event, FrameDiscarded):
                self.counters.framing_errors += 1
                events.append(FrameLost(event.reason, event.length, event.time_ns))
            elif isinstance(event, PacketNotDelivered):
                self._take_not_delivered(event, events)
            else:
                events.append(event)

    def _take_packet(self, packet: PacketReceived, events: list[ObcEvent]) -> None:
        parsed = parse_telemetry(packet.data)
        if isinstance(parsed, Malformed):
            if packet.begun_unheard:
                self.counters.startup_fragments += 1
            else:
                self._take_malformed(parsed, packet.time_ns, events)
        elif self.apid is not None and parsed.apid != self.apid:
            self.counters.other_apid += 1
        else:
            self._take_telemetry(parsed, packet.time_ns, events)

    def _take_not_delivered(self, event: PacketNotDelivered, events: list[ObcEvent]) -> None:
        pending = {id(verification): verification.state for verification in self.verifications}
        verification = self.verifications.not_delivered(event.packet, event.reason, event.time_ns)
        if verification is None:  # its time was over before, and it counts as timed out
            return
        if pending[id(verification)] is State.VERIFIED:  # nothing was asked for
            self.counters.telecommands_verified -= 1
        if isinstance(self.counters, CanCounters):
            self.counters.telecommands_not_delivered += 1
        events.append(VerificationUpdated(verification, None, event.time_ns))

    def _take_malformed(self, malformed: Malformed, now_ns: int, events: list[ObcEvent]) -> None:
        if malformed.reason is MalformedReason.BAD_CRC:
            self.counters.crc_errors += 1
        elif malformed.reason in _UNKNOWN:
            self.counters.unknown += 1
            # The packet is whole and took a sequence count, though what it says is not known here.
            if malformed.header is not None:
                self._check_sequence(malformed.header.apid, malformed.header.sequence_count, now_ns, events)
        else:
            self.counters.malformed += 1
        events.append(MalformedReceived(malformed, now_ns))

    def _take_telemetry(self, telemetry: Telemetry, now_ns: int, events: list[ObcEvent]) -> None:
        self.counters.packets += 1
        if self._learned_apid is None:
            self._learned_apid = telemetry.apid
        self._check_sequence(telemetry.apid, telemetry.sequence_count, now_ns, events)
        events.append(TelemetryReceived(telemetry, now_ns))
        if is_verification(telemetry):
            self._take_verification(telemetry, now_ns, events)

    def _check_sequence(self, apid: int, received: int, now_ns: int, events: list[ObcEvent]) -> None:
        expected = self._next_telemetry_count.get(apid)
        self._next_telemetry_count[apid] = (received + 1) % SEQUENCE_MODULO
        if expected is None or received == expected:
            return
        if received == 0:
            self.counters.restarts += 1
            return
        gap = SequenceGapDetected(apid, expected, received, now_ns)
        self.counters.sequence_gaps += 1
        self.counters.missing_packets += gap.missing
        events.append(gap)

    def _take_verification(self, telemetry: Telemetry, now_ns: int, events: list[ObcEvent]) -> None:
        pending = {id(verification): verification.state for verification in self.verifications}
        verification = self.verifications.take(telemetry, now_ns)
        if verification is None:
            self.counters.unmatched_verifications += 1
            return
        before = pending[id(verification)]
        if verification.state is not before:
            if before is State.VERIFIED:  # nothing was asked for, yet a failure came
                self.counters.telecommands_verified -= 1
            if verification.state is State.VERIFIED:
                self.counters.telecommands_verified += 1
            elif verification.state is State.FAILED:
                self.counters.telecommands_failed += 1
        events.append(VerificationUpdated(verification, telemetry, now_ns))
