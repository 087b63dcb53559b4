"""What the search for the worst frame may change, and how it does."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..bench.scenario import Scenario
from ..world import quaternion
from .modes import LOST_IN_SPACE
from .samples import Instant
from .scenes import Conditions
from .subject import Subject
from .sweeps import MOST_FALSE_STARS, MOST_RATE_DEG_S, most_lost, scenario_frame_count

MAGNITUDES = (0.0, 8.0)  # of false stars, the brightest and the faintest that the search tries
HOT_PIXEL_FACTORS = (3.0, 10.0)  # times the unit's share, which grows with the dose
LEAST_HOT_PIXEL_FRACTION = 1e-5
NOISES = 1_000_000
GENES = (
    *("attitude", "attitude", "roll", "rate", "false stars", "false stars"),
    *("magnitudes", "noise", "stray light", "hot pixels"),
)
FRESH = 0.1  # share of the changes of an attitude or a time that are not small


@dataclass(frozen=True)
class Domain:
    """Limits of what is changed. most_rate_deg_s: about any axis. stray_electrons_s: from, to.
    hot_pixel_fractions: besides the unit's. frames, period_ns: of the scenario, 0 without one."""

    most_rate_deg_s: float
    most_false_stars: int
    stray_electrons_s: tuple[float, float]
    hot_pixel_fractions: tuple[float, ...]
    most_frames_lost: int
    frames: int
    period_ns: int

    def holds(self, place: Conditions | Instant) -> bool:
        """Whether the search may start from a place."""
        if isinstance(place, Instant):
            return place.false_stars is None and place.frames_lost <= self.most_frames_lost
        rate = math.sqrt(sum(item * item for item in place.rate_deg_s))
        return (
            rate <= self.most_rate_deg_s * (1 + 1e-9)
            and place.false_stars <= self.most_false_stars
            and place.frames_lost <= self.most_frames_lost
        )

    def text(self) -> str:
        """In words."""
        if self.frames:
            lost = f"0 to {self.most_frames_lost} frames lost"
            return f"any of {self.frames} frames of the scenario, noise, {lost}"
        fractions = ", ".join(f"{item:g}" for item in self.hot_pixel_fractions)
        stray = " to ".join(f"{item:g}" for item in self.stray_electrons_s)
        magnitudes = " to ".join(f"{item:g}" for item in MAGNITUDES)
        return (
            f"attitude, roll, rate to {self.most_rate_deg_s:g} deg/s about any axis, 0 to "
            f"{self.most_false_stars} false stars of {magnitudes} mag at places by seed, noise, stray light "
            f"{stray} e-/s, hot pixels: the unit's share or {fractions}; 0 to {self.most_frames_lost} frames "
            "lost"
        )


def domain_of(subject: Subject, mode: str, scenario: Scenario | None) -> Domain:
    """What a unit may meet: stray light to that at the edge of its exclusion angles, and in tracking rates
    that its windows are made for."""
    lost = mode == LOST_IN_SPACE
    detector = subject.profile.detector
    share = max(detector.hot_pixel_fraction, LEAST_HOT_PIXEL_FRACTION)
    return Domain(
        most_rate_deg_s=MOST_RATE_DEG_S
        if lost
        else min(MOST_RATE_DEG_S, float(subject.parameters["tracking_rate_deg_s"])),
        most_false_stars=MOST_FALSE_STARS,
        stray_electrons_s=(
            detector.stray_electrons_s,
            detector.stray_electrons_s + subject.profile.exclusion.stray_electrons_s_at_edge,
        ),
        hot_pixel_fractions=tuple(min(0.1, share * factor) for factor in HOT_PIXEL_FACTORS),
        most_frames_lost=0 if lost else most_lost(subject),
        frames=0 if scenario is None else scenario_frame_count(subject, scenario),
        period_ns=subject.period_ns,
    )


def mutated(rng: np.random.Generator, place: Conditions | Instant, domain: Domain) -> Conditions | Instant:
    """A place with one or two of its figures changed."""
    for _ in range(1 + int(rng.random() < 0.3)):
        if isinstance(place, Instant):
            place = _other_instant(rng, place, domain)
        else:
            place = replace(place, **_changes(rng, place, domain))
    return place


def _other_instant(rng: np.random.Generator, place: Instant, domain: Domain) -> Instant:
    gene = rng.integers(3)
    if gene == 0:
        return replace(place, number=int(rng.integers(NOISES)))
    if gene == 1:
        return replace(place, frames_lost=int(rng.integers(domain.most_frames_lost + 1)))
    at = place.start_ns // domain.period_ns
    if rng.random() < FRESH:
        at = int(rng.integers(domain.frames))
    else:
        reach = max(1, round(domain.frames ** rng.random()))
        at = int(np.clip(at + rng.integers(-reach, reach + 1), 0, domain.frames - 1))
    return replace(place, start_ns=at * domain.period_ns)


def _changes(rng: np.random.Generator, place: Conditions, domain: Domain) -> dict[str, Any]:
    genes = GENES + (("frames lost",) * 2 if domain.most_frames_lost else ())
    match genes[int(rng.integers(len(genes)))]:
        case "attitude":
            return {"attitude": _turned(rng, place.attitude)}
        case "roll":
            roll = quaternion.from_rotation_vector(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
            return {"attitude": _tuple(quaternion.multiply(roll, np.array(place.attitude)))}
        case "rate":
            axis = rng.normal(size=3)
            size = domain.most_rate_deg_s * rng.choice([0.0, rng.random(), 1.0])
            return {"rate_deg_s": _tuple(axis / np.linalg.norm(axis) * size)}
        case "false stars":
            number = place.false_stars * math.exp(0.5 * rng.normal()) + 10.0 * rng.normal()
            return {"false_stars": int(np.clip(round(number), 0, domain.most_false_stars))}
        case "magnitudes":
            first, second = sorted(rng.uniform(*MAGNITUDES, size=2).tolist())
            return {"false_star_magnitudes": (first, second)}
        case "noise":
            return {"noise": int(rng.integers(NOISES))}
        case "stray light":
            low, high = domain.stray_electrons_s
            return {"stray_electrons_s": None if rng.random() < 0.3 else float(rng.uniform(low, high))}
        case "frames lost":
            return {"frames_lost": int(rng.integers(domain.most_frames_lost + 1))}
        case _:
            choices = (None, *domain.hot_pixel_fractions)
            return {"hot_pixel_fraction": choices[int(rng.integers(len(choices)))]}


def _turned(rng: np.random.Generator, attitude: tuple[float, ...]) -> tuple[float, ...]:
    """A little, by an angle of any size from 1e-4 rad on; now and then anywhere."""
    if rng.random() < FRESH:
        q = rng.normal(size=4)
        return _tuple(q / np.linalg.norm(q))
    axis = rng.normal(size=3)
    angle = 10.0 ** rng.uniform(-4.0, 0.0)
    turn = quaternion.from_rotation_vector(axis / np.linalg.norm(axis) * angle)
    return _tuple(quaternion.multiply(turn, np.array(attitude)))


def _tuple(values: Any) -> tuple[float, ...]:
    return tuple(float(item) + 0.0 for item in values)  # no zero with a sign
