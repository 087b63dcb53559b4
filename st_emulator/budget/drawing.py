"""Pictures of a budget: a frame's timeline, and the margin against false stars, rate and windows."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from matplotlib import pyplot as plt
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from ..commands.pictures import INK, STYLE
from ..errors import ConfigurationError
from ..firmware_model.work import STAGES
from .assessment import Assessment
from .margins import Margin
from .modes import LOST_IN_SPACE, TRACKING
from .sweeps import CROWDED, FALSE_STARS, KINDS, RATE, WINDOWS, PointResult
from .timeline import EXPOSURE, MEDIAN, READOUT, SERIAL, WORST, Timeline, timelines

STAGE_COLOURS = dict(
    zip(
        STAGES,
        ("#4f9dde", "#7bd3f7", "#69d58c", "#ff7ab6", "#ffb000", "#b48ef2", "#c8ccd2"),
        strict=True,
    )
)
SENSOR_COLOURS = {EXPOSURE: "#3b4a5a", READOUT: "#6d8196"}
REPORT_COLOUR = "#e8e3a0"
LATE_COLOUR = "#ff5252"
LIS_COLOUR, WHOLE_COLOUR, TRACKING_COLOUR = "#40c4ff", "#ff7ab6", "#ffb000"
CROWDED_COLOUR = "#ff7043"
DPI = 110
BENEATH = "s-"
LANES = (EXPOSURE, READOUT, MEDIAN, f"{MEDIAN}, {SERIAL}", WORST, f"{WORST}, {SERIAL}")
LANE_LABELS = (EXPOSURE, READOUT, MEDIAN, "its report", WORST, "its report")


def draw_timelines(figure: Any, found: Sequence[Timeline]) -> None:
    """Each timeline in a panel of its own, on one scale of time."""
    latest = max(
        max(line.deadline_ms, *(span.end_high_ms for span in line.spans if span.lane not in SENSOR_COLOURS))
        for line in found
    )
    right = latest * 1.15  # room for the times beside the bars
    panels = figure.subplots(len(found), 1, sharex=True, squeeze=False)[:, 0]
    for axes, line in zip(panels, found, strict=True):
        _timeline(axes, line, right)
    panels[-1].set_xlabel("ms from the start of the exposure")
    handles: list[Any] = [Patch(facecolor=colour, label=name) for name, colour in SENSOR_COLOURS.items()]
    handles += [Patch(facecolor=colour, label=stage) for stage, colour in STAGE_COLOURS.items()]
    handles.append(Patch(facecolor=REPORT_COLOUR, label="report on the serial line"))
    handles.append(Patch(facecolor="none", edgecolor=INK, hatch="////", label="to the upper bound"))
    handles.append(Line2D([], [], color=LATE_COLOUR, linewidth=1.5, label="deadline"))
    figure.legend(handles=handles, ncols=7, fontsize=7.5, loc="outside lower center")


def _timeline(axes: Any, line: Timeline, right: float) -> None:
    height = 0.72
    place = {lane: len(LANES) - 1 - number for number, lane in enumerate(LANES)}
    for span in line.spans:
        colour = STAGE_COLOURS.get(span.what) or SENSOR_COLOURS.get(span.what) or REPORT_COLOUR
        later = span.lane in SENSOR_COLOURS and span.start_ms >= line.period_ms
        axes.add_patch(
            Rectangle(
                (span.start_ms, place[span.lane] - height / 2),
                span.end_ms - span.start_ms,
                height,
                facecolor=colour,
                alpha=0.55 if later else 1.0,
            )
        )
        if span.what == EXPOSURE:
            number = round(span.start_ms / line.period_ms)
            axes.text(
                (span.start_ms + span.end_ms) / 2,
                place[EXPOSURE],
                "this frame" if number == 0 else f"frame + {number}",
                ha="center",
                va="center",
                fontsize=7,
                clip_on=True,
            )
    for lane in (MEDIAN, WORST):
        last = line.end(lane)
        over = max(0.0, last.end_high_ms - last.end_ms)
        axes.add_patch(
            Rectangle(
                (last.end_ms, place[lane] - height / 2),
                over,
                height,
                facecolor="none",
                edgecolor=INK,
                hatch="////",
                linewidth=0.6,
            )
        )
        first = min(span.start_ms for span in line.spans if span.lane == lane)
        took, most = last.end_ms - first, last.end_high_ms - first
        axes.text(
            max(last.end_high_ms, last.end_ms) + right * 0.006,
            place[lane],
            f"{took:.1f} ms (to {most:.1f})",
            va="center",
            fontsize=7.5,
        )
    axes.axvline(line.deadline_ms, color=LATE_COLOUR, linewidth=1.5)
    for number in range(1, int(right / line.period_ms) + 1):
        axes.axvline(number * line.period_ms, color="#5f6368", linewidth=0.6, linestyle=":")
    axes.set_title(line.title, fontsize=9, loc="left")
    axes.set_xlim(0, right)
    axes.set_ylim(-0.6, len(LANES) - 0.4)
    axes.set_yticks([place[lane] for lane in LANES], LANE_LABELS, fontsize=7.5)
    axes.tick_params(axis="y", length=0)


def draw_margins(figure: Any, assessment: Assessment) -> None:
    """The 99th percentile's margin over each sweep, with the band of the cost's bounds."""
    names = [name for name in (FALSE_STARS, RATE, WINDOWS) if name in assessment.sweeps]
    panels = figure.subplots(1, len(names), squeeze=False)[0]
    for axes, name in zip(panels, names, strict=True):
        if name == FALSE_STARS:
            crowded = assessment.sweeps[CROWDED]
            left = [point.tracked.flown.margin for point in crowded]
            values = [point.value for point in crowded]
            _band(axes, values, left, CROWDED_COLOUR, f"tracking, {CROWDED}", "v-")
        _margins(axes, name, assessment.sweeps[name])
    panels[0].set_ylabel("margin of the 99th percentile, ms")
    handles: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    handles["band: bounds of the cost"] = Patch(facecolor=INK, alpha=0.25)
    figure.legend(
        handles.values(), handles.keys(), ncols=len(handles), fontsize=8, loc="outside lower center"
    )


def _margins(axes: Any, name: str, points: Sequence[PointResult]) -> None:
    kind = KINDS[name]
    budget = max(points[0].tracked.flown.margin.budget_ms, 1.0)
    if LOST_IN_SPACE in kind.modes:
        flown = [point.lost.flown.margin for point in points]
        whole = [point.lost.whole.margin for point in points]
        values = [point.value for point in points]
        _band(axes, values, whole, WHOLE_COLOUR, "lost in space, search without limit", BENEATH)
        _band(axes, values, flown, LIS_COLOUR, "lost in space, as flown", "o-")
    if TRACKING in kind.modes:
        used = points if name != RATE else [point for point in points if point.holds]
        if used:
            tracked = [point.tracked.flown.margin for point in used]
            _band(axes, [point.value for point in used], tracked, TRACKING_COLOUR, "tracking", "^-")
    axes.axhline(0.0, color=LATE_COLOUR, linewidth=1.5)
    axes.set_yscale("symlog", linthresh=budget, linscale=3.0)
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, -0.12 * budget), max(high, 1.08 * budget))
    axes.axhspan(axes.get_ylim()[0], 0.0, color=LATE_COLOUR, alpha=0.08, linewidth=0)
    ticks = [budget * share for share in (-100, -10, -1, 0, 0.25, 0.5, 0.75, 1)]
    shown = [tick for tick in ticks if axes.get_ylim()[0] <= tick <= axes.get_ylim()[1]]
    axes.set_yticks(shown, [f"{tick:g}" for tick in shown])
    axes.minorticks_off()
    if name == FALSE_STARS:
        axes.set_xscale("symlog", linthresh=10)
        ticks_x = [point.value for point in points if point.value in (0, 5, 10, 20, 50, 100, 200, 500)]
        axes.set_xticks(ticks_x, [f"{tick:g}" for tick in ticks_x])
        axes.set_xlim(left=-0.5)
    axes.set_title(name, fontsize=9)
    axes.set_xlabel(
        {RATE: "deg/s", WINDOWS: "deg/s that the windows are made for"}.get(name, f"{name} ({kind.unit})")
    )
    axes.grid(axis="y", alpha=0.4)


def _band(
    axes: Any, values: Sequence[float], margins: Sequence[Margin], colour: str, label: str, style: str
) -> None:
    left = [margin.left_ms(margin.time_ms.p99) for margin in margins]
    axes.fill_between(
        values,
        [item.low for item in left],
        [item.high for item in left],
        color=colour,
        alpha=0.25,
        linewidth=0,
    )
    # what may lie under another line is drawn wide and light
    look = {"markersize": 8, "linewidth": 4, "alpha": 0.55} if style == BENEATH else {"markersize": 4}
    axes.plot(values, [item.value for item in left], style, color=colour, label=label, **look)


def draw_stages(figure: Any, assessment: Assessment) -> None:
    """Time by stage: median, 99th percentile and the most found, with its bounds, in both modes."""
    panels = figure.subplots(1, 2, sharey=True)
    ms = assessment.costing.ms
    for axes, mode in zip(panels, (LOST_IN_SPACE, TRACKING), strict=True):
        rows = (assessment.lost if mode == LOST_IN_SPACE else assessment.tracked).flown.rows
        for number, stage in enumerate(STAGES):
            found = (
                ("median", ms(rows[stage].median), 0.26),
                ("p99", ms(rows[stage].p99), 0.0),
                ("worst found", ms(assessment.worst_stages[mode][stage]), -0.26),
            )
            for shade, (_, time, shift) in enumerate(found):
                at = len(STAGES) - 1 - number + shift
                axes.barh(at, time.value, height=0.24, color=STAGE_COLOURS[stage], alpha=0.45 + 0.27 * shade)
                axes.plot([time.low, time.high], [at, at], color=INK, linewidth=1)
        axes.set_yticks(range(len(STAGES)), list(reversed(STAGES)))
        axes.set_title(f"{mode}, as flown", fontsize=9)
        axes.set_xlabel("ms: median, p99, most found in any frame; line: bounds")
        axes.grid(axis="x", alpha=0.4)


def draw_all(figure: Any, assessment: Assessment) -> None:
    """Timelines above, margins below: the plot of the command line."""
    own = [line for line in timelines(assessment) if line.own]
    above, below = figure.subfigures(2, 1, height_ratios=(1.15, 1.0))
    for part in (above, below):
        part.set_facecolor(STYLE["figure.facecolor"])
    draw_timelines(above, own)
    draw_margins(below, assessment)
    subject = assessment.subject
    figure.suptitle(
        f"{subject.profile.name}: {assessment.verdict.word}, {subject.processor.clock_hz / 1e6:g} MHz, "
        f"caches {subject.processor.cache_kib} KiB, line fill {subject.processor.line_fill}"
    )


def write_plot(path: Path, assessment: Assessment) -> None:
    """Draw timelines and margins. ConfigurationError: the file cannot be written."""
    try:
        _drawn(lambda figure: draw_all(figure, assessment), (12.5, 10.5), path)
    except OSError as error:
        raise ConfigurationError(f"--plot {path}: cannot be written: {error.strerror}") from error


def svg(draw: Callable[[Any], None], size: tuple[float, float]) -> bytes:
    """A drawing as SVG, the same bytes each time."""
    buffer = io.BytesIO()
    _drawn(draw, size, buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def _drawn(draw: Callable[[Any], None], size: tuple[float, float], target: Any, **options: Any) -> None:
    with plt.rc_context({**STYLE, "svg.hashsalt": "st-emulator"}):
        figure = plt.figure(figsize=size, layout="constrained")
        try:
            draw(figure)
            figure.savefig(target, dpi=DPI, **options)
        finally:
            plt.close(figure)


__all__ = ["draw_all", "draw_margins", "draw_stages", "draw_timelines", "svg", "write_plot"]
