"""On-board parameters of service 20: one table. Defaults are not here: they come from the unit's file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..errors import LocalProtocolError
from .enumerations import ParameterId
from .field_types import FLOAT32, UINT8, UINT16, UINT32, FieldError, FieldType, FieldViolation
from .fields import Field


@dataclass(frozen=True)
class ParameterDefinition:
    """One parameter: limits are inclusive; ``read_only`` ones can be reported but not set."""

    id: ParameterId
    type: FieldType
    unit: str
    minimum: float
    maximum: float
    meaning: str
    read_only: bool = False

    @property
    def name(self) -> str:
        """Its name, as in unit files."""
        return self.id.name.lower()

    @property
    def field(self) -> Field:
        """Its value as a field."""
        return Field("value", self.type, self.unit, self.minimum, self.maximum, self.meaning)

    def violation(self, value: Any) -> FieldViolation | None:
        """What is wrong with ``value``, None when the parameter may have it (READ_ONLY is not looked at)."""
        try:
            self.field.prepare(value, self.name, True)
        except FieldError as error:
            return error.violation
        return None

    def as_carried(self, value: Any) -> int | float:
        """``value`` as it is after a trip over the wire (32-bit floats rounded); LocalProtocolError when
        not allowed.
        """
        try:
            plain = self.field.prepare(value, self.name, True)
        except FieldError as error:
            violation = error.violation
            raise LocalProtocolError("parameter", self.name, violation.value, violation.allowed) from None
        carried: int | float = self.type.layout.parse(self.type.layout.build(plain))
        return carried


_P = ParameterId

PARAMETER_TABLE: tuple[ParameterDefinition, ...] = (
    ParameterDefinition(_P.EXPOSURE_US, UINT32, "us", 100, 250_000, "exposure time of a frame"),
    ParameterDefinition(
        _P.DETECTION_SIGMA,
        FLOAT32,
        "",
        3,
        50,
        "detection threshold above the local background, in standard deviations",
    ),
    ParameterDefinition(
        _P.DETECTION_MIN_PIXELS, UINT8, "px", 1, 50, "smallest cluster that counts as a spot"
    ),
    ParameterDefinition(
        _P.CENTROID_HALF_WINDOW_PX, UINT8, "px", 1, 7, "half-width of the window of the centroid"
    ),
    ParameterDefinition(_P.MAGNITUDE_LIMIT, FLOAT32, "mag", 0, 10, "faintest spot that is used"),
    ParameterDefinition(
        _P.IDENTIFICATION_TOLERANCE_ARCSEC,
        FLOAT32,
        "arcsec",
        0.1,
        600,
        "tolerance of an angle between two stars",
    ),
    ParameterDefinition(
        _P.IDENTIFICATION_MAX_SPOTS, UINT8, "", 4, 40, "number of brightest spots used by the identification"
    ),
    ParameterDefinition(
        _P.TRACKING_RATE_DEG_S,
        FLOAT32,
        "deg/s",
        0.01,
        10,
        "angular rate that the detection windows are sized for",
    ),
    ParameterDefinition(
        _P.TRACKING_TOLERANCE_ARCSEC, FLOAT32, "arcsec", 0.1, 600, "tolerance of an angle to the pivot star"
    ),
    ParameterDefinition(_P.TRACKING_MIN_STARS, UINT8, "", 2, 20, "verified stars that tracking needs"),
    ParameterDefinition(
        _P.TRACKING_MAX_MISSED,
        UINT8,
        "frames",
        0,
        20,
        "frames in a row without attitude before tracking is given up",
    ),
    ParameterDefinition(
        _P.BLINDED_BACKGROUND_DN,
        UINT16,
        "DN",
        1,
        65_535,
        "mean background above which the sensor counts as blinded",
    ),
    ParameterDefinition(
        _P.ABERRATION_CORRECTION,
        UINT8,
        "",
        0,
        1,
        "1: correct stellar aberration once the time is set (up to 20.5 arcsec, not corrected while "
        "FREE_RUNNING); 0: directions as they appear",
    ),
    ParameterDefinition(
        _P.VELOCITY_X_KM_S, FLOAT32, "km/s", -20, 20, "spacecraft velocity relative to the Earth, ICRS x"
    ),
    ParameterDefinition(
        _P.VELOCITY_Y_KM_S, FLOAT32, "km/s", -20, 20, "spacecraft velocity relative to the Earth, ICRS y"
    ),
    ParameterDefinition(
        _P.VELOCITY_Z_KM_S, FLOAT32, "km/s", -20, 20, "spacecraft velocity relative to the Earth, ICRS z"
    ),
    ParameterDefinition(
        _P.ATTITUDE_REPORT, UINT8, "", 0, 1, "1: send attitude report 130,1 each frame; 0: do not"
    ),
    ParameterDefinition(
        _P.AUTONOMOUS_START,
        UINT8,
        "",
        0,
        1,
        "1: go from STANDBY to LOST_IN_SPACE without command after the boot",
    ),
    ParameterDefinition(
        _P.PIPELINED,
        UINT8,
        "",
        0,
        1,
        "1: processing overlaps the next exposure; 0: it ends before the next one starts",
    ),
    ParameterDefinition(_P.CLOCK_HZ, UINT32, "Hz", 1_000_000, 2_000_000_000, "clock of the processor"),
    ParameterDefinition(_P.BOOT_COUNT, UINT16, "", 0, 65_535, "starts of the unit so far", read_only=True),
    ParameterDefinition(
        _P.CACHE_KIB,
        UINT8,
        "KiB",
        0,
        32,
        "size of the instruction cache and of the data cache: 32, 16, 8, 4; 0: caches off",
    ),
    ParameterDefinition(
        _P.LINE_FILL,
        UINT8,
        "",
        0,
        2,
        "time that the memory takes to fill a cache line: 0 low, 1 nominal, 2 high",
    ),
)

PARAMETERS: dict[int, ParameterDefinition] = {int(parameter.id): parameter for parameter in PARAMETER_TABLE}
"""By number."""

PARAMETERS_BY_NAME: dict[str, ParameterDefinition] = {
    parameter.name: parameter for parameter in PARAMETER_TABLE
}
"""By name."""
