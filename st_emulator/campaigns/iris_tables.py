"""The rate tables of the optical-flow paper (Fasano et al. 2013, "F"): four turns, on a display and on the
sky.

A run is F's: 100 frames at 10 a second from an equatorial orbit of 500 km, boresight to the zenith at its
start, turning at the case's rate besides. F made one run a case; where its sky began is not printed, so that
here each run begins at another right ascension. F says that the sensor frame is the orbital frame turned by
180 deg about axis 1 and, in the same passage, that Y_s is axis 2 and X_s, Z_s are opposite; only the second
gives omega_2 = -0.06243 deg/s of its table 3, so it is the one taken.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bench.world_of import camera_model, sky_of
from ..compiled_kernels import keep_compiled_kernels
from ..device.calibration import firmware_configuration
from ..device.parameters import default_parameters
from ..firmware_model.frame_log import FrameLog
from ..firmware_model.geometry import CameraGeometry
from ..firmware_model.image.optical_flow import FlowParameters, OpticalFlow, light_up
from ..firmware_model.rate_from_flow import FlowRate, FlowSettings, rate_by_flow, rate_from_directions
from ..firmware_model.work import Work
from ..report import Check, TextTable, check
from ..units.profile import UnitProfile
from ..world import quaternion
from ..world.display import Display, DisplayRenderer
from ..world.scene import SceneRenderer
from ..world.trajectory import Instants, seconds
from .bench import start_tai_ns, with_section
from .campaign import CampaignRequest, CampaignResult

Array = NDArray[np.float64]

FRAMES = 101  # 100 rates
ORBIT_RATE_DEG_S = 0.06243  # F section 4: 500 km, circular
FIRST_RA_DEG = 83.0
GOLDEN = 0.6180339887498949  # runs begin where those before leave the largest gap
TO_ZENITH = np.array([-0.5, 0.5, -0.5, 0.5])  # ICRS to a sensor whose X, Y, Z are its -Y, -Z, X
AXES = ("omega_1", "omega_2", "omega_3")
SOURCES = ("display", "sky")


@dataclass(frozen=True)
class PaperCase:
    """One of F's four: the turn about the axes, and mean and standard deviation of the errors, deg/s."""

    turn_deg_s: tuple[float, float, float]
    mean: tuple[float, float, float]
    std: tuple[float, float, float]


FAINTEST_OF_LAWS = 5.75  # mag: the laws are of stars alike, whatever field they are in

CASES = (  # F tables 3, 4 and 5
    PaperCase((1.0, 0.0, 0.0), (-1.20e-4, -1.90e-3, -4.96e-3), (1.64e-2, 9.20e-3, 1.22e-1)),
    PaperCase((5.0, 0.0, 0.0), (-1.79e-1, 4.26e-4, -1.28e-1), (1.81e-1, 3.90e-2, 1.38)),
    PaperCase((0.0, 0.0, -1.0), (-2.88e-3, 1.61e-3, -6.66e-3), (6.72e-3, 5.71e-3, 5.57e-2)),
    PaperCase((0.0, 0.0, -5.0), (-9.57e-3, 9.61e-3, 7.95e-3), (1.52e-2, 7.47e-3, 1.21e-1)),
)


class ZenithOrbit:
    """The attitude of F: a circular equatorial orbit, boresight to the zenith, X against the velocity, Y
    south; turned besides at a constant rate about the sensor's axes. The Earth is behind.
    """

    def __init__(self, first_ra_deg: float, turn_deg_s: tuple[float, float, float]) -> None:
        self._first_rad = math.radians(first_ra_deg)
        self._turn_rad_s = np.radians(turn_deg_s)

    def q_icrs_to_sensor(self, t_ns: Instants) -> Array:
        """See ``Trajectory``."""
        t_s = seconds(t_ns)
        ra = self._first_rad + math.radians(ORBIT_RATE_DEG_S) * t_s
        about_pole = np.stack(
            [np.zeros_like(ra), np.zeros_like(ra), np.sin(0.5 * ra), np.cos(0.5 * ra)], axis=-1
        )
        base = quaternion.multiply(TO_ZENITH, about_pole)
        turned = quaternion.from_rotation_vector(t_s[..., np.newaxis] * self._turn_rad_s)
        return quaternion.canonical(quaternion.multiply(turned, base))

    def rate_sensor(self, t_ns: Instants) -> Array:
        """See ``Trajectory``."""
        turned = quaternion.from_rotation_vector(seconds(t_ns)[..., np.newaxis] * self._turn_rad_s)
        # the orbit's rate is about Z of ICRS, which is -Y of the frame that is not yet turned
        orbit = np.array([0.0, -math.radians(ORBIT_RATE_DEG_S), 0.0])
        return np.asarray(quaternion.rotate(turned, orbit) + self._turn_rad_s)

    def position_km(self, t_ns: Instants) -> Array | None:
        """None: at rates like these an aberration of 5 arcsec that turns with the orbit is nothing."""
        return None

    def velocity_km_s(self, t_ns: Instants) -> Array | None:
        """None, as the position."""
        return None


@dataclass(frozen=True)
class Setting:
    """What is run: case (index), source (of SOURCES), F's way or the unit's; for F's scaling laws a rate of
    so many stars by chance, all weighed alike, and another focal length.
    """

    case: int
    source: str
    paper_way: bool = False
    by_chance: int | None = None
    focal_factor: float = 1.0

    @property
    def turn_deg_s(self) -> tuple[float, float, float]:
        """Of the case; F's laws are of spots, so that theirs is a turn that leaves no streaks."""
        return CASES[self.case].turn_deg_s if self.by_chance is None else (0.2, 0.0, 0.0)


@dataclass(frozen=True)
class Run:
    """Of one run: errors float64[rates, 3], deg/s; expected errors the same; means over its frames of the
    stars followed, of their pixels and of their angle from the boresight (rad); frames without a rate.
    """

    errors_deg_s: Array
    sigmas_deg_s: Array
    stars: float
    pixels: float
    off_axis_rad: float
    without: int


@lru_cache(maxsize=4)
def _renderer(profile_json: str, source: str, seed: int) -> SceneRenderer:
    keep_compiled_kernels()
    profile = UnitProfile.model_validate_json(profile_json)
    start = start_tai_ns()
    arguments = (camera_model(profile), sky_of(start), ZenithOrbit(0.0, (0.0, 0.0, 0.0)))
    if source == "display":
        return DisplayRenderer(Display(), *arguments, seed=seed, start_tai_ns=start)
    return SceneRenderer(*arguments, seed=seed, start_tai_ns=start)


def run_once(profile: UnitProfile, seed: int, settings: tuple[Setting, ...], index: int) -> Run:
    """Run ``index``: settings in turn, run after run."""
    setting, number = settings[index % len(settings)], index // len(settings)
    if setting.focal_factor != 1.0:
        focal_mm = profile.optics.focal_length_mm * setting.focal_factor
        profile = with_section(profile, "optics", focal_length_mm=focal_mm)
    scene = _renderer(profile.model_dump_json(), setting.source, seed)
    trajectory = ZenithOrbit(FIRST_RA_DEG + 360.0 * (number * GOLDEN % 1.0), setting.turn_deg_s)
    scene.trajectory = trajectory
    geometry = firmware_configuration(profile, default_parameters(profile)).geometry
    parameters = FlowParameters(largest_shift_px=max(8, math.ceil(40 * setting.focal_factor)))
    how = FlowSettings(weighted=not setting.paper_way, predicted=not setting.paper_way)
    if setting.paper_way:
        parameters = FlowParameters(centrings=1)
    period_ns = profile.frame_period_ns
    exposure_ns = scene.camera.exposure_ns
    bright_dn = scene.camera.electrons_per_s_mag0 * exposure_ns * 1e-9 / scene.camera.electrons_per_dn
    bright_dn *= 10.0 ** (-0.4 * FAINTEST_OF_LAWS)
    log = FrameLog(Work(), None)
    before, last, before_ns = None, None, 0
    errors, sigmas, stars, pixels, off_axis, without = [], [], [], [], [], 0
    for frame_number in range(FRAMES):
        frame = scene.frame(number * FRAMES + frame_number, frame_number * period_ns, exposure_ns)
        after, _ = light_up(frame.full(), parameters)
        middle_ns = frame.exposure_mid_ns
        if before is not None:
            interval_s = (middle_ns - before_ns) * 1e-9
            flow, last = rate_by_flow(
                before, after, interval_s, exposure_ns * 1e-9, geometry, parameters, how, last, log
            )
            if setting.by_chance is not None:
                chance = np.random.default_rng([seed, number, frame_number])
                bright = before.flux_dn[flow.star] >= bright_dn
                some = flow.take(np.flatnonzero(bright))
                flow, found = _of_some(some, setting.by_chance, chance, geometry, interval_s)
            else:
                found = last
            if found is None:
                without += 1
            else:
                q_before, q_after = (trajectory.q_icrs_to_sensor(t) for t in (before_ns, middle_ns))
                turn = quaternion.to_rotation_vector(
                    quaternion.multiply(q_after, quaternion.conjugate(q_before))
                )
                errors.append(np.degrees(found.rate_rad_s - turn / interval_s))
                sigmas.append(np.degrees(np.sqrt(np.diag(found.covariance_rad2_s2))))
                used = flow.star[found.kept]
                stars.append(len(used))
                pixels.append(float(before.pixels[used].mean()))
                u = geometry.unit_vectors(before.x_px[used], before.y_px[used])
                off_axis.append(float(np.arccos(u[:, 2]).mean()))
        before, before_ns = after, middle_ns
    return Run(
        np.array(errors).reshape(-1, 3),
        np.array(sigmas).reshape(-1, 3),
        float(np.mean(stars)) if stars else 0.0,
        float(np.mean(pixels)) if pixels else 0.0,
        float(np.mean(off_axis)) if off_axis else 0.0,
        without,
    )


def _of_some(
    flow: OpticalFlow,
    count: int,
    chance: np.random.Generator,
    geometry: CameraGeometry,
    interval_s: float,
) -> tuple[OpticalFlow, FlowRate | None]:
    """The rate of so many of the followed stars."""
    if len(flow) < count:
        return flow, None
    some = flow.take(np.sort(chance.permutation(len(flow))[:count]))
    first = geometry.unit_vectors(some.x_before_px, some.y_before_px)
    second = geometry.unit_vectors(some.x_px, some.y_px)
    alike = np.full(count, 0.1 / geometry.focal_px)
    rate, _ = rate_from_directions(first, second, interval_s, alike, alike)
    return some, rate


MAIN = tuple(
    Setting(case, source, paper_way) for paper_way in (False, True) for source in SOURCES for case in range(4)
)
#: For F (13), (14) and (28): stars and IFOV, at 1 deg/s about axis 1, on the sky.
SCALING = (
    *(Setting(0, "sky", by_chance=stars) for stars in (5, 10, 20)),
    *(Setting(0, "sky", by_chance=10, focal_factor=factor) for factor in (0.5, 0.7)),
)


@dataclass(frozen=True)
class Pooled:
    """All runs of a setting: mean, standard error of the mean and standard deviation of the errors, deg/s,
    float64[3]; share of the errors within 3 of their own sigmas; means of the runs' stars, pixels and angles.
    """

    mean: Array
    standard_error: Array
    std: Array
    within_3_sigma: float
    stars: float
    pixels: float
    off_axis_rad: float
    rates: int
    without: int


def pooled(runs: list[Run]) -> Pooled | None:
    """None: no rate at all. Errors of one run share frames and stars, so that the standard error of the mean
    is of the runs' means where there are more than three, else as if each error were alone.
    """
    errors = np.concatenate([run.errors_deg_s for run in runs])
    if len(errors) < 2:
        return None
    sigmas = np.concatenate([run.sigmas_deg_s for run in runs])
    std = errors.std(axis=0)
    means = np.array([run.errors_deg_s.mean(axis=0) for run in runs if len(run.errors_deg_s)])
    standard_error = std / math.sqrt(len(errors))
    if len(means) > 3:
        standard_error = means.std(axis=0, ddof=1) / math.sqrt(len(means))
    return Pooled(
        errors.mean(axis=0),
        standard_error,
        std,
        float((np.abs(errors) <= 3.0 * sigmas).mean()),
        float(np.mean([run.stars for run in runs])),
        float(np.mean([run.pixels for run in runs])),
        float(np.mean([run.off_axis_rad for run in runs])),
        len(errors),
        sum(run.without for run in runs),
    )


def predicted_sigma_deg_s(profile: UnitProfile, found: Pooled, focal_factor: float = 1.0) -> float:
    """F (14): sqrt(2) / dt x IFOV / sqrt(N_star N_starpixels)."""
    ifov_deg = math.degrees(1.0 / (profile.focal_px * focal_factor))
    return (
        math.sqrt(2.0) / (profile.frame_period_ns * 1e-9) * ifov_deg / math.sqrt(found.stars * found.pixels)
    )


def run(request: CampaignRequest) -> CampaignResult:
    """``n`` runs of 100 rates for each case, on the display and on the sky, F's way and the unit's."""
    settings = (*MAIN, *SCALING)
    outcomes = request.workers.map(
        partial(run_once, request.profile, request.seed, settings), range(request.n * len(settings))
    )
    by_setting = {
        setting: pooled([outcomes[k] for k in range(place, len(outcomes), len(settings))])
        for place, setting in enumerate(settings)
    }
    checks: list[Check] = []
    for setting in MAIN:
        if not setting.paper_way:
            checks += _checks(setting, by_setting[setting])
    ratio = _ratio(by_setting[Setting(0, "sky")])
    checks.append(check("sigma_3_over_sigma_1_times_chi", ratio, ">=", 0.7, ""))
    checks.append(check("sigma_3_over_sigma_1_times_chi_most", ratio, "<=", 1.4, ""))
    by_stars, by_ifov = _exponents(by_setting)
    checks += [
        check("exponent_of_stars_least", by_stars, ">=", -0.7, ""),
        check("exponent_of_stars_most", by_stars, "<=", -0.3, ""),
        check("exponent_of_ifov_least", by_ifov, ">=", 0.7, ""),
        check("exponent_of_ifov_most", by_ifov, "<=", 1.3, ""),
    ]
    figures: dict[str, Any] = {
        "rates_a_run": FRAMES - 1,
        "exponent_of_stars": by_stars,
        "exponent_of_ifov": by_ifov,
        "sigma_3_over_sigma_1_times_chi": ratio,
        "settings": [_figures(request.profile, setting, found) for setting, found in by_setting.items()],
    }
    tables = [
        _table(f"errors of the rate, deg/s: {_way(paper_way)}", by_setting, paper_way)
        for paper_way in (False, True)
    ]
    return CampaignResult(figures, checks, tables)


def _way(paper_way: bool) -> str:
    return "F's way" if paper_way else "the unit's (weighted, predicted)"


def _checks(setting: Setting, found: Pooled | None) -> list[Check]:
    paper, name = CASES[setting.case], f"case {setting.case + 1}, {setting.source}"
    checks = []
    for axis, label in enumerate(AXES):
        std = None if found is None else float(found.std[axis])
        mean = None if found is None else abs(float(found.mean[axis]))
        allowed = abs(paper.mean[axis])
        if found is not None:
            allowed = max(allowed, 3.0 * float(found.standard_error[axis]))
        checks.append(check(f"{name}: {label} std", std, "<=", paper.std[axis], "deg/s"))
        checks.append(check(f"{name}: {label} mean", mean, "<=", allowed, "deg/s"))
    within = None if found is None else found.within_3_sigma
    checks.append(check(f"{name}: within 3 sigma", within, ">=", 0.985, ""))
    return checks


def _ratio(found: Pooled | None) -> float | None:
    """sigma(omega_3) chi / sigma(omega_1), which F (28) puts at about 1."""
    return None if found is None else float(found.std[2] / found.std[0] * found.off_axis_rad)


def _exponents(by_setting: dict[Setting, Pooled | None]) -> tuple[float | None, float | None]:
    """How sigma(omega_1) goes with the number of stars, and with the IFOV at the same number of stars."""
    by_stars = [
        (found.stars, found.std[0]) for found in map(by_setting.get, SCALING[:3]) if found is not None
    ]
    by_ifov = []
    for setting in (SCALING[1], *SCALING[3:]):
        found = by_setting.get(setting)
        if found is not None:
            # freed of what the number of stars and of their pixels does, F (14)
            scaled = found.std[0] * math.sqrt(found.stars * found.pixels)
            by_ifov.append((1.0 / setting.focal_factor, scaled))
    return _slope(by_stars), _slope(by_ifov)


def _slope(points: list[tuple[float, float]]) -> float | None:
    if len(points) < 3:
        return None
    x, y = np.log(np.array(points)).T
    return float(np.polyfit(x, y, 1)[0])


def _figures(profile: UnitProfile, setting: Setting, found: Pooled | None) -> dict[str, Any]:
    figures: dict[str, Any] = {
        "case": setting.case + 1,
        "source": setting.source,
        "paper_way": setting.paper_way,
        "by_chance": setting.by_chance,
        "focal_factor": setting.focal_factor,
    }
    if found is None:
        return figures
    return figures | {
        "rates": found.rates,
        "without_rate": found.without,
        "mean_deg_s": found.mean.tolist(),
        "standard_error_deg_s": found.standard_error.tolist(),
        "std_deg_s": found.std.tolist(),
        "within_3_sigma": found.within_3_sigma,
        "stars": found.stars,
        "pixels": found.pixels,
        "off_axis_deg": math.degrees(found.off_axis_rad),
        "predicted_sigma_1_deg_s": predicted_sigma_deg_s(profile, found, setting.focal_factor),
    }


def _table(title: str, by_setting: dict[Setting, Pooled | None], paper_way: bool) -> TextTable:
    rows = []
    for case, paper in enumerate(CASES):
        for axis, label in enumerate(AXES):
            row = [f"{case + 1}", label, f"{paper.mean[axis]:.2e}", f"{paper.std[axis]:.2e}"]
            for source in SOURCES:
                found = by_setting[Setting(case, source, paper_way)]
                if found is None:
                    row += ["-", "-"]
                else:
                    row += [
                        f"{found.mean[axis]:.1e} +- {found.standard_error[axis]:.0e}",
                        f"{found.std[axis]:.2e}",
                    ]
            rows.append(tuple(row))
    columns = (
        "case",
        "rate",
        "paper mean",
        "paper std",
        "display mean",
        "display std",
        "sky mean",
        "sky std",
    )
    return TextTable(title, columns, tuple(rows))
