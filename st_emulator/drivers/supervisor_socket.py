"""A descriptor that stands beside a running unit, for the program that started it (``run --supervisor FD``).

It is the control protocol of docs/lockstep.md on one end of a socket pair, without ``hello``, token and
``bye``: who holds the other end may ask. The unit says ``{"ready": {"link": ...}}`` when everything is loaded
and the link is open, and waits for ``{"id": 1, "do": "begin", "scenario": {...}}``, at which power comes on.
When the other end closes, as it does when who holds it dies, the unit stops as on SIGTERM: nothing is left
behind.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import threading
from queue import SimpleQueue
from typing import Any

from ..errors import ConfigurationError
from .lockstep_requests import Requests
from .lockstep_wire import LineError, decoded, encoded

Message = dict[str, Any]


class SupervisorSocket:
    """The unit's end. A thread of its own reads, so that the end of the other side is seen at any time; what
    is asked is answered where the loop calls :meth:`attend`.

    Raises:
        ConfigurationError: the descriptor is no socket.
    """

    def __init__(self, descriptor: int) -> None:
        try:
            self._socket = socket.socket(fileno=descriptor)
        except OSError as error:
            raise ConfigurationError(
                f"--supervisor {descriptor}: {error.strerror}; allowed is the descriptor of a socket"
            ) from error
        self._lines: SimpleQueue[bytes | None] = SimpleQueue()
        self._requests: Requests | None = None
        self._wake_read, self._wake_write = socket.socketpair()
        self._wake_read.setblocking(False)
        self._closed = False
        threading.Thread(target=self._read, name="supervisor", daemon=True).start()

    def fileno(self) -> int:
        """Readable when something is asked."""
        return self._wake_read.fileno()

    def ready(self, **what: Any) -> None:
        """Say that all is there."""
        self._say({"ready": what})

    def await_begin(self) -> Message | None:
        """Wait until ``begin`` is asked, and refuse all else; None: the other end has closed. It is answered
        by :meth:`serve`.
        """
        while (line := self._lines.get()) is not None:
            message: Message = {}
            try:
                message = decoded(line)
                if message.get("do") == "begin":
                    return message
                raise LineError("refused", f"{message.get('do')!r:.60}: begin must come first")
            except LineError as error:
                self._refuse(message, error)
        return None

    def serve(self, requests: Requests, begin: Message) -> None:
        """The unit has begun: from now on these are served."""
        self._requests = requests
        self._say({"id": begin.get("id"), "ok": True, **requests.state()})

    def attend(self) -> None:
        """Answer what has been asked."""
        try:
            self._wake_read.recv(4096)
        except BlockingIOError:
            return
        while not self._lines.empty():
            line = self._lines.get()
            if line is None:
                return
            self._answer(line)

    def close(self) -> None:
        """Close all ends of ours."""
        self._closed = True
        with contextlib.suppress(OSError):  # the other end may be gone
            self._socket.shutdown(socket.SHUT_RDWR)  # wakes the thread
        for end in (self._socket, self._wake_read, self._wake_write):
            end.close()

    def _answer(self, line: bytes) -> None:
        assert self._requests is not None
        message: Message = {}
        try:
            message = decoded(line)
            self._say({"id": message.get("id"), "ok": True, **self._requests.answer(message)})
        except LineError as error:
            self._refuse(message, error)

    def _refuse(self, message: Message, error: LineError) -> None:
        told = {"kind": error.kind, "text": str(error)}
        self._say({"id": message.get("id"), "ok": False, "error": told})

    def _say(self, message: Message) -> None:
        with contextlib.suppress(OSError):  # the other end has closed; the reading thread sees it
            self._socket.sendall(encoded(message))

    def _read(self) -> None:
        with contextlib.suppress(OSError), self._socket.makefile("rb") as lines:
            for line in lines:
                self._lines.put(line)
                self._wake_write.send(b"x")
        self._lines.put(None)
        if not self._closed:
            os.kill(os.getpid(), signal.SIGTERM)
