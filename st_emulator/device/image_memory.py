"""The captured image: one frame in memory, downloaded in parts (service 13)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..dialects.pus.reception import Request
from ..firmware_model.link_work import kept_image_work
from ..protocol.pus.enumerations import EventId, FailureCode
from ..protocol.pus.packets import CucTime, crc16_ccitt
from ..protocol.pus.services.large_data import IMAGE_HEADER_BYTES, encode_image_header
from .imaging import FrameRecord, microseconds

if TYPE_CHECKING:
    from .star_tracker import StarTracker

PROGRESS_STEPS = 10
QUEUE_AHEAD_BYTES = 1500  # a part is built when less than this waits, so attitude reports slip in between


class ImageStore:
    """Keeps one image and sends its parts as the line has room."""

    def __init__(self, unit: StarTracker) -> None:
        self._unit = unit
        self.data = b""
        self._capture: Request | None = None
        self._download: Request | None = None
        self._transaction_id = 0
        self._first_part = 0
        self._next_part = 0
        self._last_part = 0

    def reset(self) -> None:
        self.data = b""
        self._capture = self._download = None

    # -- capture
    # ---------------------------------------------------------------------------------------------------

    @property
    def busy(self) -> bool:
        """Whether a capture or a download runs: the one would change the image under the other."""
        return self._capture is not None or self._download is not None

    def capture(self, request: Request) -> None:
        """Keep the next frame; the request completes when it is read out."""
        self._capture = request
        request.started()
        self._unit.imaging.capture()

    def keep(self, record: FrameRecord, mid_exposure: CucTime) -> None:
        """The wanted frame has been read out."""
        pixels = record.pixels
        assert pixels is not None
        image = np.ascontiguousarray(pixels.full(), dtype=">u2").tobytes()
        header = encode_image_header(
            {
                "frame_index": record.index,
                "width": pixels.width_px,
                "height": pixels.height_px,
                "bits": pixels.bits,
                "reserved": 0,
                "time": mid_exposure,
                "exposure_us": microseconds(record.exposure_ns),
                "crc": crc16_ccitt(image),
            }
        )
        assert len(header) == IMAGE_HEADER_BYTES
        self.data = header + image
        self._unit.transmitter.work += kept_image_work(len(image) // 2)
        self._unit.raise_event(EventId.IMAGE_CAPTURED, frame_index=record.index, bytes=len(self.data))
        if self._capture is not None:
            self._capture.completed()
            self._capture = None

    def abort_capture(self) -> None:
        """The wanted frame will not come; its request fails with ABORTED."""
        if self._capture is not None:
            self._unit.imaging.cancel_capture()
            self._capture.failed(FailureCode.ABORTED)
            self._capture = None

    # -- download
    # --------------------------------------------------------------------------------------------------

    @property
    def parts(self) -> int:
        """Parts of the image kept, 0 without one."""
        return -(-len(self.data) // self._unit.port.part_bytes)

    def download(self, request: Request, transaction_id: int, first_part: int, parts: int) -> None:
        """Send ``parts`` parts from ``first_part`` (1 is the first); the request completes with the last."""
        self._download = request
        self._transaction_id = transaction_id
        self._first_part = self._next_part = first_part
        self._last_part = min(self.parts, first_part + parts - 1)
        request.started()
        self._send_parts()

    def abort(self) -> None:
        """Stop the download; its request fails with ABORTED."""
        if self._download is not None:
            last_sent = self._next_part - 1 if self._next_part > self._first_part else 0
            self._unit.raise_event(
                EventId.IMAGE_DOWNLOAD_ABORTED, transaction_id=self._transaction_id, part=last_sent
            )
            self._download.failed(FailureCode.ABORTED)
            self._download = None

    def _report_progress(self, number: int) -> None:
        """A progress report for each tenth of the parts asked for."""
        assert self._download is not None
        wanted = self._last_part - self._first_part + 1
        done = number - self._first_part + 1
        tenth = done * PROGRESS_STEPS // wanted
        if tenth > (done - 1) * PROGRESS_STEPS // wanted and tenth < PROGRESS_STEPS:
            self._download.progressed(tenth)

    def _send_parts(self) -> None:
        if self._download is None:
            return
        port = self._unit.port
        size = port.part_bytes
        while self._next_part <= self._last_part and port.queued_bytes < QUEUE_AHEAD_BYTES:
            number = self._next_part
            name = "image_part"
            if number == self.parts:
                name = "image_last_part"
            elif number == 1:
                name = "image_first_part"
            data = self.data[(number - 1) * size : number * size]
            self._download.answer(
                name, {"transaction_id": self._transaction_id, "part_number": number, "data": data}
            )
            self._next_part += 1
            self._report_progress(number)
        if self._next_part > self._last_part:
            self._download.completed()
            self._download = None
            return
        excess = port.queued_bytes - QUEUE_AHEAD_BYTES + 1
        self._unit.later(max(port.drain_ns(excess), 1), self._send_parts)
