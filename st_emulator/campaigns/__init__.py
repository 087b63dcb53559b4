"""Campaigns: a unit measured over many skies, against its targets."""
