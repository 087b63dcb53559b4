"""Event definitions of service 5: one table."""

from __future__ import annotations

from dataclasses import dataclass

from .enumerations import (
    EventId,
    EventSeverity,
    FaultCause,
    FrameDropCause,
    MalformedReason,
    Mode,
    Reason,
    ResetCause,
    SelfTest,
    StoreInvalidCause,
    TransferFailure,
)
from .field_types import CUC, UINT8, UINT16, UINT32
from .fields import Field


@dataclass(frozen=True)
class EventDefinition:
    """One event: its number, severity and auxiliary data."""

    id: EventId
    severity: EventSeverity
    meaning: str
    fields: tuple[Field, ...] = ()

    @property
    def name(self) -> str:
        """Its name."""
        return self.id.name

    @property
    def message_name(self) -> str:
        """The message that reports it: ``event_info``, ``event_low``, ``event_medium`` or ``event_high``."""
        return f"event_{self.severity.name.lower()}"


_FRAME = Field("frame_index", UINT32, meaning="index of the frame")
_INFO, _LOW, _MEDIUM, _HIGH = EventSeverity.INFO, EventSeverity.LOW, EventSeverity.MEDIUM, EventSeverity.HIGH

EVENT_TABLE: tuple[EventDefinition, ...] = (
    EventDefinition(
        EventId.BOOT_COMPLETED,
        _INFO,
        "the unit has started and listens to telecommands",
        (
            Field("boot_count", UINT16, meaning="starts of the unit so far"),
            Field("reset_cause", UINT8, meaning="why it started", choices=ResetCause),
        ),
    ),
    EventDefinition(
        EventId.MODE_CHANGED,
        _INFO,
        "the mode has changed",
        (
            Field("from_mode", UINT8, meaning="mode before", choices=Mode),
            Field("to_mode", UINT8, meaning="mode now", choices=Mode),
            Field("cause", UINT8, meaning="number of the mode event that caused it (table of mode rules)"),
        ),
    ),
    EventDefinition(
        EventId.SELF_TEST_COMPLETED,
        _INFO,
        "the self-test has ended",
        (Field("result", UINT16, meaning="parts that failed; 0: passed", choices=SelfTest),),
    ),
    EventDefinition(
        EventId.FRAME_OVERRAN,
        _LOW,
        "a frame needed more cycles than its budget; its attitude is late",
        (
            _FRAME,
            Field("cycles", UINT32, "cycle", meaning="cycles it needed"),
            Field("budget", UINT32, "cycle", meaning="cycles it had"),
            Field("late_us", UINT32, "us", meaning="time by which it was late"),
        ),
    ),
    EventDefinition(
        EventId.FRAME_DROPPED,
        _LOW,
        "a frame was not processed",
        (_FRAME, Field("cause", UINT8, meaning="why", choices=FrameDropCause)),
    ),
    EventDefinition(
        EventId.TRACKING_LOST,
        _LOW,
        "tracking was given up",
        (_FRAME, Field("reasons", UINT32, meaning="reasons of that frame", choices=Reason)),
    ),
    EventDefinition(
        EventId.ATTITUDE_ACQUIRED,
        _INFO,
        "first valid attitude after LOST_IN_SPACE or RATE_ONLY",
        (_FRAME, Field("stars", UINT8, meaning="identified stars; 255 stands for 255 or more")),
    ),
    EventDefinition(
        EventId.TC_CRC_FAILED,
        _LOW,
        "a packet was received with wrong packet error control",
        (
            Field("count", UINT16, meaning="counter crc_errors after it"),
            Field("length", UINT16, "byte", meaning="length of the packet"),
        ),
    ),
    EventDefinition(
        EventId.TC_MALFORMED,
        _LOW,
        "bytes were received that are no packet of this interface (a wrong CRC has its own event)",
        (
            Field("reason", UINT8, meaning="why", choices=MalformedReason),
            Field("count", UINT16, meaning="counter concerned after it"),
            Field("length", UINT16, "byte", meaning="length of the frame; 65535 stands for 65535 or more"),
        ),
    ),
    EventDefinition(
        EventId.TC_SEQUENCE_GAP_DETECTED,
        _LOW,
        "the sequence count of a source's telecommands did not go up by one; the telecommand is executed",
        (
            Field("source_id", UINT16, meaning="source"),
            Field("expected", UINT16, meaning="sequence count that was due"),
            Field("received", UINT16, meaning="sequence count that came"),
        ),
    ),
    EventDefinition(
        EventId.SENSOR_BLINDED,
        _MEDIUM,
        "background above the limit of parameter blinded_background_dn",
        (_FRAME, Field("background_dn", UINT16, "DN", meaning="mean background")),
    ),
    EventDefinition(
        EventId.TIME_SET,
        _INFO,
        "the on-board time was set; sent with the new time",
        (
            Field("old", CUC, meaning="on-board time at the frame start, before"),
            Field("new", CUC, meaning="on-board time at the same instant, after"),
        ),
    ),
    EventDefinition(
        EventId.FAULT_ENTERED,
        _HIGH,
        "the unit stopped in mode FAULT",
        (Field("cause", UINT8, meaning="why", choices=FaultCause),),
    ),
    EventDefinition(
        EventId.PARAMETER_STORE_INVALID,
        _MEDIUM,
        "the stored parameters are not usable; defaults are in force",
        (Field("cause", UINT8, meaning="why", choices=StoreInvalidCause),),
    ),
    EventDefinition(
        EventId.IMAGE_CAPTURED,
        _INFO,
        "an image is ready for download",
        (_FRAME, Field("bytes", UINT32, "byte", meaning="size with its header")),
    ),
    EventDefinition(
        EventId.IMAGE_DOWNLOAD_ABORTED,
        _LOW,
        "a download ended before its last part",
        (
            Field("transaction_id", UINT16, meaning="transaction"),
            Field("part", UINT16, meaning="last part sent; 0: none"),
        ),
    ),
    EventDefinition(
        EventId.PARAMETERS_STORED,
        _INFO,
        "parameters were written to non-volatile memory",
        (Field("count", UINT16, meaning="number of parameters that were set"),),
    ),
    EventDefinition(
        EventId.SHUTDOWN_STARTED, _INFO, "the unit is shutting down; what is queued still leaves"
    ),
    EventDefinition(
        EventId.TX_QUEUE_OVERFLOWED,
        _LOW,
        "the transmit queue was full and packets were thrown away; sent when half of the queue is free again",
        (Field("packets", UINT16, meaning="packets thrown away"),),
    ),
    EventDefinition(
        EventId.CAN_ERROR_PASSIVE_ENTERED,
        _LOW,
        "an error counter of the CAN controller went above 127",
        (
            Field("transmit_errors", UINT16, meaning="transmit error counter"),
            Field("receive_errors", UINT16, meaning="receive error counter"),
        ),
    ),
    EventDefinition(
        EventId.CAN_BUS_OFF_RECOVERED,
        _MEDIUM,
        "the CAN controller takes part in the bus again after it was bus-off",
        (
            Field("duration_ms", UINT32, "ms", meaning="time from bus-off to now"),
            Field("count", UINT16, meaning="counter bus_off_count"),
        ),
    ),
    EventDefinition(
        EventId.CAN_TRANSFER_FAILED,
        _LOW,
        "a telecommand was given up on its way, or a frame was ignored; at most one event a second",
        (
            Field("reason", UINT8, meaning="why, the last time", choices=TransferFailure),
            Field("count", UINT16, meaning="how often since the last such event"),
        ),
    ),
    EventDefinition(
        EventId.CAN_PACKETS_LOST,
        _LOW,
        "telemetry packets were lost because nobody took them; sent when the receiver takes packets again",
        (
            Field("reason", UINT8, meaning="why the first of them was given up", choices=TransferFailure),
            Field("packets", UINT16, meaning="packets lost"),
        ),
    ),
)

EVENTS: dict[int, EventDefinition] = {int(event.id): event for event in EVENT_TABLE}
"""By number."""
