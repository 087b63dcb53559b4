"""Reassembly of a downloaded image (service 13) from its parts, in any order and however often they come.

Source: ECSS-E-ST-70-41C clause 6.13 (large packet transfer, downlink). After the image header come the
pixels, big-endian u16, row by row.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..protocol.errors import RemoteProtocolError
from ..protocol.pus.packets import CucTime, Telemetry, crc16_ccitt
from ..protocol.pus.services.large_data import IMAGE_HEADER_BYTES, decode_image_header
from .errors import DownloadError

PART_NAMES = ("image_first_part", "image_part", "image_last_part")
_BYTES_PER_PIXEL = 2


@dataclass(frozen=True)
class Image:
    """A downloaded frame: `pixels` uint16[height, width] DN; `time` is mid-exposure."""

    pixels: NDArray[np.uint16]
    frame_index: int
    bits: int
    time: CucTime
    exposure_us: int


class ImageAssembler:
    """Collects the parts of one transaction."""

    def __init__(self, transaction_id: int) -> None:
        self.transaction_id = transaction_id
        self._parts: dict[int, bytes] = {}
        self._last: int | None = None

    @property
    def received_parts(self) -> int:
        """Number of different parts that are here."""
        return len(self._parts)

    @property
    def received_bytes(self) -> int:
        """Bytes of the parts that are here."""
        return sum(len(part) for part in self._parts.values())

    @property
    def expected_bytes(self) -> int | None:
        """Size of the whole image with its header; None before the first part is here."""
        if 1 not in self._parts:
            return None
        try:
            header = decode_image_header(self._parts[1])
        except RemoteProtocolError:
            return None
        return IMAGE_HEADER_BYTES + _BYTES_PER_PIXEL * int(header["width"]) * int(header["height"])

    def take(self, telemetry: Telemetry) -> bool:
        """Take a part; False when `telemetry` is none of this transaction."""
        if telemetry.name not in PART_NAMES or telemetry.fields["transaction_id"] != self.transaction_id:
            return False
        number = int(telemetry.fields["part_number"])
        self._parts[number] = telemetry.fields["data"]
        if telemetry.name == "image_last_part":
            self._last = number
        return True

    @property
    def complete(self) -> bool:
        """Whether every part up to the last is here."""
        return not self.missing_ranges()

    def missing_ranges(self) -> list[tuple[int, int]]:
        """What to ask for again: (number of the first part, how many; 0: that one and all after it).

        An image that fits into one part has no part marked as last; its size tells that it is whole.
        """
        last = self._last
        if last is None and set(self._parts) == {1} and self.received_bytes == self.expected_bytes:
            last = 1
        highest = last if last is not None else max(self._parts, default=0)
        ranges: list[tuple[int, int]] = []
        for number in range(1, highest + 1):
            if number in self._parts:
                continue
            if ranges and ranges[-1][0] + ranges[-1][1] == number:
                ranges[-1] = (ranges[-1][0], ranges[-1][1] + 1)
            else:
                ranges.append((number, 1))
        if last is None:
            ranges.append((highest + 1, 0))
        return ranges

    def image(self) -> Image:
        """The image. DownloadError when parts are missing, or size or checksum do not match the header."""
        if not self.complete:
            missing = ", ".join(_range_text(*entry) for entry in self.missing_ranges())
            raise DownloadError(f"image, transaction {self.transaction_id}: parts missing: {missing}")
        data = b"".join(self._parts[number] for number in sorted(self._parts))
        try:
            header = decode_image_header(data)
        except RemoteProtocolError as error:
            raise DownloadError(f"image, transaction {self.transaction_id}: {error}") from None
        pixels = data[IMAGE_HEADER_BYTES:]
        height, width = int(header["height"]), int(header["width"])
        if len(pixels) != _BYTES_PER_PIXEL * width * height:
            raise DownloadError(
                f"image, transaction {self.transaction_id}: {len(pixels)} bytes of pixels, "
                f"{width} x {height} need {_BYTES_PER_PIXEL * width * height}"
            )
        if (computed := crc16_ccitt(pixels)) != header["crc"]:
            raise DownloadError(
                f"image, transaction {self.transaction_id}: checksum 0x{computed:04X} of the pixels, "
                f"the header says 0x{header['crc']:04X}"
            )
        return Image(
            pixels=np.frombuffer(pixels, dtype=">u2").reshape(height, width).astype(np.uint16),
            frame_index=int(header["frame_index"]),
            bits=int(header["bits"]),
            time=header["time"],
            exposure_us=int(header["exposure_us"]),
        )


def _range_text(first: int, count: int) -> str:
    if count == 0:
        return f"{first} and after"
    return f"{first}" if count == 1 else f"{first}..{first + count - 1}"
