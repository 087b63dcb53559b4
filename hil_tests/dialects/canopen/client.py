"""A small CANopen master of ``struct`` and whole numbers alone; it shares no code with what it tests."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field

NODE = 0x2C

STATES = {"OFF": 0, "BOOT": 1, "STANDBY": 2, "LOW_POWER": 3, "STAR_TRACK": 4, "CAPTURE": 5, "ERROR": 0xFF}
NMT = {"start": 1, "stop": 2, "pre_operational": 128, "reset_node": 129, "reset_communication": 130}

TOGGLE_BIT, TIMED_OUT, COMMAND, BLOCK_SIZE, SEQUENCE, CRC = (
    0x05030000, 0x05040000, 0x05040001, 0x05040002, 0x05040003, 0x05040004,
)  # fmt: skip
WRITE_ONLY, READ_ONLY, NO_OBJECT = 0x06010001, 0x06010002, 0x06020000
LENGTH, TOO_LONG, TOO_SHORT, NO_SUB = 0x06070010, 0x06070012, 0x06070013, 0x06090011
VALUE, TOO_HIGH, DEVICE_STATE, NO_DATA = 0x06090030, 0x06090031, 0x08000022, 0x08000024


class AbortedError(Exception):
    """The server has aborted a transfer."""

    def __init__(self, code: int) -> None:
        super().__init__(f"{code:08X}h")
        self.code = code


def record(identifier: int, data: bytes = b"", *, remote: bool = False, extended: bool = False) -> bytes:
    """A frame as the link carries it: pcap's LINKTYPE_CAN_SOCKETCAN."""
    word = identifier | (0x40000000 if remote else 0) | (0x80000000 if extended else 0)
    return struct.pack(">IBBBB", word, len(data), 0, 0, 0) + data


def frames(octets: bytes) -> list[tuple[int, bytes]]:
    """(identifier, data) of whole records."""
    found = []
    while octets:
        word, length = struct.unpack_from(">IB", octets)
        found.append((word, octets[8 : 8 + length]))
        octets = octets[8 + length :]
    return found


def crc16(data: bytes) -> int:
    """CCITT, bit by bit: x^16 + x^12 + x^5 + 1, from 0."""
    crc = 0
    for octet in data:
        crc ^= octet << 8
        for _ in range(8):
            crc = (crc << 1) ^ (0x1021 if crc & 0x8000 else 0)
            crc &= 0xFFFF
    return crc


def scet(seconds: int, microseconds: int = 0) -> bytes:
    return struct.pack("<I", seconds) + struct.pack("<I", microseconds)[:3] + b"\0"


def utc(days: int, milliseconds: int, microseconds: int = 0) -> bytes:
    return struct.pack("<HIH", days, milliseconds, microseconds)


def place(index: int, sub: int) -> bytes:
    return struct.pack("<HB", index, sub)


def abort_code(answer: bytes) -> int:
    """Of an answer that is an abort, else 0."""
    return struct.unpack_from("<I", answer, 4)[0] if answer[0] == 0x80 else 0


@dataclass
class Attitude:
    """TPDO 3, 4 and 5 of one image; ``t_ns``: when the last had left."""

    t_ns: int
    status: int
    known: int
    since_midnight: int
    i: float
    j: float
    k: float
    real: float


def attitudes(sent: list[tuple[int, int, bytes]], node: int = NODE) -> list[Attitude]:
    """Those in (time, identifier, data), which have to come in the order 3, 4, 5."""
    found, parts = [], []
    order = [0x380 + node, 0x480 + node, 0x181 + node]
    for t_ns, identifier, data in sent:
        if identifier not in order:
            continue
        assert identifier == order[len(parts)], "not in the order of TPDO 3, 4, 5"
        parts.append(data)
        if len(parts) == 3:
            status, known, since_midnight = struct.unpack("<BBI", parts[0])
            real, i = struct.unpack("<ff", parts[1])
            j, k = struct.unpack("<ff", parts[2])
            found.append(Attitude(t_ns, status, known, since_midnight, i, j, k, real))
            parts = []
    return found


@dataclass
class SdoClient:
    """Transfers over ``exchange``: it puts a request's 8 octets on the bus and returns the answers to it.

    ``drop``: numbers of segments of block transfers that get lost once.
    """

    exchange: Callable[[bytes], list[bytes]]
    drop: set[int] = field(default_factory=set)

    def ask(self, request: bytes) -> bytes:
        answers = self.exchange(request.ljust(8, b"\0"))
        assert len(answers) == 1, [answer.hex() for answer in answers]
        if answers[0][0] == 0x80:
            raise AbortedError(abort_code(answers[0]))
        return answers[0]

    def read(self, index: int, sub: int = 0) -> bytes:
        answer = self.ask(b"\x40" + place(index, sub))
        assert answer[1:4] == place(index, sub)
        if answer[0] & 2:
            assert answer[0] & 0xF3 == 0x43
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        assert answer[0] == 0x41
        (size,) = struct.unpack_from("<I", answer, 4)
        data, toggle = b"", 0
        while True:
            answer = self.ask(bytes((0x60 | toggle,)))
            assert answer[0] & 0xF0 == toggle
            data += answer[1 : 8 - (answer[0] >> 1 & 7)]
            if answer[0] & 1:
                assert len(data) == size
                return data
            toggle ^= 0x10

    def number(self, index: int, sub: int = 0) -> int:
        return int.from_bytes(self.read(index, sub), "little")

    def write(self, index: int, sub: int, data: bytes, *, segmented: bool = False) -> None:
        if 1 <= len(data) <= 4 and not segmented:
            first = 0x23 | (4 - len(data)) << 2
            answer = self.ask(bytes((first,)) + place(index, sub) + data)
            assert answer == b"\x60" + place(index, sub) + bytes(4)
            return
        answer = self.ask(b"\x21" + place(index, sub) + struct.pack("<I", len(data)))
        assert answer == b"\x60" + place(index, sub) + bytes(4)
        toggle = 0
        for start in range(0, max(len(data), 1), 7):
            part = data[start : start + 7]
            last = start + 7 >= len(data)
            answer = self.ask(bytes((toggle | (7 - len(part)) << 1 | last,)) + part)
            assert answer == bytes((0x20 | toggle,)) + bytes(7)
            toggle ^= 0x10

    def read_by_blocks(self, index: int, sub: int = 0, block: int = 127, *, crc: bool = True) -> bytes:
        """Segments whose number in the whole is in ``drop`` are taken for lost, once."""
        answer = self.ask(bytes((0xA4 if crc else 0xA0,)) + place(index, sub) + bytes((block, 0)))
        assert answer[0] == (0xC6 if crc else 0xC2)
        assert answer[1:4] == place(index, sub)
        (size,) = struct.unpack_from("<I", answer, 4)
        data, whole, request = b"", 0, b"\xa3"
        while True:
            segments = self.exchange(request.ljust(8, b"\0"))
            taken, last = 0, False
            for number, segment in enumerate(segments, start=1):
                assert segment[0] & 0x7F == number, segment.hex()
                whole_number = whole + number
                if whole_number in self.drop:
                    self.drop.discard(whole_number)
                    break
                data += segment[1:]
                taken, last = number, bool(segment[0] & 0x80)
            assert taken == block or last or taken < len(segments)
            whole += taken
            request = bytes((0xA2, taken, block))
            if not last:
                continue
            end = self.ask(request)
            unused = end[0] >> 2 & 7
            assert end[0] & 0xE3 == 0xC1
            data = data[: len(data) - unused]
            assert len(data) == size
            assert struct.unpack_from("<H", end, 1)[0] == (crc16(data) if crc else 0)
            assert self.exchange(b"\xa1".ljust(8, b"\0")) == []
            return data

    def write_by_blocks(self, index: int, sub: int, data: bytes, *, crc: int | None = None) -> None:
        """``crc``: another one than the right one."""
        answer = self.ask(b"\xc6" + place(index, sub) + struct.pack("<I", len(data)))
        assert answer[0] == 0xA4
        block = answer[4]
        parts = [data[start : start + 7] for start in range(0, len(data), 7)]
        done = 0
        while done < len(parts):
            batch = parts[done : done + block]
            answers: list[bytes] = []
            for number, part in enumerate(batch, start=1):
                if done + number in self.drop:
                    self.drop.discard(done + number)
                    continue
                last = done + number == len(parts)
                answers += self.exchange((bytes((number | (0x80 if last else 0),)) + part).ljust(8, b"\0"))
            assert len(answers) == 1
            if answers[0][0] == 0x80:
                raise AbortedError(abort_code(answers[0]))
            assert answers[0][0] == 0xA2
            done += answers[0][1]
            block = answers[0][2]
        unused = -len(data) % 7
        right = crc16(data) if crc is None else crc
        assert self.ask(bytes((0xC1 | unused << 2,)) + struct.pack("<H", right)) == b"\xa1" + bytes(7)
