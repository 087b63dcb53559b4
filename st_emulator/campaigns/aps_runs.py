"""One run of the multi-poles paper's dynamic campaigns: images of a camera that turns, until an attitude is
found.

Schiattarella, Spiller and Curti 2020 ("M"), section 6: constant rates, attitudes over the whole sphere, 26
directions of the rate, up to 60 images that follow each other without a gap, at least two of them. The stages
are the unit's own; what is of the campaign is the sky (stars to 6.5 mag, M table 1), the 50 false objects of
the worst case, which M adds after the fusion, and the judgement.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bench.frame_context import synchronised_context
from ..bench.star_tables import star_tables
from ..bench.world_of import camera_model
from ..compiled_kernels import keep_compiled_kernels
from ..device.calibration import firmware_configuration
from ..device.parameters import default_parameters
from ..firmware_model.configuration import FirmwareConfiguration, StarTables
from ..firmware_model.frame_log import FrameLog
from ..firmware_model.frame_result import FrameContext
from ..firmware_model.frame_search import SearchOutcome, velocity_over_c
from ..firmware_model.full_frame_search import identify_spots, star_motion_of
from ..firmware_model.image.detection import detect_clusters
from ..firmware_model.image.spots import Spots
from ..firmware_model.image.streaks import StreakTable, streak_table
from ..firmware_model.modes import Mode
from ..firmware_model.reasons import Reason
from ..firmware_model.star_motion import KeptFrame, StarMotion
from ..firmware_model.work import Work
from ..units.profile import UnitProfile
from ..world import quaternion
from ..world.scene import RenderedFrame, SceneRenderer
from ..world.stars import StarField, star_field
from ..world.time_scales import julian_year
from ..world.trajectory import ConstantRateTrajectory
from ..world.windows import put_windows
from .aps_centroids import CentroidErrors, PaperWay, centroid_errors, paper_configuration
from .bench import error_arcsec, start_tai_ns, with_section

Array = NDArray[np.float64]

SIMULATED_MAG = 6.5  # M table 1
MOST_IMAGES = 60  # M section 6.2
SUCCESS_ARCSEC = 360.0  # M section 6.2: of pitch and yaw
FALSE_OBJECTS = 50  # M section 6.5
FALSE_MAGNITUDES = (2.0, 5.5)  # ASSUMED: M prints none; of the stars that the catalogue holds
FASTEST_TRACKED_DEG_S = 10.0  # so that no attitude is refused for its rate: M judges the attitude alone
DIRECTIONS = np.array([v for v in itertools.product((-1, 0, 1), repeat=3) if any(v)], dtype=float)
BACKGROUNDS = 24
ROLLING_READOUT_MS = 200.0  # M (4)
GLOBAL_READOUT_MS = 40.0


@dataclass(frozen=True)
class Case:
    """shutter: rolling or global; worst: with false objects; rate_deg_s; attitude and direction by number."""

    shutter: str
    worst: bool
    rate_deg_s: int
    attitude: int
    direction: int


@dataclass(frozen=True)
class Run:
    """images: until an attitude was found, 0: none in MOST_IMAGES. error_arcsec: roll, pitch, yaw; nan
    without. wrong: an attitude that is none. unit, paper: centroid errors of the second image by the unit's
    way and by M's own, of the best case at a rate. paper_solved: M's own way has an attitude of that image.
    """

    images: int
    error_arcsec: Array
    wrong: bool
    unit: CentroidErrors
    paper: CentroidErrors
    paper_solved: bool


def attitude_of(number: int, count: int) -> Array:
    """q_icrs_to_sensor of attitude ``number`` of ``count``, evenly over the sphere.

    ASSUMED: M takes a geodesic polyhedron's corners, of which there are none with 200; a Fibonacci lattice is
    as even.
    """
    dec = math.degrees(math.asin(1.0 - (2 * number + 1) / count))
    ra = 360.0 * (number * 0.6180339887498949 % 1.0)
    return quaternion.quaternion_from_pointing(ra, dec, 360.0 * (number * 0.7548776662466927 % 1.0))


@lru_cache(maxsize=2)
def _sky() -> StarField:
    return star_field(julian_year(start_tai_ns()), SIMULATED_MAG)


class Bench:
    """The unit with one kind of shutter before its sky."""

    def __init__(self, profile_json: str, shutter: str, seed: int) -> None:
        keep_compiled_kernels()
        profile = UnitProfile.model_validate_json(profile_json)
        readout_ms = ROLLING_READOUT_MS if shutter == "rolling" else GLOBAL_READOUT_MS
        profile = with_section(profile, "detector", shutter=shutter)
        profile = with_section(profile, "timing", readout_ms=readout_ms)
        profile = with_section(profile, "tracking", rate_deg_s=FASTEST_TRACKED_DEG_S)
        self.profile = profile
        self.tables: StarTables = star_tables(profile)
        configuration = firmware_configuration(profile, default_parameters(profile))
        # The unit's limit of work is of its processor and not of M's algorithm.
        self.configuration: FirmwareConfiguration = replace(configuration, cycle_budget=None)
        self.paper = PaperWay(paper_configuration(self.configuration), self.tables)
        still = ConstantRateTrajectory(np.array([0.0, 0.0, 0.0, 1.0]))
        camera, start = camera_model(profile), start_tai_ns()
        self.scene = SceneRenderer(camera, _sky(), still, seed=seed, start_tai_ns=start, quick_light=True)
        none = _without_stars(_sky())
        empty = SceneRenderer(camera, none, still, seed=seed, start_tai_ns=start, quick_light=True)
        self._backgrounds = [empty.frame(number, 0).full() for number in range(BACKGROUNDS)]
        self._canvas = np.empty_like(self._backgrounds[0])

    def image(self, frame: RenderedFrame) -> NDArray[np.uint16]:
        """The frame's pixels wherever light falls; elsewhere those of one of BACKGROUNDS frames without
        stars.

        So the noise is that of a whole frame, pixel by pixel, and only where light falls is it made anew;
        what repeats is the noise far from all stars, every BACKGROUNDS images. Valid until the next call.
        """
        box = frame.light.box
        flat, offsets = frame.windows(box)
        self._canvas[...] = self._backgrounds[frame.frame_index % BACKGROUNDS]
        put_windows(self._canvas, box, flat, offsets)
        return self._canvas


def _without_stars(field: StarField) -> StarField:
    return StarField(
        field.hip[:0], field.unit_vectors[:0], field.hp_mag[:0], field.parallax_rad[:0], field.epoch_jyear
    )


@lru_cache(maxsize=4)
def bench_of(profile_json: str, shutter: str, seed: int) -> Bench:
    """The bench of a shutter; those asked for last are kept."""
    return Bench(profile_json, shutter, seed)


def run_case(profile_json: str, seed: int, attitudes: int, case: Case) -> Run:
    """Images until there is an attitude."""
    bench = bench_of(profile_json, case.shutter, seed)
    axis = DIRECTIONS[case.direction] / np.linalg.norm(DIRECTIONS[case.direction])
    bench.scene.trajectory = ConstantRateTrajectory(
        attitude_of(case.attitude, attitudes), np.radians(case.rate_deg_s) * axis
    )
    chance = np.random.default_rng([seed, case.attitude, case.direction, case.rate_deg_s, int(case.worst)])
    first = int(chance.integers(0, 2**31))  # of the noise
    measured = bool(case.rate_deg_s) and not case.worst
    previous: KeptFrame | None = None
    clusters: StreakTable | None = None
    errors = (CentroidErrors.none(), CentroidErrors.none(), False)
    found = (0, np.full(3, np.nan), False)
    for number in range(MOST_IMAGES):
        frame = bench.scene.frame(first + number, number * bench.profile.frame_period_ns)
        image = bench.image(frame)
        outcome = _process(bench, frame, image, number, previous, chance if case.worst else None)
        previous = outcome.kept
        if measured and number < 2:
            before, clusters = clusters, bench.paper.clusters(image)
            if before is not None:
                errors = _errors(bench, frame, outcome, before, clusters)
        if outcome.q is not None:
            true = bench.scene.trajectory.q_icrs_to_sensor(frame.exposure_mid_ns)
            x, y, z = error_arcsec(outcome.q, true)
            wrong = max(abs(x), abs(y)) > SUCCESS_ARCSEC
            found = (number + 1, np.array([z, x, y]), wrong)
            break
    return Run(*found, *errors)


@dataclass(frozen=True)
class _Outcome:
    context: FrameContext
    kept: KeptFrame
    plain: Spots
    motion: StarMotion
    search: SearchOutcome | None

    @property
    def q(self) -> Array | None:
        if self.search is None or self.search.attitude is None or self.search.reasons != Reason.NONE:
            return None
        return self.search.attitude.q_icrs_to_sensor


def _process(
    bench: Bench,
    frame: RenderedFrame,
    image: NDArray[np.uint16],
    number: int,
    previous: KeptFrame | None,
    chance: np.random.Generator | None,
) -> _Outcome:
    """The unit's stages on one image; ``chance``: of the false objects, None without them."""
    configuration = bench.configuration
    assert configuration.rate is not None
    context = synchronised_context(frame, number, Mode.LOST_IN_SPACE, bench.scene.start_tai_ns)
    log = FrameLog(Work(), None)
    detected, _ = detect_clusters(image, configuration.detection)
    now = log.run("keep_runs", streak_table, detected=detected)
    motion = star_motion_of(now, context, previous, configuration, configuration.rate, log)
    kept = KeptFrame(number, context.t_mid_ns, now)
    if motion.fused is None:  # M: at least two images
        return _Outcome(context, kept, now.spots, motion, None)
    spots, place = motion.spots, motion.fused
    if chance is not None:
        spots = with_false_objects(motion.spots.take(motion.fused), chance, bench)
        place = np.arange(len(spots), dtype=np.int32)
    velocity = velocity_over_c(context, configuration, log)
    outcome = identify_spots(spots, place, configuration, bench.tables, velocity, log)
    return _Outcome(context, kept, now.spots, motion, outcome)


def _errors(
    bench: Bench, frame: RenderedFrame, outcome: _Outcome, before: StreakTable, now: StreakTable
) -> tuple[CentroidErrors, CentroidErrors, bool]:
    """Of the unit's way, and of M's on the clusters ``before`` and ``now``; whether M's has an attitude."""
    truth = bench.scene.truth(frame)
    unit, motion = CentroidErrors.none(), outcome.motion
    if motion.fused is not None and outcome.search is not None:
        unit = centroid_errors(truth, outcome.plain, motion.spots, motion.fused, outcome.search)
    period_s = bench.profile.frame_period_ns * 1e-9
    return unit, *bench.paper.errors(before, now, outcome.context, period_s, truth)


def with_false_objects(spots: Spots, chance: np.random.Generator, bench: Bench) -> Spots:
    """Spots and FALSE_OBJECTS others anywhere in the image, brightest first."""
    camera = bench.scene.camera
    false = Spots.at(
        chance.uniform(0, camera.width_px - 1, FALSE_OBJECTS),
        chance.uniform(0, camera.height_px - 1, FALSE_OBJECTS),
        chance.uniform(*FALSE_MAGNITUDES, FALSE_OBJECTS),
        zero_point_dn=bench.configuration.detection.zero_point_dn_per_s
        * bench.configuration.detection.exposure_s,
    )
    order = np.argsort(np.concatenate([spots.magnitude, false.magnitude]), kind="stable")

    def both(name: str) -> NDArray[Any]:
        joined: NDArray[Any] = np.concatenate([getattr(spots, name), getattr(false, name)])[order]
        return joined

    return Spots(
        x_px=both("x_px"),
        y_px=both("y_px"),
        flux_dn=both("flux_dn"),
        magnitude=both("magnitude"),
        peak_dn=both("peak_dn"),
        pixels=both("pixels"),
        saturated=both("saturated"),
        at_edge=both("at_edge"),
        background_dn=spots.background_dn,
        noise_dn=spots.noise_dn,
    )
