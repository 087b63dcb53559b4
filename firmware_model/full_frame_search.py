"""Searches of a whole frame: lost in space, and by the rate alone while the unit turns too fast for more."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from .aberration import apparent_kernel
from .configuration import FirmwareConfiguration, StarTables
from .frame_log import FrameLog
from .frame_result import FirmwareState, FrameContext
from .frame_search import SearchOutcome, directions, solve
from .identification.interface import Spikes
from .identification.judgement import COUNT_NAMES
from .image.detection import DetectionParameters, detect, detect_clusters
from .image.frame import Frame
from .image.optical_flow import light_up
from .image.rolling_shutter import RowTiming, compensate
from .image.spots import Spots
from .image.streaks import StreakTable, fuse, streak_table
from .rate_from_flow import FlowRate, rate_by_flow
from .reasons import Reason
from .star_motion import (
    KeptFrame,
    RateParameters,
    StarMotion,
    TrackedStars,
    moved_spots,
    places_by_rate,
    rate_of_fusion,
)
from .work import Work

__all__ = ["find", "measure_rate"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]


def find(
    frame: Frame,
    context: FrameContext,
    state: FirmwareState,
    configuration: FirmwareConfiguration,
    tables: StarTables,
    detection: DetectionParameters,
    velocity: FloatArray,
    log: FrameLog,
) -> SearchOutcome:
    """Lost in space: the whole frame against the whole catalogue.

    With ``configuration.rate`` the spots are first compared with those of the frame directly before: those
    that are no star in both are left out (paper M, section 2.3), and the others stand where they were at the
    frame's time. Where there is no such frame, all of them as they are.
    """
    if configuration.rate is None:
        spots = log.run("detect", detect, image=frame.full(), parameters=detection)
        refused = _refused(spots, configuration)
        if refused:
            return SearchOutcome(refused, spots)
        every = np.arange(min(len(spots), configuration.max_spots), dtype=np.int32)
        return identify_spots(spots, every, configuration, tables, velocity, log)
    return _find_moving(frame, context, state, configuration, tables, detection, velocity, log, math.inf)


def measure_rate(
    frame: Frame,
    context: FrameContext,
    state: FirmwareState,
    configuration: FirmwareConfiguration,
    tables: StarTables,
    detection: DetectionParameters,
    velocity: FloatArray,
    log: FrameLog,
) -> SearchOutcome:
    """Turning fast: the rate from frame to frame; the attitude too where the rate is low enough or not known.

    The reason of an attitude that is not tried is RATE_TOO_HIGH.
    """
    if configuration.rate is None:
        return find(frame, context, state, configuration, tables, detection, velocity, log)
    most = configuration.rate.identify_below_rad_s
    return _find_moving(frame, context, state, configuration, tables, detection, velocity, log, most)


def _find_moving(
    frame: Frame,
    context: FrameContext,
    state: FirmwareState,
    configuration: FirmwareConfiguration,
    tables: StarTables,
    detection: DetectionParameters,
    velocity: FloatArray,
    log: FrameLog,
    identify_below_rad_s: float,
) -> SearchOutcome:
    assert configuration.rate is not None
    image = frame.full()
    if configuration.rate.flow is not None:
        return _find_flowing(
            image, context, state, configuration, tables, detection, velocity, log, identify_below_rad_s
        )
    detected, work = detect_clusters(image, detection)
    log.step("detect", {"image": image, "parameters": detection}, detected.spots, work)
    refused = _refused(detected.spots, configuration)
    if refused:
        return SearchOutcome(refused, detected.spots)
    now = log.run("keep_runs", streak_table, detected=detected)
    kept = KeptFrame(context.frame_index, context.t_mid_ns, now)
    motion = star_motion_of(now, context, state.previous, configuration, configuration.rate, log)
    rate = motion.rate
    if rate is not None and math.sqrt(float(rate.rate_rad_s @ rate.rate_rad_s)) >= identify_below_rad_s:
        return SearchOutcome(Reason.RATE_TOO_HIGH, motion.spots, kept=kept, star_rate=rate)
    # ASSUMED: under a rolling shutter a single image of streaks gives no attitude, as paper M needs two to
    # compensate; one of spots gives it as if at rest, so that a unit that stands still loses nothing.
    still_assumed = motion.fused is None and context.row_time_s > 0.0
    if still_assumed and detected.streaks:
        return SearchOutcome(Reason.RATE_TOO_HIGH, motion.spots, kept=kept)
    stars = np.arange(len(motion.spots), dtype=np.int32) if motion.fused is None else motion.fused
    stars = stars[: configuration.max_spots]
    outcome = identify_spots(motion.spots, stars, configuration, tables, velocity, log)
    known = _known_stars(outcome, now.spots, context)
    return replace(outcome, kept=kept, tracked=known, star_rate=rate, still_assumed=still_assumed)


def _find_flowing(
    image: npt.NDArray[np.uint16],
    context: FrameContext,
    state: FirmwareState,
    configuration: FirmwareConfiguration,
    tables: StarTables,
    detection: DetectionParameters,
    velocity: FloatArray,
    log: FrameLog,
    identify_below_rad_s: float,
) -> SearchOutcome:
    """The rate by optical flow; the attitude of the same image by detection and identification as at rest."""
    assert configuration.rate is not None
    assert configuration.rate.flow is not None
    parameters, previous = configuration.rate.flow, state.previous
    now = log.run("flow_light", light_up, image=image, parameters=parameters)
    rate: FlowRate | None = None
    interval_s = 0.0 if previous is None else (context.t_mid_ns - previous.t_mid_ns) * 1e-9
    follows = previous is not None and previous.frame_index == context.frame_index - 1 and interval_s > 0.0
    if previous is not None and previous.flow is not None and follows:
        _, rate = rate_by_flow(
            previous.flow,
            now,
            interval_s,
            context.exposure_ns * 1e-9,
            configuration.geometry,
            parameters,
            configuration.rate.flow_settings,
            previous.flow_rate,
            log,
        )
    kept = KeptFrame(context.frame_index, context.t_mid_ns, flow=now, flow_rate=rate)
    if rate is not None and math.sqrt(float(rate.rate_rad_s @ rate.rate_rad_s)) >= identify_below_rad_s:
        blank = Spots.empty(now.mean_dn, now.sigma_dn)
        return SearchOutcome(Reason.RATE_TOO_HIGH, blank, kept=kept, star_rate=rate)
    spots = log.run("detect", detect, image=image, parameters=detection)
    refused = _refused(spots, configuration)
    if refused:
        return SearchOutcome(refused, spots, kept=kept, star_rate=rate)
    stars = np.arange(min(len(spots), configuration.max_spots), dtype=np.int32)
    outcome = identify_spots(spots, stars, configuration, tables, velocity, log)
    return replace(outcome, kept=kept, tracked=_known_stars(outcome, spots, context), star_rate=rate)


def _known_stars(outcome: SearchOutcome, spots: Spots, context: FrameContext) -> TrackedStars:
    """The identified stars where the image shows them, for the rate of the first frame of tracking."""
    row, spot = outcome.stars.row, outcome.stars.spot
    return TrackedStars(context.frame_index, context.t_mid_ns, row, spots.take(spot))


def star_motion_of(
    now: StreakTable,
    context: FrameContext,
    previous: KeptFrame | None,
    configuration: FirmwareConfiguration,
    parameters: RateParameters,
    log: FrameLog,
) -> StarMotion:
    """Fusion with the frame before, rate, and the spots at the frame's time."""
    if previous is None or previous.table is None or previous.frame_index != context.frame_index - 1:
        return StarMotion(now.spots, None, None)
    interval_s = (context.t_mid_ns - previous.t_mid_ns) * 1e-9
    if interval_s <= 0.0:
        return StarMotion(now.spots, None, None)
    geometry = configuration.geometry
    timing = RowTiming(context.row_time_s, context.exposure_ns * 1e-9, interval_s, geometry.height_px)
    fusion = log.run("fuse", fuse, before=previous.table, now=now, distance_px=parameters.fusion_distance_px)
    rate = log.run(
        "star_rate",
        rate_of_fusion,
        before=previous.table,
        now=now,
        fusion=fusion,
        timing=timing,
        geometry=geometry,
        centroid_error=configuration.centroid_error,
        tolerance_px=parameters.tolerance_px,
        min_stars=parameters.min_stars,
    )
    fused = fusion.now if rate is None else fusion.now[rate.kept]
    method = parameters.compensation
    if method == "rate" and rate is not None:
        places = log.run(
            "places_by_rate",
            places_by_rate,
            x_px=now.spots.x_px,
            y_px=now.spots.y_px,
            rate_rad_s=rate.rate_rad_s,
            timing=timing,
            geometry=geometry,
            least_speed_px_s=parameters.least_speed_px_s,
            change_rad_s2=rate.change_rad_s2,
        )
    else:
        places = log.run(
            "compensate",
            compensate,
            before=previous.table,
            now=now,
            fusion=fusion,
            timing=timing,
            method="displacement" if method == "rate" else method,
            least_speed_px_s=parameters.least_speed_px_s,
        )
    return StarMotion(moved_spots(now.spots, places), fused, rate, interval_s)


def _refused(spots: Spots, configuration: FirmwareConfiguration) -> Reason:
    """Why the image as a whole is of no use; NONE: it is."""
    if spots.background_dn > configuration.blinded_background_dn:
        return Reason.BLINDED
    return Reason.TOO_MANY_SPOTS if spots.overflowed else Reason.NONE


def identify_spots(
    spots: Spots,
    place: IntArray,
    configuration: FirmwareConfiguration,
    tables: StarTables,
    velocity: FloatArray,
    log: FrameLog,
) -> SearchOutcome:
    """Identification and attitude of the spots at the places ``place``, brightest first."""
    used = spots.take(place)
    b_vectors = directions(used, configuration, log)
    parameters = configuration.identification
    budget = configuration.cycle_budget
    if budget is not None:
        parameters = replace(
            parameters,
            max_cycles=budget.for_search(log.work),
            count_cycles=np.array(budget.processor.costs(COUNT_NAMES)),
        )
    spikes = Spikes(b_vectors, used.magnitude)
    identification, identification_work = configuration.identify(spikes, tables, parameters)
    log.step(
        "identify",
        {
            "algorithm": configuration.identify,
            "spikes": spikes,
            "tables": tables,
            "parameters": parameters,
        },
        identification,
        identification_work,
    )
    if not identification.identified:
        return SearchOutcome(identification.reason, spots, identification=identification)
    found = np.flatnonzero(identification.star_index >= 0).astype(np.int32)
    rows = identification.star_index[found]
    reference = np.empty((len(rows), 3))
    apparent_kernel(tables.catalogue.unit_vectors, rows, velocity, reference)
    log.step(
        "apparent",
        {"unit_vectors": tables.catalogue.unit_vectors, "rows": rows, "velocity": velocity},
        reference,
        Work({"aberrated_stars": len(rows)} if velocity.any() else None),
    )
    outcome = solve(
        b_vectors[found],
        reference,
        rows,
        place[found],
        spots,
        configuration,
        tables,
        configuration.identification.tolerance_rad,
        min(configuration.identification.min_stars, len(rows)),
        log,
    )
    return replace(
        outcome,
        reasons=outcome.reasons | identification.reason,
        identification=identification,
        false_solutions=identification.false_solutions,
    )
