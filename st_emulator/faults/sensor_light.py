"""Faults of the sensor: light that is no star's, and charge of particles."""

from __future__ import annotations

import math
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field, model_validator

from ..clock import NS_PER_S
from ..firmware_model.image.frame import Frame
from ..world import sensor_faults
from ..world.bodies import STEEP, Earth, Moon, Sun
from ..world.lit_scene import Scene
from ..world.point_spread import SUPPORT_SIGMA
from .fault import Exposure, FaultKind, FaultSettings, Reach
from .sensor_frame import F64, STREAM_PLACES, Converter, LitFrame, SensorFault

Magnitude = Annotated[float, Field(ge=-30, le=20)]
Direction = Annotated[
    float, Field(ge=-360, le=360, description="in the image: 0 to higher columns, 90 to higher rows")
]
MOST_STEP_PX = 0.5
MOST_STEPS = 1024


class FalseStarsSettings(FaultSettings):
    kind: Literal["sensor.false_stars"]
    number: Annotated[int, Field(ge=1, le=2000, description="in a frame")] = 20
    brightest_mag: Annotated[Magnitude, Field(description="of the brightest, Hp")] = 2.0
    faintest_mag: Annotated[Magnitude, Field(description="of the faintest; evenly spread between")] = 6.0
    places: Annotated[
        Literal["new", "fixed"], Field(description="others in each frame, or the same in all")
    ] = "new"

    @model_validator(mode="after")
    def _in_order(self) -> FalseStarsSettings:
        if self.brightest_mag > self.faintest_mag:
            raise ValueError(
                f"brightest_mag = {self.brightest_mag:g} is fainter than faintest_mag = "
                f"{self.faintest_mag:g}; allowed is the same magnitude or a smaller one"
            )
        return self


class FalseStars(SensorFault[FalseStarsSettings]):
    def spots(self, exposure: Exposure) -> F64:
        """float64[n, 3]: x_px, y_px, magnitude."""
        number = exposure.index + 1 if self.settings.places == "new" else 0
        u = self.uniforms(STREAM_PLACES, number, 3 * self.settings.number).reshape(-1, 3)
        span = [self.width_px, self.height_px, self.settings.faintest_mag - self.settings.brightest_mag]
        return np.asarray(u * np.array(span) + np.array([-0.5, -0.5, self.settings.brightest_mag]))

    def spoil(self, frame: Frame, exposure: Exposure) -> Frame:
        def light() -> Scene:
            spots = self.spots(exposure)
            return sensor_faults.light(
                self.width_px,
                self.height_px,
                self.profile.optics.psf_sigma_px,
                xs=spots[:, :1],
                ys=spots[:, 1:2],
                electrons=self.electrons_of(spots[:, 2], exposure),
            )

        return LitFrame(frame, light, self.noise_key(exposure), Converter(self.profile, frame))


class StrayLightSettings(FaultSettings):
    kind: Literal["sensor.stray_light"]
    level_dn: Annotated[
        float,
        Field(
            gt=0, le=65535, description="on top of the background, in the middle, at the unit's exposure time"
        ),
    ] = 150.0
    gradient: Annotated[
        float, Field(ge=0, le=1, description="share of the level that is more at the edge it comes from")
    ] = 0.5
    direction_deg: Direction = 0.0


class StrayLight(SensorFault[StrayLightSettings]):
    """Light that falls on a straight line across the image: none less than none."""

    def spoil(self, frame: Frame, exposure: Exposure) -> Frame:
        def light() -> Scene:
            settings, profile = self.settings, self.profile
            nominal_ns = profile.timing.exposure_ms * 1e6
            level = settings.level_dn * profile.detector.electrons_per_dn * exposure.duration_ns / nominal_ns
            angle = math.radians(settings.direction_deg)
            middle_x, middle_y = (self.width_px - 1) / 2, (self.height_px - 1) / 2
            # to the corner that lies farthest this way
            far = abs(math.cos(angle)) * middle_x + abs(math.sin(angle)) * middle_y
            slope = settings.gradient / far
            along_x = slope * math.cos(angle) * (np.arange(self.width_px) - middle_x)
            along_y = slope * math.sin(angle) * (np.arange(self.height_px) - middle_y)
            return sensor_faults.light(
                self.width_px,
                self.height_px,
                profile.optics.psf_sigma_px,
                glow_columns=level * np.stack((0.5 + along_x, np.ones(self.width_px))),
                glow_rows=np.stack((np.ones(self.height_px), 0.5 + along_y)),
            )

        return LitFrame(frame, light, self.noise_key(exposure), Converter(self.profile, frame))


_BODIES = {"sun": Sun, "moon": Moon, "earth": Earth}


class BlindingSettings(FaultSettings):
    kind: Literal["sensor.blinding"]
    body: Annotated[Literal["sun", "moon", "earth"], Field(description="that comes near the boresight")] = (
        "sun"
    )
    angle_deg: Annotated[
        float | None,
        Field(
            ge=0, le=180,
            description="from the boresight to the body (the Earth: to its limb); none: 82 % of the unit's "
            "exclusion angle, where the image is nearly full",
        ),
    ] = None  # fmt: skip
    approach_deg_s: Annotated[float, Field(ge=0, le=180, description="so much nearer each second")] = 0.0
    direction_deg: Direction = 0.0


class Blinding(SensorFault[BlindingSettings]):
    """A body within the exclusion angle that the trajectory does not have there.

    The law of the baffle is that of ``world.bodies``. ASSUMED: a full Moon, a sunlit Earth; the disc itself
    is not drawn, and hides no stars.
    """

    def __init__(self, settings: BlindingSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        exclusion = reach.profile.exclusion
        self._exclusion_deg: float = getattr(exclusion, f"{settings.body}_deg")
        if not self._exclusion_deg > 0:
            raise ValueError(
                f"body = {settings.body}: the unit file has no exclusion angle of it (exclusion."
                f"{settings.body}_deg = 0); allowed are the ones with an angle over 0"
            )
        self._body = _BODIES[settings.body](
            self._exclusion_deg,
            exclusion.stray_electrons_s_at_edge,
            saturation_deg=STEEP * self._exclusion_deg,
        )

    def angle_deg(self, exposure: Exposure) -> float:
        """From the boresight to the body in a frame."""
        settings = self.settings
        first = 0.82 * self._exclusion_deg if settings.angle_deg is None else settings.angle_deg
        return max(first - settings.approach_deg_s * max(self.since_s(exposure.start_ns), 0.0), 0.0)

    def spoil(self, frame: Frame, exposure: Exposure) -> Frame:
        angle_rad = math.radians(self.angle_deg(exposure))

        def light() -> Scene:
            profile, converter = self.profile, Converter(self.profile, frame)
            exposure_s = exposure.duration_ns / NS_PER_S
            # as in world.bodies: twice what fills a pixel
            full = 2.0 * max(
                profile.detector.full_well_electrons, converter.top_dn * converter.electrons_per_dn
            )
            half_diagonal_rad = math.atan(math.hypot(self.width_px, self.height_px) / 2 / profile.focal_px)
            electrons_s, slope_per_rad = self._body.level(angle_rad, full / exposure_s, half_diagonal_rad)
            slope = min(slope_per_rad, 3.0 / half_diagonal_rad) / profile.focal_px
            direction = math.radians(self.settings.direction_deg)
            cx, cy = profile.principal_point_px
            across = slope * math.cos(direction) * (np.arange(self.width_px) - cx)
            down = slope * math.sin(direction) * (np.arange(self.height_px) - cy)
            return sensor_faults.light(
                self.width_px,
                self.height_px,
                profile.optics.psf_sigma_px,
                glow_columns=electrons_s * exposure_s * np.exp(across)[None],
                glow_rows=np.exp(down)[None],
            )

        return LitFrame(frame, light, self.noise_key(exposure), Converter(self.profile, frame))


class BrightObjectSettings(FaultSettings):
    kind: Literal["sensor.bright_object"]
    magnitude: Annotated[Magnitude, Field(description="of the object, Hp")] = -2.0
    rate_deg_s: Annotated[float, Field(gt=0, le=100, description="at which it crosses")] = 2.0
    direction_deg: Direction = 30.0
    offset_px: Annotated[
        float, Field(ge=-10_000, le=10_000, description="how far beside the middle of the image it passes")
    ] = 0.0


class BrightObject(SensorFault[BrightObjectSettings]):
    """It comes in over a corner when the fault begins, and goes straight across the image.

    ASSUMED: a point of constant brightness, as a satellite that shines in the Sun; no blooming.
    """

    def path(self, exposure: Exposure) -> tuple[F64, F64]:
        """Where it is in steps of the exposure: x_px, y_px, float64[steps] each."""
        settings = self.settings
        rate_px_s = math.radians(settings.rate_deg_s) * self.profile.focal_px
        length_px = rate_px_s * exposure.duration_ns / NS_PER_S
        steps = min(max(math.ceil(length_px / MOST_STEP_PX), 1), MOST_STEPS)
        middle = (2 * np.arange(steps) + 1) / (2 * steps)
        t_s = self.since_s(exposure.start_ns) + middle * exposure.duration_ns / NS_PER_S
        reach_px = SUPPORT_SIGMA * self.profile.optics.psf_sigma_px
        along = rate_px_s * t_s - math.hypot(self.width_px, self.height_px) / 2 - reach_px
        angle = math.radians(settings.direction_deg)
        c, s = math.cos(angle), math.sin(angle)
        middle_x, middle_y = (self.width_px - 1) / 2, (self.height_px - 1) / 2
        x = middle_x + along * c - settings.offset_px * s
        y = middle_y + along * s + settings.offset_px * c
        return x, y

    def spoil(self, frame: Frame, exposure: Exposure) -> Frame:
        x, y = self.path(exposure)
        reach_px = SUPPORT_SIGMA * self.profile.optics.psf_sigma_px + 1.0
        if (
            max(x[0], x[-1]) < -reach_px
            or min(x[0], x[-1]) > self.width_px + reach_px
            or max(y[0], y[-1]) < -reach_px
            or min(y[0], y[-1]) > self.height_px + reach_px
        ):
            return frame

        def light() -> Scene:
            return sensor_faults.light(
                self.width_px,
                self.height_px,
                self.profile.optics.psf_sigma_px,
                xs=x[None],
                ys=y[None],
                electrons=self.electrons_of([self.settings.magnitude], exposure),
            )

        return LitFrame(frame, light, self.noise_key(exposure), Converter(self.profile, frame))


LIGHT_KINDS: Final = (
    FaultKind(
        FalseStarsSettings,
        FalseStars,
        what="So many spots with the point spread of the camera and the light of stars of the given "
        "magnitudes, at other places in each frame (particles, reflexes) or at fixed ones (a ghost, a "
        "window that sparkles).",
        obc_sees="spots_detected rises in lost in space, cycles with it; an acquisition takes longer or "
        "gives NO_MATCH. In tracking only spots that fall into a window count: attitudes stay valid and "
        "right, and single stars fall out.",
        afterwards="The next frame is as before.",
    ),
    FaultKind(
        StrayLightSettings,
        StrayLight,
        what="Even light over the image that grows towards one side, with its shot noise.",
        obc_sees="background_dn and noise_dn rise in the attitude reports, covariances grow, faint stars "
        "are lost; over blinded_background_dn: BLINDED and the event SENSOR_BLINDED.",
        afterwards="The next frame is as before.",
    ),
    FaultKind(
        BlindingSettings,
        Blinding,
        what="Sun, Moon or Earth stands within its exclusion angle, or comes nearer all the time: the "
        "background goes towards saturation, more on the body's side.",
        obc_sees="background_dn over blinded_background_dn: attitudes not valid with BLINDED, the event "
        "SENSOR_BLINDED once in a row of blinded frames, TRACKING_LOST after tracking_max_missed frames, "
        "mode LOST_IN_SPACE.",
        afterwards="The unit acquires anew by itself.",
    ),
    FaultKind(
        BrightObjectSettings,
        BrightObject,
        what="A bright point crosses the field from a corner through the middle: a streak in each frame.",
        obc_sees="Attitudes stay valid and right; while it passes a window stars_identified may fall by one "
        "or some, and a bright one adds to spots_detected.",
        afterwards="The next frame is as before.",
    ),
)
