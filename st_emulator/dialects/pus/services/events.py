"""ST[05] events: what the device reports becomes an event report, unless it is disabled."""

from __future__ import annotations

from typing import Any

from ....device import reports
from ....device.counters import saturated
from ....device.imaging import FrameRecord, microseconds
from ....protocol.pus.enumerations import EventId
from ....protocol.pus.events import EVENTS
from ....protocol.pus.packets import CucTime
from ..serving import ANY, Execute, Served
from ..verification import Request, Send


class Events:
    """Event reports, and which of them are disabled.

    Args:
        send: sends a telemetry message.
    """

    def __init__(self, send: Send) -> None:
        self._send = send
        self._disabled: set[int] = set()

    def reset(self) -> None:
        """As after power-on: every event is reported."""
        self._disabled.clear()

    def raise_event(self, event: EventId, **data: Any) -> None:
        """Report an event, unless it is disabled."""
        if int(event) not in self._disabled:
            self._send(EVENTS[event].message_name, {"event_id": int(event), "data": data})

    def packets_lost(self, packets: int) -> None:
        """So many packets found the queue full, and there is room again."""
        self.raise_event(EventId.TX_QUEUE_OVERFLOWED, packets=saturated(packets, 16))

    def report(self, report: reports.Report) -> None:
        """The event that a report of the device is, if it is one."""
        match report:
            case reports.Booted(cause, boot_count, store_fault):
                self.raise_event(
                    EventId.BOOT_COMPLETED, boot_count=saturated(boot_count, 16), reset_cause=int(cause)
                )
                if store_fault is not None:
                    self.raise_event(EventId.PARAMETER_STORE_INVALID, cause=int(store_fault))
            case reports.ModeChanged(row) if row.announced:
                self.raise_event(
                    EventId.MODE_CHANGED,
                    from_mode=int(row.mode),
                    to_mode=int(row.next_mode),
                    cause=int(row.event),
                )
            case reports.SelfTestCompleted(failed):
                self.raise_event(EventId.SELF_TEST_COMPLETED, result=int(failed))
            case reports.FrameOverran(record, budget_cycles):
                self._frame_overran(record, budget_cycles)
            case reports.FrameDropped(record):
                assert record.drop_cause is not None
                self.raise_event(
                    EventId.FRAME_DROPPED, frame_index=record.index, cause=int(record.drop_cause)
                )
            case reports.TrackingLost(record):
                assert record.result is not None
                self.raise_event(
                    EventId.TRACKING_LOST, frame_index=record.index, reasons=int(record.result.reasons)
                )
            case reports.AttitudeAcquired(record):
                assert record.result is not None
                stars = saturated(len(record.result.stars), 8)
                self.raise_event(EventId.ATTITUDE_ACQUIRED, frame_index=record.index, stars=stars)
            case reports.SensorBlinded(record):
                assert record.result is not None
                background_dn = saturated(round(record.result.background_dn), 16)
                self.raise_event(
                    EventId.SENSOR_BLINDED, frame_index=record.index, background_dn=background_dn
                )
            case reports.TimeSet(old_tai_ns, new_tai_ns):
                old, new = CucTime.from_ns(old_tai_ns), CucTime.from_ns(new_tai_ns)
                self.raise_event(EventId.TIME_SET, old=old, new=new)
            case reports.FaultEntered(cause):
                self.raise_event(EventId.FAULT_ENTERED, cause=int(cause))
            case reports.ParametersStored(count):
                self.raise_event(EventId.PARAMETERS_STORED, count=count)
            case reports.ShutdownStarted():
                self.raise_event(EventId.SHUTDOWN_STARTED)

    def _frame_overran(self, record: FrameRecord, budget_cycles: int) -> None:
        assert record.cycles is not None
        self.raise_event(
            EventId.FRAME_OVERRAN,
            frame_index=record.index,
            cycles=saturated(record.cycles.total, 32),
            budget=saturated(budget_cycles, 32),
            late_us=saturated(microseconds(record.late_ns), 32),
        )

    # -- telecommands

    def enable(self, request: Request) -> Execute:
        def execute() -> None:
            self._disabled.difference_update(request.fields["event_ids"])
            request.completed()

        return execute

    def disable(self, request: Request) -> Execute:
        def execute() -> None:
            self._disabled.update(request.fields["event_ids"])
            request.completed()

        return execute

    def report_disabled(self, request: Request) -> Execute:
        def execute() -> None:
            request.answer("event_disabled_list", {"event_ids": sorted(self._disabled)})
            request.completed()

        return execute


SERVED = {
    "event_enable": Served(ANY, Events.enable),
    "event_disable": Served(ANY, Events.disable),
    "event_report_disabled": Served(ANY, Events.report_disabled),
}
