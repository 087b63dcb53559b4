"""An attitude report as numbers to compute with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..protocol.pus.enumerations import Mode, Reason


@dataclass(frozen=True)
class Attitude:
    """One attitude report (130,1); `mode` is a plain number when this interface has no name for it.

    time_ns: middle of the exposure, on-board TAI ns since 1958-01-01. q_icrs_to_sensor: float64[4], x y z w
    (scalar last), v_sensor = A(q) v_icrs. covariance_rad2: float64[3, 3] of the small-angle error in sensor
    axes. rate_rad_s: float64[3], sensor relative to ICRS in sensor axes, None when the unit says it is not
    valid; it may be valid where the attitude is not. rate_covariance_rad2_s2: float64[3, 3] of its error in
    sensor axes, None when the unit says it is not valid, and from a unit that does not send it.
    false_match_probability: that the stars were matched by chance, as the unit tells it; 1 where not valid.
    """

    time_ns: int
    frame_index: int
    mode: Mode | int
    valid: bool
    reasons: Reason
    q_icrs_to_sensor: NDArray[np.float64]
    covariance_rad2: NDArray[np.float64]
    rate_rad_s: NDArray[np.float64] | None
    spots_detected: int
    stars_identified: int
    window_half_width_px: int
    residual_rms_arcsec: float
    cycles: int
    latency_us: int
    late: bool
    false_match_probability: float
    received_ns: int
    rate_covariance_rad2_s2: NDArray[np.float64] | None = None

    @classmethod
    def from_fields(cls, fields: Mapping[str, Any], received_ns: int) -> Attitude:
        """From the decoded fields of an attitude report, whole or as an older unit sends it."""
        told = fields["rate_valid"] and fields.get("rate_covariance_valid", 0)
        mode = Mode(fields["mode"]) if fields["mode"] in Mode.__members__.values() else int(fields["mode"])
        rate = np.array([fields[f"rate_{axis}"] for axis in "xyz"], dtype=np.float64)
        return cls(
            time_ns=fields["mid_exposure_time"].to_ns(),
            frame_index=fields["frame_index"],
            mode=mode,
            valid=bool(fields["valid"]),
            reasons=Reason(fields["reasons"]),
            q_icrs_to_sensor=np.array([fields[f"q_{axis}"] for axis in "xyzw"], dtype=np.float64),
            covariance_rad2=_symmetric(fields, "covariance"),
            rate_rad_s=rate if fields["rate_valid"] else None,
            spots_detected=fields["spots_detected"],
            stars_identified=fields["stars_identified"],
            window_half_width_px=fields["window_half_width_px"],
            residual_rms_arcsec=fields["residual_rms_arcsec"],
            cycles=fields["cycles"],
            latency_us=fields["latency_us"],
            late=bool(fields["late"]),
            false_match_probability=fields["false_match_probability"],
            received_ns=received_ns,
            rate_covariance_rad2_s2=_symmetric(fields, "rate_covariance") if told else None,
        )

    @property
    def rate_sigma_rad_s(self) -> NDArray[np.float64] | None:
        """float64[3], 1 sigma of the rate about each sensor axis; NaN where a variance is negative. None
        without a covariance.
        """
        if self.rate_covariance_rad2_s2 is None:
            return None
        with np.errstate(invalid="ignore"):
            return np.sqrt(np.diagonal(self.rate_covariance_rad2_s2))

    @property
    def pointing_deg(self) -> tuple[float, float, float]:
        """As of `pointing_deg` below."""
        return pointing_deg(self.q_icrs_to_sensor)


def _symmetric(fields: Mapping[str, Any], name: str) -> NDArray[np.float64]:
    """The matrix of whose upper triangle the fields ``name``_xx to ``name``_zz are."""
    rows = [[fields[f"{name}_{min(a, b)}{max(a, b)}"] for b in "xyz"] for a in "xyz"]
    return np.array(rows, dtype=np.float64)


def pointing_deg(q_icrs_to_sensor: NDArray[np.float64]) -> tuple[float, float, float]:
    """Right ascension and declination of the boresight, roll (position angle of image up, -Y), degrees.

    The rows of A(q) are the sensor's axes in ICRS. Roll counts from north through east, 0 to 360.
    """
    x, y, z, w = q_icrs_to_sensor
    boresight = np.array([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)])
    up = -np.array([2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)])
    ra = np.arctan2(boresight[1], boresight[0])
    dec = np.arctan2(boresight[2], np.hypot(boresight[0], boresight[1]))
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    north = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    roll = np.arctan2(up @ east, up @ north)
    return float(np.degrees(ra) % 360.0), float(np.degrees(dec)), float(np.degrees(roll) % 360.0)
