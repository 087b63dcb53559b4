"""Records of the steps between two frames that follow each other: skies of streaks made up for them.

The frames of the calibration are of units that measure no rate without attitude, so these come from pictures
drawn here: stars in random places, drawn out evenly, twice, the second time one displacement on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from st_emulator.firmware_model.camera_errors import CentroidError
from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.geometry import CameraGeometry
from st_emulator.firmware_model.image.detection import DetectionParameters, detect_clusters
from st_emulator.firmware_model.image.rolling_shutter import RowTiming, compensate
from st_emulator.firmware_model.image.spots import Spots, WindowSpots
from st_emulator.firmware_model.image.streaks import DetectedClusters, Fusion, fuse, streak_table
from st_emulator.firmware_model.star_motion import (
    TrackedStars,
    places_by_rate,
    rate_of_fusion,
    rate_of_windows,
)
from st_emulator.firmware_model.work import Work

__all__ = ["streak_records"]

SIZE_PX = 1024  # as the units: what is done once a row or an image must weigh as it does there
CAMERA = CameraGeometry(SIZE_PX, SIZE_PX, 2889.0)
DISTORTED = replace(CAMERA, k1=-0.05, k2=0.01)
ERROR = CentroidError(0.01, 0.75, 25.0, 2)
TIMING = RowTiming(0.2 / SIZE_PX, 0.2, 0.2, SIZE_PX)
_NOISE_DN = 3.7
_BACKGROUND_DN = 308.0

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Scene:
    """Two pictures and what detection makes of them."""

    images: tuple[npt.NDArray[np.uint16], npt.NDArray[np.uint16]]
    detections: tuple[DetectedClusters, DetectedClusters]
    parameters: DetectionParameters
    works: tuple[Work, Work]


def _picture(
    rng: np.random.Generator, stars: FloatArray, streak: FloatArray, flux: FloatArray
) -> npt.NDArray[np.uint16]:
    image = np.full((SIZE_PX, SIZE_PX), _BACKGROUND_DN)
    steps = max(1, int(2 * np.hypot(*streak)))
    grid = np.arange(SIZE_PX)
    for (x, y), dn in zip(stars, flux, strict=True):
        for step in range(steps):
            at = (step + 0.5) / steps - 0.5
            across = np.exp(-0.5 * ((grid - x - at * streak[0]) / 0.8) ** 2)
            down = np.exp(-0.5 * ((grid - y - at * streak[1]) / 0.8) ** 2)
            rows, columns = np.flatnonzero(down > 1e-4), np.flatnonzero(across > 1e-4)
            image[np.ix_(rows, columns)] += dn / steps / 4.0 * np.outer(down[rows], across[columns])
    noisy = image + rng.normal(0.0, _NOISE_DN, image.shape)
    return np.clip(np.rint(noisy), 0, 4095).astype(np.uint16)


def _scene(rng: np.random.Generator) -> _Scene:
    length = rng.choice([0.0, 2.0, 10.0, 25.0, 40.0])
    # Faint stars vanish with the rate: where aps_rs sees 60 at rest it sees 5 to 11 at 5 deg/s, 50 px long.
    count = int(rng.integers(4, 160 if length <= 10.0 else 60))
    angle = rng.uniform(0, 2 * np.pi)
    streak = length * np.array([np.cos(angle), np.sin(angle)])
    stars = rng.uniform(10, SIZE_PX - 10, (count, 2))
    flux = 10.0 ** rng.uniform(2.4, 4.2, count) * (1.0 + 0.2 * np.hypot(*streak))
    parameters = DetectionParameters(
        tau_min_dn=20.0,
        centroid="cluster" if rng.uniform() < 0.5 else "com",
        piece_gap_px=3,
        max_pixels=600,
        saturation_dn=4095,
    )
    images = tuple(_picture(rng, stars + k * streak, streak, flux) for k in range(2))
    found = [detect_clusters(image, parameters) for image in images]
    return _Scene((images[0], images[1]), (found[0][0], found[1][0]), parameters, (found[0][1], found[1][1]))


def _record(step: str, function: Callable[..., tuple[Any, Work]], **arguments: Any) -> StepRecord:
    result, work = function(**arguments)
    return StepRecord(step, arguments, result, work)


def streak_records(rng: np.random.Generator) -> Sequence[StepRecord]:
    """The records of two frames, in their order in a frame."""
    scene = _scene(rng)
    geometry = DISTORTED if rng.uniform() < 0.3 else CAMERA
    records = []
    tables = []
    for image, detected, work in zip(scene.images, scene.detections, scene.works, strict=True):
        arguments = {"image": image, "parameters": scene.parameters}
        records.append(StepRecord("detect", arguments, detected.spots, work))
        # After its own detection, as in a frame: a second in a row would find its places in the cache.
        records.append(_record("keep_runs", streak_table, detected=detected))
        tables.append(records[-1].result)
    before, now = tables
    fusing = _record("fuse", fuse, before=before, now=now, distance_px=2.0)
    shared = {
        "timing": TIMING,
        "geometry": geometry,
        "centroid_error": ERROR,
        "tolerance_px": 1.5,
        "min_stars": 2,
    }
    rate = _record("star_rate", rate_of_fusion, before=before, now=now, fusion=fusing.result, **shared)
    records += [fusing, rate]
    for method in ("streak", "displacement"):
        arguments = {"before": before, "now": now, "fusion": fusing.result, "timing": TIMING}
        records.append(_record("compensate", compensate, **arguments, method=method, least_speed_px_s=2.0))
    turn = rng.normal(0.0, 0.03, 3) if rate.result is None else rate.result.rate_rad_s
    change = np.zeros(3) if rng.uniform() < 0.5 else rng.normal(0.0, 0.02, 3)
    records.append(
        _record(
            "places_by_rate",
            places_by_rate,
            x_px=now.spots.x_px,
            y_px=now.spots.y_px,
            rate_rad_s=turn,
            timing=TIMING,
            geometry=geometry,
            least_speed_px_s=0.0,
            change_rad_s2=change,
        )
    )
    records.append(_windows(rng, fusing.result, before.spots, now.spots, shared))
    records.append(_limit(rng))
    return records


def _windows(
    rng: np.random.Generator, fusion: Fusion, before: Spots, spots: Spots, shared: dict[str, Any]
) -> StepRecord:
    """Windows of the spots: some of two stars, some with no spot, some stars not seen in the frame before."""
    stars = min(len(spots), 24)
    order = np.arange(stars, dtype=np.int32)
    window = (order - (rng.uniform(size=stars) < 0.1)).clip(0)
    window = np.unique(window, return_inverse=True)[1].astype(np.int32)
    seen = np.flatnonzero(rng.uniform(size=stars) < 0.9)
    found = WindowSpots(spots.take(seen), window[seen], np.zeros(0, np.uint8), np.zeros(0), np.zeros(0))
    tracked = rng.permutation(np.flatnonzero(fusion.now < stars))
    kept = TrackedStars(0, 0, 7 * fusion.now[tracked], before.take(fusion.before[tracked]))
    arguments = {"before": kept, "star": 7 * order, "window": window, "found": found}
    return _record("window_rate", rate_of_windows, **arguments, **shared)


def _limit(rng: np.random.Generator) -> StepRecord:
    rate = rng.normal(0.0, 0.03, 3) + 0.02
    spread = np.diag(rng.uniform(1e-8, 1e-5, 3))
    size = float(np.sqrt(rate @ rate))
    limit = 0.5 * size
    axis = rate / size
    over = size > limit + 3.0 * float(np.sqrt(axis @ spread @ axis))
    arguments = {"rate_rad_s": rate, "covariance_rad2_s2": spread, "limit_rad_s": limit}
    return StepRecord("rate_limit", arguments, over, Work({"rates_over_limit": 1}))
