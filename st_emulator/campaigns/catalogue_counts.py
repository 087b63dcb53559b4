"""Counts of catalogue stars and pairs beside those that Zhang et al. 2014 print."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from ..compiled_kernels import keep_compiled_kernels
from ..firmware_model.catalogue.pairs import build_pair_catalogue
from ..firmware_model.catalogue.star_catalogue import build_star_catalogue
from ..report import TextTable, check
from ..world.stars import CATALOGUE_EPOCH_JYEAR, StarField, star_field
from .campaign import CampaignRequest, CampaignResult

# Z section 4.2: Hipparcos stars by Hp, from the first magnitude up to, not including, the second
PAPER_COUNTS: tuple[tuple[float, float, int], ...] = (
    (-np.inf, 3.0, 165),
    (3.0, 4.0, 315),
    (4.0, 5.0, 991),
    (5.0, 6.0, 3088),
    (6.0, 7.0, 9381),
)
# Z section 4.2, of the Bright Star Catalogue
PAPER_LIMIT_MAG = 5.0
PAPER_STARS = 1604
PAPER_PAIRS = 44_234
PAPER_FIELD_DEG = 20.0
REASON = (
    "the paper's 1604 stars are of the Bright Star Catalogue, by V; ours are of Hipparcos, by Hp, which is "
    "fainter than V for most stars, so that fewer are under 5.0. As many stars of ours, the brightest 1604, "
    "have the paper's number of pairs to about 1 %"
)


def pairs_under(stars: StarField, limit_mag: float, angle_deg: float) -> tuple[int, int]:
    """(stars, pairs at most angle_deg apart) of the stars with Hp < limit_mag, none of them merged."""
    keep_compiled_kernels()
    catalogue = build_star_catalogue(stars.hip, stars.unit_vectors, stars.hp_mag, limit_mag, 0.0)
    return len(catalogue), len(build_pair_catalogue(catalogue, float(np.radians(angle_deg))))


def limit_of(stars: StarField, count: int) -> float:
    """The magnitude that ``count`` stars are brighter than."""
    return float(np.sort(stars.hp_mag)[count])


def run(request: CampaignRequest) -> CampaignResult:
    """All of Hipparcos at its own epoch; ``n``, seed and unit make no difference."""
    stars = star_field(CATALOGUE_EPOCH_JYEAR)
    rows: list[dict[str, Any]] = []
    checks = []
    for low, high, printed in PAPER_COUNTS:
        count = int(np.sum((stars.hp_mag >= low) & (stars.hp_mag < high)))
        name = f"{low:g} to {high:g}" if np.isfinite(low) else f"under {high:g}"
        rows.append({"magnitudes": name, "stars": count, "paper": printed, "difference": count - printed})
        checks.append(check(f"stars_{name.replace(' ', '_')}_mag", count, "==", printed, "stars"))
    counted, pairs = pairs_under(stars, PAPER_LIMIT_MAG, PAPER_FIELD_DEG)
    as_many_limit = limit_of(stars, PAPER_STARS)
    as_many, as_many_pairs = pairs_under(stars, as_many_limit, PAPER_FIELD_DEG)
    figures = {
        "stars_under_5_mag": counted,
        "stars_under_5_mag_paper": PAPER_STARS,
        "pairs_under_20_deg": pairs,
        "pairs_under_20_deg_paper": PAPER_PAIRS,
        "pairs_to_paper": pairs / PAPER_PAIRS,
        "as_many_stars_limit_mag": as_many_limit,
        "as_many_stars": as_many,
        "as_many_stars_pairs": as_many_pairs,
        "as_many_stars_pairs_to_paper": as_many_pairs / PAPER_PAIRS,
        "reason": REASON,
        "by_magnitude": rows,
    }
    pairs_rows = [
        ("Bright Star Catalogue, V < 5.0 (the paper)", PAPER_STARS, PAPER_PAIRS),
        ("Hipparcos, Hp < 5.0", counted, pairs),
        (f"Hipparcos, as many stars: Hp < {as_many_limit:.2f}", as_many, as_many_pairs),
    ]
    return CampaignResult(
        figures, checks, tables=_tables(rows, pairs_rows), draw=partial(_draw, rows, pairs_rows)
    )


def _tables(rows: list[dict[str, Any]], pairs_rows: list[tuple[str, int, int]]) -> list[TextTable]:
    return [
        TextTable(
            "Hipparcos stars by Hp",
            ("magnitudes", "ours", "the paper", "difference"),
            tuple(
                (row["magnitudes"], str(row["stars"]), str(row["paper"]), f"{row['difference']:+d}")
                for row in rows
            ),
        ),
        TextTable(
            f"Pairs at most {PAPER_FIELD_DEG:g} deg apart",
            ("stars of", "stars", "pairs", "to the paper's"),
            tuple(
                (name, str(count), str(found), f"{100 * (found / PAPER_PAIRS - 1):+.1f} %")
                for name, count, found in pairs_rows
            ),
        ),
    ]


def _draw(rows: list[dict[str, Any]], pairs_rows: list[tuple[str, int, int]], figure: Any) -> None:
    """Counts by magnitude beside the paper's, and pairs by the number of stars."""
    from .plotting import COLOURS, SOURCE_COLOUR

    left, right = figure.subplots(1, 2)
    places = np.arange(len(rows))
    for shift, key, label, colour in (
        (-0.2, "stars", "Hipparcos, counted here", COLOURS[0]),
        (0.2, "paper", "Zhang et al. 2014", SOURCE_COLOUR),
    ):
        bars = left.bar(places + shift, [row[key] for row in rows], 0.38, label=label, color=colour)
        left.bar_label(bars, fontsize=8)
    left.set_yscale("log")
    left.set_xticks(places, [row["magnitudes"] for row in rows])
    left.set_xlabel("Hp, mag")
    left.set_ylabel("stars")
    left.legend(loc="upper left")
    for (name, count, found), colour in zip(pairs_rows, (SOURCE_COLOUR, *COLOURS), strict=False):
        right.plot(count, found, "o", color=colour, label=f"{name}: {count} stars, {found} pairs")
    most = 1.05 * max(count for _, count, _ in pairs_rows)
    counts = np.linspace(0.8 * min(count for _, count, _ in pairs_rows), most, 50)
    even = counts * (counts - 1) / 2 * (1 - np.cos(np.radians(PAPER_FIELD_DEG))) / 2
    right.plot(counts, even, ":", color=COLOURS[2], label="stars spread evenly over the sky")
    right.set_ylim(float(even[0]), 1.2 * max(found for _, _, found in pairs_rows))  # room for the legend
    right.set_xlabel("stars")
    right.set_ylabel(f"pairs at most {PAPER_FIELD_DEG:g} deg apart")
    right.legend(loc="upper left", fontsize=8)
    figure.suptitle("Catalogue counts beside the paper's")
