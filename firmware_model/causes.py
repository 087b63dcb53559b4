"""Why a unit started, failed or lost something. The numbers are those of the telemetry.

With :mod:`modes` and :mod:`reasons` this is the firmware's vocabulary: enumerations without code, which the
protocol and an OBC read as well.
"""

from __future__ import annotations

from enum import Enum, IntEnum, IntFlag

__all__ = [
    "CAUSE_MEANINGS",
    "FaultCause",
    "FrameDropCause",
    "ResetCause",
    "SelfTest",
    "StoreInvalidCause",
]


class ResetCause(IntEnum):
    """Why the unit started."""

    POWER_ON = 0
    WARM_RESET = 1
    COLD_RESET = 2
    WATCHDOG = 3
    FAULT = 4


class FrameDropCause(IntEnum):
    """Why a frame was not processed."""

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
    PROGRAM = 64


class FaultCause(IntEnum):
    """Why the unit went to FAULT."""

    SELF_TEST_FAILED = 1
    SENSOR_LOST = 2
    PROCESSOR_OVERLOADED = 3
    CATALOGUE_DAMAGED = 4
    COMMANDED = 5
    PROGRAM_DAMAGED = 6


class StoreInvalidCause(IntEnum):
    """Why the contents of the non-volatile memory are not used."""

    ABSENT = 1
    TRUNCATED = 2
    BAD_CHECKSUM = 3
    OUT_OF_RANGE = 4
    OTHER_UNIT = 5


CAUSE_MEANINGS: tuple[tuple[Enum, str], ...] = (
    (ResetCause.POWER_ON, "power was applied"),
    (ResetCause.WARM_RESET, "function RESET, warm"),
    (ResetCause.COLD_RESET, "function RESET, cold"),
    (ResetCause.WATCHDOG, "the watchdog expired: the processor hung"),
    (ResetCause.FAULT, "restart after a fault (reserved: nothing raises it so far)"),
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
    (SelfTest.PROGRAM, "program memory checksum"),
    (FaultCause.SELF_TEST_FAILED, "the self-test failed"),
    (FaultCause.SENSOR_LOST, "no frames from the sensor for two seconds while they were wanted"),
    (FaultCause.PROCESSOR_OVERLOADED, "every frame overruns (reserved: nothing raises it so far)"),
    (FaultCause.CATALOGUE_DAMAGED, "the star catalogue does not match its checksum any more"),
    (FaultCause.COMMANDED, "fault injected by the bench"),
    (FaultCause.PROGRAM_DAMAGED, "the program memory does not match its checksum any more"),
    (StoreInvalidCause.ABSENT, "nothing stored"),
    (StoreInvalidCause.TRUNCATED, "stored record is cut short"),
    (StoreInvalidCause.BAD_CHECKSUM, "stored record's checksum does not match"),
    (StoreInvalidCause.OUT_OF_RANGE, "a stored value is outside its range"),
    (StoreInvalidCause.OTHER_UNIT, "stored by a unit of another type or version"),
)
