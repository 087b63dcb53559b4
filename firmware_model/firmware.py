"""One frame through the firmware: pixels in, attitude or its reasons out. All memory is in the state."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from .aberration import SPEED_OF_LIGHT_KM_S, apparent_kernel, earth_velocity_km_s
from .attitude import AttitudeSolution, angular_rate, robust_q_method
from .configuration import FirmwareConfiguration, StarTables
from .frame_result import NO_RECTS, FirmwareState, FrameContext, FrameResult, IdentifiedStars
from .identification.interface import Identification, Spikes
from .identification.verification import COUNT_NAMES, false_solutions_kernel, spread_kernel
from .image.detection import DetectionParameters, detect
from .image.frame import Frame
from .image.spots import Spots, WindowStatus
from .image.windows import detect_in_windows
from .modes import Mode, ModeEvent
from .reasons import Reason
from .tracking import TrackingPlan, plan_windows, verify_by_pivot
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
_NO_VELOCITY = np.zeros(3)
_ARCSEC_PER_RAD = math.degrees(1.0) * 3600.0
# A merged window gives so many spots more than it has stars, so that a false one does not crowd out a star.
_SPARE_SPOTS = 2


@dataclass(frozen=True)
class _Outcome:
    """What a search found, before the rate and the history are looked at."""

    reasons: Reason
    spots: Spots
    stars: IdentifiedStars = field(default_factory=IdentifiedStars.none)
    attitude: AttitudeSolution | None = None
    rects: IntArray = field(default_factory=lambda: NO_RECTS)
    half_width_px: int = 0
    plan: TrackingPlan | None = None
    identification: Identification | None = None
    false_solutions: float = math.inf


def process_frame(
    frame: Frame,
    context: FrameContext,
    state: FirmwareState,
    configuration: FirmwareConfiguration,
    tables: StarTables,
) -> FrameResult:
    """Find the attitude of one frame.

    In LOST_IN_SPACE the whole frame is searched and identified; in TRACKING only the windows are looked at.
    TRACKING without a valid attitude to start from is treated as LOST_IN_SPACE.
    """
    work = Work({"frames": 1})
    tracking = context.acquisition is Mode.TRACKING and state.q_icrs_to_sensor is not None
    detection = configuration.detection
    exposure_s = context.exposure_ns * 1e-9
    if detection.exposure_s != exposure_s:
        detection = replace(detection, exposure_s=exposure_s)
    velocity = _velocity_over_c(context, configuration, work)
    if tracking:
        outcome = _track(frame, context, state, configuration, tables, detection, velocity, work)
    else:
        outcome = _find(frame, configuration, tables, detection, velocity, work)
    return _conclude(outcome, tracking, context, state, configuration, work)


def _velocity_over_c(context: FrameContext, configuration: FirmwareConfiguration, work: Work) -> FloatArray:
    if not configuration.aberration_correction or context.tai_ns is None:
        return _NO_VELOCITY
    work.add("observer_velocities")
    velocity = earth_velocity_km_s(context.tai_ns) + np.array(configuration.velocity_km_s)
    return np.asarray(velocity / SPEED_OF_LIGHT_KM_S)


def _find(
    frame: Frame,
    configuration: FirmwareConfiguration,
    tables: StarTables,
    detection: DetectionParameters,
    velocity: FloatArray,
    work: Work,
) -> _Outcome:
    """Lost in space: the whole frame against the whole catalogue."""
    spots, detection_work = detect(frame.full(), detection)
    work += detection_work
    if spots.background_dn > configuration.blinded_background_dn:
        return _Outcome(Reason.BLINDED, spots)
    if spots.overflowed:
        return _Outcome(Reason.TOO_MANY_SPOTS, spots)
    used = spots.brightest(configuration.max_spots)
    b_vectors = configuration.geometry.unit_vectors(used.x_px, used.y_px)
    work.add("unit_vectors", len(used))
    if configuration.geometry.distorted:
        work.add("distortions_removed", len(used))
    parameters = configuration.identification
    budget = configuration.cycle_budget
    if budget is not None:
        parameters = replace(
            parameters,
            max_cycles=budget.for_search(work),
            count_cycles=np.array(budget.processor.costs(COUNT_NAMES)),
        )
    identification, identification_work = configuration.identify(
        Spikes(b_vectors, used.magnitude), tables, parameters
    )
    work += identification_work
    if not identification.identified:
        return _Outcome(identification.reason, spots, identification=identification)
    spot = np.flatnonzero(identification.star_index >= 0).astype(np.int32)
    rows = identification.star_index[spot]
    reference = np.empty((len(rows), 3))
    apparent_kernel(tables.catalogue.unit_vectors, rows, velocity, reference)
    if velocity.any():
        work.add("aberrated_stars", len(rows))
    outcome = _solve(
        b_vectors[spot],
        reference,
        rows,
        spot,
        spots,
        configuration,
        tables,
        configuration.identification.tolerance_rad,
        min(configuration.identification.min_stars, len(rows)),
        work,
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
    work: Work,
) -> _Outcome:
    """Tracking: the windows where the last attitude puts the stars."""
    parameters = configuration.tracking
    geometry = configuration.geometry
    assert state.q_icrs_to_sensor is not None
    plan, plan_work = plan_windows(
        state.q_icrs_to_sensor,
        state.pivot,
        tables.catalogue,
        geometry,
        parameters,
        abs(context.t_mid_ns - state.t_ns) * 1e-9,
        context.exposure_ns * 1e-9,
        velocity,
    )
    work += plan_work
    if len(plan.star) == 0:
        return _Outcome(Reason.TOO_FEW_STARS, Spots.empty(), half_width_px=plan.half_width_px, plan=plan)
    flat, offsets = frame.windows(plan.rects)
    found, window_work = detect_in_windows(
        flat,
        offsets,
        plan.rects,
        detection,
        width_px=geometry.width_px,
        height_px=geometry.height_px,
        keep=plan.stars_in_windows() + np.int32(_SPARE_SPOTS),
    )
    work += window_work
    spots = found.spots
    blank = _Outcome(Reason.NONE, spots, rects=plan.rects, half_width_px=plan.half_width_px, plan=plan)
    if spots.background_dn > configuration.blinded_background_dn:
        return replace(blank, reasons=Reason.BLINDED)
    b_vectors = geometry.unit_vectors(spots.x_px, spots.y_px)
    work.add("unit_vectors", len(spots))
    if geometry.distorted:
        work.add("distortions_removed", len(spots))
    verification, verification_work = verify_by_pivot(plan, found, b_vectors, tables.catalogue, parameters)
    work += verification_work
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
    outcome = _solve(
        b_vectors[spot],
        plan.reference[star],
        plan.star[star],
        spot,
        spots,
        configuration,
        tables,
        parameters.tolerance_rad,
        parameters.min_stars,
        work,
    )
    chance = false_solutions_kernel(
        len(tables.catalogue),
        len(spots),
        len(outcome.stars),
        spread_kernel(b_vectors[spot], len(spot)),
        parameters.tolerance_rad,
    )
    return replace(
        outcome,
        rects=plan.rects,
        half_width_px=plan.half_width_px,
        plan=plan,
        false_solutions=float(chance),
    )


def _solve(
    measured: FloatArray,
    reference: FloatArray,
    rows: IntArray,
    spot: IntArray,
    spots: Spots,
    configuration: FirmwareConfiguration,
    tables: StarTables,
    tolerance_rad: float,
    min_stars: int,
    work: Work,
) -> _Outcome:
    """Attitude of the identified stars, without those over the tolerance.

    ASSUMED: at most a third of the stars may be dropped; more, and the rest is not to be trusted either.
    """
    least = max(min_stars, math.ceil(2.0 * len(rows) / 3.0))
    sigma = configuration.centroid_error.sigma_px(spots.flux_dn[spot], spots.noise_dn)
    sigma /= configuration.geometry.focal_px
    solution, kept, solution_work = robust_q_method(measured, reference, sigma, tolerance_rad, least)
    work += solution_work
    if solution is None:
        return _Outcome(Reason.TOO_FEW_STARS if len(kept) >= least else Reason.RESIDUAL_TOO_LARGE, spots)
    rows, spot = rows[kept], spot[kept]
    stars = IdentifiedStars(
        tables.catalogue.hip[rows],
        rows,
        spot,
        spots.x_px[spot],
        spots.y_px[spot],
        solution.residuals_rad * _ARCSEC_PER_RAD,
    )
    return _Outcome(Reason.NONE, spots, stars, solution)


def _rate_too_high(
    rate_rad_s: FloatArray,
    interval_s: float,
    before_rad2: FloatArray | None,
    now_rad2: FloatArray,
    configuration: FirmwareConfiguration,
) -> bool:
    """Whether a rate is over the tracking rate by more than the margin and three sigma."""
    rate = math.sqrt(float(rate_rad_s @ rate_rad_s))
    limit = configuration.tracking.rate_rad_s * (1.0 + configuration.tracking.rate_margin)
    if rate <= limit:
        return False
    axis = rate_rad_s / rate
    variance = float(axis @ now_rad2 @ axis)
    if before_rad2 is not None:
        variance += float(axis @ before_rad2 @ axis)
    return rate > limit + 3.0 * math.sqrt(variance) / interval_s


def _conclude(
    outcome: _Outcome,
    tracking: bool,
    context: FrameContext,
    state: FirmwareState,
    configuration: FirmwareConfiguration,
    work: Work,
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
            rate = angular_rate(before, solution.q_icrs_to_sensor, interval_ns * 1e-9)
            work.add("rate_solves")
            if _rate_too_high(rate, interval_ns * 1e-9, covariance, solution.covariance_rad2, configuration):
                reasons |= Reason.RATE_TOO_HIGH
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
        residual_rms_arcsec=0.0 if solution is None else solution.residual_rms_rad * _ARCSEC_PER_RAD,
        window_half_width_px=outcome.half_width_px,
        work=work,
        state=state,
        rects=outcome.rects,
        plan=outcome.plan,
        identification=outcome.identification,
        false_solutions=outcome.false_solutions if valid else math.inf,
    )
