"""The plot of the campaigns aps and aps-best: centroid errors and success over the rate, M's beside ours."""

from __future__ import annotations

from typing import Any

from .aps_paper import CENTROIDS, RATES_DEG_S, TABLE_OF_SUCCESS

_IMAGES = (2, 10, 60)
_CENTROIDS = {
    "table 3: global shutter": "global",
    "table 4: rolling shutter, compensated": "rolling, compensated",
    "table 5: rolling shutter, not compensated": "rolling, not compensated",
}
_MARKS = {True: "s", False: "o"}  # worst, best case


def draw_aps(figures: dict[str, Any], figure: Any) -> None:
    """``figures``: those of the campaign."""
    from .plotting import COLOURS, SOURCE_COLOUR  # the workers draw nothing

    left, right = figure.subplots(1, 2)
    _draw_centroids(figures.get("centroids", {}), left, COLOURS, SOURCE_COLOUR)
    _draw_success(figures.get("success", {}), right, COLOURS, SOURCE_COLOUR)


def _draw_centroids(kept: dict[str, Any], axes: Any, colours: Any, source: str) -> None:
    rates = RATES_DEG_S[1:]
    for order, (title, words) in enumerate(_CENTROIDS.items()):
        colour = colours[order]
        for axis, label in enumerate(("horizontal", "vertical")):
            paper = [row[1] for row in CENTROIDS[title][axis]]
            style = ("-", "--")[axis]
            first = order == axis == 0
            axes.plot(rates, paper, style, color=source, marker="_", label="M" if first else None)
            for name, mark in (("unit", "o"), ("papers_way", "x")):
                found = [kept.get(f"{title}, {label}, {rate} deg/s", {}).get(name) for rate in rates]
                places = [rate for rate, item in zip(rates, found, strict=True) if item]
                values = [item["std"] for item in found if item]
                who = "the unit's way" if name == "unit" else "M's way"
                axes.plot(
                    places,
                    values,
                    style,
                    color=colour,
                    marker=mark,
                    markersize=5,
                    label=f"{words}, {who}" if axis == 0 else None,
                )
    axes.set_yscale("log")
    axes.set_xticks(rates)
    axes.set_xlabel("deg/s")
    axes.set_ylabel("centroid error, 1 sigma, px")
    axes.set_title("tables 3 to 5 (dashed: vertical), all fused stars")
    axes.grid(alpha=0.4)
    axes.legend(fontsize=7)


def _draw_success(kept: dict[str, Any], axes: Any, colours: Any, source: str) -> None:
    named = False
    for shutter, worst in (("rolling", False), ("rolling", True)):
        number = TABLE_OF_SUCCESS[shutter, worst]
        for order, images in enumerate(_IMAGES):
            found = [kept.get(f"table {number}, {images} images, {rate} deg/s") for rate in RATES_DEG_S]
            if any(item is None for item in found):
                continue
            shares = [100 * item["value"] for item in found if item]
            below = [100 * (item["value"] - item["low"]) for item in found if item]
            above = [100 * (item["high"] - item["value"]) for item in found if item]
            axes.plot(
                RATES_DEG_S,
                [item["paper"] for item in found if item],
                "--" if worst else "-",
                color=source,
                alpha=0.8,
                label=None if named else "M (dashed: worst case)",
            )
            named = True
            aside = 0.07 * (order - 1) + (0.03 if worst else 0.0)  # so that the bars do not hide each other
            axes.errorbar(
                [rate + aside for rate in RATES_DEG_S],
                shares,
                yerr=[below, above],
                color=colours[order],
                marker=_MARKS[worst],
                markersize=5,
                capsize=3,
                linestyle="",
                fillstyle="none" if worst else "full",
                label=f"{images} images, {'worst' if worst else 'best'} case",
            )
    axes.set_xlabel("deg/s")
    axes.set_ylabel("success, %")
    axes.set_ylim(0, 102)
    axes.set_title("success within so many images, rolling shutter")
    axes.grid(alpha=0.4)
    axes.legend(fontsize=7)
