"""ST[05] event reporting."""

from __future__ import annotations

from ..enumerations import EventId, EventSeverity
from ..events import EVENT_TABLE
from ..field_types import UINT16
from ..fields import Case, Field, Repeated, Switched
from ..messages import MessageDefinition, ServiceDefinition

_EVENT = Field("event_id", UINT16, meaning="event definition", choices=EventId, identifier=True)
_EVENTS = Repeated("event_ids", (_EVENT,), 1, 64, "event definitions concerned")

_TITLES = {
    EventSeverity.INFO: "Informative event report",
    EventSeverity.LOW: "Low severity anomaly report",
    EventSeverity.MEDIUM: "Medium severity anomaly report",
    EventSeverity.HIGH: "High severity anomaly report",
}


def _report(severity: EventSeverity) -> MessageDefinition:
    cases = {
        int(event.id): Case(event.name, event.fields) for event in EVENT_TABLE if event.severity is severity
    }
    return MessageDefinition(
        "TM",
        5,
        int(severity),
        f"event_{severity.name.lower()}",
        _TITLES[severity],
        f"8.5.2.{int(severity)}",
        "An event and its auxiliary data.",
        (_EVENT, Switched("data", "event_id", cases, "auxiliary data of the event")),
    )


SERVICE = ServiceDefinition(
    5,
    "Event reporting",
    "6.5, 8.5",
    "Reports of what happened, by severity. Every event is enabled after a start.",
    (
        *(_report(severity) for severity in EventSeverity),
        MessageDefinition(
            "TC",
            5,
            5,
            "event_enable",
            "Enable the report generation of event definitions",
            "8.5.2.5",
            "The events are reported from now on.",
            (_EVENTS,),
            verification="completion at once",
        ),
        MessageDefinition(
            "TC",
            5,
            6,
            "event_disable",
            "Disable the report generation of event definitions",
            "8.5.2.6",
            "The events are no longer reported; they still happen and count.",
            (_EVENTS,),
            verification="completion at once",
        ),
        MessageDefinition(
            "TC",
            5,
            7,
            "event_report_disabled",
            "Report the list of disabled event definitions",
            "8.5.2.7",
            "Answered by the list of disabled events.",
            verification="completion at once",
        ),
        MessageDefinition(
            "TM",
            5,
            8,
            "event_disabled_list",
            "Disabled event definitions list report",
            "8.5.2.8",
            "The events that are disabled now.",
            (Repeated("event_ids", (_EVENT,), 0, 64, "disabled event definitions"),),
        ),
    ),
)
