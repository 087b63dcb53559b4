"""The tables of the star tracker card: its own objects, PDOs, states and their transitions.

Source: oresat-configs 1.2.0 (object dictionary of ``star_tracker_1`` of OreSat 1) and the card's software.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from .communication import MappedObject, PdoDefinition
from .data_types import DataType
from .objects import Access, DictionaryObject, Entry, record, variable

DEFAULT_NODE: Final = 0x2C
OBC_NODE: Final = 1

SCET: Final = 0x2010
UTC: Final = 0x2011
SATELLITE_ID: Final = 0x3000
FLIGHT_MODE: Final = 0x3001
VERSIONS: Final = 0x3002
SYSTEM: Final = 0x3003
FREAD_CACHE: Final = 0x3004
FWRITE_CACHE: Final = 0x3005
UPDATER: Final = 0x3006
DAEMONS: Final = 0x3008
BOARD_ID: Final = 0x3009
STATUS: Final = 0x4000
CAPTURE: Final = 0x4001
ORIENTATION: Final = 0x4002
CAPTURE_FILTER: Final = 0x4003

SYSTEM_RESET, STORAGE_PERCENT, RAM_PERCENT, UNIX_TIME, UPTIME, POWER_CYCLES = 1, 2, 3, 4, 5, 6
NUMBER_OF_IMAGES, DELAY, DURATION, LAST_CAPTURE = 1, 2, 3, 4
LAST_DISPLAY_IMAGE, LAST_CAPTURE_TIME, IMAGES_CAPTURED, SAVE_CAPTURES = 5, 6, 7, 8
ATTITUDE_I, ATTITUDE_J, ATTITUDE_K = 1, 2, 3
TIME_SINCE_MIDNIGHT, ATTITUDE_REAL, ATTITUDE_KNOWN = 4, 5, 6
FILTER_ENABLE, LOWER_BOUND, LOWER_PERCENTAGE, UPPER_BOUND, UPPER_PERCENTAGE = 1, 2, 3, 4, 5

DISPLAY_COLUMNS, DISPLAY_ROWS = 640, 480
"""The largest display image, px."""


class CardState(IntEnum):
    """Object 4000h."""

    OFF = 0
    BOOT = 1
    STANDBY = 2
    LOW_POWER = 3
    STAR_TRACK = 4
    CAPTURE = 5
    ERROR = 0xFF


#: The states that can be asked for in a state. BOOT is left by time alone.
TRANSITIONS: Final[dict[CardState, tuple[CardState, ...]]] = {
    CardState.OFF: (),
    CardState.BOOT: (),
    CardState.STANDBY: (CardState.LOW_POWER, CardState.STAR_TRACK, CardState.CAPTURE),
    CardState.LOW_POWER: (CardState.STANDBY, CardState.STAR_TRACK, CardState.CAPTURE),
    CardState.STAR_TRACK: (CardState.STANDBY, CardState.LOW_POWER, CardState.CAPTURE, CardState.ERROR),
    CardState.CAPTURE: (CardState.STANDBY, CardState.LOW_POWER, CardState.STAR_TRACK, CardState.ERROR),
    CardState.ERROR: (CardState.OFF,),
}


class SystemReset(IntEnum):
    """Object 3003h:1."""

    NO_STOP = 0
    SOFT = 1
    HARD = 2
    FACTORY = 3
    POWER_OFF = 4


_BOOL, _U8, _U16, _U32 = DataType.BOOLEAN, DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32
_U64, _F32, _TEXT, _DOMAIN = DataType.UNSIGNED64, DataType.REAL32, DataType.VISIBLE_STRING, DataType.DOMAIN
_CONST, _RO, _RW, _WO = Access.CONST, Access.READ_ONLY, Access.READ_WRITE, Access.WRITE_ONLY

NO_FILES = "0: the device has no files"
NO_DAEMONS = "0: the device has no daemons"

CARD_OBJECTS: Final[tuple[DictionaryObject, ...]] = (
    variable(SCET, "scet", _U64, _RW, 0, "the card's time, u32 s, u24 us of the Unix epoch", mappable=True),
    variable(UTC, "utc", _U64, _RW, 0, "the same, u16 days, u32 ms, u16 us", mappable=True),
    variable(SATELLITE_ID, "satellite_id", _U8, _CONST, 3),
    variable(FLIGHT_MODE, "flight_mode", _BOOL, _RW, 1, "kept, of no effect"),
    record(
        VERSIONS,
        "versions",
        (
            Entry(1, "hw_version", _TEXT, _CONST, "0.0"),
            Entry(2, "configs_version", _TEXT, _CONST, "1.2.0"),
            Entry(3, "olaf_version", _TEXT, _CONST, "0.0.0"),
            Entry(4, "sw_version", _TEXT, _CONST, "0.0.0"),
            Entry(5, "board_number", _U16, _RO, 0),
        ),
    ),
    record(
        SYSTEM,
        "system",
        (
            Entry(
                SYSTEM_RESET,
                "reset",
                _U8,
                _WO,
                0,
                "1 soft, 2 hard, 3 factory values and hard, 4 power off",
                maximum=4,
            ),
            Entry(STORAGE_PERCENT, "storage_percent", _U8, _RO, 0, NO_FILES, "%", mappable=True),
            Entry(RAM_PERCENT, "ram_percent", _U8, _RO, 0, "0: not measured", "%", mappable=True),
            Entry(UNIX_TIME, "unix_time", _U32, _RO, 0, "the card's time", "s", mappable=True),
            Entry(UPTIME, "uptime", _U32, _RO, 0, "since the last start", "s", mappable=True),
            Entry(
                POWER_CYCLES, "power_cycles", _U16, _RO, 0, "starts (ASSUMED: also restarts)", mappable=True
            ),
        ),
    ),
    record(FREAD_CACHE, "fread_cache", (Entry(1, "length", _U8, _RO, 0, NO_FILES, mappable=True),)),
    record(FWRITE_CACHE, "fwrite_cache", (Entry(1, "length", _U8, _RO, 0, NO_FILES, mappable=True),)),
    record(
        UPDATER,
        "updater",
        (
            Entry(1, "status", _U8, _RO, 0, "0: the device has no updater", mappable=True),
            Entry(2, "cache_length", _U8, _RO, 0, NO_FILES, mappable=True),
        ),
    ),
    record(
        DAEMONS,
        "daemons",
        (
            Entry(1, "total", _U8, _RO, 0, NO_DAEMONS, mappable=True),
            Entry(2, "active", _U8, _RO, 0, NO_DAEMONS, mappable=True),
            Entry(3, "failed", _U8, _RO, 0, NO_DAEMONS, mappable=True),
        ),
    ),
    variable(BOARD_ID, "board_id", _U8, _CONST, 0),
    variable(STATUS, "status", _U8, _RW, 0, "read: the state; write: asks for one", mappable=True),
    record(
        CAPTURE,
        "capture",
        (
            Entry(NUMBER_OF_IMAGES, "num_of_images", _U8, _RW, 1, "of CAPTURE; 0: until the duration ends"),
            Entry(DELAY, "delay", _U32, _RW, 100, "between images; 0 in STAR_TRACK: one solved image", "ms"),
            Entry(DURATION, "duration", _U32, _RW, 1, "of CAPTURE", "s"),
            Entry(LAST_CAPTURE, "last_capture", _DOMAIN, _RO, b"", "raw image"),
            Entry(LAST_DISPLAY_IMAGE, "last_display_image", _DOMAIN, _RO, b"", "PNG of it"),
            Entry(LAST_CAPTURE_TIME, "last_capture_time", _U64, _RO, 0, "Unix time of it", "s"),
            Entry(IMAGES_CAPTURED, "images_captured", _U32, _RO, 0, "in the present or last CAPTURE"),
            Entry(SAVE_CAPTURES, "save_captures", _BOOL, _RW, 1, "kept, of no effect: there are no files"),
        ),
    ),
    record(
        ORIENTATION,
        "orientation",
        (
            Entry(ATTITUDE_I, "attitude_i", _F32, _RO, 0.0, "vector part", mappable=True),
            Entry(ATTITUDE_J, "attitude_j", _F32, _RO, 0.0, "vector part", mappable=True),
            Entry(ATTITUDE_K, "attitude_k", _F32, _RO, 0.0, "vector part", mappable=True),
            Entry(
                TIME_SINCE_MIDNIGHT, "time_since_midnight", _U32, _RO, 0, "of the image", "ms", mappable=True
            ),
            Entry(ATTITUDE_REAL, "attitude_real", _F32, _RO, 0.0, "scalar part", mappable=True),
            Entry(ATTITUDE_KNOWN, "attitude_known", _BOOL, _RO, 0, "1: an image was solved", mappable=True),
        ),
    ),
    record(
        CAPTURE_FILTER,
        "capture_filter",
        (
            Entry(FILTER_ENABLE, "enable", _BOOL, _RW, 1, "0: every image is taken"),
            Entry(LOWER_BOUND, "lower_bound", _U8, _RW, 0, "of the pixels' upper 8 bits; 0: not looked at"),
            Entry(
                LOWER_PERCENTAGE, "lower_percentage", _U8, _RW, 0, "at least so many above", "%", maximum=100
            ),
            Entry(UPPER_BOUND, "upper_bound", _U8, _RW, 0, "of the pixels' upper 8 bits; 0: not looked at"),
            Entry(
                UPPER_PERCENTAGE, "upper_percentage", _U8, _RW, 0, "at least so many below", "%", maximum=100
            ),
        ),
    ),
)

RECEIVE_PDOS: Final = (
    PdoDefinition(1, 0x180, (MappedObject(SCET, 0, 64),), 0, "TPDO 1 of the OBC: sets the card's time"),
)

TRANSMIT_PDOS: Final = (
    PdoDefinition(
        1,
        0x180,
        (
            MappedObject(SYSTEM, STORAGE_PERCENT, 8),
            MappedObject(SYSTEM, RAM_PERCENT, 8),
            MappedObject(FREAD_CACHE, 1, 8),
            MappedObject(FWRITE_CACHE, 1, 8),
            MappedObject(DAEMONS, 2, 8),
            MappedObject(DAEMONS, 3, 8),
        ),
        30_000,
        "event timer",
    ),
    PdoDefinition(2, 0x280, (MappedObject(UPDATER, 1, 8), MappedObject(UPDATER, 2, 8)), 5_000, "event timer"),
    PdoDefinition(
        3,
        0x380,
        (
            MappedObject(STATUS, 0, 8),
            MappedObject(ORIENTATION, ATTITUDE_KNOWN, 8),
            MappedObject(ORIENTATION, TIME_SINCE_MIDNIGHT, 32),
        ),
        0,
        "each solved image",
    ),
    PdoDefinition(
        4,
        0x480,
        (MappedObject(ORIENTATION, ATTITUDE_REAL, 32), MappedObject(ORIENTATION, ATTITUDE_I, 32)),
        0,
        "each solved image, behind TPDO 3",
    ),
    PdoDefinition(
        5,
        0x181,  # TPDO 5 to 8 have the identifiers of TPDO 1 to 4 of the next node
        (MappedObject(ORIENTATION, ATTITUDE_J, 32), MappedObject(ORIENTATION, ATTITUDE_K, 32)),
        0,
        "each solved image, behind TPDO 4",
    ),
)

ATTITUDE_PDOS: Final = (3, 4, 5)
"""In the order in which they are sent after a solved image."""
