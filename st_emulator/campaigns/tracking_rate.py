"""Tracking at the largest rate in 26 directions, its loss at 1.5 times that rate, and its return."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..errors import ConfigurationError
from ..firmware_model.modes import Mode
from ..firmware_model.reasons import Reason
from ..report import check
from ..units.profile import UnitProfile
from ..world import quaternion
from ..world.slew import Hold, RateAxis, SlewTrajectory
from .bench import Chain, error_arcsec, random_pointings
from .campaign import CampaignRequest, CampaignResult

REST_S = 1.0
AT_RATE_S = 2.0
OVER_RATE_S = 2.0
AFTER_S = 3.0
OVER = 1.5
BACK_WITHIN_S = 2.0
RICH_FIELD_STARS = 9  # the test is of the windows, not of an empty sky
DIRECTIONS = np.array([v for v in itertools.product((-1, 0, 1), repeat=3) if any(v)], dtype=float)


@dataclass(frozen=True)
class Outcome:
    """One direction.

    worst_error_px: of the valid attitudes; worst_at_a_step_px: of those whose frame is exposed while the rate
    steps, apart from the others. There no attitude of mid-exposure can be had: the rows of a rolling shutter
    see different shares of the two rates.
    """

    direction: tuple[float, float, float]
    at_rate_frames: int
    at_rate_valid: int
    lost: bool
    reasons: int
    back_s: float
    worst_error_px: float
    worst_at_a_step_px: float


def _field(chain: Chain, profile: UnitProfile, rotation: np.ndarray, pointings: np.ndarray) -> np.ndarray:
    """The first pointing whose field is rich all along the way."""
    for q in pointings:
        way = [
            quaternion.multiply(quaternion.from_rotation_vector(rotation * part), q)
            for part in (0, 0.25, 0.5, 0.75, 1)
        ]
        if all(chain.catalogue_stars_in_field(item) >= RICH_FIELD_STARS for item in way):
            return np.asarray(q)
    raise ConfigurationError(
        f"unit {profile.name}: no pointing has {RICH_FIELD_STARS} catalogue stars in the field all along the "
        "turn; allowed are units with a wider field or a fainter catalogue.limit_mag"
    )


def turn(profile: UnitProfile, seed: int, index: int) -> Outcome:
    """At rest, at the largest rate, over it, at rest again; about direction ``index``."""
    chain = Chain.of(profile, seed)
    axis = DIRECTIONS[index % len(DIRECTIONS)]
    axis = axis / np.linalg.norm(axis)
    omega = profile.tracking.rate_deg_s
    rotation = np.radians(axis * omega * (AT_RATE_S + OVER * OVER_RATE_S))
    pointings = random_pointings(400 * (index + 1), seed)[400 * index :]
    q_start = _field(chain, profile, rotation, pointings)
    chain.look(
        SlewTrajectory(
            q_start,
            [
                Hold(REST_S),
                RateAxis(tuple(axis * omega), AT_RATE_S, 0.0),
                RateAxis(tuple(axis * omega * OVER), OVER_RATE_S, 0.0),
                Hold(AFTER_S),
            ],
        )
    )
    period_s = profile.timing.frame_period_ms / 1000
    over_from_s, over_until_s = REST_S + AT_RATE_S, REST_S + AT_RATE_S + OVER_RATE_S
    at_rate = at_rate_valid = 0
    lost, reasons, back_s, worst_px, at_a_step_px = False, Reason(0), np.inf, 0.0, 0.0
    steps_s = (REST_S, over_from_s, over_until_s)
    for number in range(int((over_until_s + AFTER_S) / period_s)):
        t_s = number * period_s
        acquisition = chain.acquisition
        frame, result = chain.step(number)
        if result.valid:
            error = error_arcsec(result.q_icrs_to_sensor, chain.true_attitude(frame))
            error_px = float(np.hypot(error[0], error[1])) / profile.pixel_arcsec
            if any(frame.exposure_start_ns < step_s * 1e9 < frame.exposure_end_ns for step_s in steps_s):
                at_a_step_px = max(at_a_step_px, error_px)
            else:
                worst_px = max(worst_px, error_px)
        if REST_S <= t_s < over_from_s:
            at_rate += 1
            at_rate_valid += result.valid and acquisition is Mode.TRACKING
        elif over_from_s <= t_s < over_until_s and not result.valid:
            lost = True
            reasons |= result.reasons
        elif (
            t_s >= over_until_s
            and result.valid
            and chain.acquisition is Mode.TRACKING
            and not np.isfinite(back_s)
        ):
            back_s = t_s + period_s - over_until_s
    direction = (float(axis[0]), float(axis[1]), float(axis[2]))
    return Outcome(
        direction, at_rate, int(at_rate_valid), lost, int(reasons), float(back_s), worst_px, at_a_step_px
    )


def run(request: CampaignRequest) -> CampaignResult:
    """The unit's omega and 1.5 times it, in ``n`` (26) directions."""
    outcomes = request.workers.map(partial(turn, request.profile, request.seed), range(request.n))
    held = sum(item.at_rate_valid == item.at_rate_frames for item in outcomes)
    lost = sum(item.lost and item.reasons != 0 for item in outcomes)
    back = sum(item.back_s <= BACK_WITHIN_S for item in outcomes)
    worst_px = max(item.worst_error_px for item in outcomes)
    figures = {
        "rate_deg_s": request.profile.tracking.rate_deg_s,
        "directions": request.n,
        "held_at_rate": held,
        "lost_over_rate": lost,
        "back_in_time": back,
        "back_s_worst": max(item.back_s for item in outcomes),
        "worst_valid_error_px": worst_px,
        "worst_valid_error_at_a_step_px": max(item.worst_at_a_step_px for item in outcomes),
        "by_direction": [item.__dict__ for item in outcomes],
    }
    checks = [
        check("held_at_rate", held, "==", request.n, "directions"),
        check("lost_over_rate", lost, "==", request.n, "directions"),
        check("back_in_time", back, "==", request.n, "directions"),
        check("worst_valid_error_px", worst_px, "<=", 2.0, "px"),
    ]
    return CampaignResult(figures, checks)
