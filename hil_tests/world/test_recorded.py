"""Recorded frames: every format written by another library, read back to the last bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from st_emulator.world import recorded
from st_emulator.world.recorded import RecordedFrameError, RecordedFrames
from st_emulator.world.windows import cut_windows

RNG = np.random.default_rng(12)
GREY8 = RNG.integers(0, 256, (30, 40), dtype=np.uint8)
GREY16 = RNG.integers(0, 65536, (30, 40), dtype=np.uint16)
COLOUR = RNG.integers(0, 256, (30, 40, 3), dtype=np.uint8)
ALPHA = RNG.integers(0, 256, (30, 40, 4), dtype=np.uint8)


def save(path: Path, pixels: NDArray[np.generic]) -> Path:
    if path.suffix in recorded.FITS_SUFFIXES:
        fits.PrimaryHDU(pixels).writeto(path)
    else:
        Image.fromarray(pixels).save(path)
    return path


@pytest.mark.parametrize(
    ("name", "pixels", "expected", "bits"),
    [
        ("grey.png", GREY8, GREY8, 8),
        ("grey16.png", GREY16, GREY16, 16),
        ("colour.png", COLOUR, COLOUR.sum(axis=2), 10),
        ("alpha.png", ALPHA, ALPHA[:, :, :3].sum(axis=2), 10),
        ("grey.tif", GREY8, GREY8, 8),
        ("grey16.tiff", GREY16, GREY16, 16),
        ("colour.tif", COLOUR, COLOUR.sum(axis=2), 10),
        ("alpha.tif", ALPHA, ALPHA[:, :, :3].sum(axis=2), 10),
        ("grey.fits", GREY8, GREY8, 8),
        ("grey16.fits", GREY16, GREY16, 16),
        ("signed.fit", (GREY16 // 2).astype(np.int16), GREY16 // 2, 16),
        ("long.fts", GREY16.astype(np.int32), GREY16, 16),
        ("float.fits", GREY16.astype(np.float32), GREY16, 16),
        ("float.tif", GREY16.astype(np.float32), GREY16, 16),
        ("cube.fits", GREY16[np.newaxis], GREY16, 16),
    ],
)
def test_pixels_come_through(
    tmp_path: Path, name: str, pixels: NDArray[np.generic], expected: NDArray[np.generic], bits: int
) -> None:
    frames = RecordedFrames(save(tmp_path / name, pixels), 40, 30)
    (frame,) = frames
    assert frame.full().dtype == np.uint16
    np.testing.assert_array_equal(frame.full(), expected)
    assert (frame.width_px, frame.height_px, frame.bits) == (40, 30, bits)
    assert frame.name == str(tmp_path / name)
    assert frame.full().max() < 2**frame.bits
    assert not frame.full().flags.writeable


def test_grey_with_alpha_and_palette(tmp_path: Path) -> None:
    grey_alpha = Image.merge("LA", (Image.fromarray(GREY8), Image.fromarray(GREY8[::-1].copy())))
    grey_alpha.save(tmp_path / "a.png")
    Image.fromarray(COLOUR).quantize(64).save(tmp_path / "b.png")
    first, second = RecordedFrames(tmp_path, 40, 30)
    np.testing.assert_array_equal(first.full(), GREY8)
    with Image.open(tmp_path / "b.png") as image:
        np.testing.assert_array_equal(second.full(), np.asarray(image.convert("RGB"), dtype=int).sum(axis=2))


def test_big_endian_tiff(tmp_path: Path) -> None:
    Image.fromarray(GREY16.astype(">u2")).save(tmp_path / "big.tif")
    np.testing.assert_array_equal(RecordedFrames(tmp_path, 40, 30)[0].full(), GREY16)


def test_rows_of_fits(tmp_path: Path) -> None:
    """As stored, or turned over when the header says that the first row is the bottom one."""
    for name, order in (("a", None), ("b", "TOP-DOWN"), ("c", "BOTTOM-UP")):
        unit = fits.PrimaryHDU(GREY16)
        if order:
            unit.header["ROWORDER"] = order
        unit.writeto(tmp_path / f"{name}.fits")
    plain, top, bottom = RecordedFrames(tmp_path, 40, 30)
    np.testing.assert_array_equal(plain.full(), GREY16)
    np.testing.assert_array_equal(top.full(), GREY16)
    np.testing.assert_array_equal(bottom.full(), GREY16[::-1])


def test_image_in_an_extension(tmp_path: Path) -> None:
    fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(GREY16)]).writeto(tmp_path / "ext.fits")
    fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(GREY16)]).writeto(tmp_path / "packed.fits")
    for frame in RecordedFrames(tmp_path, 40, 30):
        np.testing.assert_array_equal(frame.full(), GREY16)


def test_folder_in_order_of_numbers_without_other_files(tmp_path: Path) -> None:
    for number in (10, 2, 1):
        save(tmp_path / f"img{number}.PNG", np.full((30, 40), number, dtype=np.uint8))
    (tmp_path / "README.md").write_text("about these")
    (tmp_path / "more.png").mkdir()
    frames = RecordedFrames(tmp_path, 40, 30)
    assert [Path(name).name for name in frames.names] == ["img1.PNG", "img2.PNG", "img10.PNG"]
    assert [int(frame.full()[0, 0]) for frame in frames] == [1, 2, 10]
    assert len(frames) == 3
    assert int(frames[-1].full()[0, 0]) == 10
    again = RecordedFrames([tmp_path / "img10.PNG", tmp_path / "img1.PNG"], 40, 30)
    assert [int(frame.full()[0, 0]) for frame in again] == [1, 10]


def test_many_frames_are_checked_by_their_headers(tmp_path: Path) -> None:
    for number in range(70):
        save(tmp_path / f"{number}.png", np.full((30, 40), number, dtype=np.uint8))
    frames = RecordedFrames(tmp_path, 40, 30)
    assert [int(frames[i].full()[3, 3]) for i in (0, 69, 5)] == [0, 69, 5]
    save(tmp_path / "70.png", GREY8[:29])
    with pytest.raises(RecordedFrameError, match=r"70\.png: 40 x 29 px \(width x height\); expected 40 x 30"):
        RecordedFrames(tmp_path, 40, 30)


rectangles = st.tuples(st.integers(0, 40), st.integers(0, 30), st.integers(0, 40), st.integers(0, 30)).map(
    lambda r: (min(r[0], r[2]), min(r[1], r[3]), max(r[0], r[2]), max(r[1], r[3]))
)


@given(st.lists(rectangles, max_size=6))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_windows_are_crops(rects: list[tuple[int, int, int, int]]) -> None:
    flat, offsets = cut_windows(GREY16, np.array(rects, dtype=np.int32).reshape(-1, 4))
    assert flat.dtype == np.uint16
    assert len(offsets) == len(rects) + 1
    for i, (x0, y0, x1, y1) in enumerate(rects):
        np.testing.assert_array_equal(flat[offsets[i] : offsets[i + 1]], GREY16[y0:y1, x0:x1].ravel())


def test_a_window_outside_is_refused(tmp_path: Path) -> None:
    frame = RecordedFrames(save(tmp_path / "a.png", GREY8), 40, 30)[0]
    flat, _ = frame.windows([[1, 2, 4, 6]])
    np.testing.assert_array_equal(flat, GREY8[2:6, 1:4].ravel())
    with pytest.raises(ValueError, match="not inside the image of 40 x 30 px"):
        frame.windows([[0, 0, 41, 3]])


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.fits"])
def test_a_frame_of_the_wrong_size(tmp_path: Path, name: str) -> None:
    path = save(tmp_path / name, GREY8)
    with pytest.raises(RecordedFrameError) as error:
        RecordedFrames(path, 30, 40)
    assert str(error.value) == f"{path}: 40 x 30 px (width x height); expected 30 x 40 px"


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.fits"])
@pytest.mark.parametrize("damage", ["empty", "garbage", "cut", "head"])
def test_a_damaged_file_is_named(tmp_path: Path, name: str, damage: str) -> None:
    path = save(tmp_path / name, RNG.integers(0, 65536, (30, 40), dtype=np.uint16))
    intact = path.read_bytes()
    damaged = {"empty": b"", "garbage": b"\x07" * 5000, "cut": intact[:-1200], "head": intact[:30]}[damage]
    path.write_bytes(damaged)
    with pytest.raises(RecordedFrameError) as error:
        RecordedFrames(path, 40, 30)
    text = str(error.value)
    assert text.startswith(f"{path}: ")
    assert "expected" in text
    assert "\n" not in text


def test_what_cannot_be_kept_whole_is_refused(tmp_path: Path) -> None:
    cases: dict[str, NDArray[np.generic]] = {
        "negative.fits": np.full((30, 40), -1, dtype=np.int16),
        "large.fits": np.full((30, 40), 70000, dtype=np.int32),
        "nan.fits": np.full((30, 40), np.nan, dtype=np.float32),
        "flat.fits": np.zeros(1200, dtype=np.uint8),
    }
    expected = {
        "negative.fits": "pixels from -1 to -1; expected 0 to 65535",
        "large.fits": "pixels from 70000 to 70000; expected 0 to 65535",
        "nan.fits": "pixels that are no number",
        "flat.fits": "an image of 1 dimensions; expected 2",
    }
    for name, pixels in cases.items():
        save(tmp_path / name, pixels)
        with pytest.raises(RecordedFrameError, match=expected[name]):
            RecordedFrames(tmp_path / name, 40, 30)
    fits.HDUList([fits.PrimaryHDU()]).writeto(tmp_path / "none.fits")
    with pytest.raises(RecordedFrameError, match="no image in this FITS file"):
        RecordedFrames(tmp_path / "none.fits", 40, 30)
    Image.fromarray(GREY8).save(tmp_path / "pages.tif", save_all=True, append_images=[Image.fromarray(GREY8)])
    with pytest.raises(RecordedFrameError, match="2 images in one file; expected one"):
        RecordedFrames(tmp_path / "pages.tif", 40, 30)


def test_deep_colour_is_refused_rather_than_halved(tmp_path: Path) -> None:
    """A PNG of 16-bit RGB, put together by hand, as Pillow writes none."""
    import struct
    import zlib

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = b"".join(b"\0" + bytes(6 * 40) for _ in range(30))
    path = tmp_path / "deep.png"
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", 40, 30, 16, 2, 0, 0, 0))
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )
    with pytest.raises(RecordedFrameError, match="colour of 16 bits a channel"):
        RecordedFrames(path, 40, 30)


def test_nothing_to_read(tmp_path: Path) -> None:
    with pytest.raises(RecordedFrameError, match="a folder without frames"):
        RecordedFrames(tmp_path, 40, 30)
    with pytest.raises(RecordedFrameError, match="no such file"):
        RecordedFrames(tmp_path / "missing.png", 40, 30)
    with pytest.raises(RecordedFrameError, match="no recorded frame is given"):
        RecordedFrames([], 40, 30)
    (tmp_path / "a.jpg").write_bytes(b"x")
    with pytest.raises(RecordedFrameError, match=r"suffix \.jpg; expected \.png, \.tif"):
        RecordedFrames(tmp_path / "a.jpg", 40, 30)
