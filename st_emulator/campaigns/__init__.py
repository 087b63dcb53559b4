"""Campaigns: a unit measured over many skies, against its targets."""

from .registry import CAMPAIGNS, run_campaign

__all__ = ["CAMPAIGNS", "run_campaign"]
