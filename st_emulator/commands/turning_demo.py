"""The demo of a unit that measures its rate without an attitude: at rest, a turn from 0 up to 5 deg/s and
back to 0, at rest. What the OBC is told on the way, held to the truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..obc import Attitude
from ..protocol.pus.enumerations import Mode
from ..report import Check, check
from ..units.profile import UnitProfile
from ..world import quaternion
from .demo_session import Session, scenario_head

Array = NDArray[np.float64]

TURN_SHARE = (0.3, 0.8)  # of the run
MOST_DEG_S = 5.0
AXIS = (0.8, 0.6, 0.0)  # across the boresight: stars run over rows and columns
RAMP_SHARE = 0.45  # of the turn, up and down each
PHASES = (
    (TURN_SHARE[0], "tracking, at rest"),
    (0.5 * sum(TURN_SHARE), "turning faster, up to 5 deg/s"),
    (TURN_SHARE[1], "turning slower, down to rest"),
    (1.0, "at rest"),
)
AGAIN_TARGET_S = 2.0  # from the end of the turn to tracking
WITHIN_TARGET = 0.99  # of the frames with a rate, about every axis within 3 of its own sigmas
KNOWN_TARGET = 0.8  # ASSUMED: of the turn's frames have a rate; the others see too few streaks, and say so
ARCSEC_PER_RAD = 180 / np.pi * 3600


def turns(profile: UnitProfile) -> bool:
    """Whether a unit has anything to show in a turn that is too fast for its attitude."""
    return profile.rate is not None


def turn_scenario(profile: UnitProfile, seconds: float, seed: int) -> str:
    """The scenario of the turn; TOML text."""
    start_s, end_s = (round(share * seconds, 2) for share in TURN_SHARE)
    # From Orion to the north, where no part of the way is without stars; half a turn at most.
    lasts_s = min(end_s - start_s, 60.0)
    rate = ", ".join(f"{MOST_DEG_S * part:g}" for part in AXIS)
    doing = f"a turn up to {MOST_DEG_S:g} deg/s and back"
    return f"""{scenario_head(profile.name, doing, seconds, seed, 0.0)}
[[trajectory.segments]]
kind = "hold"
duration_s = {start_s:g}

[[trajectory.segments]]
kind = "rate"
duration_s = {lasts_s:g}
rate_deg_s = [{rate}]
ramp_s = {RAMP_SHARE * lasts_s:g}
"""


@dataclass
class TurnSeries:
    """One entry an attitude report of a frame whose truth is known.

    rate_deg_s, sigma_deg_s, true_deg_s: float64[n, 3], NaN where unknown; true ones are means from the frame
    before to this one, as the unit measures them. error_arcsec: of the attitude, NaN where not valid.
    modes: (seconds, mode) from each change on. turn_s: when the turn begins and ends.
    """

    t_s: Array
    frame_index: NDArray[np.int64]
    mode: NDArray[np.int64]
    valid: NDArray[np.bool_]
    rate_deg_s: Array
    sigma_deg_s: Array
    true_deg_s: Array
    error_arcsec: Array
    modes: list[tuple[float, Mode]]
    turn_s: tuple[float, float]

    @property
    def speed_deg_s(self) -> Array:
        """How fast the unit truly turned."""
        return np.asarray(np.linalg.norm(self.true_deg_s, axis=1))


def series_of(seconds: float, attitudes: list[Attitude], truth: dict[int, dict[str, Any]]) -> TurnSeries:
    """What the OBC was told, beside what is true."""
    reports = [report for report in attitudes if report.frame_index in truth]
    count = len(reports)
    nothing = np.full((3, count, 3), np.nan)
    rate, sigma, true = nothing
    error = np.full((count, 3), np.nan)
    for k, report in enumerate(reports):
        here = truth[report.frame_index]
        before = truth.get(report.frame_index - 1)
        if before is not None:
            true[k] = np.degrees(_mean_rate(before, here))
        if report.rate_rad_s is not None:
            rate[k] = np.degrees(report.rate_rad_s)
        if report.rate_covariance_rad2_s2 is not None:
            sigma[k] = np.degrees(np.sqrt(np.diag(report.rate_covariance_rad2_s2)))
        if report.valid:
            vector = quaternion.error_rotation_vector(report.q_icrs_to_sensor, here["q_icrs_to_sensor"])
            error[k] = vector * ARCSEC_PER_RAD
    start_s, end_s = (round(share * seconds, 2) for share in TURN_SHARE)
    return TurnSeries(
        t_s=np.array([truth[report.frame_index]["exposure_mid_ns"] * 1e-9 for report in reports]),
        frame_index=np.array([report.frame_index for report in reports], dtype=np.int64),
        mode=np.array([int(report.mode) for report in reports], dtype=np.int64),
        valid=np.array([report.valid for report in reports], dtype=bool),
        rate_deg_s=rate,
        sigma_deg_s=sigma,
        true_deg_s=true,
        error_arcsec=error,
        modes=[(0.0, Mode.BOOT)],
        turn_s=(start_s, start_s + min(end_s - start_s, 60.0)),
    )


def _mean_rate(before: dict[str, Any], here: dict[str, Any]) -> Array:
    """rad/s, sensor axes, from the middle of one frame to that of the next."""
    first, second = (np.array(record["q_icrs_to_sensor"]) for record in (before, here))
    turn = quaternion.to_rotation_vector(quaternion.multiply(second, quaternion.conjugate(first)))
    return np.asarray(turn / ((here["exposure_mid_ns"] - before["exposure_mid_ns"]) * 1e-9))


def mode_sequence(series: TurnSeries) -> list[str]:
    """Modes of the frames, each once where it stays."""
    modes = [Mode(int(mode)) for mode in series.mode]
    return [mode.name for k, mode in enumerate(modes) if k == 0 or mode is not modes[k - 1]]


def there_and_back(modes: list[str]) -> bool:
    """TRACKING, at some time later RATE_ONLY, TRACKING at the end."""
    if "TRACKING" not in modes or "RATE_ONLY" not in modes:
        return False
    return modes.index("TRACKING") < modes.index("RATE_ONLY") and modes[-1] == "TRACKING"


def evaluate_turn(
    profile: UnitProfile, seconds: float, session: Session, truth: dict[int, dict[str, Any]]
) -> tuple[dict[str, Any], list[Check], TurnSeries]:
    """Figures and checks from what the OBC received and from the truth by frame index."""
    series = series_of(seconds, session.attitudes, truth)
    reports = [report for report in session.attitudes if report.frame_index in truth]
    rest = ~(series.speed_deg_s > 1e-6)
    turning = (series.t_s > series.turn_s[0]) & (series.t_s < series.turn_s[1])
    tracking = series.valid & (series.mode == Mode.TRACKING)
    known = np.asarray(np.isfinite(series.rate_deg_s).all(axis=1))
    judged = known & np.isfinite(series.sigma_deg_s).all(axis=1) & np.isfinite(series.true_deg_s).all(axis=1)
    off = (series.rate_deg_s - series.true_deg_s)[judged]
    within = np.abs(off) <= 3.0 * series.sigma_deg_s[judged]
    acquired_s = session.acquired_s(reports)
    after = tracking & (series.t_s >= series.turn_s[1])
    again_s = float(series.t_s[after].min() - series.turn_s[1]) if after.any() else None
    good = tracking & rest
    error = series.error_arcsec[good]
    modes = mode_sequence(series)
    untold = sum(not report.valid and not report.reasons for report in reports)
    figures: dict[str, Any] = {
        "unit": profile.name,
        "seconds": seconds,
        "frames": len(reports),
        "frames_tracking": int(tracking.sum()),
        "frames_rate_only": int((series.mode == Mode.RATE_ONLY).sum()),
        "frames_with_rate": int(known.sum()),
        "modes": " ".join(modes),
        "fastest_deg_s": _most(series.speed_deg_s),
        "fastest_measured_deg_s": _most(np.linalg.norm(series.rate_deg_s, axis=1)),
        "fastest_tracked_deg_s": _most(series.speed_deg_s[tracking]),
        "lost_in_space_s": acquired_s,
        "tracking_again_s": again_s,
        "rates_judged": int(judged.sum()),
        "rates_within_3_sigma": float(np.all(within, axis=1).mean()) if judged.any() else None,
        "rate_error_deg_s_rms": [_rms(off[:, axis]) for axis in range(3)] if judged.any() else None,
        "turn_with_rate_share": float(known[turning].mean()) if turning.any() else None,
        "invalid_without_reason": untold,
        "cross_boresight_arcsec_rms": _rms(error[:, :2]),
        "roll_arcsec_rms": _rms(error[:, 2]),
        "overruns_tracking": sum(report.late for report in reports if report.mode == Mode.TRACKING),
        **session.figures(),
    }
    checks = [
        *session.checks(acquired_s),
        check("tracking_rate_only_tracking", int(there_and_back(modes)), "==", 1, "sequence"),
        check("tracking_again_s", again_s, "<=", AGAIN_TARGET_S, "s"),
        check("turn_with_rate_share", figures["turn_with_rate_share"], ">=", KNOWN_TARGET, ""),
        check("rates_within_3_sigma", figures["rates_within_3_sigma"], ">=", WITHIN_TARGET, ""),
        check("invalid_without_reason", untold, "==", 0, "frames"),
        # A unit that searches the whole sky and measures its rate at once may be late; it says so.
        check("overruns_tracking", figures["overruns_tracking"], "==", 0, "frames"),
    ]
    if profile.requirements.cross_boresight_arcsec is not None:
        target = profile.requirements.cross_boresight_arcsec
        cross = figures["cross_boresight_arcsec_rms"]
        checks.append(check("cross_boresight_arcsec_rms", cross, "<=", target, "arcsec"))
    return figures, checks, series


def _most(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else None


def _rms(values: Array) -> float | None:
    return math.sqrt(float(np.mean(np.square(values)))) if values.size else None


def spans(modes: list[tuple[float, Mode]], end_s: float) -> list[tuple[float, float, Mode]]:
    """(begin, end, mode), s, of each mode in its turn."""
    ends = [*modes, (end_s, Mode.OFF)]
    return [(begin, end, mode) for (begin, mode), (end, _) in pairwise(ends) if end > begin]
