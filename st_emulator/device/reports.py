"""What the device tells, in the order in which it happens. A dialect makes octets of it, or does not.

Times are virtual nanoseconds (``_ns``) or on-board TAI nanoseconds since 1958 (``tai_ns``).
"""

from __future__ import annotations

from dataclasses import dataclass

from ..firmware_model.causes import FaultCause, ResetCause, SelfTest, StoreInvalidCause
from ..firmware_model.modes import ModeTransition
from ..firmware_model.reasons import Reason
from .commands import Quaternion
from .image_memory import CapturedImage
from .imaging import FrameRecord


@dataclass(frozen=True)
class Restarted:
    """A boot begins: what a dialect remembers of the life before is void, what waits to be sent is lost."""

    cause: ResetCause


@dataclass(frozen=True)
class Booted:
    """The boot is over; telecommands are taken from now on. ``store_fault``: why factory parameters are in
    force, or None."""

    cause: ResetCause
    boot_count: int
    store_fault: StoreInvalidCause | None


@dataclass(frozen=True)
class GoingDown:
    """A reset or shutdown was commanded: no more telecommands; what runs is given up behind this report."""


@dataclass(frozen=True)
class ShutdownStarted:
    """The shutdown was commanded; :class:`GoingDown` follows."""


@dataclass(frozen=True)
class WentOff:
    """Shut down, without power, or hanging: nothing is sent any more, also not what waits."""


@dataclass(frozen=True)
class ModeChanged:
    """The mode is another one, by a row of the mode table, which says whether it is announced."""

    transition: ModeTransition


@dataclass(frozen=True)
class FrameStarted:
    """A frame period begins (also when no frame is taken)."""

    frame_index: int


@dataclass(frozen=True)
class TimeSet:
    """A setting of the on-board time came into force: its reading before and after, at this instant."""

    old_tai_ns: int
    new_tai_ns: int


@dataclass(frozen=True)
class AttitudeReady:
    """The result of a frame counts now, or a frame was dropped (its record has no result then).

    ``q_icrs_to_sensor``: of the frame, or of the last valid one, or the identity; ``reasons``: why it is not
    valid, none when it is.
    """

    record: FrameRecord
    reasons: Reason
    q_icrs_to_sensor: Quaternion


@dataclass(frozen=True)
class FrameOverran:
    """A processed frame needed more cycles than its budget."""

    record: FrameRecord
    budget_cycles: int


@dataclass(frozen=True)
class FrameDropped:
    """A frame was not processed (its record says why); an :class:`AttitudeReady` follows."""

    record: FrameRecord


@dataclass(frozen=True)
class AttitudeAcquired:
    """The attitude was found: lost in space, or behind frames that gave a rate alone."""

    record: FrameRecord


@dataclass(frozen=True)
class TrackingLost:
    """Too many frames without attitude."""

    record: FrameRecord


@dataclass(frozen=True)
class SensorBlinded:
    """The first frame of a row whose background is above the limit."""

    record: FrameRecord


@dataclass(frozen=True)
class SelfTestCompleted:
    """``failed``: the parts that failed."""

    failed: SelfTest


@dataclass(frozen=True)
class FaultEntered:
    """The unit went to FAULT."""

    cause: FaultCause


@dataclass(frozen=True)
class ImageCaptured:
    """An image is in the image memory."""

    image: CapturedImage


@dataclass(frozen=True)
class ParametersStored:
    """So many parameters were set and kept."""

    count: int


@dataclass(frozen=True)
class CountersCleared:
    """Every counter starts from 0, those of the dialect, too."""


Report = (
    Restarted
    | Booted
    | GoingDown
    | ShutdownStarted
    | WentOff
    | ModeChanged
    | FrameStarted
    | TimeSet
    | AttitudeReady
    | FrameOverran
    | FrameDropped
    | AttitudeAcquired
    | TrackingLost
    | SensorBlinded
    | SelfTestCompleted
    | FaultEntered
    | ImageCaptured
    | ParametersStored
    | CountersCleared
)
