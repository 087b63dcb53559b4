"""Work: what the stages count. Cycles are computed from these counts in ``processor.py`` and nowhere else.

Every stage is ``stage(input, parameters) -> (output, Work)``. A count has a name, belongs to one stage, and
its definition here says what one of it is; a processor profile says what one of it costs.
To add a count: one line in ``_DEFINITIONS`` and one coefficient in each file of ``cycle_costs/``
(a test holds the two equal).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

__all__ = ["COUNTS", "STAGES", "CountDefinition", "Work"]

STAGES: Final = (
    "threshold",  # pixels against the local background, full frame or windows
    "clustering",  # runs to clusters, clusters of one star in two frames
    "centroid",  # clusters to spots and unit vectors
    "identification",  # lost in space
    "tracking",  # prediction, windows, verification by the pivot
    "attitude",  # vectors to quaternion, covariance
    "telemetry",  # packets out, telecommands in
)


@dataclass(frozen=True, slots=True)
class CountDefinition:
    """One kind of work: its stage and what one of it is.

    step: an elementary step of its stage's algorithm, as papers count them; False where the count is there
        for its cycles alone.
    """

    name: str
    stage: str
    meaning: str
    step: bool = True


_DEFINITIONS: Final[tuple[tuple[str, str, str] | tuple[str, str, str, bool], ...]] = (
    # threshold
    ("noise_samples", "threshold", "pixel pair of a full frame taken for background and noise"),
    ("noise_passes", "threshold", "such a pair in one pass of the background's or the noise's estimate"),
    ("threshold_pixels", "threshold", "pixel averaged and compared with the threshold, full frame"),
    ("block_pixels", "threshold", "pixel looked at by itself, as one of its block is over the threshold"),
    ("window_samples", "threshold", "pixel of a detection window counted into the medians of its statistics"),
    ("window_noise_pixels", "threshold", "pixel of a detection window in one pass of its mean and noise"),
    ("window_pixels", "threshold", "pixel of a detection window smoothed and compared with the threshold"),
    ("reread_pixels", "threshold", "pixel of a window larger than the data cache, from memory once more"),
    ("windows", "threshold", "detection window set up"),
    (
        "flow_pixels",
        "threshold",
        "pixel summed into mean and spread of an image and compared with its threshold",
    ),
    ("lit_blocks", "threshold", "block of a row with a pixel over that threshold, looked at pixel by pixel"),
    ("lit_pixels", "threshold", "pixel over that threshold, kept with its value for the next frame"),
    # clustering
    ("clusterings", "clustering", "clustering in a frame begun: its code is in no cache"),
    ("run_tables", "clustering", "table of runs gone through: of a full frame or a detection window"),
    ("cold_runs", "clustering", "run of a full frame or a large window: its pixels are in no cache by now"),
    ("runs", "clustering", "run of pixels over threshold put into the run table"),
    ("rows_joined", "clustering", "row whose runs are compared with those of the row above"),
    ("cluster_pixels", "clustering", "pixel over threshold summed into its cluster"),
    ("clusters", "clustering", "cluster with its sums completed"),
    ("cluster_lengths", "clustering", "cluster whose extent says whether stars are streaks"),
    ("piece_runs", "clustering", "run of a frame of streaks looked at for pieces beside it"),
    ("piece_runs_compared", "clustering", "run of the rows above compared with it"),
    ("runs_sorted", "clustering", "run of a full frame looked at for the spot that it belongs to"),
    ("streaks_kept", "clustering", "spot whose pixels are kept for the next frame"),
    ("runs_kept", "clustering", "run of such a spot copied to its others"),
    ("fusions", "clustering", "fusion of two frames' spots begun: its code is in no cache"),
    ("boxes_compared", "clustering", "bounding boxes of a spot before and one now compared"),
    ("boxes_met", "clustering", "such boxes that meet: their runs are looked at"),
    ("runs_compared", "clustering", "distance between a run before and one now"),
    # centroid
    ("measurings", "centroid", "measurement of a frame's clusters begun: its code is in no cache"),
    ("first_centroids", "centroid", "first centre of mass of a frame: its code is in no cache"),
    ("frames_measured", "centroid", "full frame with a centre of mass: its pixels filled the data cache"),
    ("cluster_tables", "centroid", "table of clusters gone through: of a full frame or a detection window"),
    ("clusters_refused", "centroid", "cluster refused for its size or place before it is measured"),
    ("mask_pixels", "centroid", "pixel of the square round a cluster that shows whose its pixels are"),
    ("mask_rows", "centroid", "row of such a square: its pixels lie elsewhere than those of the row before"),
    ("mask_runs", "centroid", "run of the rows of such a square, wherever on them, compared with it"),
    ("marked_pixels", "centroid", "pixel of such a square marked as one of a run or next to it"),
    ("centroid_stars", "centroid", "centre of mass computed once (its divisions), each pass counts"),
    ("centroid_pixels", "centroid", "pixel weighted into a centre of mass, each pass counts"),
    ("centroid_background_pixels", "centroid", "pixel of the ring round a spot for its local background"),
    ("centroid_interpolations", "centroid", "axis of a spot whose columns or rows are compared for Z (6)"),
    ("interpolations_solved", "centroid", "such an axis with its quadratic equation solved"),
    ("interpolated_tables", "centroid", "table of clusters with an interpolation: the noise of a moment"),
    ("first_interpolations", "centroid", "first interpolation of a frame: its code is in no cache"),
    ("spots_judged", "centroid", "spot whose magnitude is taken (a logarithm) and looked at"),
    ("energy_tables", "centroid", "table of clusters whose own sums are taken for centroids, M (1)-(2)"),
    ("energies", "centroid", "such a cluster measured: two quotients, the logarithm of its magnitude"),
    ("compensations", "centroid", "compensation of a rolling shutter begun: its code is in no cache"),
    ("spots_compensated", "centroid", "spot whose own velocity is compared with the least compensated"),
    ("spots_moved", "centroid", "spot brought to the frame's time by its own velocity"),
    ("spots_turned", "centroid", "spot brought to the frame's time by the rate of all stars"),
    ("spots_sorted", "centroid", "comparison and move when ordering spots by brightness, n log2 n"),
    ("flow_clusters", "centroid", "cluster of a whole image looked at whether it is a star to follow"),
    ("cold_clusters", "centroid", "such a cluster more than a data cache holds beside the rest of a frame"),
    ("flow_stars_sorted", "centroid", "comparison and move when ordering such stars by brightness, n log2 n"),
    ("flow_stars", "centroid", "such a star with its place computed (divisions)"),
    ("directions_begun", "centroid", "frame whose positions are turned to unit vectors: the code is cold"),
    ("unit_vectors", "centroid", "pixel position turned to a unit vector (pinhole)"),
    ("newton_steps", "centroid", "step of Newton's method that frees a position from distortion"),
    # identification
    ("kvector_queries", "identification", "range query of the pair catalogue by its k-vector"),
    ("kvector_hits", "identification", "pair returned by a range query"),
    ("angles_computed", "identification", "dot product of two measured unit vectors"),
    ("pairs_compared", "identification", "pair of two range query results compared for a common star"),
    ("triads_tested", "identification", "triad of spots tried (smart order)"),
    ("triangles_tested", "identification", "catalogue triangle candidate tested against its third side"),
    ("pyramids_tested", "identification", "catalogue triangle tested with a fourth (pyramid) spot"),
    ("candidates_marked", "identification", "entry of a per-star mark table written, read or cleared"),
    ("votes", "identification", "vote cast or read"),
    ("magnitudes_compared", "identification", "measured brightness compared with the catalogue or another"),
    ("catalogue_angles", "identification", "dot product of two catalogue unit vectors"),
    ("spots_confirmed", "identification", "further spot matched to a catalogue star"),
    ("trial_stars_projected", "identification", "catalogue star projected with a trial attitude"),
    ("identifications", "identification", "identification begun, whatever is in the image", False),
    ("spikes_taken", "identification", "spike checked and summed into the mean direction", False),
    ("cones_searched", "identification", "cone of the sky grid set up", False),
    ("spots_followed", "identification", "turned spot compared with the star it is thought to be", False),
    ("trials_confirmed", "identification", "trial whose matches suffice: field and chance looked at", False),
    ("marks_scattered", "identification", "mark of a star that is not at hand: a cold line", False),
    ("pairs_joined", "identification", "pair looked up in the marks of another side", False),
    ("fourths_compared", "identification", "angle of a fourth spot compared with a near star's", False),
    ("triads_joined", "identification", "triad of spots whose sides are joined: its flatness", False),
    ("third_sides", "identification", "third side of a catalogue triangle computed and compared", False),
    ("cone_stars", "identification", "star of a cell tested against a cone", False),
    ("marks_stamped", "identification", "mark that also says of which pivot or pole it is", False),
    ("votes_cast", "identification", "vote added to a spot's votes for a star", False),
    # tracking
    ("tracking_plans", "tracking", "plan of windows begun: attitude matrix, cone of the neighbours"),
    ("neighbours_read", "tracking", "star of the sky grid's cells compared with the cone of the neighbours"),
    ("predicted_stars_tested", "tracking", "catalogue star rotated, four-plane test R (3)-(4)"),
    ("predicted_stars_projected", "tracking", "predicted star projected to pixels"),
    ("windows_planned", "tracking", "window sized, clipped, compared with one other for merging"),
    ("verified_entries", "tracking", "star, window or spot sorted when a verification begins"),
    ("angles_verified", "tracking", "angle between the pivot's spot and another computed, R step 5"),
    ("angles_compared", "tracking", "angle of two spots compared with that of two stars"),
    ("reference_angles", "tracking", "angle between the pivot and another predicted star computed"),
    ("pivots_tried", "tracking", "spot tried as the pivot's"),
    ("spots_assigned", "tracking", "distance of a spot to a predicted star computed"),
    ("window_stars_paired", "tracking", "predicted star looked at for the one spot of its window"),
    ("stars_followed", "tracking", "star of the frame before looked for in this one by optical flow"),
    ("flow_rows", "tracking", "row of a frame's table of runs gone through for the window of such a star"),
    ("runs_looked_at", "tracking", "run of such a row compared with the window"),
    (
        "shift_rows",
        "tracking",
        "row of shifts at one of which the lit pixels of both frames meet: its set-up",
    ),
    ("lines_matched", "tracking", "pixel of a star multiplied with a run of the other frame: its set-up"),
    ("pixels_matched", "tracking", "pair of lit pixels of the two frames multiplied for a shift"),
    ("shifts_compared", "tracking", "whole-pixel shift in such a row whose squared differences are compared"),
    ("flow_centrings", "tracking", "centre of mass of a followed star computed once (its divisions)"),
    # attitude
    ("qmethod_stars", "attitude", "star summed into the attitude profile matrix"),
    ("qmethod_solves", "attitude", "largest eigenvector of the 4 x 4 matrix"),
    ("jacobi_rotations", "attitude", "plane rotation on the way to an eigenvector", False),
    ("residual_stars", "attitude", "star's residual computed with the attitude"),
    ("centroid_errors", "attitude", "expected error of a centroid computed, for its weight"),
    ("covariance_stars", "attitude", "star summed into the information matrix"),
    ("covariance_solves", "attitude", "3 x 3 inversion"),
    ("aberrated_stars", "attitude", "catalogue direction turned to apparent (aberration)"),
    ("observer_velocities", "attitude", "velocity of the Earth computed from time"),
    ("rate_solves", "attitude", "angular rate from two attitudes"),
    ("star_rates", "attitude", "rate of unidentified stars begun: its code is in no cache"),
    ("rate_stars", "attitude", "pair of such stars summed into the equations of a rate and compared with it"),
    ("streak_errors", "attitude", "expected errors of a streak's centroid, along it and across"),
    ("rate_least_squares", "attitude", "such equations solved"),
    ("shift_errors", "attitude", "expected errors of a star's shift computed, along it and across"),
    ("flow_equations", "attitude", "star whose shift is made two weighed equations of the rate"),
    ("flow_rates", "attitude", "pass over the stars for the rate by least squares: triangle, solution"),
    ("flow_rate_stars", "attitude", "star in such a pass: turned into the triangle, its residual, its rank"),
    ("rates_over_limit", "attitude", "rate over its limit compared with its uncertainty"),
    ("false_solutions", "attitude", "chance of a false solution computed (logarithms)"),
    ("spread_stars", "attitude", "star whose angle from the stars' mean is computed for that chance"),
    # telemetry
    ("sending_rounds", "telemetry", "packets sent between two frames: code and tables not in the caches"),
    ("receiving_rounds", "telemetry", "bytes received between two frames: code not in the caches"),
    ("telemetry_bytes", "telemetry", "byte packed into a telemetry packet and put on the line"),
    ("crc_bytes", "telemetry", "byte put through the CRC"),
    ("telecommands", "telemetry", "telecommand's headers checked"),
    ("telecommand_bytes", "telemetry", "byte received and unstuffed"),
    ("image_crc_pixels", "telemetry", "pixel of an image kept for download put through the CRC"),
    ("image_bytes", "telemetry", "byte of an image copied into a packet and put on the line"),
    ("frames", "telemetry", "frame handled at all: interrupts, mode logic, housekeeping"),
)

COUNTS: Final[Mapping[str, CountDefinition]] = {d[0]: CountDefinition(*d) for d in _DEFINITIONS}


class Work:
    """Counts of work done, by name. Addition of two works adds count by count."""

    __slots__ = ("counts",)

    def __init__(self, counts: Mapping[str, int] | None = None) -> None:
        self.counts: dict[str, int] = {}
        if counts:
            for name, number in counts.items():
                self.add(name, number)

    def add(self, name: str, number: int = 1) -> None:
        """Count ``number`` more of ``name``. KeyError: not in ``COUNTS``; ValueError: negative."""
        if name not in COUNTS:
            raise KeyError(f"{name!r} is no count of work; see firmware_model/work.py")
        if number < 0:
            raise ValueError(f"work cannot be negative: {name} = {number}")
        self.counts[name] = self.counts.get(name, 0) + int(number)

    def __getitem__(self, name: str) -> int:
        if name not in COUNTS:
            raise KeyError(f"{name!r} is no count of work; see firmware_model/work.py")
        return self.counts.get(name, 0)

    def __iadd__(self, other: Work) -> Work:
        counts = self.counts
        for name, number in other.counts.items():
            counts[name] = counts.get(name, 0) + number
        return self

    def __add__(self, other: Work) -> Work:
        total = Work()
        total.counts = dict(self.counts)
        total += other
        return total

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Work):
            return NotImplemented
        names = self.counts.keys() | other.counts.keys()
        return all(self.counts.get(name, 0) == other.counts.get(name, 0) for name in names)

    __hash__ = None  # type: ignore[assignment]  # mutable

    def by_stage(self) -> dict[str, dict[str, int]]:
        """The counts that are not zero, grouped by stage, stages in their order."""
        grouped: dict[str, dict[str, int]] = {stage: {} for stage in STAGES}
        for name, number in self.counts.items():
            if number:
                grouped[COUNTS[name].stage][name] = number
        return {stage: counts for stage, counts in grouped.items() if counts}

    def operations(self, stage: str = "identification") -> int:
        """Sum of all counts of a stage that are elementary steps, whatever each may cost."""
        return sum(n for name, n in self.counts.items() if COUNTS[name].stage == stage and COUNTS[name].step)

    def __repr__(self) -> str:
        return f"Work({self.counts!r})"
