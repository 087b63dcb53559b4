"""What an OBC knows of the unit from its telemetry: latest values, mode, events, attitudes."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..naming import event_text, name_of
from ..protocol.pus.enumerations import EventId, EventSeverity, HousekeepingId, Mode
from ..protocol.pus.packets import CucTime, Telemetry
from .attitude import Attitude

KEPT_EVENTS = 10_000
KEPT_ATTITUDES = 100_000  # seven hours at 4 Hz

EVENT_SERVICE = 5
EVENT_REPORTS = {f"event_{severity.name.lower()}": severity for severity in EventSeverity}


@dataclass(frozen=True)
class Event:
    """One event report."""

    id: int
    severity: EventSeverity
    data: Mapping[str, Any]
    time: CucTime
    received_ns: int

    @property
    def name(self) -> str:
        """Its name, such as MODE_CHANGED."""
        return name_of(EventId, self.id)

    def __str__(self) -> str:
        return f"{self.severity.name.lower()}: {event_text(self.id, self.data)}"


class ObservedUnit:
    """The unit as its telemetry shows it."""

    def __init__(self) -> None:
        self.latest: dict[str, Telemetry] = {}
        """Last telemetry by message name."""
        self.housekeeping: dict[str, dict[str, Any]] = {}
        """Last values by structure name."""
        self.parameters: dict[int, Any] = {}
        """Last reported values by parameter number."""
        self.events: deque[Event] = deque(maxlen=KEPT_EVENTS)
        self.attitudes: deque[Attitude] = deque(maxlen=KEPT_ATTITUDES)
        self.frames_by_mode: dict[int, int] = {}
        self.mode: Mode | None = None
        self._mode_since_ns: int | None = None

    def take(self, telemetry: Telemetry, received_ns: int) -> Event | None:
        """Take a packet into account; the event that it reports, if it reports one."""
        self.latest[telemetry.name] = telemetry
        fields = telemetry.fields
        if telemetry.name == "attitude_report":
            self._take_attitude(Attitude.from_fields(fields, received_ns))
        elif telemetry.name == "hk_report":
            self.housekeeping[name_of(HousekeepingId, fields["structure_id"])] = fields["values"]
            if fields["structure_id"] == HousekeepingId.STATUS:
                self._set_mode(fields["values"]["mode"], telemetry.time.to_ns())
        elif telemetry.name == "parameter_values":
            self.parameters |= {entry["parameter_id"]: entry["value"] for entry in fields["values"]}
        elif telemetry.name in EVENT_REPORTS:
            event = Event(
                fields["event_id"], EVENT_REPORTS[telemetry.name], fields["data"], telemetry.time, received_ns
            )
            self._take_event(event)
            return event
        return None

    def take_cyclic(self, name: str, values: Mapping[str, Any]) -> None:
        """Take a cyclic frame into account: a heartbeat tells the mode as long as no telemetry has."""
        if name == "heartbeat" and self.mode is None:
            self._set_mode(int(values["mode"]), None)

    def _take_attitude(self, attitude: Attitude) -> None:
        self.attitudes.append(attitude)
        self.frames_by_mode[int(attitude.mode)] = self.frames_by_mode.get(int(attitude.mode), 0) + 1
        # The report tells the mode in which its frame was processed. One that was under way when the mode
        # changed comes after the event, and must not take the mode back.
        if self._mode_since_ns is None or attitude.time_ns > self._mode_since_ns:
            self._set_mode(int(attitude.mode), None)

    def _take_event(self, event: Event) -> None:
        self.events.append(event)
        if event.id == EventId.MODE_CHANGED:
            self._set_mode(event.data["to_mode"], event.time.to_ns())
        elif event.id == EventId.TIME_SET:
            # Times before and after it cannot be compared.
            self._mode_since_ns = event.data["new"].to_ns()
        elif event.id == EventId.BOOT_COMPLETED:
            self._mode_since_ns = None

    def _set_mode(self, number: int, since_ns: int | None) -> None:
        try:
            self.mode = Mode(number)
        except ValueError:  # a mode that this interface does not know is no mode to wait for
            self.mode = None
        if since_ns is not None:
            self._mode_since_ns = since_ns
