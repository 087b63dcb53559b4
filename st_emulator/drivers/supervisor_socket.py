"""A descriptor that stands beside a running unit, for the program that started it (``run --supervisor FD``).

Lines of JSON on one end of a socket pair. The unit says ``{"ready": {"link": ...}}`` when everything is
loaded and the link is open, and waits for ``begin``, at which power comes on. What it is asked,
``{"id": 1, "do": "begin", "with": {...}}``, it answers: ``{"id": 1, "result": ...}`` or ``{"id": 1, "error":
"one line"}``. When the other end closes, as it does when who holds it dies, the unit stops as on SIGTERM:
nothing is left behind.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import threading
from collections.abc import Callable, Mapping
from queue import SimpleQueue
from typing import Any

from ..errors import ConfigurationError

Request = dict[str, Any]
Answering = Callable[..., Any]


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
        self._requests: SimpleQueue[Request | None] = SimpleQueue()
        self._answers: Mapping[str, Answering] = {}
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

    def await_first(self, name: str) -> Request | None:
        """Wait until ``name`` is asked, and refuse all else; None: the other end has closed. To be answered
        with :meth:`answer`.
        """
        while (request := self._requests.get()) is not None:
            if request.get("do") == name:
                return request
            self._say({"id": request.get("id"), "error": f"{request.get('do')}: {name} must come first"})
        return None

    def answer(self, request: Request, result: Any = None) -> None:
        """What was asked is done."""
        self._say({"id": request.get("id"), "result": result})

    def serve(self, answers: Mapping[str, Answering]) -> None:
        """From now on answer by these functions, called with what stands under ``with``."""
        self._answers = answers

    def attend(self) -> None:
        """Answer what has been asked."""
        try:
            self._wake_read.recv(4096)
        except BlockingIOError:
            return
        while not self._requests.empty():
            request = self._requests.get()
            if request is None:
                return
            self._say({"id": request.get("id"), **self._answered(request)})

    def close(self) -> None:
        """Close all ends of ours."""
        self._closed = True
        with contextlib.suppress(OSError):  # the other end may be gone
            self._socket.shutdown(socket.SHUT_RDWR)  # wakes the thread
        for end in (self._socket, self._wake_read, self._wake_write):
            end.close()

    def _answered(self, request: Request) -> dict[str, Any]:
        answering = self._answers.get(str(request.get("do")))
        if answering is None:
            return {"error": f"{request.get('do')}: unknown; allowed are {', '.join(self._answers)}"}
        try:
            return {"result": answering(**request.get("with", {}))}
        except (ConfigurationError, TypeError, ValueError) as error:
            return {"error": str(error)}

    def _say(self, message: Mapping[str, Any]) -> None:
        with contextlib.suppress(OSError):  # the other end has closed; the reading thread sees it
            self._socket.sendall(json.dumps(message).encode() + b"\n")

    def _read(self) -> None:
        # Closed, or no JSON: whoever it is does not speak this.
        with contextlib.suppress(OSError, ValueError), self._socket.makefile("rb") as lines:
            for line in lines:
                self._requests.put(json.loads(line))
                self._wake_write.send(b"x")
        self._requests.put(None)
        if not self._closed:
            os.kill(os.getpid(), signal.SIGTERM)
