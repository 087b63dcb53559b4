"""An OBC for the KST-9, made of icd.md and str alone: it knows nothing of st-emulator."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import reduce


def checksum(body: str) -> str:
    return f"{reduce(lambda one, other: one ^ other, map(ord, body), 0):02X}"


def sentence(*fields: object, unit: str = "B", end: str = "\r\n") -> bytes:
    """``sentence("PSH", 3)``: a command."""
    kind, *values = map(str, fields)
    body = ",".join([f"KS{unit}{kind}", *values])
    return f"${body}*{checksum(body)}{end}".encode()


@dataclass
class Client:
    """What a unit has said: its sentences without head and checksum, (time, "ACK,RUN")."""

    unit: str = "B"
    heard: list[tuple[int, str]] = field(default_factory=list)
    _line: bytes = b""

    def take(self, data: bytes, t_ns: int = 0) -> None:
        """Octets of the unit; ValueError for what no KST-9 may send."""
        *lines, self._line = (self._line + data).split(b"\r\n")
        for line in lines:
            body, star, given = line.decode("ascii").rpartition("*")
            if not (star and body.startswith(f"$KS{self.unit}") and checksum(body[1:]) == given):
                raise ValueError(f"{line!r} is no sentence of unit {self.unit}")
            if len(body) - 1 + 3 > 80 or not body.isprintable():
                raise ValueError(f"{line!r} is too long, or not printable")
            self.heard.append((t_ns, body[4:]))

    @property
    def said(self) -> list[str]:
        return [text for _, text in self.heard]

    def of(self, kind: str) -> list[list[str]]:
        """The fields of all sentences of a kind."""
        return [text.split(",")[1:] for text in self.said if text.split(",")[0] == kind]

    def times_ns(self, kind: str) -> list[int]:
        return [t_ns for t_ns, text in self.heard if text.split(",")[0] == kind]
