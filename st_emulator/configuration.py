"""From a unit file and a scenario to what each room takes: camera, sky, trajectory, star tables,
firmware settings.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from .compiled_kernels import keep_compiled_kernels
from .errors import ConfigurationError
from .firmware_model.configuration import CentroidError, FirmwareConfiguration, StarTables
from .firmware_model.cycle_table import LINE_FILLS, ProcessorProfileError, load_table
from .firmware_model.geometry import CameraGeometry
from .firmware_model.identification.algorithms import ALGORITHMS
from .firmware_model.identification.interface import (
    BrightnessParameters,
    IdentificationParameters,
    MultiPolesParameters,
)
from .firmware_model.image.detection import DetectionParameters
from .firmware_model.processor import CycleBudget, ProcessorProfile
from .firmware_model.tracking import TrackingParameters
from .profile import UnitProfile
from .scenario import (
    ConstantRateTrajectory,
    EarthFixedTrajectory,
    HoldSegment,
    InertialTrajectory,
    OrbitTrajectory,
    RateSegment,
    Scenario,
    Sky,
    SlewTrajectory,
)
from .tables_cache import TableFigures, star_tables_of
from .world import orbit, slew, trajectory
from .world.bodies import Body, Earth, Moon, Sun
from .world.camera import CameraModel
from .world.false_spots import FalseSpots
from .world.scene import SceneRenderer
from .world.stars import StarField, star_field
from .world.time_scales import julian_year
from .world.trajectory import Trajectory

ARCSEC = np.pi / 180 / 3600
# ASSUMED: a baffle ends steeply; at this share of the exclusion angle the image is full of stray light.
STEEP = 0.8
EDGE_PX = 6.0


def camera_model(profile: UnitProfile) -> CameraModel:
    """The true camera of a unit.

    Raises:
        ConfigurationError: figures that fit the unit file's schema but make no camera.
    """
    optics, detector = profile.optics, profile.detector
    cx_px, cy_px = profile.principal_point_px
    try:
        return CameraModel(
            width_px=detector.columns,
            height_px=detector.rows,
            focal_px=profile.focal_px,
            psf_sigma_px=optics.psf_sigma_px,
            electrons_per_s_mag0=profile.electrons_per_s_mag0,
            electrons_per_dn=detector.electrons_per_dn,
            full_well_electrons=detector.full_well_electrons,
            read_noise_electrons=detector.read_noise_electrons,
            bits=detector.bits,
            offset_dn=detector.offset_dn,
            exposure_ns=round(profile.timing.exposure_ms * 1_000_000),
            dark_electrons_s=detector.dark_electrons_s,
            dark_nonuniformity=detector.dark_nonuniformity,
            stray_electrons_s=detector.stray_electrons_s,
            prnu=detector.prnu,
            hot_pixel_fraction=detector.hot_pixel_fraction,
            hot_pixel_electrons_s=detector.hot_pixel_electrons_s,
            k1=optics.k1,
            k2=optics.k2,
            p1=optics.p1,
            p2=optics.p2,
            cx_px=cx_px,
            cy_px=cy_px,
        )
    except ValueError as error:
        raise ConfigurationError(f"{profile.origin or profile.name}: {error}") from error


def camera_geometry(profile: UnitProfile) -> CameraGeometry:
    """The calibration that the firmware holds. ASSUMED: it is exact; an error of it would be one more
    figure of the unit.
    """
    keep_compiled_kernels()  # the first of all that the firmware's configuration and the tables are made of
    cx_px, cy_px = profile.principal_point_px
    optics = profile.optics
    return CameraGeometry(
        profile.detector.columns,
        profile.detector.rows,
        profile.focal_px,
        cx_px,
        cy_px,
        optics.k1,
        optics.k2,
        optics.p1,
        optics.p2,
    )


def trajectory_of(scenario: Scenario, start_tai_ns: int) -> Trajectory:
    """The trajectory of a scenario. Raises ValueError for values that fit the schema but not each other."""
    item = scenario.trajectory
    match item:
        case InertialTrajectory():
            return trajectory.inertial(ra_deg=item.ra_deg, dec_deg=item.dec_deg, roll_deg=item.roll_deg)
        case ConstantRateTrajectory():
            return trajectory.constant_rate(
                ra_deg=item.ra_deg, dec_deg=item.dec_deg, roll_deg=item.roll_deg, rate_deg_s=item.rate_deg_s
            )
        case EarthFixedTrajectory():
            return trajectory.earth_fixed(
                ra_deg=item.ra_deg,
                dec_deg=item.dec_deg,
                roll_deg=item.roll_deg,
                start_tai_ns=start_tai_ns,
                latitude_deg=item.latitude_deg,
                longitude_deg=item.longitude_deg,
            )
        case SlewTrajectory():
            segments: list[slew.Segment] = []
            for segment in item.segments:
                if isinstance(segment, HoldSegment):
                    segments.append(slew.Hold(segment.duration_s))
                elif isinstance(segment, RateSegment):
                    segments.append(slew.RateAxis(segment.rate_deg_s, segment.duration_s, segment.ramp_s))
                else:
                    segments.append(
                        slew.SlewTo(segment.ra_deg, segment.dec_deg, segment.roll_deg, segment.duration_s)
                    )
            return slew.slew(
                ra_deg=item.ra_deg, dec_deg=item.dec_deg, roll_deg=item.roll_deg, segments=segments
            )
        case OrbitTrajectory():
            return orbit.orbit(
                altitude_km=item.altitude_km,
                inclination_deg=item.inclination_deg,
                raan_deg=item.raan_deg,
                argument_deg=item.argument_deg,
                boresight=item.boresight,
                roll_deg=item.roll_deg,
            )


@lru_cache(maxsize=2)
def sky_of(start_tai_ns: int) -> StarField:
    """All Hipparcos stars at the date of a scenario's start."""
    return star_field(julian_year(start_tai_ns))


def bodies_of(profile: UnitProfile, sky: Sky) -> list[Body]:
    """Sun, Moon and Earth as the scenario has them and the unit's baffle lets them through."""
    exclusion = profile.exclusion
    stray = exclusion.stray_electrons_s_at_edge
    bodies: list[Body] = []
    if sky.sun and exclusion.sun_deg > 0:
        bodies.append(Sun(exclusion.sun_deg, stray, saturation_deg=STEEP * exclusion.sun_deg))
    if sky.moon and exclusion.moon_deg > 0:
        bodies.append(Moon(exclusion.moon_deg, stray, saturation_deg=STEEP * exclusion.moon_deg))
    if sky.earth and exclusion.earth_deg > 0:
        bodies.append(Earth(exclusion.earth_deg, stray, saturation_deg=STEEP * exclusion.earth_deg))
    return bodies


def scene_of(profile: UnitProfile, scenario: Scenario, seed: int, start_tai_ns: int) -> SceneRenderer:
    """The sky of a scenario as the unit's camera sees it.

    Raises:
        ConfigurationError: values that fit the scenario's schema but not each other.
    """
    keep_compiled_kernels()
    sky = scenario.sky
    brightest, faintest = sky.false_spot_magnitudes
    camera = camera_model(profile)
    try:
        return SceneRenderer(
            camera,
            sky_of(start_tai_ns),
            trajectory_of(scenario, start_tai_ns),
            seed=seed,
            start_tai_ns=start_tai_ns,
            aberration=sky.aberration,
            bodies=bodies_of(profile, sky),
            false_spots=FalseSpots(sky.false_spots, brightest, faintest),
        )
    except ValueError as error:
        raise ConfigurationError(f"{scenario.where}: {error}") from error


def processor_profile(profile: UnitProfile) -> ProcessorProfile:
    """The unit's processor with its cycle costs.

    Raises:
        ConfigurationError: no such table of cycle costs, or one that cannot be used.
    """
    try:
        table = load_table(profile.processor.cycle_costs)
    except ProcessorProfileError as error:
        raise ConfigurationError(
            f"{profile.origin or profile.name}: processor.cycle_costs: {error}"
        ) from error
    unit = profile.processor
    try:
        return ProcessorProfile(table, unit.clock_hz, unit.cache_kib, unit.line_fill)
    except ProcessorProfileError as error:
        raise ConfigurationError(f"{profile.origin or profile.name}: processor: {error}") from error


def processor_in_force(
    processor: ProcessorProfile, parameters: Mapping[str, float | int]
) -> ProcessorProfile:
    """The unit's processor at the clock and with the cache and memory of the on-board parameters."""
    return ProcessorProfile(
        processor.table,
        int(parameters["clock_hz"]),
        int(parameters["cache_kib"]),
        LINE_FILLS[int(parameters["line_fill"])],
    )


@lru_cache(maxsize=4)
def _tables(figures: TableFigures) -> StarTables:
    return star_tables_of(figures)


def star_tables(profile: UnitProfile) -> StarTables:
    """The unit's on-board catalogue and pair table: built once, kept in the user's cache folder."""
    geometry = camera_geometry(profile)
    return _tables(
        TableFigures(
            limit_mag=profile.catalogue.limit_mag,
            epoch_jyear=profile.catalogue.epoch_jyear,
            resolution_rad=profile.catalogue.resolution_px / profile.focal_px,
            max_angle_rad=round(2 * geometry.half_diagonal_rad, 6),
        )
    )


def cycle_budget(profile: UnitProfile, parameters: Mapping[str, float | int]) -> CycleBudget:
    """Cycles between a frame's read-out and the moment from which on it is late: those of a period, or
    what exposure and read-out leave of it where the unit is not pipelined.
    """
    budget_ns = profile.frame_period_ns
    if not parameters["pipelined"]:
        budget_ns -= int(parameters["exposure_us"]) * 1000 + round(profile.timing.readout_ms * 1_000_000)
    processor = processor_in_force(processor_profile(profile), parameters)
    return CycleBudget(processor, max(0, budget_ns) * processor.clock_hz // 1_000_000_000)


def firmware_configuration(
    profile: UnitProfile, parameters: Mapping[str, float | int]
) -> FirmwareConfiguration:
    """What a frame's processing needs, from the unit file and the on-board parameters in force."""
    detector = profile.detector
    geometry = camera_geometry(profile)
    exposure_us = int(parameters["exposure_us"])
    saturation_dn = min(
        2**detector.bits - 1,
        int(detector.full_well_electrons / detector.electrons_per_dn + detector.offset_dn),
    )
    detection = DetectionParameters(
        sigma_factor=float(parameters["detection_sigma"]),
        tau_min_dn=max(1.0, profile.detection.tau_pre_electrons / detector.electrons_per_dn),
        min_pixels=int(parameters["detection_min_pixels"]),
        max_pixels=profile.detection.max_pixels,
        centroid_half_window_px=int(parameters["centroid_half_window_px"]),
        magnitude_limit=float(parameters["magnitude_limit"]),
        zero_point_dn_per_s=profile.electrons_per_s_mag0 / detector.electrons_per_dn,
        exposure_s=exposure_us * 1e-6,
        saturation_dn=saturation_dn,
        window_sigma_factor=profile.detection.window_sigma,
        centroid=profile.detection.centroid,
        psf_sigma_px=profile.optics.psf_sigma_px,  # ASSUMED: the calibration holds it exactly
    )
    return FirmwareConfiguration(
        geometry=geometry,
        detection=detection,
        identification=IdentificationParameters(
            tolerance_rad=float(parameters["identification_tolerance_arcsec"]) * ARCSEC,
            max_spots=int(parameters["identification_max_spots"]),
            # Stars within a few pixels of the edge cannot be measured, so they are not expected.
            field_normals=geometry.field_normals(-EDGE_PX),
            most_false_solutions=profile.identification.most_false_matches,
            brightness=BrightnessParameters(
                distinct_mag=profile.identification.brightness_referenced.distinct_mag,
                bright_limit_mag=profile.identification.brightness_referenced.bright_limit_mag,
            ),
            multi_poles=MultiPolesParameters(
                magnitude_tolerance=profile.identification.multi_poles.magnitude_tolerance,
                least_recognised=profile.identification.multi_poles.least_recognised,
            ),
        ),
        cycle_budget=cycle_budget(profile, parameters),
        tracking=TrackingParameters(
            rate_rad_s=float(np.radians(parameters["tracking_rate_deg_s"])),
            star_radius_px=profile.tracking.star_radius_px,
            tolerance_rad=float(parameters["tracking_tolerance_arcsec"]) * ARCSEC,
            min_stars=int(parameters["tracking_min_stars"]),
            max_missed=int(parameters["tracking_max_missed"]),
            max_windows=profile.tracking.max_windows,
        ),
        exposure_ns=exposure_us * 1000,
        identify=ALGORITHMS[profile.identification.algorithm],
        centroid_error=CentroidError(
            psf_sigma_px=profile.optics.psf_sigma_px,
            electrons_per_dn=detector.electrons_per_dn,
            half_window_px=int(parameters["centroid_half_window_px"]),
            interpolated=profile.detection.centroid == "gaussian",
        ),
        blinded_background_dn=float(parameters["blinded_background_dn"]),
        aberration_correction=bool(parameters["aberration_correction"]),
        velocity_km_s=(
            float(parameters["velocity_x_km_s"]),
            float(parameters["velocity_y_km_s"]),
            float(parameters["velocity_z_km_s"]),
        ),
    )
