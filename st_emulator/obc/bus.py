"""What an OBC can do on a CAN bus alone: listen to cyclic frames, send SYNC, put any frame on the bus."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from ..clock import NS_PER_S
from ..links import LinkError
from ..protocol.can.bits import frame_duration_ns
from ..protocol.can.cyclic import CAN_MESSAGES_BY_NAME, CanIdentifiers, encode_can_message
from ..protocol.can.frames import CanFrame
from ..protocol.errors import LocalProtocolError
from ..protocol.pus.packets import CucTime
from ..tai import tai_ns_from_utc
from .can_transport import CanTransport
from .cyclic import CyclicAttitude, CyclicFrame, cuc_time
from .errors import NoBusError, TelemetryTimeout
from .exchange import DEFAULT_TIMEOUT_S, Exchange
from .observed import Event

FINE_PER_S = 1 << 24
SYNC_COUNTERS = 256
CYCLIC_NAMES = tuple(message.name for message in CAN_MESSAGES_BY_NAME.values() if message.direction == "TM")
CyclicPredicate = Callable[[Mapping[str, Any]], Any]


@dataclass(frozen=True)
class SyncSent:
    """A SYNC: its counter, when its last bit left (on an idle bus) by the OBC's own and by civil time, and a
    mark in the stream of telemetry before it.
    """

    counter: int
    mark: int
    time_ns: int
    utc: datetime


class BusExchange(Exchange):
    """Telecommands and telemetry of any link, and what only a CAN bus has: NoBusError on another link."""

    _next_sync = 0

    # Cyclic frames

    def cyclic(self, name: str) -> CyclicFrame | None:
        """The last cyclic frame called `name`, such as heartbeat or status; None when none has come."""
        self._require_cyclic(name)
        with self._reader.lock:
            return self.cyclic_log.latest.get(name)

    def cyclic_since(self, mark: int = 0) -> list[CyclicFrame]:
        """Cyclic frames since a `mark()` (the last 50,000)."""
        self._bus()
        with self._reader.lock:
            return self.cyclic_log.since(mark)

    def wait_for_cyclic(
        self,
        name: str,
        predicate: CyclicPredicate | None = None,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        *,
        since: int | None = None,
    ) -> CyclicFrame:
        """The first cyclic frame called `name` for whose values `predicate(values)` is true.

        since: a `mark()` from which on frames count; None: from now. TelemetryTimeout when it does not come.
        """
        self._require_cyclic(name)
        begun = self.mark() if since is None else since
        mark = begun
        found: list[CyclicFrame] = []

        def search() -> bool:
            nonlocal mark
            for frame in self.cyclic_log.since(mark):
                mark = frame.number + 1
                if frame.name == name and (predicate is None or predicate(frame.values)):
                    found.append(frame)
                    return True
            return False

        self._reader.wait(search, self._deadline_ns(timeout_s))
        self.transport.check_choice()
        if not found:
            seen = sum(frame.name == name for frame in self.cyclic_since(begun))
            last = f"{seen} came, none as wanted" if seen else "none came"
            raise TelemetryTimeout(f"cyclic frame {name}", timeout_s, last)
        return found[0]

    def cyclic_attitudes(self) -> list[CyclicAttitude]:
        """Attitudes of the cyclic frames (the last 20,000): only from halves of the same frame of the camera,
        with its status, rates and time as far as they came.
        """
        self._bus()
        with self._reader.lock:
            return self.cyclic_log.attitudes.attitudes()

    # Frames of our own

    def send_frame(self, frame: CanFrame) -> int:
        """Put any frame on the bus; the OBC's time at which the link took it.

        LinkError when it does not take it in time (the bus is off, or nobody acknowledges),
        LocalProtocolError for a frame that a link without CAN FD does not carry.
        """
        transport = self._bus()
        if frame.fd and not transport.settings.fd:
            raise LocalProtocolError("CanFrame", "fd", True, "False on a link without ,fd")
        with self._reader.lock:
            now_ns = self._reader.now_ns()
            outgoing = transport.send_frame(frame, now_ns)
            self._write(b"")
        self._reader.wait(
            lambda: outgoing.taken_ns is not None or outgoing.lost, now_ns + 2 * transport.settings.timeout_ns
        )
        if outgoing.taken_ns is None:
            timeout_s = transport.settings.timeout_ns / NS_PER_S
            raise LinkError(f"{self.link.name}: the bus did not take a frame within {timeout_s:g} s")
        return outgoing.taken_ns

    def sync(self, counter: int | None = None) -> SyncSent:
        """Send SYNC: every unit latches its time and says it in its frame sync_time.

        counter: 0 to 255; None: the next one, from 0 on. LinkError when the bus does not take it.
        """
        transport = self._bus()
        if counter is None:
            counter, self._next_sync = self._next_sync, (self._next_sync + 1) % SYNC_COUNTERS
        if not 0 <= counter < SYNC_COUNTERS:
            raise LocalProtocolError("sync", "sync_counter", counter, f"0..{SYNC_COUNTERS - 1}")
        frame = self._frame("sync", {"sync_counter": counter})
        settings = transport.settings
        mark = self.mark()
        taken_ns = self.send_frame(frame)
        taken_ns += frame_duration_ns(frame, settings.bitrate, settings.data_bitrate)
        ago_us = (self._reader.now_ns() - taken_ns) / 1000
        return SyncSent(counter, mark, taken_ns, self._reader.utc_now() - timedelta(microseconds=ago_us))

    def set_time_by_sync(
        self, time: datetime | CucTime | int | None = None, timeout_s: float = DEFAULT_TIMEOUT_S
    ) -> Event:
        """Set the on-board time of every unit on the bus: SYNC, then the time at which it was received. The
        event TIME_SET of our unit, which it sends when it has taken the time over at a frame start.

        time: at the SYNC: an aware datetime, a CucTime or TAI nanoseconds since 1958-01-01; None: the
        computer's. TelemetryTimeout when the event does not come.
        """
        transport = self._bus()
        if not transport.settled:
            self._settle()
        if isinstance(time, datetime):
            time = tai_ns_from_utc(time)
        sent = self.sync()
        if time is None:
            time = tai_ns_from_utc(sent.utc)
        at_sync = time if isinstance(time, CucTime) else CucTime.from_ns(time)
        values = {"seconds": at_sync.coarse, "fraction": at_sync.fine / FINE_PER_S}
        self.send_frame(self._frame("time_at_sync", {"sync_counter": sent.counter, **values}))
        try:
            return self.wait_for_event("TIME_SET", timeout_s, since=sent.mark)
        except TelemetryTimeout as error:
            answers = [frame for frame in self.cyclic_since(sent.mark) if frame.name == "sync_time"]
            last = "the unit did not answer the SYNC either"
            if any(frame.values["sync_counter"] == sent.counter for frame in answers):
                last = "the unit answered the SYNC"
            raise TelemetryTimeout(error.awaited, timeout_s, last) from None

    def time_at_sync(self, sent: SyncSent, timeout_s: float = DEFAULT_TIMEOUT_S) -> CucTime:
        """The unit's on-board time at a SYNC, as it latched it. TelemetryTimeout when it does not say."""
        frame = self.wait_for_cyclic(
            "sync_time", lambda values: values["sync_counter"] == sent.counter, timeout_s, since=sent.mark
        )
        return cuc_time(frame.values)

    def _frame(self, name: str, values: Mapping[str, Any]) -> CanFrame:
        transport = self._bus()
        identifiers: CanIdentifiers = transport.table
        return CanFrame(identifiers.identifier(name), encode_can_message(name, values), identifiers.extended)

    def _require_cyclic(self, name: str) -> None:
        self._bus()
        if name not in CYCLIC_NAMES:
            raise ValueError(f"{name!r} is no cyclic frame; there are {', '.join(CYCLIC_NAMES)}")

    def _bus(self) -> CanTransport:
        if not isinstance(self.transport, CanTransport):
            raise NoBusError(f"{self.link.name} is no CAN bus: it has neither cyclic frames nor SYNC")
        return self.transport
