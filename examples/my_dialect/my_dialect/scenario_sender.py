"""The OBC that a scenario's telecommands stand for: it puts them on the line and reads nothing."""

from __future__ import annotations


class LineSender:
    """See :class:`st_emulator.dialects.dialect.ScenarioSender`."""

    def __init__(self) -> None:
        self._outbox: list[bytes] = []

    def send(self, message: bytes, now_ns: int) -> None:
        self._outbox.append(message)

    def send_raw(self, octets: bytes, now_ns: int) -> None:
        self._outbox.append(octets)

    def take(self, data: bytes, now_ns: int) -> None:
        pass

    def poll(self, now_ns: int) -> list[bytes]:
        due, self._outbox = self._outbox, []
        return due

    def next_ns(self) -> int | None:
        return None
