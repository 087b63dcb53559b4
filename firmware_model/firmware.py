"""One frame through the firmware: pixels in, attitude or its reasons out. All memory is in the state."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from .attitude import angular_rate
from .configuration import FirmwareConfiguration, StarTables
from .frame_log import FrameLog
from .frame_result import FirmwareState, FrameContext, FrameResult, IdentifiedStars
from .frame_search import ARCSEC_PER_RAD, SearchOutcome, directions, solve, velocity_over_c
from .frame_trace import Trace
from .full_frame_search import find, measure_rate
from .identification.judgement import false_solutions_kernel, spread_kernel
from .image.detection import DetectionParameters
from .image.frame import Frame
from .image.spots import Spots, WindowStatus
from .image.windows import detect_in_windows
from .modes import Mode, ModeEvent
from .reasons import Reason
from .tracked_motion import at_frame_time, tracked_stars, window_rate
from .tracking import ahead_by_rate, plan_windows
from .verification import verify_by_pivot
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
    TRACKING without a valid attitude to start from is treated as LOST_IN_SPACE, and so is RATE_ONLY of a unit
    that measures no rate without attitude.
    trace: called after each step with its record (``frame_trace.py``).
    """
    log = FrameLog(Work({"frames": 1}), trace)
    tracking = context.acquisition is Mode.TRACKING and state.q_icrs_to_sensor is not None
    detection = configuration.detection
    exposure_s = context.exposure_ns * 1e-9
    if detection.exposure_s != exposure_s:
        detection = replace(detection, exposure_s=exposure_s)
    velocity = velocity_over_c(context, configuration, log)
    mode = context.acquisition
    if (mode is Mode.TRACKING and not tracking) or (mode is Mode.RATE_ONLY and configuration.rate is None):
        mode = Mode.LOST_IN_SPACE
    outcome = SEARCHES[mode](frame, context, state, configuration, tables, detection, velocity, log)
    return _conclude(outcome, tracking, context, state, configuration, log)


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
    start, planned = state.q_icrs_to_sensor, parameters
    # a rate of the same frame as the attitude: it leads on from there
    rate, covariance = state.rate_rad_s, state.rate_covariance_rad2_s2
    known = rate is not None and covariance is not None and state.rate_t_ns == state.t_ns
    if parameters.windows_by_rate and known:
        assert rate is not None
        assert covariance is not None
        start, planned = ahead_by_rate(
            start,
            rate,
            covariance,
            parameters,
            geometry,
            interval_s,
            context.row_time_s * (geometry.height_px - 1),
            exposure_s,
        )
    plan = log.run(
        "plan",
        plan_windows,
        q_icrs_to_sensor=start,
        pivot_star=state.pivot,
        catalogue=tables.catalogue,
        geometry=geometry,
        parameters=planned,
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
    measured_rate = window_rate(found, plan, context, state, configuration, log)
    tracked = tracked_stars(found, plan, context, configuration)
    found = at_frame_time(found, measured_rate, context, state, configuration, log)
    spots = found.spots
    blank = SearchOutcome(
        Reason.NONE,
        spots,
        rects=plan.rects,
        half_width_px=plan.half_width_px,
        plan=plan,
        tracked=tracked,
        star_rate=measured_rate,
    )
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
        tracked=tracked,
        star_rate=measured_rate,
        false_solutions=float(chance),
    )


#: How a frame is searched in each mode.
SEARCHES: dict[Mode, Callable[..., SearchOutcome]] = {
    Mode.LOST_IN_SPACE: find,
    Mode.TRACKING: _track,
    Mode.RATE_ONLY: measure_rate,
}


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


def _too_fast(
    rate_rad_s: FloatArray,
    covariance_rad2_s2: FloatArray,
    configuration: FirmwareConfiguration,
    log: FrameLog,
) -> bool:
    """Whether a rate is over the tracking rate by more than the margin and three of its sigmas."""
    rate = math.sqrt(float(rate_rad_s @ rate_rad_s))
    limit = configuration.tracking.rate_rad_s * (1.0 + configuration.tracking.rate_margin)
    if rate <= limit:
        return False
    axis = rate_rad_s / rate
    over = rate > limit + 3.0 * math.sqrt(float(axis @ covariance_rad2_s2 @ axis))
    arguments = {"rate_rad_s": rate_rad_s, "covariance_rad2_s2": covariance_rad2_s2, "limit_rad_s": limit}
    log.step("rate_limit", arguments, over, Work({"rates_over_limit": 1}))
    return over


def _with_rate(
    state: FirmwareState,
    rate: FloatArray | None,
    covariance: FloatArray | None,
    context: FrameContext,
    outcome: SearchOutcome,
) -> FirmwareState:
    """The state with what this frame leaves of its rate and its spots."""
    state = replace(state, previous=outcome.kept, tracked=outcome.tracked)
    if rate is None:
        return state
    return replace(state, rate_rad_s=rate, rate_covariance_rad2_s2=covariance, rate_t_ns=context.t_mid_ns)


def _without_attitude(
    mode: Mode, rate: FloatArray | None, state: FirmwareState, configuration: FirmwareConfiguration
) -> tuple[FirmwareState, Mode, ModeEvent | None]:
    """State, next search and event of a full frame without a valid attitude: LOST_IN_SPACE or RATE_ONLY.

    ASSUMED: only rates that are too high to track lead to RATE_ONLY. A unit that stands still before a sky it
    does not know would else go to and fro between the two modes.
    """
    assert configuration.rate is not None
    slow = rate is not None and float(rate @ rate) < configuration.tracking.rate_rad_s**2
    if mode is Mode.RATE_ONLY:
        if slow:
            return replace(state, fast=0), Mode.LOST_IN_SPACE, ModeEvent.SLOW_AGAIN
        return state, Mode.RATE_ONLY, None
    fast = state.fast + 1 if rate is not None and not slow else 0
    if fast < configuration.rate.frames_to_rate_only:
        return replace(state, fast=fast), Mode.LOST_IN_SPACE, None
    return replace(state, fast=0), Mode.RATE_ONLY, ModeEvent.RATE_ALONE


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
    rate_covariance: FloatArray | None = None
    rate_unknown = False
    solution = outcome.attitude
    # What is not confirmed says nothing about the rate either: it would make a right attitude look fast.
    if solution is not None and not reasons & Reason.UNCONFIRMED:
        # In tracking the rate is that from the last valid attitude, which the windows are built on; in lost
        # in space that from the last solved one, so that a turn too fast for tracking is seen although
        # nothing was valid. A unit that measures the rate of stars takes that one: it is of the frame before,
        # whenever the last attitude was, and free of what is wrong with two attitudes.
        before, covariance, t_before = state.q_icrs_to_sensor, state.covariance_rad2, state.t_ns
        if not tracking:
            before, covariance, t_before = state.solved, state.solved_covariance_rad2, state.solved_t_ns
        interval_ns = context.t_mid_ns - t_before
        if (
            before is not None
            and covariance is not None
            and outcome.star_rate is None
            and 0 < interval_ns <= configuration.solved_validity_ns
        ):
            interval_s = interval_ns * 1e-9
            rate = angular_rate(before, solution.q_icrs_to_sensor, interval_s)
            rate_covariance = (covariance + solution.covariance_rad2) / interval_s**2
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
        # Of a unit that measures the rate of stars it is since the frame before, not since any other.
        # ASSUMED: after it was lost once, tracking waits for it: a unit that turns too fast would else go to
        # and fro. The first attitude of all is taken for one at rest.
        rate_unknown = rate is None and outcome.star_rate is None and state.solved is not None
        if configuration.rate is not None and (not tracking or state.missed > 0):
            rate = rate_covariance = None
        state = replace(
            state,
            solved=solution.q_icrs_to_sensor,
            solved_covariance_rad2=None if outcome.still_assumed else solution.covariance_rad2,
            solved_t_ns=context.t_mid_ns,
        )
    if rate is None and outcome.star_rate is not None:
        rate, rate_covariance = outcome.star_rate.rate_rad_s, outcome.star_rate.covariance_rad2_s2
        if solution is not None and _too_fast(rate, rate_covariance, configuration, log):
            reasons |= Reason.RATE_TOO_HIGH
        # Faster than the windows are made for, their sides cut streaks, all on the same side: the rate is too
        # high, but it is not this one; and where no attitude fits the spots of the windows, nor need they be
        # the stars'.
        most = configuration.tracking.rate_rad_s * (1.0 + configuration.tracking.rate_margin)
        cut = float(rate @ rate) > most * most
        if tracking and solution is not None and cut:
            reasons |= Reason.RATE_TOO_HIGH
        if tracking and (solution is None or cut):
            rate = rate_covariance = None
    valid = reasons == Reason.NONE
    if configuration.rate is not None:
        state = _with_rate(state, rate, rate_covariance, context, outcome)
    event: ModeEvent | None = None
    after = Mode.TRACKING
    if valid and solution is not None:
        magnitude = outcome.spots.magnitude[outcome.stars.spot]
        state = replace(
            state,
            q_icrs_to_sensor=solution.q_icrs_to_sensor,
            covariance_rad2=None if outcome.still_assumed else solution.covariance_rad2,
            t_ns=context.t_mid_ns,
            pivot=int(outcome.stars.row[int(np.argmin(magnitude))]),
            missed=0,
            fast=0,
        )
        if outcome.still_assumed or (rate_unknown and not tracking and configuration.rate is not None):
            # The next image says how fast the unit turns; tracking begins with an attitude that knows it.
            after = context.acquisition if context.acquisition is Mode.RATE_ONLY else Mode.LOST_IN_SPACE
        elif context.acquisition in (Mode.LOST_IN_SPACE, Mode.RATE_ONLY):
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
        elif configuration.rate is not None:
            state, after, event = _without_attitude(context.acquisition, rate, state, configuration)
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
        rate_covariance_rad2_s2=rate_covariance,
    )
