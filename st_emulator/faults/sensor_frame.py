"""A frame that a fault has changed: pixels are made when they are asked for, and are the same however."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..clock import NS_PER_S
from ..firmware_model.image.frame import Frame
from ..units.profile import UnitProfile
from ..world import noise, sensor_faults
from ..world.lit_scene import Scene
from ..world.windows import checked_windows, cut_windows, window_offsets
from .fault import AtSensor, Exposure, Reach, SettingsT

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
U16 = NDArray[np.uint16]

# streams of a fault's seed: what strikes, where things lie, the noise of what is added
STREAM_STRIKES = 101
STREAM_PLACES = 102
STREAM_NOISE = 103


class SensorFault(AtSensor[SettingsT]):
    """A fault that changes what the frames show that are exposed from its begin to its end.

    All of it follows from the seed, the frame's number and the pixel, and from the time since it began.
    """

    def __init__(self, settings: SettingsT, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        self.profile: UnitProfile = reach.profile
        self.width_px = reach.profile.detector.columns
        self.height_px = reach.profile.detector.rows
        self._began_ns = 0

    def begin(self) -> None:
        self._began_ns = self.reach.clock.now_ns

    def since_s(self, t_ns: int) -> float:
        """From the fault's begin to a time, s."""
        return (t_ns - self._began_ns) / NS_PER_S

    def strikes_frame(self, exposure: Exposure) -> bool:
        """Whether it strikes this frame."""
        probability = self.settings.probability
        return probability >= 1.0 or self.uniforms(STREAM_STRIKES, exposure.index, 1)[0] < probability

    def uniforms(self, stream: int, number: int, count: int) -> F64:
        """Numbers in (0, 1) that follow from the seed, a stream and a number."""
        return noise.uniforms(noise.stream_key(self.seed, stream, number), count)

    def noise_key(self, exposure: Exposure) -> np.uint64:
        """Of the noise that the fault adds to a frame."""
        return noise.stream_key(self.seed, STREAM_NOISE, exposure.index)

    def electrons_of(self, magnitude: ArrayLike, exposure: Exposure) -> F64:
        """Charge that a star of this magnitude leaves in the unit's detector."""
        flux = self.profile.electrons_per_s_mag0 * 10.0 ** (-0.4 * np.asarray(magnitude, np.float64))
        return np.asarray(flux * exposure.duration_ns / NS_PER_S)

    def expose(self, frame: Frame, exposure: Exposure) -> Frame | None:
        return self.spoil(frame, exposure) if self.strikes_frame(exposure) else frame

    def spoil(self, frame: Frame, exposure: Exposure) -> Frame | None:
        """What the sensor delivers in place of a frame that is struck."""
        raise NotImplementedError


class SpoiltFrame(ABC):
    """A frame in place of another, whose pixels it asks for and changes."""

    def __init__(self, frame: Frame) -> None:
        self._frame = frame
        self.width_px = frame.width_px
        self.height_px = frame.height_px
        self.bits = frame.bits
        self._full: U16 | None = None

    def full(self) -> U16:
        """uint16[height, width], not to be written to."""
        if self._full is None:
            rects = np.array([[0, 0, self.width_px, self.height_px]], dtype=np.int32)
            flat, _ = self._pixels(rects)
            flat.setflags(write=False)
            self._full = flat.reshape(self.height_px, self.width_px)
        return self._full

    def windows(self, rects: ArrayLike) -> tuple[U16, I64]:
        """See :class:`~st_emulator.firmware_model.image.frame.Frame`."""
        if self._full is not None:
            return cut_windows(self._full, rects)
        return self._pixels(checked_windows(rects, self.width_px, self.height_px))

    def _whole(self, rects: I32) -> bool:
        """Whether that is all of it: asked of the frame beneath as such, it is rendered once for all."""
        return len(rects) == 1 and rects[0].tolist() == [0, 0, self.width_px, self.height_px]

    def _beneath(self, rects: I32) -> tuple[U16, I64]:
        """The pixels of the frame beneath, to be written to."""
        if self._whole(rects):
            return self._frame.full().ravel().copy(), window_offsets(rects)
        flat, offsets = self._frame.windows(rects)
        return flat.copy(), offsets

    def _pixels(self, rects: I32) -> tuple[U16, I64]:
        flat, offsets = self._beneath(rects)
        self.spoil(flat, rects, offsets)
        return flat, offsets

    @abstractmethod
    def spoil(self, flat: U16, rects: I32, offsets: I64) -> None:
        """Change the pixels of these windows."""


class Converter:
    """From charge to numbers: the unit's detector, the bits of the frame."""

    def __init__(self, profile: UnitProfile, frame: Frame) -> None:
        detector = profile.detector
        self.electrons_per_dn = detector.electrons_per_dn
        self.offset_dn = detector.offset_dn
        self.read_noise_electrons = detector.read_noise_electrons
        self.top_dn = float((1 << frame.bits) - 1)
        well_dn = math.floor(
            detector.full_well_electrons / detector.electrons_per_dn + detector.offset_dn + 0.5
        )
        #: Where more light shows no more: the converter is at its end, or the pixel is full.
        self.full_dn = min(self.top_dn, float(well_dn))


class LitFrame(SpoiltFrame):
    """More light or charge on a frame. ``light``: of it, made on first need."""

    def __init__(
        self, frame: Frame, light: Callable[[], Scene], key: np.uint64, converter: Converter
    ) -> None:
        super().__init__(frame)
        self._light = light
        self._key = key
        self._converter = converter

    @cached_property
    def light(self) -> Scene:
        return self._light()

    def spoil(self, flat: U16, rects: I32, offsets: I64) -> None:
        converter = self._converter
        sensor_faults.add_light(
            rects,
            offsets,
            flat,
            self.light,
            self._key,
            noise.NORMAL_TABLE,
            1.0 / converter.electrons_per_dn,
            converter.full_dn,
        )
