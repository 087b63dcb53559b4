"""Faults of the processor."""

from __future__ import annotations

from typing import Final

from .fault import FaultKind

KINDS: Final[tuple[FaultKind, ...]] = ()
