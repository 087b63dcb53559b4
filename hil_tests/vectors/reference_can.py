"""The OBC's end of a CAN bus with struct alone: records of frames, their bits, ISO-TP, nothing of ours.

Sources: pcap's LINKTYPE_CAN_SOCKETCAN for the records, ISO 15765-2 (clause 9) for the transfers, ISO 11898-1
(clause 10) for the bits of a frame.
"""

from __future__ import annotations

import struct
from collections import deque
from dataclasses import dataclass, field

EXTENDED, REMOTE, ERROR = 0x8000_0000, 0x4000_0000, 0x2000_0000


def record(identifier: int, data: bytes, *, extended: bool = False, fd: bool = False) -> bytes:
    flags = 0x05 if fd else 0  # FDF and BRS
    word = identifier | (EXTENDED if extended else 0)
    return struct.pack(">IBBxx", word, len(data), flags) + data


def remote_record(identifier: int, length: int, *, extended: bool = False) -> bytes:
    """A remote frame: a DLC, no data."""
    return struct.pack(">IBBxx", identifier | REMOTE | (EXTENDED if extended else 0), length, 0)


def error_record(error_class: int, data: bytes = bytes(8)) -> bytes:
    """An error message of SocketCAN (linux/can/error.h)."""
    return struct.pack(">IBBxx", ERROR | error_class, 8, 0) + data


def records(data: bytes) -> list[tuple[int, bytes]]:
    """(identifier without flags, payload) of whole records."""
    frames = []
    while data:
        word, length = struct.unpack_from(">IB", data)
        frames.append((word & 0x1FFF_FFFF, data[8 : 8 + length]))
        data = data[8 + length :]
    return frames


def classic_bits(identifier: int, data: bytes, *, extended: bool = False) -> int:
    """Bits of a classic data frame from start of frame to the end of the intermission, stuffed."""
    if extended:
        head = f"0{identifier >> 18:011b}11{identifier & 0x3FFFF:018b}000{len(data):04b}"
    else:
        head = f"0{identifier:011b}000{len(data):04b}"
    body = head + "".join(f"{byte:08b}" for byte in data)
    crc = 0
    for bit in body:
        crc = (crc << 1 & 0x7FFF) ^ (0x4599 if int(bit) ^ crc >> 14 else 0)
    body += f"{crc:015b}"
    stuffed, last, run = 0, "", 0
    for bit in body:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:  # its complement follows and starts a run of its own
            stuffed, last, run = stuffed + 1, "10"[int(bit)], 1
    return len(body) + stuffed + 3 + 7 + 3  # CRC delimiter, ACK slot and delimiter; end of frame; pause


@dataclass
class Peer:
    """One OBC: takes the unit's transfers, answering its first frames with flow control, and sends its own.

    ``frame_bytes``: 8, or 64 with CAN FD. ``outbox``: records that go onto the bus next. ``deaf``: it gives
    no flow control; ``answers`` are given in place of the next ones. ``packets``: (time, packet) received
    whole; ``broken``: transfers that were not; ``asked``: flow control of the unit; ``said``: payloads of
    what went into the outbox.
    """

    telecommand: int
    telemetry: int
    extended: bool = False
    frame_bytes: int = 8
    block_size: int = 0
    stmin: int = 0
    deaf: bool = False
    answers: deque[bytes] = field(default_factory=deque)
    asked: list[tuple[int, bytes]] = field(default_factory=list)
    said: list[bytes] = field(default_factory=list)
    outbox: deque[bytes] = field(default_factory=deque)
    packets: list[tuple[int, bytes]] = field(default_factory=list)
    frames: list[tuple[int, int, bytes]] = field(default_factory=list)
    broken: int = 0
    _incoming: bytearray | None = None
    _length: int = 0
    _next: int = 0
    _in_block: int = 0
    _sending: deque[bytes] = field(default_factory=deque)
    _pieces: deque[bytes] = field(default_factory=deque)
    _now_ns: int = 0
    _since_ns: int = 0

    def tick(self, now_ns: int) -> None:
        """N_Bs is 1 s: a telecommand that got no flow control is given up."""
        self._now_ns = now_ns
        if self._sending and not self.outbox and now_ns - self._since_ns >= 10**9:
            self._sending.popleft()
            self._pieces.clear()
            if self._sending:
                self._begin()

    @property
    def sending(self) -> bool:
        """Whether a telecommand waits or is under way."""
        return bool(self._sending)

    def put(self, payload: bytes) -> None:
        self.said.append(payload)
        fd = self.frame_bytes > 8
        lengths = [8, 12, 16, 20, 24, 32, 48, 64]
        size = next(length for length in lengths if length >= len(payload))
        padded = payload.ljust(size, b"\x55")
        self.outbox.append(record(self.telecommand, padded, extended=self.extended, fd=fd))

    def send(self, packet: bytes) -> None:
        """A telecommand, behind those under way."""
        self._sending.append(packet)
        if not self._pieces and len(self._sending) == 1:
            self._begin()

    def _begin(self) -> None:
        self._since_ns = self._now_ns
        packet = self._sending[0]
        room = self.frame_bytes
        if len(packet) <= 7:
            self.put(bytes([len(packet)]) + packet)
            self._sending.popleft()
            return
        if room > 8 and len(packet) <= room - 2:
            self.put(bytes([0, len(packet)]) + packet)
            self._sending.popleft()
            if self._sending:
                self._begin()
            return
        self.put(struct.pack(">H", 0x1000 | len(packet)) + packet[: room - 2])
        rest = packet[room - 2 :]
        self._pieces = deque(rest[n : n + room - 1] for n in range(0, len(rest), room - 1))
        self._sequence = 0

    def _go_on(self, block_size: int) -> None:
        self._since_ns = self._now_ns
        count = block_size or len(self._pieces)
        for _ in range(min(count, len(self._pieces))):
            self._sequence = (self._sequence + 1) & 15
            self.put(bytes([0x20 | self._sequence]) + self._pieces.popleft())
        if not self._pieces and self._sending:
            self._sending.popleft()
            if self._sending:
                self._begin()

    def take(self, data: bytes, t_ns: int) -> None:
        """Records that left the unit."""
        for identifier, payload in records(data):
            if identifier == self.telemetry:
                self._take(payload, t_ns)
            else:
                self.frames.append((t_ns, identifier, payload))

    def _flow_control(self) -> None:
        self._in_block = 0
        if self.answers:
            answer = self.answers.popleft()
            self.outbox.append(record(self.telecommand, answer, extended=self.extended))
        elif not self.deaf:
            self.put(bytes([0x30, self.block_size, self.stmin]))

    def _take(self, payload: bytes, t_ns: int) -> None:
        kind, low = payload[0] >> 4, payload[0] & 15
        if kind == 0:
            length, start = (low, 1) if low else (payload[1], 2)
            self.packets.append((t_ns, payload[start : start + length]))
        elif kind == 1:
            self.broken += self._incoming is not None
            self._length = struct.unpack(">H", payload[:2])[0] & 0xFFF
            self._incoming, self._next = bytearray(payload[2:]), 1
            self._flow_control()
        elif kind == 2 and self._incoming is not None:
            if low != self._next:
                self.broken += 1
                self._incoming = None
                return
            self._incoming += payload[1:]
            self._next = (self._next + 1) & 15
            if len(self._incoming) >= self._length:
                self.packets.append((t_ns, bytes(self._incoming[: self._length])))
                self._incoming = None
                return
            self._in_block += 1
            if self.block_size and self._in_block == self.block_size:
                self._flow_control()
        elif kind == 3:
            self.asked.append((t_ns, payload))
            if low == 0:
                self._go_on(payload[1])
