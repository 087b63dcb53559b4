"""Frames of a turning camera through the whole firmware: rate without attitude, RATE_ONLY and back."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_tests.firmware_model.streak_scenes import (
    CAMERA,
    ELECTRONS_PER_DN,
    ELECTRONS_PER_S_MAG0,
    EXPOSURE_S,
    MAX_DN,
    ROW_TIME_S,
    TAU_PRE_DN,
    TurningCamera,
    photograph,
)
from hil_tests.firmware_model.synthetic_sky import (
    ARCSEC,
    ImageFrame,
    SyntheticSky,
    random_attitude,
    turn_between,
)
from st_emulator.firmware_model.configuration import (
    CentroidError,
    DetectionParameters,
    FirmwareConfiguration,
    IdentificationParameters,
    RateParameters,
    TrackingParameters,
)
from st_emulator.firmware_model.firmware import process_frame
from st_emulator.firmware_model.frame_result import FirmwareState, FrameContext, FrameResult
from st_emulator.firmware_model.modes import Mode, ModeEvent
from st_emulator.firmware_model.reasons import Reason
from st_emulator.firmware_model.work import Work

Array = NDArray[np.float64]
PERIOD_NS = 200_000_000
TRACKING_DEG_S = 1.0
CONFIGURATION = FirmwareConfiguration(
    CAMERA,
    DetectionParameters(
        tau_min_dn=TAU_PRE_DN,
        zero_point_dn_per_s=ELECTRONS_PER_S_MAG0 / ELECTRONS_PER_DN,
        exposure_s=EXPOSURE_S,
        saturation_dn=MAX_DN,
        max_pixels=600,
        piece_gap_px=3,
    ),
    IdentificationParameters(60 * ARCSEC, field_normals=CAMERA.field_normals(-6.0)),
    TrackingParameters(math.radians(TRACKING_DEG_S), 40 * ARCSEC, star_radius_px=3.0),
    exposure_ns=PERIOD_NS,
    centroid_error=CentroidError(0.01, 0.75, ELECTRONS_PER_DN, 2),
    aberration_correction=False,
    rate=RateParameters(identify_below_rad_s=math.radians(1.5)),
)


# No spots are ever so near to stars: nothing is identified.
UNIDENTIFIED = replace(CONFIGURATION, identification=IdentificationParameters(1e-9))


@cache
def sky() -> SyntheticSky:
    """2,617 stars to 5.5 mag, as the paper's catalogue has of the Hipparcos catalogue."""
    return SyntheticSky.make(52, 2617, CAMERA, 5.5)


@dataclass
class Run:
    """A camera whose rate steps between frames, and the firmware behind it."""

    seed: int
    row_time_s: float = ROW_TIME_S
    configuration: FirmwareConfiguration = CONFIGURATION
    mode: Mode = Mode.LOST_IN_SPACE
    state: FirmwareState = field(default_factory=FirmwareState.initial)
    index: int = 0
    results: list[FrameResult] = field(default_factory=list)
    true_rates: list[Array] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.q = random_attitude(self.rng)
        axis = self.rng.normal(size=3)
        self.axis = axis / np.linalg.norm(axis)

    def frame(self, rate_deg_s: float, *, skip: int = 0) -> FrameResult:
        """Turn on to the next frame at this rate, which holds through its exposure, and process it."""
        rate = np.radians(rate_deg_s) * self.axis
        self.index += 1 + skip
        # attitude at the middle of this frame's exposure, one frame on from that of the last
        camera = TurningCamera(self.q, rate, self.row_time_s)
        self.q = camera.attitude((1 + skip) * PERIOD_NS * 1e-9)
        now = TurningCamera(self.q, rate, self.row_time_s)
        start = replace_at(now, -now.mid_s(0))
        view = sky().vectors @ matrix_row(self.q) > np.cos(0.3)
        flux = ELECTRONS_PER_S_MAG0 * 10.0 ** (-0.4 * sky().magnitude[view])
        image = photograph(start.signal(0, sky().vectors[view], flux), self.rng)
        context = FrameContext(
            self.index, self.mode, self.index * PERIOD_NS, PERIOD_NS, None, self.row_time_s
        )
        result = process_frame(ImageFrame(image), context, self.state, self.configuration, sky().tables)
        self.state, self.mode = result.state, result.acquisition_after
        self.results.append(result)
        self.true_rates.append(rate)
        assert result.valid == (result.reasons == Reason.NONE)
        if result.valid:
            assert self.error_px(result) < 3.0
        return result

    def error_px(self, result: FrameResult) -> float:
        turn = turn_between(self.q, result.q_icrs_to_sensor)
        return float(np.linalg.norm(turn[:2])) * CAMERA.focal_px

    def sigmas(self, result: FrameResult) -> Array:
        """Error of the rate of the last frame over its own sigmas."""
        assert result.rate_rad_s is not None
        assert result.rate_covariance_rad2_s2 is not None
        error = result.rate_rad_s - self.true_rates[-1]
        return np.asarray(error / np.sqrt(np.diag(result.rate_covariance_rad2_s2)))


def matrix_row(q: Array) -> Array:
    from hil_tests.firmware_model.synthetic_sky import matrix

    return np.asarray(matrix(q)[2])


def replace_at(camera: TurningCamera, t_s: float) -> TurningCamera:
    """The camera with its time 0 at t_s of before."""
    return replace(camera, q=camera.attitude(t_s))


@pytest.mark.parametrize("row_time_s", [ROW_TIME_S, 0.0], ids=["rolling", "global"])
def test_at_rest_the_first_image_gives_the_attitude(row_time_s: float) -> None:
    run = Run(1, row_time_s)
    first = run.frame(0.0)
    assert first.valid
    assert first.rate_rad_s is None
    assert first.state.previous is not None
    if row_time_s:  # tracking needs to know how rows are displaced: by the second image
        assert first.event is None
        assert run.mode is Mode.LOST_IN_SPACE
        assert np.abs(run.sigmas(run.frame(0.0))).max() < 4.0
    assert run.results[-1].event is ModeEvent.ATTITUDE_ACQUIRED
    tracked = run.frame(0.0)
    assert tracked.valid
    assert np.abs(run.sigmas(tracked)).max() < 4.0
    assert tracked.state.previous is None  # windows are no full frame


def test_a_tumbling_unit_measures_its_rate_and_comes_back() -> None:
    """0, 4, 0 deg/s: TRACKING, LOST_IN_SPACE, RATE_ONLY and back, with reasons and rates all the way."""
    run = Run(3)
    for _ in range(3):
        assert run.frame(0.0).valid
    assert run.mode is Mode.TRACKING
    modes = []
    for _ in range(9):
        result = run.frame(4.0)
        modes.append(run.mode)
        assert not result.valid
        assert result.reasons != Reason.NONE
    assert modes[-1] is Mode.RATE_ONLY
    events = [result.event for result in run.results]
    assert events.count(ModeEvent.TRACKING_LOST) == 1
    assert events.count(ModeEvent.RATE_ALONE) == 1
    alone = [r for r in run.results if r.rate_rad_s is not None and r.acquisition_after is Mode.RATE_ONLY]
    assert len(alone) >= 3
    assert alone[0].event is ModeEvent.RATE_ALONE
    for result in alone[1:]:
        assert result.reasons == Reason.RATE_TOO_HIGH
        assert result.work["identifications"] == 0
        assert result.work["fusions"] == 1
    assert np.abs(run.sigmas(run.results[-1])).max() < 4.0
    for _ in range(4):
        run.frame(0.1)
    assert run.mode is Mode.TRACKING
    assert run.results[-1].valid
    assert ModeEvent.ATTITUDE_ACQUIRED in [result.event for result in run.results[-4:]]


def test_rates_are_within_three_sigmas() -> None:
    """Without any attitude, over rates and skies: 99 of 100 on each axis, and none is far off."""
    off = []
    for seed in range(5):
        for rate in (0.0, 0.5, 1.5, 3.0):
            run = Run(100 + seed, configuration=UNIDENTIFIED)
            assert run.frame(rate).rate_rad_s is None
            result = run.frame(rate)
            if result.rate_rad_s is not None:
                off.append(run.sigmas(result))
    assert len(off) >= 17
    assert np.mean(np.abs(off) > 3.0) < 0.02
    assert np.abs(off).max() < 5.0


@pytest.mark.parametrize("row_time_s", [ROW_TIME_S, 0.0], ids=["rolling", "global"])
def test_rates_of_tracking_are_within_three_sigmas(row_time_s: float) -> None:
    """From attitudes, with their covariances; none from an attitude that only seemed to stand still."""
    off = []
    for seed in range(4):
        run = Run(200 + seed, row_time_s)
        for _ in range(7):
            result = run.frame(0.15 + 0.2 * seed)
            if result.rate_rad_s is not None:
                off.append(run.sigmas(result))
        assert run.mode is Mode.TRACKING
    assert len(off) >= 18
    assert np.mean(np.abs(off) > 3.0) < 0.03
    assert np.abs(off).max() < 5.0


def test_identification_in_rate_only_below_its_rate() -> None:
    run = Run(5, mode=Mode.RATE_ONLY)
    run.frame(0.8)
    result = run.frame(0.8)
    assert result.valid
    assert ModeEvent.ATTITUDE_ACQUIRED in [r.event for r in run.results]


def test_slow_again_without_an_attitude() -> None:
    """A sky that the catalogue does not know: the rate alone leads back to LOST_IN_SPACE, and stays there."""
    run = Run(6, mode=Mode.RATE_ONLY, configuration=UNIDENTIFIED)
    run.frame(0.2)
    result = run.frame(0.2)
    assert not result.valid
    assert result.event is ModeEvent.SLOW_AGAIN
    assert run.mode is Mode.LOST_IN_SPACE
    for _ in range(3):
        assert run.frame(0.2).rate_rad_s is not None
        assert run.mode is Mode.LOST_IN_SPACE


def test_a_frame_that_is_missing_breaks_the_fusion() -> None:
    run = Run(7, mode=Mode.RATE_ONLY)
    run.frame(2.0)
    assert run.frame(2.0).rate_rad_s is not None
    after_a_gap = run.frame(2.0, skip=1)
    assert after_a_gap.rate_rad_s is None
    assert after_a_gap.work["fusions"] == 0


@pytest.mark.parametrize("compensation", ["rate", "displacement", "streak"])
def test_a_rolling_shutter_s_attitude_is_that_of_the_middle(compensation: str) -> None:
    """At 0.9 deg/s the rows spread by 3.7 px over 0.2 s; the attitude is right within a fraction of that."""
    run = Run(8)
    run.configuration = replace(CONFIGURATION, rate=replace(CONFIGURATION.rate, compensation=compensation))
    run.frame(0.9)
    errors = []
    for _ in range(4):
        result = run.frame(0.9)
        if result.valid:
            errors.append(run.error_px(result))
    assert len(errors) >= 3
    assert np.median(errors) < 0.4


def test_a_unit_without_a_rate_section_keeps_nothing() -> None:
    """And its work has none of the new counts; RATE_ONLY is LOST_IN_SPACE to it."""
    run = Run(
        9, 0.0, replace(CONFIGURATION, rate=None, detection=replace(CONFIGURATION.detection, piece_gap_px=0))
    )
    run.mode = Mode.RATE_ONLY
    result = run.frame(0.0)
    assert result.valid
    assert result.event is ModeEvent.ATTITUDE_ACQUIRED
    assert result.state.previous is None
    assert result.state.rate_rad_s is None
    new = Work({"streaks_kept": 1, "fusions": 1, "star_rates": 1, "energies": 1, "cluster_lengths": 1})
    assert all(result.work[name] == 0 for name in new.counts)
