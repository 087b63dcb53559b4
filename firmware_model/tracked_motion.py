"""The motion of the stars in the windows of tracking: its rate, and where they stood at the frame's time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from .configuration import FirmwareConfiguration
from .frame_log import FrameLog
from .frame_result import FirmwareState, FrameContext
from .image.rolling_shutter import RowTiming
from .image.spots import WindowSpots
from .star_motion import TrackedStars, moved_spots, places_by_rate, rate_of_windows, single_spots
from .star_rate import StarRate
from .tracking import TrackingPlan

__all__ = ["at_frame_time", "tracked_stars", "window_rate"]

FloatArray = npt.NDArray[np.float64]


def _timing(context: FrameContext, configuration: FirmwareConfiguration, interval_ns: int) -> RowTiming:
    exposure_s, rows = context.exposure_ns * 1e-9, configuration.geometry.height_px
    return RowTiming(context.row_time_s, exposure_s, interval_ns * 1e-9, rows)


def tracked_stars(
    found: WindowSpots, plan: TrackingPlan, context: FrameContext, configuration: FirmwareConfiguration
) -> TrackedStars | None:
    """What the next frame measures the rate from: the spots of windows of a single star, in their pixels."""
    if configuration.rate is None:
        return None
    star, spot = single_spots(plan.window, found)
    return TrackedStars(context.frame_index, context.t_mid_ns, plan.star[star], found.spots.take(spot))


def window_rate(
    found: WindowSpots,
    plan: TrackingPlan,
    context: FrameContext,
    state: FirmwareState,
    configuration: FirmwareConfiguration,
    log: FrameLog,
) -> StarRate | None:
    """The rate since the frame processed before, by the spots of windows of a single star."""
    parameters, before = configuration.rate, state.tracked
    if parameters is None or before is None:
        return None
    interval_ns = context.t_mid_ns - before.t_mid_ns
    if not 0 < interval_ns <= configuration.solved_validity_ns:
        return None
    geometry = configuration.geometry
    return log.run(
        "window_rate",
        rate_of_windows,
        before=before,
        star=plan.star,
        window=plan.window,
        found=found,
        timing=_timing(context, configuration, interval_ns),
        geometry=geometry,
        centroid_error=configuration.centroid_error,
        tolerance_px=parameters.tolerance_px,
        min_stars=parameters.min_stars,
    )


def at_frame_time(
    found: WindowSpots,
    measured: StarRate | None,
    context: FrameContext,
    state: FirmwareState,
    configuration: FirmwareConfiguration,
    log: FrameLog,
) -> WindowSpots:
    """The spots of the windows as they stood at the frame's time, where the shutter is a rolling one.

    By the rate measured; where there is none, by the last one known.
    """
    parameters = configuration.rate
    if parameters is None or parameters.compensation == "none" or context.row_time_s == 0.0:
        return found
    geometry = configuration.geometry
    since_ns = state.t_ns if state.tracked is None else state.tracked.t_mid_ns
    change = np.zeros(3)
    if measured is not None:
        rate: FloatArray | None = measured.rate_rad_s
        change = measured.change_rad_s2
    else:
        recent = 0 < context.t_mid_ns - state.rate_t_ns <= configuration.solved_validity_ns
        rate = state.rate_rad_s if recent else None
    if rate is None:
        return found
    places = log.run(
        "places_by_rate",
        places_by_rate,
        x_px=found.spots.x_px,
        y_px=found.spots.y_px,
        rate_rad_s=rate,
        timing=_timing(context, configuration, context.t_mid_ns - since_ns),
        geometry=geometry,
        least_speed_px_s=parameters.least_speed_px_s,
        change_rad_s2=change,
    )
    return replace(found, spots=moved_spots(found.spots, places))
