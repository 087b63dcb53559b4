"""What the firmware makes of an identification: unconfirmed stars, false matches, and the cycle budget."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hil_tests.firmware_model.synthetic_sky import (
    ARCSEC,
    ImageFrame,
    SyntheticSky,
    random_attitude,
    turn_between,
    vectors_of,
)
from hil_tests.firmware_model.test_pyramid import measure
from st_emulator.device.calibration import cycle_budget, firmware_configuration
from st_emulator.device.parameters import default_parameters
from st_emulator.firmware_model.catalogue.tables import StarTables
from st_emulator.firmware_model.configuration import (
    DetectionParameters,
    FirmwareConfiguration,
    IdentificationParameters,
    TrackingParameters,
)
from st_emulator.firmware_model.firmware import process_frame
from st_emulator.firmware_model.frame_result import FirmwareState, FrameContext, FrameResult
from st_emulator.firmware_model.geometry import CameraGeometry
from st_emulator.firmware_model.identification.algorithms import ALGORITHMS
from st_emulator.firmware_model.identification.interface import (
    Identification,
    IdentificationAlgorithm,
    Spikes,
    for_all_spikes,
    usable_spikes,
)
from st_emulator.firmware_model.identification.judgement import COUNT_NAMES, OPERATIONS, work_of
from st_emulator.firmware_model.modes import Mode
from st_emulator.firmware_model.processor import CycleBudget, ProcessorProfile
from st_emulator.firmware_model.reasons import Reason
from st_emulator.firmware_model.work import COUNTS, Work
from st_emulator.units.profile import Identification as IdentificationSection
from st_emulator.units.profile import load_unit

CAMERA = CameraGeometry(256, 256, 720.0)
SKY = SyntheticSky.make(41, 1500, CAMERA, 6.0)
TABLES = StarTables(SKY.catalogue, SKY.pairs)
CONFIGURATION = FirmwareConfiguration(
    CAMERA,
    DetectionParameters(zero_point_dn_per_s=4e6 / 8, exposure_s=0.1, saturation_dn=4095),
    IdentificationParameters(60 * ARCSEC, field_normals=CAMERA.field_normals(-4.0)),
    TrackingParameters(math.radians(1.0), 80 * ARCSEC, star_radius_px=4.0),
    aberration_correction=False,
)
PROCESSOR = ProcessorProfile.load("arm926ej_s")


def frame_of(q: np.ndarray, render_stars, expose, seed: int = 1) -> ImageFrame:
    view = SKY.view(q, border_px=-2.0)
    stars = zip(view.x_px, view.y_px, 4e5 * 10 ** (-0.4 * view.magnitude), strict=True)
    return ImageFrame(expose(render_stars((256, 256), list(stars)), np.random.default_rng(seed)))


def looked_at(q: np.ndarray, identify: IdentificationAlgorithm, render_stars, expose) -> FrameResult:
    """A frame with another algorithm, lost in space, a valid attitude known a quarter of a second ago."""
    configuration = replace(CONFIGURATION, identify=identify)
    known = FirmwareState(solved=q, solved_covariance_rad2=1e-10 * np.eye(3), solved_t_ns=0)
    context = FrameContext(1, Mode.LOST_IN_SPACE, 250_000_000, 100_000_000)
    return process_frame(frame_of(q, render_stars, expose), context, known, configuration, TABLES)


def three_of(found: Identification, wrong: bool) -> Identification:
    """Three of the stars found (or three wrong ones), as an algorithm gives them."""
    spots = np.flatnonzero(found.star_index >= 0)[:3]
    star_index = np.full(len(found.star_index), -1, np.int32)
    star_index[spots] = found.star_index[spots]
    if wrong:
        star_index[spots] = star_index[np.roll(spots, 1)]
    return Identification(star_index, 3, Reason.UNCONFIRMED, found.q_icrs_to_sensor, 1e-3)


@pytest.mark.parametrize("wrong", [False, True])
def test_three_stars_are_told_and_give_no_valid_attitude(wrong: bool, render_stars, expose) -> None:
    rng = np.random.default_rng(2)
    for _ in range(5):
        q = random_attitude(rng)
        while len(SKY.view(q)) < 9:
            q = random_attitude(rng)

        def identify(
            spikes: Spikes, tables: StarTables, parameters: IdentificationParameters
        ) -> tuple[Identification, Work]:
            found, work = ALGORITHMS["pyramid"](spikes, tables, parameters)
            return three_of(found, wrong), work

        result = looked_at(q, identify, render_stars, expose)
        assert result.reasons & Reason.UNCONFIRMED
        assert not result.valid
        assert result.false_solutions == math.inf
        assert result.acquisition_after is Mode.LOST_IN_SPACE
        assert result.rate_rad_s is None
        assert result.state.q_icrs_to_sensor is None
        np.testing.assert_array_equal(result.state.solved, q)  # nothing is built on it
        if not wrong:
            assert result.reasons == Reason.UNCONFIRMED
            assert result.stars_identified == 3


def test_the_false_solutions_of_valid_attitudes_are_few_in_both_modes(render_stars, expose) -> None:
    q = random_attitude(np.random.default_rng(3))
    frame = frame_of(q, render_stars, expose)
    context = FrameContext(1, Mode.LOST_IN_SPACE, 250_000_000, 100_000_000)
    first = process_frame(frame, context, FirmwareState.initial(), CONFIGURATION, TABLES)
    assert first.valid
    assert first.identification is not None
    assert first.false_solutions == first.identification.false_solutions < 1e-5
    context = FrameContext(2, Mode.TRACKING, 500_000_000, 100_000_000)
    second = process_frame(frame, context, first.state, CONFIGURATION, TABLES)
    assert second.valid
    assert second.windows > 0
    # (15) in its plain form, with the spread of a field of 20 x 20 deg somewhere between 5 and 14.2 deg
    matched, spots = second.stars_identified, second.spots_detected
    density, tolerance = len(TABLES.catalogue) / (4 * math.pi), 80 * ARCSEC
    low, high = (
        math.comb(spots, matched)
        * len(TABLES.catalogue)
        * (density * 4 * math.pi * math.sin(math.radians(spread)) * tolerance)
        * (density * math.pi * tolerance**2) ** (matched - 2)
        for spread in (5.0, 14.2)
    )
    assert low < second.false_solutions < high


def test_a_search_that_would_overrun_the_budget_ends_with_work_limit(render_stars, expose) -> None:
    """All spots false: the search would go on for a long time, and the frame must be ready in its own."""
    rng = np.random.default_rng(4)
    x, y = rng.uniform(10, 245, (2, 40))
    image = render_stars((256, 256), [(a, b, 30_000.0) for a, b in zip(x, y, strict=True)])
    frame = ImageFrame(expose(image, rng))
    context = FrameContext(1, Mode.LOST_IN_SPACE, 250_000_000, 100_000_000)
    free = process_frame(frame, context, FirmwareState.initial(), CONFIGURATION, TABLES)
    assert free.reasons == Reason.NO_MATCH
    needed = PROCESSOR.cycles(free.work)
    for share in (0.2, 0.4):  # at more, half of the budget is the rule
        allowed = needed.total - needed.by_stage["identification"] * share
        budget = CycleBudget(PROCESSOR, round(allowed))
        configuration = replace(CONFIGURATION, cycle_budget=budget)
        result = process_frame(frame, context, FirmwareState.initial(), configuration, TABLES)
        assert result.reasons == Reason.WORK_LIMIT
        used = PROCESSOR.cycles(result.work)
        assert used.by_stage["identification"] > 0
        assert used.total <= budget.cycles
    ample = replace(CONFIGURATION, cycle_budget=CycleBudget(PROCESSOR, 3 * needed.total))
    assert process_frame(frame, context, FirmwareState.initial(), ample, TABLES).reasons == Reason.NO_MATCH


def test_what_a_budget_leaves_for_the_search() -> None:
    pixel = PROCESSOR.cycles(Work({"threshold_pixels": 1_000_000})).total
    budget = CycleBudget(PROCESSOR, 10 * pixel)
    assert budget.for_search(Work()) == pytest.approx(9 * pixel)
    assert budget.for_search(Work({"threshold_pixels": 2_000_000})) == pytest.approx(7 * pixel)
    # A detection that leaves less than half still lets the unit acquire, late.
    assert budget.for_search(Work({"threshold_pixels": 20_000_000})) == pytest.approx(5 * pixel)


@pytest.mark.parametrize("name", ALGORITHMS)
def test_every_algorithm_ends_at_its_limit(name: str) -> None:
    rng = np.random.default_rng(5)
    b = vectors_of(CAMERA, *rng.uniform(5, 250, (2, 60)))
    magnitude = np.sort(rng.uniform(3, 6, 60))
    unlimited, work = ALGORITHMS[name](Spikes(b, magnitude), TABLES, CONFIGURATION.identification)
    assert unlimited.reason != Reason.NONE
    all_operations = work.operations()
    assert all_operations > 20_000
    for limit in (0, 2_000, 10_000):
        parameters = replace(CONFIGURATION.identification, max_operations=limit)
        found, work = ALGORITHMS[name](Spikes(b, magnitude), TABLES, parameters)
        assert found.reason == Reason.WORK_LIMIT
        assert (found.star_index == -1).all()
        assert work.operations() < limit + 10_000  # one outer step more at most
    costs = np.array(PROCESSOR.costs(COUNT_NAMES))
    parameters = replace(CONFIGURATION.identification, max_cycles=100_000.0, count_cycles=costs)
    found, work = ALGORITHMS[name](Spikes(b, magnitude), TABLES, parameters)
    assert found.reason == Reason.WORK_LIMIT
    assert 0 < PROCESSOR.cycles(work).total < 1_500_000


def test_operations_are_the_counts_of_their_stage() -> None:
    for place, name in enumerate(COUNT_NAMES):
        assert (COUNTS[name].stage == "identification" and COUNTS[name].step) == (place < OPERATIONS)
    work = work_of(np.arange(len(COUNT_NAMES)))
    assert work.operations() == sum(range(OPERATIONS))
    solving = [COUNT_NAMES.index(name) for name in ("qmethod_stars", "qmethod_solves")]
    assert work.operations("attitude") == sum(solving)  # rotations are there for their cycles alone
    assert set(COUNT_NAMES) >= {name for name, count in COUNTS.items() if count.stage == "identification"}


def test_spikes_that_cannot_be_matched_are_left_out() -> None:
    b = np.tile([0.0, 0.6, 0.8], (7, 1))
    magnitude = np.arange(7.0)
    b[1, 0] = np.nan
    b[2] *= 2.0
    b[3] = 0.0
    b[4, 1] = np.inf
    magnitude[5] = np.nan
    usable, places = usable_spikes(Spikes(b, magnitude))
    assert places.tolist() == [0, 6]
    assert usable.magnitudes.tolist() == [0.0, 6.0]
    np.testing.assert_array_equal(usable.b_vectors, b[[0, 6]])
    found = for_all_spikes(Identification(np.array([7, 8], np.int32), 2, Reason.NONE), places, 7)
    assert found.star_index.tolist() == [7, -1, -1, -1, -1, -1, 8]
    nothing, places = usable_spikes(Spikes(np.zeros((0, 3)), np.zeros(0)))
    assert len(nothing) == len(places) == 0
    with pytest.raises(ValueError, match="7 directions, but 6 magnitudes"):
        usable_spikes(Spikes(b, magnitude[:6]))


def test_the_order_of_the_spikes_is_kept_with_some_left_out() -> None:
    rng = np.random.default_rng(6)
    b, magnitude, row = measure(rng, CAMERA, SKY.view(random_attitude(rng)), noise_px=0.02)
    spoilt = rng.random(len(b)) < 0.3
    b[spoilt] = np.nan
    found, _ = ALGORITHMS["pyramid"](Spikes(b, magnitude), TABLES, CONFIGURATION.identification)
    assert found.reason == Reason.NONE
    assert (found.star_index[spoilt] == -1).all()
    named = found.star_index >= 0
    np.testing.assert_array_equal(SKY.catalogue.hip[found.star_index[named]], row[named] + 1)


def test_a_unit_file_chooses_among_the_algorithms_there_are() -> None:
    allowed = IdentificationSection.model_json_schema()["properties"]["algorithm"]["enum"]
    assert set(allowed) == set(ALGORITHMS)
    profile = load_unit("zy3")
    for name, algorithm in ALGORITHMS.items():
        section = {
            "algorithm": name,
            "most_false_matches": 1e-7,
            "brightness_referenced": {"distinct_mag": 0.3, "bright_limit_mag": 2.5},
            "multi_poles": {"magnitude_tolerance": 0.4, "least_recognised": 6},
        }
        changed = profile.model_validate(
            profile.model_dump() | {"identification": profile.identification.model_dump() | section}
        )
        configuration = firmware_configuration(changed, default_parameters(changed))
        assert configuration.identify is algorithm
        identification = configuration.identification
        assert identification.most_false_solutions == 1e-7
        assert identification.brightness.distinct_mag == 0.3
        assert identification.brightness.bright_limit_mag == 2.5
        assert identification.multi_poles.magnitude_tolerance == 0.4
        assert identification.multi_poles.least_recognised == 6


def test_the_budget_of_a_unit_is_that_by_which_its_frames_are_late() -> None:
    profile = load_unit("zy3")  # 4 Hz, 200 ms exposure, 40 ms read-out
    parameters = dict(default_parameters(profile))
    assert cycle_budget(profile, parameters).cycles == 100_000_000
    assert cycle_budget(profile, parameters | {"clock_hz": 20_000_000}).cycles == 5_000_000
    assert cycle_budget(profile, parameters | {"pipelined": 0}).cycles == 4_000_000
    assert cycle_budget(profile, parameters | {"pipelined": 0, "exposure_us": 250_000}).cycles == 0
    assert firmware_configuration(profile, parameters).cycle_budget.cycles == 100_000_000


def test_attitudes_from_a_stub_agree_with_the_sky(render_stars, expose) -> None:
    """The bench of this file is right: the pyramid itself gives a valid attitude."""
    q = random_attitude(np.random.default_rng(3))
    result = looked_at(q, ALGORITHMS["pyramid"], render_stars, expose)
    assert result.valid
    assert np.linalg.norm(turn_between(q, result.q_icrs_to_sensor)) < 5e-3
