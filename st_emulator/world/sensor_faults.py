"""What faults of optics and detector do to numbers that the detector put out.

A number stands for a charge; its place within the step of the converter is lost, and is drawn anew where it
matters, so that a mean changes by just what is added. All is a function of the key and the pixel, whichever
rectangle is asked for, as in :mod:`noise`.

Every kernel works on windows: rects int32[n, 4] (x0, y0, x1, y1, half-open) whose pixels lie row by row in
flat[offsets[i] : offsets[i + 1]].
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .lit_scene import Scene
from .noise import POISSON_EXACT_BELOW, charge_of, normals_of, words_of
from .point_spread import PHI_TABLE, SUPPORT_SIGMA, add_background, add_stars, stars_near

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
U16 = NDArray[np.uint16]
U64 = NDArray[np.uint64]

_S8 = np.uint64(8)
_LOW_32 = np.uint64(0xFFFFFFFF)
_STRIP_PIXELS = 8192
_BLUR_REACH_SIGMA = 4.0


@lru_cache(maxsize=4)
def _constant(value: float, width_px: int, height_px: int) -> F32:
    return np.full((height_px, width_px), value, dtype=np.float32)


def light(
    width_px: int,
    height_px: int,
    sigma_px: float,
    *,
    xs: F64 | None = None,
    ys: F64 | None = None,
    electrons: F64 | None = None,
    glow_columns: F64 | None = None,
    glow_rows: F64 | None = None,
    dark_electrons_s: F32 | None = None,
    exposure_s: float = 0.0,
) -> Scene:
    """Light and charge that come on top of a frame, as the renderer's scene.

    xs, ys float64[n, steps]: the paths of n spots of so many ``electrons`` each and the width sigma_px;
    glow_columns float64[g, width], glow_rows float64[g, height]: layers of electrons, each the product of its
    column and row factors; dark_electrons_s float32[height, width]: each pixel's own, in exposure_s.
    ASSUMED: the response is that of a perfect pixel; all rows see the paths at the same time, also those of a
    rolling shutter.
    """
    none = np.empty((0, 1))
    xs, ys = (none, none) if xs is None or ys is None else (xs, ys)
    reach = SUPPORT_SIGMA * sigma_px
    box = np.empty((len(xs), 4), np.int32)
    if len(xs):
        far = 1e6  # no pixel is there
        box[:, 0] = np.floor(np.clip(xs.min(axis=1) - reach + 0.5, -far, far))
        box[:, 1] = np.floor(np.clip(ys.min(axis=1) - reach + 0.5, -far, far))
        box[:, 2] = np.floor(np.clip(xs.max(axis=1) + reach + 0.5, -far, far)) + 1
        box[:, 3] = np.floor(np.clip(ys.max(axis=1) + reach + 0.5, -far, far)) + 1
    columns = np.empty((0, width_px)) if glow_columns is None else glow_columns
    rows = np.empty((0, height_px)) if glow_rows is None else glow_rows
    zero = _constant(0.0, width_px, height_px)
    return Scene(
        xs=np.ascontiguousarray(xs),
        ys=np.ascontiguousarray(ys),
        light=np.zeros(0) if electrons is None else np.ascontiguousarray(electrons, dtype=np.float64),
        box=box,
        sigma_px=float(sigma_px),
        phi_table=PHI_TABLE,
        stray=0.0,
        glow_columns=columns.astype(np.float32),
        glow_rows=rows.astype(np.float32),
        response=_constant(1.0, width_px, height_px),
        dark=zero if dark_electrons_s is None else dark_electrons_s,
        exposure_s=float(exposure_s),
        row_starts=np.empty(0),
        row_span=0.0,
        lit=np.empty((0, 2), np.int32),
        share_table=np.empty((0, 0), np.float32),
    )


@njit(nogil=True, error_model="numpy")
def _rise(
    mean: F32, words: U64, deviates: F32, table: F32, inverse_gain: float, full_dn: float, numbers: U16
) -> None:
    """Numbers of a run of pixels rise by a charge of these means and by its shot noise.

    The charge is a Poisson number, above ``POISSON_EXACT_BELOW`` by its Cornish-Fisher expansion. The place
    of a number within its step is the word's lower half.
    """
    gain, full, one = np.float32(inverse_gain), np.int32(full_dn), np.float32(1.0)
    most = np.float32(65536.0)
    zero, sixth, small = np.float32(0.0), np.float32(1.0 / 6.0), np.float32(1.0 / 72.0)
    exact = POISSON_EXACT_BELOW
    slow = np.int64(0)
    for i in range(mean.shape[0]):
        m = max(mean[i], exact)
        z = deviates[i]
        z2 = z * z
        root = np.float32(math.sqrt(m))
        charge = m + root * z + (z2 - one) * sixth + z * (one - z2) * small / root
        before = np.int32(numbers[i])
        place = np.float32(np.int32((words[i] & _LOW_32) >> _S8)) * np.float32(2.0**-24)
        number = before + np.int32(min(place + charge * gain, most))
        few = mean[i] < exact
        slow += np.int64(few)
        numbers[i] = numbers[i] if few else np.uint16(min(number, max(before, full)))
    if slow == 0:
        return
    for i in range(mean.shape[0]):
        if zero < mean[i] < exact:
            charge = np.float32(charge_of(float(mean[i]), words[i], table))
            before = np.int32(numbers[i])
            place = np.float32(np.int32((words[i] & _LOW_32) >> _S8)) * np.float32(2.0**-24)
            number = before + np.int32(min(place + charge * gain, most))
            numbers[i] = np.uint16(min(number, max(before, full)))


@njit(nogil=True, error_model="numpy")
def add_light(
    rects: I32,
    offsets: I64,
    flat: U16,
    scene: Scene,
    key: np.uint64,
    normal_table: F32,
    inverse_gain: float,
    full_dn: float,
) -> None:
    """Adds the scene's charge with its shot noise. No number rises over full_dn (converter, full well)."""
    image_width = scene.response.shape[1]
    widest = 1
    highest = 1
    for i in range(rects.shape[0]):
        widest = max(widest, rects[i, 2] - rects[i, 0])
        highest = max(highest, rects[i, 3] - rects[i, 1])
    room = np.empty(max(_STRIP_PIXELS, widest), np.float32)
    words = np.empty(widest, np.uint64)
    deviates = np.empty(widest, np.float32)
    share_x, share_y = np.empty(widest), np.empty(highest)
    for i in range(rects.shape[0]):
        x0, y0, x1, y1 = rects[i, 0], rects[i, 1], rects[i, 2], rects[i, 3]
        w = x1 - x0
        if w <= 0:
            continue
        at = offsets[i]
        near = stars_near(rects[i], scene.box)
        strip_rows = max(_STRIP_PIXELS // w, 1)
        for top in range(y0, y1, strip_rows):
            h = min(strip_rows, y1 - top)
            mean = room[: h * w].reshape((h, w))
            mean[:] = np.float32(0.0)
            add_stars(x0, top, scene, near, share_x, share_y, mean)
            add_background(x0, top, scene, mean)
            for r in range(h):
                first, end = 0, w
                while first < end and not mean[r, first] > np.float32(0.0):
                    first += 1
                while end > first and not mean[r, end - 1] > np.float32(0.0):
                    end -= 1
                if first < end:
                    lit = end - first
                    words_of(key, (top + r) * image_width + x0 + first, words[:lit])
                    if (mean[r, first:end] >= POISSON_EXACT_BELOW).any():
                        normals_of(words[:lit], normal_table, deviates[:lit])
                    numbers = flat[at + first : at + end]
                    _rise(
                        mean[r, first:end], words[:lit], deviates[:lit], normal_table, inverse_gain, full_dn,
                        numbers,
                    )  # fmt: skip
                at += w


@njit(nogil=True, error_model="numpy")
def transmit(
    rects: I32,
    offsets: I64,
    flat: U16,
    transmission: F32,
    key: np.uint64,
    normal_table: F32,
    electrons_per_dn: float,
    offset_dn: float,
    read_noise_electrons: float,
    full_dn: float,
) -> None:
    """Lets only a part of the charge be there: transmission float32[height, width], 0 to 1.

    The noise is that of less light: what was drawn is made smaller, and the rest of a Poisson number's and
    the read-out's variance is drawn anew.
    """
    image_width = transmission.shape[1]
    widest = 1
    for i in range(rects.shape[0]):
        widest = max(widest, rects[i, 2] - rects[i, 0])
    words = np.empty(widest, np.uint64)
    deviates = np.empty(widest, np.float32)
    inverse_gain = np.float32(1.0 / electrons_per_dn)
    read_variance = np.float32((read_noise_electrons / electrons_per_dn) ** 2)
    offset, full, half = np.float32(offset_dn), np.float32(full_dn), np.float32(0.5)
    one, zero = np.float32(1.0), np.float32(0.0)
    for i in range(rects.shape[0]):
        x0, w = rects[i, 0], rects[i, 2] - rects[i, 0]
        at = offsets[i]
        for y in range(rects[i, 1], rects[i, 3]):
            shares = transmission[y, x0 : x0 + w]
            first, end = 0, w
            while first < end and shares[first] >= one:
                first += 1
            while end > first and shares[end - 1] >= one:
                end -= 1
            if first < end:
                dim = end - first
                words_of(key, y * image_width + x0 + first, words[:dim])
                normals_of(words[:dim], normal_table, deviates[:dim])
                for j in range(dim):
                    share = shares[first + j]
                    before = np.float32(flat[at + first + j])
                    signal = before - offset
                    variance = share * (one - share) * max(signal, zero) * inverse_gain
                    variance += (one - share * share) * read_variance
                    left = share * signal + np.float32(math.sqrt(variance)) * deviates[j] + (offset + half)
                    left = before if share >= one else min(max(left, zero), full)
                    flat[at + first + j] = np.uint16(np.int32(left))
            at += w


@njit(nogil=True, error_model="numpy")
def amplify(
    rects: I32, offsets: I64, flat: U16, image_width: int, key: np.uint64, gain: float, offset_dn: float,
    full_dn: float,
) -> None:  # fmt: skip
    """Makes all above the black level ``gain`` times as much, noise too; full_dn: of the converter."""
    widest = 1
    for i in range(rects.shape[0]):
        widest = max(widest, rects[i, 2] - rects[i, 0])
    words = np.empty(widest, np.uint64)
    factor, full, most = np.float32(gain), np.float32(full_dn), np.float32(65536.0)
    offset, half, zero, one = np.float32(offset_dn), np.float32(0.5), np.float32(0.0), np.float32(1.0)
    for i in range(rects.shape[0]):
        w = rects[i, 2] - rects[i, 0]
        at = offsets[i]
        for y in range(rects[i, 1], rects[i, 3]):
            words_of(key, y * image_width + rects[i, 0], words[:w])
            numbers = flat[at : at + w]
            for j in range(w):
                place = np.float32(np.int32((words[j] & _LOW_32) >> _S8)) * np.float32(2.0**-24) - half
                before = np.float32(numbers[j])
                more = (before - offset) * (factor - one) + (place * factor + half)
                number = before + np.floor(min(max(more, -most), most))
                numbers[j] = np.uint16(np.int32(min(max(number, zero), full)))
            at += w


def blur_taps(sigma_px: float) -> F32:
    """float32[reach + 1]: a Gaussian's middle and one of its sides, the whole with the sum 1."""
    reach = math.ceil(_BLUR_REACH_SIGMA * sigma_px)
    side = np.exp(-0.5 * (np.arange(reach + 1) / sigma_px) ** 2)
    return np.asarray(side / (2.0 * side.sum() - side[0]), dtype=np.float32)


def grown(rects: I32, by_px: int, width_px: int, height_px: int) -> I32:
    """The rectangles with so many pixels more on each side, as far as there are."""
    wide = rects.copy()
    wide[:, :2] = np.maximum(rects[:, :2] - by_px, 0)
    wide[:, 2] = np.minimum(rects[:, 2] + by_px, width_px)
    wide[:, 3] = np.minimum(rects[:, 3] + by_px, height_px)
    return wide


@njit(nogil=True, error_model="numpy")
def blur(
    wide_rects: I32,
    wide_offsets: I64,
    wide: U16,
    rects: I32,
    offsets: I64,
    flat: U16,
    taps: F32,
    image_width: int,
    key: np.uint64,
    normal_table: F32,
    electrons_per_dn: float,
    offset_dn: float,
    read_noise_electrons: float,
    full_dn: float,
) -> None:
    """The windows ``rects`` of an image that is blurred, from its windows ``wide_rects`` (see ``grown``).

    What the blur takes away of the noise is drawn anew. Beyond the edge the image goes on as at the edge.
    """
    reach = taps.shape[0] - 1
    kept = np.float32(0.0)
    for k in range(-reach, reach + 1):
        kept += taps[abs(k)] * taps[abs(k)]
    lost = np.float32(1.0) - kept * kept
    inverse_gain = np.float32(1.0 / electrons_per_dn)
    read_variance = np.float32((read_noise_electrons / electrons_per_dn) ** 2)
    offset, full = np.float32(offset_dn), np.float32(full_dn)
    half, zero = np.float32(0.5), np.float32(0.0)
    widest = 1
    for i in range(rects.shape[0]):
        widest = max(widest, rects[i, 2] - rects[i, 0])
    words = np.empty(widest, np.uint64)
    deviates = np.empty(widest, np.float32)
    for i in range(rects.shape[0]):
        x0, y0, x1, y1 = rects[i, 0], rects[i, 1], rects[i, 2], rects[i, 3]
        wx0, wy0, wx1, wy1 = wide_rects[i, 0], wide_rects[i, 1], wide_rects[i, 2], wide_rects[i, 3]
        w, wide_w, wide_h = x1 - x0, wx1 - wx0, wy1 - wy0
        if w <= 0 or y1 <= y0:
            continue
        across = np.zeros((wide_h, w), np.float32)
        row = np.empty(w + 2 * reach, np.float32)
        for y in range(wide_h):
            start = wide_offsets[i] + y * wide_w
            for j in range(w + 2 * reach):
                x = min(max(x0 - reach + j, wx0), wx1 - 1)
                row[j] = np.float32(wide[start + x - wx0])
            line = across[y]
            for k in range(2 * reach + 1):
                tap = taps[abs(k - reach)]
                part = row[k : k + w]
                for c in range(w):
                    line[c] += tap * part[c]
        line = np.empty(w, np.float32)
        at = offsets[i]
        for y in range(y0, y1):
            line[:] = np.float32(0.0)
            for k in range(-reach, reach + 1):
                tap = taps[abs(k)]
                part = across[min(max(y + k, wy0), wy1 - 1) - wy0]
                for c in range(w):
                    line[c] += tap * part[c]
            words_of(key, y * image_width + x0, words[:w])
            normals_of(words[:w], normal_table, deviates[:w])
            for c in range(w):
                level = line[c]
                variance = lost * (max(level - offset, zero) * inverse_gain + read_variance)
                number = level + np.float32(math.sqrt(variance)) * deviates[c] + half
                flat[at + c] = np.uint16(np.int32(min(max(number, zero), full)))
            at += w
