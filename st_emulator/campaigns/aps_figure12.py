"""Figure 12 of the multi-poles paper ("M", Schiattarella, Spiller and Curti 2020): the faintest magnitude
that is detected, over the rate and its angle beta from the boresight; by M's model (24) to (30) and by
simulation.

The model: a star at alpha from the axis leaves a trace of l = omega dt sin(alpha), over r_psf l / IFOV pixels
(26), which get I0 = IFOV G0 / (r_psf sin(alpha) omega) electrons each of magnitude 0 (28); it is detected
when they get tau_pre. The simulation: images of a made-up sky with stars of all magnitudes, rendered, and
detected with the unit's firmware; each star is held to the model's magnitude at its own alpha. And as M shows
it: the faintest star of the real sky that is detected in an image, beside the model at
alpha = beta - FOV / 2.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bench.world_of import camera_model
from ..compiled_kernels import keep_compiled_kernels
from ..device.calibration import firmware_configuration
from ..device.parameters import default_parameters
from ..firmware_model.image.detection import DetectionParameters, detect
from ..report import Check, TextTable, check
from ..units.profile import UnitProfile
from ..world import quaternion
from ..world.camera import CameraModel
from ..world.scene import RenderedFrame, SceneRenderer
from ..world.stars import StarField, star_field
from ..world.time_scales import julian_year
from ..world.trajectory import ConstantRateTrajectory, Trajectory
from .aps_runs import SIMULATED_MAG, attitude_of
from .bench import start_tai_ns
from .campaign import CampaignRequest, CampaignResult
from .confidence import Z_95

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

R_PSF = 3.0  # M section 6.1
MOST_MAG = 6.0  # M section 6.1: the model diverges at rest, so that it is shown up to here
BETAS_DEG = (15, 30, 45, 60, 90)  # ASSUMED: those of the figure are not printed
RATES_DEG_S = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0)
WINDOW_MAG = (-1.0, 2.5)  # about the model's magnitude, in which stars are counted
BRIGHTEST_MAG, FAINTEST_MAG = 2.0, MOST_MAG + WINDOW_MAG[1]
SKY_STARS = 8000  # 78 in a field of 20 x 20 deg
EDGE_PX = 48.0  # a trace of 5 deg/s that is whole in the image
ACROSS_PX = 3.0
LEAST_STARS = 30  # of a cell that is judged
NO_LIMIT_MAG = 99.0
WITHOUT_NOISE_MAG = 0.15  # how near the model with the unit's own point spread has to be, without noise
MOST_GAIN_MAG = 1.0  # by which noise may lift fainter stars over the threshold
CONSTANT_WITHIN_MAG = 0.25  # how far a cell may be from the mean of all: the law of the rate holds
GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class Cell:
    """beta_deg: of the axis from the boresight; rate_deg_s; number of the image."""

    beta_deg: float
    rate_deg_s: float
    number: int


@dataclass(frozen=True)
class Counted:
    """Stars within WINDOW_MAG of the model, in five parts of it from bright to faint; detected of these."""

    stars: NDArray[np.int64]
    detected: NDArray[np.int64]

    @classmethod
    def of(cls, excess_mag: Array, detected: Bools) -> Counted:
        """excess_mag: magnitudes of the stars less those that the model gives, float64[n]."""
        counts = [
            np.histogram(chosen, bins=5, range=WINDOW_MAG)[0].astype(np.int64)
            for chosen in (excess_mag, excess_mag[detected])
        ]
        return cls(*counts)


@dataclass(frozen=True)
class Look:
    """One image: of the made-up sky with the unit's noise and without any, and the faintest star of the real
    sky that is detected (nan: none)."""

    noisy: Counted
    quiet: Counted
    faintest_mag: float


def model_mag(profile: UnitProfile, rate_deg_s: float, alpha_rad: Array, r_psf: float = R_PSF) -> Array:
    """M (28) and (30): the magnitude at which a pixel of the trace gets tau_pre, float64[n].

    inf at alpha 0 or at rest.
    """
    ifov = 1.0 / profile.focal_px
    with np.errstate(divide="ignore"):
        i0 = ifov * profile.electrons_per_s_mag0 / (r_psf * np.sin(alpha_rad) * math.radians(rate_deg_s))
        return np.asarray(2.5 * np.log10(i0 / profile.detection.tau_pre_electrons))


def own_r_psf(psf_sigma_px: float) -> float:
    """r_psf with which (28) gives the light of the brightest pixels of a trace with this point spread: their
    share of the trace's light per pixel of its length is 1 / r_psf."""
    return 1.0 / math.erf(0.5 / (math.sqrt(2.0) * psf_sigma_px))


def made_up_sky(seed: int) -> StarField:
    """Stars evenly over the sphere and over the magnitudes from BRIGHTEST_MAG to FAINTEST_MAG."""
    rng = np.random.default_rng([seed, 12])
    vectors = rng.normal(size=(SKY_STARS, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    return StarField(
        np.arange(1, SKY_STARS + 1, dtype=np.int32),
        vectors,
        rng.uniform(BRIGHTEST_MAG, FAINTEST_MAG, SKY_STARS).astype(np.float32),
        np.zeros(SKY_STARS, dtype=np.float32),
        2000.0,
    )


class Bench:
    """The unit before three skies."""

    def __init__(self, profile_json: str, seed: int) -> None:
        keep_compiled_kernels()
        self.profile = UnitProfile.model_validate_json(profile_json)
        camera = camera_model(self.profile)
        still = dataclasses.replace(
            camera, read_noise_electrons=0.0, dark_electrons_s=0.0, stray_electrons_s=0.0
        )
        made_up, real = made_up_sky(seed), star_field(julian_year(start_tai_ns()), SIMULATED_MAG)
        self.noisy = _renderer(camera, made_up, seed)
        self.quiet = _renderer(still, made_up, seed)
        self.real = _renderer(camera, real, seed)
        configuration = firmware_configuration(self.profile, default_parameters(self.profile))
        self.detection: DetectionParameters = configuration.detection
        # What the noise alone allows, not the limit of magnitude.
        self.ungated = dataclasses.replace(self.detection, magnitude_limit=NO_LIMIT_MAG)


def _renderer(camera: CameraModel, stars: StarField, seed: int) -> SceneRenderer:
    still = ConstantRateTrajectory(np.array([0.0, 0.0, 0.0, 1.0]))
    return SceneRenderer(
        camera, stars, still, seed=seed, start_tai_ns=start_tai_ns(), aberration=False, quick_light=True
    )


@lru_cache(maxsize=2)
def _bench(profile_json: str, seed: int) -> Bench:
    return Bench(profile_json, seed)


@dataclass(frozen=True)
class Traces:
    """Where the stars of a sky are in a frame: magnitude, angle from the axis (rad), place at the frame's
    time, direction of the motion (unit vectors) and length of the trace, px; [n] or [n, 2]."""

    hp_mag: Array
    alpha_rad: Array
    place_px: Array
    along: Array
    length_px: Array

    @classmethod
    def of(cls, scene: SceneRenderer, frame: RenderedFrame, axis: Array) -> Traces:
        """Of all stars within the image. ``axis``: of the turn, sensor frame."""
        half_ns = frame.exposure_ns // 2
        start, middle, end = (
            _places(scene, scene.trajectory, frame.exposure_mid_ns + late) for late in (-half_ns, 0, half_ns)
        )
        inside = np.all(np.abs(middle - _middle_px(scene.camera)) < _half_px(scene.camera) - EDGE_PX, axis=1)
        chosen = np.flatnonzero(inside)
        moved = end[chosen] - start[chosen]
        length = np.linalg.norm(moved, axis=1)
        attitude = quaternion.attitude_matrix(scene.trajectory.q_icrs_to_sensor(frame.exposure_mid_ns))
        cosine = scene.stars.unit_vectors[chosen] @ attitude.T @ axis
        return cls(
            scene.stars.hp_mag[chosen].astype(np.float64),
            np.arccos(np.clip(np.abs(cosine), 0.0, 1.0)),
            middle[chosen],
            moved / np.maximum(length, 1e-9)[:, np.newaxis],
            length,
        )

    def detected(self, frame: RenderedFrame, detection: DetectionParameters, row_time_s: float) -> Bools:
        """Whether a spot lies on the star's trace, bool[n]."""
        spots, _ = detect(frame.full(), detection)
        if not len(spots):
            return np.zeros(len(self.hp_mag), dtype=bool)
        # where each trace's middle lies in the rows that are exposed then
        speed = self.along * (self.length_px / (frame.exposure_ns * 1e-9))[:, np.newaxis]
        rows_late = row_time_s * (self.place_px[:, 1] - 0.5 * (frame.height_px - 1))
        centre = self.place_px + speed * (rows_late / (1.0 - speed[:, 1] * row_time_s))[:, np.newaxis]
        off = np.stack([spots.x_px, spots.y_px], axis=1)[np.newaxis] - centre[:, np.newaxis]
        along = np.abs(np.einsum("nsk,nk->ns", off, self.along))
        across = np.abs(off[:, :, 0] * self.along[:, 1:] - off[:, :, 1] * self.along[:, :1])
        reach = 0.5 * self.length_px * 1.1 + ACROSS_PX  # a star along with the rows is lit the longer
        return np.asarray(((along <= reach[:, np.newaxis]) & (across <= ACROSS_PX)).any(axis=1))

    def alone(self) -> Bools:
        """Whether no brighter star is so near that its trace may be taken for this one's, bool[n]."""
        off = self.place_px[:, np.newaxis] - self.place_px[np.newaxis]
        along = np.abs(np.einsum("nsk,nk->ns", off, self.along))
        across = np.abs(off[:, :, 0] * self.along[:, 1:] - off[:, :, 1] * self.along[:, :1])
        near = (along < 1.2 * self.length_px[:, np.newaxis] + 4 * ACROSS_PX) & (across < 4 * ACROSS_PX)
        return np.asarray(~(near & (self.hp_mag[np.newaxis] < self.hp_mag[:, np.newaxis])).any(axis=1))


def _places(scene: SceneRenderer, trajectory: Trajectory, t_ns: int) -> Array:
    """Places of all stars, px; nan behind the camera."""
    attitude = quaternion.attitude_matrix(trajectory.q_icrs_to_sensor(t_ns))
    x, y, ahead = scene.camera.project(scene.stars.unit_vectors @ attitude.T)
    return np.where(np.asarray(ahead)[:, np.newaxis], np.stack([x, y], axis=1), np.nan)


def _middle_px(camera: CameraModel) -> Array:
    return 0.5 * (np.array([camera.width_px, camera.height_px]) - 1.0)


def _half_px(camera: CameraModel) -> Array:
    return 0.5 * np.array([camera.width_px, camera.height_px])


def look(profile_json: str, seed: int, n: int, cell: Cell) -> Look:
    """The images of one case."""
    bench = _bench(profile_json, seed)
    beta, around = math.radians(cell.beta_deg), 2.0 * math.pi * (cell.number * GOLDEN % 1.0)
    axis = np.array([math.sin(beta) * math.cos(around), math.sin(beta) * math.sin(around), math.cos(beta)])
    rate = math.radians(cell.rate_deg_s) * axis
    trajectory = ConstantRateTrajectory(attitude_of(cell.number, n), rate)
    rng = np.random.default_rng([seed, cell.number, round(10 * cell.rate_deg_s)])
    index = int(rng.integers(2**31))
    counted = []
    for scene in (bench.noisy, bench.quiet):
        scene.trajectory = trajectory
        frame = scene.frame(index, 0)
        traces = Traces.of(scene, frame, axis)
        excess = traces.hp_mag - model_mag(bench.profile, cell.rate_deg_s, traces.alpha_rad)
        # the model is of traces: longer than they are wide
        fit = traces.alone() & (traces.length_px >= R_PSF) & (traces.hp_mag - excess <= MOST_MAG)
        seen = traces.detected(frame, bench.ungated, scene.camera.row_time_s)
        counted.append(Counted.of(excess[fit], seen[fit]))
    bench.real.trajectory = trajectory
    frame = bench.real.frame(index, 0)
    traces = Traces.of(bench.real, frame, axis)
    seen = traces.detected(frame, bench.detection, bench.real.camera.row_time_s) & traces.alone()
    faintest = float(traces.hp_mag[seen].max()) if seen.any() else math.nan
    return Look(counted[0], counted[1], faintest)


@dataclass(frozen=True)
class Limit:
    """The magnitude at which half are detected, less the model's; half of its 95 % interval; stars; shares
    detected of the brightest and of the faintest fifth."""

    excess_mag: float
    half: float
    stars: int
    bright: float
    faint: float

    @classmethod
    def of(cls, looks: list[Counted]) -> Limit | None:
        """Spearman and Karber: with magnitudes spread evenly the limit is where the share detected, taken as
        a length, ends. None of too few stars."""
        stars, seen = (
            np.sum([getattr(item, name) for item in looks], axis=0) for name in ("stars", "detected")
        )
        if stars.sum() < LEAST_STARS or (stars == 0).any():
            return None
        step = (WINDOW_MAG[1] - WINDOW_MAG[0]) / len(stars)
        share = seen / stars
        variance = float(np.sum(share * (1.0 - share) / stars))
        return cls(
            WINDOW_MAG[0] + step * float(share.sum()),
            Z_95 * step * math.sqrt(variance),
            int(stars.sum()),
            float(share[0]),
            float(share[-1]),
        )


def run(request: CampaignRequest) -> CampaignResult:
    """``n`` images of each beta and rate."""
    profile = request.profile
    cells = [
        Cell(float(beta), rate, number)
        for beta in BETAS_DEG
        for rate in RATES_DEG_S
        for number in range(request.n)
    ]
    looks = request.workers.map(
        partial(look, profile.model_dump_json(), request.seed, request.n), cells, batch=4
    )
    by_cell: dict[tuple[float, float], list[Look]] = {}
    for cell, item in zip(cells, looks, strict=True):
        by_cell.setdefault((cell.beta_deg, cell.rate_deg_s), []).append(item)
    own = 2.5 * math.log10(R_PSF / own_r_psf(profile.optics.psf_sigma_px))
    rows = [_row(profile, beta, rate, items) for (beta, rate), items in by_cell.items()]
    figures = {"r_psf": R_PSF, "own_r_psf": own_r_psf(profile.optics.psf_sigma_px), "own_mag": own}
    return CampaignResult(
        {**figures, "rows": rows},
        _checks(rows, own),
        [_table(rows), TextTable("what differs from M, and why", ("of", "why"), _differences(rows, own))],
        draw=partial(_draw, rows),
    )


def _row(profile: UnitProfile, beta: float, rate: float, items: list[Look]) -> dict[str, Any]:
    middle = float(model_mag(profile, rate, np.array([math.radians(beta)]))[0])
    nearest = math.radians(max(beta - 0.5 * profile.field_deg[0], 0.0))
    best = float(model_mag(profile, rate, np.array([nearest]))[0])
    faintest = [item.faintest_mag for item in items if not math.isnan(item.faintest_mag)]
    noisy, quiet = Limit.of([item.noisy for item in items]), Limit.of([item.quiet for item in items])
    return {
        "beta_deg": beta,
        "rate_deg_s": rate,
        "model_mag": middle,
        "noisy": None if noisy is None else vars(noisy),
        "quiet": None if quiet is None else vars(quiet),
        "model_nearest_mag": min(best, MOST_MAG),
        "faintest_mag": float(np.mean(faintest)) if faintest else None,
        "images": len(items),
    }


def _excesses(rows: list[dict[str, Any]], name: str) -> Array:
    return np.array([row[name]["excess_mag"] for row in rows if row[name] is not None])


def _checks(rows: list[dict[str, Any]], own: float) -> list[Check]:
    noisy, quiet = _excesses(rows, "noisy"), _excesses(rows, "quiet")
    if not len(noisy) or not len(quiet):
        return [check("cells with enough stars", 0, ">=", 1, "")]
    judged = [row[name] for row in rows for name in ("noisy", "quiet") if row[name] is not None]
    spread = max(
        max(abs(item["excess_mag"] - mean) - item["half"], 0.0)
        for name, mean in (("noisy", noisy.mean()), ("quiet", quiet.mean()))
        for item in (row[name] for row in rows)
        if item is not None
    )
    gain = float(noisy.mean() - quiet.mean())
    off = abs(float(quiet.mean()) - own)
    bright, faint = (float(np.mean([item[name] for item in judged])) for name in ("bright", "faint"))
    return [
        check("without noise: off the unit's own point spread by", off, "<=", WITHOUT_NOISE_MAG, "mag"),
        check("with noise: no brighter than without", gain, ">=", 0.0, "mag"),
        check("with noise: fainter than without by", gain, "<=", MOST_GAIN_MAG, "mag"),
        check("law of rate and angle: a cell is off the mean by", spread, "<=", CONSTANT_WITHIN_MAG, "mag"),
        check("brightest fifth detected", bright, ">=", 0.97, ""),
        check("faintest fifth detected", faint, "<=", 0.05, ""),
    ]


def _table(rows: list[dict[str, Any]]) -> TextTable:
    def limit(row: dict[str, Any], name: str) -> str:
        item = row[name]
        if item is None:
            return "-"
        return (
            f"{row['model_mag'] + item['excess_mag']:.2f} ({item['excess_mag']:+.2f} +- {item['half']:.2f})"
        )

    heads = (
        "beta, deg", "deg/s", "model, alpha = beta", "half detected, no noise", "half detected", "stars",
        "model, alpha = beta - FOV/2, <= 6", "faintest of the real sky",
    )  # fmt: skip
    return TextTable(
        "figure 12: detectable magnitude (in brackets: less the model)",
        heads,
        tuple(
            (
                f"{row['beta_deg']:g}",
                f"{row['rate_deg_s']:g}",
                f"{row['model_mag']:.2f}",
                limit(row, "quiet"),
                limit(row, "noisy"),
                "-" if row["noisy"] is None else f"{row['noisy']['stars']}",
                f"{row['model_nearest_mag']:.2f}",
                "-" if row["faintest_mag"] is None else f"{row['faintest_mag']:.2f}",
            )
            for row in rows
        ),
    )


def _differences(rows: list[dict[str, Any]], own: float) -> tuple[tuple[str, str], ...]:
    noisy, quiet = _excesses(rows, "noisy"), _excesses(rows, "quiet")
    if not len(noisy) or not len(quiet):
        return ()
    return (
        (
            "without noise",
            f"{quiet.mean():+.2f} mag: r_psf = 3 spreads a trace evenly over 3 px; the brightest pixels of "
            f"the unit's point spread get more, which is worth {own:+.2f} mag",
        ),
        (
            "with noise",
            f"another {noisy.mean() - quiet.mean():+.2f} mag: of the many pixels of a trace under the "
            "threshold noise lifts two neighbours over it, and two make a cluster; M notes the same",
        ),
        (
            "slow cells",
            "less than fast ones: the ends of a trace of a few pixels are round, and the model takes none",
        ),
        (
            "faintest of the real sky",
            f"one image's faintest is of few stars, so that it scatters; none is over {SIMULATED_MAG:g} mag, "
            "the faintest simulated",
        ),
    )


def _draw(rows: list[dict[str, Any]], figure: Any) -> None:
    from .plotting import COLOURS, SOURCE_COLOUR

    colours = (*COLOURS, SOURCE_COLOUR)
    left, right = figure.subplots(1, 2, sharey=True)
    for order, beta in enumerate(BETAS_DEG):
        chosen = [row for row in rows if row["beta_deg"] == beta]
        rates = [row["rate_deg_s"] for row in chosen]
        left.plot(rates, [row["model_mag"] for row in chosen], color=colours[order], label=f"beta {beta} deg")
        for name, mark in (("quiet", "x"), ("noisy", "o")):
            found = [row for row in chosen if row[name] is not None]
            left.errorbar(
                [row["rate_deg_s"] for row in found],
                [row["model_mag"] + row[name]["excess_mag"] for row in found],
                yerr=[row[name]["half"] for row in found],
                color=colours[order],
                marker=mark,
                markersize=5,
                capsize=3,
                linestyle="",
            )
        right.plot(rates, [row["model_nearest_mag"] for row in chosen], color=colours[order])
        found = [row for row in chosen if row["faintest_mag"] is not None]
        right.plot(
            [row["rate_deg_s"] for row in found],
            [row["faintest_mag"] for row in found],
            "o",
            color=colours[order],
            markersize=5,
            label=f"beta {beta} deg",
        )
    left.set_title("lines: M's model, alpha = beta; half detected: o, without noise: x")
    right.set_title("as M: model at alpha = beta - FOV / 2; o: faintest of the real sky")
    for axes in (left, right):
        axes.set_xlabel("deg/s")
        axes.grid(alpha=0.4)
        axes.legend(fontsize=8)
    left.set_ylabel("magnitude")
    figure.suptitle("Detectable magnitude over the rate (figure 12 of Schiattarella et al. 2020)")
