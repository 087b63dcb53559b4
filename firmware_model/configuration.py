"""What one unit's firmware is set to: filled from the unit's file and from the on-board parameters."""

from __future__ import annotations

from dataclasses import dataclass, field

from .camera_errors import CentroidError
from .catalogue.tables import StarTables
from .geometry import CameraGeometry
from .identification.interface import IdentificationAlgorithm, IdentificationParameters
from .identification.pyramid import identify as identify_by_pyramid
from .image.detection import DetectionParameters
from .processor import CycleBudget
from .star_motion import RateParameters
from .tracking import TrackingParameters

__all__ = [
    "CentroidError",
    "DetectionParameters",
    "FirmwareConfiguration",
    "IdentificationParameters",
    "RateParameters",
    "StarTables",
    "TrackingParameters",
]


@dataclass(frozen=True)
class FirmwareConfiguration:
    """Everything that process_frame needs besides frame and tables; immutable.

    exposure_ns: the exposure to command. detection.exposure_s is replaced by the exposure of each frame.
    max_spots: so many of the brightest spots of a full frame are given to identification.
    blinded_background_dn: a background above this blinds the camera.
    aberration_correction: correct for stellar aberration once the on-board time is set.
    velocity_km_s: of the spacecraft about the Earth, ICRS.
    cycle_budget: what a frame may take; a search that would take more ends with WORK_LIMIT. None: no limit
        but those of `identification`.
    solved_validity_ns: an attitude older than this says nothing about the rate. ASSUMED: 2 s, within which
        the unit must be back after too high a rate.
    rate: how the rate is measured without an attitude; None: it is not, and no frame is kept.
    """

    geometry: CameraGeometry
    detection: DetectionParameters
    identification: IdentificationParameters
    tracking: TrackingParameters
    exposure_ns: int = 100_000_000
    centroid_error: CentroidError = field(default_factory=CentroidError)
    identify: IdentificationAlgorithm = identify_by_pyramid
    max_spots: int = 60
    blinded_background_dn: float = 60_000.0
    aberration_correction: bool = True
    velocity_km_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    solved_validity_ns: int = 2_000_000_000
    cycle_budget: CycleBudget | None = None
    rate: RateParameters | None = None
