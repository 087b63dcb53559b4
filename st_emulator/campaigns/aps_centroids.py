"""Centroid errors of the multi-poles paper's campaign: of the unit's way and of the paper's own, on the same
images.

The paper's own way ("M", Schiattarella, Spiller and Curti 2020): the mean over the cluster's pixels (1)-(2),
clusters as they come, every one with a partner in the image before (section 2.3), each compensated by the
length of its own streak (16)-(22). The unit's: `rate` in its file.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..firmware_model.configuration import FirmwareConfiguration, StarTables
from ..firmware_model.frame_log import FrameLog
from ..firmware_model.frame_result import FrameContext
from ..firmware_model.frame_search import SearchOutcome, velocity_over_c
from ..firmware_model.full_frame_search import identify_spots
from ..firmware_model.image.detection import detect_clusters
from ..firmware_model.image.rolling_shutter import RowTiming, compensate
from ..firmware_model.image.spots import Spots
from ..firmware_model.image.streaks import StreakTable, fuse, streak_table
from ..firmware_model.reasons import Reason
from ..firmware_model.star_motion import moved_spots
from ..firmware_model.work import Work
from ..world.truth_record import TruthRecord
from .spreads import Moments

Array = NDArray[np.float64]
IntArray = NDArray[np.int32]

MATCH_PX = 3.0  # a compensated centroid further from where a star truly is than this is no star's
LEAST_SPEED_PX_S = 25.0  # ASSUMED: v*, not printed; slower, a streak's length is its point spread's


@dataclass(frozen=True)
class AxisErrors:
    """Errors of centroids, px: as they are and compensated, x (horizontal) and y (vertical)."""

    plain_x: Moments
    plain_y: Moments
    compensated_x: Moments
    compensated_y: Moments

    @classmethod
    def of(cls, plain: Array, compensated: Array) -> AxisErrors:
        """Of errors float64[n, 2] each."""
        return cls(*(Moments.of(errors[:, axis]) for errors in (plain, compensated) for axis in (0, 1)))


@dataclass(frozen=True)
class CentroidErrors:
    """Of one image: of all fused stars, and of those among them that were recognised. astray: fused spots
    that are no star's within MATCH_PX, in neither.
    """

    fused: AxisErrors
    recognised: AxisErrors
    astray: int

    @classmethod
    def none(cls) -> CentroidErrors:
        """Of no star."""
        nothing = AxisErrors.of(np.zeros((0, 2)), np.zeros((0, 2)))
        return cls(nothing, nothing, 0)


def centroid_errors(
    truth: TruthRecord, plain: Spots, moved: Spots, fused: IntArray, outcome: SearchOutcome
) -> CentroidErrors:
    """Against where the stars are at the frame's time (M (46)). ``moved``: the spots of ``plain``
    compensated; ``fused``: places of those that ``outcome`` is of.
    """
    true = np.array([[star.x_mid_px, star.y_mid_px] for star in truth.stars]).reshape(-1, 2)
    if not len(fused) or not len(true):
        return replace(CentroidErrors.none(), astray=len(fused))
    now, then = (np.stack([item.x_px[fused], item.y_px[fused]], axis=1) for item in (moved, plain))
    distance = np.linalg.norm(now[:, np.newaxis] - true[np.newaxis], axis=2)
    place = true[distance.argmin(axis=1)]
    own = distance.min(axis=1) <= MATCH_PX
    named = np.zeros(len(fused), dtype=bool)
    if outcome.identification is not None and len(outcome.identification.star_index) == len(fused):
        named = outcome.identification.star_index >= 0
    errors, plain_errors = now - place, then - place
    return CentroidErrors(
        AxisErrors.of(plain_errors[own], errors[own]),
        AxisErrors.of(plain_errors[own & named], errors[own & named]),
        int((~own).sum()),
    )


def paper_configuration(configuration: FirmwareConfiguration) -> FirmwareConfiguration:
    """The unit set to M's own way."""
    assert configuration.rate is not None
    return replace(
        configuration,
        detection=replace(configuration.detection, centroid="cluster", piece_gap_px=0),
        rate=replace(configuration.rate, compensation="streak", least_speed_px_s=LEAST_SPEED_PX_S),
    )


@dataclass(frozen=True)
class PaperWay:
    """M's stages on two images that follow each other; ``configuration`` as `paper_configuration` gives."""

    configuration: FirmwareConfiguration
    tables: StarTables

    def clusters(self, image: NDArray[np.uint16]) -> StreakTable:
        """M sections 2.1 and 2.2."""
        detected, _ = detect_clusters(image, self.configuration.detection)
        return streak_table(detected)[0]

    def errors(
        self,
        before: StreakTable,
        now: StreakTable,
        context: FrameContext,
        period_s: float,
        truth: TruthRecord,
    ) -> tuple[CentroidErrors, bool]:
        """Of the second image, and whether there is an attitude of it."""
        configuration = self.configuration
        assert configuration.rate is not None
        log = FrameLog(Work(), None)
        rows = configuration.geometry.height_px
        timing = RowTiming(context.row_time_s, context.exposure_ns * 1e-9, period_s, rows)
        fusion, _ = fuse(before, now, configuration.rate.fusion_distance_px)
        places, _ = compensate(
            before,
            now,
            fusion,
            timing,
            configuration.rate.compensation,
            configuration.rate.least_speed_px_s,
        )
        moved = moved_spots(now.spots, places)
        velocity = velocity_over_c(context, configuration, log)
        outcome = identify_spots(moved, fusion.now, configuration, self.tables, velocity, log)
        solved = outcome.attitude is not None and outcome.reasons == Reason.NONE
        return centroid_errors(truth, now.spots, moved, fusion.now, outcome), solved
