"""Static data types of CiA 301 (7.1) that the card's objects have, and their octets: little-endian."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Final

Value = int | float | str | bytes


class DataType(IntEnum):
    """The numbers are those of CiA 301, table 44."""

    BOOLEAN = 0x01
    UNSIGNED8 = 0x05
    UNSIGNED16 = 0x06
    UNSIGNED32 = 0x07
    REAL32 = 0x08
    VISIBLE_STRING = 0x09
    DOMAIN = 0x0F
    UNSIGNED64 = 0x1B


_LAYOUTS: Final = {
    DataType.BOOLEAN: struct.Struct("<B"),
    DataType.UNSIGNED8: struct.Struct("<B"),
    DataType.UNSIGNED16: struct.Struct("<H"),
    DataType.UNSIGNED32: struct.Struct("<I"),
    DataType.REAL32: struct.Struct("<f"),
    DataType.UNSIGNED64: struct.Struct("<Q"),
}


def size_of(data_type: DataType) -> int | None:
    """Octets of a value; None where the length varies."""
    layout = _LAYOUTS.get(data_type)
    return None if layout is None else layout.size


def encode_value(data_type: DataType, value: Value) -> bytes:
    """The octets of a value that the type holds."""
    if isinstance(value, bytes):
        return value
    if isinstance(value, str):
        return value.encode("ascii")
    return _LAYOUTS[data_type].pack(value)


def decode_value(data_type: DataType, data: bytes) -> Value | None:
    """The value of octets; None where the type has no such value or length."""
    layout = _LAYOUTS.get(data_type)
    if layout is not None:
        if len(data) != layout.size:
            return None
        value: int | float = layout.unpack(data)[0]
        return value
    if data_type is DataType.VISIBLE_STRING:
        return data.decode("ascii") if data.isascii() else None
    return data
