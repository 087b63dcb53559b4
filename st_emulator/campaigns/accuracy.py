"""Attitude error against the truth, at rest, over seeded pointings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from ..firmware_model.modes import Mode
from ..report import check
from ..units.profile import UnitProfile
from ..world.trajectory import InertialTrajectory
from .bench import Chain, error_arcsec, random_pointings
from .campaign import CampaignRequest, CampaignResult

FRAMES = 40
MIN_STARS = 5


@dataclass(frozen=True)
class Outcome:
    """One pointing: root mean square over its tracked frames, per axis, arcsec (nan when it was never
    tracked).
    """

    stars: int
    tracked: int
    cross_arcsec: float
    roll_arcsec: float


def look(profile: UnitProfile, seed: int, pointings: int, index: int) -> Outcome:
    """Ten seconds at one pointing."""
    chain = Chain.of(profile, seed)
    q_true = random_pointings(pointings, seed)[index]
    stars = chain.catalogue_stars_in_field(q_true)
    if stars < MIN_STARS:
        return Outcome(stars, 0, np.nan, np.nan)
    chain.look(InertialTrajectory(q_true))
    errors = []
    for number in range(FRAMES):
        acquisition = chain.acquisition
        _, result = chain.step(index * FRAMES + number)
        if result.valid and acquisition is Mode.TRACKING:
            errors.append(error_arcsec(result.q_icrs_to_sensor, q_true))
    if not errors:
        return Outcome(stars, 0, np.nan, np.nan)
    squares = np.mean(np.square(errors), axis=0)
    return Outcome(
        stars, len(errors), float(np.sqrt((squares[0] + squares[1]) / 2)), float(np.sqrt(squares[2]))
    )


def run(request: CampaignRequest) -> CampaignResult:
    """``n`` pointings whose field holds 5 or more catalogue stars; ten seconds of tracking each."""
    profile = request.profile
    pointings = 4 * request.n + 20  # enough to find n eligible ones
    candidates = request.workers.map(partial(_stars, profile, request.seed, pointings), range(pointings))
    chosen = [index for index, stars in enumerate(candidates) if stars >= MIN_STARS][: request.n]
    outcomes = request.workers.map(partial(look, profile, request.seed, pointings), chosen)
    cross = np.array([item.cross_arcsec for item in outcomes])
    roll = np.array([item.roll_arcsec for item in outcomes])
    measured = cross[~np.isnan(cross)]
    median = float(np.median(measured)) if len(measured) else None
    checks = []
    if profile.requirements.cross_boresight_arcsec is not None:
        target = profile.requirements.cross_boresight_arcsec
        checks.append(check("cross_boresight_arcsec_median", median, "<=", target, "arcsec"))
    figures = {
        "pointings": len(chosen),
        "tracked": len(measured),
        "frames": sum(item.tracked for item in outcomes),
        "cross_boresight_arcsec_median": median,
        "cross_boresight_arcsec_p95": float(np.percentile(measured, 95)) if len(measured) else None,
        "roll_arcsec_median": float(np.nanmedian(roll)) if len(measured) else None,
        "roll_arcsec_p95": float(np.nanpercentile(roll, 95)) if len(measured) else None,
    }
    return CampaignResult(figures, checks)


def _stars(profile: UnitProfile, seed: int, pointings: int, index: int) -> int:
    return Chain.of(profile, seed).catalogue_stars_in_field(random_pointings(pointings, seed)[index])
