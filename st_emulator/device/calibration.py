"""From a unit file and the parameters in force to what the firmware holds: geometry, processor, settings."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..compiled_kernels import keep_compiled_kernels
from ..errors import ConfigurationError
from ..firmware_model.configuration import CentroidError, FirmwareConfiguration, RateParameters
from ..firmware_model.cycle_table import LINE_FILLS, ProcessorProfileError, load_table
from ..firmware_model.geometry import CameraGeometry
from ..firmware_model.identification.algorithms import ALGORITHMS
from ..firmware_model.identification.interface import (
    BrightnessParameters,
    IdentificationParameters,
    MultiPolesParameters,
)
from ..firmware_model.image.detection import DetectionParameters
from ..firmware_model.image.optical_flow import FlowParameters
from ..firmware_model.processor import CycleBudget, ProcessorProfile
from ..firmware_model.rate_from_flow import FlowSettings
from ..firmware_model.tracking import TrackingParameters
from ..units.profile import UnitProfile

ARCSEC = np.pi / 180 / 3600
EDGE_PX = 6.0


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


def cycle_budget(profile: UnitProfile, parameters: Mapping[str, float | int]) -> CycleBudget:
    """Cycles between a frame's read-out and the moment from which on it is late: those of a period, or
    what exposure and read-out leave of it where the unit is not pipelined.
    """
    budget_ns = profile.frame_period_ns
    if not parameters["pipelined"]:
        budget_ns -= int(parameters["exposure_us"]) * 1000 + round(profile.timing.readout_ms * 1_000_000)
    processor = processor_in_force(processor_profile(profile), parameters)
    return CycleBudget(processor, max(0, budget_ns) * processor.clock_hz // 1_000_000_000)


def _rate_parameters(profile: UnitProfile) -> RateParameters | None:
    """What the unit file says of the rate without an attitude; None: nothing."""
    if profile.rate is None:
        return None
    return RateParameters(
        fusion_distance_px=profile.rate.fusion_distance_px,
        compensation=profile.rate.compensation,
        least_speed_px_s=profile.rate.least_speed_px_s,
        tolerance_px=profile.rate.tolerance_px,
        min_stars=profile.rate.min_stars,
        frames_to_rate_only=profile.rate.frames_to_rate_only,
        identify_below_rad_s=float(np.radians(profile.rate.identify_below_deg_s)),
        flow=_flow_parameters(profile) if profile.rate.method == "optical_flow" else None,
        flow_settings=flow_settings_of(profile),
    )


def flow_settings_of(profile: UnitProfile) -> FlowSettings:
    """How a unit makes a rate of an optical flow.

    ASSUMED: a rate whose own sigma about an axis is over half of the largest that the unit measures is none:
    of few stars that stand close together one had an error of 20 deg/s about the boresight, and said so.
    """
    assert profile.rate is not None
    most_rad_s = float(np.radians(profile.rate.most_deg_s))
    return FlowSettings(min_stars=profile.rate.min_stars, most_error_rad_s=0.5 * most_rad_s)


def _flow_parameters(profile: UnitProfile) -> FlowParameters:
    """Tuned to the largest rate that the unit measures."""
    assert profile.rate is not None
    most_rad = np.radians(profile.rate.most_deg_s) * profile.frame_period_ns * 1e-9
    corner = 1.0 + np.tan(np.radians(profile.diagonal_deg / 2)) ** 2  # a shift is larger off the boresight
    return FlowParameters(
        sigma_factor=profile.rate.flow_sigma,
        min_pixels=profile.rate.flow_min_pixels,
        largest_shift_px=max(4, int(np.ceil(profile.focal_px * most_rad * corner))),
    )


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
        piece_gap_px=0 if profile.rate is None else profile.rate.piece_gap_px,
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
            windows_by_rate=profile.tracking.windows_by_rate,
        ),
        rate=_rate_parameters(profile),
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
