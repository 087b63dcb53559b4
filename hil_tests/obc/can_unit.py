"""The CAN side of a small star tracker, with struct alone: records, ISO-TP and cyclic frames written down a
second time (pcap LINKTYPE_CAN_SOCKETCAN, ISO 15765-2, the interface document).
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from st_emulator.links import MemoryLink, memory_link_pair

NODE = 10
MS = 1_000_000
PAD = b"\xcc"
TELECOMMAND, TELEMETRY, HEARTBEAT = 0x600, 0x580, 0x700
SYNC, TIME_AT_SYNC, SYNC_TIME = 0x080, 0x100, 0x400
ATTITUDE_1, ATTITUDE_2, RATES, STATUS, MID_EXPOSURE = 0x180, 0x280, 0x380, 0x480, 0x500


def record(identifier: int, data: bytes, *, extended: bool = False, flags: int = 0) -> bytes:
    """One frame as a link carries it."""
    return struct.pack(">IBBH", identifier | extended << 31, len(data), flags, 0) + data


def frames_of(records: bytes) -> list[tuple[int, bytes]]:
    """Identifier (with its flags) and data of each record."""
    found = []
    while records:
        word, length, _, _ = struct.unpack(">IBBH", records[:8])
        found.append((word, records[8 : 8 + length]))
        records = records[8 + length :]
    return found


def bits(*parts: tuple[int, int]) -> bytes:
    """(value, width) one after the other, most significant bit first."""
    number = width = 0
    for value, count in parts:
        number = number << count | value & ((1 << count) - 1)
        width += count
    return number.to_bytes(width // 8, "big")


def half(counter: int, first: float, second: float) -> bytes:
    """attitude_1 or attitude_2."""
    steps = [min(round(part * (1 << 27)), (1 << 27) - 1) for part in (first, second)]
    return bits((counter, 8), (steps[0], 28), (steps[1], 28))


def heartbeat(counter: int = 0, *, mode: int = 2, boot_count: int = 1, uptime_s: int = 7) -> bytes:
    return struct.pack(">BBBBI", counter, mode, 0b11_00_0000, boot_count, uptime_s)


def status(counter: int, *, valid: int = 1, reasons: int = 0, mode: int = 4) -> bytes:
    return struct.pack(">BBBHBBB", counter, mode, valid << 7, reasons, 12, 20, 0)


def clock(counter: int, coarse: int, fine: int) -> bytes:
    """A frame of seconds and fraction."""
    return struct.pack(">BI", counter, coarse) + fine.to_bytes(3, "big")


def segments(packet: bytes, size: int = 8) -> list[bytes]:
    """The frames of a packet, without flow control; `size` 8 is classic CAN."""
    if len(packet) < 8:
        return [bytes([len(packet)]) + packet + PAD * (7 - len(packet))]
    frames = [struct.pack(">H", 0x1000 | len(packet)) + packet[: size - 2]]
    rest = packet[size - 2 :]
    for number, start in enumerate(range(0, len(rest), size - 1), start=1):
        frames.append((bytes([0x20 | number % 16]) + rest[start : start + size - 1]).ljust(size, PAD))
    return frames


class _PacketLink:
    """What the fake unit of the serial line takes for its link: packets in SLIP, and ISO-TP behind it."""

    def __init__(self, wire: Any) -> None:
        self._slip, self._unslip = wire.slip, wire.unslip
        self.incoming: deque[bytes] = deque()
        self.outgoing: deque[bytes] = deque()

    def read(self) -> bytes:
        line = b"".join(map(self._slip, self.incoming))
        self.incoming.clear()
        return line

    def write(self, line: bytes) -> int:
        self.outgoing += self._unslip(line)
        return len(line)


@dataclass
class CanUnit:
    """A unit's node: `fake` is its inside (conftest.FakeUnit). `flow_control`: what it answers to a first
    frame and after each block, None for nothing. `lose`: called with each frame that it would send.
    """

    wire: Any
    link: MemoryLink
    node: int = NODE
    flow_control: bytes | None = b"\x30\x00\x00"
    lose: Callable[[int, bytes], bool] = lambda identifier, data: False
    heartbeat_ms: int = 0
    now_ns: int = 0
    heard: list[tuple[int, int, bytes]] = field(default_factory=list)
    """Time, identifier and data of every frame that came."""
    on_frame: Callable[[int, bytes], None] = lambda identifier, data: None
    _packet: bytearray = field(default_factory=bytearray)
    _length: int = 0
    _in_block: int = 0
    _waiting: list[bytes] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._packets = _PacketLink(self.wire)
        self.fake = self.wire.FakeUnit(self._packets)
        self._heartbeats = 0

    def step(self, now_ns: int) -> None:
        self.now_ns = now_ns
        for identifier, data in frames_of(self.link.read()):
            self.heard.append((now_ns, identifier, data))
            self.on_frame(identifier, data)
            if identifier == TELECOMMAND + self.node:
                self._take(data)
        if self.heartbeat_ms and now_ns >= self._heartbeats * self.heartbeat_ms * MS:
            self.put(HEARTBEAT + self.node, heartbeat(self._heartbeats % 256))
            self._heartbeats += 1
        self.fake.step(now_ns)
        self._begin()

    def put(self, identifier: int, data: bytes) -> None:
        """Send a frame."""
        if not self.lose(identifier, data):
            self.link.write(record(identifier, data))

    def _take(self, data: bytes) -> None:
        kind = data[0] >> 4
        if kind == 0:
            self._packets.incoming.append(data[1 : 1 + data[0]])
        elif kind == 1:
            self._length = struct.unpack(">H", data[:2])[0] & 0xFFF
            self._packet = bytearray(data[2:])
            self._in_block = 0
            self._answer()
        elif kind == 2:
            self._packet += data[1:]
            self._in_block += 1
            if len(self._packet) >= self._length:
                self._packets.incoming.append(bytes(self._packet[: self._length]))
            elif self.flow_control is not None and self._in_block == self.flow_control[1]:
                self._in_block = 0
                self._answer()
        elif kind == 3:
            for frame in self._waiting:
                self.put(TELEMETRY + self.node, frame)
            self._waiting = []
            self._begin()

    def _answer(self) -> None:
        if self.flow_control is not None:
            self.put(TELEMETRY + self.node, self.flow_control.ljust(8, PAD))

    def _begin(self) -> None:
        while self._packets.outgoing and not self._waiting:
            first, *self._waiting = segments(self._packets.outgoing.popleft())
            self.put(TELEMETRY + self.node, first)


class Bus:
    """Joins links in memory: what one node writes all the others read."""

    def __init__(self) -> None:
        self._taps: list[MemoryLink] = []

    def attach(self) -> MemoryLink:
        """A new node's link."""
        inside, outside = memory_link_pair(1 << 22, ("bus", f"can:memory/bus{len(self._taps)}"))
        self._taps.append(inside)
        return outside

    def step(self) -> None:
        for tap in self._taps:
            if data := tap.read():
                for other in self._taps:
                    if other is not tap:
                        other.write(data)
