"""Faults of the sensor: frames that do not come or are two in one, and the list of all its kinds."""

from __future__ import annotations

from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from ..firmware_model.image.frame import Frame
from ..world.windows import window_offsets
from .fault import Exposure, FaultKind, FaultSettings, Reach
from .sensor_frame import I32, I64, STREAM_PLACES, U16, SensorFault, SpoiltFrame
from .sensor_light import LIGHT_KINDS
from .sensor_particles import PARTICLE_KINDS
from .sensor_pixels import PIXEL_KINDS


class NoFramesSettings(FaultSettings):
    kind: Literal["sensor.no_frames"]


class NoFrames(SensorFault[NoFramesSettings]):
    def spoil(self, frame: Frame, exposure: Exposure) -> None:
        return None


class TornFrameSettings(FaultSettings):
    kind: Literal["sensor.torn_frame"]
    row: Annotated[
        int | None, Field(ge=1, le=8191, description="the first one of the frame before; none: by chance")
    ] = None


class _TornFrame(SpoiltFrame):
    """Rows below ``row`` of one frame, from there on those of another."""

    def __init__(self, frame: Frame, before: Frame, row: int) -> None:
        super().__init__(frame)
        self._before = before
        self._row = row

    def _pixels(self, rects: I32) -> tuple[U16, I64]:
        offsets = window_offsets(rects)
        flat = np.empty(int(offsets[-1]), np.uint16)
        upper, lower = rects.copy(), rects.copy()
        upper[:, 3] = np.minimum(rects[:, 3], self._row)
        lower[:, 1] = np.maximum(rects[:, 1], self._row)
        widths = (rects[:, 2] - rects[:, 0]).astype(np.int64)
        # row by row, a window's lower part follows its upper one
        firsts = offsets[:-1] + widths * (lower[:, 1] - rects[:, 1])
        for frame, parts, at in ((self._frame, upper, offsets[:-1]), (self._before, lower, firsts)):
            there = np.flatnonzero((parts[:, 3] > parts[:, 1]) & (widths > 0))
            if len(there):
                pixels, ends = frame.windows(parts[there])
                for k, begin, end in zip(there, ends[:-1], ends[1:], strict=True):
                    flat[at[k] : at[k] + end - begin] = pixels[begin:end]
        return flat, offsets

    def spoil(self, flat: U16, rects: I32, offsets: I64) -> None:
        raise AssertionError("it is made of two frames")


class TornFrame(SensorFault[TornFrameSettings]):
    """The frame before is the last that was exposed while the fault lasts; the first frame is whole."""

    _before: Frame | None = None

    def __init__(self, settings: TornFrameSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        if settings.row is not None and settings.row >= self.height_px:
            raise ValueError(
                f"row = {settings.row}: the unit has {self.height_px}; allowed are 1 to {self.height_px - 1}"
            )

    def row(self, exposure: Exposure) -> int:
        """The first row of the frame before."""
        if self.settings.row is not None:
            return self.settings.row
        chance = self.uniforms(STREAM_PLACES, exposure.index, 1)[0]
        return 1 + min(int(chance * (self.height_px - 1)), self.height_px - 2)

    def expose(self, frame: Frame, exposure: Exposure) -> Frame | None:
        before, self._before = self._before, frame
        if before is None or not self.strikes_frame(exposure):
            return frame
        return _TornFrame(frame, before, self.row(exposure))

    def end(self) -> None:
        self._before = None


KINDS: Final = (
    FaultKind(
        NoFramesSettings,
        NoFrames,
        what="The sensor delivers no frame.",
        obc_sees="FRAME_DROPPED with NO_FRAME_FROM_SENSOR and an attitude report with FRAME_DROPPED and "
        "NO_FRAME for each missing frame; after two seconds of them FAULT_ENTERED with SENSOR_LOST and mode "
        "FAULT.",
        afterwards="Shorter than two seconds: the next frame is tracked. From FAULT only a reset or a "
        "self-test leads out.",
    ),
    FaultKind(
        TornFrameSettings,
        TornFrame,
        what="A frame's lower part is that of the frame before: the buffers were changed while it was read "
        "out. From the second frame on.",
        obc_sees="Nothing while the unit does not turn. When it turns, stars of the lower part stand where "
        "they were a frame ago: fewer stars_identified, PIVOT_LOST or RESIDUAL_TOO_LARGE. An attitude from "
        "stars of the lower part alone is consistent in itself and valid, but is off by what the unit "
        "turned in a frame period: compare with the rate.",
        afterwards="The next frame is as before.",
    ),
    *LIGHT_KINDS,
    *PARTICLE_KINDS,
    *PIXEL_KINDS,
)
