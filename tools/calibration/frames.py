"""The frames of the calibration: which there are, and the records of their steps.

Frames come in sequences: one sky lost in space, then tracked. Those of the fit and those held out have other
skies, and half of the held out ones conditions between those of the fit. A sequence is a pure function of its
number, and nothing in it depends on the cycle costs: no search has a limit.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from st_emulator.bench.frame_context import synchronised_context
from st_emulator.bench.star_tables import star_tables
from st_emulator.bench.world_of import camera_model, sky_of
from st_emulator.campaigns.bench import STARS_ONLY, random_pointings, start_tai_ns, with_section
from st_emulator.compiled_kernels import keep_compiled_kernels
from st_emulator.device.calibration import firmware_configuration
from st_emulator.device.parameters import default_parameters
from st_emulator.firmware_model.configuration import FirmwareConfiguration, StarTables
from st_emulator.firmware_model.firmware import FirmwareState, process_frame
from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.identification.algorithms import ALGORITHMS
from st_emulator.firmware_model.modes import Mode
from st_emulator.firmware_model.reasons import Reason
from st_emulator.firmware_model.work import COUNTS
from st_emulator.units.profile import UnitProfile, load_unit
from st_emulator.world import quaternion
from st_emulator.world.false_spots import FalseSpots
from st_emulator.world.scene import SceneRenderer
from st_emulator.world.trajectory import ConstantRateTrajectory

__all__ = [
    "FIT",
    "HELD_OUT",
    "IDENTIFY",
    "KINDS",
    "LOST_IN_SPACE",
    "MOST_STEPS",
    "TRACKED",
    "TRACKING",
    "FrameRecords",
    "SkySequence",
    "configured_without_costs",
    "records_of",
    "renderer_of",
    "sequences",
]

UNITS: Final = ("roja1", "zy3", "aps_rs", "science_cam")
TRACKED: Final = 2  # frames of a sequence after the one lost in space
# Seeds of the skies and of the draw of conditions: the two sets have nothing in common.
FIT: Final = 926
HELD_OUT: Final = 5226
# Steps of identification (Work.operations) that the simulation of one frame is given; a frame with more is
# left out, as its search alone would take many seconds. It is four times what a frame period has room for.
MOST_STEPS: Final = 400_000
_NO_LIMIT = 100_000_000
# Of records: frames, and the spots of a frame lost in space given to the algorithms that it was not for.
LOST_IN_SPACE: Final = "lost_in_space"
TRACKING: Final = "tracking"
IDENTIFY: Final = "identify"
KINDS: Final = (LOST_IN_SPACE, TRACKING, IDENTIFY)
_OTHERS_FRAME = 1000  # number of the first of these in a sequence

# What the conditions are drawn from: for the fit, and between these for the held out frames.
_RATES_DEG_S = ((0.0, 0.0, 0.2, 1.0, 2.5, 5.0), (0.1, 0.5, 1.5, 3.5))
_FALSE_STARS = ((0, 0, 5, 30, 120, 500), (1, 12, 60, 250))
_SIGMA_SHARES = ((1.0, 1.0, 0.85, 1.5), (1.0, 0.95, 1.2))
_WINDOW_RATE_SHARES = ((1.0, 0.3, 2.0), (0.6, 1.5))
_FRAMES_LOST = ((0, 0, 0, 1), (0, 1))
_HALF_WINDOWS_PX = ((2, 2, 1, 3, 4), (2, 3))
_STRAY_SHARES = ((1.0, 1.0, 3.0), (1.0, 2.0))
_HOT_PIXELS = ((0.0, 0.0, 3e-5), (0.0, 1e-5))
_MOST_SPOTS = ((20, 20, 8, 14, 40), (20, 11, 30))


@dataclass(frozen=True)
class SkySequence:
    """Conditions of one sequence of frames; with the units' files all that its records follow from.

    number: of the sky and of all chance of the seed. algorithm: of the identification. rate_deg_s: sensor
    axes. parameters: on-board parameters that differ from the unit's. stray_share: of the unit's stray light.
    centroid: one of ``detection.CENTROIDS``. frames_lost: frames without attitude between two.
    """

    seed: int
    number: int
    unit: str
    algorithm: str
    rate_deg_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    false_stars: int = 0
    stray_share: float = 1.0
    hot_pixel_fraction: float | None = None
    centroid: str = "com"
    frames_lost: int = 0
    parameters: tuple[tuple[str, float], ...] = ()
    tracked: int = TRACKED

    def __str__(self) -> str:
        rate = float(np.linalg.norm(self.rate_deg_s))
        return (
            f"{self.unit}, {self.algorithm}, sky {self.number} of {self.seed}, {rate:.2g} deg/s, "
            f"{self.false_stars} false stars"
        )


@dataclass(frozen=True)
class FrameRecords:
    """The steps of one frame, or an identification alone.

    kind: one of ``KINDS``. left_out: its identification took over MOST_STEPS and is not there.
    """

    frame: int
    kind: str
    steps: tuple[StepRecord, ...]
    left_out: bool = False


def sequences(n: int, seed: int) -> list[SkySequence]:
    """``n`` sequences; the first ones of a seed stay the same.

    ``FIT``: every third with the unit's own parameters and nothing false in its sky, the others over the
    whole range of conditions. ``HELD_OUT``: every second one of the former kind, the others between the
    conditions of the fit.
    """
    between = int(seed != FIT)
    return [_drawn(number, seed, between) for number in range(n)]


def _drawn(number: int, seed: int, between: int) -> SkySequence:
    rng = np.random.default_rng([seed, number])

    def one(choices: Sequence[Sequence[Any]]) -> Any:
        values = choices[between]
        return values[int(rng.integers(len(values)))]

    unit = UNITS[number % len(UNITS)]
    profile = _profile(unit)
    turn = number // len(UNITS)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    if turn % (2 if between else 3) == 0:
        rate = axis * rng.uniform(0.0, profile.tracking.rate_deg_s)
        return SkySequence(seed, number, unit, profile.identification.algorithm, _three(rate))
    parameters = {
        "detection_sigma": profile.detection.sigma * one(_SIGMA_SHARES),
        "tracking_rate_deg_s": profile.tracking.rate_deg_s * one(_WINDOW_RATE_SHARES),
        "centroid_half_window_px": one(_HALF_WINDOWS_PX),
        "identification_max_spots": one(_MOST_SPOTS),
    }
    return SkySequence(
        seed,
        number,
        unit,
        tuple(ALGORITHMS)[int(rng.integers(len(ALGORITHMS)))],
        _three(axis * one(_RATES_DEG_S)),
        one(_FALSE_STARS),
        one(_STRAY_SHARES),
        one(_HOT_PIXELS),
        "gaussian" if rng.uniform() < 0.3 else "com",
        one(_FRAMES_LOST),
        tuple(sorted((name, float(value)) for name, value in parameters.items())),
    )


def _three(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


@lru_cache(maxsize=len(UNITS))
def _profile(unit: str) -> UnitProfile:
    return load_unit(unit)


def _configured(sequence: SkySequence) -> tuple[UnitProfile, FirmwareConfiguration]:
    profile = _profile(sequence.unit)
    profile = with_section(profile, "detection", centroid=sequence.centroid)
    stray = profile.detector.stray_electrons_s * sequence.stray_share
    profile = with_section(profile, "detector", stray_electrons_s=stray)
    if sequence.hot_pixel_fraction is not None:
        hot = {"hot_pixel_fraction": sequence.hot_pixel_fraction}
        if not profile.detector.hot_pixel_electrons_s:
            hot["hot_pixel_electrons_s"] = 4 * profile.detector.full_well_electrons
        profile = with_section(profile, "detector", **hot)
    configuration = configured_without_costs(profile, dict(sequence.parameters))
    identification = replace(
        configuration.identification,
        max_triads=_NO_LIMIT,
        max_pairs_compared=_NO_LIMIT,
        max_operations=_NO_LIMIT,
    )
    return profile, replace(
        configuration,
        identification=identification,
        identify=ALGORITHMS[sequence.algorithm],
        cycle_budget=None,
    )


def configured_without_costs(profile: UnitProfile, parameters: dict[str, float]) -> FirmwareConfiguration:
    """The unit's configuration, whatever the committed cycle costs: each count costs one cycle.

    A count that is new in ``work.py`` has no cost before it is calibrated.
    """
    with tempfile.TemporaryDirectory() as folder:
        entry = {"core_cycles": 1, "memory_cycles": 0, "evidence": "assumed", "source": "none"}
        costs = Path(folder) / "costs.json"
        costs.write_text(json.dumps({"clock_hz": 1_000_000, "counts": dict.fromkeys(COUNTS, entry)}))
        bare = with_section(profile, "processor", cycle_costs=str(costs))
        return firmware_configuration(bare, default_parameters(bare) | parameters)


def records_of(sequence: SkySequence) -> Iterator[FrameRecords]:
    """The frames of a sequence, in order: lost in space first, and its spots to the other algorithms last.

    Where a frame gives no valid attitude, the next one is tracked from the true one.
    """
    profile, configuration = _configured(sequence)
    tables = star_tables(profile)
    renderer = renderer_of(profile, sequence)
    period_ns = profile.frame_period_ns * (sequence.frames_lost + 1)
    state = FirmwareState.initial()
    others: list[StepRecord] = []
    for number in range(sequence.tracked + 1):
        frame = renderer.frame(number, number * period_ns, configuration.exposure_ns)
        acquisition = Mode.TRACKING if number else Mode.LOST_IN_SPACE
        context = synchronised_context(frame, number, acquisition, renderer.start_tai_ns)
        steps: list[StepRecord] = []
        result = process_frame(frame, context, state, configuration, tables, trace=steps.append)
        searched = result.work.operations("identification")
        limited = bool(result.reasons & Reason.WORK_LIMIT)
        left_out = limited or searched > MOST_STEPS
        kept = tuple(step for step in steps if not (left_out and step.step == "identify"))
        yield FrameRecords(number, TRACKING if number else LOST_IN_SPACE, kept, left_out)
        others += [] if number else _others(steps, sequence.algorithm)
        state = result.state
        if not result.valid:
            state = _true_state(renderer, frame.exposure_mid_ns, result.state, tables)
    for place, record in enumerate(others):
        yield FrameRecords(_OTHERS_FRAME + place, IDENTIFY, (record,))


def _others(steps: Sequence[StepRecord], own: str) -> list[StepRecord]:
    """The identification of a frame by each other algorithm, unless it takes too long."""
    found = []
    for step in steps:
        if step.step != IDENTIFY:
            continue
        for name, algorithm in ALGORITHMS.items():
            arguments = {**step.arguments, "algorithm": algorithm}
            if name == own:
                continue
            result, work = algorithm(arguments["spikes"], arguments["tables"], arguments["parameters"])
            if result.reason != Reason.WORK_LIMIT and work.operations("identification") <= MOST_STEPS:
                found.append(StepRecord(IDENTIFY, arguments, result, work))
    return found


def renderer_of(profile: UnitProfile, sequence: SkySequence) -> SceneRenderer:
    """The sky of a sequence as the unit sees it."""
    start = start_tai_ns()
    q = random_pointings(sequence.number + 1, sequence.seed)[sequence.number]
    rate = np.radians(sequence.rate_deg_s)
    keep_compiled_kernels()
    return SceneRenderer(
        camera_model(profile),
        sky_of(start),
        ConstantRateTrajectory(q, rate),
        seed=sequence.seed * 10_000 + sequence.number,
        start_tai_ns=start,
        aberration=STARS_ONLY.aberration,
        false_spots=FalseSpots(sequence.false_stars, 2.5, profile.detection.magnitude_limit),
    )


def _true_state(
    renderer: SceneRenderer, t_ns: int, state: FirmwareState, tables: StarTables
) -> FirmwareState:
    """The state as if the true attitude had been found at a time; pivot: the star nearest the boresight."""
    q = np.asarray(renderer.trajectory.q_icrs_to_sensor(t_ns))
    boresight = quaternion.attitude_matrix(q)[2]
    pivot = int(np.argmax(tables.catalogue.unit_vectors @ boresight))
    true = FirmwareState.from_attitude(q, t_ns)
    return replace(state, q_icrs_to_sensor=true.q_icrs_to_sensor, t_ns=t_ns, pivot=pivot)
