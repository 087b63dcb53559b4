"""ST[13] large packet transfer: the captured image, sent in parts as the wire has room."""

from __future__ import annotations

from functools import partial

import numpy as np

from ....device.commands import Failure
from ....device.image_memory import CapturedImage
from ....device.imaging import microseconds
from ....device.star_tracker import StarTracker
from ....firmware_model.link_work import kept_image_work
from ....protocol.pus.enumerations import EventId, FailureCode, FunctionId
from ....protocol.pus.packets import CucTime, crc16_ccitt
from ....protocol.pus.services.large_data import IMAGE_HEADER_BYTES, encode_image_header
from ....wire.port import UnitPort
from ..reception import RaiseEvent
from ..serving import Execute
from ..transmission import Transmitter
from ..verification import RejectedError, Request

PROGRESS_STEPS = 10
QUEUE_AHEAD_BYTES = 1500  # a part is built when less than this waits, so attitude reports slip in between


class LargeData:
    """The image as it travels, and its download. ``data``: header and pixels, empty without an image."""

    def __init__(
        self, device: StarTracker, port: UnitPort, transmitter: Transmitter, raise_event: RaiseEvent
    ) -> None:
        self._device = device
        self._port = port
        self._transmitter = transmitter
        self._raise_event = raise_event
        self.data = b""
        self._download: Request | None = None
        self._transaction_id = 0
        self._first_part = 0
        self._next_part = 0
        self._last_part = 0

    def reset(self) -> None:
        """As after power-on: no image, no download."""
        self.data = b""
        self._download = None

    def image_captured(self, image: CapturedImage) -> None:
        """Lay the image out as it will be sent."""
        pixels = np.ascontiguousarray(image.pixels.full(), dtype=">u2").tobytes()
        header = encode_image_header(
            {
                "frame_index": image.frame_index,
                "width": image.pixels.width_px,
                "height": image.pixels.height_px,
                "bits": image.pixels.bits,
                "reserved": 0,
                "time": CucTime.from_ns(image.mid_exposure_tai_ns),
                "exposure_us": microseconds(image.exposure_ns),
                "crc": crc16_ccitt(pixels),
            }
        )
        assert len(header) == IMAGE_HEADER_BYTES
        self.data = header + pixels
        self._transmitter.work += kept_image_work(len(pixels) // 2)
        self._raise_event(EventId.IMAGE_CAPTURED, frame_index=image.frame_index, bytes=len(self.data))

    @property
    def parts(self) -> int:
        """Parts of the image kept, 0 without one."""
        return -(-len(self.data) // self._port.part_bytes)

    # -- functions

    def download(self, request: Request) -> Execute:
        """Send some parts or all; completes with the last."""
        if self._device.image_memory.busy:
            raise RejectedError(FailureCode.BUSY)
        if not self.parts:
            raise RejectedError(FailureCode.NO_IMAGE)
        arguments = request.fields["arguments"]
        first = arguments["first_part"] or 1
        count = arguments["parts"] or self.parts - first + 1
        if first > self.parts or first + count - 1 > self.parts:
            raise RejectedError(FailureCode.OUT_OF_RANGE, int(FunctionId.DOWNLOAD_IMAGE))

        def execute() -> None:
            self._download = request
            self._device.image_memory.held = True
            self._transaction_id = arguments["transaction_id"]
            self._first_part = self._next_part = first
            self._last_part = first + count - 1
            request.started()
            self._send_parts(request)

        return execute

    def abort_download(self, request: Request) -> Execute:
        def execute() -> None:
            self.abort()
            request.completed()

        return execute

    def abort(self) -> None:
        """Stop the download; its request fails with ABORTED."""
        if self._download is not None:
            last_sent = self._next_part - 1 if self._next_part > self._first_part else 0
            self._raise_event(
                EventId.IMAGE_DOWNLOAD_ABORTED, transaction_id=self._transaction_id, part=last_sent
            )
            self._download.failed(Failure.ABORTED)
            self._over()

    def _over(self) -> None:
        self._download = None
        self._device.image_memory.held = False

    # -- parts

    def _report_progress(self, request: Request, number: int) -> None:
        """A progress report for each tenth of the parts asked for."""
        wanted = self._last_part - self._first_part + 1
        done = number - self._first_part + 1
        tenth = done * PROGRESS_STEPS // wanted
        if tenth > (done - 1) * PROGRESS_STEPS // wanted and tenth < PROGRESS_STEPS:
            request.progressed(tenth)

    def _send_parts(self, request: Request) -> None:
        if request is not self._download:
            return  # it was aborted
        port = self._port
        size = port.part_bytes
        while self._next_part <= self._last_part and port.queued_bytes < QUEUE_AHEAD_BYTES:
            number = self._next_part
            name = "image_part"
            if number == self.parts:
                name = "image_last_part"
            elif number == 1:
                name = "image_first_part"
            data = self.data[(number - 1) * size : number * size]
            request.answer(
                name, {"transaction_id": self._transaction_id, "part_number": number, "data": data}
            )
            self._next_part += 1
            self._report_progress(request, number)
        if self._next_part > self._last_part:
            request.completed()
            self._over()
            return
        excess = port.queued_bytes - QUEUE_AHEAD_BYTES + 1
        self._device.later(max(port.drain_ns(excess), 1), partial(self._send_parts, request))
