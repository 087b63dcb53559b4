"""CAN frames, the records in which links carry them, and candump's text of them.

A record is a packet of pcap's LINKTYPE_CAN_SOCKETCAN (227): the identifier and its flags in four bytes,
big-endian, the length, the flags of CAN FD, two reserved bytes, the payload. The length delimits a record,
so that a stream of them needs no framing; of a remote frame it is the DLC, and nothing follows.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import NamedTuple

from ..durations import NS_PER_S, NS_PER_US
from ..errors import LocalProtocolError

CAN_FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
CLASSIC_BYTES = 8
ERROR_FRAME_BYTES = 8  # CAN_ERR_DLC of linux/can/error.h
MAX_STANDARD_IDENTIFIER = 0x7FF
MAX_EXTENDED_IDENTIFIER = 0x1FFF_FFFF

RECORD_HEADER_BYTES = 8
MAX_RECORD_BYTES = RECORD_HEADER_BYTES + CAN_FD_LENGTHS[-1]

# linux/can.h
EXTENDED_FLAG = 0x8000_0000
REMOTE_FLAG = 0x4000_0000
ERROR_FLAG = 0x2000_0000
BIT_RATE_SWITCH_FLAG = 0x01
ERROR_STATE_FLAG = 0x02
FD_FLAG = 0x04

_VALID_FD_LENGTHS = frozenset(CAN_FD_LENGTHS)


@dataclass(frozen=True, slots=True)
class CanFrame:
    """A frame of CAN (ISO 11898-1) or an error message of SocketCAN.

    ``identifier`` has 11 bits, or 29 with ``extended``. ``data`` has 0 to 8 bytes, with ``fd`` any of
    :data:`CAN_FD_LENGTHS`. ``bit_rate_switch`` and ``error_state_indicator`` are bits of FD frames. A
    ``remote`` frame is classic, carries no data and asks for ``remote_dlc`` bytes. With ``error`` it never
    was on the wire: the identifier holds the error class and the 8 bytes its details (linux/can/error.h).

    Raises:
        LocalProtocolError: there is no such frame.
    """

    identifier: int
    data: bytes = b""
    extended: bool = False
    fd: bool = False
    bit_rate_switch: bool = False
    remote: bool = False
    error: bool = False
    remote_dlc: int = 0
    error_state_indicator: bool = False

    def __post_init__(self) -> None:
        limit = MAX_EXTENDED_IDENTIFIER if self.extended or self.error else MAX_STANDARD_IDENTIFIER
        if not 0 <= self.identifier <= limit:
            raise LocalProtocolError("CanFrame", "identifier", self.identifier, f"0 to {limit:#x}")
        if not isinstance(self.data, bytes):
            raise LocalProtocolError("CanFrame", "data", self.data, "bytes")
        if self.fd:
            if len(self.data) not in _VALID_FD_LENGTHS:
                lengths = f"0 to 8 or {CAN_FD_LENGTHS[9:]} bytes"
                raise LocalProtocolError("CanFrame", "data", self.data, lengths)
            if self.remote:
                raise LocalProtocolError("CanFrame", "remote", True, "False: CAN FD has no remote frames")
        elif len(self.data) > CLASSIC_BYTES:
            raise LocalProtocolError("CanFrame", "data", self.data, f"0 to {CLASSIC_BYTES} bytes")
        elif self.bit_rate_switch:
            raise LocalProtocolError("CanFrame", "bit_rate_switch", True, "False without fd")
        elif self.error_state_indicator:
            raise LocalProtocolError("CanFrame", "error_state_indicator", True, "False without fd")
        if self.remote:
            if self.data:
                raise LocalProtocolError("CanFrame", "data", self.data, "none in a remote frame")
            if not 0 <= self.remote_dlc <= CLASSIC_BYTES:
                raise LocalProtocolError("CanFrame", "remote_dlc", self.remote_dlc, f"0 to {CLASSIC_BYTES}")
        elif self.remote_dlc:
            raise LocalProtocolError("CanFrame", "remote_dlc", self.remote_dlc, "0 unless remote")
        if self.error:
            if self.extended or self.fd or self.remote:
                raise LocalProtocolError(
                    "CanFrame", "error", True, "neither extended nor fd nor remote with it"
                )
            if len(self.data) != ERROR_FRAME_BYTES:
                raise LocalProtocolError(
                    "CanFrame", "data", self.data, f"{ERROR_FRAME_BYTES} bytes with error"
                )

    @property
    def arbitration_key(self) -> tuple[int, int, int, int]:
        """Of frames that start at the same time the one with the lowest key stays on the bus (ISO 11898-1,
        bitwise arbitration): an 11-bit identifier wins over a 29-bit one with the same first 11 bits, as the
        SRR and IDE bits of the latter are recessive, and data over a remote frame.
        """
        if self.extended:
            return (self.identifier >> 18, 1, self.identifier & 0x3FFFF, int(self.remote))
        return (self.identifier, 0, 0, int(self.remote))

    def candump(self) -> str:
        """The frame as can-utils write it in logs and cansend takes it: ``123#DEADBEEF``,
        ``18DAF110#3E00``, ``123##1DEADBEEF`` (FD with its flags), ``123#R8``, ``20000040#0000000000000000``.
        """
        if self.error:
            name = f"{self.identifier | ERROR_FLAG:08X}"
        else:
            name = f"{self.identifier:08X}" if self.extended else f"{self.identifier:03X}"
        if self.remote:
            return f"{name}#R{self.remote_dlc or ''}"
        data = self.data.hex().upper()
        return f"{name}##{_fd_flags(self) & ~FD_FLAG:X}{data}" if self.fd else f"{name}#{data}"


def padded_length(length: int) -> int:
    """The smallest length of a CAN FD frame that holds ``length`` bytes.

    Raises:
        LocalProtocolError: more than 64 bytes, or fewer than none.
    """
    if 0 <= length <= CLASSIC_BYTES:
        return length
    for valid in CAN_FD_LENGTHS[9:]:
        if CLASSIC_BYTES < length <= valid:
            return valid
    raise LocalProtocolError("CanFrame", "length", length, "0 to 64 bytes")


def _fd_flags(frame: CanFrame) -> int:
    if not frame.fd:
        return 0
    return (
        FD_FLAG
        | (BIT_RATE_SWITCH_FLAG if frame.bit_rate_switch else 0)
        | (ERROR_STATE_FLAG if frame.error_state_indicator else 0)
    )


def encode_record(frame: CanFrame) -> bytes:
    """``frame`` as one record."""
    word = (
        frame.identifier
        | (EXTENDED_FLAG if frame.extended else 0)
        | (REMOTE_FLAG if frame.remote else 0)
        | (ERROR_FLAG if frame.error else 0)
    )
    length = frame.remote_dlc if frame.remote else len(frame.data)
    return word.to_bytes(4, "big") + bytes((length, _fd_flags(frame), 0, 0)) + frame.data


def _frame_of(word: int, length: int, flags: int, data: bytes) -> CanFrame | None:
    """The frame of a record's header and payload; None: no frame has these."""
    fd = bool(flags & FD_FLAG)
    remote = bool(word & REMOTE_FLAG)
    if flags & ~(FD_FLAG | BIT_RATE_SWITCH_FLAG | ERROR_STATE_FLAG):
        return None
    try:
        return CanFrame(
            word & MAX_EXTENDED_IDENTIFIER,
            data,
            extended=bool(word & EXTENDED_FLAG),
            fd=fd,
            bit_rate_switch=bool(flags & BIT_RATE_SWITCH_FLAG),
            remote=remote,
            error=bool(word & ERROR_FLAG),
            remote_dlc=length if remote else 0,
            error_state_indicator=bool(flags & ERROR_STATE_FLAG),
        )
    except LocalProtocolError:
        return None


class RecordDecoder:
    """Bytes of records in, frames out, in their order and independent of how the bytes are cut.

    A record that no frame can have is skipped by its length and counted in ``malformed``. The reserved bytes
    are not looked at. Memory is bounded by what one length byte can announce.
    """

    def __init__(self) -> None:
        self.malformed = 0
        self._rest = b""

    def receive(self, data: bytes) -> list[CanFrame]:
        """The frames that ``data`` completes."""
        frames = []
        data = self._rest + data if self._rest else bytes(data)
        start = 0
        while len(data) - start >= RECORD_HEADER_BYTES:
            word = int.from_bytes(data[start : start + 4], "big")
            length = data[start + 4]
            payload = start + RECORD_HEADER_BYTES
            end = payload if word & REMOTE_FLAG else payload + length
            if end > len(data):
                break
            frame = _frame_of(word, length, data[start + 5], data[payload:end])
            if frame is None:
                self.malformed += 1
            else:
                frames.append(frame)
            start = end
        self._rest = data[start:]
        return frames

    @property
    def incomplete(self) -> bool:
        """Whether the bytes so far end within a record."""
        return bool(self._rest)

    def reset(self) -> None:
        """Forget the record in progress and count it as malformed."""
        self.malformed += bool(self._rest)
        self._rest = b""


class CandumpLine(NamedTuple):
    """A line of a candump log: ``time_ns`` is None where the line has no time."""

    time_ns: int | None
    channel: str
    frame: CanFrame


_CANDUMP_LINE = re.compile(
    r"\s*(?:\((?P<seconds>[0-9]{1,12})\.(?P<fraction>[0-9]{1,9})\)\s+)?(?P<channel>\S+)\s+"
    r"(?P<identifier>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    r"(?:R(?P<dlc>[0-8]?)|(?:\#(?P<flags>[0-9A-Fa-f]))?(?P<data>(?:[0-9A-Fa-f]{2})*)(?:_[9A-Fa-f])?)"
    r"(?:\s+[RT])?\s*"
)


def parse_candump(line: str) -> CandumpLine | None:
    """A line of ``candump -L``, such as ``(1436509052.249713) vcan0 044#2A366C2BBA``, also without its time
    and with the direction (R, T) behind it; None: no such line, or no such frame.
    """
    match = _CANDUMP_LINE.fullmatch(line)
    if match is None:
        return None
    word = int(match["identifier"], 16)
    if len(match["identifier"]) == 8 and not word & ERROR_FLAG:
        word |= EXTENDED_FLAG
    if word & ~(EXTENDED_FLAG | ERROR_FLAG | MAX_EXTENDED_IDENTIFIER):
        return None
    if match["dlc"] is not None:
        frame = _frame_of(word | REMOTE_FLAG, int(match["dlc"] or 0), 0, b"")
    else:
        # Newer kernels show the FDF bit among the flags, older ones do not: the second # says it.
        flags = 0 if match["flags"] is None else int(match["flags"], 16) | FD_FLAG
        frame = _frame_of(word, 0, flags, bytes.fromhex(match["data"]))
    if frame is None:
        return None
    time_ns = None
    if match["seconds"] is not None:
        time_ns = int(match["seconds"]) * NS_PER_S + int(match["fraction"].ljust(9, "0"))
    return CandumpLine(time_ns, match["channel"], frame)


def candump_line(frame: CanFrame, time_ns: int, channel: str) -> str:
    """``frame`` as a line of ``candump -L``, without a line end. ``time_ns`` counts from any epoch and is cut
    to microseconds, which is what the log's readers take.

    Raises:
        LocalProtocolError: a time before its epoch, or a channel that is no word.
    """
    if time_ns < 0:
        raise LocalProtocolError("candump line", "time_ns", time_ns, "0 or more")
    if len(channel.split()) != 1 or channel != channel.strip():
        raise LocalProtocolError("candump line", "channel", channel, "a name without blanks")
    seconds, rest_ns = divmod(time_ns, NS_PER_S)
    return f"({seconds:010d}.{rest_ns // NS_PER_US:06d}) {channel} {frame.candump()}"
