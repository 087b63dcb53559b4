"""The image memory: one captured frame. How it leaves the unit is its dialect's business."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..firmware_model.image.frame import Frame
from .commands import NOBODY, Failure, Refusal, RefusedError, Running
from .imaging import FrameRecord, Imaging


@dataclass(frozen=True)
class CapturedImage:
    """A frame as it was read out. ``mid_exposure_tai_ns``: by the on-board time at its read-out."""

    frame_index: int
    pixels: Frame
    exposure_ns: int
    mid_exposure_ns: int
    mid_exposure_tai_ns: int


class ImageMemory:
    """Keeps one image.

    ``held`` is set by whoever sends the image in parts: a capture would change it under them.

    Args:
        imaging: is asked for the frame.
        tell: called with the image when it is there, before the capture completes.
    """

    def __init__(self, imaging: Imaging, tell: Callable[[CapturedImage], None]) -> None:
        self._imaging = imaging
        self._tell = tell
        self.image: CapturedImage | None = None
        self.held = False
        self._capture: Running | None = None

    def reset(self) -> None:
        """As after power-on: no image, nobody waits for one."""
        self.image = None
        self.held = False
        self._capture = None

    @property
    def busy(self) -> bool:
        """Whether the image is awaited or held."""
        return self._capture is not None or self.held

    def check_free(self) -> None:
        """Refuse with BUSY while the image is awaited or held."""
        if self.busy:
            raise RefusedError(Refusal.BUSY)

    def capture(self, running: Running = NOBODY) -> None:
        """Keep the next frame that the sensor delivers."""
        self._capture = running
        running.started()
        self._imaging.capture()

    def keep(self, record: FrameRecord, mid_exposure_tai_ns: int) -> None:
        """The wanted frame has been read out."""
        assert record.pixels is not None
        self.image = CapturedImage(
            record.index, record.pixels, record.exposure_ns, record.mid_exposure_ns, mid_exposure_tai_ns
        )
        self._tell(self.image)
        capture, self._capture = self._capture, None  # who is told may ask for the next
        if capture is not None:
            capture.completed()

    def abort_capture(self) -> None:
        """The wanted frame will not come."""
        capture, self._capture = self._capture, None
        if capture is not None:
            self._imaging.cancel_capture()
            capture.failed(Failure.ABORTED)
