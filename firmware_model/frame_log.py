"""The record of a frame's steps: where their work is summed, and who looks on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from .frame_trace import StepRecord, Trace
from .work import Work

__all__ = ["FrameLog"]

ResultT = TypeVar("ResultT")


@dataclass(frozen=True)
class FrameLog:
    """Where the steps of one frame put their work, and who looks on."""

    work: Work
    trace: Trace | None

    def run(self, name: str, function: Callable[..., tuple[ResultT, Work]], **arguments: Any) -> ResultT:
        """Run a step of ``frame_trace.STEPS``, count its work and show it to the trace."""
        result, work = function(**arguments)
        self.step(name, arguments, result, work)
        return result

    def count(self, work: Work) -> None:
        """Count what belongs to no step of its own."""
        total = self.work
        total += work

    def step(self, name: str, arguments: Mapping[str, Any], result: Any, work: Work) -> None:
        """Count a step's work and show it to the trace."""
        total = self.work
        total += work
        if self.trace is not None:
            self.trace(StepRecord(name, dict(arguments), result, work))
