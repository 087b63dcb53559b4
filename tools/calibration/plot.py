"""Predicted against simulated cycles, a panel for each stage and one for whole frames."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from matplotlib.ticker import NullFormatter

from st_emulator.campaigns.plotting import COLOURS, require_plot_path, write_plot
from st_emulator.firmware_model.work import STAGES
from tools.calibration.document import SampleSet
from tools.calibration.frames import LOST_IN_SPACE, TRACKING
from tools.calibration.validation import (
    FRAME_LIMIT,
    STAGE_LIMIT,
    Predict,
    StageError,
    frame_errors,
    stage_errors,
)

__all__ = ["draw", "require_plot_path", "write_plot"]

_MARKS = {LOST_IN_SPACE: ("o", COLOURS[0]), TRACKING: ("s", COLOURS[1])}


def draw(samples: SampleSet, predict: Predict) -> Callable[[Any], None]:
    """What draws the errors of held out samples into a figure."""
    stages = stage_errors(samples.samples, predict)
    frames = frame_errors(samples.samples, predict, samples.left_out)

    def into(figure: Any) -> None:
        axes = figure.subplots(2, 4).ravel()
        for place, stage in zip(axes, (*STAGES, "frame"), strict=True):
            limit = STAGE_LIMIT if stage != "frame" else FRAME_LIMIT
            items = [item for item in (*stages, *frames) if item.stage == stage]
            _panel(place, "whole frame" if stage == "frame" else stage, items, limit)
        named = {}
        for place in axes:
            named.update(
                {label: handle for handle, label in zip(*place.get_legend_handles_labels(), strict=True)}
            )
        figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=len(named), fontsize=8)

    return into


def _panel(axes: Any, title: str, items: list[StageError], limit: float) -> None:
    axes.set_title(title, fontsize=10)
    axes.set_xscale("log")
    axes.set_xlabel("simulated cycles", fontsize=8)
    axes.set_ylabel("predicted / simulated - 1, %", fontsize=8)
    axes.axhspan(-100 * limit, 100 * limit, color="white", alpha=0.10, label="limit")
    axes.axhline(0.0, color="white", linewidth=0.6)
    for kind in sorted({item.kind for item in items}):
        mark, colour = _MARKS.get(kind, ("^", COLOURS[2]))
        own = [item for item in items if item.kind == kind]
        axes.plot(
            [item.simulated for item in own],
            [100 * item.error for item in own],
            mark,
            markersize=3,
            color=colour,
            alpha=0.8,
            label=kind.replace("_", " ") if kind in _MARKS else "step by itself",
        )
    if items:
        least, most = (pick(item.simulated for item in items) for pick in (min, max))
        middle, half = math.sqrt(least * most), max(math.sqrt(most / least), math.sqrt(10)) * 1.2
        axes.set_xlim(middle / half, middle * half)  # a decade at least, so that it has labels
    axes.xaxis.set_minor_formatter(NullFormatter())
    largest = max((abs(100 * item.error) for item in items), default=0.0)
    reach = max(1.2 * limit * 100, 1.1 * largest)
    axes.set_ylim(-reach, reach)
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.3)
