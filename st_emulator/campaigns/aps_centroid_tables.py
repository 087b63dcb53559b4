"""Tables 3 to 5 of the multi-poles paper ("M") beside ours, and what the errors without compensation are made
of.

M does not say which stars its errors are of. A star that is not compensated is off by its speed times the
time between its row's exposure and the frame's, so that the spread of all is that of the speeds of whichever
stars are counted: table 5 is given for the stars that were recognised, which M's attitudes are of, and for
all fused ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ..report import Check, TextTable, check
from ..units.profile import UnitProfile
from .aps_centroids import AxisErrors, CentroidErrors
from .aps_paper import CENTROIDS, RATES_DEG_S
from .aps_runs import DIRECTIONS, Case, Run
from .spreads import Moments, Spread

ALLOWED_OF_PLAIN = 0.15  # what the errors without compensation may differ from M's, relatively
RUNS_OF = Mapping[tuple[str, bool, int], Sequence[tuple[Case, Run]]]
_AXES = (("x", "horizontal"), ("y", "vertical"))
_COMPENSATED = {
    "table 3: global shutter": "global",
    "table 4: rolling shutter, compensated": "rolling",
}
_PLAIN = "table 5: rolling shutter, not compensated"
_ROLLS = frozenset(number for number, (x, y, _) in enumerate(DIRECTIONS) if x == y == 0.0)


def centroid_tables(
    by_key: RUNS_OF,
    profile: UnitProfile,
    tables: list[TextTable],
    checks: list[Check],
    figures: dict[str, Any],
) -> None:
    """Append tables 3 to 5, their checks and figures."""
    kept: dict[str, Any] = figures.setdefault("centroids", {})
    for title, shutter in _COMPENSATED.items():
        rows = []
        for axis, (name, label) in enumerate(_AXES):
            for place, rate in enumerate(RATES_DEG_S[1:]):
                paper, runs = CENTROIDS[title][axis][place], by_key[shutter, False, rate]
                key = f"{title}, {label}, {rate} deg/s"
                field = f"compensated_{name}"
                unit = _spread(runs, lambda run: run.unit.fused, field)
                theirs = _papers_way(runs, field)
                kept[key] = {
                    "paper": paper,
                    "unit": _plain(unit),
                    **_papers_figures(theirs),
                }
                checks.append(check(key, None if unit is None else unit.std, "<=", paper[1], "px"))
                rows.append((label, f"{rate}", *_of_paper(paper), *_all_of(unit), *map(_std, theirs)))
        tables.append(TextTable(f"{title}, px; all fused stars", _HEADS, tuple(rows)))
    _not_compensated(by_key, tables, checks, kept)
    tables.append(_speeds(by_key, profile, figures))
    kept["astray"] = _astray(by_key)


_HEADS = (
    "axis", "deg/s", "M mean", "M std", "M skew.", "M kurt.", "mean", "std", "skew.", "kurt.", "stars",
    "M's way: recognised", "all",
)  # fmt: skip
_HEADS_5 = (
    "axis", "deg/s", "M std", "M kurt.", "recognised: std", "off", "kurt.", "stars",
    "all fused: std", "off", "kurt.", "stars", "M's way: recognised", "all",
)  # fmt: skip


def _not_compensated(
    by_key: RUNS_OF, tables: list[TextTable], checks: list[Check], kept: dict[str, Any]
) -> None:
    rows = []
    for axis, (name, label) in enumerate(_AXES):
        for place, rate in enumerate(RATES_DEG_S[1:]):
            paper, runs = CENTROIDS[_PLAIN][axis][place], by_key["rolling", False, rate]
            key, field = f"{_PLAIN}, {label}, {rate} deg/s", f"plain_{name}"
            named = _spread(runs, lambda run: run.unit.recognised, field)
            every = _spread(runs, lambda run: run.unit.fused, field)
            theirs = _papers_way(runs, field)
            kept[key] = {
                "paper": paper,
                "unit_recognised": _plain(named),
                "unit": _plain(every),
                **_papers_figures(theirs),
            }
            for who, found in (("recognised", named), ("all fused", every)):
                off = None if found is None else _least_off(found, paper[1])
                checks.append(check(f"{key}, {who}: near end off M's", off, "<=", ALLOWED_OF_PLAIN, ""))
            rows.append(
                (
                    label,
                    f"{rate}",
                    f"{paper[1]:.3g}",
                    f"{paper[3]:.3g}",
                    *_off_of(named, paper[1]),
                    *_off_of(every, paper[1]),
                    *(_std(item) for item in theirs),
                )
            )
    tables.append(TextTable(f"{_PLAIN}, px", _HEADS_5, tuple(rows)))


def _speeds(by_key: RUNS_OF, profile: UnitProfile, figures: dict[str, Any]) -> TextTable:
    """What the spread without compensation is made of: stars of turns about the boresight alone, and all
    others."""
    rows, kept = [], []
    for place, rate in enumerate(RATES_DEG_S[1:]):
        paper = math.hypot(*(CENTROIDS[_PLAIN][axis][place][1] for axis in (0, 1))) / math.sqrt(2.0)
        # of a star that moves along one axis at the full rate, its rows as likely as each other
        full = math.radians(rate) * profile.focal_px * profile.timing.exposure_ms * 1e-3 / math.sqrt(12.0)
        for words, pick in _COUNTED.items():
            parts = []
            for rolls in (True, False):
                chosen = [
                    item for item in by_key["rolling", False, rate] if (item[0].direction in _ROLLS) == rolls
                ]
                both = [_spread(chosen, pick, f"plain_{name}") for name, _ in _AXES]
                if both[0] is None or both[1] is None:
                    break
                parts.append((both[0].count, math.hypot(both[0].std, both[1].std) / math.sqrt(2.0)))
            if len(parts) < 2:
                continue
            (rolled, slow), (turned, fast) = parts
            share = rolled / (rolled + turned)
            needed = (fast**2 - paper**2) / (fast**2 - slow**2) if fast > slow else math.nan
            kept.append(
                {
                    "rate_deg_s": rate, "counted": words, "full_rate_px": full, "rolls_px": slow,
                    "others_px": fast, "share_of_rolls": share, "share_for_paper": needed,
                }
            )  # fmt: skip
            rows.append(
                (
                    f"{rate}",
                    words,
                    f"{full:.2f}",
                    f"{slow:.2f}",
                    f"{fast:.2f}",
                    f"{100 * share:.1f}",
                    f"{100 * needed:.1f}",
                )
            )
    figures["speeds"] = kept
    heads = (
        "deg/s", "stars counted", "at the full rate: std", "turns about the boresight: std",
        "other directions: std", "boresight's share of the stars, %", "share that gives M's std, %",
    )  # fmt: skip
    return TextTable("table 5: what its spread is made of, px", heads, tuple(rows))


_COUNTED: dict[str, Callable[[Run], AxisErrors]] = {
    "recognised": lambda run: run.unit.recognised,
    "all fused": lambda run: run.unit.fused,
    "recognised, M's way": lambda run: run.paper.recognised,
    "all fused, M's way": lambda run: run.paper.fused,
}


def _astray(by_key: RUNS_OF) -> list[dict[str, Any]]:
    """Share of the fused spots that are no star's."""
    rows = []
    for shutter in ("global", "rolling"):
        for rate in RATES_DEG_S[1:]:
            row: dict[str, Any] = {"shutter": shutter, "rate_deg_s": rate}
            for name in ("unit", "paper"):
                errors: list[CentroidErrors] = [getattr(run, name) for _, run in by_key[shutter, False, rate]]
                astray = sum(item.astray for item in errors)
                every = astray + sum(item.fused.plain_x.count for item in errors)
                row[name] = astray / every if every else None
            rows.append(row)
    return rows


def _spread(runs: Sequence[tuple[Case, Run]], pick: Callable[[Run], AxisErrors], field: str) -> Spread | None:
    moments: list[tuple[int, Moments]] = [(case.attitude, getattr(pick(run), field)) for case, run in runs]
    return Spread.of(moments)


def _papers_way(runs: Sequence[tuple[Case, Run]], field: str) -> tuple[Spread | None, Spread | None]:
    """By M's own way: of the stars that were recognised, and of all fused ones."""
    recognised = _spread(runs, lambda run: run.paper.recognised, field)
    return recognised, _spread(runs, lambda run: run.paper.fused, field)


def _papers_figures(found: tuple[Spread | None, Spread | None]) -> dict[str, Any]:
    return {"papers_way_recognised": _plain(found[0]), "papers_way": _plain(found[1])}


def _plain(found: Spread | None) -> dict[str, Any] | None:
    return None if found is None else dict(vars(found))


def _of_paper(paper: tuple[float, float, float, float]) -> tuple[str, ...]:
    return tuple(f"{value:.3g}" for value in paper)


def _std(found: Spread | None) -> str:
    return "-" if found is None else f"{found.std:.3f} +- {found.std_half:.3f}"


def _all_of(found: Spread | None) -> tuple[str, ...]:
    if found is None:
        return ("-",) * 5
    return (
        f"{found.mean:.2g}",
        _std(found),
        f"{found.skewness:.2g}",
        f"{found.kurtosis:.3g}",
        f"{found.count}",
    )


def _off_of(found: Spread | None, paper: float) -> tuple[str, ...]:
    if found is None:
        return ("-",) * 4
    return _std(found), f"{100 * (found.std / paper - 1):+.1f} %", f"{found.kurtosis:.3g}", f"{found.count}"


def _least_off(found: Spread, paper: float) -> float:
    """How far the nearest end of the interval is off, relatively: few attitudes say little, and M's own
    figures are of 200."""
    return max(abs(found.std - paper) - found.std_half, 0.0) / paper
