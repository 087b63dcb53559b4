"""What goes into the processing of a frame besides its pixels, what is carried on, and what comes out."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from .identification.interface import Identification
from .image.spots import Spots
from .modes import Mode, ModeEvent
from .reasons import Reason
from .star_motion import KeptFrame, TrackedStars
from .tracking import TrackingPlan
from .work import Work

__all__ = ["NO_RECTS", "FirmwareState", "FrameContext", "FrameResult", "IdentifiedStars"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]

NO_RECTS: IntArray = np.zeros((0, 4), np.int32)


@dataclass(frozen=True)
class FrameContext:
    """What the firmware knows about a frame besides its pixels.

    acquisition: LOST_IN_SPACE, TRACKING or RATE_ONLY, how the frame is to be searched.
    t_mid_ns: mid-exposure, ns since power-on (of a rolling shutter that of the middle row); exposure_ns;
        tai_ns: on-board time of mid-exposure (TAI, ns since 1958-01-01), None while the time is not set.
    row_time_s: a rolling shutter's row begins its exposure so much after the row before; 0: a global shutter.
    """

    frame_index: int
    acquisition: Mode
    t_mid_ns: int
    exposure_ns: int
    tai_ns: int | None = None
    row_time_s: float = 0.0


@dataclass(frozen=True)
class FirmwareState:
    """What is carried from frame to frame.

    q_icrs_to_sensor, covariance_rad2, t_ns: the last valid attitude, or None; covariance None where it was
        sent to the unit rather than measured. pivot: its brightest star, row of the catalogue, -1 without.
    solved, solved_t_ns: the last attitude solved, also where it was not valid because the rate was too high.
    missed: consecutive tracking frames without attitude.
    Of a unit with ``FirmwareConfiguration.rate`` alone: previous: the last frame if it was a full one, its
    spots and their runs; rate_rad_s, rate_t_ns: the last rate measured; fast: consecutive full frames with a
    rate too high to track and no valid attitude.
    """

    q_icrs_to_sensor: FloatArray | None = None
    covariance_rad2: FloatArray | None = None
    t_ns: int = 0
    pivot: int = -1
    solved: FloatArray | None = None
    solved_covariance_rad2: FloatArray | None = None
    solved_t_ns: int = 0
    missed: int = 0
    previous: KeptFrame | None = None
    tracked: TrackedStars | None = None
    rate_rad_s: FloatArray | None = None
    rate_covariance_rad2_s2: FloatArray | None = None
    rate_t_ns: int = 0
    fast: int = 0

    @classmethod
    def initial(cls) -> FirmwareState:
        """State after power-on: no attitude is known."""
        return cls()

    @classmethod
    def from_attitude(cls, q_icrs_to_sensor: FloatArray, t_ns: int) -> FirmwareState:
        """State from which tracking starts at an attitude that was sent to the unit, valid at t_ns.

        Raises ValueError unless the quaternion's length is 1 within 1e-3; it is then made canonical.
        """
        q = np.asarray(q_icrs_to_sensor, np.float64)
        length = float(np.sqrt(q @ q)) if q.shape == (4,) else math.nan
        if not abs(length - 1.0) < 1e-3:
            raise ValueError(f"not a unit quaternion: {q_icrs_to_sensor}")
        return cls(q_icrs_to_sensor=q / math.copysign(length, float(q[3])), t_ns=t_ns)


@dataclass(frozen=True)
class IdentifiedStars:
    """Stars of a frame; all arrays have one entry per star."""

    hip: IntArray
    row: IntArray
    spot: IntArray
    x_px: FloatArray
    y_px: FloatArray
    residual_arcsec: FloatArray

    def __len__(self) -> int:
        return len(self.hip)

    @classmethod
    def none(cls) -> IdentifiedStars:
        """No stars."""
        no_int, no_float = np.zeros(0, np.int32), np.zeros(0)
        return cls(no_int, no_int, no_int, no_float, no_float, no_float)


@dataclass(frozen=True)
class FrameResult:
    """What came of a frame, with its intermediates.

    valid, reasons: reasons is NONE when valid. q_icrs_to_sensor: the frame's attitude at mid-exposure;
        where not valid the last valid one (identity before the first). covariance_rad2: of the small-angle
        error in sensor axes (zeros where not valid). rate_rad_s: of the sensor relative to ICRS, in sensor
        axes; None where unknown. rate_covariance_rad2_s2: of its error, float64[3, 3]; None where not known.
    acquisition_after: how the next frame is to be searched; event: what happened to the mode, if anything.
    false_solutions: how many attitudes chance would let fit the spots as well, over the whole sky; inf where
        not valid.
    spots: of the full frame, or of the windows. rects: int32[m, 4], detection windows. All else as named.
    """

    frame_index: int
    valid: bool
    reasons: Reason
    q_icrs_to_sensor: FloatArray
    covariance_rad2: FloatArray
    rate_rad_s: FloatArray | None
    acquisition_after: Mode
    event: ModeEvent | None
    spots: Spots
    stars: IdentifiedStars
    residual_rms_arcsec: float
    window_half_width_px: int
    work: Work
    state: FirmwareState
    rects: IntArray = field(default_factory=lambda: NO_RECTS)
    plan: TrackingPlan | None = None
    identification: Identification | None = None
    false_solutions: float = math.inf
    rate_covariance_rad2_s2: FloatArray | None = None

    @property
    def background_dn(self) -> float:
        """Background of the image."""
        return self.spots.background_dn

    @property
    def noise_dn(self) -> float:
        """Noise of the background, 1 sigma."""
        return self.spots.noise_dn

    @property
    def spots_detected(self) -> int:
        """Number of spots."""
        return len(self.spots)

    @property
    def stars_identified(self) -> int:
        """Number of stars that the attitude is made of (or would be, where it is not valid)."""
        return len(self.stars)

    @property
    def windows(self) -> int:
        """Number of detection windows."""
        return len(self.rects)

    @property
    def star_index(self) -> IntArray:
        """int32[spots], row of the catalogue for each spot, -1 where it is no identified star."""
        index = np.full(len(self.spots), -1, np.int32)
        index[self.stars.spot] = self.stars.row
        return index
