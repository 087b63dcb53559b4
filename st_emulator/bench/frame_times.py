"""When the frames that a unit has processed were exposed."""

from __future__ import annotations

from collections import OrderedDict

from ..device.imaging import FrameRecord
from ..errors import ConfigurationError

KEPT_FRAMES = 4096  # the truth of seventeen minutes at 4 Hz can be asked for


class FrameTimes:
    """The middles of the exposures of the last ``KEPT_FRAMES`` frames."""

    def __init__(self) -> None:
        self._middle_ns: OrderedDict[int, int] = OrderedDict()

    def completed(self, record: FrameRecord) -> None:
        """A frame's result counts from now on."""
        self._middle_ns[record.index] = record.mid_exposure_ns
        self._middle_ns.move_to_end(record.index)
        if len(self._middle_ns) > KEPT_FRAMES:
            self._middle_ns.popitem(last=False)

    def middle_ns(self, frame_index: int) -> int:
        """Virtual time of the middle of the exposure.

        Raises:
            ConfigurationError: the unit has not processed such a frame, or that is long ago.
        """
        if frame_index not in self._middle_ns:
            last = next(reversed(self._middle_ns), None)
            there = "it has processed none" if last is None else f"the last was {last}"
            raise ConfigurationError(f"frame {frame_index}: is none that the unit has processed; {there}")
        return self._middle_ns[frame_index]
