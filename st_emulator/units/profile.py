"""Unit files: one TOML file describes one star tracker, validated on load.

A unit is data. The shipped units lie in ``st_emulator/units``; a user's own unit is one more file, named by
its path. An error names the file, the key and what is allowed. The JSON schema is written by ``st-emulator
export unit-schema``.
"""

from __future__ import annotations

import math
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from ..errors import ConfigurationError
from .can_section import CanSection
from .validation import Section, Switch, parse_toml, read_text, validate

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
MOST_PIXELS = 33_000_000  # 2 bytes each, in at most 65535 parts of 1024 bytes (service 13)


class UnitIdentity(Section):
    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    title: str
    source: str


class Optics(Section):
    """Lens. Distortion is Brown's radial (k1, k2) and tangential (p1, p2) on normalised image coordinates."""

    focal_length_mm: Positive
    aperture_mm: Positive
    psf_sigma_px: Annotated[float, Field(ge=0.3, le=5)]
    electrons_per_s_mm2_mag0: Positive
    principal_point_x_px: float | None = None
    principal_point_y_px: float | None = None
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0


class Detector(Section):
    columns: Annotated[int, Field(ge=64, le=8192)]
    rows: Annotated[int, Field(ge=64, le=8192)]
    pixel_um: Positive
    bits: Annotated[int, Field(ge=8, le=16)]
    electrons_per_dn: Positive
    offset_dn: NonNegative
    full_well_electrons: Positive
    read_noise_electrons: NonNegative
    dark_electrons_s: NonNegative
    dark_nonuniformity: Annotated[float, Field(ge=0, le=1)] = 0.0
    stray_electrons_s: NonNegative
    prnu: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    hot_pixel_fraction: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    hot_pixel_electrons_s: NonNegative = 0.0
    shutter: Annotated[
        Literal["global", "rolling"],
        Field(
            description="global: all rows are exposed at once; rolling: row y of n from y/n of "
            "timing.readout_ms on, each as long as the exposure"
        ),
    ] = "global"

    @model_validator(mode="after")
    def _image_can_be_downloaded(self) -> Detector:
        if self.columns * self.rows > MOST_PIXELS:
            raise ValueError(
                f"columns = {self.columns} times rows = {self.rows} must be {MOST_PIXELS} or less: an image "
                "is downloaded in at most 65535 parts"
            )
        return self


class Exclusion(Section):
    """Exclusion angles from the boresight and the stray light at that angle, electrons per second and
    pixel.
    """

    sun_deg: Annotated[float, Field(ge=0, le=180)]
    moon_deg: Annotated[float, Field(ge=0, le=180)]
    earth_deg: Annotated[float, Field(ge=0, le=180)]
    stray_electrons_s_at_edge: NonNegative


class Timing(Section):
    frame_period_ms: Annotated[int, Field(ge=10, le=10000)]
    exposure_ms: Annotated[float, Field(ge=0.1, le=250)]  # the range of parameter exposure_us
    readout_ms: Positive
    pipelined: Switch
    boot_ms: Annotated[int, Field(ge=0, le=60000)]
    self_test_ms: Annotated[int, Field(ge=1, le=60000)]
    telecommand_latency_us: Annotated[int, Field(ge=0, le=1_000_000)]

    @model_validator(mode="after")
    def _exposure_fits(self) -> Timing:
        if self.exposure_ms > self.frame_period_ms:
            raise ValueError(
                f"exposure_ms = {self.exposure_ms:g} does not fit frame_period_ms = {self.frame_period_ms}"
            )
        if self.readout_ms > self.frame_period_ms:
            raise ValueError(
                f"readout_ms = {self.readout_ms:g} does not fit frame_period_ms = {self.frame_period_ms}"
            )
        if self.self_test_ms < 2 * self.frame_period_ms + self.readout_ms:
            raise ValueError(
                f"self_test_ms = {self.self_test_ms} does not hold two frame_period_ms = "
                f"{self.frame_period_ms} and readout_ms = {self.readout_ms:g}: the self-test looks at a frame"
            )
        return self


class Processor(Section):
    clock_hz: Annotated[int, Field(ge=1_000_000, le=2_000_000_000)]
    cycle_costs: str
    cache_kib: Literal[32, 16, 8, 4, 0] = 32
    line_fill: Literal["low", "nominal", "high"] = "nominal"
    memory_mbyte: Positive


class Catalogue(Section):
    limit_mag: Annotated[float, Field(ge=2, le=9)]
    epoch_jyear: Annotated[float, Field(ge=1950, le=2100)]
    resolution_px: NonNegative


class Detection(Section):
    sigma: Annotated[float, Field(ge=3, le=50)]
    tau_pre_electrons: NonNegative = 0.0  # the threshold over the background is never less than this
    window_sigma: Annotated[float, Field(ge=2, le=50)]
    min_pixels: Annotated[int, Field(ge=1, le=50)]
    max_pixels: Annotated[int, Field(ge=10, le=100000)]
    centroid_half_window_px: Annotated[int, Field(ge=1, le=7)]
    centroid: Literal["com", "gaussian", "cluster"] = "com"
    magnitude_limit: Annotated[float, Field(ge=0, le=10)]
    blinded_background_dn: Annotated[int, Field(ge=1, le=65535)]


class BrightnessReferenced(Section):
    """Of the algorithm of this name: spots over ``distinct_mag`` apart are in the order of their brightness;
    a star over ``bright_limit_mag`` is looked for among the stars as bright."""

    distinct_mag: Annotated[float, Field(ge=0, le=10)] = 0.7
    bright_limit_mag: Annotated[float, Field(ge=-2, le=10)] = 3.0


class MultiPoles(Section):
    """Of the algorithm of this name: a pair of stars fits two spots that are no more than
    ``magnitude_tolerance`` off; ``least_recognised`` stars are to be accepted by two poles."""

    magnitude_tolerance: Annotated[float, Field(gt=0, le=10)] = 0.7
    least_recognised: Annotated[int, Field(ge=3, le=20)] = 5


class Identification(Section):
    """Lost in space. ``most_false_matches``: an attitude is refused where chance gives more that fit."""

    algorithm: Literal["pyramid", "brightness_referenced", "geometric_voting", "multi_poles"]
    tolerance_arcsec: Annotated[float, Field(ge=0.1, le=600)]
    max_spots: Annotated[int, Field(ge=4, le=40)]
    most_false_matches: Annotated[float, Field(gt=0, le=1)] = 1e-5
    brightness_referenced: BrightnessReferenced = BrightnessReferenced()
    multi_poles: MultiPoles = MultiPoles()


class Tracking(Section):
    """Windows round the stars. ``windows_by_rate``: where the last rate puts them, as wide as it is unsure;
    false: round their last places, as wide as ``rate_deg_s`` moves them. A unit needs [rate] for it.
    """

    rate_deg_s: Annotated[float, Field(ge=0.01, le=10)]
    star_radius_px: Positive
    tolerance_arcsec: Annotated[float, Field(ge=0.1, le=600)]
    min_stars: Annotated[int, Field(ge=2, le=20)]
    max_missed: Annotated[int, Field(ge=0, le=20)]
    max_windows: Annotated[int, Field(ge=3, le=60)]
    windows_by_rate: Switch = False


class Rate(Section):
    """The angular rate without an attitude, from the stars of two full frames that follow each other.

    ``fusion_distance_px``: the pixels of a star's two images are no further apart. ``piece_gap_px``: pieces
    of a streak so near to each other are one star. ``compensation``: how a rolling shutter's centroids are
    brought to one instant: by the rate of all stars, each by its own displacement, by the streak's length, or
    not; stars slower than ``least_speed_px_s`` are left. A star that fits the rate worse than
    ``tolerance_px`` is left out; ``min_stars`` are to fit. After ``frames_to_rate_only`` frames that turn too
    fast to be tracked and give no valid attitude the unit measures the rate alone, and tries to identify
    stars below ``identify_below_deg_s``. ``method``: the rate of fused clusters, or of an optical flow: stars
    of at least ``flow_min_pixels`` pixels over the image's mean and ``flow_sigma`` of its standard deviation,
    followed up to ``most_deg_s``; for a global shutter.
    """

    method: Literal["fusion", "optical_flow"] = "fusion"
    flow_sigma: Annotated[float, Field(ge=1, le=20)] = 3.0
    flow_min_pixels: Annotated[int, Field(ge=1, le=50)] = 3
    most_deg_s: Annotated[float, Field(gt=0, le=30)] = 5.5

    fusion_distance_px: Annotated[float, Field(ge=0, le=20)] = 2.0
    piece_gap_px: Annotated[int, Field(ge=1, le=20)] = 3
    compensation: Literal["rate", "displacement", "streak", "none"] = "rate"
    least_speed_px_s: NonNegative = 2.0
    tolerance_px: Annotated[float, Field(gt=0, le=20)] = 1.5
    min_stars: Annotated[int, Field(ge=2, le=20)] = 2
    frames_to_rate_only: Annotated[int, Field(ge=1, le=100)] = 2
    identify_below_deg_s: Annotated[float, Field(ge=0, le=100)]


class Wire(Section):
    """``dialect``: the language on the wire, a shipped one or ``module:NAME`` of your own; its settings
    stand in ``[dialects.NAME]``. Those of pus are the other keys here and ``[can]``."""

    apid: Annotated[int, Field(ge=1, le=2046)]
    source_id: Annotated[int, Field(ge=0, le=65535)]
    baud: Annotated[int, Field(ge=300, le=4_000_000)]
    attitude_report: Switch = True
    status_interval_ms: Annotated[int, Field(ge=0, le=3_600_000)] = 1000
    dialect: str = "pus"


class Requirements(Section):
    """Figures that the unit is held to; the campaigns and the demo report against them."""

    cross_boresight_arcsec: Positive | None = None
    detection_limit_mag: Annotated[float, Field(ge=0, le=10)] | None = None
    lost_in_space_coverage: Annotated[float, Field(ge=0, le=1)] | None = None


class UnitProfile(Section):
    """One star tracker. All figures are the unit file's; derived ones are properties."""

    unit: UnitIdentity
    optics: Optics
    detector: Detector
    exclusion: Exclusion
    timing: Timing
    processor: Processor
    catalogue: Catalogue
    detection: Detection
    identification: Identification
    tracking: Tracking
    rate: Rate | None = None
    wire: Wire
    can: CanSection = CanSection()
    dialects: dict[str, dict[str, Any]] = Field(default_factory=dict)
    requirements: Requirements = Requirements()

    @property
    def name(self) -> str:
        return self.unit.name

    @property
    def apid(self) -> int:
        return self.wire.apid

    @model_validator(mode="after")
    def _windows_by_rate_need_a_rate(self) -> UnitProfile:
        if self.tracking.windows_by_rate and self.rate is None:
            raise ValueError("tracking.windows_by_rate = true needs the section [rate], which is missing")
        return self

    @cached_property
    def focal_px(self) -> float:
        return self.optics.focal_length_mm * 1000.0 / self.detector.pixel_um

    @cached_property
    def principal_point_px(self) -> tuple[float, float]:
        """(x, y); the middle of the detector unless the file says otherwise."""
        x, y = self.optics.principal_point_x_px, self.optics.principal_point_y_px
        return (
            (self.detector.columns - 1) / 2 if x is None else x,
            (self.detector.rows - 1) / 2 if y is None else y,
        )

    @cached_property
    def electrons_per_s_mag0(self) -> float:
        """Photoelectrons per second of a star of magnitude 0: photon rate times aperture."""
        return self.optics.electrons_per_s_mm2_mag0 * math.pi * (self.optics.aperture_mm / 2) ** 2

    @cached_property
    def pixel_arcsec(self) -> float:
        """Angle of one pixel at the boresight."""
        return math.degrees(1 / self.focal_px) * 3600

    @property
    def field_deg(self) -> tuple[float, float]:
        """Field of view (columns, rows) by geometry, degrees."""
        return (
            math.degrees(2 * math.atan(self.detector.columns / 2 / self.focal_px)),
            math.degrees(2 * math.atan(self.detector.rows / 2 / self.focal_px)),
        )

    @property
    def diagonal_deg(self) -> float:
        return math.degrees(
            2 * math.atan(math.hypot(self.detector.columns, self.detector.rows) / 2 / self.focal_px)
        )

    @property
    def frame_period_ns(self) -> int:
        return self.timing.frame_period_ms * 1_000_000

    @property
    def rolling_readout_ns(self) -> int:
        """Time over which the rows of a rolling shutter start, one after the other; 0: a global shutter."""
        return round(self.timing.readout_ms * 1_000_000) if self.detector.shutter == "rolling" else 0

    @property
    def last_row_start_ns(self) -> int:
        """When a rolling shutter's last row starts its exposure, after the first one; 0: a global shutter."""
        return (self.detector.rows - 1) * self.rolling_readout_ns // self.detector.rows

    @property
    def row_time_s(self) -> float:
        """From the start of a rolling shutter's row to that of the next one; 0: a global shutter."""
        return self.rolling_readout_ns * 1e-9 / self.detector.rows


def unit_names() -> list[str]:
    """Names of the shipped units."""
    folder = resources.files("st_emulator") / "units"
    return sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml"))


def unit_text(name_or_path: str) -> tuple[str, str]:
    """(where it was found, TOML text) of a shipped unit or of a file.

    Raises:
        ConfigurationError: no such unit or file.
    """
    if name_or_path in unit_names():
        resource = resources.files("st_emulator") / "units" / f"{name_or_path}.toml"
        return str(resource), resource.read_text(encoding="utf-8")
    path = Path(name_or_path)
    if path.suffix == ".toml" or path.exists():
        return str(path), read_text(path, "a unit file")
    raise ConfigurationError(
        f"no unit '{name_or_path}': shipped are {', '.join(unit_names())}, or give the path of a unit "
        f"file (.toml)"
    )


def load_unit(name_or_path: str) -> UnitProfile:
    """Load and validate a unit.

    Raises:
        ConfigurationError: names the file, the key and what is allowed.
    """
    where, text = unit_text(name_or_path)
    return parse_unit(text, where)


def parse_unit(text: str, where: str) -> UnitProfile:
    """Validate the TOML text of a unit; ``where`` names it in errors."""
    return validate(UnitProfile, parse_toml(text, where), where)
