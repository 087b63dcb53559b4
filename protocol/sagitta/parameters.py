"""The parameters of the language: numbers, arguments, defaults. One table for codec and document.

The arguments are the same in a request to set and in the reply to a request to read.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from .layout import Field, Kind, Layout, Repeated

__all__ = ["PARAMETERS", "PARAMETERS_BY_NAME", "PARAMETER_TABLE", "SUBSCRIPTION_SLOTS", "ParameterDefinition"]

SUBSCRIPTION_SLOTS: Final = 16

_U8, _U16, _I16, _U32, _F32 = Kind.U8, Kind.U16, Kind.I16, Kind.U32, Kind.F32


@dataclass(frozen=True)
class ParameterDefinition:
    """One parameter, which is a row of arguments that are set together.

    ``mapping``: what the emulated device does with it; empty: it is stored and read back alone.
    """

    id: int
    name: str
    arguments: Layout
    mapping: str = ""


def _definition(id_: int, name: str, *elements: Field | Repeated, mapping: str = "") -> ParameterDefinition:
    return ParameterDefinition(id_, name, Layout(elements), mapping)


PARAMETER_TABLE: Final[tuple[ParameterDefinition, ...]] = (
    _definition(3, "log_level", Field("levels", _U8, "of each source of the log", count=16)),
    _definition(
        5,
        "limits",
        Field("action", _U8, "what is done where a limit is passed"),
        Field("limits", _F32, "largest currents and temperatures", count=10),
    ),
    _definition(
        6,
        "mounting",
        Field("w", _F32, "scalar part", default=1.0),
        Field("x", _F32),
        Field("y", _F32),
        Field("z", _F32),
        mapping="turns every quaternion of the solution: C(sent) = C(mounting) C(unit). ASSUMED: its place "
        "in the product. A quaternion whose length is off 1 by more than 0.001 is refused",
    ),
    _definition(
        8,
        "distortion",
        Field("mode", _U8, default=1),
        Field("x_coefficients", _F32, "ASSUMED: 0, they belong to one lens", count=8),
        Field("y_coefficients", _F32, "ASSUMED: 0, they belong to one lens", count=8),
    ),
    _definition(
        9,
        "camera",
        Field("mode", _U8, default=2),
        Field("focal_length_mm", _F32, unit="mm", default=25.0),
        Field("exposure_s", _F32, "exposure time", "s", default=0.075),
        Field("interval_s", _F32, "time between images", "s", default=0.1),
        Field("offset", _I16, default=-175),
        Field("pga_gain", _U8, default=3),
        Field("adc_gain", _U8, default=58),
        Field("registers", _U8, "registers of the sensor to overwrite", count=16),
        Field("frequency", _U32, default=8),
        mapping="`exposure_s` is the device's `exposure_us`, from 100 us to the frame period, at most "
        "250 ms; others are refused. The frame period is the unit's own: `interval_s` is stored alone",
    ),
    _definition(
        10,
        "image_processor",
        Field("mode", _U8, "1: image", default=3),
        Field("store", _U8),
        Field("signal_threshold", _U16, default=10),
        Field("dark_threshold", _U16),
        Field("background_compensation", _U8),
        mapping="`mode` 1 keeps the next frame for the histogram. ASSUMED: attitude determination goes on",
    ),
    _definition(
        11,
        "centroiding",
        Field("enable_filter", _U8),
        Field("max_quality", _F32, default=9999.0),
        Field("dark_threshold", _F32),
        Field("min_quality", _F32, default=-9999.0),
        Field("max_intensity", _F32, default=9999.0),
        Field("min_intensity", _F32, default=-9999.0),
        Field("max_magnitude", _F32, "faintest star that is used", "mag", default=9999.0),
        Field("gaussian_max", _F32, default=9999.0),
        Field("gaussian_min", _F32, default=-9999.0),
        Field("matrix", _F32, "00, 01, 10, 11", count=4, default=(0.0, 1.0, -1.0, 0.0)),
        mapping="`max_magnitude` is the device's `magnitude_limit`; over 10 it is the unit's own, for 9999 "
        "says that there is none; below 0 is refused. The matrix turns nothing: coordinates are the sensor's",
    ),
    _definition(
        12,
        "lisa",
        Field("mode", _U32, default=2),
        Field("prefilter_distance_mm", _F32, unit="mm", default=0.05),
        Field("prefilter_angle_rad", _F32, unit="rad", default=0.025),
        Field("field_width_rad", _F32, unit="rad", default=0.44316187),
        Field("field_height_rad", _F32, unit="rad", default=0.44316187),
        Field("float_star_limit_mm", _F32, unit="mm", default=0.08),
        Field("close_star_limit_mm", _F32, unit="mm", default=0.08),
        Field("weight_close_count", _F32, default=100.0),
        Field("weight_fraction_close", _F32, default=10.0),
        Field("weight_mean_sum", _F32),
        Field("weight_database_count", _F32),
        Field("max_combinations", _U8, default=12),
        Field("stars_stop", _U8, default=6),
        Field("fraction_close_stop", _F32, default=0.6),
    ),
    _definition(
        13,
        "matching",
        Field("squared_distance_limit", _F32, default=0.0121),
        Field("squared_shift_limit", _F32, default=0.003025),
    ),
    _definition(
        14,
        "tracking",
        Field("thin_limit", _F32, default=0.01),
        Field("outlier_limit", _F32, default=0.000272),
        Field("outlier_limit_quest", _F32, default=0.0005),
        Field("tracker", _U8, default=2),
    ),
    _definition(
        15,
        "validation",
        Field("stable_count", _U8, "solutions in a row that are needed", default=5),
        Field("max_difference_deg", _F32, "from one solution to the next", "deg", default=0.5),
        Field("min_confidence", _F32, "of the tracker", default=0.005),
        Field("min_stars", _U8, "matched stars that are needed", default=6),
        mapping="decides when `valid` of the solution is 1, see there. ASSUMED: how they work together",
    ),
    _definition(
        16,
        "algorithm",
        Field("mode", _U8, default=12),
        Field("lisa_to_tracking_confidence", _F32, default=0.005),
        Field("lisa_to_tracking_stars", _U8, default=6),
        Field("tracking_to_lisa_confidence", _F32, default=0.005),
        Field("tracking_to_lisa_stars", _U8, "with fewer tracking gives up", default=6),
        mapping="`tracking_to_lisa_stars` is the device's `tracking_min_stars`, 2 to 20; others are refused",
    ),
    _definition(
        18,
        "subscription",
        Field("telemetry_ids", _U8, "0: none", count=SUBSCRIPTION_SLOTS, default=(24, 27, *(0,) * 14)),
        mapping="the telemetry that is sent without being asked for. An id that does not exist is refused, "
        "and the subscription stays as it was. Read back before it was set it shows the default of the "
        "driver; nothing is sent before it was set",
    ),
    _definition(
        23,
        "auto_threshold",
        Field("enable", _U8, default=1),
        Field("count", _U8, default=30),
        Field("min_threshold", _U16, default=2),
        Field("max_threshold", _U16, default=70),
        Field("gain", _F32, default=0.01),
    ),
    _definition(
        25,
        "fast_lisa",
        Field("first_limit", _F32, default=0.1),
        Field("second_limit", _F32, default=0.2),
    ),
    _definition(
        30,
        "noise_limits",
        Field("limits", _U16, count=4, default=(4, 40, 0, 255)),
    ),
    _definition(
        31,
        "blob_filter",
        Repeated(
            "filters",
            5,
            (Field("high", _U32), Field("low", _U32)),
            "64 bits each, the high word first (unconfirmed); ASSUMED: 0 by default",
        ),
        Field("limits", _U8, count=3, default=5),
    ),
)

PARAMETERS: Final[dict[int, ParameterDefinition]] = {entry.id: entry for entry in PARAMETER_TABLE}
PARAMETERS_BY_NAME: Final[dict[str, ParameterDefinition]] = {entry.name: entry for entry in PARAMETER_TABLE}
