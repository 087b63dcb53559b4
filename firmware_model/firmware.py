"""One frame through the firmware: pixels in, attitude or its reasons out. All memory is in the state."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from .aberration import apparent_kernel
from .attitude import angular_rate
from .configuration import FirmwareConfiguration, StarTables
from .frame_result import FirmwareState, FrameContext, FrameResult, IdentifiedStars
from .frame_search import ARCSEC_PER_RAD, FrameLog, SearchOutcome, directions, solve, velocity_over_c
from .frame_trace import Trace
from .identification.interface import Spikes
from .identification.judgement import COUNT_NAMES, false_solutions_kernel, spread_kernel
from .image.detection import DetectionParameters, detect
from .image.frame import Frame
from .image.spots import Spots, WindowStatus
from .image.windows import detect_in_windows
from .modes import Mode, ModeEvent
from .reasons import Reason
from .tracking import plan_windows, verify_by_pivot
from .work import Work

__all__ = [
    "FirmwareConfiguration",
    "FirmwareState",
    "FrameContext",
    "FrameResult",
    "IdentifiedStars",
    "StarTables",
    "process_frame",
]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]

_IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
# A merged window gives so many spots more than it has stars, so that a false one does not crowd out a star.
_SPARE_SPOTS = 2


def process_frame(
    frame: Frame,
    context: FrameContext,
    state: FirmwareState,
    configuration: FirmwareConfiguration,
    tables: StarTables,
    trace: Trace | None = None,
) -> FrameResult:
    """Find the attitude of one frame.

    In LOST_IN_SPACE the whole frame is searched and identified; in TRACKING only the windows are looked at.
    TRACKING without a valid attitude to start from is treated as LOST_IN_SPACE.
    trace: called after each step with its record (``frame_trace.py``).
    """
    log = FrameLog(Work({"frames": 1}), trace)
    tracking = context.acquisition is Mode.TRACKING and state.q_icrs_to_sensor is not None
    detection = configuration.detection
    exposure_s = context.exposure_ns * 1e-9
    if detection.exposure_s != exposure_s:
        detection = replace(detection, exposure_s=exposure_s)
    velocity = velocity_over_c(context, configuration, log)
    search = SEARCHES[Mode.TRACKING if tracking else Mode.LOST_IN_SPACE]
    outcome = search(frame, context, state, configuration, tables, detection, velocity, log)
    return _conclude(outcome, tracking, context, state, configuration, log)


def _find(
    frame: Frame,
    context: FrameContext,
    state: FirmwareState,
    configuration: FirmwareConfiguration,
    tables: StarTables,
    detection: DetectionParameters,
    velocity: FloatArray,
    log: FrameLog,
) -> SearchOutcome:
    """Lost in space: the whole frame against the whole catalogue."""
    spots = log.run("detect", detect, image=frame.full(), parameters=detection)
    if spots.background_dn > configuration.blinded_background_dn:
        return SearchOutcome(Reason.BLINDED, spots)
    if spots.overflowed:
        return SearchOutcome(Reason.TOO_MANY_SPOTS, spots)
    used = spots.brightest(configuration.max_spots)
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
    spot = np.flatnonzero(identification.star_index >= 0).astype(np.int32)
    rows = identification.star_index[spot]
    reference = np.empty((len(rows), 3))
    apparent_kernel(tables.catalogue.unit_vectors, rows, velocity, reference)
    log.step(
        "apparent",
        {"unit_vectors": tables.catalogue.unit_vectors, "rows": rows, "velocity": velocity},
        reference,
        Work({"aberrated_stars": len(rows)} if velocity.any() else None),
    )
    outcome = solve(
        b_vectors[spot],
        reference,
        rows,
        spot,
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


def _track(
    frame: Frame,
    context: FrameContext,
    state: FirmwareState,
    configuration: FirmwareConfiguration,
    tables: StarTables,
    detection: DetectionParameters,
    velocity: FloatArray,
    log: FrameLog,
) -> SearchOutcome:
    """Tracking: the windows where the last attitude puts the stars."""
    parameters = configuration.tracking
    geometry = configuration.geometry
    assert state.q_icrs_to_sensor is not None
    interval_s = abs(context.t_mid_ns - state.t_ns) * 1e-9
    exposure_s = context.exposure_ns * 1e-9
    plan = log.run(
        "plan",
        plan_windows,
        q_icrs_to_sensor=state.q_icrs_to_sensor,
        pivot_star=state.pivot,
        catalogue=tables.catalogue,
        geometry=geometry,
        parameters=parameters,
        interval_s=interval_s,
        exposure_s=exposure_s,
        velocity_over_c=velocity,
    )
    if len(plan.star) == 0:
        return SearchOutcome(Reason.TOO_FEW_STARS, Spots.empty(), half_width_px=plan.half_width_px, plan=plan)
    flat, offsets = frame.windows(plan.rects)
    keep = plan.stars_in_windows() + np.int32(_SPARE_SPOTS)
    found = log.run(
        "windows",
        detect_in_windows,
        flat=flat,
        offsets=offsets,
        rects=plan.rects,
        parameters=detection,
        width_px=geometry.width_px,
        height_px=geometry.height_px,
        keep=keep,
    )
    spots = found.spots
    blank = SearchOutcome(Reason.NONE, spots, rects=plan.rects, half_width_px=plan.half_width_px, plan=plan)
    if spots.background_dn > configuration.blinded_background_dn:
        return replace(blank, reasons=Reason.BLINDED)
    b_vectors = directions(spots, configuration, log)
    verification = log.run(
        "verify",
        verify_by_pivot,
        plan=plan,
        found=found,
        b_vectors=b_vectors,
        catalogue=tables.catalogue,
        parameters=parameters,
    )
    if verification.pivot < 0:
        reasons = Reason.PIVOT_LOST
        if verification.found < parameters.min_stars:
            reasons = Reason.TOO_FEW_STARS
        # ASSUMED: where half of the windows cut their spot, the stars are moving out of them all: the rate
        # is too high.
        if 2 * np.count_nonzero(found.status == WindowStatus.CLIPPED) >= len(plan.rects):
            reasons |= Reason.RATE_TOO_HIGH
        return replace(blank, reasons=reasons)
    star = np.flatnonzero(verification.spot >= 0)
    spot = verification.spot[star]
    outcome = solve(
        b_vectors[spot],
        plan.reference[star],
        plan.star[star],
        spot,
        spots,
        configuration,
        tables,
        parameters.tolerance_rad,
        parameters.min_stars,
        log,
    )
    measured = b_vectors[spot]
    chance = false_solutions_kernel(
        len(tables.catalogue),
        len(spots),
        len(outcome.stars),
        spread_kernel(measured, len(spot)),
        parameters.tolerance_rad,
    )
    log.step(
        "false_solutions",
        {
            "stars": len(tables.catalogue),
            "spots": len(spots),
            "matched": len(outcome.stars),
            "b_vectors": measured,
            "tolerance_rad": parameters.tolerance_rad,
        },
        float(chance),
        Work({"false_solutions": 1, "spread_stars": len(spot)}),
    )
    return replace(
        outcome,
        rects=plan.rects,
        half_width_px=plan.half_width_px,
        plan=plan,
        false_solutions=float(chance),
    )


#: How a frame is searched in each mode.
SEARCHES: dict[Mode, Callable[..., SearchOutcome]] = {Mode.LOST_IN_SPACE: _find, Mode.TRACKING: _track}


def _rate_too_high(
    rate_rad_s: FloatArray,
    interval_s: float,
    before_rad2: FloatArray | None,
    now_rad2: FloatArray,
    configuration: FirmwareConfiguration,
    work: Work,
) -> bool:
    """Whether a rate is over the tracking rate by more than the margin and three sigma."""
    rate = math.sqrt(float(rate_rad_s @ rate_rad_s))
    limit = configuration.tracking.rate_rad_s * (1.0 + configuration.tracking.rate_margin)
    if rate <= limit:
        return False
    work.add("rates_over_limit")
    axis = rate_rad_s / rate
    variance = float(axis @ now_rad2 @ axis)
    if before_rad2 is not None:
        variance += float(axis @ before_rad2 @ axis)
    return rate > limit + 3.0 * math.sqrt(variance) / interval_s


def _conclude(
    outcome: SearchOutcome,
    tracking: bool,
    context: FrameContext,
    state: FirmwareState,
    configuration: FirmwareConfiguration,
    log: FrameLog,
) -> FrameResult:
    """Look at the rate, decide on validity and on the next search, and carry the state on."""
    reasons = outcome.reasons
    rate: FloatArray | None = None
    solution = outcome.attitude
    # What is not confirmed says nothing about the rate either: it would make a right attitude look fast.
    if solution is not None and not reasons & Reason.UNCONFIRMED:
        # In tracking the rate is that from the last valid attitude, which the windows are built on; in lost
        # in space that from the last solved one, so that a turn too fast for tracking is seen although
        # nothing was valid.
        before, covariance, t_before = state.q_icrs_to_sensor, state.covariance_rad2, state.t_ns
        if not tracking:
            before, covariance, t_before = state.solved, state.solved_covariance_rad2, state.solved_t_ns
        interval_ns = context.t_mid_ns - t_before
        measured = covariance is not None
        if before is not None and measured and 0 < interval_ns <= configuration.solved_validity_ns:
            interval_s = interval_ns * 1e-9
            rate = angular_rate(before, solution.q_icrs_to_sensor, interval_s)
            rate_work = Work({"rate_solves": 1})
            if _rate_too_high(
                rate, interval_s, covariance, solution.covariance_rad2, configuration, rate_work
            ):
                reasons |= Reason.RATE_TOO_HIGH
            log.step(
                "rate",
                {
                    "before": before,
                    "after": solution.q_icrs_to_sensor,
                    "interval_s": interval_s,
                    "covariance_before_rad2": covariance,
                    "covariance_after_rad2": solution.covariance_rad2,
                    "tracking": configuration.tracking,
                },
                rate,
                rate_work,
            )
        state = replace(
            state,
            solved=solution.q_icrs_to_sensor,
            solved_covariance_rad2=solution.covariance_rad2,
            solved_t_ns=context.t_mid_ns,
        )
    valid = reasons == Reason.NONE
    event: ModeEvent | None = None
    after = Mode.TRACKING
    if valid and solution is not None:
        magnitude = outcome.spots.magnitude[outcome.stars.spot]
        state = replace(
            state,
            q_icrs_to_sensor=solution.q_icrs_to_sensor,
            covariance_rad2=solution.covariance_rad2,
            t_ns=context.t_mid_ns,
            pivot=int(outcome.stars.row[int(np.argmin(magnitude))]),
            missed=0,
        )
        if context.acquisition is Mode.LOST_IN_SPACE:
            event = ModeEvent.ATTITUDE_ACQUIRED
    elif tracking:
        state = replace(state, missed=state.missed + 1)
        if state.missed > configuration.tracking.max_missed:
            after = Mode.LOST_IN_SPACE
            event = ModeEvent.TRACKING_LOST
            state = replace(state, missed=0)
    else:
        after = Mode.LOST_IN_SPACE
        if context.acquisition is Mode.TRACKING:
            event = ModeEvent.TRACKING_LOST
    q = _IDENTITY if state.q_icrs_to_sensor is None else state.q_icrs_to_sensor
    covariance_now = solution.covariance_rad2 if valid and solution is not None else np.zeros((3, 3))
    return FrameResult(
        frame_index=context.frame_index,
        valid=valid,
        reasons=reasons,
        q_icrs_to_sensor=q,
        covariance_rad2=covariance_now,
        rate_rad_s=rate,
        acquisition_after=after,
        event=event,
        spots=outcome.spots,
        stars=outcome.stars,
        residual_rms_arcsec=0.0 if solution is None else solution.residual_rms_rad * ARCSEC_PER_RAD,
        window_half_width_px=outcome.half_width_px,
        work=log.work,
        state=state,
        rects=outcome.rects,
        plan=outcome.plan,
        identification=outcome.identification,
        false_solutions=outcome.false_solutions if valid else math.inf,
    )
