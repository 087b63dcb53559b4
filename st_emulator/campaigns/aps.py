"""Tables 3 to 13 of the multi-poles paper (Schiattarella, Spiller and Curti 2020, "M"), beside ours.

Every figure of ours has its 95 % interval: Wilson's for shares, that of a standard deviation from its degrees
of freedom (taken as many as runs or, of centroids, as stars: those of one image share its rate, so that
theirs is a little too narrow).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..report import Check, TextTable, check
from .aps_paper import (
    ATTITUDES,
    CENTROIDS,
    IMAGES,
    RATES_DEG_S,
    RUNS_A_RATE,
    RUNS_AT_REST,
    SUCCESS,
    TABLE_OF_ATTITUDES,
    TABLE_OF_SUCCESS,
)
from .aps_runs import DIRECTIONS, Case, Moments, Run, run_case
from .campaign import CampaignRequest, CampaignResult
from .confidence import Z_95, share, wilson

Array = NDArray[np.float64]

AXES = ("roll", "pitch", "yaw")
ALLOWED_OF_PLAIN = 0.15  # what the errors without compensation may differ from M's, relatively
SHUTTERS = ("rolling", "global")


def cases_of(attitudes: int, worst: tuple[bool, ...]) -> list[Case]:
    """All runs of both shutters: at rest one an attitude, at each rate one an attitude and direction."""
    cases = []
    for shutter in SHUTTERS:
        for one in worst:
            for rate in RATES_DEG_S:
                directions = range(len(DIRECTIONS)) if rate else range(1)
                cases += [
                    Case(shutter, one, rate, attitude, direction)
                    for attitude in range(attitudes)
                    for direction in directions
                ]
    return cases


def _run(profile_json: str, seed: int, attitudes: int, worst: tuple[bool, ...], index: int) -> Run:
    return run_case(profile_json, seed, attitudes, _cases(attitudes, worst)[index])


_KEPT: dict[tuple[int, tuple[bool, ...]], list[Case]] = {}


def _cases(attitudes: int, worst: tuple[bool, ...]) -> list[Case]:
    key = (attitudes, worst)
    if key not in _KEPT:
        _KEPT[key] = cases_of(attitudes, worst)
    return _KEPT[key]


@dataclass(frozen=True)
class Spread:
    """Mean, standard deviation, skewness and kurtosis of ``count`` errors."""

    count: int
    mean: float
    std: float
    skewness: float
    kurtosis: float

    @classmethod
    def of(cls, moments: Iterable[Moments]) -> Spread | None:
        """Of all of them together; None of fewer than two."""
        all_of = list(moments)
        count = sum(item.count for item in all_of)
        if count < 2:
            return None
        first, second, third, fourth = np.sum([item.sums for item in all_of], axis=0) / count
        variance = second - first * first
        std = math.sqrt(max(variance, 0.0))
        central_3 = third - 3 * first * second + 2 * first**3
        central_4 = fourth - 4 * first * third + 6 * first * first * second - 3 * first**4
        if std == 0.0:
            return cls(count, float(first), 0.0, 0.0, 0.0)
        return cls(
            count, float(first), std, float(central_3 / std**3), float(central_4 / (variance * variance))
        )

    @property
    def interval(self) -> float:
        """Half of the 95 % interval of the standard deviation."""
        return Z_95 * self.std * math.sqrt(max(self.kurtosis - 1.0, 0.5) / (4.0 * self.count))


def run(request: CampaignRequest, worst: tuple[bool, ...] = (False, True)) -> CampaignResult:
    """``n`` attitudes (M: 200), 26 directions at 1 to 5 deg/s, both shutters."""
    cases = _cases(request.n, worst)
    runs = request.workers.map(
        partial(_run, request.profile.model_dump_json(), request.seed, request.n, worst), range(len(cases))
    )
    by_key: dict[tuple[str, bool, int], list[Run]] = {}
    for case, outcome in zip(cases, runs, strict=True):
        by_key.setdefault((case.shutter, case.worst, case.rate_deg_s), []).append(outcome)
    tables: list[TextTable] = []
    checks: list[Check] = []
    figures: dict[str, Any] = {"runs": len(cases), "wrong": sum(item.wrong for item in runs)}
    checks.append(check("wrong attitudes", figures["wrong"], "==", 0, ""))
    if False in worst:
        _centroids(by_key, tables, checks, figures)
    for one in worst:
        for shutter in reversed(SHUTTERS):
            _attitudes((shutter, one), by_key, tables, checks, figures)
            _success((shutter, one), by_key, tables, checks, figures)
    return CampaignResult(figures, checks, tables)


def run_best(request: CampaignRequest) -> CampaignResult:
    """The best case alone: no false objects but the stars that the catalogue does not hold."""
    return run(request, (False,))


def _centroids(
    by_key: dict[tuple[str, bool, int], list[Run]],
    tables: list[TextTable],
    checks: list[Check],
    figures: dict[str, Any],
) -> None:
    places = {
        "table 3: global shutter": ("global", "compensated"),
        "table 4: rolling shutter, compensated": ("rolling", "compensated"),
        "table 5: rolling shutter, not compensated": ("rolling", "plain"),
    }
    for title, (shutter, kind) in places.items():
        rows = []
        for axis, (name, label) in enumerate((("x", "horizontal"), ("y", "vertical"))):
            for place, rate in enumerate(RATES_DEG_S[1:]):
                paper = CENTROIDS[title][axis][place]
                found = Spread.of(getattr(item, f"{kind}_{name}") for item in by_key[shutter, False, rate])
                key = f"{title}, {label}, {rate} deg/s"
                if found is None:
                    checks.append(check(key, None, "<=", paper[1], "px"))
                    continue
                figures.setdefault("centroids", {})[key] = {**vars(found), "paper": paper}
                if kind == "plain":
                    off = abs(found.std / paper[1] - 1.0)
                    checks.append(check(f"{key}, off M's by", off, "<=", ALLOWED_OF_PLAIN, ""))
                else:
                    checks.append(check(key, found.std, "<=", paper[1], "px"))
                rows.append(
                    (
                        label,
                        f"{rate}",
                        *(f"{value:.3g}" for value in paper),
                        f"{found.mean:.2g}",
                        f"{found.std:.3f} +- {found.interval:.3f}",
                        f"{found.skewness:.2g}",
                        f"{found.kurtosis:.3g}",
                        f"{found.count}",
                    )
                )
        columns = (
            "axis", "deg/s", "M mean", "M std", "M skew.", "M kurt.",
            "mean", "std", "skew.", "kurt.", "stars",
        )  # fmt: skip
        tables.append(TextTable(f"{title}, px", columns, tuple(rows)))


def _attitudes(
    configuration: tuple[str, bool],
    by_key: dict[tuple[str, bool, int], list[Run]],
    tables: list[TextTable],
    checks: list[Check],
    figures: dict[str, Any],
) -> None:
    rows = []
    number = TABLE_OF_ATTITUDES[configuration]
    for place, rate in enumerate(RATES_DEG_S):
        errors = np.array([item.error_arcsec for item in by_key[(*configuration, rate)] if item.images])
        for axis, label in enumerate(AXES):
            mean, std = ATTITUDES[configuration][place][axis]
            key = f"table {number}, {label}, {rate} deg/s"
            if len(errors) < 2:
                checks.append(check(key, None, "<=", std, "arcsec"))
                continue
            found = float(errors[:, axis].std())
            half = Z_95 * found / math.sqrt(2.0 * len(errors))
            figures.setdefault("attitudes", {})[key] = {
                "mean": float(errors[:, axis].mean()), "std": found, "runs": len(errors),
                "paper": (mean, std),
            }  # fmt: skip
            checks.append(check(key, found - half, "<=", std, "arcsec"))
            rows.append(
                (
                    f"{rate}",
                    label,
                    f"{mean:.2f}",
                    f"{std:.2f}",
                    f"{errors[:, axis].mean():.2f}",
                    f"{found:.2f} +- {half:.2f}",
                    f"{len(errors)}",
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
    by_key: dict[tuple[str, bool, int], list[Run]],
    tables: list[TextTable],
    checks: list[Check],
    figures: dict[str, Any],
) -> None:
    number = TABLE_OF_SUCCESS[configuration]
    rows = []
    for line, images in enumerate(IMAGES):
        row = [f"{images}"]
        for place, rate in enumerate(RATES_DEG_S):
            runs = by_key[(*configuration, rate)]
            found = share(sum(0 < item.images <= images and not item.wrong for item in runs), len(runs))
            paper = SUCCESS[configuration][line][place]
            of_paper = RUNS_A_RATE if rate else RUNS_AT_REST
            low, _ = wilson(paper / 100.0 * of_paper, of_paper)
            key = f"table {number}, {images} images, {rate} deg/s"
            figures.setdefault("success", {})[key] = {
                "share": found.value, "low": found.low, "high": found.high, "runs": len(runs), "paper": paper,
            }  # fmt: skip
            checks.append(check(key, 100.0 * found.high, ">=", 100.0 * low, "%"))
            row += [f"{paper:.1f}", f"{100 * found.value:.1f} ({found.interval(1)})"]
        rows.append(tuple(row))
    heads = [text for rate in RATES_DEG_S for text in (f"M {rate}", f"{rate} deg/s")]
    case = "worst" if configuration[1] else "best"
    tables.append(
        TextTable(
            f"table {number}: success within so many images, {configuration[0]} shutter, {case} case, %",
            ("images", *heads),
            tuple(rows),
        )
    )
