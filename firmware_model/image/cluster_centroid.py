"""Centroid of a cluster as it is: the energy-weighted mean over all of its pixels, paper M eqs. (1)-(2).

Nothing under the threshold counts. For spots and for streaks alike it costs one division of sums that are
there already; the centre of mass of ``centroid.py`` takes in the light beside the cluster instead.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from . import centroid
from .centroid import SpotLimits
from .clustering import BACKGROUND, FIRST_X, FIRST_Y, LAST_X, LAST_Y, PEAK, PIXELS, SUM, SUM_X, SUM_Y

__all__ = ["measure_clusters"]


@numba.njit(nogil=True)
def measure_clusters(
    columns: int,
    rows: int,
    clusters: NDArray[np.float64],
    limits: SpotLimits,
    spots: NDArray[np.float64],
    outcome: NDArray[np.int8],
    tally: NDArray[np.int64],
) -> int:
    """Centroid, flux and verdict of each cluster. Returns the number of spots put into ``spots``.

    ``clusters``: ``float64[n, CLUSTER_FIELDS]`` as ``sum_clusters`` fills it; flux is the cluster's energy.
    The verdicts are those of ``centroid.measure_spots`` and in its order; a cluster at the edge of the
    image is EDGE, as some of its light is not there. ``spots``, ``outcome``, ``tally``: as there.
    """
    tally[centroid.ENERGY_TABLES] += 1
    found = 0
    for cluster in range(clusters.shape[0]):
        entry = clusters[cluster]
        outcome[cluster] = -1
        tally[centroid.CLUSTER_PIXELS] += int(entry[PIXELS])
        extent = max(entry[LAST_X] - entry[FIRST_X], entry[LAST_Y] - entry[FIRST_Y])
        at_edge = entry[FIRST_X] == 0 or entry[FIRST_Y] == 0
        at_edge = at_edge or entry[LAST_X] == columns - 1 or entry[LAST_Y] == rows - 1
        if entry[PIXELS] < limits.min_pixels:
            outcome[cluster] = centroid.SMALL
        elif entry[PIXELS] > limits.max_pixels or extent >= limits.max_extent:
            outcome[cluster] = centroid.LARGE
        elif at_edge:
            outcome[cluster] = centroid.EDGE
        elif entry[SUM] <= 0.0:
            outcome[cluster] = centroid.FAINT
        if outcome[cluster] >= 0:
            tally[outcome[cluster]] += 1
            tally[centroid.REFUSED] += 1
            continue
        tally[centroid.ENERGIES] += 1
        flux = entry[SUM]
        magnitude = -2.5 * math.log10(flux / limits.zero_point_dn)
        if not magnitude <= limits.magnitude_limit:
            outcome[cluster] = centroid.FAINT
        elif entry[PEAK] > limits.max_peak_fraction * flux:
            outcome[cluster] = centroid.SHARP
        if outcome[cluster] >= 0:
            tally[outcome[cluster]] += 1
            continue
        spot = spots[found]
        spot[centroid.X], spot[centroid.Y] = entry[SUM_X] / flux, entry[SUM_Y] / flux
        spot[centroid.FLUX], spot[centroid.MAGNITUDE] = flux, magnitude
        spot[centroid.SPOT_PEAK], spot[centroid.SPOT_PIXELS] = entry[PEAK], entry[PIXELS]
        saturated = entry[PEAK] + entry[BACKGROUND] >= limits.saturation_dn - 0.5
        spot[centroid.SATURATED] = 1.0 if saturated else 0.0
        spot[centroid.AT_EDGE] = 0.0
        found += 1
    return found
