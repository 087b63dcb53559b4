"""ST[13] large packet transfer: downlink of the captured image."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import construct

from ...errors import LocalProtocolError, RemoteProtocolError
from ..field_types import CUC, UINT8, UINT16, UINT32, FieldError
from ..fields import Data, DataLayout, Element, Field
from ..messages import MessageDefinition, ServiceDefinition
from ..packets import MAX_TELEMETRY_BYTES, MIN_TELEMETRY_BYTES

MAX_PART_BYTES = MAX_TELEMETRY_BYTES - MIN_TELEMETRY_BYTES - 4
"""Largest part that fits into a telemetry packet (4 bytes are the transaction and part numbers)."""

IMAGE_HEADER_FIELDS: tuple[Element, ...] = (
    Field("frame_index", UINT32, meaning="index of the frame"),
    Field("width", UINT16, "px", meaning="columns"),
    Field("height", UINT16, "px", meaning="rows"),
    Field("bits", UINT8, "bit", 1, 16, "bits of a pixel that are used"),
    Field("reserved", UINT8, "", 0, 0, "0"),
    Field("time", CUC, meaning="on-board time of mid-exposure"),
    Field("exposure_us", UINT32, "us", meaning="exposure time"),
    Field("crc", UINT16, meaning="CRC-16 of the pixels, as the packet error control is computed"),
)

_IMAGE_HEADER = DataLayout(IMAGE_HEADER_FIELDS)
IMAGE_HEADER_BYTES = 23


def encode_image_header(fields: Mapping[str, Any]) -> bytes:
    """The header of a downloaded image; LocalProtocolError when a field is not allowed."""
    try:
        return _IMAGE_HEADER.build(fields)
    except FieldError as error:
        violation = error.violation
        raise LocalProtocolError(
            "image header", violation.field, violation.value, violation.allowed
        ) from None


def decode_image_header(data: bytes) -> dict[str, Any]:
    """The fields of the header with which ``data``, the joined parts of an image, starts.

    RemoteProtocolError when there are fewer bytes than a header.
    """
    try:
        return _IMAGE_HEADER.parse(data[:IMAGE_HEADER_BYTES])
    except construct.ConstructError:
        raise RemoteProtocolError(
            f"an image header has {IMAGE_HEADER_BYTES} bytes, got {len(data)}"
        ) from None


_PART: tuple[Element, ...] = (
    Field("transaction_id", UINT16, meaning="large message transaction identifier"),
    Field("part_number", UINT16, "", 1, None, "part sequence number, from 1"),
    Data("data", 1, MAX_PART_BYTES, "the part"),
)
_TAILORING = (
    "The length of a part is deduced from the length of the packet for every part, not for the last alone."
)

SERVICE = ServiceDefinition(
    13,
    "Large packet transfer",
    "6.13, 8.13",
    "The captured image: the image header, then the pixels, big-endian u16, row by row from the top; cut "
    "into parts of one length, the last of which may be shorter. Part 1 goes as first part, the last one as "
    "last part, also when only some parts are sent again; an image of a single part goes as last part.",
    (
        MessageDefinition(
            "TM",
            13,
            1,
            "image_first_part",
            "First downlink part report",
            "8.13.2.1",
            "Part 1; it starts with the image header (see below).",
            _PART,
            _TAILORING,
        ),
        MessageDefinition(
            "TM",
            13,
            2,
            "image_part",
            "Intermediate downlink part report",
            "8.13.2.2",
            "A part that is neither the first nor the last of the image.",
            _PART,
            _TAILORING,
        ),
        MessageDefinition(
            "TM",
            13,
            3,
            "image_last_part",
            "Last downlink part report",
            "8.13.2.3",
            "The last part of the image.",
            _PART,
            _TAILORING,
        ),
    ),
)
