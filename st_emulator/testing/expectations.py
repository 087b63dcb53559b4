"""Expectations with time: what must come, what must not, told in a line a person understands."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Callable
from typing import Any

from ..clock import NS_PER_S
from .clock import BenchClock
from .errors import ExpectationError

Condition = Callable[[], Any]
LONGEST_TEXT = 200


def condition_text(condition: Condition) -> str:
    """What a condition says: the body of a lambda as it stands in the test, the name of a function."""
    name = getattr(condition, "__name__", type(condition).__name__)
    if name != "<lambda>":
        return str(getattr(condition, "__qualname__", name)).rpartition("<locals>.")[2]
    try:
        source = textwrap.dedent(inspect.getsource(condition))
    except (OSError, TypeError):
        return "the condition"
    return _lambda_body(source)[:LONGEST_TEXT]


def _lambda_body(source: str) -> str:
    try:
        found = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Lambda)]
    except SyntaxError:  # a piece of a longer statement
        found = []
    if len(found) == 1:
        return " ".join((ast.get_source_segment(source, found[0].body) or "").split())
    # Of several on a line nobody can tell which it was.
    match = re.search(r"lambda\s*:\s*(.*)", " ".join(source.split())) if not found else None
    return match.group(1).rstrip(" ),") if match else " ".join(source.split())


class Expectations:
    """Lets the time of a bench go on until something holds.

    ``state`` tells what the units are doing, for the message of a failure.
    """

    def __init__(self, clock: BenchClock, state: Callable[[], str]) -> None:
        self._clock = clock
        self._state = state

    @property
    def now_ns(self) -> int:
        """Nanoseconds since the bench was made."""
        return self._clock.now_ns

    def run(self, seconds: float) -> None:
        """Let so much time pass."""
        self._clock.run_until(lambda: False, self._after(seconds))

    def run_until(self, condition: Condition, limit_s: float) -> bool:
        """Let time go on until ``condition()`` holds, at most ``limit_s``; whether it did."""
        return self._clock.run_until(condition, self._after(limit_s))

    def within(self, seconds: float, condition: Condition) -> float:
        """``condition()`` must hold within ``seconds``; how many it took.

        Raises:
            ExpectationError: it did not.
        """
        __tracebackhide__ = True
        begun_ns = self._clock.now_ns
        self._await(condition, seconds, f"not within {seconds:g} s")
        return (self._clock.now_ns - begun_ns) / NS_PER_S

    def until(self, condition: Condition, limit_s: float = 60.0) -> Any:
        """Wait until ``condition()`` holds; what it returned. ``limit_s`` only bounds a hang.

        Raises:
            ExpectationError: it did not hold by then.
        """
        __tracebackhide__ = True
        return self._await(condition, limit_s, f"waited {limit_s:g} s in vain")

    def never(self, condition: Condition, *, for_s: float) -> None:
        """``condition()`` must not hold at any event of the next ``for_s`` seconds.

        Raises:
            ExpectationError: it did, as soon as it did.
        """
        __tracebackhide__ = True
        begun_ns = self._clock.now_ns
        if self._clock.run_until(condition, self._after(for_s)):
            after_s = (self._clock.now_ns - begun_ns) / NS_PER_S
            raise ExpectationError(
                f"after {after_s:.6f} s, which must never be within {for_s:g} s: "
                f"{condition_text(condition)}\n  {self._span(begun_ns)}"
            )

    def _await(self, condition: Condition, seconds: float, what: str) -> Any:
        __tracebackhide__ = True
        begun_ns = self._clock.now_ns
        result: Any = None

        def holds() -> Any:
            nonlocal result
            result = condition()
            return result

        if not self._clock.run_until(holds, self._after(seconds)):
            raise ExpectationError(f"{what}: {condition_text(condition)}\n  {self._span(begun_ns)}")
        return result

    def _after(self, seconds: float) -> int:
        if not 0 <= seconds < 10**9:
            raise ValueError(f"{seconds} s: allowed is a time from 0 to 1e9 seconds")
        return self._clock.now_ns + round(seconds * NS_PER_S)

    def _span(self, begun_ns: int) -> str:
        at = f"looked from {begun_ns / NS_PER_S:.3f} s to {self._clock.now_ns / NS_PER_S:.3f} s"
        return f"{at}; {self._state()}"
