"""The campaigns by name, and how one is run: progress, tables, JSON, exit status."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from rich.console import Console

from ..errors import ConfigurationError
from ..profile import load_unit
from ..report import all_hold, require_json_path, show_checks, show_figures, write_json
from ..scenario import Scenario
from ..scenario_inputs import check_inputs
from .campaign import CampaignRequest, CampaignResult
from .workers import Progress, Workers


@dataclass(frozen=True)
class Campaign:
    """A campaign: what it measures, its default number of cases, and the function that runs it."""

    title: str
    default_n: int
    run: Callable[[CampaignRequest], CampaignResult]


def campaigns() -> dict[str, Campaign]:
    """All campaigns by name."""
    # Imported here: the command line's help needs none of it.
    from . import accuracy, earth_rate, lost_in_space, single_stars, star_quadruples, tracking_rate

    return {
        "accuracy": Campaign("attitude error over seeded pointings", 100, accuracy.run),
        "centroids": Campaign("centroid error by magnitude, at rest", 200, single_stars.run_centroids),
        "detection": Campaign(
            "detection probability by magnitude, false clusters", 400, single_stars.run_detection
        ),
        "earth-rate": Campaign("the Earth's rotation from telemetered attitudes", 200, earth_rate.run),
        "lost-in-space": Campaign("lost in space over random pointings", 1000, lost_in_space.run),
        "star-quadruples": Campaign("the ROJA1 paper's real identifications", 3, star_quadruples.run),
        "tracking-rate": Campaign(
            "tracking at and over the largest rate, 26 directions", 26, tracking_rate.run
        ),
    }


CAMPAIGNS = (
    "accuracy",
    "centroids",
    "detection",
    "earth-rate",
    "lost-in-space",
    "star-quadruples",
    "tracking-rate",
)


def run_campaign(
    name: str,
    unit: str,
    n: int | None,
    seed: int,
    workers: int | None,
    json_path: str | None,
    console: Console,
) -> int:
    """Run a campaign; returns the exit status: 0 when every check holds, else 1."""
    if name not in CAMPAIGNS:
        raise ConfigurationError(f"no campaign '{name}': there are {', '.join(CAMPAIGNS)}")
    require_json_path(json_path)
    campaign = campaigns()[name]
    profile = load_unit(unit)
    check_inputs(profile, Scenario())
    count = n if n is not None else campaign.default_n
    started = time.perf_counter()
    with Progress(console, f"{name} {profile.name}") as progress:
        result = campaign.run(CampaignRequest(profile, count, seed, Workers(workers, progress)))
    figures = {
        "campaign": name,
        "unit": profile.name,
        "n": count,
        "seed": seed,
        **result.figures,
        "elapsed_s": round(time.perf_counter() - started, 3),
    }
    show_figures(console, campaign.title, figures)
    if result.checks:
        show_checks(console, result.checks)
    write_json(json_path, figures, result.checks)
    return 0 if all_hold(result.checks) else 1
