"""Recorded frames: real pixels in place of the renderer's.

PNG, TIFF and FITS files become frames with the interface that the firmware knows. Grey pixels of 8 or 16 bits
are taken as they are. Colour (RGB, RGBA, palette) of 8 bits a channel becomes the sum of red, green and blue,
0 to 765 in 10 bits, so that no step of the recording is lost; an alpha channel is dropped. Row 0 is the top
row of a PNG or TIFF. ASSUMED: the rows of a FITS file are those of the detector, the first stored on top (so
does a detector write it, and so does astropy number it), unless its ROWORDER keyword says BOTTOM-UP.
"""

from __future__ import annotations

import functools
import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, UnidentifiedImageError

from .windows import cut_windows

U16 = NDArray[np.uint16]

IMAGE_SUFFIXES = (".png", ".tif", ".tiff")
FITS_SUFFIXES = (".fits", ".fit", ".fts")
SUFFIXES = IMAGE_SUFFIXES + FITS_SUFFIXES
_DECODED_AT_ONCE = 64
_KEPT = 4
_GREY_BITS = {"1": 8, "L": 8, "LA": 8, "I;16": 16, "I;16L": 16, "I;16B": 16, "I;16N": 16}
_COLOUR = ("RGB", "RGBA", "RGBX", "P", "PA")


# Pillow raises SyntaxError for broken PNG chunks, astropy TypeError and KeyError for some broken headers.
_DECODER_ERRORS = (
    OSError,
    SyntaxError,
    ValueError,
    TypeError,
    KeyError,
    EOFError,
    Image.DecompressionBombError,
)


class RecordedFrameError(ValueError):
    """A recorded frame cannot be used; the message names the file, what was found and what is expected."""


class RecordedFrame:
    """One recorded frame: width_px, height_px, bits, full(), windows(rects), and name, the file's."""

    def __init__(self, pixels: U16, bits: int, name: str) -> None:
        self._pixels = pixels
        self._pixels.setflags(write=False)
        self.height_px, self.width_px = pixels.shape
        self.bits = bits
        self.name = name

    def full(self) -> U16:
        """uint16[height, width], not to be written to."""
        return self._pixels

    def windows(self, rects: ArrayLike) -> tuple[U16, NDArray[np.int64]]:
        """As `scene.RenderedFrame.windows`."""
        return cut_windows(self._pixels, rects)


class RecordedFrames(Sequence[RecordedFrame]):
    """The frames of a folder or of a list of files, in the order of their names (numbers in them by value).

    Every file's type and size are checked at once, up to 64 files down to the last pixel; pixels are read
    again when asked for, and the last few kept. Other files in a folder are passed over.
    """

    def __init__(self, source: Path | str | Sequence[Path | str], width_px: int, height_px: int) -> None:
        """Raises RecordedFrameError for nothing to read or a frame that is not width_px x height_px."""
        self.width_px = int(width_px)
        self.height_px = int(height_px)
        self.paths = tuple(sorted(_files(source), key=_natural_order))
        self._read = functools.lru_cache(maxsize=_KEPT)(self._read_file)
        for path in self.paths:
            if len(self.paths) <= _DECODED_AT_ONCE:
                self._read_file(path)
            else:
                self._check_size(path)

    @property
    def names(self) -> tuple[str, ...]:
        """The files' paths as given, in their order."""
        return tuple(str(path) for path in self.paths)

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: int) -> RecordedFrame:  # type: ignore[override]  # no slices
        return self._read(self.paths[index])

    def __iter__(self) -> Iterator[RecordedFrame]:
        return (self._read(path) for path in self.paths)

    def _check_size(self, path: Path) -> None:
        if path.suffix.lower() in FITS_SUFFIXES:
            self._read_file(path)
            return
        try:
            with Image.open(path) as image:
                self._expect(path, image.size)
        except (OSError, SyntaxError, ValueError) as error:
            raise _unreadable(path, error) from error

    def _read_file(self, path: Path) -> RecordedFrame:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what matters becomes an error of ours
                is_fits = path.suffix.lower() in FITS_SUFFIXES
                pixels, bits = _read_fits(path) if is_fits else self._read_image(path)
        except RecordedFrameError:
            raise
        except _DECODER_ERRORS as error:
            raise _unreadable(path, error) from error
        self._expect(path, (pixels.shape[1], pixels.shape[0]))
        return RecordedFrame(pixels, bits, str(path))

    def _read_image(self, path: Path) -> tuple[U16, int]:
        with Image.open(path, formats=("PNG", "TIFF")) as image:
            self._expect(path, image.size)
            count = getattr(image, "n_frames", 1)
            if count != 1:
                raise RecordedFrameError(f"{path}: {count} images in one file; expected one")
            if image.format == "PNG" and _png_is_deep_colour(path):
                raise RecordedFrameError(
                    f"{path}: colour of 16 bits a channel; expected grey of 8 or 16 bits or colour of 8"
                )
            if image.mode in _GREY_BITS:
                grey = image.convert("L") if image.mode in ("1", "LA") else image
                return np.asarray(grey).astype(np.uint16), _GREY_BITS[image.mode]
            if image.mode in _COLOUR:
                return np.asarray(image.convert("RGB")).sum(axis=2, dtype=np.uint16), 10
            if image.mode in ("I", "F"):
                return _whole_numbers(path, np.asarray(image)), 16
            raise RecordedFrameError(
                f"{path}: pixels of the kind {image.mode}; expected grey of 8 or 16 bits or colour of 8"
            )

    def _expect(self, path: Path, size: tuple[int, int]) -> None:
        if size != (self.width_px, self.height_px):
            raise RecordedFrameError(
                f"{path}: {size[0]} x {size[1]} px (width x height); "
                f"expected {self.width_px} x {self.height_px} px"
            )


def _files(source: Path | str | Sequence[Path | str]) -> list[Path]:
    if isinstance(source, Path | str):
        path = Path(source)
        if not path.is_dir():
            return _files([path])
        try:
            found = [file for file in path.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file()]
        except OSError as error:
            raise _unreadable(path, error) from error
        if not found:
            raise RecordedFrameError(f"{path}: a folder without frames; expected files {_expected()}")
        return found
    paths = [Path(item) for item in source]
    if not paths:
        raise RecordedFrameError(f"no recorded frame is given; expected files {_expected()}")
    for path in paths:
        if not path.is_file():
            raise RecordedFrameError(f"{path}: no such file; expected {_expected()} or a folder of them")
        if path.suffix.lower() not in SUFFIXES:
            raise RecordedFrameError(f"{path}: suffix {path.suffix or 'missing'}; expected {_expected()}")
    return paths


def _expected() -> str:
    return ", ".join(SUFFIXES)


def _unreadable(path: Path, error: BaseException) -> RecordedFrameError:
    reason = "no image" if isinstance(error, UnidentifiedImageError) else str(error).splitlines()[0:1]
    text = reason if isinstance(reason, str) else (reason[0] if reason else type(error).__name__)
    return RecordedFrameError(f"{path}: cannot be read ({text}); expected an intact file {_expected()}")


def _natural_order(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    parts = re.split(r"(\d+)", path.name)
    return [(1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts], str(path)


def _png_is_deep_colour(path: Path) -> bool:
    """Pillow would drop the low byte of such a file without a word. IHDR: bit depth at byte 24, colour type
    at 25."""
    with path.open("rb") as file:
        header = file.read(26)
    return len(header) == 26 and header[24] == 16 and bool(header[25] & 2)


def _whole_numbers(path: Path, values: NDArray[np.generic]) -> U16:
    numbers = np.asarray(values, dtype=np.float64)
    if not np.all(np.isfinite(numbers)):
        raise RecordedFrameError(f"{path}: pixels that are no number; expected 0 to 65535")
    rounded = np.rint(numbers)
    low, high = float(rounded.min()), float(rounded.max())
    if low < 0.0 or high > 65535.0:
        raise RecordedFrameError(f"{path}: pixels from {low:g} to {high:g}; expected 0 to 65535")
    return rounded.astype(np.uint16)


def _read_fits(path: Path) -> tuple[U16, int]:
    from astropy.io import fits  # here, as it takes a second to import

    with fits.open(path, memmap=False) as units:
        for unit in units:
            if unit.is_image and unit.data is not None:
                data = np.squeeze(unit.data)
                if data.ndim != 2:
                    raise RecordedFrameError(f"{path}: an image of {data.ndim} dimensions; expected 2")
                bits = 8 if data.dtype == np.uint8 else 16
                pixels = _whole_numbers(path, data)
                bottom_up = str(unit.header.get("ROWORDER", "")).strip().upper() == "BOTTOM-UP"
                return np.ascontiguousarray(pixels[::-1] if bottom_up else pixels), bits
    raise RecordedFrameError(f"{path}: no image in this FITS file; expected one")
