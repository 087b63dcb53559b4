"""One unit's chain without its line: frames of the rendered sky through the firmware. What the campaigns
share.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bench.frame_context import synchronised_context
from ..bench.scenario import Scenario, Sky
from ..bench.star_tables import star_tables
from ..bench.world_of import bodies_of, camera_model, sky_of
from ..compiled_kernels import keep_compiled_kernels
from ..device.calibration import firmware_configuration
from ..device.parameters import default_parameters
from ..firmware_model.configuration import FirmwareConfiguration
from ..firmware_model.firmware import FirmwareState, FrameResult, process_frame
from ..firmware_model.modes import Mode
from ..tai import tai_ns_from_utc
from ..units.profile import UnitProfile
from ..world import quaternion
from ..world.scene import RenderedFrame, SceneRenderer
from ..world.trajectory import InertialTrajectory, Trajectory

ARCSEC_PER_RAD = 180 / np.pi * 3600
STARS_ONLY = Sky(sun=False, moon=False, earth=False)


def random_pointings(n: int, seed: int) -> NDArray[np.float64]:
    """``float64[n, 4]``: attitudes uniform over all rotations (q_icrs_to_sensor); the first n of a seed
    stay the same.
    """
    rng = np.random.default_rng([seed, 0x5EED])
    q = rng.normal(size=(n, 4))
    return np.asarray(q / np.linalg.norm(q, axis=1, keepdims=True))


def error_arcsec(q_estimated: NDArray[np.float64], q_true: NDArray[np.float64]) -> NDArray[np.float64]:
    """Error rotation in sensor axes: (x, y) across the boresight, z roll, arcsec."""
    return quaternion.error_rotation_vector(q_estimated, q_true) * ARCSEC_PER_RAD


@lru_cache(maxsize=2)
def start_tai_ns() -> int:
    return tai_ns_from_utc(Scenario().start_utc)


@lru_cache(maxsize=2)
def _scene(profile_json: str, seed: int, sky_json: str) -> SceneRenderer:
    profile = UnitProfile.model_validate_json(profile_json)
    sky = Sky.model_validate_json(sky_json)
    start = start_tai_ns()
    keep_compiled_kernels()
    return SceneRenderer(
        camera_model(profile),
        sky_of(start),
        InertialTrajectory(np.array([0.0, 0.0, 0.0, 1.0])),
        seed=seed,
        start_tai_ns=start,
        aberration=sky.aberration,
        bodies=bodies_of(profile, sky),
    )


@dataclass
class Chain:
    """A unit's camera and firmware, frame after frame; the sky's trajectory can be replaced."""

    profile: UnitProfile
    scene: SceneRenderer
    state: FirmwareState
    configuration: FirmwareConfiguration
    acquisition: Mode = Mode.LOST_IN_SPACE

    @classmethod
    def of(cls, profile: UnitProfile, seed: int, sky: Sky = STARS_ONLY) -> Chain:
        """A chain at rest with the unit's own parameters, lost in space."""
        scene = _scene(profile.model_dump_json(), seed, sky.model_dump_json())
        parameters = default_parameters(profile)
        return cls(
            profile,
            scene,
            FirmwareState.initial(),
            firmware_configuration(profile, parameters),
        )

    def look(self, trajectory: Trajectory) -> None:
        """Follow another trajectory, lost in space again."""
        self.scene.trajectory = trajectory
        self.restart()

    def restart(self) -> None:
        self.state = FirmwareState.initial()
        self.acquisition = Mode.LOST_IN_SPACE

    def expose(self, index: int) -> RenderedFrame:
        """Frame ``index`` of the grid."""
        return self.scene.frame(index, index * self.profile.frame_period_ns, self.configuration.exposure_ns)

    def step(self, index: int) -> tuple[RenderedFrame, FrameResult]:
        """Expose and process frame ``index``; the state goes on."""
        frame = self.expose(index)
        context = synchronised_context(frame, index, self.acquisition, self.scene.start_tai_ns)
        result = process_frame(frame, context, self.state, self.configuration, star_tables(self.profile))
        self.state, self.acquisition = result.state, result.acquisition_after
        return frame, result

    def true_attitude(self, frame: RenderedFrame) -> NDArray[np.float64]:
        return np.asarray(self.scene.trajectory.q_icrs_to_sensor(frame.exposure_mid_ns))

    def catalogue_stars_in_field(self, q_true: NDArray[np.float64]) -> int:
        """How many stars of the on-board catalogue truly lie in the image (by the true camera)."""
        catalogue = star_tables(self.profile).catalogue
        vectors = catalogue.unit_vectors @ quaternion.attitude_matrix(q_true).T
        near = vectors[vectors[:, 2] > np.cos(np.radians(self.profile.diagonal_deg / 2 * 1.05))]
        x, y, ahead = self.scene.camera.project(near)
        inside = ahead & (x > -0.5) & (y > -0.5)
        inside &= (x < self.profile.detector.columns - 0.5) & (y < self.profile.detector.rows - 0.5)
        return int(inside.sum())


def with_section(profile: UnitProfile, section: str, **values: Any) -> UnitProfile:
    """The unit with some figures of a section replaced; nothing that was computed of the old ones stays."""
    changed = profile.model_copy(update={section: getattr(profile, section).model_copy(update=values)})
    return UnitProfile.model_validate_json(changed.model_dump_json())


__all__ = [
    "ARCSEC_PER_RAD",
    "STARS_ONLY",
    "Chain",
    "error_arcsec",
    "random_pointings",
    "start_tai_ns",
    "with_section",
]
