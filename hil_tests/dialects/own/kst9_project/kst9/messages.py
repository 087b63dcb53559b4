"""Sentences of the KST-9: ``$`` body ``*`` checksum, CR LF. No device, no clock and no port here."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

LONGEST_BODY = 80  # characters with *HH
MANUFACTURER = "KS"
HEAD = re.compile(r"KS([A-Z])([A-Z]{3})")
PRINTABLE = range(0x20, 0x7F)

#: The application's commands and the names of their fields.
COMMANDS: dict[str, tuple[str, ...]] = {
    "RUN": (),
    "VER": (),
    "SRH": (),
    "IDL": (),
    "TST": (),
    "EXP": ("ms",),
    "TIM": ("week", "s"),
    "PSH": ("ds",),
    "POL": ("what",),
    "RST": (),
}


@dataclass(frozen=True)
class Sentence:
    """A sentence whose checksum is right."""

    unit: str
    kind: str
    fields: tuple[str, ...]


@dataclass(frozen=True)
class Bad:
    """What was no sentence; ``code`` is the answer's."""

    code: str


def checksum(body: str) -> int:
    """Exclusive or of the characters."""
    total = 0
    for octet in body.encode("ascii"):
        total ^= octet
    return total


def encode(unit: str, kind: str, fields: Sequence[object] = ()) -> bytes:
    """A sentence as octets of the line; the fields as they are printed."""
    body = ",".join([MANUFACTURER + unit + kind, *map(str, fields)])
    return f"${body}*{checksum(body):02X}\r\n".encode("ascii")


class Decoder:
    """Finds sentences in the octets of a line, however they are cut."""

    def __init__(self) -> None:
        self._body: bytearray | None = None  # None: outside of a sentence

    def reset(self) -> None:
        self._body = None

    def receive(self, data: bytes) -> list[Sentence | Bad]:
        """What is whole with these octets, in order."""
        found = (self._next(octet) for octet in data)
        return [item for item in found if item is not None]

    def _next(self, octet: int) -> Sentence | Bad | None:
        body = self._body
        if octet == ord("$"):
            self._body = bytearray()
            return None if body is None else Bad("FM")
        if body is None:
            return None
        if octet == ord("\n"):
            self._body = None
            return parsed(body.removesuffix(b"\r"))
        if octet == ord("\r") and not body.endswith(b"\r"):
            body.append(octet)
            return None
        if octet not in PRINTABLE or body.endswith(b"\r"):
            self._body = None
            return Bad("FM")
        body.append(octet)
        if len(body) > LONGEST_BODY:
            self._body = None
            return Bad("LN")
        return None


def parsed(body: bytes | bytearray) -> Sentence | Bad:
    """What stood between ``$`` and the end of the line."""
    text, star, given = body.decode("ascii").rpartition("*")
    if not star or not re.fullmatch("[0-9A-Fa-f]{2}", given):
        return Bad("FM")
    if int(given, 16) != checksum(text):
        return Bad("CS")
    head, *fields = text.split(",")
    match = HEAD.fullmatch(head)
    return Bad("FM") if match is None else Sentence(match[1], match[2], tuple(fields))
