"""The rate tables of the optical-flow paper (Fasano et al. 2013, "F"): four turns, on a display and on the
sky.

A run is F's: 100 frames at 10 a second from an equatorial orbit of 500 km, boresight to the zenith at its
start, turning at the case's rate besides. F made one run a case; where its sky began is not printed, so that
here each run begins at another right ascension.

What the display does to a star: it stands in the middle of a display pixel, or of the strip of pixels that
it runs over in a scene, off by up to half a pixel of 0.011 deg on each axis: 0.19 px of the sensor, 1 sigma,
in each of two images. With 55 stars (F's mean) that alone is 0.006 deg/s where the errors of two frames are
independent: F's omega_1 and omega_2 of the slow turns are mostly the display's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bench.world_of import camera_model, sky_of
from ..compiled_kernels import keep_compiled_kernels
from ..device.calibration import firmware_configuration, flow_settings_of
from ..device.parameters import default_parameters
from ..firmware_model.frame_log import FrameLog
from ..firmware_model.geometry import CameraGeometry
from ..firmware_model.image.optical_flow import FlowFrame, FlowParameters, OpticalFlow, light_up
from ..firmware_model.rate_from_flow import FlowRate, FlowSettings, rate_by_flow, rate_from_directions
from ..firmware_model.work import Work
from ..report import Check, TextTable, check
from ..units.profile import UnitProfile
from ..world import quaternion
from ..world.display import Display, DisplayRenderer
from ..world.scene import SceneRenderer
from ..world.zenith_orbit import ZenithOrbit
from .bench import start_tai_ns, with_section
from .campaign import CampaignRequest, CampaignResult

Array = NDArray[np.float64]

FRAMES = 101  # 100 rates
FIRST_RA_DEG = 83.0
GOLDEN = 0.6180339887498949  # runs begin where those before leave the largest gap
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

    @property
    def view(self) -> View:
        """What it is made of; all settings of a view see the same frames."""
        return View(self.turn_deg_s, self.source, self.focal_factor)


@dataclass(frozen=True)
class View:
    """What the camera sees in a run: a turn in front of a source; several settings are of the same frames."""

    turn_deg_s: tuple[float, float, float]
    source: str
    focal_factor: float


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


class _Record:
    """Errors of the rates of one setting, as they come."""

    def __init__(self, geometry: CameraGeometry) -> None:
        self._geometry = geometry
        self._errors: list[Array] = []
        self._sigmas: list[Array] = []
        self._means: list[tuple[float, float, float]] = []
        self._without = 0

    def take(self, found: FlowRate | None, flow: OpticalFlow, before: FlowFrame, rate_rad_s: Array) -> None:
        if found is None:
            self._without += 1
            return
        self._errors.append(np.degrees(found.rate_rad_s - rate_rad_s))
        self._sigmas.append(np.degrees(np.sqrt(np.diag(found.covariance_rad2_s2))))
        used = flow.star[found.kept]
        u = self._geometry.unit_vectors(before.x_px[used], before.y_px[used])
        off_axis = float(np.arccos(u[:, 2]).mean())
        self._means.append((len(used), float(before.pixels[used].mean()), off_axis))

    def run(self) -> Run:
        stars, pixels, off_axis = np.array(self._means or [(0.0, 0.0, 0.0)]).mean(axis=0).tolist()
        errors, sigmas = (np.array(rows).reshape(-1, 3) for rows in (self._errors, self._sigmas))
        return Run(errors, sigmas, stars, pixels, off_axis, self._without)


class _Way:
    """A way to make a rate of the frames: F's, or the unit's; it remembers its last one."""

    def __init__(
        self,
        paper_way: bool,
        settings: FlowSettings,
        parameters: FlowParameters,
        exposure_ns: int,
        geometry: CameraGeometry,
    ) -> None:
        self._how = replace(settings, weighted=not paper_way, predicted=not paper_way)
        self._parameters = replace(parameters, centrings=1) if paper_way else parameters
        self._exposure_s = exposure_ns * 1e-9
        self._geometry = geometry
        self._last: FlowRate | None = None

    def rate(
        self, before: FlowFrame, after: FlowFrame, interval_s: float
    ) -> tuple[OpticalFlow, FlowRate | None]:
        flow, self._last = rate_by_flow(
            before,
            after,
            interval_s,
            self._exposure_s,
            self._geometry,
            self._parameters,
            self._how,
            self._last,
            FrameLog(Work(), None),
        )
        return flow, self._last


def run_once(
    profile: UnitProfile, seed: int, views: tuple[tuple[Setting, ...], ...], index: int
) -> tuple[Run, ...]:
    """Run ``index``: views in turn, run after run; a run for each setting of the view."""
    settings, number = views[index % len(views)], index // len(views)
    view = settings[0].view
    if view.focal_factor != 1.0:
        focal_mm = profile.optics.focal_length_mm * view.focal_factor
        profile = with_section(profile, "optics", focal_length_mm=focal_mm)
    scene = _renderer(profile.model_dump_json(), view.source, seed)
    trajectory = ZenithOrbit(FIRST_RA_DEG + 360.0 * (number * GOLDEN % 1.0), view.turn_deg_s)
    scene.trajectory = trajectory
    geometry = firmware_configuration(profile, default_parameters(profile)).geometry
    parameters = FlowParameters(largest_shift_px=max(8, math.ceil(40 * view.focal_factor)))
    exposure_ns = scene.camera.exposure_ns
    bright_dn = scene.camera.electrons_per_s_mag0 * exposure_ns * 1e-9 / scene.camera.electrons_per_dn
    bright_dn *= 10.0 ** (-0.4 * FAINTEST_OF_LAWS)
    ways = {
        paper_way: _Way(paper_way, flow_settings_of(profile), parameters, exposure_ns, geometry)
        for paper_way in {setting.paper_way for setting in settings}
    }
    records = [_Record(geometry) for _ in settings]
    before, before_ns = None, 0
    for frame_number in range(FRAMES):
        exposure_start_ns = frame_number * profile.frame_period_ns
        frame = scene.frame(number * FRAMES + frame_number, exposure_start_ns, exposure_ns)
        after, _ = light_up(frame.full(), parameters)
        middle_ns = frame.exposure_mid_ns
        if before is not None:
            interval_s = (middle_ns - before_ns) * 1e-9
            q_before, q_after = (trajectory.q_icrs_to_sensor(t) for t in (before_ns, middle_ns))
            turn = quaternion.multiply(q_after, quaternion.conjugate(q_before))
            rate_rad_s = quaternion.to_rotation_vector(turn) / interval_s
            rates = {paper_way: way.rate(before, after, interval_s) for paper_way, way in ways.items()}
            for setting, record in zip(settings, records, strict=True):
                flow, found = rates[setting.paper_way]
                if setting.by_chance is not None:
                    chance = np.random.default_rng([seed, number, frame_number])
                    alike = flow.take(np.flatnonzero(_alike(flow, found, before, bright_dn)))
                    flow, found = _of_some(alike, setting.by_chance, chance, geometry, interval_s)
                record.take(found, flow, before, rate_rad_s)
        before, before_ns = after, middle_ns
    return tuple(record.run() for record in records)


def _alike(
    flow: OpticalFlow, found: FlowRate | None, before: FlowFrame, bright_dn: float
) -> NDArray[np.bool_]:
    """The stars that F's laws are about: bright ones, seen well, and no mismatches. Which are mismatches is
    told by the rate of all stars: five by chance could not tell, and the law is of noise.
    """
    bright: NDArray[np.bool_] = before.flux_dn[flow.star] >= bright_dn
    return bright & found.kept if found is not None else np.zeros(len(flow), np.bool_)


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
CHOSEN_STARS = (5, 10, 20)
#: For F (13), (14) and (28): stars and IFOV, at 1 deg/s about axis 1, on the sky.
SCALING = (
    *(Setting(0, "sky", by_chance=stars) for stars in CHOSEN_STARS),
    *(Setting(0, "sky", by_chance=CHOSEN_STARS[1], focal_factor=factor) for factor in (0.5, 0.7)),
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
    weights = [len(run.errors_deg_s) for run in runs]  # a run without a rate says nothing of stars either
    stars, pixels, off_axis = np.average(
        [(run.stars, run.pixels, run.off_axis_rad) for run in runs], axis=0, weights=weights
    )
    return Pooled(
        errors.mean(axis=0),
        standard_error,
        std,
        float((np.abs(errors) <= 3.0 * sigmas).mean()),
        float(stars),
        float(pixels),
        float(off_axis),
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
    by_view: dict[View, list[Setting]] = {}
    for setting in settings:
        by_view.setdefault(setting.view, []).append(setting)
    views = tuple(tuple(group) for group in by_view.values())
    outcomes = request.workers.map(
        partial(run_once, request.profile, request.seed, views), range(request.n * len(views))
    )
    by_setting = {
        setting: pooled([run[place] for run in outcomes[number :: len(views)]])
        for number, group in enumerate(views)
        for place, setting in enumerate(group)
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
    tables.append(_table_of_runs(request.profile, by_setting))
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
    # a unit that tells no rate has no errors either
    told = None if found is None else found.rates / (found.rates + found.without)
    checks.append(check(f"{name}: rates told", told, ">=", 0.99, ""))
    if setting.source == "sky":
        # The unit is calibrated under the sky. It does not know that it looks at a display, whose pixels move
        # each star by 0.19 px besides: what that does to its sigmas is printed, not asked for.
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
        for axis in range(3):
            row = [f"{case + 1}", f"{axis + 1}", f"{paper.mean[axis]:.1e}", f"{paper.std[axis]:.1e}"]
            for source in SOURCES:
                found = by_setting[Setting(case, source, paper_way)]
                row += ["-", "-"] if found is None else [f"{found.mean[axis]:.1e}", f"{found.std[axis]:.1e}"]
            rows.append(tuple(row))
    columns = ("case", "axis", *(f"{whose} {of}" for whose in ("paper", *SOURCES) for of in ("mean", "std")))
    return TextTable(title, columns, tuple(rows))


def _table_of_runs(profile: UnitProfile, by_setting: dict[Setting, Pooled | None]) -> TextTable:
    """Of how many stars the unit's rates are, and what its sigmas are worth."""
    rows = []
    for setting in MAIN:
        found = by_setting[setting]
        if setting.paper_way or found is None:
            continue
        rows.append(
            (
                f"{setting.case + 1}",
                setting.source,
                f"{found.rates}",
                f"{found.without}",
                f"{found.stars:.1f}",
                f"{found.within_3_sigma:.4f}",
                f"{predicted_sigma_deg_s(profile, found):.1e}",
            )
        )
    columns = ("case", "source", "rates", "without", "stars", "within 3 sigma", "F (14), deg/s")
    return TextTable("rates of the unit: stars kept, errors within 3 of their sigmas", columns, tuple(rows))
