"""Octets of the line to commands: header and trailer are all that there is to hold on to.

A command is nine octets with header and trailer in their places, none of which belonged to a command before.
So it is found behind any garbage, cut into any pieces, with any pauses, and when its last octet comes.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

from .messages import COMMAND, HEADER


class MalformedReason(Enum):
    """What is wrong with octets that should be a command."""

    LENGTH = auto()
    HEADER = auto()
    TRAILER = auto()


@dataclass(frozen=True, slots=True)
class CommandReceived:
    """A well-formed command, known or not; ``raw``: as it came, for the echo."""

    raw: bytes
    command: int
    payload: int


@dataclass(frozen=True, slots=True)
class Malformed:
    """Octets that are no command."""

    raw: bytes
    reason: MalformedReason


CommandEvent = CommandReceived | Malformed


def parse_command(raw: bytes) -> CommandEvent:
    """Octets that are one command or none: what the reference simulator does with all that it gets in one
    call.
    """
    if len(raw) != COMMAND.octets:
        return Malformed(raw, MalformedReason.LENGTH)
    if not raw.startswith(HEADER):
        return Malformed(raw, MalformedReason.HEADER)
    values = COMMAND.decode(raw)
    if values is None:
        return Malformed(raw, MalformedReason.TRAILER)
    return CommandReceived(raw, values["command"], values["payload"])


class CommandParser:
    """A stream of octets in, events out, independent of how the octets are cut into pieces.

    Nine octets that begin with a header and lack the trailer are an event; the search goes on at the octet
    behind the header's first, so that they hide no command. Octets without any header are counted alone.

    ``discarded``: octets so far that belong to no command.
    """

    def __init__(self) -> None:
        self.discarded = 0
        self._octets = bytearray()  # from the first octet on that may begin a command; never nine

    def receive(self, data: bytes) -> list[CommandEvent]:
        """The events that ``data`` completes, in order."""
        octets = self._octets
        octets += data
        events: list[CommandEvent] = []
        while self._aligned() and len(octets) >= COMMAND.octets:
            event = parse_command(bytes(octets[: COMMAND.octets]))
            events.append(event)
            if isinstance(event, CommandReceived):
                del octets[: COMMAND.octets]
            else:
                self._discard(1)
        return events

    def reset(self) -> None:
        """Forget the command in progress, as a restart of the receiver does."""
        self._octets.clear()

    def _aligned(self) -> bool:
        """Throw away what cannot begin a command; whether a whole header is there."""
        octets = self._octets
        start = octets.find(HEADER)
        if start >= 0:
            self._discard(start)
            return True
        self._discard(len(octets) - octets.endswith(HEADER[:1]))
        return False

    def _discard(self, count: int) -> None:
        del self._octets[:count]
        self.discarded += count
