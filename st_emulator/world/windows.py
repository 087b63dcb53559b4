"""Rectangles of an image: int32[n, 4], each x0, y0, x1, y1, half-open, in pixels."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

U16 = NDArray[np.uint16]


def checked_windows(rects: ArrayLike, width_px: int, height_px: int) -> NDArray[np.int32]:
    """The rectangles as contiguous int32[n, 4]. Raises ValueError for one that is not inside the image."""
    checked = np.ascontiguousarray(np.asarray(rects, dtype=np.int32).reshape(-1, 4))
    x0, y0, x1, y1 = checked.T
    wrong = (x0 < 0) | (y0 < 0) | (x1 > width_px) | (y1 > height_px) | (x0 > x1) | (y0 > y1)
    if wrong.any():
        raise ValueError(
            f"window {checked[int(np.argmax(wrong))].tolist()} (x0, y0, x1, y1) is not inside the image of "
            f"{width_px} x {height_px} px"
        )
    return checked


def window_offsets(rects: NDArray[np.int32]) -> NDArray[np.int64]:
    """int64[n + 1]: where each rectangle's pixels begin when all lie one after another, and their total."""
    sizes = (rects[:, 2] - rects[:, 0]).astype(np.int64) * (rects[:, 3] - rects[:, 1])
    return np.concatenate((np.zeros(1, np.int64), np.cumsum(sizes)))


def cut_windows(image: U16, rects: ArrayLike) -> tuple[U16, NDArray[np.int64]]:
    """(flat uint16[total], offsets int64[n + 1]) of rectangles of an image uint16[height, width]."""
    checked = checked_windows(rects, image.shape[1], image.shape[0])
    offsets = window_offsets(checked)
    flat = np.empty(int(offsets[-1]), dtype=np.uint16)
    for (x0, y0, x1, y1), at, end in zip(checked, offsets[:-1], offsets[1:], strict=True):
        flat[at:end] = image[y0:y1, x0:x1].ravel()
    return flat, offsets


@numba.njit(nogil=True)
def put_windows(
    image: NDArray[np.uint16],
    rects: NDArray[np.int32],
    flat: NDArray[np.uint16],
    offsets: NDArray[np.int64],
) -> None:
    """The pixels of windows (``cut_windows``) at their places in an image, which is changed."""
    for number in range(len(rects)):
        place = offsets[number]
        for y in range(rects[number, 1], rects[number, 3]):
            for x in range(rects[number, 0], rects[number, 2]):
                image[y, x] = flat[place]
                place += 1
