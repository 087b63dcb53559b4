"""What two full frames that follow each other tell before any star is identified: rate, and places in time.

The steps of a unit with a ``[rate]`` section between detection and identification: the clusters' pixels are
kept, fused with those of the frame before, the rate of the fused stars is solved, and every centroid is
brought to the frame's time where the shutter is a rolling one.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from .camera_errors import CentroidError
from .geometry import CameraGeometry
from .image.optical_flow import FlowFrame, FlowParameters
from .image.rolling_shutter import COMPENSATIONS, RowTiming, intervals
from .image.spots import Spots, WindowSpots
from .image.streaks import Fusion, StreakTable
from .rate_from_flow import FlowRate, FlowSettings
from .star_rate import EXPECTED_JERK_RAD_S3, StarRate, bend_s2, rate_of_pairs, turned_later
from .work import Work

__all__ = [
    "KeptFrame",
    "RateParameters",
    "StarMotion",
    "TrackedStars",
    "moved_spots",
    "places_by_rate",
    "rate_of_fusion",
    "rate_of_windows",
]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]


@dataclass(frozen=True)
class RateParameters:
    """What the rate of unidentified stars and what follows from it need to know.

    fusion_distance_px: d_f of paper M. compensation: one of ``rolling_shutter.COMPENSATIONS``.
    least_speed_px_s: v* of paper M, slower stars are not compensated. tolerance_px: a pair that fits the rate
    worse than this is left out. min_stars: a rate needs so many pairs. frames_to_rate_only: after so many
    frames with a rate too high to track and no valid attitude the unit measures the rate alone.
    identify_below_rad_s: and below this rate it tries to identify nevertheless. flow: the rate is that of an
    optical flow, tuned by this, and nothing is fused; None: that of fused clusters.
    """

    fusion_distance_px: float = 2.0
    compensation: str = "rate"
    least_speed_px_s: float = 2.0
    tolerance_px: float = 1.5
    min_stars: int = 2
    frames_to_rate_only: int = 2
    identify_below_rad_s: float = 0.05
    flow: FlowParameters | None = None
    flow_settings: FlowSettings = field(default_factory=FlowSettings)

    def __post_init__(self) -> None:
        if self.compensation not in COMPENSATIONS:
            raise ValueError(
                f"compensation must be one of {', '.join(COMPENSATIONS)}, not {self.compensation!r}"
            )
        if self.min_stars < 2 or self.frames_to_rate_only < 1:
            raise ValueError("a rate needs 2 stars at least, and frames_to_rate_only of 1 or more")
        if not (self.fusion_distance_px >= 0.0 and self.tolerance_px > 0.0 and self.least_speed_px_s >= 0.0):
            raise ValueError("fusion_distance_px, tolerance_px and least_speed_px_s must not be negative")


@dataclass(frozen=True)
class KeptFrame:
    """What is kept of a full frame for the one directly after it: clusters with their pixels, or the lit
    pixels and the rate of an optical flow.
    """

    frame_index: int
    t_mid_ns: int
    table: StreakTable | None = None
    flow: FlowFrame | None = None
    flow_rate: FlowRate | None = None


@dataclass(frozen=True)
class TrackedStars:
    """Where stars of a frame stand in its pixels, before anything is compensated: row int32[n] of the
    catalogue, spots[n] of them.
    """

    frame_index: int
    t_mid_ns: int
    row: IntArray
    spots: Spots


@dataclass(frozen=True)
class StarMotion:
    """The spots of a frame at its time, which of them are stars by the frame before, and their rate.

    spots: of the whole frame, places compensated. fused: places of those with a partner that fits the rate;
    None where there is no frame directly before. rate: of the fused stars, None where too few fit.
    interval_s: between the two frames, 0 without one before.
    """

    spots: Spots
    fused: IntArray | None
    rate: StarRate | None
    interval_s: float = 0.0


def rate_of_fusion(
    before: StreakTable,
    now: StreakTable,
    fusion: Fusion,
    timing: RowTiming,
    geometry: CameraGeometry,
    centroid_error: CentroidError,
    tolerance_px: float,
    min_stars: int,
) -> tuple[StarRate | None, Work]:
    """Rate of the fused stars, each over the time between the exposures of its own two rows.

    That is what compensated centroids would give, without compensating them: a star that moves evenly stands
    at its centroid in the middle of the exposure of the centroid's row.
    """
    first, second = before.spots.take(fusion.before), now.spots.take(fusion.now)
    return _rate_of_spots(first, second, timing, geometry, centroid_error, tolerance_px, min_stars)


def single_spots(window: IntArray, found: WindowSpots) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Stars of windows that are theirs alone (place in ``window``, ascending), and the brightest spots."""
    stars = np.bincount(window, minlength=int(window.max(initial=-1)) + 1)
    first_of = np.full(len(stars), -1, np.int64)
    windows, firsts = np.unique(found.window, return_index=True)  # within a window brightest first
    first_of[windows] = firsts
    star = np.flatnonzero((stars[window] == 1) & (first_of[window] >= 0))
    return star, first_of[window[star]]


def rate_of_windows(
    before: TrackedStars,
    star: IntArray,
    window: IntArray,
    found: WindowSpots,
    timing: RowTiming,
    geometry: CameraGeometry,
    centroid_error: CentroidError,
    tolerance_px: float,
    min_stars: int,
) -> tuple[StarRate | None, Work]:
    """Rate from the spots of stars in the frame before to those of the same stars' windows.

    star: int32[n], the catalogue row of each star of the plan, and its window. Windows of one star alone, and
    the brightest spot of each. Pixels against pixels: from the places where an attitude puts the stars, its
    error would become one of the rate, that one of the next places, and so from frame to frame.
    """
    alone, spot = single_spots(window, found)
    place_of = {int(row): place for place, row in reversed(list(enumerate(before.row.tolist())))}
    place = np.array([place_of.get(row, -1) for row in star[alone].tolist()], np.int64)
    first, second = before.spots.take(place[place >= 0]), found.spots.take(spot[place >= 0])
    rate, work = _rate_of_spots(first, second, timing, geometry, centroid_error, tolerance_px, min_stars)
    work.add("window_stars_paired", len(window))
    return rate, work


def _rate_of_spots(
    first: Spots,
    second: Spots,
    timing: RowTiming,
    geometry: CameraGeometry,
    centroid_error: CentroidError,
    tolerance_px: float,
    min_stars: int,
) -> tuple[StarRate | None, Work]:
    """Rate of pairs of spots: first[i] and second[i] are one star, in two frames a period apart."""
    interval_s = intervals(first.y_px, second.y_px, timing)
    later_s = timing.row_time_s * (0.5 * (first.y_px + second.y_px) - timing.middle_row)
    then, steps_then = geometry.counted_unit_vectors(first.x_px, first.y_px)
    later, steps_later = geometry.counted_unit_vectors(second.x_px, second.y_px)
    moved = np.hypot(second.x_px - first.x_px, second.y_px - first.y_px)
    length = moved * timing.exposure_s / np.maximum(interval_s, 0.5 * timing.period_s)
    along_1, across_1 = centroid_error.streak_sigma_px(first.flux_dn, first.noise_dn, length)
    along_2, across_2 = centroid_error.streak_sigma_px(second.flux_dn, second.noise_dn, length)
    focal = geometry.focal_px
    bend = EXPECTED_JERK_RAD_S3 * bend_s2(later_s, timing.exposure_s) * interval_s
    rate, work = rate_of_pairs(
        then,
        later,
        interval_s,
        later_s,
        np.sqrt((along_1 * along_1 + along_2 * along_2) / (focal * focal) + bend * bend),
        np.sqrt((across_1 * across_1 + across_2 * across_2) / (focal * focal) + bend * bend),
        EXPECTED_JERK_RAD_S3 * timing.exposure_s * timing.exposure_s / 24.0,
        tolerance_px / focal,
        min_stars,
    )
    pairs = len(second)
    work += Work(
        {
            "directions_begun": 2 if pairs else 0,
            "unit_vectors": 2 * pairs,
            "newton_steps": steps_then + steps_later,
            "streak_errors": 2 * pairs,
        }
    )
    return rate, work


def places_by_rate(
    x_px: FloatArray,
    y_px: FloatArray,
    rate_rad_s: FloatArray,
    timing: RowTiming,
    geometry: CameraGeometry,
    least_speed_px_s: float,
    change_rad_s2: FloatArray,
) -> tuple[tuple[FloatArray, FloatArray], Work]:
    """Places of all spots at the frame's time: each turned by the rate from its row's time, exactly.

    rate_rad_s: of half a period before the frame's time, since when it changes by change_rad_s2.

    A rate under ``least_speed_px_s`` (across the boresight or about it at the corner of the image) leaves
    them as they are.
    """
    speed = geometry.focal_px * float(np.sqrt(rate_rad_s @ rate_rad_s))
    if timing.row_time_s == 0.0 or not len(x_px) or speed < least_speed_px_s:
        return (x_px, y_px), Work()
    vectors, steps = geometry.counted_unit_vectors(x_px, y_px)
    turned = turned_later(
        vectors,
        rate_rad_s,
        timing.until_reference_s(y_px),
        change_rad_s2,
        0.5 * timing.period_s,
        timing.exposure_s,
    )
    x, y, ahead = geometry.project(turned)
    x, y = np.where(ahead, x, x_px), np.where(ahead, y, y_px)
    work = {"directions_begun": 1, "unit_vectors": len(x), "newton_steps": steps, "spots_turned": len(x)}
    return (x, y), Work(work)


def moved_spots(spots: Spots, places: tuple[FloatArray, FloatArray]) -> Spots:
    """The spots at other places."""
    return replace(spots, x_px=places[0], y_px=places[1])
