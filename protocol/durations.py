"""Nanoseconds in other units of time."""

from __future__ import annotations

NS_PER_S = 1_000_000_000
NS_PER_US = 1_000
