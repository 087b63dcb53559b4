"""The plot of the campaign zy3-table3: what is not identified, beside the paper, and what it costs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .confidence import Share

FLOOR = 1e-4  # shares below are drawn here
_MARKS = ("o", "D")  # of the two noises


def _miss(axes: Any, x: float, success: Share, **style: Any) -> None:
    """1 - success with its interval on a logarithmic axis."""
    value = max(1 - success.value, FLOOR)
    low, high = max(1 - success.high, FLOOR), max(1 - success.low, FLOOR)
    axes.errorbar(x, value, yerr=[[value - low], [high - value]], capsize=3, linestyle="", **style)


def draw_table3(rows: Sequence[dict[str, Any]], figure: Any) -> None:
    """``rows``: algorithm, scenario, noise, success, operations, paper (a Share or None)."""
    from .plotting import COLOURS, SOURCE_COLOUR  # the workers draw nothing

    algorithms = list(dict.fromkeys(row["algorithm"] for row in rows))
    scenarios = list(dict.fromkeys(row["scenario"] for row in rows))
    noises = list(dict.fromkeys(row["noise"] for row in rows))
    left, right = figure.subplots(1, 2, width_ratios=(2, 1))
    step = 0.8 / (len(algorithms) * (len(noises) + 1))
    named: set[str] = set()

    def label(text: str) -> str | None:
        if text in named:
            return None
        named.add(text)
        return text

    for row in rows:
        order, noise = algorithms.index(row["algorithm"]), noises.index(row["noise"])
        x = scenarios.index(row["scenario"]) - 0.4 + (order * (len(noises) + 1) + 0.5) * step
        if row["paper"] is not None and noise == 0:
            _miss(left, x, row["paper"], marker="_", color=SOURCE_COLOUR, markersize=12, label=label("paper"))
        _miss(
            left,
            x + (noise + 1) * step,
            row["success"],
            marker=_MARKS[noise % 2],
            markersize=5,
            color=COLOURS[order % len(COLOURS)],
            label=label(f"{row['algorithm']}, {row['noise']}"),
        )
    left.set_yscale("log")
    left.set_ylim(FLOOR * 0.8, 1.0)
    left.set_xticks(range(len(scenarios)), scenarios)
    left.set_ylabel(f"share not identified rightly (at the floor: {FLOOR:g} or less)")
    left.set_title("Zhang et al. 2014, table 3")
    left.grid(axis="y", alpha=0.4)
    left.legend(fontsize=7, ncols=2, loc="upper left")
    for order, name in enumerate(algorithms):
        heights = [
            next(
                row["operations"]
                for row in rows
                if (row["algorithm"], row["scenario"], row["noise"]) == (name, scenario, noises[0])
            )
            for scenario in scenarios
        ]
        width = 0.8 / len(algorithms)
        places = [place - 0.4 + (order + 0.5) * width for place in range(len(scenarios))]
        right.bar(places, heights, width, color=COLOURS[order % len(COLOURS)], label=name)
    right.set_yscale("log")
    right.set_xticks(range(len(scenarios)), [name.replace(", ", ",\n") for name in scenarios], fontsize=7)
    right.set_title(f"operations of an identification, {noises[0]}")
    right.grid(axis="y", alpha=0.4)
