"""An OBC's side of the wire: a driver made with struct and the table of the language alone.

Command: DE AD, u8 number, u32 payload, BE EF. Replies: see REPLIES. Everything big-endian.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from fractions import Fraction

NUMBERS = {
    "code": {"noop": 0, "housekeeping": 1, "data": 2, "config": 3},
    "readme": {"housekeeping": 0, "data": 1, "config": 2},
}
# header and trailer as two octets each, so that a wrong one is seen
REPLIES = {
    ("code", "housekeeping"): (">2sI2s", ("header", "count", "trailer")),
    ("code", "data"): (">2s4HB2s", ("header", "q0", "q1", "q2", "q3", "valid", "trailer")),
    ("readme", "housekeeping"): (">2sIII2s", ("header", "count", "configuration", "status", "trailer")),
    ("readme", "data"): (">2sI4HB2s", ("header", "count", "q0", "q1", "q2", "q3", "valid", "trailer")),
}


def command(name: str, payload: int = 0, layout: str = "code") -> bytes:
    return raw_command(NUMBERS[layout][name], payload)


def raw_command(number: int, payload: int = 0) -> bytes:
    return b"\xde\xad" + struct.pack(">BI", number, payload) + b"\xbe\xef"


def commands_in(octets: bytes) -> list[tuple[int, bytes]]:
    """(offset behind it, nine octets) of each command: the first nine octets with header and trailer, then
    the first ones behind those, and so on. Looked for at every offset, whatever stands between."""
    found = []
    offset = 0
    while offset + 9 <= len(octets):
        nine = octets[offset : offset + 9]
        if nine[0] == 0xDE and nine[1] == 0xAD and nine[7] == 0xBE and nine[8] == 0xEF:
            found.append((offset + 9, nine))
            offset += 9
        else:
            offset += 1
    return found


def reply_size(name: str, layout: str = "code") -> int:
    shape = REPLIES.get((layout, name))
    return 0 if shape is None else struct.calcsize(shape[0])


def decode(name: str, octets: bytes, layout: str = "code") -> dict[str, int]:
    """The fields of a reply; AssertionError when header, trailer or length are wrong."""
    shape, names = REPLIES[layout, name]
    assert len(octets) == struct.calcsize(shape), octets.hex()
    values = dict(zip(names, struct.unpack(shape, octets), strict=True))
    assert values.pop("header") == b"\xde\xad"
    assert values.pop("trailer") == b"\xbe\xef"
    return values


def quaternion(values: dict[str, int]) -> tuple[float, ...]:
    """x, y, z, w as the driver computes them."""
    return tuple((values[f"q{number}"] - 32768) / 32767 for number in range(4))


def exact_u(component: float) -> Fraction:
    """q * 32767 + 32768 without any rounding."""
    return Fraction(component) * 32767 + 32768


def truncated(component: float) -> int:
    return math.floor(exact_u(component))  # positive for all components of a unit quaternion


@dataclass
class Answer:
    """A command's answer on the line: each octet with the time at which its group had left."""

    name: str
    echo: bytes
    reply: dict[str, int] | None


@dataclass
class Decoder:
    """Answers out of what the unit sends, given the names of the commands in their order."""

    layout: str = "code"
    octets: bytearray = field(default_factory=bytearray)

    def answers(self, commands: list[tuple[str, bytes]]) -> list[Answer]:
        """Take one answer for each command; AssertionError when the line says anything else."""
        found = []
        for name, sent in commands:
            echo = bytes(self.octets[:9])
            assert echo == sent, (echo.hex(), sent.hex())
            size = reply_size(name, self.layout)
            reply = bytes(self.octets[9 : 9 + size])
            found.append(Answer(name, echo, decode(name, reply, self.layout) if size else None))
            del self.octets[: 9 + size]
        return found
