"""Frames: address, type, id, payload and hash between two C0; requests taken apart, replies put together."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Final

from ..framing import slip_encode
from .xxh32 import xxh32

__all__ = [
    "ADDRESS",
    "HASH_BYTES",
    "HASH_SEED",
    "HEADER_BYTES",
    "MOST_REQUEST_BYTES",
    "STATUS_MEANINGS",
    "TELEMETRY_HEADER_BYTES",
    "BadRequest",
    "MessageType",
    "RefusedFrame",
    "Request",
    "Status",
    "body_of",
    "frame_of",
    "parse_request",
    "request_body",
    "telemetry_body",
]

ADDRESS: Final = 0x21
HASH_SEED: Final = 1425
HASH_BYTES: Final = 4
HEADER_BYTES: Final = 3  # address, type, id
TELEMETRY_HEADER_BYTES: Final = 16  # those, status, counter and time
#: ASSUMED: the longest request has 72 bytes; whatever is longer than this is none.
MOST_REQUEST_BYTES: Final = 128


class MessageType(IntEnum):
    """The second byte of a frame. A reply's is the request's with the highest bit set."""

    SET_PARAMETER = 0x00
    READ_PARAMETER = 0x01
    REQUEST_TELEMETRY = 0x02
    ACTION = 0x03
    SET_PARAMETER_REPLY = 0x80
    PARAMETER = 0x81
    TELEMETRY = 0x82
    ACTION_REPLY = 0x83
    ASYNCHRONOUS_TELEMETRY = 0x84


REQUEST_TYPES: Final = (
    MessageType.SET_PARAMETER,
    MessageType.READ_PARAMETER,
    MessageType.REQUEST_TELEMETRY,
    MessageType.ACTION,
)


class Status(IntEnum):
    """The status of a reply. 0 and 1 are known; ASSUMED: which errors there are and their numbers from 2
    on (all that is known is that 2 to 255 are errors)."""

    OK = 0
    NOT_IMPLEMENTED = 1
    BAD_ARGUMENTS = 2
    NOT_NOW = 3
    BOOT_LOADER = 4


STATUS_MEANINGS: Final[dict[Status, str]] = {
    Status.OK: "done",
    Status.NOT_IMPLEMENTED: "no such parameter, telemetry or action",
    Status.BAD_ARGUMENTS: "arguments of a wrong length or out of range; nothing was changed",
    Status.NOT_NOW: "not in the present state; nothing was changed",
    Status.BOOT_LOADER: "the boot loader takes the action boot alone",
}


class RefusedFrame(Enum):
    """Why a frame is no request. The value says it for people."""

    SHORT = "shorter than address, type, id and hash"
    LONG = "longer than any request"
    ADDRESS = "another address"
    HASH = "the hash does not fit"
    TYPE = "no type of a request"


@dataclass(frozen=True, slots=True)
class Request:
    """A request of the OBC. ``id``: of the parameter, telemetry or action."""

    type: MessageType
    id: int
    arguments: bytes


@dataclass(frozen=True, slots=True)
class BadRequest:
    """What came in place of a request."""

    reason: RefusedFrame


def body_of(type_: MessageType, id_: int, payload: bytes = b"", address: int = ADDRESS) -> bytes:
    """Address, type, id and payload, with the hash behind them; not yet framed."""
    body = bytes([address, type_, id_]) + payload
    return body + struct.pack("<I", xxh32(body, HASH_SEED))


def frame_of(body: bytes) -> bytes:
    """A body as it goes onto the line: escaped, between two C0."""
    return slip_encode(body)


def request_body(request: Request, address: int = ADDRESS) -> bytes:
    """The body of a request."""
    return body_of(request.type, request.id, request.arguments, address)


def telemetry_body(
    type_: MessageType, id_: int, status: int, counter: int, time_us: int, data: bytes, address: int = ADDRESS
) -> bytes:
    """The body of telemetry: status, counter (32 bits) and time (64 bits) stand in front of its data."""
    head = struct.pack("<BIQ", status, counter & 0xFFFFFFFF, time_us & 0xFFFFFFFFFFFFFFFF)
    return body_of(type_, id_, head + data, address)


def parse_request(body: bytes, address: int = ADDRESS, *, hash_checked: bool = True) -> Request | BadRequest:
    """A body as it came between two C0, its escapes undone."""
    if len(body) < HEADER_BYTES + HASH_BYTES:
        return BadRequest(RefusedFrame.SHORT)
    if len(body) > MOST_REQUEST_BYTES:
        return BadRequest(RefusedFrame.LONG)
    if body[0] != address:
        return BadRequest(RefusedFrame.ADDRESS)
    (found,) = struct.unpack("<I", body[-HASH_BYTES:])
    if hash_checked and found != xxh32(body[:-HASH_BYTES], HASH_SEED):
        return BadRequest(RefusedFrame.HASH)
    if body[1] not in REQUEST_TYPES:
        return BadRequest(RefusedFrame.TYPE)
    return Request(MessageType(body[1]), body[2], bytes(body[HEADER_BYTES:-HASH_BYTES]))
