"""The checks that go on in operation: memories come round to be checked, and the sensor has to deliver."""

from __future__ import annotations

from ..clock import NS_PER_S
from ..firmware_model.causes import FaultCause
from .memories import Memories

CHECK_PERIOD_NS = 2 * NS_PER_S  # ASSUMED: all memories come round within it, in time left over by the frames
SENSOR_SILENCE_NS = 2 * NS_PER_S  # ASSUMED: a missed frame is noise, two seconds of them are a dead sensor


class Health:
    """Says when the unit is not fit to go on.

    Args:
        memories: what is checked.
        period_ns: of the frames.
    """

    def __init__(self, memories: Memories, period_ns: int) -> None:
        self._memories = memories
        self._check_frames = max(1, CHECK_PERIOD_NS // period_ns)
        self._most_missed = max(1, SENSOR_SILENCE_NS // period_ns)
        self._missed = 0

    def reset(self) -> None:
        """The unit starts anew."""
        self._missed = 0

    def frame_started(self, frame_index: int) -> FaultCause | None:
        """What the check that ends with this frame's start has found."""
        return None if frame_index % self._check_frames else self._memories.damage()

    def frame_wanted(self, delivered: bool) -> FaultCause | None:
        """A frame was wanted from the sensor, and came or did not."""
        self._missed = 0 if delivered else self._missed + 1
        return FaultCause.SENSOR_LOST if self._missed >= self._most_missed else None
