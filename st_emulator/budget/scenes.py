"""Frames for the firmware, one by one: a sky under given conditions, lost in space and tracked after it.

The budget, its sweeps and its search for the worst case run these frames; `frames_of` gives them to anyone
else. A frame is a pure function of the unit, the conditions and the settings.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from ..bench.frame_context import synchronised_context
from ..bench.scenario import Scenario
from ..bench.star_tables import star_tables
from ..bench.world_of import bodies_of, camera_model, scene_of, sky_of
from ..campaigns.bench import STARS_ONLY, random_pointings, start_tai_ns, with_section
from ..compiled_kernels import keep_compiled_kernels
from ..device.calibration import firmware_configuration
from ..device.parameters import default_parameters
from ..firmware_model.configuration import FirmwareConfiguration, StarTables
from ..firmware_model.firmware import FirmwareState, FrameContext, FrameResult, process_frame
from ..firmware_model.frame_trace import StepRecord, Trace
from ..firmware_model.modes import Mode
from ..firmware_model.tracking import plan_windows
from ..tai import tai_ns_from_utc
from ..units.profile import UnitProfile
from ..world.false_spots import FalseSpots
from ..world.scene import RenderedFrame, SceneRenderer
from ..world.trajectory import ConstantRateTrajectory, InertialTrajectory

__all__ = [
    "Conditions",
    "FrameInputs",
    "frames_of",
    "frames_under",
    "random_conditions",
    "scenario_frames",
]

SPECIMEN = 1  # seed of the detector's fixed pattern: one unit throughout
NOISE_STRIDE = 1024  # indices of frames, which the noise follows from, that a number of the noise has


@dataclass(frozen=True)
class Conditions:
    """What one frame meets; with the unit's file all that its pixels follow from.

    attitude: q_icrs_to_sensor at the first exposure's start. rate_deg_s: sensor axes. false_stars: spots that
    are no stars, new ones each frame, of magnitudes uniform in false_star_magnitudes. noise: number of the
    noise and of the false stars' places. stray_electrons_s, hot_pixel_fraction: of the detector; None: the
    unit file's. frames_lost: frames between the last attitude and a tracked frame.
    """

    attitude: tuple[float, float, float, float]
    rate_deg_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    false_stars: int = 0
    false_star_magnitudes: tuple[float, float] = (3.0, 6.0)
    noise: int = 0
    stray_electrons_s: float | None = None
    hot_pixel_fraction: float | None = None
    frames_lost: int = 0


@dataclass(frozen=True)
class FrameInputs:
    """What `process_frame` takes for one frame.

    conditions: None where a scenario's sky is looked at. acquired: the state before a tracked frame is that
    of the firmware's own attitude; False: it was given the true one, as its own was not valid.
    """

    frame: RenderedFrame
    context: FrameContext
    state: FirmwareState
    configuration: FirmwareConfiguration
    tables: StarTables
    conditions: Conditions | None = None
    acquired: bool = True

    @property
    def tracking(self) -> bool:
        return self.context.acquisition is Mode.TRACKING

    @cached_property
    def traced(self) -> tuple[FrameResult, list[StepRecord]]:
        """The firmware's result with the steps that led to it; run once, kept with the inputs."""
        records: list[StepRecord] = []
        return self.process(records.append), records

    def process(self, trace: Trace | None = None) -> FrameResult:
        """Run the firmware on the frame; ``trace`` is told of each step."""
        return process_frame(
            self.frame, self.context, self.state, self.configuration, self.tables, trace=trace
        )

    def without_limit(self) -> FrameInputs:
        """The same with no limit to the search's work from the cycle budget."""
        return replace(self, configuration=replace(self.configuration, cycle_budget=None))


def random_conditions(
    n: int, seed: int, *, rate_deg_s: float = 0.0, false_stars: int = 0, frames_lost: int = 0
) -> list[Conditions]:
    """``n`` skies, attitudes uniform over all rotations, the rate about axes uniform over the sphere; the
    first ones of a seed stay the same.
    """
    attitudes = random_pointings(n, seed)
    generator = np.random.default_rng([seed, 0xA715])
    axes = generator.normal(size=(n, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return [
        Conditions(
            attitude=_four(attitudes[number]),
            rate_deg_s=_three(rate_deg_s * axes[number] + 0.0),  # no zero with a sign
            false_stars=false_stars,
            noise=number,
            frames_lost=frames_lost,
        )
        for number in range(n)
    ]


def frames_of(
    profile: UnitProfile,
    *,
    seed: int,
    rate_deg_s: float = 0.0,
    false_stars: int = 0,
    skies: int = 1,
    tracked: int = 2,
    frames_lost: int = 0,
    parameters: Mapping[str, float | int] | None = None,
    search_limit: bool = True,
) -> Iterator[FrameInputs]:
    """``skies`` random skies of a seed: of each one frame lost in space and ``tracked`` frames tracked.
    The frame lost in space of a unit that fuses frames (``[rate]``) follows another full one.

    rate_deg_s: about a random axis. frames_lost: frames without attitude between two of them, so that the
    windows are wider. parameters: on-board parameters that differ from the unit's. search_limit: whether the
    search of lost in space ends at the unit's cycle budget. Each frame comes with the state before it, so
    that it can be processed alone and in any order.
    """
    for conditions in random_conditions(
        skies, seed, rate_deg_s=rate_deg_s, false_stars=false_stars, frames_lost=frames_lost
    ):
        for inputs in frames_under(profile, conditions, tracked=tracked, parameters=parameters):
            yield inputs if search_limit else inputs.without_limit()


def frames_under(
    profile: UnitProfile,
    conditions: Conditions,
    *,
    tracked: int = 2,
    parameters: Mapping[str, float | int] | None = None,
) -> Iterator[FrameInputs]:
    """The frame lost in space under the conditions, then ``tracked`` frames tracked from its attitude.

    Where an attitude is not valid, the next frame is tracked from the true one: what the search costs is
    wanted, also where the mode logic would not have gone on.
    """
    renderer = _renderer(profile, conditions)
    yield from _chain(
        profile,
        renderer,
        0,
        conditions.noise * NOISE_STRIDE,
        conditions.frames_lost,
        tracked,
        _configuration(profile, parameters),
        conditions,
    )


def scenario_frames(
    profile: UnitProfile,
    scenario: Scenario,
    start_ns: int,
    number: int,
    *,
    tracked: int = 2,
    frames_lost: int = 0,
    parameters: Mapping[str, float | int] | None = None,
) -> Iterator[FrameInputs]:
    """The same of a scenario's sky and trajectory, from the frame that begins at ``start_ns`` on.

    number: of the noise, so that frames at one time differ; with 0 the pixels are those of the unit's own
    frames at that time. Raises ConfigurationError: see `scene_of`.
    """
    start = tai_ns_from_utc(scenario.start_utc)
    renderer = _scenario_renderer(profile.model_dump_json(), scenario.model_dump_json(by_alias=True), start)
    yield from _chain(
        profile,
        renderer,
        start_ns,
        start_ns // profile.frame_period_ns + number * NOISE_STRIDE * NOISE_STRIDE,
        frames_lost,
        tracked,
        _configuration(profile, parameters),
        None,
    )


def _chain(
    profile: UnitProfile,
    renderer: SceneRenderer,
    start_ns: int,
    index: int,
    frames_lost: int,
    tracked: int,
    configuration: FirmwareConfiguration,
    conditions: Conditions | None,
) -> Iterator[FrameInputs]:
    tables = star_tables(profile)
    period_ns = profile.frame_period_ns
    state = FirmwareState.initial()
    acquired = True
    before: RenderedFrame | None = None
    if configuration.rate is not None:
        # The heavier of a unit's frames lost in space: one that is fused with the full frame before it.
        first = renderer.frame(index, start_ns, configuration.exposure_ns)
        context = synchronised_context(first, -1, Mode.LOST_IN_SPACE, renderer.start_tai_ns)
        led = process_frame(first, context, state, configuration, tables)
        state = replace(state, previous=led.state.previous)
        start_ns, index = start_ns + period_ns, index + 1
    for number in range(tracked + 1):
        if before is not None:
            start_ns += (frames_lost + 1) * period_ns
            index += frames_lost + 1
        frame = renderer.frame(index, start_ns, configuration.exposure_ns)
        acquisition = Mode.LOST_IN_SPACE if before is None else Mode.TRACKING
        context = synchronised_context(frame, number, acquisition, renderer.start_tai_ns)
        inputs = FrameInputs(frame, context, state, configuration, tables, conditions, acquired)
        yield inputs
        if number == tracked:
            return
        result, _ = inputs.traced
        acquired = result.valid
        state = result.state if acquired else _true_state(renderer, frame, configuration, tables)
        state = replace(state, missed=min(frames_lost, configuration.tracking.max_missed))
        before = frame


def _true_state(
    renderer: SceneRenderer, frame: RenderedFrame, configuration: FirmwareConfiguration, tables: StarTables
) -> FirmwareState:
    """The state after a frame as if its true attitude had been found, the brightest star its pivot."""
    truth = np.asarray(renderer.trajectory.q_icrs_to_sensor(frame.exposure_mid_ns))
    state = FirmwareState.from_attitude(truth, frame.exposure_mid_ns)
    assert state.q_icrs_to_sensor is not None
    plan, _ = plan_windows(
        state.q_icrs_to_sensor,
        -1,
        tables.catalogue,
        configuration.geometry,
        configuration.tracking,
        0.0,
        frame.exposure_ns * 1e-9,
        np.zeros(3),
    )
    return replace(state, pivot=int(plan.star[0]) if len(plan.star) else -1)


@lru_cache(maxsize=8)
def _cached_configuration(
    profile_json: str, items: tuple[tuple[str, float | int], ...]
) -> FirmwareConfiguration:
    profile = UnitProfile.model_validate_json(profile_json)
    return firmware_configuration(profile, default_parameters(profile) | dict(items))


def _configuration(
    profile: UnitProfile, parameters: Mapping[str, float | int] | None
) -> FirmwareConfiguration:
    return _cached_configuration(profile.model_dump_json(), tuple(sorted((parameters or {}).items())))


@lru_cache(maxsize=4)
def _bare_renderer(profile_json: str, hot_pixel_fraction: float | None) -> SceneRenderer:
    """At rest; what the conditions say is put in for each frame."""
    profile = UnitProfile.model_validate_json(profile_json)
    if hot_pixel_fraction is not None:
        profile = with_section(profile, "detector", hot_pixel_fraction=hot_pixel_fraction)
    start = start_tai_ns()
    keep_compiled_kernels()
    return SceneRenderer(
        camera_model(profile),
        sky_of(start),
        InertialTrajectory(np.array([0.0, 0.0, 0.0, 1.0])),
        seed=SPECIMEN,
        start_tai_ns=start,
        bodies=bodies_of(profile, STARS_ONLY),
    )


def _renderer(profile: UnitProfile, conditions: Conditions) -> SceneRenderer:
    """A renderer of its own for the conditions: frames are rendered late, when others may be under way."""
    renderer = copy.copy(_bare_renderer(profile.model_dump_json(), conditions.hot_pixel_fraction))
    renderer.trajectory = ConstantRateTrajectory(
        np.array(conditions.attitude), np.radians(conditions.rate_deg_s)
    )
    renderer.false_spots = FalseSpots(conditions.false_stars, *conditions.false_star_magnitudes)
    if conditions.stray_electrons_s is not None:
        renderer.camera = replace(renderer.camera, stray_electrons_s=conditions.stray_electrons_s)
    return renderer


@lru_cache(maxsize=4)
def _scenario_renderer(profile_json: str, scenario_json: str, start_tai: int) -> SceneRenderer:
    profile = UnitProfile.model_validate_json(profile_json)
    scenario = Scenario.model_validate_json(scenario_json)
    return scene_of(profile, scenario, scenario.seed, start_tai)


def _four(values: NDArray[np.float64]) -> tuple[float, float, float, float]:
    return float(values[0]), float(values[1]), float(values[2]), float(values[3])


def _three(values: NDArray[np.float64]) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
