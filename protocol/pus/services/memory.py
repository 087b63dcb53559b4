"""ST[06] memory management: raw memory data areas."""

from __future__ import annotations

from ..enumerations import MemoryId
from ..field_types import UINT8, UINT16, UINT32
from ..fields import Data, Field
from ..messages import MessageDefinition, ServiceDefinition

MAX_LOAD_BYTES = 256
MAX_DUMP_BYTES = 1024

_MEMORY = Field("memory_id", UINT8, meaning="memory", choices=MemoryId, identifier=True)
_START = Field(
    "start_address", UINT32, "byte", meaning="address of the first byte, counted from the memory's start"
)
_CHECKSUM = Field("checksum", UINT16, meaning="CRC-16 of the data, as the packet error control is computed")
_ONE_AREA = "One memory area per request: the number N of areas is 1 and is not transmitted."

SERVICE = ServiceDefinition(
    6,
    "Memory management",
    "6.6, 8.6",
    "Load, dump and check of raw memory areas by absolute address.",
    (
        MessageDefinition(
            "TC",
            6,
            2,
            "memory_load",
            "Load raw memory data areas",
            "8.6.2.2",
            "The data are written when their checksum matches and the area lies in the memory.",
            (
                _MEMORY,
                _START,
                Data("data", 1, MAX_LOAD_BYTES, "data to load", UINT16),
                _CHECKSUM,
            ),
            tailoring=_ONE_AREA,
            verification="completion at once",
        ),
        MessageDefinition(
            "TC",
            6,
            5,
            "memory_dump",
            "Dump raw memory data areas",
            "8.6.2.5",
            "Answered by a dump report.",
            (_MEMORY, _START, Field("length", UINT16, "byte", 1, MAX_DUMP_BYTES, "number of bytes")),
            tailoring=_ONE_AREA,
            verification="completion at once",
        ),
        MessageDefinition(
            "TM",
            6,
            6,
            "memory_dump_report",
            "Dumped raw memory data report",
            "8.6.2.6",
            "The contents of an area.",
            (_MEMORY, _START, Data("data", 1, MAX_DUMP_BYTES, "contents", UINT16), _CHECKSUM),
            tailoring=_ONE_AREA,
        ),
        MessageDefinition(
            "TC",
            6,
            9,
            "memory_check",
            "Check raw memory data areas",
            "8.6.2.9",
            "Answered by a check report.",
            (_MEMORY, _START, Field("length", UINT16, "byte", 1, 65_535, "number of bytes")),
            tailoring=_ONE_AREA,
            verification="completion at once",
        ),
        MessageDefinition(
            "TM",
            6,
            10,
            "memory_check_report",
            "Checked raw memory data report",
            "8.6.2.10",
            "The checksum of an area.",
            (
                _MEMORY,
                _START,
                Field("length", UINT16, "byte", 1, 65_535, "number of bytes"),
                Field(
                    "checksum", UINT16, meaning="CRC-16 of the area, as the packet error control is computed"
                ),
            ),
            tailoring=_ONE_AREA,
        ),
    ),
)
