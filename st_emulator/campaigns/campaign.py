"""What a campaign is asked for and what it gives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ..profile import UnitProfile
from ..report import Check
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
    """Figures for JSON and the table, and the checks they are held to."""

    figures: dict[str, Any]
    checks: list[Check] = field(default_factory=list)
