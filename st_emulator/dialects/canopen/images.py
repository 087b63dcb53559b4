"""Captured images as octets: raw, and a picture to look at."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray

from ...firmware_model.image.frame import Frame
from ...protocol.canopen.card import DISPLAY_COLUMNS, DISPLAY_ROWS

BITS = 8


def load_encoder() -> None:
    """Load what :func:`display_image` needs: at the first picture it would hold the whole unit up.

    Not with this module, for it is imported with every dialect's table.
    """
    from PIL import Image

    Image.preinit()


def upper_bits(frame: Frame) -> NDArray[np.uint8]:
    """The upper 8 bits of each pixel, ``uint8[rows, columns]``. ASSUMED: the card's camera has 8 bits."""
    return (frame.full() >> (frame.bits - BITS)).astype(np.uint8)


def raw_image(frame: Frame) -> bytes:
    """Rows from the top, each from the left, 16 bits a pixel, little-endian.

    ASSUMED: no layout is documented.
    """
    return frame.full().astype("<u2").tobytes()


def display_image(frame: Frame) -> bytes:
    """A PNG, 8 bits grey, at most 640 x 480 px: the upper 8 bits, reduced with the same aspect ratio.

    ASSUMED: reduced by averaging, as no method is documented.
    """
    from PIL import Image

    image = Image.fromarray(upper_bits(frame))
    factor = min(DISPLAY_COLUMNS / image.width, DISPLAY_ROWS / image.height, 1.0)
    if factor < 1.0:
        size = (max(1, int(image.width * factor)), max(1, int(image.height * factor)))
        image = image.resize(size, Image.Resampling.BOX)
    octets = io.BytesIO()
    image.save(octets, "PNG")
    return octets.getvalue()


def passes(
    frame: Frame, lower_bound: int, lower_percentage: int, upper_bound: int, upper_percentage: int
) -> bool:
    """The capture filter: enough pixels above the lower bound and enough below the upper; a bound of 0 is
    not looked at."""
    if not lower_bound and not upper_bound:
        return True
    pixels = upper_bits(frame)
    if lower_bound and np.mean(pixels > lower_bound) * 100 < lower_percentage:
        return False
    return not upper_bound or bool(np.mean(pixels < upper_bound) * 100 >= upper_percentage)
