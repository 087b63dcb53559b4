"""Table 3 of Zhang et al. 2014: the identification algorithms with and without a false star.

Stratified by the number of catalogue stars in the field, since the failures are of the fields with three and
four, and there the paper's share of such fields decides: 140 of its 10,000 with three. A circular field of 20
deg has about as many (133), a square one 30. Each stratum gets more cases than its share; the figures are of
the strata weighted by the paper's share of fields with three stars and the sky's shares of the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..firmware_model.catalogue.tables import StarTables
from ..firmware_model.identification.algorithms import ALGORITHMS
from ..firmware_model.identification.interface import IdentificationParameters
from ..report import Check, TextTable, check
from ..world import quaternion
from .campaign import CampaignRequest, CampaignResult
from .confidence import Share, share, stratified_share
from .star_identification import BAD, FAILURE, LABELS, SUCCESS, Attempt, attempts, pair_tolerance_rad
from .star_scenes import MagnitudeNoise, SceneSettings, make_scene, random_attitude, scene_tables
from .table3_plot import draw_table3

FIELD_DEG = 20.0
LIMIT_MAG = 5.0
NOISE_ARCSEC = 5.0
MOST_SPIKES = 10
PAPER_CASES = 10_000
PAPER_SMALL_SHARE = 140 / 10_000  # fields with three stars (and, in the second scenario, a false one)
#: Catalogue stars in the field, first and last of each stratum.
STRATA = ((3, 3), (4, 4), (5, 6), (7, 9), (10, 10_000))
BATCH = 50
_GRID = 100_000  # points of the sphere for the strata's shares
_DRAWN = 64  # boresights at a time in the search for one of a stratum
_ORIENTATION_STREAM = 2


@dataclass(frozen=True)
class Scenario:
    """One of the three of the table. label: a short name. least_stars: true ones in the field."""

    name: str
    label: str
    false_stars: int
    least_stars: int


SCENARIOS = (
    Scenario("no false star", "no false", 0, 3),
    Scenario("1 false star, >= 4 stars", "1 of >= 4", 1, 3),
    Scenario("1 false star, >= 5 stars", "1 of >= 5", 1, 4),
)
NOISES = {
    MagnitudeNoise.NORMAL: "0.2 mag",
    MagnitudeNoise.FLIGHT: "flight",
}
#: Failures, bad matches of 10,000 and milliseconds in the paper, by algorithm, in the order of SCENARIOS.
PAPER: dict[str, tuple[tuple[int, int, float], ...]] = {
    "brightness_referenced": ((18, 0, 0.77), (118, 6, 5.12), (14, 16, 4.78)),
    "pyramid": ((9, 0, 3.93), (0, 75, 10.65), (0, 0, 10.36)),
    "geometric_voting": ((106, 22, 28.87), (175, 38, 43.38), (84, 2, 44.27)),
}
LEAST_RATIO = {"pyramid": 4.0, "geometric_voting": 35.0}


@dataclass(frozen=True)
class Case:
    """An orientation of a stratum in a scenario; ``number`` counts in the stratum."""

    scenario: int
    noise: MagnitudeNoise
    stratum: int
    number: int


def tables_of(resolution_arcsec: float) -> StarTables:
    """Hipparcos stars with Hp < 5.0 as the lens tells them apart, pairs up to the field's diameter."""
    return scene_tables(LIMIT_MAG, FIELD_DEG, resolution_arcsec)


@lru_cache(maxsize=2)
def sky_shares(resolution_arcsec: float) -> tuple[float, ...]:
    """Share of the boresights, even over the sphere (a Fibonacci lattice), in each stratum."""
    number = np.arange(_GRID) + 0.5
    z = 1.0 - 2.0 * number / _GRID
    radius, angle = np.sqrt(1.0 - z * z), np.pi * (1.0 + math.sqrt(5.0)) * number
    boresights = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
    counts = np.concatenate([_stars_around(part, resolution_arcsec) for part in np.split(boresights, 100)])
    return tuple(float(np.mean((counts >= low) & (counts <= high))) for low, high in STRATA)


def _stars_around(boresights: NDArray[np.float64], resolution_arcsec: float) -> NDArray[np.int64]:
    """Catalogue stars in the circular field of each boresight."""
    stars = tables_of(resolution_arcsec).catalogue.unit_vectors
    return np.asarray(np.sum(boresights @ stars.T > np.cos(np.radians(FIELD_DEG / 2)), axis=1))


def weights_of(scenario: Scenario, shares: Sequence[float]) -> list[float]:
    """The strata's weights in a scenario, sum 1: the paper's share of three stars, of the rest the sky's."""
    weights = [
        value if low >= scenario.least_stars else 0.0 for value, (low, _) in zip(shares, STRATA, strict=True)
    ]
    if scenario.least_stars == 3:
        rest = (1.0 - PAPER_SMALL_SHARE) / sum(weights[1:])
        return [PAPER_SMALL_SHARE, *(rest * value for value in weights[1:])]
    return [value / sum(weights) for value in weights]


def cases_of(n: int, weights: Sequence[float]) -> list[int]:
    """``n`` cases over the strata with weight: half of them by weight, half evenly; one at least."""
    used = sum(weight > 0 for weight in weights)
    wanted = [n * (0.5 * weight + 0.5 / used) if weight > 0 else 0.0 for weight in weights]
    given = [max(1, math.floor(item)) if item > 0 else 0 for item in wanted]
    given[-1] += max(0, n - sum(given))
    return given


def orientation(seed: int, stratum: int, number: int, resolution_arcsec: float) -> NDArray[np.float64]:
    """An attitude, uniform over those whose field is of the stratum."""
    rng = np.random.default_rng([seed, stratum, number, _ORIENTATION_STREAM])
    low, high = STRATA[stratum]
    while True:
        attitudes = np.array([random_attitude(rng) for _ in range(_DRAWN)])
        counts = _stars_around(quaternion.attitude_matrix(attitudes)[:, 2], resolution_arcsec)
        found = np.flatnonzero((counts >= low) & (counts <= high))
        if len(found):
            return np.asarray(attitudes[found[0]])


def look(seed: int, resolution_arcsec: float, case: Case) -> tuple[Attempt, ...]:
    """Every algorithm on the scene of a case."""
    scenario = SCENARIOS[case.scenario]
    tables = tables_of(resolution_arcsec)
    settings = SceneSettings(
        FIELD_DEG,
        circular=True,
        noise_arcsec=NOISE_ARCSEC,
        magnitude_noise=case.noise,
        false_stars=scenario.false_stars,
        most_spikes=MOST_SPIKES,
    )
    q = orientation(seed, case.stratum, case.number, resolution_arcsec)
    # the same noise and false star for every scenario that has the orientation
    scene = make_scene(tables.catalogue, settings, seed, case.stratum * 10**9 + case.number, q)
    # Without the four planes of a field: this one is a circle.
    parameters = IdentificationParameters(
        tolerance_rad=pair_tolerance_rad(NOISE_ARCSEC), max_spots=MOST_SPIKES
    )
    return attempts(scene, tables, parameters)


@dataclass(frozen=True)
class Cell:
    """An algorithm in a scenario at a noise: weighted shares, mean operations, milliseconds (medians
    of the strata, which nothing else on the computer disturbs).
    """

    success: Share
    failure: Share
    bad: Share
    bad_cases: int
    operations: float
    time_ms: float
    by_stratum: tuple[dict[str, Any], ...]


def _cell(tried: Sequence[Sequence[Attempt]], weights: Sequence[float]) -> Cell:
    """``tried[stratum]``: the attempts in each stratum."""
    numbers = [len(items) for items in tried]
    counts = {
        verdict: [sum(item.verdict == verdict for item in items) for items in tried]
        for verdict in (SUCCESS, FAILURE, BAD)
    }

    def weighted(values: Sequence[float]) -> float:
        return sum(weight * value for weight, value in zip(weights, values, strict=True) if weight > 0)

    rows = tuple(
        {
            "stars": [low, min(high, 99)],
            "cases": numbers[place],
            "weight": weights[place],
            **{verdict: counts[verdict][place] for verdict in counts},
        }
        for place, (low, high) in enumerate(STRATA)
        if weights[place] > 0
    )
    return Cell(
        stratified_share(counts[SUCCESS], numbers, weights),
        stratified_share(counts[FAILURE], numbers, weights),
        stratified_share(counts[BAD], numbers, weights),
        sum(counts[BAD]),
        weighted([float(np.mean([item.operations for item in items] or [0])) for items in tried]),
        weighted([float(np.median([item.time_ns for item in items] or [0])) / 1e6 for items in tried]),
        rows,
    )


def run(request: CampaignRequest) -> CampaignResult:
    """``n`` orientations in each scenario, at each of the two noises."""
    resolution = round(request.profile.catalogue.resolution_px * request.profile.pixel_arcsec, 1)
    shares = sky_shares(resolution)
    cases: list[Case] = []
    for place, scenario in enumerate(SCENARIOS):
        numbers = cases_of(request.n, weights_of(scenario, shares))
        for noise in NOISES:
            for stratum, number in enumerate(numbers):
                cases += [Case(place, noise, stratum, item) for item in range(number)]
    outcomes = request.workers.map(partial(look, request.seed, resolution), cases, batch=BATCH)
    cells: dict[tuple[str, int, MagnitudeNoise], Cell] = {}
    for order, name in enumerate(ALGORITHMS):
        for place, scenario in enumerate(SCENARIOS):
            for noise in NOISES:
                tried: list[list[Attempt]] = [[] for _ in STRATA]
                for case, outcome in zip(cases, outcomes, strict=True):
                    if case.scenario == place and case.noise is noise:
                        tried[case.stratum].append(outcome[order])
                cells[name, place, noise] = _cell(tried, weights_of(scenario, shares))
    return CampaignResult(
        _figures(cells, resolution, shares),
        _checks(cells),
        _tables(cells),
        {"ms": {_key(*key): cell.time_ms for key, cell in cells.items()}},
        partial(draw_table3, plot_rows(cells)),
    )


def _key(name: str, place: int, noise: MagnitudeNoise) -> str:
    return f"{name} / {SCENARIOS[place].name} / {noise}"


def paper_success(name: str, place: int) -> Share | None:
    """The paper's share of successes with its interval; None where it has no such algorithm."""
    if name not in PAPER:
        return None
    failures, bad, _ = PAPER[name][place]
    return share(PAPER_CASES - failures - bad, PAPER_CASES)


def operations_ratio(
    cells: dict[tuple[str, int, MagnitudeNoise], Cell], name: str, noise: MagnitudeNoise
) -> float:
    """Mean operations without a false star, in units of the brightness-referenced one's."""
    own = cells["brightness_referenced", 0, noise].operations
    return cells[name, 0, noise].operations / own if own > 0 else math.inf


def _checks(cells: dict[tuple[str, int, MagnitudeNoise], Cell]) -> list[Check]:
    checks = []
    for (name, place, noise), cell in cells.items():
        paper = paper_success(name, place)
        if paper is not None:
            words = f"{LABELS.get(name, name)}, {SCENARIOS[place].label}, {noise}"
            checks.append(check(words, cell.success.value, ">=", paper.low, ""))
    bad = sum(cell.bad_cases for (name, _, _), cell in cells.items() if name == "brightness_referenced")
    checks.append(check("bad: brightness", bad, "==", 0, "matches"))
    for noise in NOISES:
        for name, least in LEAST_RATIO.items():
            ratio = operations_ratio(cells, name, noise)
            checks.append(
                check(f"steps: {LABELS.get(name, name)} / brightness, {noise}", ratio, ">=", least, "")
            )
    return checks


def _figures(
    cells: dict[tuple[str, int, MagnitudeNoise], Cell], resolution: float, shares: Sequence[float]
) -> dict[str, Any]:
    rows = []
    for (name, place, noise), cell in cells.items():
        paper = PAPER[name][place] if name in PAPER else None
        rows.append(
            {
                "algorithm": name,
                "scenario": SCENARIOS[place].name,
                "magnitude_noise": str(noise),
                "success": cell.success.__dict__,
                "failure": cell.failure.__dict__,
                "bad": cell.bad.__dict__,
                "bad_cases": cell.bad_cases,
                "operations": cell.operations,
                "paper_failure_bad_ms": paper,
                "by_stars": list(cell.by_stratum),
            }
        )
    return {
        "catalogue_stars": len(tables_of(resolution).catalogue),
        "catalogue_pairs": len(tables_of(resolution).pairs.cos_angle),
        "sky_share_three_stars": shares[0],
        "paper_share_three_stars": PAPER_SMALL_SHARE,
        **{
            f"operations_ratio_{name}": operations_ratio(cells, name, MagnitudeNoise.NORMAL)
            for name in LEAST_RATIO
        },
        "rows": rows,
    }


def _tables(cells: dict[tuple[str, int, MagnitudeNoise], Cell]) -> list[TextTable]:
    columns = ("algorithm", "of", "right %", "95 %", "fail, bad", "steps", "ms")
    tables = []
    for place, scenario in enumerate(SCENARIOS):
        rows: list[tuple[str, ...]] = []
        for name in ALGORITHMS:
            paper = paper_success(name, place)
            first = LABELS.get(name, name)
            if paper is not None:
                failures, bad, ms = PAPER[name][place]
                shares = (f"{100 * paper.value:.2f}", paper.interval())
                rows.append(
                    (first, "paper", *shares, f"{failures / 100:.2f}, {bad / 100:.2f}", "", f"{ms:.2f}")
                )
                first = ""
            for noise, words in NOISES.items():
                cell = cells[name, place, noise]
                rows.append(
                    (
                        first,
                        words,
                        f"{100 * cell.success.value:.2f}",
                        cell.success.interval(),
                        f"{100 * cell.failure.value:.2f}, {100 * cell.bad.value:.2f}",
                        f"{cell.operations:.0f}",
                        f"{cell.time_ms:.2f}",
                    )
                )
                first = ""
        tables.append(TextTable(scenario.name, columns, tuple(rows)))
    return tables


def plot_rows(cells: dict[tuple[str, int, MagnitudeNoise], Cell]) -> list[dict[str, Any]]:
    """What the plot shows: one row for each algorithm, scenario and noise."""
    return [
        {
            "algorithm": name,
            "scenario": SCENARIOS[place].name,
            "noise": NOISES[noise],
            "success": cell.success,
            "operations": cell.operations,
            "paper": paper_success(name, place),
        }
        for (name, place, noise), cell in cells.items()
    ]
