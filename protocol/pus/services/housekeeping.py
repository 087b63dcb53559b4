"""ST[03] housekeeping."""

from __future__ import annotations

from ..enumerations import HousekeepingId
from ..field_types import UINT8, UINT32
from ..fields import Case, Field, Repeated, Switched
from ..housekeeping import HOUSEKEEPING_TABLE, MAX_INTERVAL_MS, MIN_INTERVAL_MS
from ..messages import MessageDefinition, ServiceDefinition

_STRUCTURE = Field("structure_id", UINT8, meaning="structure", choices=HousekeepingId, identifier=True)
_STRUCTURES = Repeated("structure_ids", (_STRUCTURE,), 1, 16, "structures concerned")

SERVICE = ServiceDefinition(
    3,
    "Housekeeping",
    "6.3, 8.3",
    "Periodic and one-shot reports of fixed structures; structures cannot be created or deleted on board.",
    (
        MessageDefinition(
            "TC",
            3,
            5,
            "hk_enable",
            "Enable periodic housekeeping reports",
            "8.3.2.5",
            "The structures are reported at their interval from now on.",
            (_STRUCTURES,),
            verification="completion at once",
        ),
        MessageDefinition(
            "TC",
            3,
            6,
            "hk_disable",
            "Disable periodic housekeeping reports",
            "8.3.2.6",
            "The structures are no longer reported periodically.",
            (_STRUCTURES,),
            verification="completion at once",
        ),
        MessageDefinition(
            "TM",
            3,
            25,
            "hk_report",
            "Housekeeping parameter report",
            "8.3.2.25",
            "The values of one structure.",
            (
                _STRUCTURE,
                Switched(
                    "values",
                    "structure_id",
                    {int(entry.id): Case(entry.name, entry.fields) for entry in HOUSEKEEPING_TABLE},
                    "values of the structure",
                ),
            ),
        ),
        MessageDefinition(
            "TC",
            3,
            27,
            "hk_one_shot",
            "Generate a one-shot housekeeping report",
            "8.3.2.27",
            "Each structure is reported once, now.",
            (_STRUCTURES,),
            verification="completion at once",
        ),
        MessageDefinition(
            "TC",
            3,
            31,
            "hk_set_interval",
            "Modify the collection interval of housekeeping structures",
            "8.3.2.31",
            "The structures are reported at this interval; counting starts anew.",
            (
                Repeated(
                    "intervals",
                    (
                        _STRUCTURE,
                        Field(
                            "interval_ms",
                            UINT32,
                            "ms",
                            MIN_INTERVAL_MS,
                            MAX_INTERVAL_MS,
                            "time between two reports",
                        ),
                    ),
                    1,
                    16,
                    "structures and their intervals",
                ),
            ),
            tailoring="The interval is in milliseconds, not in minimum sampling intervals.",
            verification="completion at once",
        ),
    ),
)
