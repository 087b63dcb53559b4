"""What a command of the OBC's shell works on, and how its words become numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..report import Check
from .client import Obc
from .watching import watch


class CommandError(Exception):
    """A line that is no command; one line that says what is wrong and what is allowed."""


class NotHeldError(Exception):
    """What a command was to see did not hold."""


@dataclass
class Desk:
    """What a command works on: the OBC, a way to tell the user, and the checks made so far."""

    obc: Obc
    say: Callable[[str], None]
    checks: list[Check]
    watch: Callable[[Obc, float | None], None] = watch


Action = Callable[[Desk], None]
Arguments = Sequence[str]


def number(text: str, what: str, low: float, high: float) -> float:
    """A number in a range; ValueError says so."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not low <= value <= high:
        raise ValueError(f"{what} is {text!r}; allowed are {low:g} to {high:g}")
    return value


def whole(text: str, what: str, low: int, high: int) -> int:
    """A whole number in a range, also as 0x..; ValueError says so."""
    try:
        value = int(text, 0)
    except ValueError:
        value = low - 1
    if not low <= value <= high:
        raise ValueError(f"{what} is {text!r}; allowed are {low} to {high}")
    return value


def octets(text: str) -> bytes:
    """Octets from hexadecimal text; ValueError says so."""
    try:
        return bytes.fromhex(text)
    except ValueError:
        raise ValueError(f"{text!r} is no hexadecimal text of whole octets") from None
