"""ST[09] time management, and the setting of the time (mission-specific)."""

from __future__ import annotations

from ..enumerations import TimeStatus
from ..field_types import CUC, UINT8
from ..fields import Field
from ..messages import MessageDefinition, ServiceDefinition

MAX_RATE_EXPONENT = 8
_RATE = Field("rate_exponent", UINT8, "", 0, MAX_RATE_EXPONENT, "a time report each 2^rate_exponent frames")

SERVICE = ServiceDefinition(
    9,
    "Time management",
    "6.9, 8.9",
    "Reports of the on-board time and its setting.",
    (
        MessageDefinition(
            "TC",
            9,
            1,
            "time_report_rate",
            "Set the time report generation rate",
            "8.9.2.1",
            "Time reports are sent at this rate from the next frame start on.",
            (_RATE,),
            tailoring="The rate counts frames of the sensor, not transfer frames of channel 0 (6.9.3).",
            verification="completion at once",
        ),
        MessageDefinition(
            "TM",
            9,
            2,
            "time_report",
            "CUC time report",
            "8.9.2.2",
            "The on-board time at the start of the frame that caused the report.",
            (
                _RATE,
                Field("time", CUC, meaning="on-board time at the frame start"),
                Field("time_status", UINT8, meaning="time reference status", choices=TimeStatus),
            ),
            tailoring="An ordinary packet of the unit, with secondary header, not the spacecraft time packet "
            "of APID 0 (6.9.4): the unit's time is not the spacecraft's.",
        ),
        MessageDefinition(
            "TC",
            9,
            128,
            "set_time",
            "Set the on-board time",
            "",
            "The time given is that of the instant at which the last byte of the telecommand was "
            "received. The unit carries it on to the next frame start and takes it over there; event "
            "TIME_SET is sent then.",
            (Field("time", CUC, meaning="TAI at the reception of the last byte"),),
            tailoring="Mission-specific message subtype.",
            verification="start; completion when the time has been taken over",
        ),
    ),
)
