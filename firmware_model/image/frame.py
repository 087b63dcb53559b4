"""What the firmware asks of an image: the sensor's read-out as the processing unit sees it."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["Frame", "rectangles"]


class Frame(Protocol):
    """One image, in full or by windows; both give the same numbers for the same pixels.

    Pixel coordinates: x = column, y = row, an integer is the centre of a pixel.
    """

    @property
    def width_px(self) -> int:
        """Columns."""

    @property
    def height_px(self) -> int:
        """Rows."""

    @property
    def bits(self) -> int:
        """Bits of the converter; the largest value of a pixel is ``2**bits - 1`` DN."""

    def full(self) -> NDArray[np.uint16]:
        """The whole image, ``uint16[rows, columns]``, DN."""

    def windows(self, rects: NDArray[np.int32]) -> tuple[NDArray[np.uint16], NDArray[np.int64]]:
        """The pixels inside ``rects``, DN.

        ``rects``: ``int32[n, 4]``, rows ``x0, y0, x1, y1``, half-open, inside the image, not empty.
        Returns ``(flat, offsets)``: window i is ``flat[offsets[i]:offsets[i + 1]]``, row-major, of
        ``y1 - y0`` rows and ``x1 - x0`` columns; ``flat`` is ``uint16[total]``, ``offsets`` ``int64[n + 1]``.
        """


def rectangles(
    x_px: NDArray[np.float64],
    y_px: NDArray[np.float64],
    half_width_px: float,
    width_px: int,
    height_px: int,
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Square windows about points, clipped at the edge of the image.

    ``x_px, y_px``: ``float64[n]`` centres. A window covers the pixels whose centres lie within
    ``half_width_px`` (rounded up) of the pixel nearest to the point.
    Returns ``(rects int32[n, 4], whole bool[n])``; ``whole`` is False where the edge has clipped the
    window. A window wholly outside comes out empty (``x1 <= x0`` or ``y1 <= y0``): drop it before use.
    """
    half = int(np.ceil(half_width_px))
    column = np.rint(np.asarray(x_px, np.float64)).astype(np.int32)
    row = np.rint(np.asarray(y_px, np.float64)).astype(np.int32)
    wanted = np.stack([column - half, row - half, column + half + 1, row + half + 1], axis=-1).reshape(-1, 4)
    rects = wanted.copy()
    np.maximum(rects[:, :2], 0, out=rects[:, :2])
    np.minimum(rects[:, 2], width_px, out=rects[:, 2])
    np.minimum(rects[:, 3], height_px, out=rects[:, 3])
    return rects, np.asarray((rects == wanted).all(axis=1))
