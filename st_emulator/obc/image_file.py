"""Writing a downloaded image to a file, every bit of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".npy")


def write_image(file: Path, pixels: NDArray[np.uint16]) -> None:
    """Write uint16[height, width] as 16-bit greyscale PNG or TIFF, or as NumPy array, by the file's
    suffix.
    """
    if file.suffix.lower() == ".npy":
        np.save(file, pixels)
        return
    from PIL import Image  # only who writes pictures waits for it

    Image.fromarray(pixels).save(file)
