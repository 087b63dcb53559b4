"""The identification algorithms on one star-level scene, and what a try of each came to."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from ..firmware_model.catalogue.tables import StarTables
from ..firmware_model.identification.algorithms import ALGORITHMS
from ..firmware_model.identification.interface import Identification, IdentificationParameters
from ..firmware_model.reasons import Reason
from ..world import quaternion
from .star_scenes import ARCSEC, StarScene

# Of the whole rotation: a wrong identification is off by degrees, a right one of three stars close together
# by some minutes of arc about the boresight.
RIGHT_DEG = 0.5
SIGMAS = 4.0  # ASSUMED: at 3 one of six sides of four stars is over it in 1.6 % of the cases, at 4 in 0.04 %

#: Names short enough for tables.
LABELS = {
    "brightness_referenced": "brightness",
    "geometric_voting": "voting",
    "multi_poles": "multi-poles",
}

SUCCESS, FAILURE, BAD = "success", "failure", "bad"


@dataclass(frozen=True)
class Attempt:
    """One algorithm on one scene.

    verdict: SUCCESS (every matched star is the right one and the attitude is within RIGHT_DEG), BAD (one of
    them is not), FAILURE (nothing identified). reason: of the identification; 0: an attitude was given as
    valid. operations: counts of the stage identification, all together. time_ns: on this computer.
    """

    verdict: str
    reason: int
    operations: int
    time_ns: int

    @property
    def confirmed(self) -> bool:
        """An attitude was given as valid (more than three stars alone)."""
        return self.reason == Reason.NONE


def pair_tolerance_rad(noise_arcsec: float) -> float:
    """SIGMAS of the angle between two stars, each with noise_arcsec (1 sigma) an axis."""
    return SIGMAS * float(np.sqrt(2.0)) * noise_arcsec * ARCSEC


def verdict_of(found: Identification, scene: StarScene) -> str:
    """Whether an identification is right."""
    if not found.identified or found.q_icrs_to_sensor is None:
        return FAILURE
    matched = found.star_index >= 0
    if np.any(found.star_index[matched] != scene.true_rows[matched]):
        return BAD
    error = np.linalg.norm(quaternion.error_rotation_vector(found.q_icrs_to_sensor, scene.q))
    return SUCCESS if error < np.radians(RIGHT_DEG) else BAD


_compiled: set[str] = set()  # algorithms that have run in this process


def attempts(
    scene: StarScene, tables: StarTables, parameters: IdentificationParameters
) -> tuple[Attempt, ...]:
    """Every algorithm, in the order of ALGORITHMS, on a scene. No compilation is in the times measured."""
    tried = []
    for name, identify in ALGORITHMS.items():
        if name not in _compiled:
            identify(scene.spikes, tables, parameters)
            _compiled.add(name)
        started = time.perf_counter_ns()
        found, work = identify(scene.spikes, tables, parameters)
        time_ns = time.perf_counter_ns() - started
        tried.append(Attempt(verdict_of(found, scene), int(found.reason), work.operations(), time_ns))
    return tuple(tried)
