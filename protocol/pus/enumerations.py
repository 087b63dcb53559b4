"""Numbers with a name that travel on the wire.

Those of the unit itself (modes, reasons, causes) are the firmware's, those of the bus are CAN's; the rest is
the language's own. Each member's meaning stands in ``MEANINGS``; the interface control document prints both.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from enum import Enum, IntEnum

from ...firmware_model.causes import (
    CAUSE_MEANINGS,
    FaultCause,
    FrameDropCause,
    ResetCause,
    SelfTest,
    StoreInvalidCause,
)
from ...firmware_model.modes import MODE_MEANINGS, Mode
from ...firmware_model.reasons import REASON_MEANINGS, Reason
from ..can.vocabulary import CAN_MEANINGS, CanState, TransferFailure

__all__ = [
    "MEANINGS",
    "CanState",
    "EventId",
    "EventSeverity",
    "FailureCode",
    "FaultCause",
    "FrameDropCause",
    "FramingReason",
    "FunctionId",
    "HousekeepingId",
    "MalformedReason",
    "Meanings",
    "MemoryId",
    "Mode",
    "ParameterId",
    "Reason",
    "ResetCause",
    "ResetKind",
    "SelfTest",
    "StoreInvalidCause",
    "TimeStatus",
    "TransferFailure",
]


class FailureCode(IntEnum):
    """Failure notice of the verification reports 1,2 1,4 1,6 1,8 and 1,10."""

    UNKNOWN_APID = 1
    LENGTH = 2
    CRC = 3
    UNKNOWN_SERVICE = 4
    UNKNOWN_SUBSERVICE = 5
    BAD_FIELDS = 6
    NOT_ALLOWED_IN_MODE = 7
    OUT_OF_RANGE = 8
    UNKNOWN_ID = 9
    READ_ONLY = 10
    BUSY = 11
    NO_IMAGE = 12
    BAD_CHECKSUM = 13
    ADDRESS = 14
    SUPERSEDED = 15
    SELF_TEST_FAILED = 16
    ABORTED = 17
    HEADER = 18


class MalformedReason(IntEnum):
    """Why received bytes are not a packet of this interface; the number stands in event TC_MALFORMED."""

    TOO_SHORT = 1
    TOO_LONG = 2
    LENGTH_MISMATCH = 3
    BAD_CRC = 4
    BAD_VERSION = 5
    NOT_TELECOMMAND = 6
    NOT_TELEMETRY = 7
    UNKNOWN_APID = 8
    NO_SECONDARY_HEADER = 9
    SEGMENTED = 10
    BAD_PUS_VERSION = 11
    UNKNOWN_SERVICE = 12
    UNKNOWN_SUBSERVICE = 13
    UNKNOWN_ID = 14
    BAD_FIELDS = 15
    FRAME_OVERSIZED = 16
    FRAME_BAD_ESCAPE = 17

    @property
    def failure_code(self) -> FailureCode:
        """The failure code with which a unit answers a telecommand malformed in this way."""
        return _FAILURE_OF_MALFORMED[self]


class FramingReason(IntEnum):
    """Why the line decoder threw bytes away."""

    OVERSIZED = 1
    BAD_ESCAPE = 2

    @property
    def malformed_reason(self) -> MalformedReason:
        """Its number in event TC_MALFORMED, apart from those of the packet parser."""
        return (
            MalformedReason.FRAME_OVERSIZED
            if self is FramingReason.OVERSIZED
            else MalformedReason.FRAME_BAD_ESCAPE
        )


class HousekeepingId(IntEnum):
    """Housekeeping parameter report structures."""

    STATUS = 1
    LINK = 2
    TIMING = 3
    CAN = 4


class EventId(IntEnum):
    """Event definitions."""

    BOOT_COMPLETED = 1
    MODE_CHANGED = 2
    SELF_TEST_COMPLETED = 3
    FRAME_OVERRAN = 4
    FRAME_DROPPED = 5
    TRACKING_LOST = 6
    ATTITUDE_ACQUIRED = 7
    TC_CRC_FAILED = 8
    TC_MALFORMED = 9
    TC_SEQUENCE_GAP_DETECTED = 10
    SENSOR_BLINDED = 11
    TIME_SET = 12
    FAULT_ENTERED = 13
    PARAMETER_STORE_INVALID = 14
    IMAGE_CAPTURED = 15
    IMAGE_DOWNLOAD_ABORTED = 16
    PARAMETERS_STORED = 17
    SHUTDOWN_STARTED = 18
    TX_QUEUE_OVERFLOWED = 19
    CAN_ERROR_PASSIVE_ENTERED = 20
    CAN_BUS_OFF_RECOVERED = 21
    CAN_TRANSFER_FAILED = 22
    CAN_PACKETS_LOST = 23


class EventSeverity(IntEnum):
    """Severity of an event: the message subtype of its report (ECSS-E-ST-70-41C 6.5.3)."""

    INFO = 1
    LOW = 2
    MEDIUM = 3
    HIGH = 4


class FunctionId(IntEnum):
    """Functions of service 8."""

    GO_STANDBY = 1
    START_ACQUISITION = 2
    START_SELF_TEST = 3
    RESET = 4
    CAPTURE_IMAGE = 5
    DOWNLOAD_IMAGE = 6
    ABORT_DOWNLOAD = 7
    SHUTDOWN = 8
    CLEAR_COUNTERS = 9
    RESTORE_DEFAULT_PARAMETERS = 10
    TRACK_FROM = 11


class ParameterId(IntEnum):
    """On-board parameters of service 20."""

    EXPOSURE_US = 1
    DETECTION_SIGMA = 2
    DETECTION_MIN_PIXELS = 3
    CENTROID_HALF_WINDOW_PX = 4
    MAGNITUDE_LIMIT = 5
    IDENTIFICATION_TOLERANCE_ARCSEC = 6
    IDENTIFICATION_MAX_SPOTS = 7
    TRACKING_RATE_DEG_S = 8
    TRACKING_TOLERANCE_ARCSEC = 9
    TRACKING_MIN_STARS = 10
    TRACKING_MAX_MISSED = 11
    BLINDED_BACKGROUND_DN = 12
    ABERRATION_CORRECTION = 13
    VELOCITY_X_KM_S = 14
    VELOCITY_Y_KM_S = 15
    VELOCITY_Z_KM_S = 16
    ATTITUDE_REPORT = 17
    AUTONOMOUS_START = 18
    PIPELINED = 19
    CLOCK_HZ = 20
    BOOT_COUNT = 21
    CACHE_KIB = 22
    LINE_FILL = 23


class MemoryId(IntEnum):
    """Memories of service 6; their sizes are those of the unit."""

    RAM = 1
    NON_VOLATILE = 2
    IMAGE = 3
    PROGRAM = 4


class TimeStatus(IntEnum):
    """Time reference status of a telemetry packet (ECSS-E-ST-70-41C 7.4.3.1; values are this interface's
    own).
    """

    FREE_RUNNING = 0
    SET = 1


class ResetKind(IntEnum):
    """Argument of function RESET."""

    WARM = 0
    COLD = 1


_FAILURE_OF_MALFORMED: dict[MalformedReason, FailureCode] = {
    MalformedReason.TOO_SHORT: FailureCode.LENGTH,
    MalformedReason.TOO_LONG: FailureCode.LENGTH,
    MalformedReason.LENGTH_MISMATCH: FailureCode.LENGTH,
    MalformedReason.BAD_CRC: FailureCode.CRC,
    MalformedReason.BAD_VERSION: FailureCode.HEADER,
    MalformedReason.NOT_TELECOMMAND: FailureCode.HEADER,
    MalformedReason.NOT_TELEMETRY: FailureCode.HEADER,
    MalformedReason.UNKNOWN_APID: FailureCode.UNKNOWN_APID,
    MalformedReason.NO_SECONDARY_HEADER: FailureCode.HEADER,
    MalformedReason.SEGMENTED: FailureCode.HEADER,
    MalformedReason.BAD_PUS_VERSION: FailureCode.HEADER,
    MalformedReason.UNKNOWN_SERVICE: FailureCode.UNKNOWN_SERVICE,
    MalformedReason.UNKNOWN_SUBSERVICE: FailureCode.UNKNOWN_SUBSERVICE,
    MalformedReason.UNKNOWN_ID: FailureCode.UNKNOWN_ID,
    MalformedReason.BAD_FIELDS: FailureCode.BAD_FIELDS,
    MalformedReason.FRAME_OVERSIZED: FailureCode.LENGTH,
    MalformedReason.FRAME_BAD_ESCAPE: FailureCode.LENGTH,
}

_MEANINGS: tuple[tuple[Enum, str], ...] = (
    *MODE_MEANINGS.items(),
    *REASON_MEANINGS.items(),
    *CAN_MEANINGS,
    *CAUSE_MEANINGS,
    (FailureCode.UNKNOWN_APID, "no application process of this APID here (reported by 1,10); data: the APID"),
    (FailureCode.LENGTH, "packet too short, too long or not of the length it states; data: bytes received"),
    (FailureCode.CRC, "packet error control does not match; data: CRC received"),
    (FailureCode.UNKNOWN_SERVICE, "service not provided; data: service"),
    (FailureCode.UNKNOWN_SUBSERVICE, "message subtype not provided; data: service * 256 + subservice"),
    (FailureCode.BAD_FIELDS, "application data do not fit the layout; data: bytes of the packet"),
    (FailureCode.NOT_ALLOWED_IN_MODE, "not allowed in the present mode; data: mode"),
    (
        FailureCode.OUT_OF_RANGE,
        "a value is outside its range; data: the structure, parameter, function or memory concerned, else 0",
    ),
    (
        FailureCode.UNKNOWN_ID,
        "unknown structure, parameter, function, event or memory; data: the "
        "identifier, 0 when it could not be decoded",
    ),
    (FailureCode.READ_ONLY, "the parameter or memory cannot be written; data: its identifier"),
    (FailureCode.BUSY, "an image is being captured or downloaded; data: 0"),
    (FailureCode.NO_IMAGE, "no captured image; data: 0"),
    (
        FailureCode.BAD_CHECKSUM,
        "checksum of the data to load does not match; data: checksum computed on board",
    ),
    (FailureCode.ADDRESS, "address range outside the memory; data: start address"),
    (FailureCode.SUPERSEDED, "ended by a later telecommand before it completed; data: 0"),
    (FailureCode.SELF_TEST_FAILED, "the self-test found a failure; data: self-test result bits"),
    (FailureCode.ABORTED, "aborted by a telecommand, a reset or a change of mode; data: 0"),
    (
        FailureCode.HEADER,
        "packet header or secondary header not of the supported form; data: malformed reason",
    ),
    (MalformedReason.TOO_SHORT, "fewer bytes than the smallest packet"),
    (MalformedReason.TOO_LONG, "more bytes than the largest packet of this interface"),
    (MalformedReason.LENGTH_MISMATCH, "number of bytes differs from the packet data length field"),
    (MalformedReason.BAD_CRC, "packet error control does not match"),
    (MalformedReason.BAD_VERSION, "packet version number is not 0"),
    (MalformedReason.NOT_TELECOMMAND, "packet type is telemetry where a telecommand is expected"),
    (MalformedReason.NOT_TELEMETRY, "packet type is telecommand where telemetry is expected"),
    (MalformedReason.UNKNOWN_APID, "APID is not one of the receiver's"),
    (MalformedReason.NO_SECONDARY_HEADER, "secondary header flag is 0"),
    (MalformedReason.SEGMENTED, "sequence flags are not '11' (unsegmented)"),
    (MalformedReason.BAD_PUS_VERSION, "PUS version number is not 2"),
    (MalformedReason.UNKNOWN_SERVICE, "service type unknown"),
    (MalformedReason.UNKNOWN_SUBSERVICE, "message subtype unknown in a known service"),
    (MalformedReason.UNKNOWN_ID, "an identifier that determines the layout of what follows is unknown"),
    (MalformedReason.BAD_FIELDS, "application or source data do not fit the layout"),
    (MalformedReason.FRAME_OVERSIZED, "frame longer than the receive buffer (line decoder)"),
    (MalformedReason.FRAME_BAD_ESCAPE, "DB followed by neither DC nor DD (line decoder)"),
    (FramingReason.OVERSIZED, "more bytes between two ENDs than the decoder accepts"),
    (FramingReason.BAD_ESCAPE, "ESC followed by neither ESC_END nor ESC_ESC"),
    (HousekeepingId.STATUS, "mode, start, time and frame statistics"),
    (HousekeepingId.LINK, "counters of the command link"),
    (HousekeepingId.TIMING, "processor cycles of the last frame by stage"),
    (HousekeepingId.CAN, "CAN controller, bus load and transfers"),
    (EventSeverity.INFO, "informative"),
    (EventSeverity.LOW, "low severity anomaly"),
    (EventSeverity.MEDIUM, "medium severity anomaly"),
    (EventSeverity.HIGH, "high severity anomaly"),
    (MemoryId.RAM, "working memory: loadable scratch area"),
    (MemoryId.NON_VOLATILE, "non-volatile memory: the stored parameters"),
    (MemoryId.IMAGE, "the captured image, read-only"),
    (MemoryId.PROGRAM, "program memory, copied anew at each start; a load damages what its check expects"),
    (TimeStatus.FREE_RUNNING, "time counts from power-on or the last cold reset; it has not been set since"),
    (TimeStatus.SET, "time has been set, by telecommand 9,128 or by time_at_sync; a warm reset keeps it"),
    (ResetKind.WARM, "restart the software; the on-board time and the counters of housekeeping are kept"),
    (ResetKind.COLD, "restart as after power-on: the on-board time and the counters start from 0"),
)


class Meanings(Mapping[Enum, str]):
    """Meaning of each enumeration member. Members of different enumerations are different keys, though
    equal as ints.
    """

    def __init__(self, meanings: Iterable[tuple[Enum, str]]) -> None:
        self._texts = {(type(member), member.name): (member, text) for member, text in meanings}

    def __getitem__(self, member: Enum) -> str:
        try:
            return self._texts[type(member), member.name][1]
        except (KeyError, AttributeError):
            raise KeyError(member) from None

    def __iter__(self) -> Iterator[Enum]:
        return (member for member, _ in self._texts.values())

    def __len__(self) -> int:
        return len(self._texts)


MEANINGS = Meanings(_MEANINGS)
"""Meaning of enumeration members; the members without one are described where they are defined (events,
functions, parameters)."""
