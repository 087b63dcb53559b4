"""A budget on a terminal of 80 columns: the same figures as on its page, in fewer columns."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape

from ..campaigns.confidence import share
from ..report import TextTable, show_table
from . import report
from .assessment import Assessment
from .figures import ROWS
from .margins import Margin
from .memory import MIB
from .modes import LOST_IN_SPACE, TRACKING, LostResult, TrackedResult
from .sweeps import KINDS, RATE
from .tables import count_text, mega
from .verdict import Requirement


def show(console: Console, assessment: Assessment) -> None:
    """Print the tables, what they hold and the verdict."""
    for table in (
        _cycles(assessment, LOST_IN_SPACE),
        _cycles(assessment, TRACKING),
        _margins(assessment),
        *(_sweep(assessment, name) for name in assessment.sweeps),
        _stops(assessment),
        _worst(assessment),
        _memory(assessment),
        _requirements(assessment),
    ):
        show_table(console, table)
    for text in (
        assessment.memory.paper.text(),
        report.conditions_text(assessment),
        report.uncertainty_text(assessment),
    ):
        console.print(escape(text))
    colour = "red"
    if report.fits(assessment):
        colour = "green" if assessment.verdict.fits_at_bound else "yellow"
    console.print(f"[bold {colour}]{escape(assessment.verdict.text(assessment.subject))}[/]")


def _cycles(assessment: Assessment, mode: str) -> TextTable:
    result: LostResult | TrackedResult = assessment.lost if mode == LOST_IN_SPACE else assessment.tracked
    rows = []
    for row in ROWS:
        found = result.flown.rows[row]
        worst = assessment.worst_stages[mode][row]
        rows.append((row, mega(found.median), mega(found.p99), mega(worst)))
    return TextTable(
        f"{mode}: million cycles as flown (lower..upper bound), {result.frames} frames and the search",
        ("stage", "median", "p99", "worst found"),
        tuple(rows),
    )


def _margins(assessment: Assessment) -> TextTable:
    own = assessment.subject.pipelined
    lost, tracked = assessment.lost, assessment.tracked
    rows = []
    for mode, pipelined, margin in (
        (LOST_IN_SPACE, own, lost.flown.margin),
        (TRACKING, own, tracked.flown.margin),
        (LOST_IN_SPACE, not own, lost.other),
        (TRACKING, not own, tracked.other),
    ):
        rows.append(
            (
                f"{mode}{'' if pipelined else ', not pipelined'}",
                f"{margin.budget_ms:g}",
                margin.left_ms(margin.time_ms.worst).text(),
                _late(margin),
                count_text(margin.late.dropped),
            )
        )
    return TextTable(
        "margin of the worst of the skies, ms (lower..upper bound); late with its 95 % interval",
        ("mode", "has", "margin", "late", "dropped"),
        tuple(rows),
    )


def _late(margin: Margin) -> str:
    late = margin.late
    found = share(int(late.late.value), late.frames)
    return f"{count_text(late.late)}/{late.frames}, {found.interval(1)} %"


def _sweep(assessment: Assessment, name: str) -> TextTable:
    kind = KINDS[name]
    lost = LOST_IN_SPACE in kind.modes
    columns = [kind.unit, *(("lost in space", "no limit", "cut") if lost else ()), "tracking"]
    columns += [] if lost else ["margin", "found", "window px"]
    rows = []
    for point in assessment.sweeps[name]:
        row = [f"{point.value:g}"]
        if lost:
            row += [
                point.lost.flown.margin.time_ms.p99.text(),
                point.lost.whole.margin.time_ms.p99.text(),
                str(point.lost.limited),
            ]
        margin = point.tracked.flown.margin
        held = name != RATE or point.holds
        row.append(margin.time_ms.p99.text() if held else "does not hold")
        if not lost:
            tracked = point.tracked
            row += [
                margin.left_ms(margin.time_ms.p99).text(),
                f"{tracked.valid}/{tracked.frames}",
                str(2 * tracked.half_width_px + 1),
            ]
        rows.append(tuple(row))
    cut = "; cut: searches that the budget ended" if lost else ""
    return TextTable(f"{name}: p99 of the time, ms (lower..upper bound){cut}", tuple(columns), tuple(rows))


def _stops(assessment: Assessment) -> TextTable:
    rows = tuple((f"{row.sweep}: {row.title}", row.text(), row.stop.stage or "") for row in assessment.stops)
    return TextTable("where the 99th percentile stops fitting", ("sweep", "fits", "stage that grew"), rows)


def _worst(assessment: Assessment) -> TextTable:
    rows = tuple(
        (
            case.objective.title,
            mega(case.before),
            mega(case.cost.frame),
            assessment.costing.ms(case.cost.frame).text(),
            str(case.evaluations),
        )
        for case in assessment.worst
    )
    return TextTable(
        "search for the worst frame, million cycles (lower..upper bound)",
        ("frames", "before", "found", "ms", "tried"),
        rows,
    )


def _memory(assessment: Assessment) -> TextTable:
    memory = assessment.memory
    rows = [(f"{item.name}", f"{item.nbytes / MIB:.3f}", item.basis) for item in memory.items]
    low, high = (memory.total_bytes + sign * memory.assumed_bytes for sign in (-1, 1))
    rows.append(
        (
            f"all, of {memory.available_bytes / MIB:g} MiB: {'fits' if memory.fits else 'does not fit'}",
            f"{memory.total_bytes / MIB:.2f} ({low / MIB:.2f}..{high / MIB:.2f})",
            "what is assumed: 0 to twice",
        )
    )
    return TextTable("memory, MiB", ("what", "MiB", "known by"), tuple(rows))


def _requirements(assessment: Assessment) -> TextTable:
    rows = tuple(
        (f"{item.name}, {item.statistic}", item.time_ms.text(), item.stage, item.clock.text(), word(item))
        for item in assessment.verdict.requirements
    )
    budget = assessment.verdict.breaks_first.budget_ms
    return TextTable(
        f"required: {budget:g} ms at most (lower..upper bound)",
        ("frames", "ms", "most in", "fits from", ""),
        rows,
    )


def word(item: Requirement) -> str:
    """Whether a requirement holds, in a word."""
    if not item.fits:
        return "late"
    return "fits" if item.fits_at_bound else "late at bound"
