"""The messages of my unit: one table, and the codec made of it. No device, no clock and no port here.

A frame on the line, numbers little-endian::

    A5 5A | address u8 | number u8 | length u8 | payload, length octets | CRC u16

The CRC is CRC-16/CCITT-FALSE (polynomial 1021, start FFFF) from the address to the end of the payload.
Octets that make no frame are values (:class:`Bad`), never exceptions; what comes behind them is not lost.
"""

from __future__ import annotations

import binascii
import struct
from dataclasses import dataclass
from typing import Any

SYNC = b"\xa5\x5a"
HEADER = struct.Struct("<BBB")
CRC = struct.Struct("<H")
LONGEST_PAYLOAD = 32  # octets


@dataclass(frozen=True)
class Layout:
    """One message: its number, its payload in the letters of :mod:`struct`, the names of what is in it."""

    number: int
    name: str
    letters: str = ""
    fields: tuple[str, ...] = ()

    @property
    def payload(self) -> struct.Struct:
        return struct.Struct("<" + self.letters)


COMMANDS = (
    Layout(0x01, "get_status"),
    Layout(0x02, "find_attitude"),
    Layout(0x03, "stop"),
    Layout(0x04, "restart"),
    Layout(0x05, "report_every", "B", ("frames",)),
)
TELEMETRY = (
    Layout(0x81, "answer", "BB", ("command", "refusal")),  # refusal 0: it is taken
    Layout(0x82, "done", "BB", ("command", "failure")),  # failure 0: it completed
    Layout(0x83, "status", "BBHH", ("mode", "attitude_valid", "boot_count", "bad_frames")),
    Layout(0x84, "attitude", "IQB4f", ("frame", "time_us", "valid", "x", "y", "z", "w")),
    Layout(0x85, "started", "H", ("boot_count",)),
)
BY_NAME = {layout.name: layout for layout in COMMANDS + TELEMETRY}
BY_NUMBER = {layout.number: layout for layout in COMMANDS + TELEMETRY}


@dataclass(frozen=True)
class Frame:
    """A frame whose checksum is right; its number may be one that nobody knows."""

    address: int
    number: int
    payload: bytes

    @property
    def layout(self) -> Layout | None:
        """What the message is; None where the number is unknown or the payload has another length."""
        layout = BY_NUMBER.get(self.number)
        return layout if layout is not None and layout.payload.size == len(self.payload) else None

    def values(self) -> dict[str, Any]:
        """The payload by names, of a frame that has a layout."""
        layout = self.layout
        assert layout is not None
        return dict(zip(layout.fields, layout.payload.unpack(self.payload), strict=True))


@dataclass(frozen=True)
class Bad:
    """Octets that are no frame."""

    reason: str


def encode(name: str, address: int, values: dict[str, Any]) -> bytes:
    """A message as octets of the line. KeyError, struct.error: a field is missing or does not fit."""
    layout = BY_NAME[name]
    payload = layout.payload.pack(*(values[field] for field in layout.fields))
    body = HEADER.pack(address, layout.number, len(payload)) + payload
    return SYNC + body + CRC.pack(binascii.crc_hqx(body, 0xFFFF))


class Decoder:
    """Finds frames in the octets of a line, however they are cut."""

    def __init__(self) -> None:
        self._waiting = bytearray()

    @property
    def half(self) -> bool:
        """Whether the beginning of a frame waits for its end."""
        return bool(self._waiting)

    def receive(self, data: bytes) -> list[Frame | Bad]:
        """What is whole with these octets, in order."""
        self._waiting += data
        found: list[Frame | Bad] = []
        while (item := self._next()) is not None:
            found.append(item)
        return found

    def give_up(self) -> list[Frame | Bad]:
        """The end of the half frame does not come any more; what lies in it may be frames, too."""
        del self._waiting[: len(SYNC)]
        return [Bad("cut off"), *self.receive(b"")]

    def reset(self) -> None:
        self._waiting.clear()

    def _next(self) -> Frame | Bad | None:
        waiting = self._waiting
        start = waiting.find(SYNC)
        if start < 0:
            start = len(waiting) - waiting.endswith(SYNC[:1])
        del waiting[:start]  # silence and noise between frames
        begin = len(SYNC) + HEADER.size
        if len(waiting) < begin:
            return None
        address, number, length = HEADER.unpack_from(waiting, len(SYNC))
        if length > LONGEST_PAYLOAD:
            return self._bad("length")
        end = begin + length
        if len(waiting) < end + CRC.size:
            return None
        (crc,) = CRC.unpack_from(waiting, end)
        if crc != binascii.crc_hqx(bytes(waiting[len(SYNC) : end]), 0xFFFF):
            return self._bad("checksum")
        payload = bytes(waiting[begin:end])
        del waiting[: end + CRC.size]
        return Frame(address, number, payload)

    def _bad(self, reason: str) -> Bad:
        del self._waiting[: len(SYNC)]  # a frame may begin inside what looked like one
        return Bad(reason)
