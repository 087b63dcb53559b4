"""Tables 3 to 13 of the multi-poles paper (Schiattarella, Spiller and Curti 2020, "M"), beside ours.

Every figure of ours has its 95 % interval, from how the attitudes differ: the 26 directions of one attitude
share its part of the sky, rich or poor, and so do the stars of an image.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from ..report import Check, TextTable, check
from .aps_centroid_tables import RUNS_OF, centroid_tables
from .aps_paper import (
    ATTITUDES,
    IMAGES,
    RATES_DEG_S,
    RUNS_A_RATE,
    RUNS_AT_REST,
    SUCCESS,
    TABLE_OF_ATTITUDES,
    TABLE_OF_SUCCESS,
)
from .aps_plot import draw_aps
from .aps_runs import DIRECTIONS, Case, Run, run_case
from .campaign import CampaignRequest, CampaignResult
from .confidence import Share, clustered_share, wilson
from .spreads import Moments, Spread

BATCH = 8  # cases
AXES = ("roll", "pitch", "yaw")
SHUTTERS = ("rolling", "global")
DIRECTION_NUMBERS = tuple(range(len(DIRECTIONS)))

DIFFERENCES = ()


def cases_of(attitudes: int, worst: tuple[bool, ...]) -> list[Case]:
    """All runs of both shutters: at rest one an attitude, at each rate one an attitude and direction."""
    cases = []
    for shutter in SHUTTERS:
        for one in worst:
            for rate in RATES_DEG_S:
                directions = DIRECTION_NUMBERS if rate else DIRECTION_NUMBERS[:1]
                cases += [
                    Case(shutter, one, rate, attitude, direction)
                    for attitude in range(attitudes)
                    for direction in directions
                ]
    return cases


def run(request: CampaignRequest, worst: tuple[bool, ...] = (False, True)) -> CampaignResult:
    """``n`` attitudes (M: 200), 26 directions at 1 to 5 deg/s, both shutters."""
    cases = cases_of(request.n, worst)
    runs = request.workers.map(
        partial(run_case, request.profile.model_dump_json(), request.seed, request.n), cases, batch=BATCH
    )
    by_key: dict[tuple[str, bool, int], list[tuple[Case, Run]]] = {}
    for case, outcome in zip(cases, runs, strict=True):
        by_key.setdefault((case.shutter, case.worst, case.rate_deg_s), []).append((case, outcome))
    tables: list[TextTable] = []
    checks: list[Check] = []
    figures: dict[str, Any] = {"runs": len(cases), "wrong": sum(item.wrong for item in runs)}
    checks.append(check("wrong attitudes", figures["wrong"], "==", 0, ""))
    if False in worst:
        centroid_tables(by_key, request.profile, tables, checks, figures)
    for one in worst:
        for shutter in reversed(SHUTTERS):
            _attitudes((shutter, one), by_key, tables, checks, figures)
            _success((shutter, one), by_key, tables, checks, figures)
    tables.append(TextTable("what differs from M, and why", ("table", "why"), DIFFERENCES))
    return CampaignResult(figures, checks, tables, draw=partial(draw_aps, figures))


def run_best(request: CampaignRequest) -> CampaignResult:
    """The best case alone: no false objects but the stars that the catalogue does not hold."""
    return run(request, (False,))


def _attitudes(
    configuration: tuple[str, bool],
    by_key: RUNS_OF,
    tables: list[TextTable],
    checks: list[Check],
    figures: dict[str, Any],
) -> None:
    rows = []
    number = TABLE_OF_ATTITUDES[configuration]
    for place, rate in enumerate(RATES_DEG_S):
        runs = [(case, item) for case, item in by_key[(*configuration, rate)] if item.images]
        for axis, label in enumerate(AXES):
            mean, std = ATTITUDES[configuration][place][axis]
            key = f"table {number}, {label}, {rate} deg/s"
            found = Spread.of((case.attitude, Moments.of(item.error_arcsec[[axis]])) for case, item in runs)
            if found is None:
                checks.append(check(key, None, "<=", std, "arcsec"))
                continue
            figures.setdefault("attitudes", {})[key] = {**vars(found), "paper": (mean, std)}
            checks.append(check(f"{key}: low end", max(found.std - found.std_half, 0.0), "<=", std, "arcsec"))
            rows.append(
                (
                    f"{rate}",
                    label,
                    f"{mean:.2f}",
                    f"{std:.2f}",
                    f"{found.mean:.2f} +- {found.mean_half:.2f}",
                    f"{found.std:.2f} +- {found.std_half:.2f}",
                    f"{found.count}",
                )
            )
    case = "worst" if configuration[1] else "best"
    tables.append(
        TextTable(
            f"table {number}: attitude errors, {configuration[0]} shutter, {case} case, arcsec",
            ("deg/s", "angle", "M mean", "M std", "mean", "std", "runs"),
            tuple(rows),
        )
    )


def _success(
    configuration: tuple[str, bool],
    by_key: RUNS_OF,
    tables: list[TextTable],
    checks: list[Check],
    figures: dict[str, Any],
) -> None:
    number = TABLE_OF_SUCCESS[configuration]
    kept = figures.setdefault("success", {})
    rows = []
    for line, images in enumerate(IMAGES):
        row = [f"{images}"]
        for place, rate in enumerate(RATES_DEG_S):
            found = _share(by_key[(*configuration, rate)], partial(_within, images))
            paper = SUCCESS[configuration][line][place]
            of_paper = RUNS_A_RATE if rate else RUNS_AT_REST
            low, _ = wilson(paper / 100.0 * of_paper, of_paper)
            key = f"table {number}, {images} images, {rate} deg/s"
            kept[key] = {**vars(found), "paper": paper}
            checks.append(check(f"{key}: high end", 100.0 * found.high, ">=", 100.0 * low, "%"))
            row += [f"{paper:.1f}", f"{100 * found.value:.1f} ({found.interval(1)})"]
        rows.append(tuple(row))
    if not configuration[1]:
        row = ["2, M's way"]
        for place, rate in enumerate(RATES_DEG_S):
            row.append(f"{SUCCESS[configuration][0][place]:.1f}")
            if not rate:
                row.append("-")
                continue
            found = _share(by_key[(*configuration, rate)], _by_papers_way)
            kept[f"table {number}, 2 images by M's way, {rate} deg/s"] = vars(found)
            row.append(f"{100 * found.value:.1f} ({found.interval(1)})")
        rows.insert(1, tuple(row))
    heads = [text for rate in RATES_DEG_S for text in (f"M {rate}", f"{rate} deg/s")]
    case = "worst" if configuration[1] else "best"
    tables.append(
        TextTable(
            f"table {number}: success within so many images, {configuration[0]} shutter, {case} case, %",
            ("images", *heads),
            tuple(rows),
        )
    )


def _within(images: int, run: Run) -> bool:
    return 0 < run.images <= images and not run.wrong


def _by_papers_way(run: Run) -> bool:
    return run.paper_solved


def _share(runs: Sequence[tuple[Case, Run]], good: Callable[[Run], bool]) -> Share:
    """Of the runs, grouped by their attitudes."""
    groups: dict[int, list[bool]] = {}
    for case, item in runs:
        groups.setdefault(case.attitude, []).append(good(item))
    return clustered_share([sum(item) for item in groups.values()], [len(item) for item in groups.values()])
