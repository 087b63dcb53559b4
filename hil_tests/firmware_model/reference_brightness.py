"""Zhang et al. 2014 written plainly: its equations with the paper's indices, its algorithm with sets.

The algorithm knows nothing of ranges, marks or the order of reading: a triangle of pivot and two partners is
any three catalogue stars whose three angles and whose order of brightness fit.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hil_tests.firmware_model.reference_pyramid import angles, attitude, chance, match

Array = NDArray[np.float64]
Rows = NDArray[np.int32]


def pair_catalogue(vectors: Array, magnitude: Array, field_rad: float) -> list[tuple[float, int, int]]:
    """(10): (P, I, J) in ascending order of P; I is the brighter star, or the first of two equal ones."""
    pairs = []
    for one, other in itertools.combinations(range(len(vectors)), 2):
        cosine = float(vectors[one] @ vectors[other])
        if cosine >= math.cos(field_rad):
            swap = magnitude[other] < magnitude[one]
            pairs.append((cosine, other if swap else one, one if swap else other))
    return sorted(pairs)


def line(p: list[float]) -> tuple[float, float]:
    """(11): slope a and offset b of the line through (1, p_1) and (m, p_m)."""
    m = len(p)
    return (p[-1] - p[0]) / (m - 1), (m * p[0] - p[-1]) / (m - 1)


def k_vector(p: list[float]) -> list[int]:
    """(12): K(1) = 1, K(k) = i with P(i) <= y(k) < P(i + 1); the list starts with K(1)."""
    a, b = line(p)
    return [1] + [sum(value <= a * k + b + 1e-15 for value in p) for k in range(2, len(p) + 1)]


def index_range(p: list[float], theta: float, epsilon: float) -> tuple[int, int]:
    """(13)-(14): k_start, k_end, from 1, both included."""
    (a, b), k, m = line(p), k_vector(p), len(p)
    bottom = math.floor((math.cos(theta + 2 * epsilon) - b) / a)
    top = math.ceil((math.cos(theta - 2 * epsilon) - b) / a)
    start = k[min(bottom, m) - 1] + 1 if bottom >= 1 else 1
    return start, k[min(max(top, 1), m) - 1]


def partners(pivot: int, spots: int) -> Iterator[list[int]]:
    """The groups of a pivot: three at a time of the dimmest left."""
    left = list(range(spots - 1, pivot, -1))
    while left:
        yield left[:3]
        left = left[3:]


def identify(
    b: Array,
    magnitudes: Array,
    catalogue: Array,
    hp_mag: Array,
    tolerance: float,
    *,
    max_angle: float,
    distinct: float = 0.7,
    bright_limit: float = 3.0,
    max_spots: int = 20,
    most_false: float = 1e-5,
    most_false_triangle: float = 1e-2,
    certain_false: float = 1e-9,
) -> tuple[str, Rows]:
    """(name of the reason, row of the catalogue for each spike); brightness is not judged at the end."""
    nothing = np.full(len(b), -1, np.int32)
    if len(b) < 3:
        return "TOO_FEW_STARS", nothing
    spots = min(len(b), max_spots)
    least = 3 if len(b) <= 4 else 4
    between = angles(catalogue, catalogue)
    between[(between > max_angle) | np.eye(len(catalogue), dtype=bool)] = np.inf
    row = np.arange(len(catalogue))
    # brighter[s, t]: star s is I and star t is J of their pair
    brighter = (hp_mag[:, None] < hp_mag[None, :]) | (
        (hp_mag[:, None] == hp_mag[None, :]) & (row[:, None] < row[None, :])
    )
    measured = angles(b, b)
    mean = b.mean(axis=0) / np.linalg.norm(b.mean(axis=0))
    spread = float(np.arccos(np.clip(b @ mean, -1, 1)).max())
    solutions: dict[bool, tuple[float, Rows]] = {}  # confirmed or triangle alone: the best
    triangle_rivals = 0

    def fits(i: int, j: int) -> NDArray[np.bool_]:
        return np.abs(between - measured[i, j]) <= tolerance

    def candidates(pivot: int, spot: int, round_: int) -> NDArray[np.bool_]:
        """[star of the pivot, star of the partner]."""
        table = fits(pivot, spot)
        if round_ < 2 and magnitudes[spot] - magnitudes[pivot] > distinct:
            table = table & brighter
        if round_ == 0:  # of both stars the brighter is a reference star, and the pivot's is one
            table = table & (hp_mag[:, None] < bright_limit)
        return table

    for round_ in range(3):
        if (round_ == 0 and len(b) < 4) or (round_ == 2 and True in solutions):
            continue
        for pivot in range(spots - 2):
            if round_ == 0 and not magnitudes[pivot] < bright_limit:
                break
            groups = list(partners(pivot, spots))
            members = list(itertools.chain.from_iterable(groups[:1] if round_ == 0 else groups))
            tables = {spot: candidates(pivot, spot, round_) for spot in members}
            for j, k in itertools.combinations(members, 2):
                for star in np.flatnonzero(tables[j].any(axis=1) & tables[k].any(axis=1)):
                    third = fits(j, k)
                    for star_j, star_k in itertools.product(
                        np.flatnonzero(tables[j][star]), np.flatnonzero(tables[k][star])
                    ):
                        if not third[star_j, star_k]:
                            continue
                        corners, named = [pivot, j, k], [star, star_j, star_k]
                        volume = np.linalg.det(b[corners])
                        mirror = np.linalg.det(catalogue[named])
                        longest = measured[np.ix_(corners, corners)].max() + tolerance
                        if volume * mirror < 0 and min(abs(volume), abs(mirror)) > 2 * tolerance * longest:
                            continue
                        a = attitude(b[corners], catalogue[named])
                        for radius in (2 * tolerance, tolerance, tolerance):
                            trial = match(b, a, catalogue, radius)
                            if (trial >= 0).sum() < least:
                                break
                            a = attitude(b[trial >= 0], catalogue[trial[trial >= 0]])
                        matched = int((trial >= 0).sum())
                        if matched < least:
                            continue
                        confirmed = matched >= 4
                        false = chance(len(catalogue), len(b), matched, spread, tolerance)
                        if false > (most_false if confirmed else most_false_triangle):
                            continue
                        if confirmed in solutions:
                            best = solutions[confirmed]
                            both = (trial >= 0) & (best[1] >= 0)
                            other = bool((trial[both] != best[1][both]).any()) or both.sum() < 2
                            if other and confirmed and min(false, best[0]) > certain_false:
                                return "AMBIGUOUS", nothing
                            triangle_rivals += other and not confirmed
                            if false >= best[0]:
                                continue
                        solutions[confirmed] = false, trial
                        if confirmed and false <= certain_false:
                            return "NONE", trial
    if True in solutions:
        return "NONE", solutions[True][1]
    if triangle_rivals:
        return "AMBIGUOUS", nothing
    if False in solutions:
        return "UNCONFIRMED", solutions[False][1]
    return "NO_MATCH", nothing
