"""Faults of the line: octets of a serial line, and whole messages on any wire."""

from __future__ import annotations

from typing import Final

from . import line_messages, line_octets, line_signal
from .fault import FaultKind

KINDS: Final[tuple[FaultKind, ...]] = (*line_octets.KINDS, *line_messages.KINDS, *line_signal.KINDS)
