"""Records and python-can's messages: the same frames in the two forms that pass through a CAN link."""

from __future__ import annotations

import logging
import struct
from collections.abc import Iterator

import can

from ...protocol.can.frames import (
    ERROR_FRAME_BYTES,
    MAX_EXTENDED_IDENTIFIER,
    RECORD_HEADER_BYTES,
    REMOTE_FLAG,
    CanFrame,
    RecordDecoder,
    encode_record,
)

# Without a handler of its user's, python-can's remarks would go to standard error: what matters is raised.
logging.getLogger("can").addHandler(logging.NullHandler())

RECORD_HEADER = struct.Struct(">IBBH")
MOST_FRAMES_A_READ = 8192
"""A bus that is faster than its reader must not keep it in one call for ever; the rest comes at the next."""


def records(data: bytes) -> Iterator[bytes]:
    """The whole records that `data` begins with."""
    start = 0
    while start + RECORD_HEADER_BYTES <= len(data):
        word, length, _, _ = RECORD_HEADER.unpack_from(data, start)
        end = start + RECORD_HEADER_BYTES + (0 if word & REMOTE_FLAG else length)
        if end > len(data):
            return
        yield data[start:end]
        start = end


def message_of(frame: CanFrame) -> can.Message:
    return can.Message(
        arbitration_id=frame.identifier,
        is_extended_id=frame.extended,
        is_remote_frame=frame.remote,
        is_fd=frame.fd,
        bitrate_switch=frame.bit_rate_switch,
        error_state_indicator=frame.error_state_indicator,
        dlc=frame.remote_dlc if frame.remote else len(frame.data),
        data=frame.data,
    )


def record_of(message: can.Message) -> bytes:
    """LocalProtocolError: no frame has these."""
    data = bytes(message.data)
    if message.is_error_frame:
        identifier = message.arbitration_id & MAX_EXTENDED_IDENTIFIER
        padded = data[:ERROR_FRAME_BYTES].ljust(ERROR_FRAME_BYTES, b"\0")
        return encode_record(CanFrame(identifier, padded, error=True))
    return encode_record(
        CanFrame(
            message.arbitration_id,
            b"" if message.is_remote_frame else data,
            extended=message.is_extended_id,
            fd=message.is_fd,
            bit_rate_switch=message.bitrate_switch,
            remote=message.is_remote_frame,
            remote_dlc=message.dlc if message.is_remote_frame else 0,
            error_state_indicator=message.error_state_indicator,
        )
    )


def frame_to_send(record: bytes, fd: bool) -> CanFrame | None:
    frames = RecordDecoder().receive(record)
    if not frames or frames[0].error or (frames[0].fd and not fd):
        return None
    return frames[0]


def one_line(error: Exception) -> str:
    """What an error of somebody else's says, fit for a LinkError."""
    return " ".join(str(error).split())
