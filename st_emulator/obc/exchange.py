"""Telecommands out, verification matched, telemetry in: what every service of the unit is used through."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from ..clock import NS_PER_S
from ..links import Link
from ..naming import member, name_of
from ..protocol.pus.enumerations import EventId
from ..protocol.pus.packets import Telemetry
from .attitude import Attitude
from .connecting import connect_to
from .counters import Counters
from .cyclic import CyclicLog
from .errors import TelecommandNotDelivered, TelecommandTimeout, TelemetryTimeout, VerificationError
from .obc_protocol import ObcEvent, ObcProtocol, TelemetryReceived
from .observed import EVENT_REPORTS, Event, ObservedUnit
from .reading import LiveReader, Reader
from .recorder import Recorder
from .transport import CanFrameSeen, CyclicReceived, SlipTransport, Transport
from .verification import State, Verification

KEPT_PACKETS = 10_000
DEFAULT_TIMEOUT_S = 5.0
LEARNING_S = 1.5
"""Units report housekeeping and send their heartbeat each second as they come."""
Predicate = Callable[[Telemetry], Any]


@dataclass(frozen=True)
class Received:
    """A telemetry packet, its number in the order of arrival (from 0; on a CAN bus the cyclic frames have
    numbers of the same count) and its reception time.
    """

    number: int
    telemetry: Telemetry
    time_ns: int


class Exchange:
    """One end of a link that speaks the unit's protocol.

    Telemetry is read all the time; what is asked for by name is looked for among the packets that came
    since a mark (by default since the call). Every wait has a time limit. Used as a context manager it
    closes the link.

    apid: the unit's application process; None takes telemetry of any and answers the first that is heard.
    source_id: the OBC's identity. recorder: where everything is written.
    reader: how the link is read; None reads it in a thread in real time. transport: what carries packets on
    the link; None is a serial line.
    """

    def __init__(
        self,
        link: Link,
        *,
        apid: int | None = None,
        source_id: int = 0,
        recorder: Recorder | None = None,
        reader: Reader | None = None,
        transport: Transport | None = None,
    ) -> None:
        self.link = link
        self.unit = ObservedUnit()
        self.cyclic_log = CyclicLog()
        self.transport: Transport = (
            SlipTransport(getattr(link, "baud", None)) if transport is None else transport
        )
        self._protocol = ObcProtocol(apid, source_id, self.transport)
        self._recorder = recorder
        self._reader: Reader = LiveReader() if reader is None else reader
        self._received: deque[Received] = deque(maxlen=KEPT_PACKETS)
        self._next_number = 0
        self._closed = False
        self._asked_for_apid = False
        self.started_ns = self._reader.now_ns()
        if recorder is not None:
            session = {"link": link.name, "apid": apid, "source_id": source_id, **self.transport.description}
            recorder.begin(self.started_ns, self._reader.utc_now(), session)
        self._reader.start(link, self._take, self.transport.next_deadline_ns)

    @classmethod
    def connect(
        cls,
        link: str,
        *,
        apid: int | None = None,
        source_id: int | None = None,
        baud: int | None = None,
        record: str | Path | None = None,
        unit: str | None = None,
        node: int | None = None,
    ) -> Self:
        """An OBC on a link that is opened here: `pty:/path`, `serial:/dev/ttyUSB0@115200`, a bare path, or
        `can:socketcan/vcan0`.

        unit: name or file of the unit whose APID, source ID, rates and CAN identifiers are meant where they
        are not given. node: the unit's node number on a CAN bus; with neither unit nor node it is learned
        from its heartbeat. record: folder for a recording. LinkError, ConfigurationError or RecordingError
        when it cannot be.
        """
        connection = connect_to(link, unit=unit, apid=apid, source_id=source_id, baud=baud, node=node)
        try:
            recorder = None if record is None else Recorder(record)
            return cls(
                connection.link,
                apid=connection.apid,
                source_id=connection.source_id,
                recorder=recorder,
                transport=connection.transport,
            )
        except BaseException:
            connection.link.close()
            raise

    def close(self) -> None:
        """Stop listening, close link and recording."""
        if self._closed:
            return
        self._closed = True
        self._reader.stop()
        self.link.close()
        if self._recorder is not None:
            self._recorder.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exception_type: type[BaseException] | None,
        exception: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    # Telecommands

    def send(
        self,
        name: str,
        /,
        *,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        ack: int | None = None,
        apid: int | None = None,
        strict: bool = True,
        **fields: Any,
    ) -> Verification:
        """Send a telecommand and wait until its verification is complete.

        Enumerations may be given by name: `send("function", function_id="RESET", kind="WARM")`. ack: flags
        for the reports asked for (8 acceptance, 4 start, 2 progress, 1 completion; None: all that the unit
        gives). strict: False lets out-of-range values go to the unit. VerificationError when the unit
        reports a failure, TelecommandTimeout when a report does not come, LocalProtocolError when it cannot
        be sent.
        """
        verification = self.begin(name, timeout_s=timeout_s, ack=ack, apid=apid, strict=strict, **fields)
        return self.finish(verification)

    def begin(
        self,
        name: str,
        /,
        *,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        ack: int | None = None,
        apid: int | None = None,
        strict: bool = True,
        **fields: Any,
    ) -> Verification:
        """As `send`, without waiting: the record returned is brought up to date as reports come.

        Without an APID given, the first telecommand waits for telemetry to learn it from, at most LEARNING_S.
        Where a CAN bus was opened without naming unit or node, it also waits until every heartbeat must have
        come, LEARNING_S from the start on: UnitNotChosenError when none or several were heard.
        """
        if not self.transport.settled:
            self._settle()
        if apid is None and not self._asked_for_apid:
            self._asked_for_apid = True
            self._reader.wait(lambda: self._protocol.apid_known, self._deadline_ns(LEARNING_S))
        with self._reader.lock:
            line, verification = self._protocol.telecommand(
                name,
                fields,
                self._reader.now_ns(),
                ack=ack,
                timeout_ns=round(timeout_s * NS_PER_S),
                apid=apid,
                strict=strict,
            )
            if self._recorder is not None:
                self._recorder.sent(name, fields, verification, line)
            self._write(line)
        return verification

    def finish(self, verification: Verification) -> Verification:
        """Wait for the end of a telecommand sent with `begin`; raises as `send` does."""
        while not verification.finished:
            # The deadline may move while we wait.
            self._reader.wait(lambda: verification.finished, verification.deadline_ns)
            self._expire()
        if verification.state is State.FAILED:
            raise VerificationError(verification)
        if verification.state is State.TIMED_OUT:
            timeout_s = (verification.deadline_ns - verification.sent_ns) / NS_PER_S
            raise TelecommandTimeout(
                verification.label, verification.missing, timeout_s, verification.transfer
            )
        if verification.state is State.NOT_DELIVERED:
            after_s = verification.seconds or 0.0
            raise TelecommandNotDelivered(
                verification.label, verification.missing, after_s, verification.transfer
            )
        return verification

    def request(
        self,
        name: str,
        reply: str,
        predicate: Predicate | None = None,
        /,
        *,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        ack: int | None = None,
        **fields: Any,
    ) -> tuple[Received, Verification]:
        """Send a telecommand that is answered by telemetry `reply`; the answer and the complete
        verification.
        """
        mark = self.mark()
        verification = self.begin(name, timeout_s=timeout_s, ack=ack, **fields)
        found = self._find(
            _named(reply, predicate),
            mark,
            verification.deadline_ns,
            give_up=lambda: verification.state in (State.FAILED, State.NOT_DELIVERED),
        )
        self.finish(verification)
        if found is None:
            raise TelecommandTimeout(verification.label, (reply,), timeout_s)
        return found, verification

    def send_raw(self, data: bytes, *, framed: bool = False) -> int:
        """Put bytes on the wire as they are (on a CAN bus: records of frames), or `framed` as one packet,
        whatever it says. The number of bytes that the link took; of a packet that leaves frame by frame, of
        the packet.
        """
        with self._reader.lock:
            if not framed:
                return self.link.write(data)
            line = self.transport.encode(data, self._reader.now_ns())
            taken = self._write(line)
            return taken if line else len(data)

    # Telemetry

    def mark(self) -> int:
        """The present place in the stream of telemetry, for `since`."""
        with self._reader.lock:
            return self._next_number

    def next(self, name: str, timeout_s: float = DEFAULT_TIMEOUT_S, *, since: int | None = None) -> Telemetry:
        """The next telemetry called `name`. TelemetryTimeout when none comes in time."""
        return self.wait_for(name, None, timeout_s, since=since)

    def wait_for(
        self,
        name: str,
        predicate: Predicate | None = None,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        *,
        since: int | None = None,
    ) -> Telemetry:
        """The first telemetry called `name` for which `predicate(telemetry)` is true.

        since: a `mark()` from which on packets count; None: from now. TelemetryTimeout when it does not come.
        """
        mark = self.mark() if since is None else since
        found = self._find(_named(name, predicate), mark, self._deadline_ns(timeout_s))
        if found is None:
            seen = sum(entry.telemetry.name == name for entry in self._since(mark))
            last = f"{seen} came, none as wanted" if seen else "none came"
            raise TelemetryTimeout(f"telemetry {name}", timeout_s, last)
        return found.telemetry

    def wait_for_event(
        self, name: str, timeout_s: float = DEFAULT_TIMEOUT_S, *, since: int | None = None
    ) -> Event:
        """The first event called `name`, such as TRACKING_LOST; `since` and errors as in `wait_for`."""
        number = member(EventId, name)
        mark = self.mark() if since is None else since

        def fits(telemetry: Telemetry) -> bool:
            return telemetry.name in EVENT_REPORTS and telemetry.fields["event_id"] == number

        found = self._find(fits, mark, self._deadline_ns(timeout_s))
        if found is None:
            raise TelemetryTimeout(f"event {name_of(EventId, number)}", timeout_s)
        telemetry = found.telemetry
        severity = EVENT_REPORTS[telemetry.name]
        return Event(number, severity, telemetry.fields["data"], telemetry.time, found.time_ns)

    def wait(self, seconds: float) -> None:
        """Let time pass and telemetry come in."""
        self._reader.wait(lambda: False, self._deadline_ns(seconds))
        self._expire()
        self.transport.check_choice()

    def attitudes(self) -> list[Attitude]:
        """Every attitude report received (the last 100,000)."""
        with self._reader.lock:
            return list(self.unit.attitudes)

    def events(self) -> list[Event]:
        """Every event received (the last 10,000)."""
        with self._reader.lock:
            return list(self.unit.events)

    def telemetry_since(self, mark: int = 0) -> list[Received]:
        """Packets since a mark (the last 10,000)."""
        with self._reader.lock:
            return list(self._since(mark))

    @property
    def counters(self) -> Counters:
        """What has happened on the wire."""
        return self._protocol.counters

    @property
    def destination_apid(self) -> int:
        """Where telecommands go."""
        return self._protocol.destination_apid

    def now_ns(self) -> int:
        """The OBC's own time, in which reception times are."""
        return self._reader.now_ns()

    # Within

    def _settle(self) -> None:
        """Before the first telecommand: which unit of the bus it is for, where nobody said."""
        self._reader.wait(lambda: False, self.started_ns + round(LEARNING_S * NS_PER_S))
        with self._reader.lock:
            self.transport.settle()

    def _write(self, line: bytes) -> int:
        """Write what leaves at once and begin what leaves bit by bit; called with the lock held."""
        taken = self.link.write(line) if line else 0
        self._pump()
        if self.transport.next_deadline_ns() is not None:
            self._reader.wake()
        return taken

    def _pump(self) -> bool:
        """Give the link what the transport has for it; called with the lock held. As `_handle` says."""
        told = False
        while data := self.transport.outgoing(self._reader.now_ns()):
            taken = self.link.write(data)
            told |= self._handle(self._protocol.written(taken, self._reader.now_ns()))
        return told

    def _take(self, data: bytes, now_ns: int) -> bool:
        """What the reader has read, or b"" when it is time; called with its lock held. As `_handle` says."""
        told = self._handle(self._protocol.receive(data, now_ns))
        return self._pump() or told

    def _handle(self, events: Iterable[ObcEvent]) -> bool:
        """Whether something happened that a caller may wait for: on a CAN bus most frames that come are a
        piece of a packet, or another's.
        """
        told = False
        for event in events:
            told = told or not isinstance(event, CanFrameSeen) or event.sent
            if isinstance(event, TelemetryReceived):
                self._received.append(Received(self._count(), event.telemetry, event.time_ns))
                reported = self.unit.take(event.telemetry, event.time_ns)
                if reported is not None and reported.id == EventId.BOOT_COMPLETED:
                    self.cyclic_log.attitudes.restart()
                if self._recorder is not None:
                    self._recorder.telemetry(event.telemetry, event.time_ns)
                continue
            if isinstance(event, CyclicReceived):
                self.cyclic_log.take(self._count(), event)
                self.unit.take_cyclic(event.name, event.values)
            if self._recorder is not None:
                self._recorder.event(event)
        return told

    def _count(self) -> int:
        self._next_number += 1
        return self._next_number - 1

    def _expire(self) -> None:
        with self._reader.lock:
            for event in self._protocol.expire(self._reader.now_ns()):
                if self._recorder is not None:
                    self._recorder.event(event)

    def _deadline_ns(self, timeout_s: float, begun_ns: int | None = None) -> int:
        return (self._reader.now_ns() if begun_ns is None else begun_ns) + round(timeout_s * NS_PER_S)

    def _since(self, mark: int) -> list[Received]:
        return list(takewhile(lambda entry: entry.number >= mark, reversed(self._received)))[::-1]

    def _find(
        self,
        fits: Callable[[Telemetry], Any],
        mark: int,
        deadline_ns: int,
        give_up: Callable[[], bool] = lambda: False,
    ) -> Received | None:
        """The first packet since `mark` that fits; None when `give_up()` or at the deadline."""
        found: list[Received] = []
        looked_at = mark

        def search() -> bool:
            nonlocal looked_at
            for entry in self._since(looked_at):
                looked_at = entry.number + 1
                if fits(entry.telemetry):
                    found.append(entry)
                    return True
            return give_up()

        self._reader.wait(search, deadline_ns)
        self.transport.check_choice()
        return found[0] if found else None


def _named(name: str, predicate: Predicate | None) -> Predicate:
    if predicate is None:
        return lambda telemetry: telemetry.name == name
    return lambda telemetry: telemetry.name == name and predicate(telemetry)
