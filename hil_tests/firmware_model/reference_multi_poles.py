"""Improved multi-poles written slowly and plainly: what the firmware's compiled loop must give.

Equation numbers are those of Schiattarella, Spiller & Curti 2020. All catalogue angles stand in one matrix.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hil_tests.firmware_model.reference_pyramid import angles, attitude, chance, match

Array = NDArray[np.float64]
Set = dict[int, int]  # spike -> star


@dataclass
class Image:
    """Spikes, catalogue, tolerances, and what was counted."""

    b: Array
    magnitudes: Array
    between: Array  # angles of all stars; inf for pairs that are not in the pair catalogue
    star_mag: Array
    tolerance: float
    tolerance_mag: float
    counted: Counter[str] = field(default_factory=Counter)


def pairs_of(image: Image, pole: int, neighbour: int) -> list[tuple[int, int]]:
    """(star of the pole, star of the neighbour) of the pairs that fit, (36) to (40)."""
    theta = angles(image.b[[pole]], image.b[[neighbour]])[0, 0]
    fitting = np.argwhere(np.abs(image.between - theta) <= image.tolerance)  # (37), both ways round
    image.counted["kvector_hits"] += len(fitting) // 2
    off = np.abs(image.star_mag - image.magnitudes[pole]) < image.tolerance_mag  # (38)
    off_neighbour = np.abs(image.star_mag - image.magnitudes[neighbour]) < image.tolerance_mag
    return [(int(one), int(other)) for one, other in fitting if off[one] and off_neighbour[other]]


def acceptance(image: Image, pole: int) -> Set:
    """The accepted stars for one pole, (41) to (43); empty when the pole is not accepted."""
    neighbours = [j for j in range(len(image.b)) if j != pole]
    image.counted["kvector_queries"] += len(neighbours)
    found = {j: pairs_of(image, pole, j) for j in neighbours}
    votes = Counter(star for j in neighbours for star in {one for one, _ in found[j]})
    image.counted["votes"] += votes.total()
    if not votes:
        return {}
    most = max(votes.values())
    named = [star for star, number in votes.items() if number == most]
    if len(named) != 1:
        return {}
    accepted = {pole: named[0]}
    for j in neighbours:
        theta = angles(image.b[[pole]], image.b[[j]])[0, 0]
        partners = [other for one, other in found[j] if one == named[0]]
        if partners:
            accepted[j] = min(
                partners, key=lambda star: abs(np.cos(image.between[named[0], star]) - np.cos(theta))
            )
    return accepted


def recognised(one: Set, other: Set) -> Set:
    """(45): what both sets say of the same spikes."""
    return {spike: star for spike, star in one.items() if other.get(spike) == star}


def judged(image: Image, stars: Set, catalogue: Array, least: int) -> NDArray[np.int32] | None:
    """Star of each spike when the trial explains enough of the image."""
    spots = sorted(stars)
    a = attitude(image.b[spots], catalogue[[stars[spot] for spot in spots]])
    for radius in (2 * image.tolerance, image.tolerance, image.tolerance):
        star = match(image.b, a, catalogue, radius)
        if (star >= 0).sum() < least:
            return None
        a = attitude(image.b[star >= 0], catalogue[star[star >= 0]])
    return star


def identify(
    b: Array,
    magnitudes: Array,
    catalogue: Array,
    star_mag: Array,
    tolerance: float,
    *,
    max_angle: float,
    tolerance_mag: float = 0.7,
    least_recognised: int = 5,
    min_stars: int = 4,
    most_false: float = 1e-5,
    most_false_triangles: float = 1e-2,
    certain_false: float = 1e-9,
) -> tuple[str, NDArray[np.int32], Counter[str]]:
    """(reason, row of the catalogue for each spike, counts); the spikes brightest first."""
    nothing = np.full(len(b), -1, np.int32)
    if len(b) < 3:
        return "TOO_FEW_STARS", nothing, Counter()
    between = angles(catalogue, catalogue)
    between[(between > max_angle) | np.eye(len(catalogue), dtype=bool)] = np.inf
    image = Image(b, magnitudes, between, star_mag, tolerance, tolerance_mag)
    mean = b.mean(axis=0) / np.linalg.norm(b.mean(axis=0))
    spread = float(np.arccos(np.clip(b @ mean, -1, 1)).max())
    least = max(3, min(least_recognised, len(b)))
    best: tuple[float, NDArray[np.int32]] | None = None
    sets: list[Set] = []
    waiting = list(range(len(b)))
    latest: Set = {}
    while waiting:
        pole = next((spike for spike in waiting if spike in latest), waiting[0])
        waiting.remove(pole)
        latest = acceptance(image, pole)
        if len(latest) < least:
            latest = {}
            continue
        for earlier in sets:
            common = recognised(earlier, latest)
            if len(common) < least:  # (44)
                continue
            if best is not None and all(best[1][spike] == star for spike, star in common.items()):
                continue
            star = judged(image, common, catalogue, min(min_stars, len(common)))
            if star is None:
                continue
            matched = int((star >= 0).sum())
            false = chance(len(catalogue), len(b), matched, spread, tolerance)
            if false > (most_false if matched >= min_stars else most_false_triangles):
                continue
            if best is not None:
                both = (star >= 0) & (best[1] >= 0)
                other = (star[both] != best[1][both]).any() or not both.any()
                if other and min(false, best[0]) > certain_false:
                    return "AMBIGUOUS", nothing, image.counted
                if false >= best[0]:
                    continue
            best = false, star
            if false <= certain_false:
                return "NONE", star, image.counted
        sets.append(latest)
    if best is None:
        return "NO_MATCH", nothing, image.counted
    named = int((best[1] >= 0).sum())
    return ("NONE" if named >= min_stars else "UNCONFIRMED"), best[1], image.counted
