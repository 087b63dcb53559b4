"""Sun, Moon and Earth: where they stand and how much of their light reaches the pixels.

Each body has an exclusion angle and the stray light that the baffle lets through there, both from the unit's
file. ASSUMED, as data sheets give an exclusion angle and no more: outward from it the stray light falls with
a power of the angle, (exclusion / angle)^falloff; inward it rises, on a straight line in log-log, to twice
what fills a pixel in the exposure, reached at saturation_deg (by default when the body's edge comes into the
image), and stays there. Across the image it grows exponentially towards the body, with the slope that this
law has at the boresight, but by no more than a factor of e^3 from the middle to a corner. The body's own disc
is not drawn: inside saturation_deg there is nothing else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Protocol

import erfa
import numpy as np
from numpy.typing import NDArray

from . import time_scales
from .camera import CameraModel
from .orbit import EARTH_RADIUS_KM
from .trajectory import Trajectory, TrajectoryWithSun

Array = NDArray[np.float64]

SUN_RADIUS_KM = 695_700.0  # IAU 2015 resolution B3
MOON_RADIUS_KM = 1_737.4
# ASSUMED: a baffle ends steeply; at this share of the exclusion angle the image is full of stray light.
STEEP = 0.8
# Below this height the Earth is a horizon under the observer and no body in the sky.
_IN_SPACE_KM = 80.0


@dataclass(frozen=True)
class ObserverState:
    """Where and how fast the observer is at one instant; vectors in ICRS axes.

    geocentric_km is None for a trajectory without a position: then the observer is at the Earth's centre.
    """

    tai_ns: int
    geocentric_km: Array | None
    barycentric_km: Array
    velocity_km_s: Array
    sun_km: Array
    earth_to_sun_km: Array

    @classmethod
    def at(cls, trajectory: Trajectory, t_ns: int, start_tai_ns: int) -> ObserverState:
        """The state on a trajectory at virtual time t_ns; velocity_km_s is barycentric: the Earth's plus its
        own. A trajectory that knows where the Sun is has the last word on it."""
        tai_ns = start_tai_ns + t_ns
        heliocentric, barycentric, velocity = time_scales.earth_position_velocity(tai_ns)
        position, own = trajectory.position_km(t_ns), trajectory.velocity_km_s(t_ns)
        sun = trajectory.sun_direction(t_ns) if isinstance(trajectory, TrajectoryWithSun) else None
        if sun is not None:
            heliocentric = -float(np.linalg.norm(heliocentric)) * sun - (
                0.0 if position is None else position
            )
        return cls(
            tai_ns=tai_ns,
            geocentric_km=position,
            barycentric_km=barycentric if position is None else barycentric + position,
            velocity_km_s=velocity if own is None else velocity + own,
            sun_km=-heliocentric if position is None else -heliocentric - position,
            earth_to_sun_km=-heliocentric,
        )

    def moon_km(self) -> Array:
        """From the observer to the Moon's centre (ERFA ``moon98``: within 12 arcsec and 23 km, after
        Meeus)."""
        geocentric = np.array(erfa.moon98(*time_scales.tt_jd(self.tai_ns))["p"]) * time_scales.AU_KM
        return geocentric if self.geocentric_km is None else geocentric - self.geocentric_km

    def behind_earth(self, direction: Array) -> bool:
        """Whether the Earth's body hides a direction (unit vector); never, without a position."""
        if self.geocentric_km is None:
            return False
        towards, angular_radius = self.earth()
        return bool(direction @ towards > math.cos(angular_radius))

    def earth(self) -> tuple[Array, float]:
        """(direction of the Earth's centre, its angular radius in rad) from a known position."""
        if self.geocentric_km is None:
            raise ValueError("the trajectory has no position")
        distance = float(np.linalg.norm(self.geocentric_km))
        return -self.geocentric_km / distance, math.asin(min(EARTH_RADIUS_KM / distance, 1.0))


@dataclass(frozen=True)
class Stray:
    """A body's stray light in one frame.

    direction: unit vector, ICRS; angle_deg: boresight to the body's centre (the Earth: to its limb);
    electrons_s: per pixel, at the boresight; slope_per_rad: growth of its logarithm towards the body;
    occulting: [x, y, z, cos] of the cone in which the body hides stars, or None.
    """

    body: str
    direction: Array
    angle_deg: float
    electrons_s: float
    slope_per_rad: float
    occulting: Array | None = None


class Body(Protocol):
    """Something that may blind the camera."""

    def stray(
        self,
        observer: ObserverState,
        boresight: Array,
        exposure_ns: int,
        camera: CameraModel,
        half_diagonal_rad: float,
    ) -> Stray | None:
        """Its stray light with the camera's boresight along a unit vector (ICRS); None when it is not in the
        sky."""
        ...


@dataclass(frozen=True)
class _Exclusion:
    """exclusion_deg; stray_electrons_s per pixel at that angle; falloff outward; saturation_deg: see the
    module."""

    exclusion_deg: float
    stray_electrons_s: float
    falloff: float = 3.0
    saturation_deg: float | None = None

    name: ClassVar[str] = ""

    def __post_init__(self) -> None:
        if not 0.0 < self.exclusion_deg <= 180.0:
            raise ValueError(f"{self.name} exclusion_deg is {self.exclusion_deg}; allowed is over 0 to 180")
        if not 0.0 <= self.stray_electrons_s < math.inf:
            raise ValueError(
                f"{self.name} stray_electrons_s is {self.stray_electrons_s}; it cannot be negative"
            )
        if not 0.0 <= self.falloff <= 20.0:
            raise ValueError(f"{self.name} falloff is {self.falloff}; allowed is 0 to 20")
        if self.saturation_deg is not None and not 0.0 < self.saturation_deg <= self.exclusion_deg:
            raise ValueError(
                f"{self.name} saturation_deg is {self.saturation_deg}; allowed is over 0 to exclusion_deg"
            )

    def level(self, angle_rad: float, saturated_electrons_s: float, edge_rad: float) -> tuple[float, float]:
        """(electrons/s/px, slope per rad towards the body) at an angle; edge_rad: the default of
        saturation_deg."""
        exclusion = math.radians(self.exclusion_deg)
        inner = edge_rad if self.saturation_deg is None else math.radians(self.saturation_deg)
        inner = min(max(inner, 1e-6), exclusion)
        if angle_rad >= exclusion:
            return self.stray_electrons_s * (exclusion / angle_rad) ** self.falloff, self.falloff / angle_rad
        top = max(saturated_electrons_s, self.stray_electrons_s)
        if angle_rad <= inner or self.stray_electrons_s <= 0.0:
            return top, 0.0
        power = math.log(top / self.stray_electrons_s) / math.log(exclusion / inner)
        return self.stray_electrons_s * (exclusion / angle_rad) ** power, power / angle_rad

    def _stray(
        self,
        direction: Array,
        angle_rad: float,
        edge_rad: float,
        lit: float,
        exposure_ns: int,
        camera: CameraModel,
        half_diagonal_rad: float,
        occulting: Array | None = None,
    ) -> Stray:
        saturated = 2.0 * max(camera.full_well_electrons, camera.maximum_dn * camera.electrons_per_dn)
        level, slope = self.level(angle_rad, saturated / (exposure_ns * 1e-9), edge_rad)
        slope = min(slope, 3.0 / half_diagonal_rad)
        return Stray(self.name, direction, math.degrees(angle_rad), level * lit, slope, occulting)


class Sun(_Exclusion):
    """The Sun; behind the Earth it gives no light."""

    name = "sun"

    def stray(
        self,
        observer: ObserverState,
        boresight: Array,
        exposure_ns: int,
        camera: CameraModel,
        half_diagonal_rad: float,
    ) -> Stray | None:
        distance = float(np.linalg.norm(observer.sun_km))
        direction = observer.sun_km / distance
        if observer.behind_earth(direction):
            return None
        edge = half_diagonal_rad + math.asin(SUN_RADIUS_KM / distance)
        return self._stray(
            direction, _angle(direction, boresight), edge, 1.0, exposure_ns, camera, half_diagonal_rad
        )


class Moon(_Exclusion):
    """The Moon; stray_electrons_s is that of the full Moon.

    ASSUMED: its light goes with the lit part of its disc (near the full Moon the real one is still brighter).
    """

    name = "moon"

    def stray(
        self,
        observer: ObserverState,
        boresight: Array,
        exposure_ns: int,
        camera: CameraModel,
        half_diagonal_rad: float,
    ) -> Stray | None:
        moon_km = observer.moon_km()
        distance = float(np.linalg.norm(moon_km))
        direction = moon_km / distance
        if observer.behind_earth(direction):
            return None
        sun_from_moon = observer.sun_km - moon_km
        lit = 0.5 * (1.0 - float(sun_from_moon @ direction) / float(np.linalg.norm(sun_from_moon)))
        edge = half_diagonal_rad + math.asin(MOON_RADIUS_KM / distance)
        return self._stray(
            direction, _angle(direction, boresight), edge, lit, exposure_ns, camera, half_diagonal_rad
        )


class Earth(_Exclusion):
    """The Earth as seen from space; angles are from its limb, stray_electrons_s is that of the fully lit
    Earth.

    Not there for an observer without a position or on the ground. It hides the stars behind it also at night.
    ASSUMED: its light goes with (1 + cos) / 2 of the Sun's distance from the observer's zenith.
    """

    name = "earth"

    def stray(
        self,
        observer: ObserverState,
        boresight: Array,
        exposure_ns: int,
        camera: CameraModel,
        half_diagonal_rad: float,
    ) -> Stray | None:
        if observer.geocentric_km is None:
            return None
        if float(np.linalg.norm(observer.geocentric_km)) < EARTH_RADIUS_KM + _IN_SPACE_KM:
            return None
        direction, angular_radius = observer.earth()
        sun = observer.earth_to_sun_km
        lit = 0.5 * (1.0 - float(direction @ sun) / float(np.linalg.norm(sun)))
        from_limb = max(_angle(direction, boresight) - angular_radius, 0.0)
        cone = np.array([*direction, math.cos(angular_radius)])
        return self._stray(
            direction, from_limb, half_diagonal_rad, lit, exposure_ns, camera, half_diagonal_rad, cone
        )


def _angle(a: Array, b: Array) -> float:
    """Angle between unit vectors, rad, exact at small and large angles alike."""
    return 2.0 * math.atan2(float(np.linalg.norm(a - b)), float(np.linalg.norm(a + b)))
