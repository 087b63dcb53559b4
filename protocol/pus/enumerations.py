"""Numbers with a name that travel on the wire.

Each member's meaning stands in ``MEANINGS`` below; the interface control document prints both.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from enum import Enum, IntEnum, IntFlag


class Mode(IntEnum):
    """Operating mode of the unit."""

    BOOT = 0
    SELF_TEST = 1
    STANDBY = 2
    LOST_IN_SPACE = 3
    TRACKING = 4
    FAULT = 5
    OFF = 6


class Reason(IntFlag):
    """Why an attitude is not valid (a bit each; 0 when it is valid)."""

    TOO_FEW_STARS = 1
    NO_MATCH = 2
    BLINDED = 4
    RATE_TOO_HIGH = 8
    OVERRUN = 16
    NOT_ACQUIRING = 32
    FRAME_DROPPED = 64
    PIVOT_LOST = 128
    RESIDUAL_TOO_LARGE = 256
    AMBIGUOUS = 512
    WORK_LIMIT = 1024
    NO_FRAME = 2048
    TOO_MANY_SPOTS = 4096
    UNCONFIRMED = 8192


class CanState(IntEnum):
    """State of the unit's CAN controller (ISO 11898-1, fault confinement)."""

    ERROR_ACTIVE = 0
    ERROR_PASSIVE = 1
    BUS_OFF = 2
    NOT_USED = 3


class TransferFailure(IntEnum):
    """Why a transfer by ISO-TP (ISO 15765-2) failed, or a frame of it was ignored."""

    TIMEOUT_A = 1
    TIMEOUT_BS = 2
    TIMEOUT_CR = 3
    WRONG_SEQUENCE = 4
    UNEXPECTED_PDU = 5
    INVALID_FLOW_STATUS = 6
    WAIT_LIMIT = 7
    RECEIVER_OVERFLOW = 8
    TOO_LONG = 9
    BAD_LENGTH = 10
    BAD_PCI = 11
    ABORTED = 12


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


class TimeStatus(IntEnum):
    """Time reference status of a telemetry packet (ECSS-E-ST-70-41C 7.4.3.1; values are this interface's
    own).
    """

    FREE_RUNNING = 0
    SET = 1


class ResetCause(IntEnum):
    """Why the unit started."""

    POWER_ON = 0
    WARM_RESET = 1
    COLD_RESET = 2
    WATCHDOG = 3
    FAULT = 4


class ResetKind(IntEnum):
    """Argument of function RESET."""

    WARM = 0
    COLD = 1


class FrameDropCause(IntEnum):
    """Cause in event FRAME_DROPPED."""

    OVERRUN = 0
    PROCESSOR_BUSY = 1
    NO_FRAME_FROM_SENSOR = 2


class SelfTest(IntFlag):
    """Parts of the self-test that failed (a bit each; 0 when all passed)."""

    PROCESSOR = 1
    MEMORY = 2
    PARAMETER_STORE = 4
    CATALOGUE = 8
    SENSOR = 16
    CLOCK = 32


class FaultCause(IntEnum):
    """Cause in event FAULT_ENTERED."""

    SELF_TEST_FAILED = 1
    SENSOR_LOST = 2
    PROCESSOR_OVERLOADED = 3
    CATALOGUE_DAMAGED = 4
    COMMANDED = 5


class StoreInvalidCause(IntEnum):
    """Cause in event PARAMETER_STORE_INVALID."""

    ABSENT = 1
    TRUNCATED = 2
    BAD_CHECKSUM = 3
    OUT_OF_RANGE = 4
    OTHER_UNIT = 5


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
    (Mode.BOOT, "initialising after power-on or reset; no attitude"),
    (Mode.SELF_TEST, "testing itself; no attitude"),
    (Mode.STANDBY, "waiting for a command; frames are not processed"),
    (Mode.LOST_IN_SPACE, "looking for the attitude over the whole sky, without any prior"),
    (Mode.TRACKING, "following the stars in detection windows from frame to frame"),
    (Mode.FAULT, "stopped by a fault; only a reset or a self-test leads out"),
    (Mode.OFF, "shut down; nothing is sent until power is cycled"),
    (Reason.TOO_FEW_STARS, "fewer spots or identified stars than the solution needs"),
    (Reason.NO_MATCH, "enough spots, but no consistent identification"),
    (Reason.BLINDED, "background above the limit of parameter blinded_background_dn"),
    (Reason.RATE_TOO_HIGH, "angular rate above what the detection windows cover"),
    (Reason.OVERRUN, "a frame needed more cycles than its budget and this one was dropped for it"),
    (Reason.NOT_ACQUIRING, "the mode does not process frames"),
    (Reason.FRAME_DROPPED, "the frame was dropped before processing"),
    (Reason.PIVOT_LOST, "no star could serve as pivot for the verification of the windows"),
    (Reason.RESIDUAL_TOO_LARGE, "residual of the attitude solution above the tolerance"),
    (Reason.AMBIGUOUS, "more than one consistent identification"),
    (Reason.WORK_LIMIT, "the search was cut off at its work limit"),
    (Reason.NO_FRAME, "the sensor delivered no frame"),
    (Reason.TOO_MANY_SPOTS, "more spots than the unit handles"),
    (Reason.UNCONFIRMED, "stars were identified, but too few of them to be sure"),
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
    (CanState.ERROR_ACTIVE, "takes part in everything on the bus"),
    (CanState.ERROR_PASSIVE, "an error counter is above 127: it no longer stops the frames of others"),
    (CanState.BUS_OFF, "the transmit error counter is above 255: it sends and receives nothing"),
    (CanState.NOT_USED, "the unit is on its serial line, or off"),
    (TransferFailure.TIMEOUT_A, "N_As or N_Ar: the controller did not get the frame onto the bus"),
    (TransferFailure.TIMEOUT_BS, "N_Bs: no flow control came"),
    (TransferFailure.TIMEOUT_CR, "N_Cr: no consecutive frame came"),
    (TransferFailure.WRONG_SEQUENCE, "sequence number of a consecutive frame is not the next one"),
    (TransferFailure.UNEXPECTED_PDU, "a frame that does not belong to what is under way"),
    (TransferFailure.INVALID_FLOW_STATUS, "flow control with a reserved flow status"),
    (TransferFailure.WAIT_LIMIT, "more flow control frames WAIT than allowed"),
    (TransferFailure.RECEIVER_OVERFLOW, "flow control OVFLW: the receiver has no room for the packet"),
    (TransferFailure.TOO_LONG, "first frame of more bytes than the receive buffer has"),
    (TransferFailure.BAD_LENGTH, "a length that the frame cannot have"),
    (TransferFailure.BAD_PCI, "reserved protocol control information"),
    (TransferFailure.ABORTED, "given up by a reset"),
    (EventSeverity.INFO, "informative"),
    (EventSeverity.LOW, "low severity anomaly"),
    (EventSeverity.MEDIUM, "medium severity anomaly"),
    (EventSeverity.HIGH, "high severity anomaly"),
    (MemoryId.RAM, "working memory: loadable scratch area"),
    (MemoryId.NON_VOLATILE, "non-volatile memory: the stored parameters"),
    (MemoryId.IMAGE, "the captured image, read-only"),
    (TimeStatus.FREE_RUNNING, "time counts from power-on or the last cold reset; it has not been set since"),
    (TimeStatus.SET, "time has been set, by telecommand 9,128 or by time_at_sync; a warm reset keeps it"),
    (ResetCause.POWER_ON, "power was applied"),
    (ResetCause.WARM_RESET, "function RESET, warm"),
    (ResetCause.COLD_RESET, "function RESET, cold"),
    (ResetCause.WATCHDOG, "watchdog expired (reserved: nothing raises it so far)"),
    (ResetCause.FAULT, "restart after a fault (reserved: nothing raises it so far)"),
    (ResetKind.WARM, "restart the software; the on-board time and the counters of housekeeping are kept"),
    (ResetKind.COLD, "restart as after power-on: the on-board time and the counters start from 0"),
    (FrameDropCause.OVERRUN, "at its read-out the processor was still busy with an earlier frame"),
    (
        FrameDropCause.PROCESSOR_BUSY,
        "not exposed: the processor was still busy with an earlier frame (parameter pipelined 0)",
    ),
    (FrameDropCause.NO_FRAME_FROM_SENSOR, "the sensor delivered no frame"),
    (SelfTest.PROCESSOR, "processor test (reserved: nothing raises it so far)"),
    (SelfTest.MEMORY, "working memory test"),
    (SelfTest.PARAMETER_STORE, "stored parameters are damaged"),
    (SelfTest.CATALOGUE, "star catalogue checksum"),
    (SelfTest.SENSOR, "image sensor gives no frame"),
    (SelfTest.CLOCK, "clock out of tolerance (reserved: nothing raises it so far)"),
    (FaultCause.SELF_TEST_FAILED, "the self-test failed"),
    (FaultCause.SENSOR_LOST, "no frames from the sensor (reserved: nothing raises it so far)"),
    (FaultCause.PROCESSOR_OVERLOADED, "every frame overruns (reserved: nothing raises it so far)"),
    (FaultCause.CATALOGUE_DAMAGED, "star catalogue damaged (reserved: nothing raises it so far)"),
    (FaultCause.COMMANDED, "fault injected by the bench (reserved: nothing raises it so far)"),
    (StoreInvalidCause.ABSENT, "nothing stored"),
    (StoreInvalidCause.TRUNCATED, "stored record is cut short"),
    (StoreInvalidCause.BAD_CHECKSUM, "stored record's checksum does not match"),
    (StoreInvalidCause.OUT_OF_RANGE, "a stored value is outside its range"),
    (StoreInvalidCause.OTHER_UNIT, "stored by a unit of another type or version"),
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
