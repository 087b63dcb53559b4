"""What the device can be told, and how whoever told it learns what came of it.

A command is data. :meth:`StarTracker.check` refuses one with a reason (nothing has changed then),
:meth:`StarTracker.execute` runs one that was checked, and tells a :class:`Running` how it goes. The order of
what is told is part of the contract: ``started`` at most once, then ``progressed``, then one of ``completed``
and ``failed``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final, Protocol

from ..firmware_model.causes import ResetCause
from ..firmware_model.modes import Mode, ModeEvent, next_mode

Quaternion = tuple[float, float, float, float]
"""x, y, z, w: vector part first, scalar last."""


class Refusal(Enum):
    """Why a command is refused."""

    NOT_ALLOWED_IN_MODE = auto()
    OUT_OF_RANGE = auto()
    UNKNOWN_ID = auto()
    READ_ONLY = auto()
    BUSY = auto()
    NO_IMAGE = auto()
    ADDRESS = auto()


class RefusedError(Exception):
    """A command is refused; nothing was changed.

    ``subject`` is what it is about: the name of a parameter or memory, the mode, an address, or None.
    """

    def __init__(self, refusal: Refusal, subject: str | int | None = None) -> None:
        super().__init__(f"{refusal.name} ({subject})")
        self.refusal = refusal
        self.subject = subject


class Failure(Enum):
    """Why a command that ran did not complete."""

    SUPERSEDED = auto()
    SELF_TEST_FAILED = auto()
    ABORTED = auto()


class Running(Protocol):
    """Who gave a command: it is told how the command goes."""

    def started(self) -> None: ...

    def progressed(self, step: int) -> None: ...

    def completed(self) -> None: ...

    def failed(self, failure: Failure, data: int = 0) -> None: ...


class _Nobody:
    """Nobody wants to know."""

    def started(self) -> None:
        pass

    def progressed(self, step: int) -> None:
        pass

    def completed(self) -> None:
        pass

    def failed(self, failure: Failure, data: int = 0) -> None:
        pass


NOBODY: Final[Running] = _Nobody()


@dataclass(frozen=True)
class GoStandby:
    """Stop attitude determination."""


@dataclass(frozen=True)
class Acquire:
    """Find the attitude from nothing; completes with the first valid one."""


@dataclass(frozen=True)
class TrackFrom:
    """Track from a given attitude (a unit quaternion); completes with the first valid one."""

    q_icrs_to_sensor: Quaternion


@dataclass(frozen=True)
class RunSelfTest:
    """Test memories, program, catalogue and sensor; four steps."""


@dataclass(frozen=True)
class Reset:
    """Abort what runs, let the line run empty, restart. A warm reset keeps time and counters. The report
    :class:`~st_emulator.device.reports.Booted` takes the place of completion."""

    cause: ResetCause = ResetCause.COLD_RESET


@dataclass(frozen=True)
class Shutdown:
    """Abort what runs, let the line run empty, go to OFF."""


@dataclass(frozen=True)
class SetTime:
    """On-board time (TAI nanoseconds since 1958) at the virtual time ``at_ns``; in force, and completed, with
    the next frame's start. A later one supersedes it."""

    tai_ns: int
    at_ns: int


@dataclass(frozen=True)
class SetParameters:
    """Parameters by name; in force at the next exposure and kept through a restart."""

    values: Mapping[str, float | int]


@dataclass(frozen=True)
class RestoreParameters:
    """Factory values for every parameter."""


@dataclass(frozen=True)
class CaptureImage:
    """Keep the next frame that the sensor delivers; completes when it is read out."""


@dataclass(frozen=True)
class ClearCounters:
    """Count from 0."""


@dataclass(frozen=True)
class LoadMemory:
    """Write into a memory."""

    memory: str
    start: int
    data: bytes


Command = (
    GoStandby
    | Acquire
    | TrackFrom
    | RunSelfTest
    | Reset
    | Shutdown
    | SetTime
    | SetParameters
    | RestoreParameters
    | CaptureImage
    | ClearCounters
    | LoadMemory
)

RUNNING: Final = (Mode.STANDBY, Mode.LOST_IN_SPACE, Mode.TRACKING, Mode.RATE_ONLY)
LISTENING: Final = (*RUNNING, Mode.SELF_TEST, Mode.FAULT)

#: The mode event of a command that changes the mode: it is allowed where the mode table knows the event.
MODE_EVENTS: Final[dict[type[Command], ModeEvent]] = {
    GoStandby: ModeEvent.COMMAND_STANDBY,
    Acquire: ModeEvent.COMMAND_ACQUIRE,
    TrackFrom: ModeEvent.COMMAND_TRACK_FROM,
    RunSelfTest: ModeEvent.COMMAND_SELF_TEST,
    Reset: ModeEvent.COMMAND_RESET,
    Shutdown: ModeEvent.COMMAND_SHUTDOWN,
}

#: The modes in which a command that does not change the mode is allowed.
COMMAND_MODES: Final[dict[type[Command], tuple[Mode, ...]]] = {
    SetTime: (*RUNNING, Mode.FAULT),
    SetParameters: RUNNING,
    RestoreParameters: RUNNING,
    CaptureImage: RUNNING,
    ClearCounters: LISTENING,
    LoadMemory: (Mode.STANDBY, Mode.FAULT),
}


def modes_of(command: type[Command]) -> tuple[Mode, ...]:
    """The modes in which a kind of command is allowed."""
    event = MODE_EVENTS.get(command)
    if event is None:
        return COMMAND_MODES[command]
    return tuple(mode for mode in LISTENING if next_mode(mode, event) is not None)
