"""Full-frame detection: adaptive threshold, clustering, centroids, magnitude limit."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from ..work import Work
from . import centroid
from .background import frame_samples, frame_statistics
from .centroid import SpotLimits
from .cluster_centroid import measure_clusters
from .clustering import (
    FIRST_X,
    FIRST_Y,
    LAST_X,
    LAST_Y,
    PIXELS,
    RUN_FIELDS,
    SUM,
    join_pieces,
    join_runs,
    sum_clusters,
    threshold_scan,
)
from .interpolation import HALF_HEIGHT_PX, InterpolationTerms, interpolation_terms
from .spots import Rejections, Spots
from .streaks import DetectedClusters

__all__ = ["CENTROIDS", "DetectionParameters", "detect", "detect_clusters"]

CENTROIDS = ("com", "gaussian", "cluster")  # paper Z (1)-(3) and (4)-(6), paper M (1)-(2)


_POSITIVE = (
    "sigma_factor",
    "tau_min_dn",
    "window_sigma_factor",
    "exposure_s",
    "zero_point_dn_per_s",
    "min_pixels",
    "max_pixels",
    "max_extent_px",
    "centroid_half_window_px",
    "average_pixels",
    "max_runs",
    "max_spots",
)


# Stars are streaks where the median of the extents of the brightest clusters is at least this.
# ASSUMED: a star of magnitude 0 at rest is 8 px wide, the usual ones 3 to 5; five are there in any field, and
# neither the Moon nor a hot pixel decides.
STREAK_EXTENT_PX = 7.0
JUDGED_CLUSTERS = 5


@dataclass(frozen=True, slots=True)
class DetectionParameters:
    """What the image stages need to know; the same for full frames and windows."""

    sigma_factor: float = 5.0  # threshold over the local background, in units of the frame's noise
    tau_min_dn: float = 1.0  # and never less than this (paper M: tau_pre), DN
    min_pixels: int = 2  # clusters below this are dropped (paper M: isolated pixels)
    max_pixels: int = 2000  # clusters above this are no stars
    max_extent_px: int = 128  # nor are clusters longer than this, on either axis
    centroid_half_window_px: int = 2  # the centre of mass is taken over +-(this + 0.5) px at least
    magnitude_limit: float = 99.0  # spots dimmer than this are dropped (paper R: < 6.9)
    zero_point_dn_per_s: float = 1.0e6  # DN/s of a magnitude 0 star
    exposure_s: float = 0.1
    saturation_dn: int = 65535  # a pixel at or above is saturated
    max_peak_fraction: float = 0.85  # a spot with more of its flux in one pixel is a hot pixel
    average_pixels: int = 256  # length of the moving average along the scan
    max_runs: int = 16384  # size of the run table
    max_spots: int = 1000  # spots handed on; the dimmest are dropped
    window_sigma_factor: float = 4.0  # threshold in detection windows, where a star is expected
    # ASSUMED: in a window a catalogue star is expected, so one whose noise (or whose streak's lost rim)
    # puts it a little beyond the limit is still wanted
    window_magnitude_margin: float = 0.3
    centroid: str = "com"  # one of CENTROIDS
    psf_sigma_px: float = 0.75  # of the point spread that "gaussian" takes a spot for
    interpolation_half_height_px: int = HALF_HEIGHT_PX  # its columns are summed over +- so many rows
    piece_gap_px: int = 0  # where stars are streaks, pieces so near to each other are one; 0: never

    def __post_init__(self) -> None:
        for name in _POSITIVE:
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)}")
        if self.centroid not in CENTROIDS:
            raise ValueError(f"centroid must be one of {', '.join(CENTROIDS)}, not {self.centroid!r}")
        self.interpolation_terms()

    def spot_limits(self, in_windows: bool = False) -> SpotLimits:
        """The part that the measurement of spots needs, in the types that its compiled code expects."""
        margin = self.window_magnitude_margin if in_windows else 0.0
        return SpotLimits(
            int(self.centroid_half_window_px),
            int(self.min_pixels),
            int(self.max_pixels),
            int(self.max_extent_px),
            float(self.max_peak_fraction),
            int(self.saturation_dn),
            float(self.zero_point_dn_per_s * self.exposure_s),
            float(self.magnitude_limit + margin),
            self.interpolation_terms(),
        )

    def interpolation_terms(self) -> InterpolationTerms:
        """The part that Gaussian interpolation needs. ValueError: see there."""
        return interpolation_terms(
            float(self.psf_sigma_px), self.centroid == "gaussian", self.interpolation_half_height_px
        )


@numba.njit(nogil=True)
def streaks_seen(table: NDArray[np.float64]) -> bool:
    """Whether the brightest of ``float64[clusters, CLUSTER_FIELDS]`` are longer than stars at rest."""
    extents = np.empty(JUDGED_CLUSTERS)
    sums = np.empty(JUDGED_CLUSTERS)
    judged = 0
    for cluster in range(table.shape[0]):
        entry = table[cluster]
        place = judged
        while place > 0 and sums[place - 1] < entry[SUM]:
            place -= 1
        if place == JUDGED_CLUSTERS:
            continue
        judged = min(judged + 1, JUDGED_CLUSTERS)
        for later in range(judged - 1, place, -1):
            sums[later], extents[later] = sums[later - 1], extents[later - 1]
        sums[place] = entry[SUM]
        extents[place] = max(entry[LAST_X] - entry[FIRST_X], entry[LAST_Y] - entry[FIRST_Y]) + 1.0
    long = 0
    for place in range(judged):
        long += int(extents[place] >= STREAK_EXTENT_PX)
    return 2 * long > judged


@numba.njit(nogil=True)
def _detect(
    image: NDArray[np.uint16],
    sigma_factor: float,
    tau_min_dn: float,
    average_pixels: int,
    max_runs: int,
    whole_clusters: bool,
    piece_gap_px: int,
    limits: SpotLimits,
    tally: NDArray[np.int64],
) -> tuple[
    NDArray[np.float64],
    float,
    float,
    int,
    int,
    int,
    bool,
    NDArray[np.int32],
    NDArray[np.int32],
    NDArray[np.float64],
    NDArray[np.int8],
    bool,
]:
    background, noise, samples = frame_statistics(image)
    runs = np.empty((max_runs, RUN_FIELDS), np.int32)
    run_background = np.empty(max_runs, np.float64)
    row_start = np.empty(image.shape[0] + 1, np.int32)
    over = max(sigma_factor * noise, tau_min_dn)
    count, overflowed, looked_at = threshold_scan(
        image, background, over, average_pixels, runs, run_background, row_start
    )
    scanned = runs[count - 1, 0] + 1 if overflowed else image.shape[0]
    label = np.empty(count, np.int32)
    clusters, _ = join_runs(runs, count, row_start, label)
    table = sum_clusters(image, runs, count, run_background, label, clusters)
    streaks = False
    if piece_gap_px > 0:
        tally[centroid.LENGTHS] += clusters
        streaks = streaks_seen(table)
        if streaks:
            tally[centroid.PIECES] += count
            clusters, compared = join_pieces(runs, count, row_start, label, clusters, piece_gap_px)
            tally[centroid.PIECE_RUNS] += compared
            for cluster in range(table.shape[0]):
                tally[centroid.RESUMMED] += int(table[cluster, PIXELS])
            table = sum_clusters(image, runs, count, run_background, label, clusters)
    spots = np.empty((clusters, centroid.SPOT_FIELDS), np.float64)
    outcome = np.empty(clusters, np.int8)
    if whole_clusters:
        found = measure_clusters(image.shape[1], image.shape[0], table, limits, spots, outcome, tally)
    else:
        found = centroid.measure_spots(
            image,
            runs,
            row_start,
            label,
            table,
            noise,
            True,
            1,
            limits,
            spots,
            outcome,
            tally,
        )
    return (
        spots[:found],
        background,
        noise,
        samples,
        scanned,
        looked_at,
        overflowed,
        runs[:count],
        label,
        table,
        outcome,
        streaks,
    )


def spots_of_table(
    table: NDArray[np.float64], rejected: Rejections, background_dn: float, noise_dn: float, overflowed: bool
) -> Spots:
    """Spots of a table ``float64[n, SPOT_FIELDS]`` as ``centroid.measure_spots`` fills it, order kept."""
    return Spots(
        x_px=np.ascontiguousarray(table[:, centroid.X]),
        y_px=np.ascontiguousarray(table[:, centroid.Y]),
        flux_dn=np.ascontiguousarray(table[:, centroid.FLUX]),
        magnitude=np.ascontiguousarray(table[:, centroid.MAGNITUDE]),
        peak_dn=np.ascontiguousarray(table[:, centroid.SPOT_PEAK]),
        pixels=table[:, centroid.SPOT_PIXELS].astype(np.int32),
        saturated=table[:, centroid.SATURATED] > 0.5,
        at_edge=table[:, centroid.AT_EDGE] > 0.5,
        background_dn=background_dn,
        noise_dn=noise_dn,
        rejected=rejected,
        overflowed=overflowed,
    )


def sorting_work(spots: int) -> int:
    """Comparisons of ordering n spots by brightness: n ceil(log2 n)."""
    return spots * max(spots - 1, 0).bit_length()


def detect(image: NDArray[np.uint16], parameters: DetectionParameters) -> tuple[Spots, Work]:
    """Find the spots of a whole image. ``image``: ``uint16[rows, columns]`` DN.

    Threshold: local background (moving average along a zigzag scan, paper M section 2.1) plus
    max(``sigma_factor`` * noise of this frame, ``tau_min_dn``). Runs are joined to 8-connected clusters;
    each cluster between ``min_pixels`` and ``max_pixels`` is measured (centre of mass, paper Z (1)-(3),
    Gaussian interpolation, (4)-(6), or the mean of the cluster itself, paper M (1)-(2)) and kept if its flux
    is brighter than ``magnitude_limit``. Spots come brightest first.
    ``Spots.overflowed``: more runs than ``max_runs``; the spots are of the part scanned until then.
    """
    detected, work = detect_clusters(image, parameters)
    return detected.spots, work


def detect_clusters(
    image: NDArray[np.uint16], parameters: DetectionParameters
) -> tuple[DetectedClusters, Work]:
    """As ``detect``, with the runs and clusters that the spots are of."""
    if image.ndim != 2 or image.dtype != np.uint16 or image.shape[1] < 2:
        raise ValueError(f"an image is uint16[rows, columns >= 2], not {image.dtype}{list(image.shape)}")
    tally = np.zeros(centroid.TALLIES, np.int64)
    (
        measured,
        background,
        noise,
        samples,
        scanned,
        looked_at,
        overflowed,
        runs,
        label,
        table,
        outcome,
        streaks,
    ) = _detect(
        np.ascontiguousarray(image),
        float(parameters.sigma_factor),
        float(parameters.tau_min_dn),
        int(parameters.average_pixels),
        int(parameters.max_runs),
        parameters.centroid == "cluster",
        int(parameters.piece_gap_px),
        parameters.spot_limits(),
        tally,
    )
    found = len(measured)
    order = np.argsort(-measured[:, centroid.FLUX], kind="stable")[: parameters.max_spots]
    counts = tally.tolist()
    rejected = Rejections(
        small=counts[centroid.SMALL],
        large=counts[centroid.LARGE],
        sharp=counts[centroid.SHARP],
        edge=counts[centroid.EDGE],
        faint=counts[centroid.FAINT],
        surplus=found - len(order),
    )
    work = Work()
    work.counts = {
        "noise_samples": frame_samples(image),
        "noise_passes": samples,
        "threshold_pixels": scanned * image.shape[1],
        "block_pixels": looked_at,
        "clusterings": 1,
        "run_tables": 1,
        "cold_runs": len(runs),
        "runs": len(runs),
        "rows_joined": image.shape[0],
        "cluster_pixels": counts[centroid.CLUSTER_PIXELS],
        "clusters": len(table),
        "frames_measured": int(counts[centroid.PASSES] > 0),
        "spots_sorted": sorting_work(found),
    }
    work.counts |= centroid.centroid_counts(counts)
    work.counts |= {
        "cluster_lengths": counts[centroid.LENGTHS],
        "piece_runs": counts[centroid.PIECES],
        "piece_runs_compared": counts[centroid.PIECE_RUNS],
    }
    work.add("cluster_pixels", counts[centroid.RESUMMED])
    spots = spots_of_table(measured[order], rejected, background, noise, overflowed)
    extent = table[:, FIRST_X : LAST_Y + 1].astype(np.int32)
    cluster = np.flatnonzero(outcome < 0)[order]
    return DetectedClusters(spots, cluster, extent, runs, label, bool(streaks)), work
