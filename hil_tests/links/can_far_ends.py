"""Far ends of CAN links that share no code with them: a bare socket, python-can's bus of this process, and an
adapter that speaks the Lawicel protocol. What they take and give are records, packed here with struct alone.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import can

PATIENCE_S = 10.0  # only bounds a hang
EXTENDED, REMOTE, ERROR, FD = 1 << 31, 1 << 30, 1 << 29, 4
CAN_RAW_ERR_FILTER = 2  # linux/can/raw.h; without it error messages do not come
CLASSIC_FRAME, FD_FRAME = struct.Struct("=IB3x8s"), struct.Struct("=IBB2x64s")


@dataclass(frozen=True)
class Record:
    """A record taken apart: the word holds the identifier and its flags, flags are those of CAN FD."""

    word: int
    length: int
    flags: int = 0
    data: bytes = b""

    def pack(self) -> bytes:
        return struct.pack(">IBBH", self.word, self.length, self.flags, 0) + self.data


def taken_apart(data: bytes) -> Iterator[Record]:
    """Every record in `data`, which must end with one."""
    while data:
        word, length, flags, _ = struct.unpack_from(">IBBH", data)
        end = 8 if word & REMOTE else 8 + length
        assert end <= len(data)
        yield Record(word, length, flags, data[8:end])
        data = data[end:]


class SocketEnd:
    """A raw CAN socket; its receive buffer is the kernel's default, a few hundred frames."""

    def __init__(self, interface: str = "vcan0", fd: bool = False) -> None:
        self.socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        if fd:
            self.socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        self.socket.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_ERR_FILTER, 0x1FFFFFFF)
        self.socket.bind((interface,))

    def write(self, data: bytes) -> int:
        for record in taken_apart(data):
            if record.flags & FD:
                raw = FD_FRAME.pack(record.word, record.length, record.flags, record.data)
            else:
                raw = CLASSIC_FRAME.pack(record.word, record.length, record.data)
            assert self.socket.send(raw) == len(raw)
        return len(data)

    def read(self, patience_s: float = PATIENCE_S) -> bytes:
        """What has arrived; waits when nothing has."""
        received = bytearray()
        while select.select([self.socket], [], [], 0 if received else patience_s)[0]:
            raw = self.socket.recv(FD_FRAME.size)
            if len(raw) == CLASSIC_FRAME.size:
                word, length, data = CLASSIC_FRAME.unpack(raw)
                flags = 0
            else:
                word, length, flags, data = FD_FRAME.unpack(raw)
                flags |= FD
            received += Record(word, length, flags, b"" if word & REMOTE else data[:length]).pack()
        return bytes(received)

    def close(self) -> None:
        self.socket.close()


class VirtualEnd:
    """A node on python-can's bus of this process, with room for few frames."""

    def __init__(self, channel: str, queue_frames: int = 4096) -> None:
        self.bus = can.Bus(channel, "virtual", ignore_config=True, rx_queue_size=queue_frames)

    def write(self, data: bytes) -> int:
        for record in taken_apart(data):
            self.bus.send(
                can.Message(
                    arbitration_id=record.word & 0x1FFFFFFF,
                    is_extended_id=bool(record.word & EXTENDED),
                    is_remote_frame=bool(record.word & REMOTE),
                    is_error_frame=bool(record.word & ERROR),
                    is_fd=bool(record.flags & FD),
                    bitrate_switch=bool(record.flags & 1),
                    dlc=record.length,
                    data=record.data,
                )
            )
        return len(data)

    def read(self, patience_s: float = 0) -> bytes:
        """What has arrived."""
        received = bytearray()
        while (message := self.bus.recv(timeout=0)) is not None:
            word = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
            word |= (REMOTE if message.is_remote_frame else 0) | (ERROR if message.is_error_frame else 0)
            flags = (FD if message.is_fd else 0) | (1 if message.bitrate_switch else 0)
            received += Record(word, message.dlc, flags, bytes(message.data)).pack()
        return bytes(received)

    def close(self) -> None:
        self.bus.shutdown()


class LawicelEnd:
    """The adapter itself, at the master side of a pseudo-terminal; what it is told to do is in `commands`."""

    def __init__(self, master_fd: int) -> None:
        self.fd = master_fd
        self.commands: list[str] = []
        self._rest = b""
        os.set_blocking(master_fd, False)

    def write(self, data: bytes) -> int:
        text = "".join(f"{line}\r" for line in map(_line_of, taken_apart(data)))
        assert os.write(self.fd, text.encode()) == len(text)
        return len(data)

    def read(self, patience_s: float = PATIENCE_S) -> bytes:
        """The records of the frames that the adapter was given; waits when there are none."""
        received = b""
        while not received and select.select([self.fd], [], [], patience_s)[0]:
            with contextlib.suppress(BlockingIOError):
                self._rest += os.read(self.fd, 65536)
            *lines, self._rest = self._rest.split(b"\r")
            for line in map(bytes.decode, lines):
                if line[:1] in ("t", "T", "r", "R"):
                    received += _record_of(line).pack()
                else:
                    self.commands.append(line)
        return received


def _line_of(record: Record) -> str:
    remote = bool(record.word & REMOTE)
    letter, digits = ("rt"[not remote], 3) if not record.word & EXTENDED else ("RT"[not remote], 8)
    return f"{letter}{record.word & 0x1FFFFFFF:0{digits}X}{record.length}{record.data.hex().upper()}"


def _record_of(line: str) -> Record:
    digits = 8 if line[0] in "TR" else 3
    word = int(line[1 : 1 + digits], 16) | (EXTENDED if digits == 8 else 0)
    data = bytes.fromhex(line[2 + digits :])
    length = int(line[1 + digits])
    if line[0] in "rR":
        assert not data
        return Record(word | REMOTE, length)
    assert len(data) == length
    return Record(word, length, 0, data)
