"""Does it fit: what is required of a unit, what breaks first, and the clock at which all of it would hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..firmware_model.work import STAGES
from .figures import Cost, Figure
from .least_clock import LeastClock
from .subject import Subject

FITS_NOT_EVERY_FRAME = "does not fit in every frame (the skies do, the worst frame found does not)"


@dataclass(frozen=True)
class Requirement:
    """Frames of a mode that have to be on time.

    time_ms: what of them is held to the budget, as ``statistic`` says. stage: the heaviest of that frame.
    clock: from which on the requirement is met. sought: of frames found by the search for the worst one.
    """

    name: str
    mode: str
    statistic: str
    time_ms: Figure
    budget_ms: float
    stage: str
    clock: LeastClock
    sought: bool = False

    @property
    def fits(self) -> bool:
        """At the nominal cost."""
        return self.budget_ms > 0 and self.time_ms.value <= self.budget_ms

    @property
    def fits_at_bound(self) -> bool:
        """At the highest cost."""
        return self.budget_ms > 0 and self.time_ms.high <= self.budget_ms

    @property
    def margin_ms(self) -> Figure:
        return Figure(
            self.budget_ms - self.time_ms.value,
            self.budget_ms - self.time_ms.high,
            self.budget_ms - self.time_ms.low,
        )

    def as_dict(self) -> dict[str, object]:
        return {
            "name": self.name,
            "mode": self.mode,
            "statistic": self.statistic,
            "time_ms": self.time_ms.as_dict(),
            "budget_ms": self.budget_ms,
            "margin_ms": self.margin_ms.as_dict(),
            "stage": self.stage,
            "least_clock": self.clock.as_dict(),
            "fits": self.fits,
            "fits_at_bound": self.fits_at_bound,
        }


@dataclass(frozen=True)
class Verdict:
    """All requirements together. breaks_first: the one that needs the highest clock."""

    requirements: tuple[Requirement, ...]
    breaks_first: Requirement
    clock: LeastClock

    @property
    def fits(self) -> bool:
        """Every requirement holds at the nominal cost."""
        return all(item.fits for item in self.requirements)

    @property
    def fits_at_bound(self) -> bool:
        """Every requirement holds at the highest cost that the model allows."""
        return all(item.fits_at_bound for item in self.requirements)

    @property
    def word(self) -> str:
        """``fits``, ``fits, but not at the upper bound``, ``does not fit``, or that all does but what the
        search has found."""
        late = [item for item in self.requirements if not item.fits]
        if late:
            return "does not fit" if any(not item.sought for item in late) else FITS_NOT_EVERY_FRAME
        return "fits" if self.fits_at_bound else "fits, but not at the upper bound of the cost"

    def text(self, subject: Subject) -> str:
        """The answer in a sentence or two."""
        first = self.breaks_first
        clock_mhz = subject.processor.clock_hz / 1e6
        late = [item.name for item in self.requirements if not item.fits]
        unsure = [item.name for item in self.requirements if item.fits and not item.fits_at_bound]
        sentence = (
            f"{subject.profile.name} {self.word}. A frame has {first.budget_ms:g} ms at {clock_mhz:g} MHz, "
            f"caches {subject.processor.cache_kib} KiB, line fill {subject.processor.line_fill}."
        )
        if late:
            sentence += f" Late: {'; '.join(late)}."
        if unsure:
            sentence += f" Late at the upper bound: {'; '.join(unsure)}."
        when = " as the clock falls" if self.fits else ""
        return sentence + (
            f" What breaks first{when}: {first.name}, stage {first.stage}; all of it fits from "
            f"{self.clock.text()} on."
        )

    def as_dict(self) -> dict[str, object]:
        return {
            "fits": self.fits,
            "fits_at_bound": self.fits_at_bound,
            "word": self.word,
            "breaks_first": {
                "requirement": self.breaks_first.name,
                "mode": self.breaks_first.mode,
                "stage": self.breaks_first.stage,
            },
            "least_clock": self.clock.as_dict(),
            "requirements": [item.as_dict() for item in self.requirements],
        }


def verdict_of(requirements: Sequence[Requirement]) -> Verdict:
    """The verdict on requirements; ValueError without any."""
    if not requirements:
        raise ValueError("nothing is required")

    def largest(which: str) -> float | None:
        found = [getattr(item.clock, which) for item in requirements]
        return None if None in found else max(found)

    first = max(requirements, key=lambda item: _infinite(item.clock.nominal_hz))
    clock = LeastClock(largest("low_hz"), largest("nominal_hz"), largest("high_hz"))
    return Verdict(tuple(requirements), first, clock)


def heaviest_stage(cost: Cost) -> str:
    """The stage of a frame that takes most."""
    return max(STAGES, key=lambda stage: cost.by_row[stage].value)


def _infinite(hz: float | None) -> float:
    return float("inf") if hz is None else hz
