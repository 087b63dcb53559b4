"""The services: what each telecommand checks and does.

A telecommand is checked in this order: the mode, the identifiers and ranges of the message table, then what
only its handler can know. A handler first makes every check, raising :class:`RejectedError`, and returns
what executes the telecommand: so a refused telecommand has changed nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ...clock import NS_PER_MS, ScheduledEvent
from ...device.counters import saturated
from ...firmware_model.modes import Mode, ModeEvent, next_mode
from ...protocol.pus.enumerations import (
    CanState,
    EventId,
    FailureCode,
    FunctionId,
    HousekeepingId,
    ResetCause,
    ResetKind,
)
from ...protocol.pus.housekeeping import HOUSEKEEPING
from ...protocol.pus.packets import CucTime, Telecommand, crc16_ccitt
from .reception import Handler, RejectedError, Request
from .timing import timing_fields

if TYPE_CHECKING:
    from ...device.star_tracker import StarTracker

RUNNING = (Mode.STANDBY, Mode.LOST_IN_SPACE, Mode.TRACKING)
ANY = (*RUNNING, Mode.SELF_TEST, Mode.FAULT)

#: The modes in which a telecommand is allowed; the ones that change the mode follow the mode table.
ALLOWED_MODES: dict[str, tuple[Mode, ...]] = {
    "ping": ANY,
    "hk_enable": ANY,
    "hk_disable": ANY,
    "hk_one_shot": ANY,
    "hk_set_interval": ANY,
    "event_enable": ANY,
    "event_disable": ANY,
    "event_report_disabled": ANY,
    "memory_load": (Mode.STANDBY, Mode.FAULT),
    "memory_dump": ANY,
    "memory_check": ANY,
    "time_report_rate": ANY,
    "set_time": (*RUNNING, Mode.FAULT),
    "parameter_report": ANY,
    "parameter_set": RUNNING,
    "function": ANY,
}

#: The modes in which a function that is not a mode change is allowed.
FUNCTION_MODES: dict[FunctionId, tuple[Mode, ...]] = {
    FunctionId.CAPTURE_IMAGE: RUNNING,
    FunctionId.DOWNLOAD_IMAGE: (*RUNNING, Mode.FAULT),
    FunctionId.ABORT_DOWNLOAD: ANY,
    FunctionId.CLEAR_COUNTERS: ANY,
    FunctionId.RESTORE_DEFAULT_PARAMETERS: RUNNING,
}

#: The mode event of a function that changes the mode.
FUNCTION_EVENTS: dict[FunctionId, ModeEvent] = {
    FunctionId.GO_STANDBY: ModeEvent.COMMAND_STANDBY,
    FunctionId.START_ACQUISITION: ModeEvent.COMMAND_ACQUIRE,
    FunctionId.START_SELF_TEST: ModeEvent.COMMAND_SELF_TEST,
    FunctionId.RESET: ModeEvent.COMMAND_RESET,
    FunctionId.SHUTDOWN: ModeEvent.COMMAND_SHUTDOWN,
    FunctionId.TRACK_FROM: ModeEvent.COMMAND_TRACK_FROM,
}

DEFAULT_INTERVAL_MS = 1000  # ASSUMED: 1 Hz until the OBC sets another
QUATERNION_NORM_TOLERANCE = 1e-3  # ASSUMED: float64 on the wire; more is a mistake, not rounding


def allowed_modes(function_id: FunctionId) -> tuple[Mode, ...]:
    """The modes in which a function is allowed."""
    if function_id in FUNCTION_EVENTS:
        return tuple(mode for mode in ANY if next_mode(mode, FUNCTION_EVENTS[function_id]) is not None)
    return FUNCTION_MODES[function_id]


class Services:
    """Handlers of one unit."""

    def __init__(self, unit: StarTracker) -> None:
        self._unit = unit
        self.received_ns = 0
        self._intervals_ms: dict[int, int] = {}
        self._periodic: dict[int, ScheduledEvent] = {}
        self._time_report_exponent: int | None = None
        self._handlers: dict[str, Handler] = {name: getattr(self, f"_{name}") for name in ALLOWED_MODES}

    def reset(self) -> None:
        """As after power-on: no periodic housekeeping, no time reports."""
        for event in self._periodic.values():
            event.cancel()
        self._periodic.clear()
        self._intervals_ms.clear()
        self._time_report_exponent = None

    def handler(self, telecommand: Telecommand) -> Handler:
        """The handler of a telecommand, if the present mode allows it."""
        mode, name = self._unit.mode, telecommand.name
        allowed = ALLOWED_MODES[name]
        if name == "function":
            allowed = allowed_modes(FunctionId(telecommand.fields["function_id"]))
        if mode not in allowed:
            raise RejectedError(FailureCode.NOT_ALLOWED_IN_MODE, int(mode))
        return self._handlers[name]

    def frame_started(self, frame_index: int) -> None:
        """Frame-synchronous work: the time report."""
        exponent = self._time_report_exponent
        if exponent is not None and frame_index % (1 << exponent) == 0:
            self._unit.send("time_report", self._time_fields(exponent))

    # -- test
    # ------------------------------------------------------------------------------------------------------

    def _ping(self, _: Telecommand) -> Callable[[Request], None]:
        def execute(request: Request) -> None:
            request.answer("pong", {})
            request.completed()

        return execute

    # -- housekeeping
    # ----------------------------------------------------------------------------------------------

    def enable_housekeeping(self, structure_id: int, interval_ms: int | None = None) -> None:
        """Send a structure periodically from now on."""
        if interval_ms is not None:
            self._intervals_ms[structure_id] = interval_ms
        if structure_id in self._periodic:
            self._periodic[structure_id].cancel()
        delay_ns = self._intervals_ms.get(structure_id, DEFAULT_INTERVAL_MS) * NS_PER_MS

        def report() -> None:
            self._periodic[structure_id] = self._unit.later(delay_ns, report)
            self._unit.send("hk_report", self._housekeeping(structure_id))

        self._periodic[structure_id] = self._unit.later(delay_ns, report)

    def _hk_enable(self, telecommand: Telecommand) -> Callable[[Request], None]:
        ids = telecommand.fields["structure_ids"]

        def execute(request: Request) -> None:
            for structure_id in ids:
                if structure_id not in self._periodic:
                    self.enable_housekeeping(structure_id)
            request.completed()

        return execute

    def _hk_disable(self, telecommand: Telecommand) -> Callable[[Request], None]:
        ids = telecommand.fields["structure_ids"]

        def execute(request: Request) -> None:
            for structure_id in ids:
                event = self._periodic.pop(structure_id, None)
                if event is not None:
                    event.cancel()
            request.completed()

        return execute

    def _hk_one_shot(self, telecommand: Telecommand) -> Callable[[Request], None]:
        ids = telecommand.fields["structure_ids"]

        def execute(request: Request) -> None:
            for structure_id in ids:
                request.answer("hk_report", self._housekeeping(structure_id))
            request.completed()

        return execute

    def _hk_set_interval(self, telecommand: Telecommand) -> Callable[[Request], None]:
        intervals = telecommand.fields["intervals"]

        def execute(request: Request) -> None:
            for item in intervals:
                structure_id = item["structure_id"]
                self._intervals_ms[structure_id] = item["interval_ms"]
                if structure_id in self._periodic:
                    self.enable_housekeeping(structure_id)
            request.completed()

        return execute

    def _housekeeping(self, structure_id: int) -> dict[str, Any]:
        values = {
            HousekeepingId.STATUS: self._status,
            HousekeepingId.LINK: self._link,
            HousekeepingId.TIMING: self._timing,
            HousekeepingId.CAN: self._can,
        }[HousekeepingId(structure_id)]()
        return {"structure_id": structure_id, "values": values}

    def _status(self) -> dict[str, int]:
        unit, counters = self._unit, self._unit.frame_counters
        return {
            "mode": int(unit.mode),
            "reset_cause": int(unit.reset_cause),
            "boot_count": saturated(unit.parameters.boot_count, 16),
            "uptime_ms": unit.uptime_ms & 0xFFFFFFFF,  # a clock: it turns over after 49 days
            "time_status": int(unit.time.status),
            "self_test_result": int(unit.self_test.result),
            "last_frame_index": unit.last_frame_index & 0xFFFFFFFF,
            "last_reasons": int(unit.last_reasons),
            "frames_processed": saturated(counters.frames_processed, 32),
            "frames_valid": saturated(counters.frames_valid, 32),
            "frames_tracking": saturated(counters.frames_tracking, 32),
            "frames_late": saturated(counters.frames_late, 32),
            "frames_dropped": saturated(counters.frames_dropped, 32),
            "temperature_cdeg": unit.temperature_cdeg,
            "stored_parameters_valid": int(unit.store_fault is None),
        }

    def _link(self) -> dict[str, int]:
        unit, counters = self._unit, self._unit.link_counters
        wide = ("tc_received", "tc_accepted", "tc_rejected", "rx_bytes")
        values = {
            name: saturated(getattr(counters, name), 32 if name in wide else 16)
            for name in counters.__dataclass_fields__
        }
        return values | {
            "tx_bytes": saturated(unit.transmitter.bytes, 32),
            "tx_packets": saturated(unit.transmitter.packets, 32),
            "tx_queue_bytes": unit.port.queued_bytes,
        }

    def _timing(self) -> dict[str, int]:
        """Of the last processed frame; before the first one, the budget and clock of the next."""
        unit = self._unit
        record = unit.last_frame
        settings = record.settings if record is not None else unit.parameters.frame_settings()
        budget_cycles = unit.imaging.budget_cycles(settings)
        return timing_fields(record, settings, budget_cycles, unit.frame_counters.worst_cycles)

    def _can(self) -> dict[str, int]:
        """On the serial line there is no bus, and nothing is counted."""
        if self._unit.can is not None:
            return self._unit.can.housekeeping()
        fields = HOUSEKEEPING[int(HousekeepingId.CAN)].fields
        return dict.fromkeys((field.name for field in fields), 0) | {"can_state": int(CanState.NOT_USED)}

    # -- events
    # ----------------------------------------------------------------------------------------------------

    def _event_enable(self, telecommand: Telecommand) -> Callable[[Request], None]:
        ids = telecommand.fields["event_ids"]

        def execute(request: Request) -> None:
            self._unit.disabled_events.difference_update(ids)
            request.completed()

        return execute

    def _event_disable(self, telecommand: Telecommand) -> Callable[[Request], None]:
        ids = telecommand.fields["event_ids"]

        def execute(request: Request) -> None:
            self._unit.disabled_events.update(ids)
            request.completed()

        return execute

    def _event_report_disabled(self, _: Telecommand) -> Callable[[Request], None]:
        def execute(request: Request) -> None:
            request.answer("event_disabled_list", {"event_ids": sorted(self._unit.disabled_events)})
            request.completed()

        return execute

    # -- memory
    # ----------------------------------------------------------------------------------------------------

    def _memory_load(self, telecommand: Telecommand) -> Callable[[Request], None]:
        fields, memories = telecommand.fields, self._unit.memories
        data, start = fields["data"], fields["start_address"]
        memories.check_writable(fields["memory_id"], start, len(data))
        checksum = crc16_ccitt(data)
        if checksum != fields["checksum"]:
            raise RejectedError(FailureCode.BAD_CHECKSUM, checksum)

        def execute(request: Request) -> None:
            memories.write(start, data)
            request.completed()

        return execute

    def _memory_dump(self, telecommand: Telecommand) -> Callable[[Request], None]:
        fields = telecommand.fields
        data = self._unit.memories.read(fields["memory_id"], fields["start_address"], fields["length"])

        def execute(request: Request) -> None:
            request.answer(
                "memory_dump_report",
                {
                    "memory_id": fields["memory_id"],
                    "start_address": fields["start_address"],
                    "data": data,
                    "checksum": crc16_ccitt(data),
                },
            )
            request.completed()

        return execute

    def _memory_check(self, telecommand: Telecommand) -> Callable[[Request], None]:
        fields = telecommand.fields
        data = self._unit.memories.read(fields["memory_id"], fields["start_address"], fields["length"])

        def execute(request: Request) -> None:
            names = ("memory_id", "start_address", "length")
            request.answer(
                "memory_check_report",
                {name: fields[name] for name in names} | {"checksum": crc16_ccitt(data)},
            )
            request.completed()

        return execute

    # -- functions
    # -------------------------------------------------------------------------------------------------

    def _function(self, telecommand: Telecommand) -> Callable[[Request], None]:
        unit = self._unit
        function_id = FunctionId(telecommand.fields["function_id"])
        arguments: dict[str, Any] = telecommand.fields["arguments"]
        match function_id:
            case FunctionId.GO_STANDBY:
                return self._at_once(unit.go_standby)
            case FunctionId.START_ACQUISITION:
                return self._acquisition(unit.start_acquisition)
            case FunctionId.START_SELF_TEST:
                return unit.self_test.start
            case FunctionId.RESET:
                return self._reset_function(arguments["kind"])
            case FunctionId.CAPTURE_IMAGE:
                if unit.image_store.busy:
                    raise RejectedError(FailureCode.BUSY)
                return unit.image_store.capture
            case FunctionId.DOWNLOAD_IMAGE:
                return self._download(arguments)
            case FunctionId.ABORT_DOWNLOAD:
                return self._at_once(unit.image_store.abort)
            case FunctionId.SHUTDOWN:
                return self._shutdown
            case FunctionId.CLEAR_COUNTERS:
                return self._at_once(self._clear_counters)
            case FunctionId.RESTORE_DEFAULT_PARAMETERS:
                return self._at_once(lambda: self._parameters_stored(unit.parameters.restore_defaults()))
            case FunctionId.TRACK_FROM:
                q = tuple(arguments[f"q_{name}"] for name in "xyzw")
                norm = sum(value * value for value in q) ** 0.5
                if not abs(norm - 1) <= QUATERNION_NORM_TOLERANCE:
                    raise RejectedError(FailureCode.OUT_OF_RANGE, int(function_id))
                return self._acquisition(
                    lambda: unit.track_from((q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm))
                )

    @staticmethod
    def _at_once(action: Callable[[], None]) -> Callable[[Request], None]:
        def execute(request: Request) -> None:
            action()
            request.completed()

        return execute

    def _acquisition(self, begin: Callable[[], None]) -> Callable[[Request], None]:
        def execute(request: Request) -> None:
            request.started()
            self._unit.await_attitude(request)
            begin()

        return execute

    def _reset_function(self, kind: int) -> Callable[[Request], None]:
        causes = {ResetKind.WARM: ResetCause.WARM_RESET, ResetKind.COLD: ResetCause.COLD_RESET}
        cause = causes[ResetKind(kind)]

        def execute(request: Request) -> None:
            # The boot event takes the place of the completion report: who completes would be another life.
            request.started()
            self._unit.go_down(lambda: self._unit.reset(cause))

        return execute

    def _shutdown(self, request: Request) -> None:
        request.started()
        self._unit.raise_event(EventId.SHUTDOWN_STARTED)
        self._unit.go_down(self._unit.shut_down)
        request.completed()

    def _download(self, arguments: dict[str, Any]) -> Callable[[Request], None]:
        store = self._unit.image_store
        if store.busy:
            raise RejectedError(FailureCode.BUSY)
        if not store.parts:
            raise RejectedError(FailureCode.NO_IMAGE)
        first = arguments["first_part"] or 1
        count = arguments["parts"] or store.parts - first + 1
        if first > store.parts or first + count - 1 > store.parts:
            raise RejectedError(FailureCode.OUT_OF_RANGE, int(FunctionId.DOWNLOAD_IMAGE))
        return lambda request: store.download(request, arguments["transaction_id"], first, count)

    def _clear_counters(self) -> None:
        self._unit.clear_counters()

    # -- time
    # ------------------------------------------------------------------------------------------------------

    def _time_fields(self, exponent: int) -> dict[str, Any]:
        unit = self._unit
        return {
            "rate_exponent": exponent,
            "time": unit.time.cuc(unit.clock.now_ns),
            "time_status": int(unit.time.status),
        }

    def _time_report_rate(self, telecommand: Telecommand) -> Callable[[Request], None]:
        exponent = telecommand.fields["rate_exponent"]

        def execute(request: Request) -> None:
            self._time_report_exponent = exponent
            request.completed()

        return execute

    def _set_time(self, telecommand: Telecommand) -> Callable[[Request], None]:
        time: CucTime = telecommand.fields["time"]
        received_ns = self.received_ns

        def execute(request: Request) -> None:
            request.started()
            self._unit.await_time(request)
            self._unit.time.prepare(time, received_ns)

        return execute

    # -- parameters
    # ------------------------------------------------------------------------------------------------

    def _parameter_report(self, telecommand: Telecommand) -> Callable[[Request], None]:
        parameters = self._unit.parameters
        ids = telecommand.fields["parameter_ids"]
        values = [{"parameter_id": item, "value": parameters.by_id(item)} for item in ids]

        def execute(request: Request) -> None:
            request.answer("parameter_values", {"values": values})
            request.completed()

        return execute

    def _parameter_set(self, telecommand: Telecommand) -> Callable[[Request], None]:
        parameters = self._unit.parameters
        settings = {item["parameter_id"]: item["value"] for item in telecommand.fields["settings"]}
        parameters.check(settings)

        def execute(request: Request) -> None:
            self._parameters_stored(parameters.store(settings))
            request.completed()

        return execute

    def _parameters_stored(self, count: int) -> None:
        self._unit.raise_event(EventId.PARAMETERS_STORED, count=count)
