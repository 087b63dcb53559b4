"""Faults of the processor: it is slower than it was, hangs, or starts anew."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field

from ..clock import NS_PER_MS
from ..device.calibration import processor_profile
from ..firmware_model.causes import ResetCause
from ..firmware_model.cycle_table import NO_CACHE_KIB
from ..firmware_model.processor import ProcessorProfile
from .fault import AtProcessor, Fault, FaultKind, FaultSettings, Reach, SettingsT

Stage = Literal["threshold", "clustering", "centroid", "identification", "tracking", "attitude", "telemetry"]
Cause = Literal["power_on", "warm_reset", "cold_reset", "watchdog", "fault"]
Factor = Annotated[float, Field(gt=1, le=1e6, description="how many times as long it takes")]


class _Slower(AtProcessor[SettingsT]):
    """A processor in place of the unit's, made anew only when parameters gave the unit another one.

    ASSUMED: the firmware does not notice. The limit that it sets its search is that of the processor that it
    believes to have.
    """

    _plain: ProcessorProfile | None = None
    _slow: ProcessorProfile

    def processor(self, processor: ProcessorProfile) -> ProcessorProfile:
        if not self.strikes():
            return processor
        if processor is not self._plain:
            self._plain, self._slow = processor, self._made(processor)
        return self._slow

    def _made(self, processor: ProcessorProfile) -> ProcessorProfile:
        raise NotImplementedError


class SlowerClockSettings(FaultSettings):
    kind: Literal["processor.slower_clock"]
    factor: Factor = 4.0


class SlowerClock(_Slower[SlowerClockSettings]):
    def _made(self, processor: ProcessorProfile) -> ProcessorProfile:
        return processor.with_clock(max(1, round(processor.clock_hz / self.settings.factor)))


class CacheOffSettings(FaultSettings):
    kind: Literal["processor.cache_off"]


class CacheOff(_Slower[CacheOffSettings]):
    def __init__(self, settings: CacheOffSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        table = processor_profile(reach.profile).table
        if NO_CACHE_KIB not in table.caches_kib:
            raise ValueError(f"the cycle costs {table.name} say nothing of a processor whose caches are off")

    def _made(self, processor: ProcessorProfile) -> ProcessorProfile:
        return processor.with_cache(NO_CACHE_KIB)


class SlowStageSettings(FaultSettings):
    kind: Literal["processor.slow_stage"]
    stage: Annotated[Stage, Field(description="of the processing")] = "centroid"
    factor: Factor = 50.0


class SlowStage(_Slower[SlowStageSettings]):
    def _made(self, processor: ProcessorProfile) -> ProcessorProfile:
        return processor.with_slow_stage(self.settings.stage, self.settings.factor)


class StuckSettings(FaultSettings):
    kind: Literal["processor.stuck"]
    # ASSUMED: a watchdog is fed in each frame period and expires after a few of them that it missed
    watchdog_ms: Annotated[
        int, Field(ge=1, le=600_000, description="from the hang to the reset by the watchdog")
    ] = 1000


class Stuck(Fault[StuckSettings]):
    instant = True

    def begin(self) -> None:
        if self.strikes():
            self.reach.device.hang(self.settings.watchdog_ms * NS_PER_MS)


class SpuriousResetSettings(FaultSettings):
    kind: Literal["processor.spurious_reset"]
    cause: Annotated[Cause, Field(description="what the unit says of it")] = "fault"


class SpuriousReset(Fault[SpuriousResetSettings]):
    instant = True

    def begin(self) -> None:
        if self.strikes():
            self.reach.device.restart(ResetCause[self.settings.cause.upper()])


KINDS: Final = (
    FaultKind(
        SlowerClockSettings,
        SlowerClock,
        what="The processor's clock is a fraction of what it was; the memory keeps its own time. A frame "
        "that is struck is worked on at this clock.",
        obc_sees="Latencies grow. Where the frame's cycles do not fit its period any more: late in the "
        "attitude reports and FRAME_OVERRAN, and frames dropped with OVERRUN (FRAME_DROPPED, "
        "frames_dropped). Housekeeping TIMING shows the clock and a budget of fewer cycles. Attitudes that "
        "come are right.",
        afterwards="The frame that is in work ends late; from the next one on latencies are as before.",
    ),
    FaultKind(
        CacheOffSettings,
        CacheOff,
        what="The caches are off: every access goes to the memory.",
        obc_sees="The same frames take several times the cycles (cycles, cycles_memory and cache_kib 0 in "
        "housekeeping TIMING); where they do not fit the budget frames are late or dropped with OVERRUN.",
        afterwards="The frame that is in work ends late; from the next one on latencies are as before.",
    ),
    FaultKind(
        SlowStageSettings,
        SlowStage,
        what="One stage of the processing takes many times as long: threshold, clustering, centroid, "
        "identification, tracking, attitude or telemetry.",
        obc_sees="Its cycles in housekeeping TIMING are so many times as many, the others' are not; where "
        "the sum does not fit the budget frames are late or dropped with OVERRUN.",
        afterwards="The frame that is in work ends late; from the next one on latencies are as before.",
    ),
    FaultKind(
        StuckSettings,
        Stuck,
        what="The processor hangs: nothing is sent, taken or processed, what waited to be sent is lost. The "
        "watchdog resets the unit watchdog_ms later. Times of its end mean nothing.",
        obc_sees="Silence, telecommands without a report; then BOOT_COMPLETED with reset cause WATCHDOG and "
        "a boot count one higher. Working memory, on-board time and counters are those of a start.",
        afterwards="After watchdog and boot the unit is in STANDBY, or acquires by itself where "
        "autonomous_start is 1. Stored parameters are kept.",
    ),
    FaultKind(
        SpuriousResetSettings,
        SpuriousReset,
        what="The unit starts anew at once, without a command; what waited to be sent is lost. Times of its "
        "end mean nothing.",
        obc_sees="A gap of the boot time, then BOOT_COMPLETED with the reset cause that the setting says; "
        "sequence counts begin anew. The on-board time is not set any more, except for a warm reset.",
        afterwards="After the boot the unit is in STANDBY, or acquires by itself where autonomous_start is "
        "1. Stored parameters are kept.",
    ),
)
