"""The ROJA1 paper's sky test: fixed to the Earth, the rotation fitted to the telemetered attitudes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..bench.emulator import Emulator
from ..bench.scenario import EarthFixedTrajectory, Scenario, ScenarioTelecommand
from ..clock import NS_PER_S
from ..dialects.registry import with_dialect
from ..obc.listening import TelemetryListener
from ..report import check
from ..tai import tai_ns_from_utc
from ..world import quaternion
from .bench import STARS_ONLY
from .campaign import CampaignRequest, CampaignResult

EARTH_RATE_DEG_S = 0.00417807  # 360 deg in a sidereal day of 86164.1 s
PAPER_ERROR_DEG_S = 3.84e-4
TARGET_DEG_S = 4e-6
ACQUIRE_S = 2.0
LEAST_ATTITUDES = 3  # a rotation cannot be fitted to fewer


def fitted_rotation_deg_s(t_s: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rate vector (deg/s, sensor axes of the middle attitude) of the constant rotation that fits ``q[n,
    4]`` best.

    Least squares on the rotation vectors from the middle attitude, whose components grow linearly with time
    for a rotation about a fixed axis.
    """
    middle = q[len(q) // 2]
    turns = np.array(
        [quaternion.to_rotation_vector(quaternion.multiply(item, quaternion.conjugate(middle))) for item in q]
    )
    design = np.stack([np.ones_like(t_s), t_s - t_s.mean()], axis=1)
    solution, *_ = np.linalg.lstsq(design, turns, rcond=None)
    return np.asarray(np.degrees(solution[1]))


def run(request: CampaignRequest) -> CampaignResult:
    """``n`` seconds over the wire, as fast as the computer can."""
    seconds = float(request.n)
    listener = TelemetryListener()
    start = Scenario().start_utc
    scenario = Scenario(
        name="earth-rate",
        trajectory=EarthFixedTrajectory(kind="earth_fixed", ra_deg=12.76, dec_deg=57.0, roll_deg=0.0),
        sky=STARS_ONLY,
        telecommands=[
            ScenarioTelecommand(at_s=0.6, name="set_time", fields={"time": start.isoformat()}),
            ScenarioTelecommand(at_s=ACQUIRE_S, name="function", fields={"function_id": "START_ACQUISITION"}),
        ],
    )
    in_pus = with_dialect(request.profile, "pus")  # what is listened to
    emulator = Emulator(in_pus, scenario, seed=request.seed, transmit=listener.transmitted)
    end_s = ACQUIRE_S + 1.0 + seconds
    with request.workers.progress.task(int(end_s)) as advance:
        for second in range(1, int(end_s) + 1):
            emulator.advance(second * NS_PER_S)
            advance()
        emulator.advance(round(end_s * NS_PER_S))
    reports = [
        item.fields
        for item in listener.named("attitude_report")
        if item.fields["valid"] and item.fields["mode"] == 4
    ]
    if len(reports) < LEAST_ATTITUDES:
        nothing = {"attitudes": len(reports), "rate_deg_s": None, "rate_error_deg_s": None}
        return CampaignResult(nothing, [check("rate_error_deg_s", None, "<=", TARGET_DEG_S, "deg/s")])
    first_ns = tai_ns_from_utc(start)
    t_s = np.array([(item["mid_exposure_time"].to_ns() - first_ns) / NS_PER_S for item in reports])
    q = np.array([[item[f"q_{axis}"] for axis in "xyzw"] for item in reports])
    rate = float(np.linalg.norm(fitted_rotation_deg_s(t_s, q)))
    ra = np.unwrap(np.radians([quaternion.pointing_from_quaternion(item)[0] for item in q]))
    drift = np.degrees(np.polyfit(t_s - t_s.mean(), ra, 1))
    error = abs(rate - EARTH_RATE_DEG_S)
    figures = {
        "seconds": float(t_s[-1] - t_s[0]),
        "attitudes": len(reports),
        "rate_deg_s": rate,
        "rate_true_deg_s": EARTH_RATE_DEG_S,
        "rate_error_deg_s": error,
        "rate_error_paper_deg_s": PAPER_ERROR_DEG_S,
        "right_ascension_drift_deg_s": float(drift[0]),
        "right_ascension_first_deg": float(np.degrees(ra[0])),
        "right_ascension_last_deg": float(np.degrees(ra[-1])),
    }
    return CampaignResult(figures, [check("rate_error_deg_s", error, "<=", TARGET_DEG_S, "deg/s")])
