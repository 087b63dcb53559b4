"""A budget's tables in full width, for its page."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from ..campaigns.confidence import share
from ..report import TextTable
from .assessment import Assessment
from .figures import ROWS, Figure
from .margins import Margin
from .memory import MIB
from .modes import LOST_IN_SPACE, TRACKING, LostResult, TrackedResult
from .sweeps import FALSE_STARS, KINDS, RATE, PointResult


def cycle_table(assessment: Assessment, mode: str) -> TextTable:
    """Cycles by stage of a mode, as flown."""
    result: LostResult | TrackedResult = assessment.lost if mode == LOST_IN_SPACE else assessment.tracked
    rows = []
    budget = assessment.subject.cycle_budget(assessment.subject.pipelined).cycles
    for row in ROWS:
        found = result.flown.rows[row]
        most = assessment.worst_stages[mode][row]
        rows.append(
            (
                row,
                mega(found.median),
                mega(found.p99),
                mega(found.worst),
                mega(most),
                percent(most, budget),
            )
        )
    return TextTable(
        f"{mode}: million cycles by stage, as flown, {result.frames} frames (lower..upper bound)",
        ("stage", "median", "p99", "worst of the skies", "worst found", "of the budget"),
        tuple(rows),
    )


def margin_table(assessment: Assessment) -> TextTable:
    """Margins of the random frames, pipelined and not."""
    own = assessment.subject.pipelined
    lost, tracked = assessment.lost, assessment.tracked
    rows = []
    for title, pipelined, margin in (
        (LOST_IN_SPACE, own, lost.flown.margin),
        (f"{LOST_IN_SPACE}, no limit", own, lost.whole.margin),
        (TRACKING, own, tracked.flown.margin),
        (LOST_IN_SPACE, not own, lost.other),
        (TRACKING, not own, tracked.other),
    ):
        rows.append(
            (
                title,
                "yes" if pipelined else "no",
                f"{margin.budget_ms:g}",
                margin.left_ms(margin.time_ms.p99).text(),
                margin.left_ms(margin.time_ms.worst).text(),
                late_text(margin),
                count_text(margin.late.dropped),
            )
        )
    return TextTable(
        "Margin in ms against the time a frame has (lower..upper bound)",
        ("mode", "pipelined", "has", "at p99", "at the worst", "late (95 %)", "dropped"),
        tuple(rows),
    )


def late_text(margin: Margin) -> str:
    """``0 of 400 (0.0-1.0 %)``, at the bounds where they differ."""
    late = margin.late
    found = share(int(late.late.value), late.frames)
    return f"{count_text(late.late)} of {late.frames} ({found.interval(1)} %)"


def sweep_table(assessment: Assessment, name: str) -> TextTable:
    """One sweep: p99 of time and margin, in its modes."""
    kind = KINDS[name]
    points = assessment.sweeps[name]
    columns = [f"{name}, {kind.unit}"]
    if LOST_IN_SPACE in kind.modes:
        columns += ["lost in space p99", "no limit p99", "margin", "cut short", "found"]
    if TRACKING in kind.modes:
        columns += ["tracking p99", "margin", "late", "found"]
    if name not in (FALSE_STARS, RATE):
        columns.append("window, px")
    rows = []
    for point in points:
        row = [f"{point.value:g}"]
        if LOST_IN_SPACE in kind.modes:
            row += _lost_cells(point.lost)
        if TRACKING in kind.modes:
            row += _tracked_cells(point, name)
        if name not in (FALSE_STARS, RATE):
            row.append(str(2 * point.tracked.half_width_px + 1))
        rows.append(tuple(row))
    return TextTable(f"{name}: {kind.meaning}; ms (lower..upper bound)", tuple(columns), tuple(rows))


def _lost_cells(lost: LostResult) -> list[str]:
    flown, whole = lost.flown.margin, lost.whole.margin
    return [
        flown.time_ms.p99.text(),
        whole.time_ms.p99.text(),
        whole.left_ms(whole.time_ms.p99).text(),
        f"{lost.limited}/{lost.frames}",
        f"{lost.valid}/{lost.frames}",
    ]


def _tracked_cells(point: PointResult, name: str) -> list[str]:
    tracked = point.tracked
    margin = tracked.flown.margin
    if name == RATE and not point.holds:
        return ["does not hold", "", "", f"{tracked.valid}/{tracked.frames}"]
    return [
        margin.time_ms.p99.text(),
        margin.left_ms(margin.time_ms.p99).text(),
        count_text(margin.late.late),
        f"{tracked.valid}/{tracked.frames}",
    ]


def stop_table(assessment: Assessment) -> TextTable:
    """Where each sweep stops fitting."""
    rows = tuple((row.sweep, row.title, row.text(), row.stop.stage or "") for row in assessment.stops)
    return TextTable(
        "Where the 99th percentile stops fitting", ("sweep", "mode", "fits", "stage that grew"), rows
    )


def requirement_table(assessment: Assessment) -> TextTable:
    """What is required, and the clock that each needs."""
    rows = []
    for item in assessment.verdict.requirements:
        word = "fits" if item.fits_at_bound else "not at the bound" if item.fits else "late"
        rows.append(
            (
                item.name,
                item.statistic,
                item.time_ms.text(),
                item.margin_ms.text(),
                item.stage,
                item.clock.text(),
                word,
            )
        )
    return TextTable(
        "Requirements (lower..upper bound)",
        ("frames", "statistic", "time, ms", "margin, ms", "heaviest stage", "fits from", ""),
        tuple(rows),
    )


def worst_table(assessment: Assessment) -> TextTable:
    """What the search for the worst frame found."""
    rows = []
    for case in assessment.worst:
        place = asdict(case.place)
        what = ", ".join(f"{name} {_short(value)}" for name, value in place.items() if value is not None)
        rows.append(
            (
                case.objective.title,
                mega(case.before),
                mega(case.cost.frame),
                assessment.costing.ms(case.cost.frame).text(),
                str(case.evaluations),
                what,
            )
        )
    return TextTable(
        "Worst frames found by search, million cycles (lower..upper bound)",
        ("frames", "before", "found", "ms", "tried", "place"),
        tuple(rows),
    )


def memory_table(assessment: Assessment) -> TextTable:
    """Where the memory goes."""
    memory = assessment.memory
    rows = [
        (item.group, item.name, f"{item.nbytes / MIB:.3f}", item.basis, item.remark) for item in memory.items
    ]
    total = (
        f"{memory.total_bytes / MIB:.2f} ({(memory.total_bytes - memory.assumed_bytes) / MIB:.2f}.."
        f"{(memory.total_bytes + memory.assumed_bytes) / MIB:.2f})"
    )
    word = "fits" if memory.fits else "does not fit"
    rows.append(
        ("total", f"of {memory.available_bytes / MIB:g} MiB: {word}", total, "", "assumed: 0 to twice")
    )
    return TextTable("Memory, MiB", ("group", "what", "MiB", "known by", "remark"), tuple(rows))


def mega(cycles: Figure) -> str:
    return cycles.scaled(1e-6).text()


def percent(cycles: Figure, budget: float) -> str:
    return "none left" if budget <= 0 else f"{cycles.scaled(100.0 / budget).text()} %"


def count_text(count: Figure) -> str:
    """A number of frames, with the numbers at the bounds where they differ."""
    if count.low == count.high:
        return f"{count.value:.0f}"
    return f"{count.value:.0f} ({count.low:.0f}..{count.high:.0f})"


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, (tuple, list)):
        return "[" + " ".join(_short(item) for item in value) + "]"
    return str(value)
