"""Rolling shutter: every centroid brought to one instant, the middle of the detector's exposure.

Each row begins its exposure ``row_time_s`` after the row above, so the centroid of a streak is where the
star was in the middle of the exposure of the row that the centroid lies in (exactly so at constant speed).
Paper M, section 3.2, takes a star's speed from the length of its streak (9)-(17) and its sense from the
fusion; the others take it from the displacement between two frames, or from the rate of all stars.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from ..work import Work
from .streaks import Fusion, StreakTable

__all__ = ["COMPENSATIONS", "RowTiming", "compensate", "intervals"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]

COMPENSATIONS = ("rate", "displacement", "streak", "none")


@dataclass(frozen=True, slots=True)
class RowTiming:
    """When the rows of a frame are exposed.

    row_time_s: from the begin of a row's exposure to that of the next; 0: a global shutter. exposure_s: of
    each row. period_s: from the frame before to this one. rows: of the detector; the middle one, whose place
    is (rows - 1) / 2, is exposed about the frame's time.
    """

    row_time_s: float
    exposure_s: float
    period_s: float
    rows: int

    @property
    def middle_row(self) -> float:
        return 0.5 * (self.rows - 1)

    def until_reference_s(self, y_px: FloatArray) -> FloatArray:
        """From the middle of the exposure of places in these rows to the frame's time, paper M (22)."""
        return np.asarray(self.row_time_s * (self.middle_row - y_px))


def intervals(y_before_px: FloatArray, y_now_px: FloatArray, timing: RowTiming) -> FloatArray:
    """Time between the exposures of places in the frame before and in this one, float64[n], s."""
    return np.asarray(timing.period_s + timing.row_time_s * (y_now_px - y_before_px))


def compensate(
    before: StreakTable,
    now: StreakTable,
    fusion: Fusion,
    timing: RowTiming,
    method: str,
    least_speed_px_s: float,
) -> tuple[tuple[FloatArray, FloatArray], Work]:
    """Places x_px[n], y_px[n] of all spots of ``now`` at the frame's time.

    method: ``streak``, paper M (12), (16)-(17), (20)-(22): speed by the extents of the streak, sense by the
    fusion. The sense is that from the frame before to this one; (3) prints the opposite, which would double
    the error. ``displacement``: velocity by the centroids of the pair over the time between their exposures.
    ``none``: as they are. Spots without a partner, and those slower than ``least_speed_px_s`` (v* of paper
    M), stay as they are.
    """
    if method not in COMPENSATIONS[1:]:
        raise ValueError(f"method must be one of {', '.join(COMPENSATIONS[1:])}, not {method!r}")
    x_px, y_px = now.spots.x_px.copy(), now.spots.y_px.copy()
    if method == "none" or timing.row_time_s == 0.0 or not len(fusion):
        return (x_px, y_px), Work()
    moved = _compensate(
        before.spots.x_px,
        before.spots.y_px,
        fusion.before,
        fusion.now,
        now.extent,
        timing.row_time_s,
        timing.exposure_s,
        timing.period_s,
        timing.middle_row,
        method == "streak",
        least_speed_px_s,
        x_px,
        y_px,
    )
    return (x_px, y_px), Work(
        {"compensations": 1, "spots_compensated": len(fusion), "spots_moved": int(moved)}
    )


@numba.njit(nogil=True)
def _compensate(
    x_before: FloatArray,
    y_before: FloatArray,
    pair_before: IntArray,
    pair_now: IntArray,
    extent: IntArray,
    row_time_s: float,
    exposure_s: float,
    period_s: float,
    middle_row: float,
    by_streak: bool,
    least_speed_px_s: float,
    x: FloatArray,
    y: FloatArray,
) -> int:
    moved = 0
    for pair in range(len(pair_now)):
        i, j = pair_before[pair], pair_now[pair]
        across, down = x[j] - x_before[i], y[j] - y_before[i]
        if by_streak:
            # lengths between the centres of the outer pixels, as (7) counts rows
            length_x = float(extent[j, 1] - extent[j, 0])
            length_y = float(extent[j, 3] - extent[j, 2])
            late_s = row_time_s * length_y
            lit_s = exposure_s + late_s if down >= 0.0 else exposure_s - late_s
            speed_x = length_x / lit_s if across >= 0.0 else -length_x / lit_s
            speed_y = length_y / lit_s if down >= 0.0 else -length_y / lit_s
        else:
            lit_s = period_s + row_time_s * down
            speed_x, speed_y = across / lit_s, down / lit_s
        if lit_s <= 0.0 or speed_x * speed_x + speed_y * speed_y < least_speed_px_s * least_speed_px_s:
            continue
        until_s = row_time_s * (middle_row - y[j])
        x[j] += speed_x * until_s
        y[j] += speed_y * until_s
        moved += 1
    return moved
