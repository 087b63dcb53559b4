"""Lost in space over random pointings: right, wrong, unsolved, and the share of the sky that is covered."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from ..report import check
from ..units.profile import UnitProfile
from ..world.trajectory import InertialTrajectory
from .bench import Chain, error_arcsec, random_pointings
from .campaign import CampaignRequest, CampaignResult

FRAMES = 4
ELIGIBLE_STARS = 5
RIGHT_CROSS_PX = 2.0  # a wrong identification is off by degrees; a right one by a small part of a pixel
RIGHT_ROLL_DEG = 0.2
ELIGIBLE_RIGHT_SHARE = 0.995


@dataclass(frozen=True)
class Outcome:
    """One pointing: catalogue stars truly in the field, frames used (0: unsolved), right or wrong,
    errors in arcsec.
    """

    stars: int
    frames: int
    right: bool
    cross_arcsec: float
    roll_arcsec: float


def look(profile: UnitProfile, seed: int, n: int, index: int) -> Outcome:
    """Pointing ``index`` of a campaign of ``n``."""
    chain = Chain.of(profile, seed)
    q_true = random_pointings(n, seed)[index]
    chain.look(InertialTrajectory(q_true))
    stars = chain.catalogue_stars_in_field(q_true)
    for number in range(FRAMES):
        _, result = chain.step(index * FRAMES + number)
        if result.valid:
            error = error_arcsec(result.q_icrs_to_sensor, q_true)
            cross, roll = float(np.hypot(error[0], error[1])), float(abs(error[2]))
            right = cross < RIGHT_CROSS_PX * profile.pixel_arcsec and roll < RIGHT_ROLL_DEG * 3600
            return Outcome(stars, number + 1, right, cross, roll)
    return Outcome(stars, 0, False, 0.0, 0.0)


def run(request: CampaignRequest) -> CampaignResult:
    """``n`` pointings uniform over the sphere and roll; up to four frames each, at rest, fresh noise in
    each.
    """
    profile = request.profile
    outcomes = request.workers.map(partial(look, profile, request.seed, request.n), range(request.n))
    eligible = [item for item in outcomes if item.stars >= ELIGIBLE_STARS]
    right = [item for item in outcomes if item.right]
    eligible_right = sum(item.right for item in eligible)
    wrong = sum(item.frames > 0 and not item.right for item in outcomes)
    coverage = len(right) / len(outcomes)
    share = eligible_right / len(eligible) if eligible else None
    checks = [
        check("eligible_right_share", share, ">=", ELIGIBLE_RIGHT_SHARE, ""),
        check("wrong", wrong, "==", 0, "pointings"),
    ]
    if profile.requirements.lost_in_space_coverage is not None:
        checks.append(check("coverage", coverage, ">=", profile.requirements.lost_in_space_coverage, ""))
    figures = {
        "eligible": len(eligible),
        "right": len(right),
        "wrong": wrong,
        "unsolved": len(outcomes) - len(right) - wrong,
        "coverage": coverage,
        "eligible_right": eligible_right,
        "eligible_right_share": share,
        "first_frame_share": sum(item.frames == 1 for item in right) / max(1, len(right)),
        "cross_boresight_arcsec_median": float(np.median([item.cross_arcsec for item in right]))
        if right
        else None,
        "unsolved_eligible_indices": [
            index for index, item in enumerate(outcomes) if item.stars >= ELIGIBLE_STARS and not item.right
        ][:100],
    }
    return CampaignResult(figures, checks)
