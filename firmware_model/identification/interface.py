"""What every identification algorithm takes and gives."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Protocol

import numba
import numpy as np
import numpy.typing as npt

from ..catalogue.tables import StarTables
from ..reasons import Reason
from ..work import Work

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]


@dataclass(frozen=True)
class Spikes:
    """What was detected in an image, brightest first.

    b_vectors: float64[n, 3], unit vectors in the sensor frame. magnitudes: float64[n], as measured.
    """

    b_vectors: FloatArray
    magnitudes: FloatArray

    def __len__(self) -> int:
        return len(self.b_vectors)


@dataclass(frozen=True)
class BrightnessParameters:
    """Of the brightness-referenced algorithm (Zhang et al. 2014).

    distinct_mag: of two spikes whose magnitudes differ by more than this (gamma of the paper, there of
        intensities) the brighter one is the brighter star of its catalogue pair; of others either may be.
        ASSUMED: 0.7, the largest error of a magnitude that the paper saw in flight.
    bright_limit_mag: M_t, the reference (three-star) mode is for images whose brightest star is over it.
    """

    distinct_mag: float = 0.7
    bright_limit_mag: float = 3.0


@dataclass(frozen=True)
class MultiPolesParameters:
    """Of the improved multi-poles algorithm.

    magnitude_tolerance: eps_m of its equation (38). ASSUMED: 0.7; the paper prints none.
    least_recognised: t*, so many stars accepted by two poles are recognised (table 1 of the paper: 5).
    """

    magnitude_tolerance: float = 0.7
    least_recognised: int = 5


@dataclass(frozen=True)
class IdentificationParameters:
    """Limits of an identification; angles in rad.

    tolerance_rad: largest error of the angle between two spots, and of a spot against the solution.
    max_spots: patterns are built from so many of the brightest spots; all spots are matched to a solution.
    min_stars: a solution needs at least so many matched stars. A triangle alone is never valid, so 4 at
        least.
    field_normals: float64[4, 3], inward normals of the field's four planes in the sensor frame
        (``CameraGeometry.field_normals``), to count the stars that the image should show; None: not counted.
    least_seen_share: of the catalogue stars in the field that are brighter than the middle one of those
        matched, at least this share must be matched.
    magnitude_tolerance: a match is odd if its brightness is off by more than this from the median of the
        matches; of fewer than 6 matches at most one may be odd. ASSUMED: 1.5, twice the largest error of
        Zhang et al. 2014 (0.7).
    most_false_solutions: a solution counts only if chance would give fewer solutions as good as it per image.
    most_false_triangles: the same for three stars alone, which are never valid (UNCONFIRMED). ASSUMED: 0.01,
        so that what is called unconfirmed is right far more often than not.
    certain_false_solutions: below this the search ends; above it goes on and looks for a rival.
    max_triads, max_pairs_compared: limits of the pyramid's work.
    max_operations: limit of the work of any algorithm, the sum of all its counts of the stage
        identification (`Work.operations`); looked at once per outer step, so it is passed by one step at
        most. A search that reaches it ends with WORK_LIMIT.
    max_cycles, count_cycles: the same limit in the processor's time; count_cycles: what one of each of
        `verification.COUNT_NAMES` costs (the attitudes tried included), None: no limit.
    brightness, multi_poles: of those algorithms alone.
    """

    tolerance_rad: float
    max_spots: int = 20
    min_stars: int = 4
    field_normals: FloatArray | None = field(default=None, compare=False)
    least_seen_share: float = 0.5
    magnitude_tolerance: float = 1.5
    most_false_solutions: float = 1e-5
    most_false_triangles: float = 1e-2
    certain_false_solutions: float = 1e-9
    max_triads: int = 10_000
    max_pairs_compared: int = 3_000_000
    max_operations: int = 1_000_000_000
    max_cycles: float = math.inf
    count_cycles: FloatArray | None = field(default=None, compare=False)
    brightness: BrightnessParameters = BrightnessParameters()
    multi_poles: MultiPolesParameters = MultiPolesParameters()

    def __post_init__(self) -> None:
        if not 0.0 < self.tolerance_rad < 0.1:
            raise ValueError(f"tolerance_rad {self.tolerance_rad} is not between 0 and 0.1")
        if self.min_stars < 4:
            raise ValueError(f"min_stars {self.min_stars}: a triangle alone is never valid, 4 is the least")
        if self.max_spots < 4:
            raise ValueError(f"max_spots {self.max_spots}: a pyramid needs 4")
        if self.max_operations < 0:
            raise ValueError(f"max_operations {self.max_operations} is negative")

    @property
    def normals(self) -> FloatArray:
        """For kernels: field_normals, float64[4, 3], or float64[0, 3] where the field is not given."""
        if self.field_normals is None:
            return np.zeros((0, 3))
        return np.ascontiguousarray(self.field_normals, np.float64)

    @property
    def work_limit(self) -> FloatArray:
        """For `verification.exhausted_kernel`: max_operations, max_cycles, cycles of one of each count."""
        cycles = () if self.count_cycles is None else self.count_cycles
        return np.array([self.max_operations, self.max_cycles, *cycles])


@dataclass(frozen=True)
class Identification:
    """Outcome of an identification.

    star_index: int32[n], row of the star catalogue for each spot, -1 where none; all -1 unless identified.
    verified: number of spots with a star.
    reason: NONE; UNCONFIRMED (three stars, whose attitude is not to be relied on); or why nothing was
        identified: TOO_FEW_STARS, NO_MATCH, AMBIGUOUS or WORK_LIMIT.
    q_icrs_to_sensor: float64[4], attitude from the matches at equal weights; None without a solution.
    false_solutions: how many solutions as good as this one chance gives per image (inf without a solution).
    expected: catalogue stars in the field that are brighter than the middle one of those matched; seen: of
        these how many are matched. Both 0 where the field is not given.
    """

    star_index: IntArray
    verified: int
    reason: Reason
    q_icrs_to_sensor: FloatArray | None = None
    false_solutions: float = math.inf
    expected: int = 0
    seen: int = 0

    @property
    def identified(self) -> bool:
        """Whether stars were identified, be it only three."""
        return self.reason in (Reason.NONE, Reason.UNCONFIRMED)


class IdentificationAlgorithm(Protocol):
    """An identification algorithm: pure, and counting its work."""

    def __call__(
        self,
        spikes: Spikes,
        catalogue: StarTables,
        parameters: IdentificationParameters,
    ) -> tuple[Identification, Work]:
        """Which star of the catalogue each spike is, and what it took to find out."""


def no_identification(spots: int, reason: Reason) -> Identification:
    """The outcome without a solution."""
    return Identification(np.full(spots, -1, np.int32), 0, reason)


def usable_spikes(spikes: Spikes) -> tuple[Spikes, IntArray]:
    """The spikes that can be matched at all, C-contiguous, and their places: int32[m] in what was given.

    Left out, and so never matched: spikes with a NaN or an infinity in direction or magnitude, and with a
    direction that is no unit vector (by more than 1e-6). ValueError: not as many magnitudes as directions.
    """
    b = np.ascontiguousarray(spikes.b_vectors, np.float64).reshape(-1, 3)
    magnitudes = np.ascontiguousarray(spikes.magnitudes, np.float64)
    if len(magnitudes) != len(b):
        raise ValueError(f"{len(b)} directions, but {len(magnitudes)} magnitudes")
    places = np.empty(len(b), np.int32)
    usable = _usable_kernel(b, magnitudes, places)
    if usable == len(b):
        return Spikes(b, magnitudes), places
    places = places[:usable]
    return Spikes(b[places], magnitudes[places]), places


@numba.njit(nogil=True)
def _usable_kernel(b: FloatArray, magnitudes: FloatArray, places: IntArray) -> int:
    """Write the places of the spikes that can be matched; returns how many there are."""
    usable = 0
    for spike in range(len(b)):
        square = b[spike, 0] * b[spike, 0] + b[spike, 1] * b[spike, 1] + b[spike, 2] * b[spike, 2]
        # NaN and infinity fail the comparison of the length as well.
        if abs(square - 1.0) <= 2e-6 and math.isfinite(magnitudes[spike]):
            places[usable] = spike
            usable += 1
    return usable


def for_all_spikes(identification: Identification, places: IntArray, spots: int) -> Identification:
    """An identification of the spikes at `places` (see `usable_spikes`) as one of all `spots` spikes."""
    if len(places) == spots:
        return identification
    star_index = np.full(spots, -1, np.int32)
    star_index[places] = identification.star_index
    return replace(identification, star_index=star_index)
