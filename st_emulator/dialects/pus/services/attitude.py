"""The attitude report (130,1) of a frame: what its result says, or that there is none."""

from __future__ import annotations

from typing import Any, Final

from ....device.counters import saturated
from ....device.imaging import microseconds
from ....device.reports import AttitudeReady
from ....device.star_tracker import StarTracker
from ....firmware_model.firmware import FrameResult
from ..time_code import cuc_at, time_status

_ELEMENTS: Final = {"xx": (0, 0), "xy": (0, 1), "xz": (0, 2), "yy": (1, 1), "yz": (1, 2), "zz": (2, 2)}


def attitude_fields(device: StarTracker, report: AttitudeReady) -> dict[str, Any]:
    """The fields of the report of a processed frame, or of a dropped one, at the end of its processing.

    An invalid report repeats the last valid attitude, so that a careless reader sees no jump.
    """
    record, result = report.record, report.record.result
    # not from the time that is told, which may be a wrong one
    latency_us = 0 if result is None else microseconds(device.clock.now_ns - record.exposed_ns)
    mode = device.mode if record.acquisition is None else record.acquisition
    frame: dict[str, Any] = {
        "frame_index": record.index,
        "mid_exposure_time": cuc_at(device, record.mid_exposure_ns),
        "time_status": int(time_status(device)),
        "mode": int(mode),
        "valid": int(result is not None and result.valid),
        "reasons": int(report.reasons),
        "exposure_us": microseconds(record.exposure_ns),
        "cycles": 0 if record.cycles is None else saturated(record.cycles.total, 32),
        "latency_us": saturated(latency_us, 32),
        "late": int(record.late_ns > 0),
        "frames_dropped_before": saturated(record.dropped_before, 16),
    }
    attitude = {f"q_{name}": part for name, part in zip("xyzw", report.q_icrs_to_sensor, strict=True)}
    return frame | attitude | _accuracy(result) | _observation(result)


def _accuracy(result: FrameResult | None) -> dict[str, Any]:
    valid = result if result is not None and result.valid else None
    covariance = {
        f"covariance_{name}": 0.0 if valid is None else float(valid.covariance_rad2[place])
        for name, place in _ELEMENTS.items()
    }
    probability = 1.0 if valid is None else min(1.0, valid.false_solutions)
    return covariance | _rate(result) | {"false_match_probability": probability}


def _rate(result: FrameResult | None) -> dict[str, Any]:
    """The rate and its covariance: what is not known is 0, and flags tell it from a rate of 0."""
    rate = None if result is None else result.rate_rad_s
    covariance = None if result is None or rate is None else result.rate_covariance_rad2_s2
    return {
        "rate_valid": int(rate is not None),
        **{f"rate_{name}": 0.0 if rate is None else float(rate[axis]) for axis, name in enumerate("xyz")},
        "rate_covariance_valid": int(covariance is not None),
        **{
            f"rate_covariance_{name}": 0.0 if covariance is None else float(covariance[place])
            for name, place in _ELEMENTS.items()
        },
    }


def _observation(result: FrameResult | None) -> dict[str, Any]:
    if result is None:
        counts = ("spots_detected", "stars_identified", "windows", "window_half_width_px")
        figures = ("residual_rms_arcsec", "background_dn", "noise_dn")
        return dict.fromkeys(counts, 0) | dict.fromkeys(figures, 0.0)
    return {
        "spots_detected": saturated(result.spots_detected, 16),
        "stars_identified": saturated(len(result.stars), 16),
        "windows": saturated(len(result.rects), 16),
        "window_half_width_px": saturated(result.window_half_width_px, 16),
        "residual_rms_arcsec": float(result.residual_rms_arcsec),
        "background_dn": float(result.background_dn),
        "noise_dn": float(result.noise_dn),
    }
