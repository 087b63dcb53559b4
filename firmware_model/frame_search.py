"""What both searches of a frame share: the record of its steps, directions, and the attitude of its stars."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from .aberration import SPEED_OF_LIGHT_KM_S, earth_velocity_km_s
from .attitude import AttitudeSolution, robust_q_method
from .configuration import FirmwareConfiguration, StarTables
from .frame_log import FrameLog
from .frame_result import NO_RECTS, FrameContext, IdentifiedStars
from .identification.interface import Identification
from .image.spots import Spots
from .rate_from_flow import FlowRate
from .reasons import Reason
from .star_motion import KeptFrame, TrackedStars
from .star_rate import StarRate
from .tracking import TrackingPlan
from .work import Work

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]

ARCSEC_PER_RAD = math.degrees(1.0) * 3600.0
_NO_VELOCITY = np.zeros(3)


@dataclass(frozen=True)
class SearchOutcome:
    """What a search found, before the rate and the history are looked at.

    kept: what the next frame may fuse with; tracked: the same of known stars alone; star_rate: by this frame
    and the one before, without attitude.
    still_assumed: a rolling shutter's attitude as if the unit stood still; nothing follows for its rate.
    """

    reasons: Reason
    spots: Spots
    stars: IdentifiedStars = field(default_factory=IdentifiedStars.none)
    attitude: AttitudeSolution | None = None
    rects: IntArray = field(default_factory=lambda: NO_RECTS)
    half_width_px: int = 0
    plan: TrackingPlan | None = None
    identification: Identification | None = None
    false_solutions: float = math.inf
    kept: KeptFrame | None = None
    tracked: TrackedStars | None = None
    star_rate: StarRate | FlowRate | None = None
    still_assumed: bool = False


def velocity_over_c(context: FrameContext, configuration: FirmwareConfiguration, log: FrameLog) -> FloatArray:
    """Velocity of the observer over that of light, ICRS, float64[3]; zeros without a date or correction."""
    if not configuration.aberration_correction or context.tai_ns is None:
        return _NO_VELOCITY
    velocity = earth_velocity_km_s(context.tai_ns) + np.array(configuration.velocity_km_s)
    over_c = np.asarray(velocity / SPEED_OF_LIGHT_KM_S)
    arguments = {"tai_ns": context.tai_ns, "velocity_km_s": configuration.velocity_km_s}
    log.step("velocity", arguments, over_c, Work({"observer_velocities": 1}))
    return over_c


def directions(spots: Spots, configuration: FirmwareConfiguration, log: FrameLog) -> FloatArray:
    """Unit vectors of spots in the sensor frame, float64[n, 3]."""
    geometry = configuration.geometry
    vectors, newton_steps = geometry.counted_unit_vectors(spots.x_px, spots.y_px)
    begun = int(len(spots) > 0)
    work = Work({"directions_begun": begun, "unit_vectors": len(spots), "newton_steps": newton_steps})
    arguments = {"geometry": geometry, "x_px": spots.x_px, "y_px": spots.y_px}
    log.step("unit_vectors", arguments, vectors, work)
    return vectors


def solve(
    measured: FloatArray,
    reference: FloatArray,
    rows: IntArray,
    spot: IntArray,
    spots: Spots,
    configuration: FirmwareConfiguration,
    tables: StarTables,
    tolerance_rad: float,
    min_stars: int,
    log: FrameLog,
) -> SearchOutcome:
    """Attitude of the identified stars, without those over the tolerance.

    ASSUMED: at most a third of the stars may be dropped; more, and the rest is not to be trusted either.
    """
    least = max(min_stars, math.ceil(2.0 * len(rows) / 3.0))
    flux_dn = spots.flux_dn[spot]
    sigma = configuration.centroid_error.sigma_px(flux_dn, spots.noise_dn)
    sigma /= configuration.geometry.focal_px
    solution, kept, solution_work = robust_q_method(measured, reference, sigma, tolerance_rad, least)
    solution_work.add("centroid_errors", len(sigma))
    log.step(
        "attitude",
        {
            "measured": measured,
            "reference": reference,
            "flux_dn": flux_dn,
            "noise_dn": spots.noise_dn,
            "centroid_error": configuration.centroid_error,
            "focal_px": configuration.geometry.focal_px,
            "tolerance_rad": tolerance_rad,
            "least": least,
        },
        (solution, kept),
        solution_work,
    )
    if solution is None:
        return SearchOutcome(Reason.TOO_FEW_STARS if len(kept) >= least else Reason.RESIDUAL_TOO_LARGE, spots)
    rows, spot = rows[kept], spot[kept]
    stars = IdentifiedStars(
        tables.catalogue.hip[rows],
        rows,
        spot,
        spots.x_px[spot],
        spots.y_px[spot],
        solution.residuals_rad * ARCSEC_PER_RAD,
    )
    return SearchOutcome(Reason.NONE, spots, stars, solution)
