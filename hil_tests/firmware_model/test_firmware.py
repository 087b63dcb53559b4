"""Frames of pixels through the whole firmware: acquisition, tracking, its loss and return."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import erfa
import numpy as np
import pytest

from hil_tests.firmware_model.synthetic_sky import (
    ARCSEC,
    ImageFrame,
    SyntheticSky,
    matrix,
    random_attitude,
    turn_between,
    turned,
)
from st_emulator.firmware_model.aberration import SPEED_OF_LIGHT_KM_S, earth_velocity_km_s
from st_emulator.firmware_model.configuration import (
    CentroidError,
    DetectionParameters,
    FirmwareConfiguration,
    IdentificationParameters,
    StarTables,
    TrackingParameters,
)
from st_emulator.firmware_model.firmware import process_frame
from st_emulator.firmware_model.frame_result import FirmwareState, FrameContext, FrameResult
from st_emulator.firmware_model.geometry import CameraGeometry
from st_emulator.firmware_model.modes import Mode, ModeEvent
from st_emulator.firmware_model.reasons import Reason
from st_emulator.firmware_model.work import COUNTS

CAMERA = CameraGeometry(256, 256, 720.0)  # 20 x 20 deg, 286 arcsec a pixel
PIXEL = 1.0 / 720.0
SKY = SyntheticSky.make(41, 1500, CAMERA, 6.0)
TABLES = StarTables(SKY.catalogue, SKY.pairs)
OMEGA_DEG_S = 1.0
PERIOD_NS, EXPOSURE_NS = 250_000_000, 100_000_000
ELECTRONS_PER_S, ELECTRONS_PER_DN = 4e6, 8.0
TAI_NS = 2_145_916_837_000_000_000  # 2026
CONFIGURATION = FirmwareConfiguration(
    CAMERA,
    DetectionParameters(
        zero_point_dn_per_s=ELECTRONS_PER_S / ELECTRONS_PER_DN, exposure_s=0.1, saturation_dn=4095
    ),
    IdentificationParameters(60 * ARCSEC, field_normals=CAMERA.field_normals(-4.0)),
    TrackingParameters(math.radians(OMEGA_DEG_S), 80 * ARCSEC, star_radius_px=4.0),
    exposure_ns=EXPOSURE_NS,
    centroid_error=CentroidError(0.015, 0.75, ELECTRONS_PER_DN, 2),
    blinded_background_dn=1000.0,
)
DIRECTIONS = [
    np.array(v) / np.linalg.norm(v) for v in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(v)
]
Fixture = Callable[..., np.ndarray]


@dataclass
class Bench:
    """A camera that turns as told, and the firmware behind it."""

    render_stars: Fixture
    expose: Fixture
    q: np.ndarray
    seed: int = 0
    sky: SyntheticSky = field(default=SKY)
    configuration: FirmwareConfiguration = CONFIGURATION
    state: FirmwareState = field(default_factory=FirmwareState.initial)
    mode: Mode = Mode.LOST_IN_SPACE
    t_ns: int = 0
    tai_set: bool = False
    noise: bool = True
    background_electrons: float = 800.0
    results: list[FrameResult] = field(default_factory=list)

    def image(self, q_mid: np.ndarray, rate_rad_s: np.ndarray, exposure_ns: int = EXPOSURE_NS) -> ImageFrame:
        """The sky drawn out by the rate during the exposure."""
        steps = 1 + int(np.linalg.norm(rate_rad_s) * exposure_ns * 1e-9 / PIXEL * 2)
        stars = []
        for step in range(steps):
            at = ((step + 0.5) / steps - 0.5) * exposure_ns * 1e-9
            view = self.sky.view(turned(q_mid, rate_rad_s * at), border_px=-2.0)
            flux = ELECTRONS_PER_S * exposure_ns * 1e-9 / steps * 10 ** (-0.4 * view.magnitude)
            stars += list(zip(view.x_px, view.y_px, flux, strict=True))
        signal = self.render_stars((256, 256), stars)
        if not self.noise:
            return ImageFrame(
                np.rint((signal + self.background_electrons) / ELECTRONS_PER_DN).astype(np.uint16)
            )
        rng = np.random.default_rng([self.seed, self.t_ns])
        return ImageFrame(self.expose(signal, rng, background_electrons=self.background_electrons))

    def process(self, frame: ImageFrame) -> FrameResult:
        """The frame at the present time."""
        context = FrameContext(
            self.t_ns // PERIOD_NS,
            self.mode,
            self.t_ns,
            EXPOSURE_NS,
            TAI_NS + self.t_ns if self.tai_set else None,
        )
        result = process_frame(frame, context, self.state, self.configuration, TABLES)
        self.state, self.mode = result.state, result.acquisition_after
        self.results.append(result)
        return result

    def step(self, rate_deg_s: np.ndarray | None = None, *, drop: bool = False) -> FrameResult | None:
        """Turn for one frame period, then take a frame (or lose it)."""
        rate = np.zeros(3) if rate_deg_s is None else np.radians(rate_deg_s)
        self.t_ns += PERIOD_NS
        self.q = turned(self.q, rate * PERIOD_NS * 1e-9)
        return None if drop else self.process(self.image(self.q, rate))

    def frame(self, rate_deg_s: np.ndarray | None = None) -> FrameResult:
        result = self.step(rate_deg_s)
        assert result is not None
        if result.valid:  # no valid attitude is ever wrong
            assert self.error_rad(result) < PIXEL
        return result

    def error_rad(self, result: FrameResult) -> float:
        """Cross-boresight error."""
        return float(np.linalg.norm(turn_between(self.q, result.q_icrs_to_sensor)[:2]))

    def acquire(self) -> FrameResult:
        result = self.frame()
        assert result.valid
        assert self.mode is Mode.TRACKING
        return result


@pytest.fixture
def bench(render_stars: Fixture, expose: Fixture) -> Callable[..., Bench]:
    """``bench(seed, stars=9, **changes)``: a bench that looks at a field of so many stars or more."""

    def make(seed: int, stars: int = 9, **changes: object) -> Bench:
        rng = np.random.default_rng(seed)
        while True:
            q = random_attitude(rng)
            if stars <= len(SKY.view(q, border_px=12.0)):
                return Bench(render_stars, expose, q, seed, **changes)  # type: ignore[arg-type]

    return make


@pytest.mark.parametrize("seed", range(6))
def test_lost_in_space_then_tracking(bench: Callable[..., Bench], seed: int) -> None:
    b = bench(seed)
    first = b.acquire()
    view = SKY.view(b.q, border_px=0.0)
    assert first.event is ModeEvent.ATTITUDE_ACQUIRED
    assert first.reasons == Reason.NONE
    assert first.windows == 0
    assert first.rate_rad_s is None
    assert first.stars_identified >= 5
    assert set(first.stars.hip.tolist()) <= set((view.row + 1).tolist())
    place = {int(row) + 1: (x, y) for row, x, y in zip(view.row, view.x_px, view.y_px, strict=True)}
    for hip, x, y in zip(first.stars.hip.tolist(), first.stars.x_px, first.stars.y_px, strict=True):
        assert math.hypot(x - place[hip][0], y - place[hip][1]) < 0.3
    index = first.star_index
    assert len(index) == first.spots_detected
    assert sorted(index[index >= 0].tolist()) == sorted(first.stars.row.tolist())
    for _ in range(3):
        result = b.frame()
        assert result.valid
        assert result.event is None
        assert result.windows == len(result.rects) > 0
        # 12.7 px/deg: 3.2 px in 0.25 s; 4 px and 0.6 px of streak
        assert result.window_half_width_px == 4 + 5
        assert result.stars_identified >= 0.7 * min(len(SKY.view(b.q)), 25)
        assert result.rate_rad_s is not None
        assert (np.abs(result.rate_rad_s) < np.radians([0.03, 0.03, 0.2])).all()
        assert result.residual_rms_arcsec < 40


def test_tracking_reads_its_windows_only(bench: Callable[..., Bench]) -> None:
    b = bench(7)
    b.acquire()
    b.t_ns += PERIOD_NS
    frame = b.image(b.q, np.zeros(3))
    result = b.process(frame)
    assert result.valid
    area = (result.rects[:, 2] - result.rects[:, 0]) * (result.rects[:, 3] - result.rects[:, 1])
    assert frame.pixels_read == area.sum() < 0.3 * 256 * 256


def test_a_frame_is_a_pure_function(bench: Callable[..., Bench]) -> None:
    b = bench(8)
    b.acquire()
    for mode in (Mode.TRACKING, Mode.LOST_IN_SPACE):
        frame = b.image(b.q, np.zeros(3))
        state = b.state
        kept = (state.q_icrs_to_sensor.copy(), state.covariance_rad2.copy())  # type: ignore[union-attr]
        context = FrameContext(1, mode, PERIOD_NS * 2, EXPOSURE_NS, TAI_NS)
        one, other = (process_frame(frame, context, state, CONFIGURATION, TABLES) for _ in range(2))
        np.testing.assert_array_equal(one.q_icrs_to_sensor, other.q_icrs_to_sensor)
        np.testing.assert_array_equal(one.covariance_rad2, other.covariance_rad2)
        assert one.work == other.work
        np.testing.assert_array_equal(state.q_icrs_to_sensor, kept[0])
        np.testing.assert_array_equal(state.covariance_rad2, kept[1])


@pytest.mark.parametrize("number", range(26))
def test_windows_hold_omega_in_every_direction_and_not_half_as_much_again(
    bench: Callable[..., Bench], number: int
) -> None:
    axis = DIRECTIONS[number]
    b = bench(100 + number, stars=12)
    b.acquire()
    for _ in range(6):
        result = b.frame(OMEGA_DEG_S * axis)
        assert result.valid
        assert b.mode is Mode.TRACKING
    assert result.rate_rad_s is not None
    off_deg_s = np.degrees(result.rate_rad_s) - OMEGA_DEG_S * axis
    assert (np.abs(off_deg_s) < [0.05, 0.05, 0.2]).all()  # roll is known worse, by the field's radius
    reasons = Reason.NONE
    for _ in range(16):  # longer than an old attitude says anything about the rate
        searched = b.mode is Mode.LOST_IN_SPACE
        result = b.frame(1.5 * OMEGA_DEG_S * axis)
        reasons |= result.reasons
        assert not (searched and result.valid)
    assert reasons & Reason.RATE_TOO_HIGH
    assert ModeEvent.TRACKING_LOST in [result.event for result in b.results]
    assert b.mode is Mode.LOST_IN_SPACE
    assert not result.valid
    back = [b.frame().valid for _ in range(8)]
    assert any(back[:4])
    assert b.mode is Mode.TRACKING


def test_spots_cut_by_their_windows_mean_too_high_a_rate(bench: Callable[..., Bench]) -> None:
    """A jump that puts every star on its window's edge; those in merged windows may still give a rate."""
    by_the_windows_alone = 0
    for seed in range(51, 63):
        b = bench(seed, stars=12)
        b.acquire()
        turn = np.zeros(3)
        turn[seed % 2] = b.frame().window_half_width_px * PIXEL
        b.q = turned(b.q, turn)
        result = b.frame()
        assert result.reasons & Reason.RATE_TOO_HIGH
        by_the_windows_alone += result.rate_rad_s is None
    assert by_the_windows_alone >= 4


def test_one_dropped_frame_is_survived_at_the_largest_rate(bench: Callable[..., Bench]) -> None:
    rate = OMEGA_DEG_S * np.array([0.8, -0.6, 0.0])
    b = bench(9, stars=12)
    b.acquire()
    narrow = b.frame(rate).window_half_width_px
    b.step(rate, drop=True)
    result = b.frame(rate)
    assert result.valid
    assert b.mode is Mode.TRACKING
    assert result.window_half_width_px > narrow
    assert b.frame(rate).window_half_width_px == narrow


def test_tracking_is_lost_after_max_missed_frames_and_says_why(bench: Callable[..., Bench]) -> None:
    b = bench(10)
    b.acquire()
    last = b.frame().q_icrs_to_sensor
    b.sky = replace(SKY, magnitude=SKY.magnitude + np.float32(20))  # the shutter stays closed
    widths = []
    for missed in range(3):
        result = b.frame()
        assert not result.valid
        assert result.reasons == Reason.TOO_FEW_STARS
        np.testing.assert_array_equal(result.q_icrs_to_sensor, last)
        assert (result.covariance_rad2 == 0).all()
        assert b.mode is (Mode.TRACKING if missed < 2 else Mode.LOST_IN_SPACE)
        assert result.event is (None if missed < 2 else ModeEvent.TRACKING_LOST)
        widths.append(result.window_half_width_px)
    assert widths == sorted(set(widths))
    result = b.frame()
    assert not result.valid
    assert result.reasons == Reason.TOO_FEW_STARS
    np.testing.assert_array_equal(result.q_icrs_to_sensor, last)
    b.sky = SKY
    assert b.frame().event is ModeEvent.ATTITUDE_ACQUIRED


def test_a_short_loss_does_not_leave_tracking(bench: Callable[..., Bench]) -> None:
    b = bench(11)
    b.acquire()
    closed = replace(SKY, magnitude=SKY.magnitude + np.float32(20))
    for _ in range(3):  # two missed, then one good: the count begins anew
        b.sky = closed
        for _ in range(2):
            assert not b.frame().valid
            assert b.mode is Mode.TRACKING
        b.sky = SKY
        assert b.frame().valid
        assert b.mode is Mode.TRACKING


def test_before_the_first_attitude_it_is_the_identity(bench: Callable[..., Bench]) -> None:
    b = bench(12)
    b.sky = replace(SKY, magnitude=SKY.magnitude + np.float32(20))
    result = b.frame()
    assert result.reasons == Reason.TOO_FEW_STARS
    assert result.q_icrs_to_sensor.tolist() == [0.0, 0.0, 0.0, 1.0]
    assert b.mode is Mode.LOST_IN_SPACE


def test_stray_light_blinds_both_modes(bench: Callable[..., Bench]) -> None:
    b = bench(13)
    b.background_electrons = 8200.0
    assert b.frame().reasons == Reason.BLINDED
    b.background_electrons = 800.0
    b.acquire()
    b.background_electrons = 8200.0
    result = b.frame()
    assert result.reasons == Reason.BLINDED
    assert result.background_dn > 1000
    assert result.windows > 0
    b.background_electrons = 800.0
    assert b.frame().valid


def test_tracking_from_a_given_attitude(bench: Callable[..., Bench]) -> None:
    b = bench(14)
    b.state = FirmwareState.from_attitude(-3.0004 / 3.0 * turned(b.q, np.array([2, -1, 0]) * PIXEL), b.t_ns)
    b.mode = Mode.TRACKING
    assert b.state.q_icrs_to_sensor is not None
    assert b.state.q_icrs_to_sensor[3] >= 0
    result = b.frame()
    assert result.valid
    assert result.event is None
    assert result.rate_rad_s is None  # the difference from a given attitude is no rate
    assert b.frame().rate_rad_s is not None
    with pytest.raises(ValueError, match="unit quaternion"):
        FirmwareState.from_attitude(np.array([1.0, 1.0, 0.0, 0.0]), 0)
    with pytest.raises(ValueError, match="unit quaternion"):
        FirmwareState.from_attitude(np.full(4, np.nan), 0)


def test_tracking_from_a_wrong_attitude_is_lost_and_never_valid(bench: Callable[..., Bench]) -> None:
    for seed in range(15, 25):
        b = bench(seed)
        b.state = FirmwareState.from_attitude(random_attitude(np.random.default_rng(1000 + seed)), b.t_ns)
        b.mode = Mode.TRACKING
        for _ in range(3):
            assert not b.frame().valid
        assert b.results[-1].event is ModeEvent.TRACKING_LOST
        assert b.frame().event is ModeEvent.ATTITUDE_ACQUIRED


def test_tracking_without_any_attitude_is_lost_in_space(bench: Callable[..., Bench]) -> None:
    b = bench(25)
    b.mode = Mode.TRACKING
    result = b.frame()
    assert result.valid
    assert result.event is None
    assert result.identification is not None
    b.state, b.mode = FirmwareState.initial(), Mode.TRACKING
    b.sky = replace(SKY, magnitude=SKY.magnitude + np.float32(20))
    assert b.frame().event is ModeEvent.TRACKING_LOST
    assert b.mode is Mode.LOST_IN_SPACE


def test_a_field_of_three_stars_is_identified_but_not_valid(bench: Callable[..., Bench]) -> None:
    b = bench(26)
    rows = SKY.view(b.q, border_px=12.0).row[:3]
    b.sky = replace(SKY, vectors=SKY.vectors[rows], magnitude=SKY.magnitude[rows])
    result = b.frame()
    assert result.reasons == Reason.UNCONFIRMED
    assert not result.valid
    assert result.spots_detected == result.stars_identified == 3
    assert sorted(result.stars.hip) == sorted(rows + 1)


def test_more_runs_than_the_table_holds(bench: Callable[..., Bench]) -> None:
    b = bench(27)
    b.configuration = replace(CONFIGURATION, detection=replace(CONFIGURATION.detection, max_runs=20))
    assert b.frame().reasons == Reason.TOO_MANY_SPOTS


def apparent_sky(velocity_km_s: np.ndarray) -> SyntheticSky:
    """The sky as an observer of this velocity sees it, by erfa."""
    beta = velocity_km_s / SPEED_OF_LIGHT_KM_S
    moved = erfa.ab(SKY.vectors, beta, 1e12, math.sqrt(1 - beta @ beta))
    return replace(SKY, vectors=np.asarray(moved))


def test_aberration_is_corrected_once_the_time_is_set(bench: Callable[..., Bench]) -> None:
    orbit = np.array([5.0, -4.0, 3.0])
    sky = apparent_sky(earth_velocity_km_s(TAI_NS) + orbit)
    errors: dict[str, list[float]] = {"corrected": [], "no time": [], "off": [], "no orbit": []}
    for seed in range(30, 36):
        b = bench(seed, stars=12)
        b.sky, b.noise = sky, False
        told = replace(CONFIGURATION, velocity_km_s=(5.0, -4.0, 3.0))
        cases = {
            "corrected": (told, True),
            "no time": (told, False),
            "off": (replace(told, aberration_correction=False), True),
            "no orbit": (CONFIGURATION, True),
        }
        for name, (b.configuration, b.tai_set) in cases.items():
            b.state, b.mode = FirmwareState.initial(), Mode.LOST_IN_SPACE
            b.acquire()
            errors[name].append(b.error_rad(b.frame()) / ARCSEC)
    worst = {name: max(values) for name, values in errors.items()}
    assert worst["corrected"] < 2.0  # centroids are good to 0.02 px, 6 arcsec
    assert worst["no time"] > 15.0
    assert worst["off"] == pytest.approx(worst["no time"], rel=0.01)
    assert 3.0 < worst["no orbit"] < 8.0  # 7.1 km/s are 4.9 arcsec


def test_the_covariance_tells_the_error(bench: Callable[..., Bench]) -> None:
    pulls = []
    for seed in range(200, 260):
        b = bench(seed, stars=7)
        for result in (b.frame(), b.frame(), b.frame()):
            if result.valid:
                error = turn_between(b.q, result.q_icrs_to_sensor)
                pulls.append(error / np.sqrt(np.diag(result.covariance_rad2)))
    assert len(pulls) > 150
    spread = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert (spread > 0.6).all()
    assert (spread < 1.5).all()


def test_the_expected_error_of_a_centroid(render_stars: Fixture) -> None:
    """Plain centres of mass of 5 x 5 px against the formula, bright and dim."""
    rng = np.random.default_rng(60)
    error = CentroidError(0.0, 0.75, ELECTRONS_PER_DN, 2)
    for electrons in (1500.0, 20_000.0):
        signal = render_stars((5, 5), [(2.0, 2.0, electrons)])
        images = (rng.poisson(signal, (4000, 5, 5)) + rng.normal(0, 19.0, (4000, 5, 5))) / ELECTRONS_PER_DN
        x = (images.sum(axis=1) * np.arange(5)).sum(axis=1) / images.sum(axis=(1, 2))
        expected = error.sigma_px(np.array([electrons / ELECTRONS_PER_DN]), 19.0 / ELECTRONS_PER_DN)[0]
        assert x.std() == pytest.approx(expected, rel=0.12)
    floor = replace(error, floor_px=0.3).sigma_px(np.array([1e9]), 0.0)[0]
    assert floor == pytest.approx(0.3, abs=1e-3)


def test_magnitudes_follow_the_frames_exposure(bench: Callable[..., Bench]) -> None:
    b = bench(28)
    magnitude = []
    for exposure_ns in (50_000_000, 200_000_000):
        frame = b.image(b.q, np.zeros(3), exposure_ns)
        context = FrameContext(0, Mode.LOST_IN_SPACE, 0, exposure_ns)
        magnitude.append(process_frame(frame, context, b.state, CONFIGURATION, TABLES).spots.magnitude[0])
    assert magnitude[0] == pytest.approx(magnitude[1], abs=0.1)


def test_work_is_counted_by_what_was_done(bench: Callable[..., Bench]) -> None:
    b = bench(29)
    acquired = b.acquire()
    followed = b.frame()
    for work in (found := acquired.work, tracked := followed.work):
        assert work["frames"] == work["directions_begun"] == 1
        for name in ("qmethod_solves", "covariance_stars", "unit_vectors"):
            assert work[name] > 0, name
    assert found["threshold_pixels"] == 256 * 256
    assert found["kvector_queries"] >= 3
    assert found["triads_tested"] >= 1
    assert found["centroid_errors"] >= acquired.stars_identified
    assert tracked["centroid_errors"] == tracked["spread_stars"] >= followed.stars_identified
    assert (found["false_solutions"], tracked["false_solutions"]) == (0, 1)
    assert found["windows"] == found["newton_steps"] == 0  # the whole frame, a pinhole
    assert found["aberrated_stars"] == tracked["aberrated_stars"] == 0
    b.tai_set = True
    assert b.frame().work["aberrated_stars"] >= tracked["predicted_stars_projected"]
    b.mode = Mode.LOST_IN_SPACE
    again = b.frame()
    assert again.work["aberrated_stars"] >= again.stars_identified
    assert again.work["observer_velocities"] == 1
    assert tracked["threshold_pixels"] == 0
    assert tracked["windows"] == b.results[1].windows
    assert tracked["angles_compared"] >= tracked["spots_assigned"] >= b.results[1].stars_identified - 1
    assert all(COUNTS[name].stage != "identification" for name, count in tracked.counts.items() if count)
    assert all(COUNTS[name].stage != "tracking" for name, count in found.counts.items() if count)


def test_two_stars_that_make_one_spot_do_not_spoil_tracking(bench: Callable[..., Bench]) -> None:
    """Apart in the catalogue, together in the image: at least 8 other stars must win."""
    b = bench(50, stars=10)
    b.acquire()
    view = SKY.view(b.q, border_px=12.0)
    brightest = int(view.row[0])
    beside = matrix(b.q)[0] * 2.5 * PIXEL
    vectors = np.concatenate([SKY.vectors, [SKY.vectors[brightest] + beside]])
    vectors[-1] /= np.linalg.norm(vectors[-1])
    b.sky = replace(SKY, vectors=vectors, magnitude=np.append(SKY.magnitude, SKY.magnitude[brightest]))
    for _ in range(4):
        result = b.frame()
        assert result.valid
        assert brightest + 1 not in result.stars.hip
        assert b.error_rad(result) < 0.1 * PIXEL
