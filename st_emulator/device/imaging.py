"""Frames in time: exposure, read-out, processing on a cycle budget, dropped frames.

The frame grid runs from power-on with the unit's period. A frame's parameters are latched at its exposure
start. Its processing starts when it is read out and ends when its cycles are spent; then its result counts.
The processor also builds telemetry and takes telecommands in: what it did of that since the frame before
counts into a frame. ASSUMED: all of it, although some is done while the processor has no frame to work on.
A frame that needs more cycles than its budget is late, and a frame whose read-out finds the processor still
busy is dropped. Without overlap (``pipelined`` 0) a frame is not even exposed while the processor is busy.

The rows of a rolling shutter are exposed one after the other: its frames may overlap, a row beginning its
exposure of the next frame when that of the frame before ends. What becomes of a frame that begins while the
one before still is exposed is settled when that one has been read out.

The computation itself is started at the exposure start (beside the loop in real time) and joined when its
processing starts in virtual time, so no telecommand waits for pixels and the results do not depend on the
computer's speed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from ..clock import NS_PER_S, NS_PER_US, ScheduledEvent, VirtualClock
from ..firmware_model.causes import FrameDropCause
from ..firmware_model.configuration import FirmwareConfiguration, StarTables
from ..firmware_model.firmware import FirmwareState, FrameContext, FrameResult, process_frame
from ..firmware_model.image.frame import Frame
from ..firmware_model.modes import Mode
from ..firmware_model.processor import CycleReport, ProcessorProfile
from ..firmware_model.work import Work


class FrameSource(Protocol):
    """What stands in front of the detector: the rendered sky or recorded frames."""

    def frame(self, frame_index: int, exposure_start_ns: int, exposure_ns: int) -> Frame | None:
        """The pixels of an exposure (they may be rendered when first read), or None when the sensor
        delivers none.
        """


class Deferred(Protocol):
    """A result that is computed beside the loop or when first asked for."""

    def result(self) -> Any: ...


class Lazy:
    """Computes when first asked: for runs as fast as possible and for tests."""

    def __init__(self, compute: Callable[[], Any]) -> None:
        self._compute: Callable[[], Any] | None = compute
        self._value: Any = None

    def result(self) -> Any:
        if self._compute is not None:
            self._value, self._compute = self._compute(), None
        return self._value


Submit = Callable[[Callable[[], Any]], Deferred]


@dataclass(frozen=True)
class FrameSettings:
    """What is latched at a frame's exposure start."""

    configuration: FirmwareConfiguration
    processor: ProcessorProfile
    pipelined: bool
    report: bool = True


@dataclass
class FrameRecord:
    """One frame from its exposure to its result.

    exposure_ns: of each row; last_row_start_ns: when the last row's begins, after start_ns (0: a global
    shutter).
    """

    index: int
    start_ns: int
    exposure_ns: int
    readout_end_ns: int
    settings: FrameSettings
    epoch: int
    acquisition: Mode | None
    pixels: Frame | None
    computation: Deferred | None = None
    result: FrameResult | None = None
    work: Work | None = None
    cycles: CycleReport | None = None
    due_ns: int | None = None
    late_ns: int = 0
    dropped_before: int = 0
    drop_cause: FrameDropCause | None = None
    last_row_start_ns: int = 0

    @property
    def exposed_ns(self) -> int:
        """When it was exposed: the middle, of a rolling shutter that of the middle of its rows."""
        return self.start_ns + (self.exposure_ns + self.last_row_start_ns) // 2

    @property
    def mid_exposure_ns(self) -> int:
        """The same, as it is told."""
        return self.exposed_ns

    @property
    def exposure_end_ns(self) -> int:
        """Of the last row."""
        return self.start_ns + self.last_row_start_ns + self.exposure_ns


class ImagingClient(Protocol):
    """What the imaging chain needs from the unit, and tells it."""

    def frame_started(self, frame_index: int) -> None:
        """A frame period begins (also when no frame is taken)."""

    def frame_settings(self) -> FrameSettings: ...

    @property
    def tables(self) -> StarTables:
        """The on-board catalogue as it stands in memory."""

    def link_work(self) -> Work:
        """Work of telemetry and telecommands since the last call: the processor's, like the frame's."""
        ...

    def onboard_tai_ns(self, t_ns: int) -> int | None:
        """On-board TAI at a virtual time, or None while it is not set."""

    def frame_exposed(self, record: FrameRecord) -> None:
        """A frame is on its way (for the truth record)."""

    def frame_completed(self, record: FrameRecord) -> None: ...

    def frame_dropped(self, record: FrameRecord) -> None: ...

    def image_captured(self, record: FrameRecord) -> None: ...


class Imaging:
    """The frame grid and the processor's time line."""

    def __init__(
        self,
        clock: VirtualClock,
        source: FrameSource,
        client: ImagingClient,
        *,
        period_ns: int,
        readout_ns: int,
        last_row_start_ns: int = 0,
        row_time_s: float = 0.0,
        submit: Submit = Lazy,
    ) -> None:
        """last_row_start_ns, row_time_s: of a rolling shutter, when the last row's exposure begins, and from
        the start of a row to that of the next one; 0: a global shutter.
        """
        self._clock = clock
        self._source = source
        self._client = client
        self.period_ns = period_ns
        self._readout_ns = readout_ns
        self._last_row_start_ns = last_row_start_ns
        self._row_time_s = row_time_s
        self._submit = submit
        self._epoch = 0
        self._acquisition: Mode | None = None
        self._state = FirmwareState.initial()
        self._previous: FrameRecord | None = None
        self._waiting: deque[FrameRecord] = deque()  # for the read-out of the previous frame
        self._dropped_since = 0
        self._capture_wanted = False
        self._next_tick: ScheduledEvent | None = None
        self._captures = 0  # counts captures asked for and cancelled; the read-out of an earlier one is void

    # -- what the unit asks for
    # ------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin the frame grid at the present time (power-on); the one before was halted."""
        self._tick_at(self._clock.now_ns, 0)

    def halt(self) -> None:
        """No more frame periods (power goes)."""
        self.stop()
        self.cancel_capture()
        if self._next_tick is not None:
            self._next_tick.cancel()
            self._next_tick = None

    def _tick_at(self, at_ns: int, index: int) -> None:
        self._next_tick = self._clock.at(at_ns, lambda: self._tick(index))

    def acquire(self, state: FirmwareState | None = None, acquisition: Mode = Mode.LOST_IN_SPACE) -> None:
        """Process frames from the next exposure on; frames in flight are given up."""
        self.stop()
        self._acquisition = acquisition
        self._state = state or FirmwareState.initial()

    def stop(self) -> None:
        """Process no more frames; frames in flight are given up and the processor is free."""
        self._epoch += 1
        self._acquisition = None
        self._previous = None
        self._waiting.clear()
        self._dropped_since = 0

    def capture(self) -> None:
        """Tell the client of the next frame that the sensor delivers, when it is read out."""
        self._captures += 1
        self._capture_wanted = True

    def cancel_capture(self) -> None:
        """The frame is wanted no more, also when it is exposed already."""
        self._captures += 1
        self._capture_wanted = False

    @property
    def next_start_ns(self) -> int | None:
        """When the next frame period begins; None without power."""
        return None if self._next_tick is None else self._next_tick.at_ns

    def budget_cycles(self, settings: FrameSettings) -> int:
        """Cycles between a frame's read-out and the moment from which on it is late."""
        return max(0, self._budget_ns(settings)) * settings.processor.clock_hz // NS_PER_S

    def _budget_ns(self, settings: FrameSettings) -> int:
        """A period when processing overlaps the next exposure, else what is left of the frame's own."""
        if settings.pipelined:
            return self.period_ns
        return self.period_ns - settings.configuration.exposure_ns - self._readout_ns

    # -- the time line of a frame
    # ----------------------------------------------------------------------------------

    def _tick(self, index: int) -> None:
        start_ns = self._clock.now_ns
        self._tick_at(start_ns + self.period_ns, index + 1)
        self._client.frame_started(index)
        if self._previous is None:
            self._client.link_work()  # done while the processor had nothing else to do
        if self._acquisition is None and not self._capture_wanted:
            return
        settings = self._client.frame_settings()
        exposure_ns = settings.configuration.exposure_ns
        record = FrameRecord(
            index=index,
            start_ns=start_ns,
            exposure_ns=exposure_ns,
            readout_end_ns=start_ns + exposure_ns + self._readout_ns,
            settings=settings,
            epoch=self._epoch,
            acquisition=None,
            pixels=None,
            last_row_start_ns=self._last_row_start_ns,
        )
        previous = self._previous
        overlaps = bool(self._waiting) or (previous is not None and previous.exposure_end_ns > start_ns)
        if self._acquisition is not None and previous is not None and not overlaps:
            self._join(previous)  # its cycles and its state are needed from here on
        busy = overlaps or self._busy_until_ns() > start_ns
        if self._acquisition is not None and not settings.pipelined and busy:
            # No exposure at all: the processor has no time to start it.
            self._drop(record, FrameDropCause.PROCESSOR_BUSY, start_ns)
            return
        record.pixels = self._source.frame(index, start_ns, exposure_ns)
        self._client.frame_exposed(record)
        if self._capture_wanted and record.pixels is not None:
            self._capture_wanted = False
            number = self._captures
            self._clock.at(record.readout_end_ns, lambda: self._captured(record, number))
        if self._acquisition is None:
            return
        if overlaps:
            self._waiting.append(record)
        else:
            self._settle(record)

    def _busy_until_ns(self) -> int:
        """Until when the processor works on the previous frame, which is joined; 0: on none."""
        previous = self._previous
        return 0 if previous is None or previous.due_ns is None else previous.due_ns

    def _settle(self, record: FrameRecord) -> None:
        """What becomes of a frame that is exposed; the one before is joined."""
        if record.pixels is None:
            self._drop(record, FrameDropCause.NO_FRAME_FROM_SENSOR, record.readout_end_ns)
            return
        if self._busy_until_ns() > record.readout_end_ns:
            self._drop(record, FrameDropCause.OVERRUN, record.readout_end_ns)
            return
        record.acquisition = self._acquisition
        record.dropped_before, self._dropped_since = self._dropped_since, 0
        self._compute(record)
        self._previous = record
        self._clock.at(record.readout_end_ns, lambda: self._processing_starts(record))

    def _compute(self, record: FrameRecord) -> None:
        frame, state, tables = record.pixels, self._state, self._client.tables
        assert frame is not None
        assert record.acquisition is not None
        context = FrameContext(
            frame_index=record.index,
            acquisition=record.acquisition,
            t_mid_ns=record.mid_exposure_ns,
            exposure_ns=record.exposure_ns,
            tai_ns=self._client.onboard_tai_ns(record.mid_exposure_ns),
            row_time_s=self._row_time_s,
        )
        configuration = record.settings.configuration
        record.computation = self._submit(lambda: process_frame(frame, context, state, configuration, tables))

    def _join(self, record: FrameRecord) -> None:
        """Fetch the frame's result, advance the firmware's state and fix when the result counts."""
        if record.computation is None:
            return
        result: FrameResult = record.computation.result()
        record.computation = None
        record.result = result
        record.work = result.work + self._client.link_work()
        record.cycles = record.settings.processor.cycles(record.work)
        processing_ns = record.settings.processor.duration_ns(record.cycles.total)
        record.due_ns = record.readout_end_ns + processing_ns
        record.late_ns = max(0, processing_ns - self._budget_ns(record.settings))
        self._state = result.state
        self._acquisition = result.acquisition_after
        self._clock.at(max(record.due_ns, self._clock.now_ns), lambda: self._completed(record))

    def _processing_starts(self, record: FrameRecord) -> None:
        if record.epoch != self._epoch:
            return
        self._join(record)
        while self._waiting and record is self._previous:
            self._settle(self._waiting.popleft())

    def _completed(self, record: FrameRecord) -> None:
        if record.epoch == self._epoch:
            self._client.frame_completed(record)

    def _captured(self, record: FrameRecord, number: int) -> None:
        if number == self._captures:
            self._client.image_captured(record)

    def _drop(self, record: FrameRecord, cause: FrameDropCause, told_ns: int) -> None:
        """Leave the frame out; the client is told at ``told_ns``."""
        record.drop_cause, record.dropped_before = cause, self._dropped_since
        self._dropped_since += 1

        def tell() -> None:
            if record.epoch == self._epoch:
                self._client.frame_dropped(record)

        self._clock.at(told_ns, tell)


def microseconds(duration_ns: int) -> int:
    """Whole microseconds, rounded."""
    return (duration_ns + NS_PER_US // 2) // NS_PER_US
