"""The ROJA1 paper's real identifications (table 3): the unit looks where it looked, and must name the
same stars.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..report import check
from ..world import quaternion
from ..world.trajectory import InertialTrajectory
from .bench import Chain
from .campaign import CampaignRequest, CampaignResult

#: Hipparcos numbers, R table 3 (night of 2012-10-18).
QUADRUPLES = (
    (109592, 109556, 110103, 109972),
    (115389, 116187, 115806, 115915),
    (15863, 17358, 16335, 16826),
)
FRAMES = 4


def pointing_of(chain: Chain, hips: tuple[int, ...]) -> tuple[NDArray[np.float64], float]:
    """The attitude that looks at the middle of the stars with the roll that keeps them farthest from the
    edge.

    Returns (q_icrs_to_sensor, distance of the outermost star from the edge, px; negative when none holds
    them).
    """
    stars = chain.scene.stars
    vectors = np.array([stars.unit_vectors[int(np.flatnonzero(stars.hip == hip)[0])] for hip in hips])
    middle = vectors.sum(axis=0)
    ra = float(np.degrees(np.arctan2(middle[1], middle[0])) % 360)
    dec = float(np.degrees(np.arctan2(middle[2], np.hypot(middle[0], middle[1]))))
    best, margin = np.zeros(4), -np.inf
    width, height = chain.profile.detector.columns, chain.profile.detector.rows
    for roll in np.arange(0.0, 360.0, 2.0):
        q = quaternion.quaternion_from_pointing(ra, dec, float(roll))
        x, y, _ = chain.scene.camera.project(vectors @ quaternion.attitude_matrix(q).T)
        inside = float(np.min([x, y, width - 1 - x, height - 1 - y]))
        if inside > margin:
            best, margin = q, inside
    return best, margin


def run(request: CampaignRequest) -> CampaignResult:
    """Lost in space at each quadruple; all four stars must be among those identified."""
    chain = Chain.of(request.profile, request.seed)
    rows = []
    with request.workers.progress.task(len(QUADRUPLES)) as advance:
        for number, hips in enumerate(QUADRUPLES):
            q, margin = pointing_of(chain, hips)
            chain.look(InertialTrajectory(q))
            identified: set[int] = set()
            for frame in range(FRAMES):
                _, result = chain.step(number * FRAMES + frame)
                if result.valid:
                    identified |= {int(hip) for hip in result.stars.hip}
                    break
            ra, dec, roll = quaternion.pointing_from_quaternion(q)
            rows.append(
                {
                    "stars": list(hips),
                    "ra_deg": ra,
                    "dec_deg": dec,
                    "roll_deg": roll,
                    "edge_distance_px": margin,
                    "identified": sorted(identified),
                    "all_identified": set(hips) <= identified,
                }
            )
            advance()
    count = sum(bool(row["all_identified"]) for row in rows)
    figures = {"identified": count, "quadruples": rows}
    return CampaignResult(figures, [check("identified", count, "==", len(QUADRUPLES), "quadruples")])
