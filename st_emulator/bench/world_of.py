"""From a unit file and a scenario to the world in front of the detector: camera, sky, bodies, trajectory."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np

from ..compiled_kernels import keep_compiled_kernels
from ..errors import ConfigurationError
from ..units.profile import UnitProfile
from ..world import detumbling, orbit, pointing, slew, trajectory
from ..world.bodies import STEEP, Body, Earth, Moon, Sun
from ..world.camera import CameraModel
from ..world.display import DisplayRenderer
from ..world.false_spots import FalseSpots
from ..world.scene import SceneRenderer
from ..world.stars import StarField, star_field
from ..world.time_scales import julian_year
from ..world.trajectory import Trajectory
from .scenario import Scenario, Sky
from .trajectory_file import sampled_of
from .trajectory_sections import (
    ConstantRateTrajectory,
    DetumbleTrajectory,
    EarthFixedTrajectory,
    FileTrajectory,
    HoldSegment,
    InertialTrajectory,
    NadirTrajectory,
    OrbitTrajectory,
    PointingOrbit,
    RateSegment,
    SlewTrajectory,
    SunTrajectory,
    TargetTrajectory,
)


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
            rolling_readout_ns=profile.rolling_readout_ns,
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
        case NadirTrajectory():
            return pointing.nadir_pointing(_place(item), boresight=item.boresight, roll_deg=item.roll_deg)
        case SunTrajectory():
            return pointing.sun_pointing(
                _place(item), start_tai_ns=start_tai_ns, boresight=item.boresight, roll_deg=item.roll_deg
            )
        case TargetTrajectory():
            return _target_pointing(item, start_tai_ns)
        case DetumbleTrajectory():
            return detumbling.detumbling(
                ra_deg=item.ra_deg,
                dec_deg=item.dec_deg,
                roll_deg=item.roll_deg,
                rate_deg_s=item.rate_deg_s,
                time_constant_s=item.time_constant_s,
            )
        case FileTrajectory():
            return sampled_of(scenario, item, start_tai_ns)


def _place(item: PointingOrbit) -> orbit.OrbitTrajectory:
    return orbit.orbit(
        altitude_km=item.altitude_km,
        inclination_deg=item.inclination_deg,
        raan_deg=item.raan_deg,
        argument_deg=item.argument_deg,
    )


def _target_pointing(item: TargetTrajectory, start_tai_ns: int) -> Trajectory:
    if item.latitude_deg is not None and item.longitude_deg is not None:
        return pointing.place_pointing(
            _place(item),
            latitude_deg=item.latitude_deg,
            longitude_deg=item.longitude_deg,
            height_m=item.height_m,
            start_tai_ns=start_tai_ns,
            boresight=item.boresight,
            roll_deg=item.roll_deg,
        )
    if item.hip is not None:
        field = sky_of(start_tai_ns)
        found = np.flatnonzero(field.hip == item.hip)
        if not len(found):
            raise ValueError(f"hip = {item.hip}: no star of the Hipparcos catalogue has this number")
        direction = field.unit_vectors[found[0]]
    else:
        assert item.ra_deg is not None
        assert item.dec_deg is not None
        ra, dec = np.radians([item.ra_deg, item.dec_deg])
        direction = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    return pointing.star_pointing(_place(item), direction, boresight=item.boresight, roll_deg=item.roll_deg)


@lru_cache(maxsize=2)
def sky_of(start_tai_ns: int) -> StarField:
    """All Hipparcos stars at the date of a scenario's start."""
    return star_field(julian_year(start_tai_ns))


def bodies_of(profile: UnitProfile, sky: Sky) -> list[Body]:
    """Sun, Moon and Earth as the scenario has them and the unit's baffle lets them through; none where a
    display shows the sky."""
    if sky.display is not None:
        return []
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


def scene_of(
    profile: UnitProfile,
    scenario: Scenario,
    seed: int,
    start_tai_ns: int,
    outside: Trajectory | None = None,
) -> SceneRenderer:
    """The sky of a scenario as the unit's camera sees it; ``outside`` in place of the scenario's trajectory.

    Raises:
        ConfigurationError: values that fit the scenario's schema but not each other.
    """
    keep_compiled_kernels()
    sky = scenario.sky
    brightest, faintest = sky.false_spot_magnitudes
    camera = camera_model(profile)
    renderer: Callable[..., SceneRenderer] = SceneRenderer
    if sky.display is not None:
        renderer = partial(DisplayRenderer, sky.display.display)
    try:
        return renderer(
            camera,
            sky_of(start_tai_ns),
            trajectory_of(scenario, start_tai_ns) if outside is None else outside,
            seed=seed,
            start_tai_ns=start_tai_ns,
            aberration=sky.aberration,
            bodies=bodies_of(profile, sky),
            false_spots=FalseSpots(sky.false_spots, brightest, faintest),
        )
    except ValueError as error:
        raise ConfigurationError(f"{scenario.where}: {error}") from error
