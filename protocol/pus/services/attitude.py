"""Service 130: attitude (mission-specific)."""

from __future__ import annotations

from ..enumerations import Mode, Reason, TimeStatus
from ..field_types import CUC, FLOAT32, FLOAT64, UINT8, UINT16, UINT32
from ..fields import Field
from ..messages import MessageDefinition, ServiceDefinition

_COVARIANCE = "covariance of the small-angle attitude error, sensor axes, "
_RATE = "mean angular rate of the sensor frame relative to ICRS, sensor axes, "
_RATE_COVARIANCE = "covariance of the error of the rate, sensor axes, "

SERVICE = ServiceDefinition(
    130,
    "Attitude",
    "",
    "The product of the unit: one report per frame while parameter attitude_report is 1.",
    (
        MessageDefinition(
            "TM",
            130,
            1,
            "attitude_report",
            "Attitude report",
            "",
            "Attitude at mid-exposure of one frame, with what it rests on and what it cost. While the time "
            "is FREE_RUNNING stellar aberration is not corrected and the attitude is off by up to 20.5 "
            "arcsec, which the covariance does not contain; the velocity about the Earth, which parameters "
            "14 to 16 give, makes up to 5 arcsec more. The report of a dropped frame may come before that "
            "of the late frame that caused it: frame_index orders them. The rate has a validity of its own: "
            "in mode RATE_ONLY it is all that is known. It is the mean from the mid-exposure of the frame "
            "processed before to that of this one: the turn between the two attitudes over the time between "
            "them. A unit that measures no rate of stars gives it from the last valid attitude on, in "
            "LOST_IN_SPACE from the last one solved. A rate that jumps within an exposure counts for as "
            "much of it as it lasts. Where the attitude is not valid the last valid one is repeated; a "
            "covariance or rate that is not valid is sent as 0.",
            (
                Field("frame_index", UINT32, meaning="index of the frame, from 0 at power-on"),
                Field(
                    "mid_exposure_time",
                    CUC,
                    meaning="on-board time of mid-exposure: the time of the attitude",
                ),
                Field("time_status", UINT8, meaning="time reference status", choices=TimeStatus),
                Field("mode", UINT8, meaning="mode in which the frame was processed", choices=Mode),
                Field("valid", UINT8, "", 0, 1, "1: quaternion and covariance are valid"),
                Field(
                    "reasons", UINT32, meaning="why the attitude is not valid; 0 when it is", choices=Reason
                ),
                Field("q_x", FLOAT64, meaning="q_icrs_to_sensor, vector part x"),
                Field("q_y", FLOAT64, meaning="q_icrs_to_sensor, vector part y"),
                Field("q_z", FLOAT64, meaning="q_icrs_to_sensor, vector part z"),
                Field("q_w", FLOAT64, meaning="q_icrs_to_sensor, scalar part, 0 or positive"),
                Field("covariance_xx", FLOAT32, "rad^2", meaning=_COVARIANCE + "xx"),
                Field("covariance_xy", FLOAT32, "rad^2", meaning=_COVARIANCE + "xy"),
                Field("covariance_xz", FLOAT32, "rad^2", meaning=_COVARIANCE + "xz"),
                Field("covariance_yy", FLOAT32, "rad^2", meaning=_COVARIANCE + "yy"),
                Field("covariance_yz", FLOAT32, "rad^2", meaning=_COVARIANCE + "yz"),
                Field("covariance_zz", FLOAT32, "rad^2", meaning=_COVARIANCE + "zz"),
                Field("rate_valid", UINT8, "", 0, 1, "1: the rate is valid, also where the attitude is not"),
                Field("rate_x", FLOAT32, "rad/s", meaning=_RATE + "x"),
                Field("rate_y", FLOAT32, "rad/s", meaning=_RATE + "y"),
                Field("rate_z", FLOAT32, "rad/s", meaning=_RATE + "z"),
                Field("spots_detected", UINT16, meaning="spots found in the frame or its windows"),
                Field("stars_identified", UINT16, meaning="of those, stars that the attitude rests on"),
                Field("windows", UINT16, meaning="detection windows read; 0: the whole frame"),
                Field(
                    "window_half_width_px", UINT16, "px", meaning="half-width of a window; 0: the whole frame"
                ),
                Field(
                    "residual_rms_arcsec",
                    FLOAT32,
                    "arcsec",
                    meaning="rms of the angles between measured and catalogue directions",
                ),
                Field("background_dn", FLOAT32, "DN", meaning="mean background"),
                Field("noise_dn", FLOAT32, "DN", meaning="standard deviation of the background"),
                Field("exposure_us", UINT32, "us", meaning="exposure time"),
                Field("cycles", UINT32, "cycle", meaning="processor cycles used by the frame"),
                Field(
                    "latency_us",
                    UINT32,
                    "us",
                    meaning="from mid-exposure to the end of processing; 0: not processed",
                ),
                Field("late", UINT8, "", 0, 1, "1: the frame overran its budget"),
                Field(
                    "frames_dropped_before", UINT16, meaning="frames dropped in a row just before this one"
                ),
                Field(
                    "false_match_probability",
                    FLOAT32,
                    "",
                    0.0,
                    1.0,
                    "attitudes over the whole sky that chance would let fit the spots as well, at most 1; 1 "
                    "where the attitude is not valid",
                ),
                Field("rate_covariance_valid", UINT8, "", 0, 1, "1: the covariance of the rate is valid"),
                *(
                    Field(f"rate_covariance_{axes}", FLOAT32, "(rad/s)^2", meaning=_RATE_COVARIANCE + axes)
                    for axes in ("xx", "xy", "xz", "yy", "yz", "zz")
                ),
            ),
            earlier_ends=("false_match_probability",),
            tailoring="Mission-specific service.",
        ),
    ),
)
