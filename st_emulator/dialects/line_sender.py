"""The OBC that a scenario's telecommands stand for on a serial line: it sends and does not listen."""

from __future__ import annotations

from collections.abc import Callable


class LineSender:
    """See :class:`~st_emulator.dialects.dialect.ScenarioSender`.

    Args:
        frame: what a telecommand is on the line; as it is unless said otherwise. Raw octets always are.
    """

    def __init__(self, frame: Callable[[bytes], bytes] = bytes) -> None:
        self._frame = frame
        self._outbox: list[bytes] = []

    def send(self, message: bytes, now_ns: int) -> None:
        self._outbox.append(self._frame(message))

    def send_raw(self, octets: bytes, now_ns: int) -> None:
        self._outbox.append(octets)

    def take(self, data: bytes, now_ns: int) -> None:
        pass

    def poll(self, now_ns: int) -> list[bytes]:
        due, self._outbox = self._outbox, []
        return due

    def next_ns(self) -> int | None:
        return None
