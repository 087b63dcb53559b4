"""What a campaign is asked for and what it gives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ..report import Check, TextTable
from ..units.profile import UnitProfile
from .workers import Workers


@dataclass(frozen=True)
class CampaignRequest:
    """What a campaign is asked for."""

    profile: UnitProfile
    n: int
    seed: int
    workers: Workers


@dataclass
class CampaignResult:
    """Figures for JSON and the table, and the checks they are held to.

    figures: the same for the same request, however it was run. timing: what depends on the computer. tables:
    printed after the figures, the source's beside ours. draw: draws the plot on an empty matplotlib figure.
    """

    figures: dict[str, Any]
    checks: list[Check] = field(default_factory=list)
    tables: list[TextTable] = field(default_factory=list)
    timing: dict[str, Any] = field(default_factory=dict)
    draw: Callable[[Any], None] | None = None
