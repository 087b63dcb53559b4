"""The modes and the one table that changes them: (mode, event) -> mode. Nothing else changes a mode.

The numbers are those of the telemetry. Modes follow ECSS-E-ST-60-20C in their meaning: autonomous attitude
determination (lost in space) and autonomous attitude tracking.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

__all__ = [
    "MODE_MEANINGS",
    "TRANSITIONS",
    "Mode",
    "ModeEvent",
    "ModeTransition",
    "next_mode",
    "transition",
]


class Mode(IntEnum):
    """What the unit does."""

    BOOT = 0
    SELF_TEST = 1
    STANDBY = 2
    LOST_IN_SPACE = 3
    TRACKING = 4
    FAULT = 5
    OFF = 6
    RATE_ONLY = 7


MODE_MEANINGS: dict[Mode, str] = {
    Mode.BOOT: "initialising after power-on or reset; no attitude",
    Mode.SELF_TEST: "testing itself; no attitude",
    Mode.STANDBY: "waiting for a command; frames are not processed",
    Mode.LOST_IN_SPACE: "looking for the attitude over the whole sky, without any prior",
    Mode.TRACKING: "following the stars in detection windows from frame to frame",
    Mode.FAULT: "stopped by a fault; only a reset or a self-test leads out",
    Mode.RATE_ONLY: "turning too fast for an attitude: the rate alone is measured, from frame to frame",
    Mode.OFF: "shut down; nothing is sent until power is cycled",
}


class ModeEvent(IntEnum):
    """What can change the mode; the numbers are the cause in the event report of a mode change."""

    POWER_ON = 0
    BOOT_DONE = 1
    SELF_TEST_STARTED = 2
    SELF_TEST_PASSED = 3
    SELF_TEST_FAILED = 4
    COMMAND_STANDBY = 5
    COMMAND_ACQUIRE = 6
    COMMAND_TRACK_FROM = 7
    COMMAND_SELF_TEST = 8
    COMMAND_RESET = 9
    COMMAND_SHUTDOWN = 10
    AUTONOMOUS_START = 11
    ATTITUDE_ACQUIRED = 12
    TRACKING_LOST = 13
    FAULT_DETECTED = 14
    POWER_OFF = 15
    RATE_ALONE = 16
    SLOW_AGAIN = 17


@dataclass(frozen=True)
class ModeTransition:
    """One row of the table.

    ``announced``: whether the unit tells the change as such; not where nothing is sent in the new mode, and
    not where another report says it (the end of the boot).
    """

    mode: Mode
    event: ModeEvent
    next_mode: Mode
    meaning: str

    @property
    def announced(self) -> bool:
        return self.next_mode not in (Mode.BOOT, Mode.OFF) and self.event is not ModeEvent.BOOT_DONE


def _rows(
    modes: tuple[Mode, ...], event: ModeEvent, next_mode: Mode, meaning: str
) -> tuple[ModeTransition, ...]:
    return tuple(ModeTransition(mode, event, next_mode, meaning) for mode in modes)


_ACQUIRING = (Mode.LOST_IN_SPACE, Mode.TRACKING, Mode.RATE_ONLY)
_COMMANDED = (Mode.STANDBY, *_ACQUIRING)
_POWERED = (Mode.BOOT, Mode.SELF_TEST, *_COMMANDED, Mode.FAULT)

TRANSITIONS: tuple[ModeTransition, ...] = (
    *_rows((Mode.OFF,), ModeEvent.POWER_ON, Mode.BOOT, "power comes on"),
    *_rows((Mode.BOOT,), ModeEvent.BOOT_DONE, Mode.STANDBY, "started; no power-on self-test is asked for"),
    *_rows((Mode.BOOT,), ModeEvent.SELF_TEST_STARTED, Mode.SELF_TEST, "started; the power-on self-test runs"),
    *_rows((Mode.SELF_TEST,), ModeEvent.SELF_TEST_PASSED, Mode.STANDBY, "every check passed"),
    *_rows((Mode.SELF_TEST,), ModeEvent.SELF_TEST_FAILED, Mode.FAULT, "a check failed"),
    *_rows((Mode.STANDBY, Mode.FAULT), ModeEvent.COMMAND_SELF_TEST, Mode.SELF_TEST, "self-test on command"),
    *_rows(_COMMANDED, ModeEvent.COMMAND_STANDBY, Mode.STANDBY, "stop attitude determination"),
    *_rows(_COMMANDED, ModeEvent.COMMAND_ACQUIRE, Mode.LOST_IN_SPACE, "find the attitude from nothing"),
    *_rows((Mode.STANDBY,), ModeEvent.AUTONOMOUS_START, Mode.LOST_IN_SPACE, "as configured, without command"),
    *_rows(
        _COMMANDED, ModeEvent.COMMAND_TRACK_FROM, Mode.TRACKING, "track from an attitude sent to the unit"
    ),
    *_rows(
        (Mode.LOST_IN_SPACE, Mode.RATE_ONLY),
        ModeEvent.ATTITUDE_ACQUIRED,
        Mode.TRACKING,
        "a valid attitude was found",
    ),
    *_rows(
        (Mode.LOST_IN_SPACE,), ModeEvent.RATE_ALONE, Mode.RATE_ONLY, "a rate is measured, but no attitude"
    ),
    *_rows((Mode.RATE_ONLY,), ModeEvent.SLOW_AGAIN, Mode.LOST_IN_SPACE, "slow enough for an attitude"),
    *_rows((Mode.TRACKING,), ModeEvent.TRACKING_LOST, Mode.LOST_IN_SPACE, "too many frames without attitude"),
    *_rows(
        (Mode.BOOT, Mode.SELF_TEST, *_COMMANDED),
        ModeEvent.FAULT_DETECTED,
        Mode.FAULT,
        "the unit is not fit to go on",
    ),
    *_rows(_POWERED, ModeEvent.COMMAND_RESET, Mode.BOOT, "restart, on command or by the watchdog"),
    *_rows(_POWERED, ModeEvent.COMMAND_SHUTDOWN, Mode.OFF, "end cleanly; parameters are stored"),
    *_rows(_POWERED, ModeEvent.POWER_OFF, Mode.OFF, "power goes, at any instant"),
)

_ROWS: dict[tuple[Mode, ModeEvent], ModeTransition] = {(row.mode, row.event): row for row in TRANSITIONS}


def transition(mode: Mode, event: ModeEvent) -> ModeTransition | None:
    """The row of the table for an event in a mode, or None when the event is not allowed (or means nothing)
    there.
    """
    return _ROWS.get((mode, event))


def next_mode(mode: Mode, event: ModeEvent) -> Mode | None:
    """The mode after the event, or None when the event is not allowed (or means nothing) in the mode."""
    row = transition(mode, event)
    return None if row is None else row.next_mode
