"""Solve times of the identification algorithms on one core, beside those of peers on the same centroids.

Run as a process of its own, so that one core and one thread are all it has; prints one JSON object a line:
progress (``{"scene": n}``), at last the figures.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import secrets
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import peers

from st_emulator.campaigns.star_scenes import ARCSEC, SceneSettings, StarScene, make_scene, scene_tables
from st_emulator.firmware_model.catalogue.tables import StarTables
from st_emulator.firmware_model.geometry import CameraGeometry
from st_emulator.firmware_model.identification.algorithms import ALGORITHMS
from st_emulator.firmware_model.identification.interface import (
    IdentificationAlgorithm,
    IdentificationParameters,
    Spikes,
)
from st_emulator.firmware_model.reasons import Reason
from st_emulator.world.quaternion import attitude_matrix

LIMIT_MAG = 5.5
FIELD_DEG = 20.0
MAX_SPOTS = 100  # of 50 false stars most are among the brightest 20 that a unit looks at
SIZE_PX = 1024
NOISE_ARCSEC = 5.0
TOLERANCE_ARCSEC = 25.0  # the same for all: 5 sigma of a centroid
RESOLUTION_ARCSEC = 3600 * FIELD_DEG / SIZE_PX  # of stars within a pixel one is in the catalogue
CASES = {"no_false_stars": 0, "50_false_stars": 50}
SCENES, QUICK_SCENES = 400, 100
WARM_UP_SCENES = 5
MOST_SECONDS = 30.0  # of one solver in one case: a slow one gets fewer scenes
TURN = 20  # scenes of one solver before it is the next one's turn: all get the same load of the machine
RIGHT_DEG = 0.05  # a boresight farther off is wrong

Centroids = tuple[np.ndarray, np.ndarray, np.ndarray]  # x_px, y_px, magnitudes


class Ours:
    """One of the algorithms, from pixels on, as a peer is."""

    def __init__(
        self, algorithm: IdentificationAlgorithm, tables: StarTables, camera: CameraGeometry
    ) -> None:
        self._algorithm = algorithm
        self._tables = tables
        self._camera = camera
        self._parameters = IdentificationParameters(
            TOLERANCE_ARCSEC * ARCSEC, max_spots=MAX_SPOTS, field_normals=camera.field_normals(-2.0)
        )
        self.operations: list[int] = []

    def prepare(self, x_px: np.ndarray, y_px: np.ndarray, magnitudes: np.ndarray) -> Centroids:
        """Centroids as they are."""
        return x_px, y_px, magnitudes

    def solve(self, centroids: Centroids) -> Any:
        """Directions, then the identification."""
        x_px, y_px, magnitudes = centroids
        spikes = Spikes(self._camera.unit_vectors(x_px, y_px), magnitudes)
        return self._algorithm(spikes, self._tables, self._parameters)

    def boresight(self, result: Any) -> np.ndarray | None:
        """Third axis of the attitude, where it is valid."""
        identification, work = result
        self.operations.append(work.operations())
        if identification.reason != Reason.NONE:
            return None
        return attitude_matrix(identification.q_icrs_to_sensor)[2]


class Tally:
    """What one solver did in one case."""

    def __init__(self) -> None:
        self.ms: list[float] = []
        self.cpu_ms: list[float] = []
        self.right = self.wrong = 0

    def figures(self) -> dict[str, Any]:
        """Times and outcomes."""
        median, p95 = np.percentile(self.ms, (50, 95))
        return {
            "median_ms": float(f"{median:.4g}"),
            "p95_ms": float(f"{p95:.4g}"),
            "median_cpu_ms": float(f"{np.median(self.cpu_ms):.4g}"),  # what a busy machine leaves alone
            "scenes": len(self.ms),
            "right": self.right,
            "wrong": self.wrong,
            "not_solved": len(self.ms) - self.right - self.wrong,
        }


def centroids_of(scene: StarScene, camera: CameraGeometry) -> Centroids:
    """The scene's spikes in pixels."""
    x_px, y_px, _ = camera.project(scene.b_vectors)
    return x_px, y_px, scene.magnitudes


def run_case(
    solvers: dict[str, Any], scenes: Sequence[StarScene], camera: CameraGeometry, most_seconds: float
) -> Iterator[dict[str, Any]]:
    """Progress, then the tallies of all solvers as ``{"tallies": ...}``."""
    centroids = [centroids_of(scene, camera) for scene in scenes]
    boresights = [attitude_matrix(scene.q)[2] for scene in scenes]
    tallies = {name: Tally() for name in solvers}
    for first in range(0, len(scenes), TURN):
        for name, solver in solvers.items():
            tally = tallies[name]
            for number in range(first, min(first + TURN, len(scenes))):
                if sum(tally.ms) > 1e3 * most_seconds:
                    break
                given = solver.prepare(*centroids[number])
                begun, begun_cpu = time.perf_counter_ns(), time.thread_time_ns()
                result = solver.solve(given)
                ended_cpu, ended = time.thread_time_ns(), time.perf_counter_ns()
                tally.ms.append(1e-6 * (ended - begun))
                tally.cpu_ms.append(1e-6 * (ended_cpu - begun_cpu))
                found = solver.boresight(result)
                if found is not None:
                    off = math.degrees(math.acos(min(1.0, float(found @ boresights[number]))))
                    tally.right += off <= RIGHT_DEG
                    tally.wrong += not off <= RIGHT_DEG
        yield {"scene": min(first + TURN, len(scenes))}
    yield {"tallies": tallies}


def measure(scenes: int, seed: int, most_seconds: float) -> Iterator[dict[str, Any]]:
    """Progress, then all figures as ``{"figures": ...}``."""
    half = SIZE_PX / 2
    camera = CameraGeometry(SIZE_PX, SIZE_PX, half / math.tan(math.radians(FIELD_DEG / 2)))
    tables = scene_tables(LIMIT_MAG, math.degrees(2.0 * camera.half_diagonal_rad), RESOLUTION_ARCSEC)
    field = peers.Field(SIZE_PX, FIELD_DEG, TOLERANCE_ARCSEC)
    about: dict[str, Any] = {}
    solvers: dict[str, Any] = {name: Ours(item, tables, camera) for name, item in ALGORITHMS.items()}
    with tempfile.TemporaryDirectory() as folder:
        for name, how in peers.INSTALL.items():
            peer = peers.load(name, tables.catalogue, field, Path(folder))
            about[name] = {"absent": f"to measure it: {how}"} if peer is None else peer.about
            if peer is not None:
                solvers[name] = peer
        cases = {}
        for case, false_stars in CASES.items():
            settings = SceneSettings(FIELD_DEG, noise_arcsec=NOISE_ARCSEC, false_stars=false_stars)
            made = [make_scene(tables.catalogue, settings, seed, n) for n in range(scenes + WARM_UP_SCENES)]
            for _ in run_case(solvers, made[scenes:], camera, most_seconds):
                pass
            for solver in solvers.values():
                if isinstance(solver, Ours):
                    solver.operations.clear()
            for item in run_case(solvers, made[:scenes], camera, most_seconds):
                if "tallies" in item:
                    cases[case] = _case_figures(item["tallies"], solvers)
                else:
                    yield item
    yield {
        "figures": {
            "seed": seed,
            "catalogue": f"Hipparcos, Hp < {LIMIT_MAG:g}, {len(tables.catalogue)} stars",
            "field_deg": FIELD_DEG,
            "noise_arcsec": NOISE_ARCSEC,
            "tolerance_arcsec": TOLERANCE_ARCSEC,
            "peers": about,
            "cases": cases,
        }
    }


def _case_figures(tallies: dict[str, Tally], solvers: dict[str, Any]) -> dict[str, Any]:
    figures = {name: tally.figures() for name, tally in tallies.items()}
    for name, solver in solvers.items():
        if isinstance(solver, Ours):
            figures[name]["operations_median"] = int(np.median(solver.operations))
    if "tetra3rs" in figures:
        peer = float(np.median(tallies["tetra3rs"].ms))
        for name, tally in tallies.items():
            figures[name]["median_to_tetra3rs"] = float(f"{np.median(tally.ms) / peer:.3g}")
    return figures


def main() -> None:
    """Arguments as ``__main__`` gives them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=SCENES)
    parser.add_argument("--seed", type=int, default=None, help="default: a fresh one, told in the figures")
    parser.add_argument("--seconds", type=float, default=MOST_SECONDS, help="of one solver in one case")
    arguments = parser.parse_args()
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    seed = secrets.randbits(32) if arguments.seed is None else arguments.seed
    for item in measure(arguments.scenes, seed, arguments.seconds):
        print(json.dumps(item), flush=True)


if __name__ == "__main__":
    main()
