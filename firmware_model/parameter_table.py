"""The parameters of the firmware: names, how they are stored, limits.

Their defaults are the unit file's, their numbers on a wire those of its language.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import Enum
from numbers import Real
from typing import Any

__all__ = ["PARAMETERS_BY_NAME", "PARAMETER_TABLE", "ParameterDefinition", "Storage"]


class Storage(Enum):
    """How a parameter stands in the memory: the format of :mod:`struct`."""

    U8 = "B"
    U16 = "H"
    U32 = "I"
    F32 = "f"


def _as_f32(value: float) -> float:
    return float(struct.unpack("f", struct.pack("f", value))[0])


@dataclass(frozen=True)
class ParameterDefinition:
    """One parameter: limits are inclusive, in a 32-bit float their nearest 32-bit values; ``read_only`` ones
    can be reported but not set.
    """

    name: str
    storage: Storage
    unit: str
    minimum: float
    maximum: float
    meaning: str
    read_only: bool = False

    def fits(self, value: Any) -> bool:
        """Whether the parameter can have ``value``."""
        if self.storage is not Storage.F32:
            return isinstance(value, int) and self.minimum <= value <= self.maximum
        if not isinstance(value, Real):
            return False
        try:
            stored = _as_f32(float(value))
        except OverflowError:
            return False
        return math.isfinite(stored) and _as_f32(self.minimum) <= stored <= _as_f32(self.maximum)

    def stored(self, value: float | int) -> float | int:
        """``value`` as the memory keeps it: floats rounded to 32 bits. ValueError when it does not fit."""
        if not self.fits(value):
            raise ValueError(f"{self.name} = {value!r}; allowed: {self.minimum:.15g}..{self.maximum:.15g}")
        return _as_f32(value) if self.storage is Storage.F32 else int(value)


PARAMETER_TABLE: tuple[ParameterDefinition, ...] = (
    ParameterDefinition("exposure_us", Storage.U32, "us", 100, 250_000, "exposure time of a frame"),
    ParameterDefinition(
        "detection_sigma",
        Storage.F32,
        "",
        3,
        50,
        "detection threshold above the local background, in standard deviations",
    ),
    ParameterDefinition(
        "detection_min_pixels", Storage.U8, "px", 1, 50, "smallest cluster that counts as a spot"
    ),
    ParameterDefinition(
        "centroid_half_window_px", Storage.U8, "px", 1, 7, "half-width of the window of the centroid"
    ),
    ParameterDefinition("magnitude_limit", Storage.F32, "mag", 0, 10, "faintest spot that is used"),
    ParameterDefinition(
        "identification_tolerance_arcsec",
        Storage.F32,
        "arcsec",
        0.1,
        600,
        "tolerance of an angle between two stars",
    ),
    ParameterDefinition(
        "identification_max_spots",
        Storage.U8,
        "",
        4,
        40,
        "number of brightest spots used by the identification",
    ),
    ParameterDefinition(
        "tracking_rate_deg_s",
        Storage.F32,
        "deg/s",
        0.01,
        10,
        "angular rate that the detection windows are sized for",
    ),
    ParameterDefinition(
        "tracking_tolerance_arcsec",
        Storage.F32,
        "arcsec",
        0.1,
        600,
        "tolerance of an angle to the pivot star",
    ),
    ParameterDefinition("tracking_min_stars", Storage.U8, "", 2, 20, "verified stars that tracking needs"),
    ParameterDefinition(
        "tracking_max_missed",
        Storage.U8,
        "frames",
        0,
        20,
        "frames in a row without attitude before tracking is given up",
    ),
    ParameterDefinition(
        "blinded_background_dn",
        Storage.U16,
        "DN",
        1,
        65_535,
        "mean background above which the sensor counts as blinded",
    ),
    ParameterDefinition(
        "aberration_correction",
        Storage.U8,
        "",
        0,
        1,
        "1: correct stellar aberration once the time is set (up to 20.5 arcsec, not corrected while "
        "FREE_RUNNING); 0: directions as they appear",
    ),
    ParameterDefinition(
        "velocity_x_km_s", Storage.F32, "km/s", -20, 20, "spacecraft velocity relative to the Earth, ICRS x"
    ),
    ParameterDefinition(
        "velocity_y_km_s", Storage.F32, "km/s", -20, 20, "spacecraft velocity relative to the Earth, ICRS y"
    ),
    ParameterDefinition(
        "velocity_z_km_s", Storage.F32, "km/s", -20, 20, "spacecraft velocity relative to the Earth, ICRS z"
    ),
    ParameterDefinition(
        "attitude_report", Storage.U8, "", 0, 1, "1: send attitude report 130,1 each frame; 0: do not"
    ),
    ParameterDefinition(
        "autonomous_start",
        Storage.U8,
        "",
        0,
        1,
        "1: go from STANDBY to LOST_IN_SPACE without command after the boot",
    ),
    ParameterDefinition(
        "pipelined",
        Storage.U8,
        "",
        0,
        1,
        "1: processing overlaps the next exposure; 0: it ends before the next one starts",
    ),
    ParameterDefinition("clock_hz", Storage.U32, "Hz", 1_000_000, 2_000_000_000, "clock of the processor"),
    ParameterDefinition(
        "boot_count", Storage.U16, "", 0, 65_535, "starts of the unit so far", read_only=True
    ),
    ParameterDefinition(
        "cache_kib",
        Storage.U8,
        "KiB",
        0,
        32,
        "size of the instruction cache and of the data cache: 32, 16, 8, 4; 0: caches off",
    ),
    ParameterDefinition(
        "line_fill",
        Storage.U8,
        "",
        0,
        2,
        "time that the memory takes to fill a cache line: 0 low, 1 nominal, 2 high",
    ),
)

PARAMETERS_BY_NAME: dict[str, ParameterDefinition] = {entry.name: entry for entry in PARAMETER_TABLE}
