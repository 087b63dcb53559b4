"""Service data objects (CiA 301, 7.2.4.3): numbers of the frames and of what goes wrong."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

FRAME_BYTES: Final = 8
SEGMENT_BYTES: Final = 7
MOST_BLOCK_SEGMENTS: Final = 127


class ClientCommand(IntEnum):
    """Bits 7 to 5 of a client's first octet."""

    DOWNLOAD_SEGMENT = 0
    INITIATE_DOWNLOAD = 1
    INITIATE_UPLOAD = 2
    UPLOAD_SEGMENT = 3
    ABORT = 4
    BLOCK_UPLOAD = 5
    BLOCK_DOWNLOAD = 6


class ServerCommand(IntEnum):
    """Bits 7 to 5 of a server's first octet."""

    UPLOAD_SEGMENT = 0
    DOWNLOAD_SEGMENT = 1
    INITIATE_UPLOAD = 2
    INITIATE_DOWNLOAD = 3
    ABORT = 4
    BLOCK_DOWNLOAD = 5
    BLOCK_UPLOAD = 6


class BlockCommand(IntEnum):
    """Bits 1 and 0 of the first octet of a block transfer."""

    INITIATE = 0
    END = 1
    ACKNOWLEDGE = 2
    START_UPLOAD = 3


EXPEDITED: Final = 0x02
SIZE_INDICATED: Final = 0x01
TOGGLE: Final = 0x10
LAST_SEGMENT: Final = 0x01
BLOCK_SIZE_INDICATED: Final = 0x02
CRC_SUPPORTED: Final = 0x04
LAST_BLOCK_SEGMENT: Final = 0x80


class AbortCode(IntEnum):
    """CiA 301, table 22: those that the card gives."""

    TOGGLE_BIT = 0x0503_0000
    TIMED_OUT = 0x0504_0000
    COMMAND = 0x0504_0001
    BLOCK_SIZE = 0x0504_0002
    SEQUENCE_NUMBER = 0x0504_0003
    CRC = 0x0504_0004
    WRITE_ONLY = 0x0601_0001
    READ_ONLY = 0x0601_0002
    NO_OBJECT = 0x0602_0000
    LENGTH = 0x0607_0010
    TOO_LONG = 0x0607_0012
    TOO_SHORT = 0x0607_0013
    NO_SUB_INDEX = 0x0609_0011
    VALUE = 0x0609_0030
    VALUE_TOO_HIGH = 0x0609_0031
    DEVICE_STATE = 0x0800_0022
    NO_DATA = 0x0800_0024


ABORT_MEANINGS: Final[dict[AbortCode, str]] = {
    AbortCode.TOGGLE_BIT: "the toggle bit of a segment did not alternate",
    AbortCode.TIMED_OUT: "the client said nothing for the time-out of a transfer",
    AbortCode.COMMAND: "no such command specifier, or none that belongs to the transfer under way",
    AbortCode.BLOCK_SIZE: "a block size of 0 or more than 127 segments",
    AbortCode.SEQUENCE_NUMBER: "more segments acknowledged than were sent",
    AbortCode.CRC: "the CRC of a block download does not match",
    AbortCode.WRITE_ONLY: "read of an object that can be written only",
    AbortCode.READ_ONLY: "write of an object that can be read only",
    AbortCode.NO_OBJECT: "no object of this index",
    AbortCode.LENGTH: "not so many octets as were announced",
    AbortCode.TOO_LONG: "more octets than the object has",
    AbortCode.TOO_SHORT: "fewer octets than the object has",
    AbortCode.NO_SUB_INDEX: "the object has no such sub-index",
    AbortCode.VALUE: "a value that is not allowed",
    AbortCode.VALUE_TOO_HIGH: "a value above the object's range",
    AbortCode.DEVICE_STATE: "not in the present state of the device",
    AbortCode.NO_DATA: "there is nothing: an error history without so many errors",
}


def abort_frame(index: int, sub: int, code: AbortCode) -> bytes:
    """The server ends the transfer of an object."""
    return bytes((ServerCommand.ABORT << 5, index & 0xFF, index >> 8, sub)) + int(code).to_bytes(4, "little")
