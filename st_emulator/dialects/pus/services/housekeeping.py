"""ST[03] housekeeping: structures on request and periodically."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ....clock import NS_PER_MS, ScheduledEvent
from ....device.star_tracker import StarTracker
from ....protocol.pus.enumerations import HousekeepingId
from ..serving import ANY, Execute, Served
from ..verification import Request, Send

DEFAULT_INTERVAL_MS = 1000  # ASSUMED: 1 Hz until the OBC sets another

Structures = Mapping[HousekeepingId, Callable[[], dict[str, int]]]


class Housekeeping:
    """Reports of structures.

    Args:
        device: whose life the periodic reports share.
        send: sends a telemetry message.
        structures: the values of each structure now.
    """

    def __init__(self, device: StarTracker, send: Send, structures: Structures) -> None:
        self._device = device
        self._send = send
        self._structures = structures
        self._intervals_ms: dict[int, int] = {}
        self._periodic: dict[int, ScheduledEvent] = {}

    def reset(self) -> None:
        """As after power-on: nothing periodic."""
        for event in self._periodic.values():
            event.cancel()
        self._periodic.clear()
        self._intervals_ms.clear()

    def start(self, structure_id: int, interval_ms: int | None = None) -> None:
        """Send a structure periodically from now on."""
        if interval_ms is not None:
            self._intervals_ms[structure_id] = interval_ms
        if structure_id in self._periodic:
            self._periodic[structure_id].cancel()
        delay_ns = self._intervals_ms.get(structure_id, DEFAULT_INTERVAL_MS) * NS_PER_MS

        def report() -> None:
            self._periodic[structure_id] = self._device.later(delay_ns, report)
            self._send("hk_report", self._fields(structure_id))

        self._periodic[structure_id] = self._device.later(delay_ns, report)

    def _fields(self, structure_id: int) -> dict[str, Any]:
        values = self._structures[HousekeepingId(structure_id)]()
        return {"structure_id": structure_id, "values": values}

    # -- telecommands

    def enable(self, request: Request) -> Execute:
        def execute() -> None:
            for structure_id in request.fields["structure_ids"]:
                if structure_id not in self._periodic:
                    self.start(structure_id)
            request.completed()

        return execute

    def disable(self, request: Request) -> Execute:
        def execute() -> None:
            for structure_id in request.fields["structure_ids"]:
                event = self._periodic.pop(structure_id, None)
                if event is not None:
                    event.cancel()
            request.completed()

        return execute

    def one_shot(self, request: Request) -> Execute:
        def execute() -> None:
            for structure_id in request.fields["structure_ids"]:
                request.answer("hk_report", self._fields(structure_id))
            request.completed()

        return execute

    def set_interval(self, request: Request) -> Execute:
        def execute() -> None:
            for item in request.fields["intervals"]:
                structure_id = item["structure_id"]
                self._intervals_ms[structure_id] = item["interval_ms"]
                if structure_id in self._periodic:
                    self.start(structure_id)
            request.completed()

        return execute


SERVED = {
    "hk_enable": Served(ANY, Housekeeping.enable),
    "hk_disable": Served(ANY, Housekeeping.disable),
    "hk_one_shot": Served(ANY, Housekeeping.one_shot),
    "hk_set_interval": Served(ANY, Housekeeping.set_interval),
}
