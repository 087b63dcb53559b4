"""Faults of the sensor: pixels, rows and columns of the detector, its gain, and what lies on the optics."""

from __future__ import annotations

import math
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..firmware_model.image.frame import Frame
from ..world import noise, sensor_faults
from ..world.lit_scene import Scene
from ..world.windows import window_offsets
from .fault import Exposure, FaultKind, FaultSettings, Reach, SettingsT
from .sensor_frame import I32, I64, STREAM_PLACES, U16, Converter, LitFrame, SensorFault, SpoiltFrame

F32 = NDArray[np.float32]
MOST_GAIN = 1e6
Line = Annotated[int, Field(ge=0, le=8191)]


class HotPixelsSettings(FaultSettings):
    kind: Literal["sensor.hot_pixels"]
    number: Annotated[int, Field(ge=1, le=1_000_000, description="at places by chance")] = 1000
    electrons_s: Annotated[
        float,
        Field(gt=0, le=1e9, description="mean dark current; single ones by an exponential distribution"),
    ] = 50_000.0


class HotPixels(SensorFault[HotPixelsSettings]):
    """More hot pixels, always the same. ASSUMED: near-exponential, as irradiated detectors' dark currents."""

    def __init__(self, settings: HotPixelsSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        pixels = self.width_px * self.height_px
        if settings.number > pixels:
            raise ValueError(f"number = {settings.number}; allowed is up to {pixels}, the unit's pixels")
        u = self.uniforms(STREAM_PLACES, 0, 2 * settings.number).reshape(2, -1)
        self.dark_electrons_s: F32 = np.zeros((self.height_px, self.width_px), np.float32)
        # two that meet make one that is hotter
        np.add.at(
            self.dark_electrons_s.reshape(-1),
            (u[0] * pixels).astype(np.int64),
            -settings.electrons_s * np.log(u[1]),
        )

    def spoil(self, frame: Frame, exposure: Exposure) -> Frame:
        def light() -> Scene:
            return sensor_faults.light(
                self.width_px,
                self.height_px,
                self.profile.optics.psf_sigma_px,
                dark_electrons_s=self.dark_electrons_s,
                exposure_s=exposure.duration_ns * 1e-9,
            )

        return LitFrame(frame, light, self.noise_key(exposure), Converter(self.profile, frame))


class DeadRowsSettings(FaultSettings):
    kind: Literal["sensor.dead_rows"]
    number: Annotated[int, Field(ge=1, le=8192, description="so many by chance, where rows names none")] = 5
    rows: Annotated[tuple[Line, ...], Field(max_length=8192, description="from the top, from 0")] = ()
    value_dn: Annotated[
        int, Field(ge=0, le=65535, description="what they show, up to the converter's end")
    ] = 0


class DeadColumnsSettings(FaultSettings):
    kind: Literal["sensor.dead_columns"]
    number: Annotated[
        int, Field(ge=1, le=8192, description="so many by chance, where columns names none")
    ] = 5
    columns: Annotated[tuple[Line, ...], Field(max_length=8192, description="from the left, from 0")] = ()
    value_dn: Annotated[
        int, Field(ge=0, le=65535, description="what they show, up to the converter's end")
    ] = 0


class _DeadFrame(SpoiltFrame):
    def __init__(self, frame: Frame, lines: NDArray[np.bool_], across: bool, value_dn: int) -> None:
        super().__init__(frame)
        self._lines = lines
        self._across = across
        self._value_dn = min(value_dn, (1 << frame.bits) - 1)

    def spoil(self, flat: U16, rects: I32, offsets: I64) -> None:
        for (x0, y0, x1, y1), at, end in zip(rects.tolist(), offsets[:-1], offsets[1:], strict=True):
            window = flat[at:end].reshape(y1 - y0, x1 - x0)
            if self._across:
                window[self._lines[y0:y1]] = self._value_dn
            else:
                window[:, self._lines[x0:x1]] = self._value_dn


class _DeadLines(SensorFault[SettingsT]):
    """Rows or columns that show one number."""

    across = True

    def __init__(self, settings: SettingsT, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        name, count = ("rows", self.height_px) if self.across else ("columns", self.width_px)
        named, number, self._value_dn = (
            getattr(settings, name),
            self.settings_number(),
            self.settings_value_dn(),
        )
        if max(named, default=0) >= count or number > count:
            raise ValueError(
                f"{name} = {list(named) or number}: the unit has {count}; allowed are 0 to {count - 1}"
            )
        self.lines = np.zeros(count, bool)
        self.lines[list(named) or np.argsort(self.uniforms(STREAM_PLACES, 0, count))[:number]] = True

    def settings_number(self) -> int:
        raise NotImplementedError

    def settings_value_dn(self) -> int:
        raise NotImplementedError

    def spoil(self, frame: Frame, exposure: Exposure) -> Frame:
        return _DeadFrame(frame, self.lines, self.across, self._value_dn)


class DeadRows(_DeadLines[DeadRowsSettings]):
    def settings_number(self) -> int:
        return self.settings.number

    def settings_value_dn(self) -> int:
        return self.settings.value_dn


class DeadColumns(_DeadLines[DeadColumnsSettings]):
    across = False

    def settings_number(self) -> int:
        return self.settings.number

    def settings_value_dn(self) -> int:
        return self.settings.value_dn


class GainDriftSettings(FaultSettings):
    kind: Literal["sensor.gain_drift"]
    factor_per_s: Annotated[
        float, Field(gt=0, le=100, description="each second the gain is so many times what it was")
    ] = 0.9


class _AmplifiedFrame(SpoiltFrame):
    def __init__(self, frame: Frame, gain: float, key: np.uint64, converter: Converter) -> None:
        super().__init__(frame)
        self._gain = gain
        self._key = key
        self._converter = converter

    def spoil(self, flat: U16, rects: I32, offsets: I64) -> None:
        sensor_faults.amplify(
            rects,
            offsets,
            flat,
            self.width_px,
            self._key,
            self._gain,
            self._converter.offset_dn,
            self._converter.top_dn,
        )


class GainDrift(SensorFault[GainDriftSettings]):
    """ASSUMED: the amplifier drifts, behind all noise but the converter's; the black level stays."""

    def gain(self, exposure: Exposure) -> float:
        """Of a frame, 1 when the fault begins."""
        exponent = math.log(self.settings.factor_per_s) * max(self.since_s(exposure.start_ns), 0.0)
        return math.exp(min(exponent, math.log(MOST_GAIN)))

    def spoil(self, frame: Frame, exposure: Exposure) -> Frame:
        converter = Converter(self.profile, frame)
        return _AmplifiedFrame(frame, self.gain(exposure), self.noise_key(exposure), converter)


class DustSettings(FaultSettings):
    kind: Literal["sensor.dust"]
    number: Annotated[int, Field(ge=1, le=1000, description="of dark spots")] = 20
    radius_px: Annotated[float, Field(ge=0.5, le=500, description="sigma of each spot's shadow")] = 8.0
    depth: Annotated[float, Field(gt=0, le=1, description="share of the light missing in its middle")] = 0.7


class _DimmedFrame(SpoiltFrame):
    def __init__(self, frame: Frame, transmission: F32, key: np.uint64, converter: Converter) -> None:
        super().__init__(frame)
        self._transmission = transmission
        self._key = key
        self._converter = converter

    def spoil(self, flat: U16, rects: I32, offsets: I64) -> None:
        converter = self._converter
        sensor_faults.transmit(
            rects,
            offsets,
            flat,
            self._transmission,
            self._key,
            noise.NORMAL_TABLE,
            converter.electrons_per_dn,
            converter.offset_dn,
            converter.read_noise_electrons,
            converter.top_dn,
        )


class Dust(SensorFault[DustSettings]):
    """Soft dark spots that do not move. ASSUMED: Gaussian shadows; dark current counts as light."""

    def __init__(self, settings: DustSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        u = self.uniforms(STREAM_PLACES, 0, 2 * settings.number).reshape(-1, 2)
        self.spots_px = u * np.array([self.width_px, self.height_px]) - 0.5
        transmission = np.ones((self.height_px, self.width_px))
        reach_px = 4.0 * settings.radius_px
        for x, y in self.spots_px:
            left, right = max(math.floor(x - reach_px), 0), min(math.ceil(x + reach_px) + 1, self.width_px)
            top, below = max(math.floor(y - reach_px), 0), min(math.ceil(y + reach_px) + 1, self.height_px)
            across = np.exp(-0.5 * ((np.arange(left, right) - x) / settings.radius_px) ** 2)
            down = np.exp(-0.5 * ((np.arange(top, below) - y) / settings.radius_px) ** 2)
            transmission[top:below, left:right] *= 1.0 - settings.depth * np.outer(down, across)
        self.transmission: F32 = transmission.astype(np.float32)

    def spoil(self, frame: Frame, exposure: Exposure) -> Frame:
        key, converter = self.noise_key(exposure), Converter(self.profile, frame)
        return _DimmedFrame(frame, self.transmission, key, converter)


class DefocusSettings(FaultSettings):
    kind: Literal["sensor.defocus"]
    sigma_px: Annotated[
        float, Field(ge=0.5, le=5, description="of the blur; its square adds to that of the point spread")
    ] = 1.5


class _BlurredFrame(SpoiltFrame):
    def __init__(self, frame: Frame, sigma_px: float, key: np.uint64, converter: Converter) -> None:
        super().__init__(frame)
        self._taps = sensor_faults.blur_taps(sigma_px)
        self._key = key
        self._converter = converter

    def _pixels(self, rects: I32) -> tuple[U16, I64]:
        wide_rects = sensor_faults.grown(rects, len(self._taps) - 1, self.width_px, self.height_px)
        if self._whole(wide_rects):
            wide, wide_offsets = self._frame.full().ravel(), window_offsets(wide_rects)
        else:
            wide, wide_offsets = self._frame.windows(wide_rects)
        offsets = window_offsets(rects)
        flat = np.empty(int(offsets[-1]), np.uint16)
        converter = self._converter
        sensor_faults.blur(
            wide_rects,
            wide_offsets,
            wide,
            rects,
            offsets,
            flat,
            self._taps,
            self.width_px,
            self._key,
            noise.NORMAL_TABLE,
            converter.electrons_per_dn,
            converter.offset_dn,
            converter.read_noise_electrons,
            converter.top_dn,
        )
        return flat, offsets

    def spoil(self, flat: U16, rects: I32, offsets: I64) -> None:
        raise AssertionError("a blurred pixel needs its neighbours")


class Defocus(SensorFault[DefocusSettings]):
    """A wider point spread.

    ASSUMED: the numbers are blurred instead of the light before it was noise, and the noise that goes thereby
    is drawn anew; so hot pixels are blurred as well, and what a saturated star had over the converter's end
    is missing.
    """

    def spoil(self, frame: Frame, exposure: Exposure) -> Frame:
        converter = Converter(self.profile, frame)
        return _BlurredFrame(frame, self.settings.sigma_px, self.noise_key(exposure), converter)


PIXEL_KINDS: Final = (
    FaultKind(
        HotPixelsSettings,
        HotPixels,
        what="So many pixels more have a high dark current, always the same ones.",
        obc_sees="Little: single bright pixels are no stars and are left out. Where one lies beside a star "
        "its residual grows or it falls out (stars_identified); cycles rise, and with very many "
        "spots_detected too.",
        afterwards="The next frame is as before.",
    ),
    FaultKind(
        DeadRowsSettings,
        DeadRows,
        what="Rows of the detector show one number, whatever light falls on them.",
        obc_sees="Stars on them fall out or are a little off (stars_identified, residual_rms_arcsec); "
        "attitudes stay valid as long as enough others are there.",
        afterwards="The next frame is as before.",
    ),
    FaultKind(
        DeadColumnsSettings,
        DeadColumns,
        what="Columns of the detector show one number, whatever light falls on them.",
        obc_sees="Stars on them fall out or are a little off (stars_identified, residual_rms_arcsec); "
        "attitudes stay valid as long as enough others are there.",
        afterwards="The next frame is as before.",
    ),
    FaultKind(
        GainDriftSettings,
        GainDrift,
        what="The gain of the read-out grows or falls by a factor each second.",
        obc_sees="Falling: stars seem fainter, stars_identified falls, at last TOO_FEW_STARS and "
        "TRACKING_LOST. Growing: background_dn and noise_dn rise, to BLINDED at last.",
        afterwards="The gain is as before with the next frame; a unit that lost tracking acquires anew.",
    ),
    FaultKind(
        DustSettings,
        Dust,
        what="Dark soft spots on the optics that do not move.",
        obc_sees="Stars behind them are fainter or gone (stars_identified); attitudes stay valid and right.",
        afterwards="The next frame is as before.",
    ),
    FaultKind(
        DefocusSettings,
        Defocus,
        what="The optics are out of focus: the light of a star is spread over more pixels.",
        obc_sees="Faint stars fall out, covariances and residual_rms_arcsec grow; a strong defocus leaves "
        "too few stars: TOO_FEW_STARS, TRACKING_LOST, mode LOST_IN_SPACE.",
        afterwards="The next frame is as before; a unit that lost tracking acquires anew.",
    ),
)
