"""Transfers of an SDO server that are under way: what they hold, and the frames of their parts."""

from __future__ import annotations

from binascii import crc_hqx
from dataclasses import dataclass, field

from .sdo import (
    LAST_BLOCK_SEGMENT,
    LAST_SEGMENT,
    MOST_BLOCK_SEGMENTS,
    SEGMENT_BYTES,
    TOGGLE,
    AbortCode,
    BlockCommand,
    ServerCommand,
)


def crc16(data: bytes) -> int:
    """CRC-16-CCITT of a block transfer: x^16 + x^12 + x^5 + 1, from 0 (CiA 301, 7.2.4.3.16)."""
    return crc_hqx(data, 0)


def padded(data: bytes) -> bytes:
    """``data`` in a frame of 8 octets, zeros behind it."""
    return data.ljust(8, b"\0")


@dataclass
class SegmentedUpload:
    """An object on its way to the client, 7 octets each time it asks."""

    index: int
    sub: int
    data: bytes
    toggle: int = 0
    at: int = 0

    def segment(self, command: int) -> bytes | AbortCode:
        """The next segment; the transfer has ended with it when :attr:`ended` is set."""
        if command & TOGGLE != self.toggle:
            return AbortCode.TOGGLE_BIT
        part = self.data[self.at : self.at + SEGMENT_BYTES]
        self.at += SEGMENT_BYTES
        first = (
            ServerCommand.UPLOAD_SEGMENT << 5
            | self.toggle
            | (SEGMENT_BYTES - len(part)) << 1
            | (LAST_SEGMENT if self.ended else 0)
        )
        self.toggle ^= TOGGLE
        return padded(bytes((first,)) + part)

    @property
    def ended(self) -> bool:
        return self.at >= len(self.data)


@dataclass
class SegmentedDownload:
    """An object on its way from the client. ``size``: what it announced; ``most``: what the object takes."""

    index: int
    sub: int
    size: int | None
    most: int
    toggle: int = 0
    data: bytearray = field(default_factory=bytearray)

    def segment(self, request: bytes) -> bytes | AbortCode:
        """Take a segment: its acknowledgement, or what is wrong with it."""
        command = request[0]
        if command & TOGGLE != self.toggle:
            return AbortCode.TOGGLE_BIT
        unused = command >> 1 & 7
        self.data += request[1 : 8 - unused]
        if len(self.data) > self.most:
            return AbortCode.TOO_LONG
        answer = padded(bytes((ServerCommand.DOWNLOAD_SEGMENT << 5 | self.toggle,)))
        self.toggle ^= TOGGLE
        return answer


@dataclass
class BlockDownload:
    """As :class:`SegmentedDownload`, by blocks of segments. ``taken``: the last segment of the block that
    came in its turn; ``complete``: the last of all has come.
    """

    index: int
    sub: int
    size: int | None
    most: int
    with_crc: bool
    block_size: int
    taken: int = 0
    complete: bool = False
    data: bytearray = field(default_factory=bytearray)

    def segment(self, request: bytes) -> bytes | AbortCode | None:
        """Take a segment: the acknowledgement of the block that ends with it, or None.

        One that does not come in its turn is lost; the acknowledgement says so and the client sends again.
        """
        number, last = request[0] & ~LAST_BLOCK_SEGMENT, bool(request[0] & LAST_BLOCK_SEGMENT)
        if number == 0:
            return AbortCode.SEQUENCE_NUMBER
        if number == self.taken + 1:
            self.taken = number
            self.data += request[1:]
            self.complete = last
            if len(self.data) > self.most + SEGMENT_BYTES - 1:
                return AbortCode.TOO_LONG
        if not last and number < self.block_size:
            return None
        first = ServerCommand.BLOCK_DOWNLOAD << 5 | BlockCommand.ACKNOWLEDGE
        answer = padded(bytes((first, self.taken, self.block_size)))
        self.taken = 0
        return answer

    def end(self, request: bytes) -> bytes | AbortCode:
        """The client ends the transfer: the whole of it, or what is wrong."""
        unused = request[0] >> 2 & 7
        if unused > len(self.data):
            return AbortCode.LENGTH
        data = bytes(self.data[: len(self.data) - unused])
        if self.with_crc and crc16(data) != int.from_bytes(request[1:3], "little"):
            return AbortCode.CRC
        return data


@dataclass
class BlockUpload:
    """As :class:`SegmentedUpload`, by blocks. ``at``: octets that the client has acknowledged; ``sent``:
    segments of the block under way; ``started``: the client has asked for the first.
    """

    index: int
    sub: int
    data: bytes
    with_crc: bool
    block_size: int
    at: int = 0
    sent: int = 0
    started: bool = False
    ending: bool = False

    def block(self) -> list[bytes]:
        """The segments of the next block."""
        frames = []
        for number in range(1, self.block_size + 1):
            start = self.at + (number - 1) * SEGMENT_BYTES
            last = start + SEGMENT_BYTES >= len(self.data)
            first = number | (LAST_BLOCK_SEGMENT if last else 0)
            frames.append(padded(bytes((first,)) + self.data[start : start + SEGMENT_BYTES]))
            if last:
                break
        self.sent = len(frames)
        return frames

    def acknowledged(self, count: int, block_size: int) -> list[bytes] | AbortCode:
        """The client has so many segments: what follows, the next block or the end."""
        if count > self.sent:
            return AbortCode.SEQUENCE_NUMBER
        if not 1 <= block_size <= MOST_BLOCK_SEGMENTS:
            return AbortCode.BLOCK_SIZE
        self.at += count * SEGMENT_BYTES
        self.block_size = block_size
        if self.at < len(self.data) or not count:
            return self.block()
        self.ending = True
        unused = -len(self.data) % SEGMENT_BYTES if self.data else SEGMENT_BYTES
        crc = crc16(self.data) if self.with_crc else 0
        first = ServerCommand.BLOCK_UPLOAD << 5 | unused << 2 | BlockCommand.END
        return [padded(bytes((first,)) + crc.to_bytes(2, "little"))]


Transfer = SegmentedUpload | SegmentedDownload | BlockDownload | BlockUpload
