"""One star tracker: bytes and frames in, bytes out, in virtual time.

It touches no port, no clock and no file but its store. Its parts: the receiver (telecommands), the
transmitter (telemetry), imaging (frames in time), the parameters and the services. This class owns the mode
(by the one table in ``firmware_model.modes``) and tells the parts of each other.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from ..clock import NS_PER_MS, NS_PER_US, ScheduledEvent, VirtualClock
from ..dialects.pus.attitude import IDENTITY, attitude_fields
from ..dialects.pus.can import CanServices
from ..dialects.pus.reception import Handler, Receiver, Request
from ..dialects.pus.services import Services
from ..dialects.pus.transmission import Transmitter
from ..firmware_model.configuration import StarTables
from ..firmware_model.firmware import FirmwareState
from ..firmware_model.link_work import line_work, round_work, telecommand_work
from ..firmware_model.modes import Mode, ModeEvent, next_mode
from ..firmware_model.reasons import Reason
from ..firmware_model.work import Work
from ..protocol.pus.enumerations import (
    EventId,
    FailureCode,
    FaultCause,
    FrameDropCause,
    HousekeepingId,
    MalformedReason,
    ResetCause,
    StoreInvalidCause,
)
from ..protocol.pus.events import EVENTS
from ..protocol.pus.packets import Telecommand
from ..units.profile import UnitProfile
from ..wire.can.port import CanPort
from ..wire.port import UnitPort
from .counters import FrameCounters, LinkCounters, saturated
from .image_memory import ImageStore
from .imaging import FrameRecord, FrameSettings, FrameSource, Imaging, Lazy, Submit, microseconds
from .memories import Memories
from .onboard_time import OnboardTime
from .parameters import Parameters
from .self_test import SelfTestRun
from .store import Store

SILENT = (Mode.BOOT, Mode.OFF)
SELF_TEST_STEPS = 4
TEMPERATURE_CDEG = 2000  # ASSUMED: 20.00 deg C; no thermal model


class StarTracker:
    """The unit behind its port.

    Args:
        profile: the unit file.
        clock: the virtual clock; power comes on at its present time with :meth:`power_on`.
        make_port: makes the port to the OBC, which tells this unit what comes in.
        source: what the detector sees.
        tables: the on-board catalogue.
        store: the non-volatile memory.
        submit: how a frame's computation is started (at once beside the loop, or when needed).
        on_frame: called when a frame is exposed, with its record (the truth is written there).
        on_completed: called when a frame's result counts.
    """

    def __init__(
        self,
        profile: UnitProfile,
        clock: VirtualClock,
        make_port: Callable[[StarTracker], UnitPort],
        source: FrameSource,
        tables: StarTables,
        store: Store,
        *,
        submit: Submit = Lazy,
        on_frame: Callable[[FrameRecord], None] = lambda record: None,
        on_completed: Callable[[FrameRecord], None] = lambda record: None,
    ) -> None:
        self.profile = profile
        self.clock = clock
        self.port = make_port(self)
        self.tables = tables
        self.mode = Mode.OFF
        self.time = OnboardTime()
        self.link_counters = LinkCounters()
        self.frame_counters = FrameCounters()
        self.transmitter = Transmitter(clock, self.port, self.time, profile.wire.apid, profile.wire.source_id)
        self.receiver = Receiver(self, profile.wire.apid, self.link_counters)
        self.parameters = Parameters(profile, store)
        self.imaging = Imaging(
            clock,
            source,
            self,
            tables,
            period_ns=profile.frame_period_ns,
            readout_ns=int(profile.timing.readout_ms * NS_PER_MS),
            submit=submit,
        )
        self.image_store = ImageStore(self)
        self.memories = Memories(self)
        self.services = Services(self)
        self.can = CanServices(self, self.port) if isinstance(self.port, CanPort) else None
        self.disabled_events: set[int] = set()
        self.last_frame: FrameRecord | None = None
        self.last_frame_index = 0
        self.last_reasons = Reason.NOT_ACQUIRING
        self.self_test = SelfTestRun(self)
        self.reset_cause = ResetCause.POWER_ON
        self._last_quaternion = IDENTITY
        self._on_frame = on_frame
        self._on_completed = on_completed
        self._powered_ns = 0
        self._blinded = False
        self._life = 0  # counts starts; an action scheduled in an earlier life is void
        self._time_request: Request | None = None
        self._acquisition_request: Request | None = None
        self._reception = Work()  # not yet in the work of a frame
        self._going_down = False
        self.store_fault: StoreInvalidCause | None = None

    # -- life
    # ------------------------------------------------------------------------------------------------------

    def power_on(self) -> None:
        """Start the unit at the present time; the frame grid runs from here."""
        self.imaging.start()
        self._boot(ResetCause.POWER_ON)

    def later(self, delay_ns: int, action: Callable[[], None]) -> ScheduledEvent:
        """Schedule an action that a reset makes void."""
        life = self._life
        return self.clock.after(delay_ns, lambda: action() if self._life == life else None)

    def _boot(self, cause: ResetCause) -> None:
        self._life += 1
        self._going_down = False
        self.mode = Mode.BOOT
        self.reset_cause = cause
        self.transmitter.reset()
        self.receiver.reset()
        if cause != ResetCause.WARM_RESET:
            self.clear_counters()
            self.time.restart(self.clock.now_ns)
        self.disabled_events.clear()
        self.image_store.reset()
        self.memories.reset()
        self.services.reset()
        if self.can is not None:
            self.can.reset()
        self.imaging.stop()
        self.imaging.cancel_capture()
        self.last_frame = None
        self.last_reasons = Reason.NOT_ACQUIRING
        self._last_quaternion = IDENTITY
        self._blinded = False
        self._time_request = self._acquisition_request = None
        self.self_test.reset()
        self.time.discard_pending()
        self._powered_ns = self.clock.now_ns
        self.store_fault = self.parameters.load(count_start=True)
        self.later(self.profile.timing.boot_ms * NS_PER_MS, self._boot_done)

    def _boot_done(self) -> None:
        self.follow(ModeEvent.BOOT_DONE, announce=False)
        self.raise_event(
            EventId.BOOT_COMPLETED,
            boot_count=saturated(self.parameters.boot_count, 16),
            reset_cause=int(self.reset_cause),
        )
        if self.store_fault is not None:
            self.raise_event(EventId.PARAMETER_STORE_INVALID, cause=int(self.store_fault))
        if self.can is not None:
            self.can.start()
        interval_ms = self.profile.wire.status_interval_ms
        if interval_ms:
            self.services.enable_housekeeping(HousekeepingId.STATUS, interval_ms)
        if self.parameters["autonomous_start"]:
            self.start_acquisition(ModeEvent.AUTONOMOUS_START)

    def reset(self, cause: ResetCause) -> None:
        """Restart; all but a warm reset forget the on-board time and the counters."""
        self._boot(cause)

    def shut_down(self) -> None:
        """Leave for OFF: nothing is sent or processed until power is cycled."""
        self._life += 1
        self.mode = Mode.OFF
        self.port.restart()  # cyclic frames that still wait for a CAN bus

    def go_down(self, last: Callable[[], None]) -> None:
        """Come to rest and do ``last`` (a reset, a shutdown) when the line is idle.

        No more frames, periodic reports and telecommands; what runs is aborted, so that every accepted
        telecommand has its end.
        """
        self._going_down = True
        self.imaging.stop()
        self.image_store.abort()
        self.image_store.abort_capture()
        self._give_up_acquisition(FailureCode.ABORTED)
        self.self_test.give_up()
        self._give_up_time(FailureCode.ABORTED)
        self.services.reset()
        self.later(0, partial(self._when_idle, last))  # behind what is sent at this instant

    def _when_idle(self, action: Callable[[], None]) -> None:
        waiting_ns = self.port.drain_ns(self.port.queued_bytes)
        if waiting_ns:
            self.later(waiting_ns, partial(self._when_idle, action))
        else:
            action()

    def clear_counters(self) -> None:
        """Set every counter of the housekeeping structures to 0."""
        self.link_counters.clear()
        self.frame_counters.clear()
        self.transmitter.clear_counters()
        if self.can is not None:
            self.can.clear_counters()

    # -- modes
    # -----------------------------------------------------------------------------------------------------

    def follow(self, event: ModeEvent, *, announce: bool = True) -> None:
        """Change the mode as the table says; an event that the table does not know in this mode changes
        nothing.
        """
        target = next_mode(self.mode, event)
        if target is None or target == self.mode:
            return
        before, self.mode = self.mode, target
        if announce:
            self.raise_event(
                EventId.MODE_CHANGED, from_mode=int(before), to_mode=int(target), cause=int(event)
            )

    def start_acquisition(self, event: ModeEvent = ModeEvent.COMMAND_ACQUIRE) -> None:
        """Find the attitude from nothing; in TRACKING the search starts anew."""
        self.imaging.acquire()
        self.follow(event)

    def await_attitude(self, request: Request) -> None:
        """``request`` started an acquisition and completes with the first valid attitude."""
        self._give_up_acquisition(FailureCode.SUPERSEDED)
        self._acquisition_request = request

    def _give_up_acquisition(self, code: FailureCode) -> None:
        if self._acquisition_request is not None:
            self._acquisition_request.failed(code)
            self._acquisition_request = None

    def track_from(self, quaternion: tuple[float, float, float, float]) -> None:
        """Track from a given attitude, without lost in space."""
        state = FirmwareState.from_attitude(np.array(quaternion), self.clock.now_ns)
        self.imaging.acquire(state, Mode.TRACKING)
        self.follow(ModeEvent.COMMAND_TRACK_FROM)

    def go_standby(self) -> None:
        self.imaging.stop()
        self._give_up_acquisition(FailureCode.ABORTED)
        self.last_reasons = Reason.NOT_ACQUIRING
        self.follow(ModeEvent.COMMAND_STANDBY)

    def enter_fault(self, cause: FaultCause) -> None:
        """Stop in FAULT; nothing happens when the unit is there already or is off."""
        if next_mode(self.mode, ModeEvent.FAULT_DETECTED) is None:
            return
        self.imaging.stop()
        self._give_up_acquisition(FailureCode.ABORTED)
        self.self_test.give_up()
        self.follow(ModeEvent.FAULT_DETECTED)
        self.raise_event(EventId.FAULT_ENTERED, cause=int(cause))

    # -- the port's client
    # -----------------------------------------------------------------------------------------------

    @property
    def listening(self) -> bool:
        return self.mode not in SILENT and not self._going_down

    @property
    def silent(self) -> bool:
        return self.mode in SILENT

    def bytes_received(self, count: int) -> None:
        self.link_counters.rx_bytes += count
        self._reception += line_work(count)

    def packet_received(self, raw: bytes, last_bit_ns: int) -> None:
        self._reception += telecommand_work(raw)
        latency_ns = self.profile.timing.telecommand_latency_us * NS_PER_US
        self.later(latency_ns, partial(self._handle, raw, last_bit_ns))

    def packet_discarded(self, reason: MalformedReason, length: int) -> None:
        self.receiver.discarded(reason, length)

    def _handle(self, raw: bytes, received_ns: int) -> None:
        if not self.listening:
            return
        self.services.received_ns = received_ns
        self.receiver.handle(raw)

    def send(self, name: str, fields: dict[str, Any], destination_id: int | None = None) -> bool:
        """Send telemetry; nothing leaves in BOOT and OFF."""
        if self.mode in SILENT:
            return False
        sent = self.transmitter.send(name, fields, destination_id)
        if sent and self.transmitter.has_room and (lost := self.transmitter.take_lost()):
            self.raise_event(EventId.TX_QUEUE_OVERFLOWED, packets=saturated(lost, 16))
        return sent

    def raise_event(self, event: EventId, **data: Any) -> None:
        if int(event) not in self.disabled_events:
            self.send(EVENTS[event].message_name, {"event_id": int(event), "data": data})

    def handler(self, telecommand: Telecommand) -> Handler:
        return self.services.handler(telecommand)

    # -- imaging's client
    # ------------------------------------------------------------------------------------------

    def frame_started(self, frame_index: int) -> None:
        self.last_frame_index = frame_index
        if self.mode in SILENT:
            return
        change = self.time.apply(self.clock.now_ns)
        if change is not None:
            self.raise_event(EventId.TIME_SET, old=change[0], new=change[1])
            if self._time_request is not None:
                self._time_request.completed()
                self._time_request = None
        self.services.frame_started(frame_index)

    def await_time(self, request: Request) -> None:
        """``request`` sets the time and completes when the time comes into force; an earlier one is
        superseded.
        """
        self.supersede_time()
        self._time_request = request

    def supersede_time(self) -> None:
        """A setting of the time that has not come into force never will."""
        self._give_up_time(FailureCode.SUPERSEDED)

    def _give_up_time(self, code: FailureCode) -> None:
        if self._time_request is not None:
            self._time_request.failed(code)
            self._time_request = None
            self.time.discard_pending()

    def frame_settings(self) -> FrameSettings:
        return self.parameters.frame_settings()

    def link_work(self) -> Work:
        received, self._reception = self._reception, Work()
        return round_work(self.transmitter.take_work(), received)

    def onboard_tai_ns(self, t_ns: int) -> int | None:
        return self.time.tai_ns(t_ns) if self.time.synchronised else None

    def frame_exposed(self, record: FrameRecord) -> None:
        self._on_frame(record)

    def image_captured(self, record: FrameRecord) -> None:
        if self.self_test.running:
            self.self_test.frame_captured()
        elif self.mode not in SILENT:
            self.image_store.keep(record, self.time.cuc(record.mid_exposure_ns))

    def frame_completed(self, record: FrameRecord) -> None:
        result = record.result
        assert result is not None
        assert record.cycles is not None
        counters = self.frame_counters
        counters.frames_processed += 1
        counters.frames_valid += result.valid
        counters.frames_tracking += result.valid and record.acquisition is Mode.TRACKING
        counters.frames_late += record.late_ns > 0
        counters.worst_cycles = max(counters.worst_cycles, record.cycles.total)
        self.last_frame = record
        self.last_reasons = result.reasons
        if result.valid:
            x, y, z, w = (float(value) for value in result.q_icrs_to_sensor)
            self._last_quaternion = (x, y, z, w)
        self._report_attitude(record, result.reasons)
        if record.late_ns:
            self.raise_event(
                EventId.FRAME_OVERRAN,
                frame_index=record.index,
                cycles=saturated(record.cycles.total, 32),
                budget=saturated(self.imaging.budget_cycles(record.settings), 32),
                late_us=saturated(microseconds(record.late_ns), 32),
            )
        self._follow_frame(record)
        if result.valid and self._acquisition_request is not None:
            self._acquisition_request.completed()
            self._acquisition_request = None
        self._on_completed(record)

    def _follow_frame(self, record: FrameRecord) -> None:
        result = record.result
        assert result is not None
        blinded = bool(result.reasons & Reason.BLINDED)
        if blinded and not self._blinded:
            background = min(65535, round(result.background_dn))
            self.raise_event(EventId.SENSOR_BLINDED, frame_index=record.index, background_dn=background)
        self._blinded = blinded
        if result.event is ModeEvent.ATTITUDE_ACQUIRED and self.mode == Mode.LOST_IN_SPACE:
            self.raise_event(
                EventId.ATTITUDE_ACQUIRED, frame_index=record.index, stars=min(255, len(result.stars))
            )
        elif result.event is ModeEvent.TRACKING_LOST and self.mode == Mode.TRACKING:
            self.raise_event(EventId.TRACKING_LOST, frame_index=record.index, reasons=int(result.reasons))
        if result.event is not None:
            self.follow(result.event)

    def frame_dropped(self, record: FrameRecord) -> None:
        self.frame_counters.frames_dropped += 1
        assert record.drop_cause is not None
        no_frame = record.drop_cause == FrameDropCause.NO_FRAME_FROM_SENSOR
        reasons = Reason.FRAME_DROPPED | (Reason.NO_FRAME if no_frame else Reason.OVERRUN)
        self.last_reasons = reasons
        self.raise_event(EventId.FRAME_DROPPED, frame_index=record.index, cause=int(record.drop_cause))
        self._report_attitude(record, reasons)

    def _report_attitude(self, record: FrameRecord, reasons: Reason) -> None:
        if not record.settings.report and self.can is None:
            return
        # An invalid report repeats the last valid attitude, so that a careless reader sees no jump.
        fields = attitude_fields(
            record, reasons, self._last_quaternion, self.time, self.mode, self.clock.now_ns
        )
        if self.can is not None and self.mode not in SILENT:
            self.can.report_attitude(fields)
        if record.settings.report:
            self.send("attitude_report", fields)

    # -- housekeeping
    # ----------------------------------------------------------------------------------------------

    @property
    def attitude_valid(self) -> bool:
        """Whether the last frame gave a valid attitude."""
        return not self.last_reasons

    @property
    def temperature_cdeg(self) -> int:
        return TEMPERATURE_CDEG

    @property
    def uptime_ms(self) -> int:
        return (self.clock.now_ns - self._powered_ns) // NS_PER_MS
