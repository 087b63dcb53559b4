"""The control socket: one client at a time steps a unit, or looks into one that is paced by the computer.

It listens on a loopback address, asks for a token, and answers every line with one line. Nothing that comes
in raises an exception or holds the unit up: what a client does not read waits for it, up to a limit.
Described in docs/lockstep.md.
"""

from __future__ import annotations

import hmac
import ipaddress
import select
import socket
import time
from collections.abc import Callable
from typing import Any

from ..clock import NS_PER_S
from ..errors import ConfigurationError
from .lockstep_requests import Requests
from .lockstep_wire import MOST_LINE_BYTES, PROTOCOL, VERSION, LineError, decoded, encoded

HELLO_NS = 5 * NS_PER_S  # a stranger has so long to say hello
STALL_NS = 30 * NS_PER_S  # ASSUMED: a client that steps and is silent for longer has stalled
FAREWELL_NS = NS_PER_S  # what is told last has so long to be read
MOST_STRANGERS = 8
MOST_UNREAD_BYTES = 1 << 22  # a client that reads no answers has stalled
READ_BYTES = 1 << 16


def loopback_address(text: str, option: str) -> tuple[str, int]:
    """(host, port) of ``HOST:PORT``; port 0 is a free one.

    Raises:
        ConfigurationError: not a loopback address.
    """
    host, colon, port_text = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    allowed = "allowed are 127.0.0.1:PORT, localhost:PORT and [::1]:PORT, PORT 0 (a free one) to 65535"
    try:
        address = ipaddress.ip_address("127.0.0.1" if host == "localhost" else host)
        port = int(port_text) if port_text.isascii() and port_text.isdecimal() else -1
    except ValueError as error:
        raise ConfigurationError(f"{option} {text}: {allowed}") from error
    if not colon or not address.is_loopback or not 0 <= port <= 65535:
        raise ConfigurationError(f"{option} {text}: {allowed}")
    return str(address), port


class _Connection:
    """One that has connected."""

    def __init__(self, link: socket.socket, now_ns: int) -> None:
        self.socket = link
        self.since_ns = now_ns
        self.heard_ns = now_ns
        self.incoming = bytearray()
        self.outgoing = bytearray()
        self.skipping = False  # the rest of a line that is too long
        self.leaving_ns: int | None = None  # it is told its last; then closed

    def fileno(self) -> int:
        return self.socket.fileno()


class ControlServer:
    """Serves the protocol on a loopback address.

    Args:
        address: of :func:`loopback_address`.
        token: what a hello has to bring.
        requests: what is served.
        say: tells the person who started the unit.
        now_ns: the computer's clock.
    """

    def __init__(
        self,
        address: tuple[str, int],
        token: str,
        requests: Requests,
        say: Callable[[str], None],
        *,
        stall_ns: int = STALL_NS,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._token = token.encode()
        self._requests = requests
        self._say = say
        self._stall_ns = stall_ns
        self._clock_ns = now_ns
        self._client: _Connection | None = None
        self._stalled = False
        self._paused_here = False  # for its silence; a pause that it asked for stays
        self._others: list[_Connection] = []  # strangers, and those that are told their last
        family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        self._listener = socket.socket(family, socket.SOCK_STREAM)
        try:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.bind(address)
            self._listener.listen(MOST_STRANGERS)
            self._listener.setblocking(False)
        except OSError as error:
            self._listener.close()
            raise ConfigurationError(
                f"control socket {address[0]}:{address[1]}: cannot be opened: {error.strerror}"
            ) from error

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens."""
        host, port = self._listener.getsockname()[:2]
        return str(host), int(port)

    def close(self) -> None:
        """Everybody is told that the run is over."""
        for connection in self._connections():
            connection.socket.close()
        self._listener.close()

    # -- waiting

    def readers(self) -> list[Any]:
        """What to wait for: to be read."""
        patient = [one for one in self._connections() if len(one.outgoing) == 0 or one.leaving_ns is not None]
        return [self._listener, *patient]

    def writers(self) -> list[Any]:
        """What to wait for: to be written to."""
        return [one for one in self._connections() if one.outgoing]

    def serve(self, wait_s: float = 0.0, *waking: Any) -> bool:
        """Wait for something to do (or for ``waking`` to be readable) and do it; whether a client asked."""
        readable, writable, _ = select.select([*waking, *self.readers()], self.writers(), [], wait_s)
        served = False
        if self._listener in readable:
            self._accept()
        for one in self._connections():
            if one in writable:
                self._flush(one)
            if one in readable and one.socket.fileno() >= 0:
                served |= self._read(one)
        self._look_at_the_clock()
        return served

    def _connections(self) -> list[_Connection]:
        return ([] if self._client is None else [self._client]) + self._others

    def _accept(self) -> None:
        try:
            link, _ = self._listener.accept()
        except OSError:
            return  # gone again
        link.setblocking(False)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection = _Connection(link, self._clock_ns())
        strangers = sum(one.leaving_ns is None for one in self._others)
        self._others.append(connection)
        if self._client is not None and not self._stalled:
            self._dismiss(connection, LineError("busy", "another client is there; one at a time is served"))
        elif strangers >= MOST_STRANGERS:
            self._dismiss(connection, LineError("busy", "too many connections wait to say hello"))

    def _look_at_the_clock(self) -> None:
        now_ns = self._clock_ns()
        for one in list(self._others):
            if one.leaving_ns is not None and now_ns >= one.leaving_ns:
                self._forget(one)
            elif one.leaving_ns is None and now_ns - one.since_ns > HELLO_NS:
                self._dismiss(one, LineError("unauthorised", "no hello came in time"))
        client = self._client
        if client is not None and not self._stalled and now_ns - client.heard_ns > self._stall_ns:
            self._stalled = True
            if self._requests.steps:
                because = f"the client has been silent for {self._stall_ns / NS_PER_S:g} s"
                self._paused_here = self._pause(because)
                self._tell_where(because, "it may go on, or a new client may take over")

    def _pause(self, because: str) -> bool:
        """Whether the unit was not paused before."""
        lockstep = self._requests.lockstep
        running = lockstep.paused_because is None
        if running:
            lockstep.pause(because)
        return running

    # -- one connection

    def _read(self, one: _Connection) -> bool:
        try:
            data = one.socket.recv(READ_BYTES)
        except BlockingIOError:
            return False
        except OSError:
            data = b""
        if not data:
            self._gone(one)
            return False
        if one.leaving_ns is not None:
            return False  # nothing it says counts any more
        one.heard_ns = self._clock_ns()
        if one is self._client and self._stalled:
            self._back()
        one.incoming += data
        served = False
        while one.leaving_ns is None and (line := self._next_line(one)) is not None:
            served |= self._answer(one, line)
            one.heard_ns = self._clock_ns()  # a long step is no silence
        return served

    def _next_line(self, one: _Connection) -> bytes | None:
        """The next whole line; of one that is too long the beginning, which is no request."""
        end = one.incoming.find(b"\n")
        if one.skipping:
            if end < 0:
                one.incoming.clear()
                return None
            del one.incoming[: end + 1]
            one.skipping = False
            return self._next_line(one)
        if end < 0 and len(one.incoming) < MOST_LINE_BYTES:
            return None
        if end < 0 or end >= MOST_LINE_BYTES:
            line = bytes(one.incoming[: MOST_LINE_BYTES + 1])
            one.skipping = end < 0
            del one.incoming[: end + 1 if end >= 0 else len(one.incoming)]
            return line
        line = bytes(one.incoming[:end])
        del one.incoming[: end + 1]
        return line

    def _answer(self, one: _Connection, line: bytes) -> bool:
        """Whether it was a request of the client."""
        message: dict[str, Any] = {}
        try:
            if len(line) >= MOST_LINE_BYTES:
                raise LineError("oversized", f"a line may have up to {MOST_LINE_BYTES} bytes with its end")
            if not line.strip():
                return False
            message = decoded(line)
            if one is not self._client:
                self._hello(one, message)
                return True
            if message.get("do") == "bye":
                self._send(one, {"id": _identifier(message), "ok": True})
                self._part(one)
                self._say(f"control: the client has left at {self._seconds()}")
                return True
            answer = self._requests.answer(message)
        except LineError as error:
            told = {"id": _identifier(message), "ok": False, **_error(error)}
            if one is self._client:
                self._send(one, told)
            else:
                kind = error.kind if error.kind in ("version", "oversized", "malformed") else "unauthorised"
                self._dismiss(one, LineError(kind, str(error)), _identifier(message))
            return True
        self._send(one, {"id": _identifier(message), "ok": True, **answer})
        return True

    def _hello(self, one: _Connection, message: dict[str, Any]) -> None:
        """A stranger becomes the client, or LineError."""
        token = message.get("token")
        given = token.encode("utf-8", "surrogatepass") if isinstance(token, str) else b""
        right = hmac.compare_digest(given, self._token)
        if message.get("do") != "hello" or not right:
            raise LineError("unauthorised", "the first line has to be a hello with the token of this unit")
        if message.get("version") != VERSION:
            raise LineError("version", f"version: found {message.get('version')!r:.20}; allowed is {VERSION}")
        if self._client is not None:
            if not self._stalled:
                raise LineError("unauthorised", "another client was faster")
            before, self._client = self._client, None
            self._dismiss(before, LineError("taken_over", "another client has taken over"))
            self._say(f"control: a new client has taken over at {self._seconds()}")
        self._others.remove(one)
        self._client, self._stalled = one, False
        emulator = self._requests.lockstep.emulator
        answer = {
            "protocol": PROTOCOL,
            "version": VERSION,
            "unit": emulator.profile.name,
            "start_tai_ns": emulator.start_tai_ns,
            "frame_period_ns": emulator.profile.frame_period_ns,
            "wire": "serial" if emulator.can is None else "can",
        }
        self._send(one, {"id": _identifier(message), "ok": True, **answer, **self._requests.state()})

    def _back(self) -> None:
        self._stalled = False
        if self._requests.steps:
            if self._paused_here:
                self._requests.lockstep.resume()
            self._say(f"control: the client is back at {self._seconds()}")

    def _gone(self, one: _Connection) -> None:
        """It has closed its end, or died."""
        was_client = one is self._client
        self._forget(one)
        if was_client and self._requests.steps:
            because = "the client has gone without a word"
            self._pause(because)
            self._tell_where(because, "a new client may take over where it stands")

    def _tell_where(self, because: str, then: str) -> None:
        self._say(f"control: {because}: the unit is paused at {self._seconds()}; {then}")

    def _seconds(self) -> str:
        return f"{self._requests.lockstep.now_ns / NS_PER_S:.9f} s"

    # -- sending

    def _send(self, one: _Connection, message: dict[str, Any]) -> None:
        one.outgoing += encoded(message)
        self._flush(one)
        if len(one.outgoing) > MOST_UNREAD_BYTES:
            self._gone(one)

    def _flush(self, one: _Connection) -> None:
        try:
            while one.outgoing:
                del one.outgoing[: one.socket.send(one.outgoing)]
        except BlockingIOError:
            return
        except OSError:
            self._gone(one)
            return
        if one.leaving_ns is not None:
            try:
                one.socket.shutdown(socket.SHUT_WR)
            except OSError:
                self._forget(one)

    def _dismiss(self, one: _Connection, error: LineError, identifier: Any = None) -> None:
        """Tell why, and close when that is read."""
        if one not in self._others:
            self._others.append(one)
        one.leaving_ns = self._clock_ns() + FAREWELL_NS
        self._send(one, {"id": identifier, "ok": False, **_error(error)})

    def _part(self, one: _Connection) -> None:
        """The client is none any more; what it is still sent it may read."""
        self._client, self._stalled = None, False
        one.leaving_ns = self._clock_ns() + FAREWELL_NS
        self._others.append(one)
        self._flush(one)

    def _forget(self, one: _Connection) -> None:
        if one is self._client:
            self._client, self._stalled = None, False
        if one in self._others:
            self._others.remove(one)
        one.outgoing.clear()
        one.socket.close()


def _error(error: LineError) -> dict[str, Any]:
    return {"error": {"kind": error.kind, "text": " ".join(str(error).split())}}


def _identifier(message: dict[str, Any]) -> Any:
    """What a request calls itself, for its answer: a number or a short text."""
    identifier = message.get("id")
    if isinstance(identifier, int) and not isinstance(identifier, bool) and abs(identifier) < 1 << 63:
        return identifier
    return identifier if isinstance(identifier, str) and len(identifier) <= 64 else None
