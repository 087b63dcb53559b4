"""Attitudes under a fault against the truth: what was told as valid, and how far off it was."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hil_tests.unit.conftest import make
from st_emulator.bench.scenario import Scenario
from st_emulator.faults.faults import settings_of
from st_emulator.units.profile import load_unit

START_S = 2.0
ARCSEC_PER_RAD = 180 / np.pi * 3600


@dataclass
class Against:
    """Of the frames under the fault: how many attitude reports came, how many were valid, their errors."""

    frames: int = 0
    valid: int = 0
    across_arcsec: list[float] = field(default_factory=list)  # of each valid one, both axes
    about_arcsec: list[float] = field(default_factory=list)
    claimed_arcsec: list[float] = field(default_factory=list)  # sigma across the boresight by its covariance
    in_lost_in_space: int = 0

    @property
    def rms_arcsec(self) -> float:
        """Across the boresight, an axis."""
        return float(np.sqrt(np.mean(np.square(self.across_arcsec)) / 2)) if self.across_arcsec else 0.0

    @property
    def worst_arcsec(self) -> float:
        return max(self.across_arcsec, default=0.0)


def error_rad(measured: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Rotation vector in sensor axes from one attitude [x, y, z, w] to the other, by its definition."""
    x1, y1, z1, w1 = measured
    x2, y2, z2, w2 = -true[0], -true[1], -true[2], true[3]
    vector = np.array(
        [
            w1 * x2 + x1 * w2 - y1 * z2 + z1 * y2,
            w1 * y2 + x1 * z2 + y1 * w2 - z1 * x2,
            w1 * z2 - x1 * y2 + y1 * x2 + z1 * w2,
        ]
    )
    scalar = w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2
    return vector * (2.0 if scalar >= 0 else -2.0)  # small angles


def against_truth(
    fault: dict[str, Any] | None,
    frames: int,
    *,
    unit: str = "roja1",
    acquire_every: int = 10,
    seed: int = 1,
    **scenario: Any,
) -> Against:
    """Run a unit under a fault for so many frames, with a new acquisition every now and then."""
    faults = [] if fault is None else [settings_of(fault | {"start_s": START_S}, "campaign")]
    keys = {"sky": {"aberration": False}} | scenario
    parameters = {"autonomous_start": 1}
    bench = make(
        load_unit(unit),
        scenario=Scenario(seed=seed, parameters=parameters, faults=faults, **keys),
        baud=921600,
    )
    period_ms = bench.emulator.profile.timing.frame_period_ms
    bench.run_to(START_S * 1000)
    bench.quiet()
    first = int(START_S * 1000 / period_ms)
    end_ms = START_S * 1000 + frames * period_ms
    while bench.now_ms < end_ms:
        bench.run(min(acquire_every * period_ms, end_ms - bench.now_ms))
        bench.function("START_ACQUISITION", ack=0)
    found = Against()
    scene = bench.emulator.scene
    assert scene is not None
    for report in bench.of("attitude_report"):
        if report["frame_index"] < first:
            continue
        found.frames += 1
        if not report["valid"]:
            continue
        found.valid += 1
        found.in_lost_in_space += report["mode"] == 3
        start_ns = report["frame_index"] * period_ms * 1_000_000
        true = scene.trajectory.q_icrs_to_sensor(start_ns + report["exposure_us"] * 500)
        error = (
            error_rad(np.array([report[f"q_{axis}"] for axis in "xyzw"]), np.asarray(true)) * ARCSEC_PER_RAD
        )
        found.across_arcsec.append(float(np.hypot(error[0], error[1])))
        found.about_arcsec.append(float(abs(error[2])))
        variance = (report["covariance_xx"] + report["covariance_yy"]) / 2
        found.claimed_arcsec.append(float(np.sqrt(variance)) * ARCSEC_PER_RAD)
    return found
