"""One star tracker: commands and frames in, reports out, in virtual time.

It knows no wire, touches no port, no clock of the computer and no file but its store. Power, boot and mode
are its life (``life.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from ..clock import NS_PER_MS, VirtualClock
from ..firmware_model.causes import FaultCause, FrameDropCause, ResetCause
from ..firmware_model.configuration import StarTables
from ..firmware_model.firmware import FirmwareState
from ..firmware_model.modes import Mode, ModeEvent, transition
from ..firmware_model.reasons import Reason
from ..firmware_model.work import Work
from ..units.profile import UnitProfile
from . import reports
from .commands import (
    NOBODY,
    Acquire,
    CaptureImage,
    ClearCounters,
    Command,
    Failure,
    GoStandby,
    LoadMemory,
    Quaternion,
    Refusal,
    RefusedError,
    Reset,
    RestoreParameters,
    Running,
    RunSelfTest,
    SetParameters,
    SetTime,
    Shutdown,
    TrackFrom,
    modes_of,
)
from .counters import FrameCounters
from .health import Health
from .image_memory import CapturedImage, ImageMemory
from .imaging import FrameRecord, FrameSettings, FrameSource, Imaging, Lazy, Submit
from .life import Life
from .memories import Memories
from .onboard_time import OnboardTime
from .parameters import Parameters
from .seams import PLAIN, DeviceSeams
from .self_test import STEPS, SelfTestRun
from .store import Store

IDENTITY: Final[Quaternion] = (0.0, 0.0, 0.0, 1.0)
SEARCHING: Final = (Mode.LOST_IN_SPACE, Mode.RATE_ONLY)
TEMPERATURE_CDEG: Final = 2000  # ASSUMED: 20.00 deg C; no thermal model


class StarTracker(Life):
    """The device.

    Args:
        profile: the unit file.
        clock: the virtual clock; power comes on with :meth:`power_on`.
        source: what the detector sees.
        tables: the on-board catalogue.
        store: the non-volatile memory.
        submit: how a frame's computation is started (at once beside the loop, or when needed).
        on_frame: called when a frame is exposed, with its record (the truth is written there).
        on_completed: called when a frame's result counts.
        seams: where faults enter.
    """

    def __init__(
        self,
        profile: UnitProfile,
        clock: VirtualClock,
        source: FrameSource,
        tables: StarTables,
        store: Store,
        *,
        submit: Submit = Lazy,
        on_frame: Callable[[FrameRecord], None] = lambda record: None,
        on_completed: Callable[[FrameRecord], None] = lambda record: None,
        seams: DeviceSeams = PLAIN,
    ) -> None:
        super().__init__(clock, profile.timing.boot_ms * NS_PER_MS)
        self.profile = profile
        self._seams = seams
        self.time = OnboardTime()
        self.frame_counters = FrameCounters()
        self.parameters = Parameters(profile, store)
        self.memories = Memories(profile.name, tables, seams.written)
        self.imaging = Imaging(
            clock,
            source,
            self,
            period_ns=profile.frame_period_ns,
            readout_ns=int(profile.timing.readout_ms * NS_PER_MS),
            last_row_start_ns=profile.last_row_start_ns,
            row_time_s=profile.row_time_s,
            submit=submit,
        )
        self.image_memory = ImageMemory(self.imaging, self._image_kept)
        self.self_test = SelfTestRun(self.memories, self.parameters)
        self.last_frame: FrameRecord | None = None
        self.last_frame_index = 0
        self.last_reasons = Reason.NOT_ACQUIRING
        self.last_quaternion = self._last_valid = IDENTITY
        self._health = Health(self.memories, profile.frame_period_ns)
        self._on_frame = on_frame
        self._on_completed = on_completed
        self._blinded = False
        self._setting_time: Running | None = None
        self._acquiring: Running | None = None

    # -- what it does in its life

    def _power_came(self) -> None:
        self.imaging.start()

    def _power_went(self) -> None:
        self.imaging.halt()

    def _begin(self, cause: ResetCause) -> None:
        if cause != ResetCause.WARM_RESET:
            self._clear_counters()
            self.time.restart(self.clock.now_ns)
        self.image_memory.reset()
        self.memories.reset()
        self._fall_still()
        self.last_frame = None
        self.last_reasons = Reason.NOT_ACQUIRING
        self.last_quaternion = self._last_valid = IDENTITY
        self._blinded = False
        self._setting_time = self._acquiring = None
        self.self_test.reset()
        self._health.reset()
        self.time.discard_pending()
        self.parameters.load(count_start=True)

    def _booted(self, fault: FaultCause | None) -> None:
        self._tell(
            reports.Booted(self.reset_cause, self.parameters.boot_count, self.parameters.fault_at_start)
        )
        if fault is not None:
            self.enter_fault(fault)
        elif self.parameters["autonomous_start"]:
            self.imaging.acquire()
            self._follow(ModeEvent.AUTONOMOUS_START)

    def _come_to_rest(self) -> None:
        self.imaging.stop()
        self._tell(reports.GoingDown())
        self.image_memory.abort_capture()
        self._give_up_acquisition(Failure.ABORTED)
        self._give_up_self_test()
        self._give_up_time(Failure.ABORTED)

    def _fall_still(self) -> None:
        self.imaging.stop()
        self.imaging.cancel_capture()

    def _clear_counters(self) -> None:
        self.frame_counters.clear()
        self._tell(reports.CountersCleared())

    def enter_fault(self, cause: FaultCause) -> None:
        """Stop in FAULT; nothing happens where the table does not lead there (FAULT, OFF), or while it hangs.
        From BOOT when the boot is over: nothing is sent or taken before.
        """
        if self._hangs or transition(self.mode, ModeEvent.FAULT_DETECTED) is None:
            return
        if self.mode == Mode.BOOT:
            self._fault_in_boot = self._fault_in_boot or cause
            return
        self.imaging.stop()
        self._health.reset()  # the self-test judges anew
        self.last_reasons = Reason.NOT_ACQUIRING
        self.image_memory.abort_capture()
        self._give_up_acquisition(Failure.ABORTED)
        self._give_up_self_test()
        self._follow(ModeEvent.FAULT_DETECTED)
        self._tell(reports.FaultEntered(cause))

    def _found(self, fault: FaultCause | None) -> None:
        """What a check in operation has found. A self-test finds it itself, and says all that it finds."""
        if fault is not None and not self._going_down and not self.self_test.running:
            self.enter_fault(fault)

    # -- commands

    def check(self, command: Command) -> None:
        """Raise :class:`RefusedError` for a command that the device does not take now."""
        if self.mode not in modes_of(type(command)):
            raise RefusedError(Refusal.NOT_ALLOWED_IN_MODE, int(self.mode))
        match command:
            case SetParameters(values):
                self.parameters.check(values)
            case CaptureImage():
                self.image_memory.check_free()
            case LoadMemory():
                self.memories.check_load(command)

    def execute(self, command: Command, running: Running = NOBODY) -> None:
        """Run a command that :meth:`check` let pass at this instant."""
        match command:
            case GoStandby():
                self._go_standby()
                running.completed()
            case Acquire():
                self._await_attitude(running)
                self.imaging.acquire()
                self._follow(ModeEvent.COMMAND_ACQUIRE)
            case TrackFrom(quaternion):
                self._await_attitude(running)
                state = FirmwareState.from_attitude(np.array(quaternion), self.clock.now_ns)
                self.imaging.acquire(state, Mode.TRACKING)
                self._follow(ModeEvent.COMMAND_TRACK_FROM)
            case RunSelfTest():
                self._run_self_test(running)
            case Reset(cause):
                running.started()
                self._go_down(partial(self._boot, ModeEvent.COMMAND_RESET, cause))
            case Shutdown():
                running.started()
                self._tell(reports.ShutdownStarted())
                self._go_down(partial(self._off, ModeEvent.COMMAND_SHUTDOWN))
                running.completed()
            case SetTime(tai_ns, at_ns):
                running.started()
                self._give_up_time(Failure.SUPERSEDED)
                self._setting_time = running
                self.time.prepare(tai_ns, at_ns)
            case SetParameters(values):
                self._tell(reports.ParametersStored(self.parameters.store(values)))
                running.completed()
            case RestoreParameters():
                self._tell(reports.ParametersStored(self.parameters.restore_defaults()))
                running.completed()
            case CaptureImage():
                self.image_memory.capture(running)
            case ClearCounters():
                self._clear_counters()
                running.completed()
            case LoadMemory():
                self.memories.load(command)
                running.completed()

    def _go_standby(self) -> None:
        self.imaging.stop()
        self._give_up_acquisition(Failure.ABORTED)
        self.last_reasons = Reason.NOT_ACQUIRING
        self._follow(ModeEvent.COMMAND_STANDBY)

    def _await_attitude(self, running: Running) -> None:
        running.started()
        self._give_up_acquisition(Failure.SUPERSEDED)
        self._acquiring = running

    def _give_up_acquisition(self, failure: Failure) -> None:
        running, self._acquiring = self._acquiring, None
        if running is not None:
            running.failed(failure)

    def _give_up_time(self, failure: Failure) -> None:
        running, self._setting_time = self._setting_time, None
        if running is not None:
            running.failed(failure)
            self.time.discard_pending()

    # -- self-test

    def _run_self_test(self, running: Running) -> None:
        """Test every part, a step at a time; back to STANDBY, or to FAULT."""
        self.imaging.stop()
        self.image_memory.abort_capture()
        self.self_test.begin(running)
        self._follow(ModeEvent.COMMAND_SELF_TEST)
        running.started()
        self.imaging.capture()
        step_ns = self.profile.timing.self_test_ms * NS_PER_MS // STEPS
        for step in range(1, STEPS + 1):
            self.later(step * step_ns, partial(self._self_test_step, running, self.self_test.runs, step))

    def _self_test_step(self, running: Running, run: int, step: int) -> None:
        test = self.self_test
        if test.runs != run:
            return
        test.test(step)
        if step < STEPS:
            running.progressed(step)
            return
        test.end()
        self.imaging.cancel_capture()
        self._tell(reports.SelfTestCompleted(test.result))
        if test.result:
            running.failed(Failure.SELF_TEST_FAILED, int(test.result))
            self._follow(ModeEvent.SELF_TEST_FAILED)
            self._tell(reports.FaultEntered(FaultCause.SELF_TEST_FAILED))
        else:
            running.progressed(step)
            running.completed()
            self._follow(ModeEvent.SELF_TEST_PASSED)

    def _give_up_self_test(self) -> None:
        if self.self_test.running:
            self.imaging.cancel_capture()
            self.self_test.give_up()

    # -- imaging's client

    def frame_started(self, frame_index: int) -> None:
        self.last_frame_index = frame_index
        if self.silent:
            return
        change = None
        if self.time.waiting and self._seams.synchronises():
            change = self.time.apply(self.clock.now_ns)
        if change is not None:
            self._tell(reports.TimeSet(*change))
            running, self._setting_time = self._setting_time, None
            if running is not None:
                running.completed()
        self._tell(reports.FrameStarted(frame_index))
        self._found(self._health.frame_started(frame_index))

    def frame_settings(self) -> FrameSettings:
        settings = self.parameters.frame_settings()
        processor = self._seams.processor(settings.processor)
        return settings if processor is settings.processor else replace(settings, processor=processor)

    @property
    def tables(self) -> StarTables:
        """The on-board catalogue."""
        return self.memories.tables

    def link_work(self) -> Work:
        return self._speaker.take_work()

    def onboard_tai_ns(self, t_ns: int) -> int | None:
        return self.time.tai_ns(t_ns) if self.time.synchronised else None

    def frame_exposed(self, record: FrameRecord) -> None:
        self._on_frame(record)
        self._found(self._health.frame_wanted(record.pixels is not None))

    def image_captured(self, record: FrameRecord) -> None:
        if self.self_test.running:
            self.self_test.frame_captured()
        elif not self.silent:
            self.image_memory.keep(record, self.time.tai_ns(record.mid_exposure_ns))

    def _image_kept(self, image: CapturedImage) -> None:
        self._tell(reports.ImageCaptured(image))

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
        if result.valid:
            x, y, z, w = (float(value) for value in result.q_icrs_to_sensor)
            self._last_valid = (x, y, z, w)
        self._tell_attitude(record, result.reasons)
        if record.late_ns:
            self._tell(reports.FrameOverran(record, self.imaging.budget_cycles(record.settings)))
        self._follow_frame(record)
        if result.valid and self._acquiring is not None:
            acquiring, self._acquiring = self._acquiring, None  # who is told may give the next command
            acquiring.completed()
        self._on_completed(record)

    def _follow_frame(self, record: FrameRecord) -> None:
        result = record.result
        assert result is not None
        blinded = bool(result.reasons & Reason.BLINDED)
        if blinded and not self._blinded:
            self._tell(reports.SensorBlinded(record))
        self._blinded = blinded
        if result.event is ModeEvent.ATTITUDE_ACQUIRED and self.mode in SEARCHING:
            self._tell(reports.AttitudeAcquired(record))
        elif result.event is ModeEvent.TRACKING_LOST and self.mode == Mode.TRACKING:
            self._tell(reports.TrackingLost(record))
        if result.event is not None:
            self._follow(result.event)

    def frame_dropped(self, record: FrameRecord) -> None:
        self.frame_counters.frames_dropped += 1
        assert record.drop_cause is not None
        no_frame = record.drop_cause == FrameDropCause.NO_FRAME_FROM_SENSOR
        reasons = Reason.FRAME_DROPPED | (Reason.NO_FRAME if no_frame else Reason.OVERRUN)
        self.last_reasons = reasons
        self._tell(reports.FrameDropped(record))
        self._tell_attitude(record, reasons)

    def _tell_attitude(self, record: FrameRecord, reasons: Reason) -> None:
        """Tell what a frame gave, and remember what was told."""
        report = self._seams.attitude(reports.AttitudeReady(record, reasons, self._last_valid))
        if report.record.result is not None:
            self.last_frame = report.record
        self.last_reasons = report.reasons
        self.last_quaternion = report.q_icrs_to_sensor
        self._tell(report)

    # -- what a dialect may ask at any time

    @property
    def attitude_valid(self) -> bool:
        """Whether the last frame gave a valid attitude."""
        return not self.last_reasons

    @property
    def temperature_cdeg(self) -> int:
        """Of the detector, 0.01 deg C."""
        return TEMPERATURE_CDEG

    @property
    def uptime_ms(self) -> int:
        """Since the last start."""
        return (self.clock.now_ns - self._started_ns) // NS_PER_MS
