"""One command at a time: its echo, its reply, then the next command."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

from ...protocol.nos3.command_parser import CommandReceived
from ...wire.serial_line import SerialLine

# ASSUMED: as many as come in while the longest answer at any baud rate leaves, with much to spare: a driver
# waits for each answer. More are lost, as when a receive buffer is full, and count for nothing.
MOST_WAITING: Final = 64

Answer = Callable[[CommandReceived], tuple[bytes, ...]]
"""The messages that answer a command, in order; none: silence."""


class Answering:
    """Answers commands in the order in which they came.

    Args:
        line: where answers go; nobody else sends on it.
        later: schedules an action after a delay (ns), void after a reset of the unit.
        answer: makes the answer when the command's turn has come.
        pause_ns: between the messages of an answer.
    """

    def __init__(
        self,
        line: SerialLine,
        later: Callable[[int, Callable[[], None]], object],
        answer: Answer,
        pause_ns: int,
    ) -> None:
        self.messages = 0
        self.octets = 0
        self._line = line
        self._later = later
        self._answer = answer
        self._pause_ns = pause_ns
        self._waiting: deque[CommandReceived] = deque()
        self._unsent: deque[bytes] = deque()  # of the answer under way
        self._busy = False

    def take(self, command: CommandReceived) -> None:
        """Answer a command, now or when those before it are answered."""
        if len(self._waiting) < MOST_WAITING:
            self._waiting.append(command)
        if not self._busy:
            self._next()

    def forget_waiting(self) -> None:
        """Answer no more commands; the answer under way is finished."""
        self._waiting.clear()

    def reset(self) -> None:
        """Forget everything but what is on the line already."""
        self._waiting.clear()
        self._unsent.clear()
        self._busy = False
        self._line.flush()

    def drain_ns(self) -> int:
        """Time that what is still to be sent takes on the line; 0 when nothing is."""
        return self._line.duration_ns(self._line.queued_bytes + sum(map(len, self._unsent)))

    def _next(self) -> None:
        """Send the next message, of the answer under way or of the next one."""
        self._busy = True
        while not self._unsent:
            if not self._waiting:
                self._busy = False
                return
            self._unsent.extend(self._answer(self._waiting.popleft()))
        message = self._unsent.popleft()
        self._line.send(message)
        self.messages += 1
        self.octets += len(message)
        pause_ns = self._pause_ns if self._unsent else 0
        self._later(self._line.duration_ns(len(message)) + pause_ns, self._next)
