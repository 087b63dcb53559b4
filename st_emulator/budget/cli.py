"""The command ``st-emulator budget``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console


def budget(
    unit: Annotated[
        str, typer.Argument(help="A shipped unit (see `st-emulator units`) or the path of a unit file.")
    ],
    scenario: Annotated[
        Path | None,
        typer.Option(
            "--scenario",
            metavar="FILE",
            help="Take sky, trajectory and parameters of a scenario (TOML) instead of random skies at rest.",
        ),
    ] = None,
    n: Annotated[int, typer.Option("--n", min=1, help="Skies; each point of a sweep has a fifth.")] = 400,
    seed: Annotated[
        int, typer.Option("--seed", min=0, help="Seed of the skies and of the search for the worst.")
    ] = 1,
    evaluations: Annotated[
        int,
        typer.Option(
            "--evaluations", metavar="N", min=1, help="Skies that the search for the worst frame tries."
        ),
    ] = 900,
    clock: Annotated[
        int | None,
        typer.Option("--clock", metavar="HZ", help="Clock of the processor instead of the unit's."),
    ] = None,
    cache: Annotated[
        int | None,
        typer.Option(
            "--cache", metavar="KIB", help="Size of each cache instead of the unit's; 0: caches off."
        ),
    ] = None,
    line_fill: Annotated[
        str | None,
        typer.Option(
            "--line-fill",
            metavar="low|nominal|high",
            help="How long the memory takes to fill a line of the caches, instead of the unit's.",
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option("--workers", "--jobs", min=1, help="Processes; default: one a core.")
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option("--dask", metavar="ADDRESS", help="Run on the Dask cluster of this scheduler."),
    ] = None,
    results: Annotated[
        Path | None,
        typer.Option(
            "--results",
            metavar="FILE",
            help="Frames that are through (JSON lines): a run with the same file goes on where it was "
            "stopped. Default: a file of the user's state folder, deleted at the end.",
        ),
    ] = None,
    restart: Annotated[
        bool, typer.Option("--restart", help="Begin anew where a stopped run would be gone on with.")
    ] = False,
    json_path: Annotated[
        str | None,
        typer.Option("--json", metavar="FILE", help="Write every figure as JSON (- for standard output)."),
    ] = None,
    html: Annotated[
        Path | None, typer.Option("--html", metavar="FILE", help="Write one page with pictures and tables.")
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            "--plot", metavar="FILE", help="Draw a frame's timeline and the margins (PNG, SVG, PDF, JPG)."
        ),
    ] = None,
    rerun: Annotated[
        Path | None,
        typer.Option(
            "--rerun",
            metavar="FILE",
            help="Only run the worst frames of a report (`--json`) again and compare their cycles.",
        ),
    ] = None,
) -> None:
    """Does a unit fit its frame period and its memory: cycles by stage, margins, what breaks first, the worst
    frame.

    Every figure stands with its bounds. Exit status: 0 where the unit fits at the nominal cost (what does not
    at the upper bound is told), 1 where it does not, 2 for input that cannot be used. With `--rerun`: 0 where
    the cycles are the same, 1 where they are not.
    """
    from .running import BudgetOptions, run_budget

    options = BudgetOptions(
        unit=unit,
        scenario=scenario,
        n=n,
        seed=seed,
        evaluations=evaluations,
        clock_hz=clock,
        cache_kib=cache,
        line_fill=line_fill,
        workers=workers,
        dask=dask,
        results=results,
        restart=restart,
        json_path=json_path,
        html=html,
        plot=plot,
        rerun=rerun,
    )
    raise typer.Exit(run_budget(options, Console(stderr=json_path == "-")))


__all__ = ["budget"]
