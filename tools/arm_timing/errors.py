"""What is wrong with an ARM program, or with how it ran."""

from __future__ import annotations


class ArmError(Exception):
    """A program that cannot be loaded or run as ARM926EJ-S code; the message says where (pc and symbol)."""
