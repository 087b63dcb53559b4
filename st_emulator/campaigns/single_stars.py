"""Single stars in full frames at rest: centroid errors and detection probability, under the noise of the
unit file.
"""

from __future__ import annotations

import dataclasses
import itertools
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..firmware_model.image.detection import detect
from ..report import check
from ..units.profile import UnitProfile
from ..world.trajectory import InertialTrajectory
from .bench import Chain, random_pointings
from .campaign import CampaignRequest, CampaignResult

CENTROID_TARGET_PX = 0.04  # R: centroiding better than 0.04 px
CENTROID_LIMIT_MAG = 6.0
DETECTION_HALF_BIN_MAG = 0.15
MATCH_PX = 2.0
ISOLATION_PX = 12.0  # a neighbour nearer than this disturbs
NEIGHBOUR_MAG = 3.0  # and counts when it is at most so much dimmer
EDGE_PX = 8.0
NO_LIMIT_MAG = 99.0


@dataclass(frozen=True)
class Measurement:
    """Stars of one frame: ``float64[n, 4]`` of (Hp, found 0/1, dx, dy in px), and its clusters on no star."""

    stars: NDArray[np.float64]
    false_clusters: int


def measure(profile: UnitProfile, seed: int, n: int, gated: bool, index: int) -> Measurement:
    """One frame at a random pointing, full-frame detection against the truth.

    ``gated`` False: without the firmware's magnitude threshold, so that the noise alone sets the limit.
    """
    chain = Chain.of(profile, seed)
    chain.scene.trajectory = InertialTrajectory(random_pointings(n, seed)[index])
    frame = chain.expose(index)
    truth = chain.scene.truth(frame)
    detection = chain.configuration.detection
    if not gated:
        detection = dataclasses.replace(detection, magnitude_limit=NO_LIMIT_MAG)
    spots, _ = detect(frame.full(), detection)
    place = np.array([(star.x_px, star.y_px, star.hp_mag) for star in truth.stars]).reshape(-1, 3)
    found = np.stack([spots.x_px, spots.y_px], axis=1).reshape(-1, 2)
    columns, rows = profile.detector.columns, profile.detector.rows
    measured = []
    for x, y, magnitude in place:
        if not (EDGE_PX < x < columns - 1 - EDGE_PX and EDGE_PX < y < rows - 1 - EDGE_PX):
            continue
        distance = np.hypot(place[:, 0] - x, place[:, 1] - y)
        if np.any((distance > 0) & (distance < ISOLATION_PX) & (place[:, 2] < magnitude + NEIGHBOUR_MAG)):
            continue
        offset = found - (x, y)
        nearest = int(np.argmin(np.hypot(*offset.T))) if len(found) else -1
        if nearest >= 0 and np.hypot(*offset[nearest]) < MATCH_PX:
            measured.append((magnitude, 1.0, *offset[nearest]))
        else:
            measured.append((magnitude, 0.0, np.nan, np.nan))
    false = sum(not np.any(np.hypot(place[:, 0] - x, place[:, 1] - y) < 2 * MATCH_PX) for x, y in found)
    return Measurement(np.array(measured).reshape(-1, 4), false)


def _all(request: CampaignRequest, gated: bool = True) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    outcomes = request.workers.map(
        partial(measure, request.profile, request.seed, request.n, gated), range(request.n)
    )
    return np.concatenate([item.stars for item in outcomes]), np.array(
        [item.false_clusters for item in outcomes]
    )


def run_centroids(request: CampaignRequest) -> CampaignResult:
    """Root mean square centroid error per axis in bins of half a magnitude."""
    stars, _ = _all(request)
    limit = min(CENTROID_LIMIT_MAG, request.profile.detection.magnitude_limit - 0.5)
    table: list[dict[str, Any]] = []
    for low in np.arange(1.0, request.profile.detection.magnitude_limit, 0.5):
        chosen = stars[(stars[:, 0] > low) & (stars[:, 0] <= low + 0.5) & (stars[:, 1] == 1)]
        if len(chosen) >= 5:
            rms = float(np.sqrt(np.mean(np.square(chosen[:, 2:]))))
            table.append({"magnitudes": [float(low), float(low + 0.5)], "stars": len(chosen), "rms_px": rms})
    bright = stars[(stars[:, 0] <= limit) & (stars[:, 1] == 1)]
    rms_all = float(np.sqrt(np.mean(np.square(bright[:, 2:])))) if len(bright) else None
    faintest = next((row["rms_px"] for row in reversed(table) if row["magnitudes"][1] <= limit), None)
    figures = {
        "stars": len(bright),
        "limit_mag": limit,
        "centroid_rms_px": rms_all,
        "centroid_rms_px_faintest_bin": faintest,
        "bias_px": [float(value) for value in np.mean(bright[:, 2:], axis=0)] if len(bright) else None,
        "by_magnitude": table,
    }
    checks = [
        check("centroid_rms_px", rms_all, "<=", CENTROID_TARGET_PX, "px"),
        check("centroid_rms_px_faintest_bin", faintest, "<=", CENTROID_TARGET_PX, "px"),
    ]
    return CampaignResult(figures, checks)


def _shares(stars: NDArray[np.float64], centres: NDArray[np.float64]) -> list[dict[str, Any]]:
    """Share detected in bins of +- 0.15 mag about the magnitudes ``centres``."""
    rows = []
    for centre in centres:
        chosen = stars[np.abs(stars[:, 0] - centre) <= DETECTION_HALF_BIN_MAG]
        if len(chosen):
            share = float(np.mean(chosen[:, 1]))
            rows.append({"magnitude": round(float(centre), 3), "stars": len(chosen), "share_detected": share})
    return rows


def _half_detected_mag(rows: list[dict[str, Any]]) -> float | None:
    """The magnitude at which half are detected, between two bins; None where the bins do not reach it."""
    for brighter, dimmer in itertools.pairwise(rows):
        high, low = brighter["share_detected"], dimmer["share_detected"]
        if high >= 0.5 > low:
            step = dimmer["magnitude"] - brighter["magnitude"]
            return float(brighter["magnitude"] + step * (high - 0.5) / (high - low))
    return None


def run_detection(request: CampaignRequest) -> CampaignResult:
    """Share of the stars detected, in bins about the limiting magnitude, and clusters on no star a frame.

    The limiting magnitude is the source's (``requirements``), not the parameter that is measured. Beside it,
    how deep the noise alone would allow to go, with the clusters on no star there.
    """
    stars, false = _all(request)
    ungated, ungated_false = _all(request, gated=False)
    limit = request.profile.requirements.detection_limit_mag or request.profile.detection.magnitude_limit
    centres = np.arange(limit - 0.9, limit + 2.5, 0.3)
    table = _shares(stars, centres[:7])
    ungated_table = _shares(ungated, centres)
    at_limit = stars[np.abs(stars[:, 0] - limit) <= DETECTION_HALF_BIN_MAG]
    share = float(np.mean(at_limit[:, 1])) if len(at_limit) else None
    false_mean = float(np.mean(false))
    figures = {
        "frames": request.n,
        "stars_at_limit": len(at_limit),
        "share_detected_at_limit": share,
        "false_clusters_per_frame": false_mean,
        "false_clusters_worst_frame": int(np.max(false)),
        "noise_limited_mag": _half_detected_mag(ungated_table),
        "noise_limited_false_clusters_per_frame": float(np.mean(ungated_false)),
        "by_magnitude": table,
        "by_magnitude_noise_limited": ungated_table,
    }
    checks = [
        check("share_detected_at_limit_low", share, ">=", 0.4, ""),
        check("share_detected_at_limit_high", share, "<=", 0.6, ""),
        check("false_clusters_per_frame", false_mean, "<=", 1, "clusters"),
    ]
    return CampaignResult(figures, checks)
