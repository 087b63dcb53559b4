"""What the firmware is told of a frame where no unit runs: campaigns, budget, calibration, pictures."""

from __future__ import annotations

from ..firmware_model.firmware import FrameContext
from ..firmware_model.modes import Mode
from ..world.scene import RenderedFrame


def synchronised_context(
    frame: RenderedFrame, index: int, acquisition: Mode, start_tai_ns: int
) -> FrameContext:
    """A rendered frame's, with an on-board time that is the sky's.

    ``start_tai_ns``: date of virtual time zero, TAI nanoseconds since 1958.
    """
    return FrameContext(
        frame_index=index,
        acquisition=acquisition,
        t_mid_ns=frame.exposure_mid_ns,
        exposure_ns=frame.exposure_ns,
        tai_ns=start_tai_ns + frame.exposure_mid_ns,
        row_time_s=frame.row_time_s,
    )


def undated_context(exposure_ns: int, row_time_s: float = 0.0) -> FrameContext:
    """A single picture's, lost in space, whose time nobody knows: no stellar aberration is corrected."""
    return FrameContext(
        frame_index=0,
        acquisition=Mode.LOST_IN_SPACE,
        t_mid_ns=exposure_ns // 2,
        exposure_ns=exposure_ns,
        tai_ns=None,
        row_time_s=row_time_s,
    )
