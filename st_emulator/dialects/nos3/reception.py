"""Octets to commands: as a stream, or as the reference simulator takes them, one call at a time."""

from __future__ import annotations

from collections import deque
from typing import Protocol

from ...protocol.nos3.command_parser import CommandEvent, CommandParser, parse_command


class Reception(Protocol):
    """What stands behind the line's receiver."""

    def announce(self, count: int) -> None:
        """The other side has written so many octets at once; they will come."""

    def receive(self, data: bytes, listening: bool) -> list[CommandEvent]:
        """Octets have come; those that come while the unit does not listen are lost."""

    def reset(self) -> None:
        """The receiver restarts: what was half received is forgotten."""


class StreamReception:
    """A real line: it does not matter what was written at once."""

    def __init__(self) -> None:
        self._parser = CommandParser()

    def announce(self, count: int) -> None:
        pass

    def receive(self, data: bytes, listening: bool) -> list[CommandEvent]:
        return self._parser.receive(data) if listening else []

    def reset(self) -> None:
        self._parser.reset()


class CallbackReception:
    """What is written at once is one command or nothing. It is looked at when its last octet has come."""

    def __init__(self) -> None:
        self._writes: deque[int] = deque()  # octets of each write that have not come yet
        self._heard = bytearray()

    def announce(self, count: int) -> None:
        self._writes.append(count)

    def receive(self, data: bytes, listening: bool) -> list[CommandEvent]:
        events: list[CommandEvent] = []
        offset = 0
        while offset < len(data):
            piece = data[offset : offset + self._writes[0]]
            offset += len(piece)
            self._writes[0] -= len(piece)
            if listening:
                self._heard += piece
            if self._writes[0] == 0:
                self._writes.popleft()
                if self._heard:
                    events.append(parse_command(bytes(self._heard)))
                self._heard.clear()
        return events

    def reset(self) -> None:
        self._heard.clear()
