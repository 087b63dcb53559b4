"""Centres of mass against Gaussian interpolation on straight slews, as Zhang et al. 2014 compare them.

Section 3.3 there: 50 successive images of one star of 2.9 mag during a slew across the boresight; the track
should be a line, and the coefficient of determination of a line fitted to it is larger for the centre of
mass.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..firmware_model.image.detection import DetectionParameters, detect
from ..report import TextTable, check
from ..units.profile import UnitProfile
from ..world.scene import RenderedFrame
from ..world.slew import RateAxis, SlewTrajectory
from ..world.truth_record import TrueStar
from .bench import Chain, random_pointings
from .campaign import CampaignRequest, CampaignResult
from .confidence import Z_95, share

FRAMES = 50  # Z figure 1
PAPER_STAR_MAG = 2.9  # Z figure 1
# ASSUMED: the paper prints no rate. At 4 Hz and 71.5 arcsec a pixel these are 0.025 to 0.2 px a frame: 1.2 to
# 12.6 px in all, over which the paths are straight to a few thousandths of a pixel and stars are hardly drawn
# out.
RATES_DEG_S = (0.002, 0.005, 0.01, 0.02)
MATCH_PX = 1.5
ISOLATION_PX = 14.0  # of every star at most NEIGHBOUR_MAG dimmer, all along the track
NEIGHBOUR_MAG = 3.5
EDGE_PX = 10.0
DIM_END_MAG = 0.5  # stars closer to the detection limit than this are not in every frame
BIN_MAG = 0.5
PAPER_BIN_MAG = 0.5  # half-width of the bin about the paper's star
FEWEST_TRACKS = 5

FloatArray = NDArray[np.float64]


# The paper's two, and between them the unit's: "gaussian" in a unit file sums its columns over three rows,
# "two_pixels" takes one pixel of each, as the paper's section 3.3 says.
METHODS: dict[str, dict[str, Any]] = {
    "com": {"centroid": "com"},
    "gaussian": {"centroid": "gaussian"},
    "two_pixels": {"centroid": "gaussian", "interpolation_half_height_px": 0},
}


@dataclass(frozen=True)
class Track:
    """One star through one slew: coefficients of determination of the straight line, and the r.m.s. of what
    the line leaves, px per axis, in the order of METHODS. path_rms_px: the same of the true path.
    """

    hip: int
    magnitude: float
    rate_deg_s: float
    r2: tuple[float, ...]
    rms_px: tuple[float, ...]
    path_rms_px: float


def straight_line(places: FloatArray) -> tuple[float, float]:
    """(R^2, r.m.s. of the residuals per axis) of places[n, 2] at equal steps as a straight line in time.

    Both axes together: R^2 = 1 - sum |residual|^2 / sum |place - mean|^2. ASSUMED: not the distance from the
    sensor's origin that the paper fits, which is no straight line for a star that passes it on one side.
    """
    time = np.arange(len(places)) - (len(places) - 1) / 2
    about_mean = places - places.mean(axis=0)
    slope = time @ about_mean / (time @ time)
    left = float(np.square(about_mean - np.outer(time, slope)).sum())
    return 1.0 - left / float(np.square(about_mean).sum()), math.sqrt(left / (2 * (len(places) - 2)))


def _isolated(stars: tuple[TrueStar, ...], dimmest: float, columns: int, rows: int) -> list[TrueStar]:
    place = np.array([(star.x_px, star.y_px, star.hp_mag) for star in stars]).reshape(-1, 3)
    kept = []
    for star in stars:
        if star.hp_mag >= dimmest:
            break  # brightest first
        if not (EDGE_PX < star.x_px < columns - 1 - EDGE_PX and EDGE_PX < star.y_px < rows - 1 - EDGE_PX):
            continue
        distance = np.hypot(place[:, 0] - star.x_px, place[:, 1] - star.y_px)
        if np.sum((distance < ISOLATION_PX) & (place[:, 2] < star.hp_mag + NEIGHBOUR_MAG)) == 1:
            kept.append(star)
    return kept


def _places(
    frame: RenderedFrame, detection: DetectionParameters, true: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """The spot nearest to each true place (nan without one within MATCH_PX), and which are saturated."""
    spots, _ = detect(frame.full(), detection)
    found = np.full((len(true), 2), np.nan)
    saturated = np.zeros(len(true), np.bool_)
    for row, (x, y) in enumerate(true):
        distance = np.hypot(spots.x_px - x, spots.y_px - y)
        if len(distance) and distance[nearest := int(np.argmin(distance))] < MATCH_PX:
            found[row] = spots.x_px[nearest], spots.y_px[nearest]
            saturated[row] = spots.saturated[nearest]
    return found, saturated


def slew(profile: UnitProfile, seed: int, n: int, index: int) -> list[Track]:
    """The tracks of all isolated stars through one slew across the boresight at a random pointing."""
    rng = np.random.default_rng([seed, index, 0x51E3])
    direction = rng.uniform(0.0, 2.0 * math.pi)
    rate = RATES_DEG_S[index % len(RATES_DEG_S)]
    axis = (rate * math.cos(direction), rate * math.sin(direction), 0.0)
    chain = Chain.of(profile, seed)
    duration_s = (FRAMES + 1) * profile.timing.frame_period_ms / 1000
    chain.look(SlewTrajectory(random_pointings(n, seed)[index], [RateAxis(axis, duration_s, 0.0)]))
    dimmest = profile.detection.magnitude_limit - DIM_END_MAG
    by_method = {
        name: dataclasses.replace(chain.configuration.detection, **changes)
        for name, changes in METHODS.items()
    }
    chosen: list[TrueStar] = []
    true: list[FloatArray] = []
    found: dict[str, list[FloatArray]] = {name: [] for name in by_method}
    usable = np.zeros(0, np.bool_)
    for number in range(FRAMES):
        # other noise and other pixels for each slew: the frame's number is that of no other slew's
        frame = chain.scene.frame(
            index * FRAMES + number, number * profile.frame_period_ns, chain.configuration.exposure_ns
        )
        if number == 0:
            deep = chain.scene.truth(frame, dimmest + NEIGHBOUR_MAG).stars
            chosen = _isolated(deep, dimmest, profile.detector.columns, profile.detector.rows)
            usable = np.ones(len(chosen), np.bool_)
        now = {star.hip: (star.x_px, star.y_px) for star in chain.scene.truth(frame, dimmest).stars}
        true.append(
            np.array([now.get(star.hip, (np.nan, np.nan)) for star in chosen], np.float64).reshape(-1, 2)
        )
        for name, detection in by_method.items():
            places, saturated = _places(frame, detection, true[-1])
            found[name].append(places)
            usable &= ~saturated
    paths = np.array(true)
    tracks = {name: np.array(places) for name, places in found.items()}
    result = []
    for row, star in enumerate(chosen):
        if not usable[row] or not all(np.isfinite(track[:, row]).all() for track in tracks.values()):
            continue
        lines = [straight_line(track[:, row]) for track in tracks.values()]
        _, path_rms = straight_line(paths[:, row])
        r2, rms_px = zip(*lines, strict=True)
        result.append(Track(star.hip, star.hp_mag, rate, r2, rms_px, path_rms))
    return result


def summary(tracks: list[Track]) -> dict[str, Any]:
    """All methods on some tracks, and each beside the centre of mass: the geometric mean of the ratios of the
    tracks' residuals (over 1: the centre of mass is the better one) and the share of the tracks to which it
    fits the better line, both with 95 % intervals.
    """
    figures: dict[str, Any] = {"tracks": len(tracks)}
    for place, name in enumerate(METHODS):
        rms = [track.rms_px[place] for track in tracks]
        figures[f"r2_{name}_median"] = float(np.median([track.r2[place] for track in tracks]))
        figures[f"rms_{name}_px"] = math.sqrt(float(np.mean(np.square(rms))))
        if name == "com":
            continue
        logs = np.log([track.rms_px[place] / track.rms_px[0] for track in tracks])
        middle, half = float(logs.mean()), Z_95 * float(logs.std(ddof=1)) / math.sqrt(len(logs))
        better = share(sum(track.r2[0] > track.r2[place] for track in tracks), len(tracks))
        figures[f"{name}_to_com"] = math.exp(middle)
        figures[f"{name}_to_com_interval"] = [math.exp(middle - half), math.exp(middle + half)]
        figures[f"com_better_than_{name}"] = better.value
        figures[f"com_better_than_{name}_interval"] = [better.low, better.high]
    return figures


def crossing_mag(rows: list[dict[str, Any]], name: str) -> float | None:
    """The magnitude at which a method and the centre of mass leave the same residuals, between two bins; None
    where no two bins are on its two sides.
    """
    for brighter, dimmer in itertools.pairwise(rows):
        high, low = math.log(brighter[f"{name}_to_com"]), math.log(dimmer[f"{name}_to_com"])
        if high >= 0.0 > low:
            first, second = (sum(row["magnitudes"]) / 2 for row in (brighter, dimmer))
            return float(first + (second - first) * high / (high - low))
    return None


def run(request: CampaignRequest) -> CampaignResult:
    """``n`` slews of 50 frames, rates in turn; tracks by magnitude and by rate."""
    outcomes = request.workers.map(partial(slew, request.profile, request.seed, request.n), range(request.n))
    tracks = [track for outcome in outcomes for track in outcome]
    by_magnitude = []
    for low in np.arange(1.5, request.profile.detection.magnitude_limit, BIN_MAG):
        some = [track for track in tracks if low <= track.magnitude < low + BIN_MAG]
        if len(some) >= FEWEST_TRACKS:
            by_magnitude.append({"magnitudes": [float(low), float(low + BIN_MAG)]} | summary(some))
    by_rate = []
    near = [track for track in tracks if abs(track.magnitude - PAPER_STAR_MAG) <= PAPER_BIN_MAG]
    for rate in RATES_DEG_S:
        some = [track for track in near if track.rate_deg_s == rate]
        if len(some) >= FEWEST_TRACKS:
            by_rate.append({"rate_deg_s": rate} | summary(some))
    paper_star = summary(near) if len(near) >= FEWEST_TRACKS else {}
    better = paper_star.get("com_better_than_two_pixels")
    figures = {
        "tracks": len(tracks),
        "true_path_rms_px_worst": max((track.path_rms_px for track in tracks), default=None),
        "com_better_than_two_pixels_near_2.9_mag": better,
        "com_better_than_gaussian_near_2.9_mag": paper_star.get("com_better_than_gaussian"),
        "two_pixels_equal_com_at_mag": crossing_mag(by_magnitude, "two_pixels"),
        "gaussian_equals_com_at_mag": crossing_mag(by_magnitude, "gaussian"),
        "paper": "COM has the larger coefficient of determination (one star of 2.9 mag, 50 images)",
        "near_paper_star": paper_star,
        "near_paper_star_by_rate": by_rate,
        "by_magnitude": by_magnitude,
    }
    return CampaignResult(
        figures,
        [check("com_better_than_two_pixels_near_2.9_mag", better, ">=", 0.5, "")],
        tables=_tables(by_magnitude, by_rate, paper_star),
        draw=partial(_draw, by_magnitude),
    )


def _interval(row: dict[str, Any], name: str, percent: bool = False) -> str:
    """A figure with its interval."""
    values = (row[name], *row[f"{name}_interval"])
    return "{} ({}-{})".format(*(f"{100 * v:.0f}" if percent else f"{v:.2f}" for v in values))


def _tables(
    by_magnitude: list[dict[str, Any]], by_rate: list[dict[str, Any]], paper_star: dict[str, Any]
) -> list[TextTable]:
    """Ours, with 95 % intervals, beside what the paper says."""
    rows = [("{:.1f}-{:.1f}".format(*row["magnitudes"]), row) for row in by_magnitude]
    if paper_star:
        rows.append((f"{PAPER_STAR_MAG}+-{PAPER_BIN_MAG}", paper_star))
    rows += [(f"  {row['rate_deg_s']} deg/s", row) for row in by_rate]
    others = [name for name in METHODS if name != "com"]
    heads = ["COM", "Gaussian", "2 pixels"]
    return [
        TextTable(
            "R2 of straight lines through 50 places; tracks, %, to which COM has the larger one",
            ("Hp, mag", "tracks", *heads, "> Gaussian", "> 2 pixels"),
            (
                *(
                    (
                        head,
                        str(row["tracks"]),
                        *(f"{row[f'r2_{name}_median']:.6f}" for name in METHODS),
                        *(_interval(row, f"com_better_than_{name}", True) for name in others),
                    )
                    for head, row in rows
                ),
                ("paper 2.9", "1", "larger", "", "smaller", "", "yes"),
            ),
        ),
        TextTable(
            "Residuals, 0.001 px an axis, r.m.s., and beside those of COM",
            ("Hp, mag", *heads, *(f"{name} / COM" for name in heads[1:])),
            tuple(
                (
                    head,
                    *(f"{1000 * row[f'rms_{name}_px']:.1f}" for name in METHODS),
                    *(_interval(row, f"{name}_to_com") for name in others),
                )
                for head, row in rows
            ),
        ),
    ]


def _draw(by_magnitude: list[dict[str, Any]], figure: Any) -> None:
    """Residuals by magnitude, and each method's beside those of the centre of mass."""
    from .plotting import COLOURS, SOURCE_COLOUR  # the workers draw nothing

    left, right = figure.subplots(1, 2)
    middle = [sum(row["magnitudes"]) / 2 for row in by_magnitude]
    labels = {
        "com": "centre of mass, Z (1)-(3)",
        "gaussian": "Gaussian interpolation, columns of 3 px",
        "two_pixels": "Gaussian interpolation, two pixels, as Z",
    }
    for (name, label), colour in zip(labels.items(), COLOURS, strict=False):
        left.semilogy(
            middle, [row[f"rms_{name}_px"] for row in by_magnitude], "o-", color=colour, label=label
        )
        if name == "com":
            continue
        ratio = np.array([row[f"{name}_to_com"] for row in by_magnitude])
        bounds = np.array([row[f"{name}_to_com_interval"] for row in by_magnitude]).reshape(-1, 2)
        spread = [ratio - bounds[:, 0], bounds[:, 1] - ratio]
        right.errorbar(middle, ratio, yerr=spread, fmt="o-", capsize=3, color=colour, label=label)
    left.set_ylabel("residuals of the straight line, px an axis, r.m.s.")
    right.set_ylabel("residuals beside those of the centre of mass (95 %)")
    right.axhline(1.0, color=COLOURS[0], linestyle=":")
    for axes in (left, right):
        axes.set_xlabel("Hp, mag")
        axes.axvline(PAPER_STAR_MAG, color=SOURCE_COLOUR, linestyle="--", linewidth=1)
    right.annotate(
        "the paper's star:\nCOM the better one",
        (PAPER_STAR_MAG, 0.97),
        xycoords=("data", "axes fraction"),
        xytext=(6, 0),
        textcoords="offset points",
        va="top",
        color=SOURCE_COLOUR,
    )
    left.legend(loc="upper left")
    figure.suptitle("Centroid tracks on straight slews, 50 frames each")
