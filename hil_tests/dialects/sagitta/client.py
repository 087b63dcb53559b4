"""The other end of the line: frames made and read with struct, the hash by the package xxhash.

It shares no code with the unit. Every number is as the table of the wire format has it: offsets count
from the address byte of the unescaped body.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import xxhash

SET, READ, REQUEST, ACTION = 0x00, 0x01, 0x02, 0x03
SET_REPLY, READ_REPLY, TELEMETRY, ACTION_REPLY, ASYNCHRONOUS = 0x80, 0x81, 0x82, 0x83, 0x84
BOOT, SET_TIME = 1, 14
TIME, POWER, SOLUTION, TEMPERATURE, HISTOGRAM = 1, 11, 24, 27, 28
BLOBS, CENTROIDS, AUTO_BLOB, MATCHED, BLOB_STATISTICS = 36, 37, 39, 40, 49
TELEMETRY_BODY_BYTES = {1: 32, 11: 84, 24: 87, 27: 32, 28: 164, 36: 58, 37: 166, 39: 24, 40: 341, 49: 85}
SUBSCRIPTION = 18
PARAMETER_BYTES = {
    3: 16, 5: 41, 6: 16, 8: 65, 9: 37, 10: 7, 11: 49, 12: 50, 13: 8, 14: 13, 15: 10, 16: 11, 18: 16, 23: 10,
    25: 8, 30: 8, 31: 43,
}  # fmt: skip

#: What the driver sends, packed by hand from the table. The distortion's coefficients belong to one lens, and
#: those of the blob filter are not known: zeros.
DEFAULTS = {
    3: bytes(16),
    5: bytes(41),
    6: struct.pack("<4f", 1, 0, 0, 0),
    8: b"\x01" + bytes(64),
    9: struct.pack("<B3fhBB16xI", 2, 25, 0.075, 0.1, -175, 3, 58, 8),
    10: struct.pack("<BBHHB", 3, 0, 10, 0, 0),
    11: struct.pack("<B12f", 0, 9999, 0, -9999, 9999, -9999, 9999, 9999, -9999, 0, 1, -1, 0),
    12: struct.pack(
        "<I10fBBf", 2, 0.05, 0.025, 0.44316187, 0.44316187, 0.08, 0.08, 100, 10, 0, 0, 12, 6, 0.6
    ),
    13: struct.pack("<2f", 0.0121, 0.003025),
    14: struct.pack("<3fB", 0.01, 0.000272, 0.0005, 2),
    15: struct.pack("<BffB", 5, 0.5, 0.005, 6),
    16: struct.pack("<BfBfB", 12, 0.005, 6, 0.005, 6),
    18: bytes([24, 27]) + bytes(14),
    23: struct.pack("<BBHHf", 1, 30, 2, 70, 0.01),
    25: struct.pack("<2f", 0.1, 0.2),
    30: struct.pack("<4H", 4, 40, 0, 255),
    31: bytes(40) + bytes([5, 5, 5]),
}


def body(type_: int, id_: int, arguments: bytes = b"", address: int = 0x21) -> bytes:
    """Address, type, id, arguments and hash."""
    head = bytes([address, type_, id_]) + arguments
    return head + xxhash.xxh32(head, seed=1425).intdigest().to_bytes(4, "little")


def framed(unescaped: bytes) -> bytes:
    """A body on the line."""
    line = bytearray([0xC0])
    for octet in unescaped:
        line += {0xC0: b"\xdb\xdc", 0xDB: b"\xdb\xdd"}.get(octet, bytes([octet]))
    return bytes(line) + b"\xc0"


def request(type_: int, id_: int, arguments: bytes = b"", address: int = 0x21) -> bytes:
    """A request on the line."""
    return framed(body(type_, id_, arguments, address))


def camera(exposure_s: float) -> bytes:
    """Arguments of the camera, all but the exposure as the driver sends them."""
    return struct.pack("<B3fhBB16xI", 2, 25, exposure_s, 0.1, -175, 3, 58, 8)


def subscription(*ids: int) -> bytes:
    """Arguments of the subscription."""
    return bytes(ids) + bytes(16 - len(ids))


@dataclass(frozen=True)
class Frame:
    """A frame of the unit. ``t_ns``: when its closing C0 had left; ``line_bytes``: with both C0."""

    t_ns: int
    body: bytes
    line_bytes: int

    @property
    def type(self) -> int:
        return self.body[1]

    @property
    def id(self) -> int:
        return self.body[2]

    @property
    def status(self) -> int:
        """Not of 81, which has none."""
        assert self.type != READ_REPLY
        return self.body[3]

    @property
    def counter(self) -> int:
        return int(struct.unpack_from("<I", self.body, 4)[0])

    @property
    def time_us(self) -> int:
        return int(struct.unpack_from("<Q", self.body, 8)[0])

    @property
    def arguments(self) -> bytes:
        """Of 81."""
        assert self.type == READ_REPLY
        return self.body[3:-4]

    @property
    def data(self) -> bytes:
        """Of 82 and 84."""
        assert self.type in (TELEMETRY, ASYNCHRONOUS)
        return self.body[16:-4]


class Reader:
    """Octets of the line to frames. Whatever is wrong with one is an AssertionError."""

    def __init__(self) -> None:
        self._line: bytearray | None = None

    def take(self, t_ns: int, octets: bytes, octet_ns: float) -> list[Frame]:
        """The frames that end in these octets, the last of which had left at ``t_ns``."""
        frames = []
        for number, octet in enumerate(octets, start=1):
            if octet != 0xC0:
                assert self._line is not None, "octets outside of a frame"
                self._line.append(octet)
            elif not self._line:
                self._line = bytearray()
            else:
                left_ns = t_ns - round((len(octets) - number) * octet_ns)
                frames.append(self._frame(left_ns, bytes(self._line)))
                self._line = None
        return frames

    @staticmethod
    def _frame(t_ns: int, line: bytes) -> Frame:
        unescaped = bytearray()
        octets = iter(line)
        for octet in octets:
            unescaped.append({0xDC: 0xC0, 0xDD: 0xDB}[next(octets)] if octet == 0xDB else octet)
        found = int.from_bytes(unescaped[-4:], "little")
        assert found == xxhash.xxh32(bytes(unescaped[:-4]), seed=1425).intdigest(), "hash"
        return Frame(t_ns, bytes(unescaped), len(line) + 2)


def solution(frame: Frame) -> dict[str, Any]:
    """Telemetry 24, each field at its own offset."""
    raw = frame.body
    assert len(raw) == 87
    return {
        "q": struct.unpack_from("<4f", raw, 16),
        "track_confidence": struct.unpack_from("<f", raw, 32)[0],
        "track_q": struct.unpack_from("<4f", raw, 36),
        "removed": raw[52],
        "centroided": raw[53],
        "matched": raw[54],
        "lisa_q": struct.unpack_from("<4f", raw, 55),
        "lisa_fraction_close": struct.unpack_from("<f", raw, 71)[0],
        "lisa_close": raw[75],
        "mode": raw[76],
        "valid": raw[77],
        "stable": struct.unpack_from("<I", raw, 78)[0],
        "strategy": raw[82],
    }


def centroids(frame: Frame) -> tuple[int, list[tuple[float, float, int]]]:
    """Telemetry 37: count, and (x, y, magnitude) of all 16."""
    data = frame.data
    return struct.unpack_from("<H", data)[0], [struct.unpack_from("<ffB", data, 2 + 9 * n) for n in range(16)]


def matched(frame: Frame) -> tuple[int, list[tuple[int, float, float, float, float]]]:
    """Telemetry 40: count, and (star, x, y, error of x, error of y) of all 16."""
    data = frame.data
    return data[0], [struct.unpack_from("<I4f", data, 1 + 20 * n) for n in range(16)]


def blobs(frame: Frame) -> tuple[int, int, int, list[tuple[int, int]]]:
    """Telemetry 36: count, used, skipped, and (x, y) of all 8."""
    data = frame.data
    count, used, skipped = struct.unpack_from("<3H", data)
    return count, used, skipped, [struct.unpack_from("<2H", data, 6 + 4 * n) for n in range(8)]


def histogram(frame: Frame) -> list[tuple[int, ...]]:
    """Telemetry 28: nine numbers of each section."""
    return [struct.unpack_from("<9I", frame.data, 36 * n) for n in range(4)]


def blob_statistics(frame: Frame) -> tuple[int, list[tuple[int, ...]]]:
    """Telemetry 49: count, and (noise, threshold, valid, overflow) of all 16."""
    data = frame.data
    return data[0], [tuple(data[1 + 4 * n : 5 + 4 * n]) for n in range(16)]
