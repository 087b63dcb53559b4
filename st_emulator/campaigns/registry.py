"""The campaigns by name, and how one is run: progress, kept outcomes, tables, JSON, plot, exit status."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from ..bench.scenario import Scenario
from ..bench.scenario_inputs import check_inputs
from ..commands.state_folder import state_folder
from ..errors import ConfigurationError
from ..report import all_hold, require_json_path, show_checks, show_figures, show_table, write_json
from ..units.profile import load_unit
from .campaign import CampaignRequest, CampaignResult
from .results_file import ResultsFile, identity_hash, program_fingerprint
from .workers import Progress, Workers

DEFAULT_UNIT = "roja1"


@dataclass(frozen=True)
class Campaign:
    """A campaign: what it measures, its default number of cases, and the function that runs it.

    unit: the only one that it is of (None: any). spread: has cases for several workers, whose outcomes are
    kept. plots: draws a plot.
    """

    title: str
    default_n: int
    run: Callable[[CampaignRequest], CampaignResult]
    unit: str | None = None
    spread: bool = True
    plots: bool = False


@dataclass(frozen=True)
class CampaignOptions:
    """The options of the command line."""

    unit: str | None = None
    n: int | None = None
    seed: int = 1
    workers: int | None = None
    dask: str | None = None
    results: Path | None = None
    restart: bool = False
    json_path: str | None = None
    plot: Path | None = None


def campaigns() -> dict[str, Campaign]:
    """All campaigns by name."""
    # Imported here: the command line's help needs none of it.
    from . import (
        accuracy,
        aps,
        aps_figure12,
        catalogue_counts,
        earth_rate,
        false_stars,
        iris_tables,
        lost_in_space,
        single_stars,
        star_quadruples,
        straight_tracks,
        tracking_rate,
        zy3_table3,
    )

    return {
        "accuracy": Campaign("attitude error over seeded pointings", 100, accuracy.run),
        "aps": Campaign(
            "tables 3 to 13 of Schiattarella, Spiller and Curti 2020",
            200,
            aps.run,
            unit="aps_rs",
            plots=True,
        ),
        "aps-best": Campaign(
            "tables 3 to 9 of the same, without false objects",
            200,
            aps.run_best,
            unit="aps_rs",
            plots=True,
        ),
        "aps-figure12": Campaign(
            "figure 12 of Schiattarella et al. 2020: magnitudes over the rate",
            20,
            aps_figure12.run,
            unit="aps_rs",
            plots=True,
        ),
        "catalogue-counts": Campaign(
            "stars by magnitude and pairs of the catalogue", 1, catalogue_counts.run, spread=False, plots=True
        ),
        "centroids": Campaign("centroid error by magnitude, at rest", 200, single_stars.run_centroids),
        "detection": Campaign(
            "detection probability by magnitude, false clusters", 400, single_stars.run_detection
        ),
        "earth-rate": Campaign(
            "the Earth's rotation from telemetered attitudes", 200, earth_rate.run, spread=False
        ),
        "false-stars": Campaign(
            "identification among false stars", 200, false_stars.run, unit="zy3", plots=True
        ),
        "iris-tables": Campaign("tables 4 and 5 of Fasano et al. 2013", 10, iris_tables.run, unit="iris"),
        "lost-in-space": Campaign("lost in space over random pointings", 1000, lost_in_space.run),
        "star-quadruples": Campaign(
            "the ROJA1 paper's real identifications", 3, star_quadruples.run, spread=False
        ),
        "tracking-rate": Campaign(
            "tracking at and over the largest rate, 26 directions", 26, tracking_rate.run
        ),
        "zy3-centroids": Campaign(
            "centroids of stars on straight slews", 60, straight_tracks.run, unit="zy3", plots=True
        ),
        "zy3-table3": Campaign(
            "table 3 of Zhang et al. 2014", 10_000, zy3_table3.run, unit="zy3", plots=True
        ),
    }


CAMPAIGNS = (
    "accuracy",
    "aps",
    "aps-best",
    "aps-figure12",
    "catalogue-counts",
    "centroids",
    "detection",
    "earth-rate",
    "false-stars",
    "iris-tables",
    "lost-in-space",
    "star-quadruples",
    "tracking-rate",
    "zy3-centroids",
    "zy3-table3",
)


def run_campaign(name: str, options: CampaignOptions, console: Console) -> int:
    """Run a campaign; returns the exit status: 0 when every check holds, else 1."""
    if name not in CAMPAIGNS:
        raise ConfigurationError(f"no campaign '{name}': there are {', '.join(CAMPAIGNS)}")
    require_json_path(options.json_path)
    campaign = campaigns()[name]
    _require(name, campaign, options)
    profile = load_unit(options.unit or campaign.unit or DEFAULT_UNIT)
    check_inputs(profile, Scenario())
    count = options.n if options.n is not None else campaign.default_n
    identity = {"campaign": name, "unit": profile.model_dump_json(), "n": count, "seed": options.seed}
    identity["program"] = program_fingerprint()
    results = _results(name, profile.name, identity, options) if campaign.spread else None
    started = time.perf_counter()
    with Progress(console, f"{name} {profile.name}") as progress:
        workers = Workers(options.workers, progress, dask=options.dask, results=results)
        try:
            result = campaign.run(CampaignRequest(profile, count, options.seed, workers))
        except BaseException:
            if results is not None and results.usable and workers.done:
                where = f"{workers.done} cases are kept in {results.path}"
                console.print(
                    escape(f"stopped: {where}; the same command goes on from there"), soft_wrap=True
                )
            raise
    if workers.resumed:
        console.print(f"{workers.resumed} of {workers.done} cases were there from a run before")
    figures = {
        "campaign": name,
        "unit": profile.name,
        "n": count,
        "seed": options.seed,
        **result.figures,
        **({"timing": result.timing} if result.timing else {}),
        "elapsed_s": round(time.perf_counter() - started, 3),
    }
    show_figures(console, campaign.title, figures)
    for table in result.tables:
        show_table(console, table)
    if result.checks:
        show_checks(console, result.checks)
    if options.plot is not None and result.draw is not None:
        from .plotting import write_plot

        write_plot(options.plot, result.draw)
    write_json(options.json_path, figures, result.checks)
    if results is not None:
        results.finished()
    return 0 if all_hold(result.checks) else 1


def _require(name: str, campaign: Campaign, options: CampaignOptions) -> None:
    """Refuse options that this campaign has no use for. ConfigurationError says which."""
    if options.unit is not None and campaign.unit not in (None, options.unit):
        raise ConfigurationError(f"--unit {options.unit}: campaign {name} is of {campaign.unit} alone")
    if options.plot is not None:
        if not campaign.plots:
            drawn = [other for other, item in campaigns().items() if item.plots]
            raise ConfigurationError(
                f"--plot: campaign {name} draws no plot; there are plots of {', '.join(drawn)}"
            )
        from .plotting import require_plot_path

        require_plot_path(options.plot)
    if options.dask is not None and options.workers is not None:
        raise ConfigurationError("--workers: with --dask the cluster decides how many there are")
    if options.results is not None and options.restart:
        raise ConfigurationError("--restart: with --results delete the file, or give another")
    if not campaign.spread:
        for option, value in (("--dask", options.dask), ("--results", options.results)):
            if value is not None:
                raise ConfigurationError(f"{option}: campaign {name} is one run, it has no cases to spread")


def _results(name: str, unit: str, identity: dict[str, object], options: CampaignOptions) -> ResultsFile:
    """The file that the user named, else one of the user's state folder."""
    if options.results is not None:
        if options.results.is_dir():
            raise ConfigurationError(f"--results {options.results}: is a folder")
        if not options.results.absolute().parent.is_dir():
            raise ConfigurationError(f"--results {options.results}: there is no such folder")
        return ResultsFile(options.results, identity, named=True)
    path = state_folder() / "campaigns" / f"{name}-{unit}-{identity_hash(identity)}.jsonl"
    return ResultsFile(path, identity, named=False, fresh=options.restart)
