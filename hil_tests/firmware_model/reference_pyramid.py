"""The pyramid written slowly and plainly: what the firmware's compiled loop must give, star for star."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def smart_triads(spots: int) -> Iterator[tuple[int, int, int]]:
    """Mortari's order: no spot stays in many triads in a row, so that a false one is soon passed over."""
    for dj in range(1, spots - 1):
        for dk in range(1, spots - dj):
            for i in range(spots - dj - dk):
                yield i, i + dj, i + dj + dk


def angles(u: Array, v: Array) -> Array:
    """Angles between all pairs of two lists of unit vectors."""
    chord = np.linalg.norm(u[:, None, :] - v[None, :, :], axis=2)
    return np.asarray(2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0)))


def attitude(b: Array, r: Array) -> Array:
    """A with b = A r, at equal weights."""
    return np.asarray(Rotation.align_vectors(b, r)[0].as_matrix())


def match(b: Array, a: Array, catalogue: Array, radius: float) -> NDArray[np.int32]:
    """Nearest star of each spot within the radius; a star only to its nearest spot."""
    off = angles(b @ a, catalogue)
    star = np.full(len(b), -1, np.int32)
    for spot in np.argsort(off.min(axis=1)):
        nearest = int(np.argmin(off[spot]))
        if off[spot, nearest] <= radius and nearest not in star:
            star[spot] = nearest
    return star


def chance(stars: int, spots: int, matched: int, spread: float, tolerance: float) -> float:
    """Expected number of solutions as good by chance: C(n, m) N (ring) (circle)^(m - 2)."""
    density = stars / (4 * math.pi)
    ring = density * 4 * math.pi * math.sin(spread) * tolerance
    circle = density * math.pi * tolerance**2
    return math.comb(spots, matched) * stars * ring * circle ** (matched - 2)


def identify(
    b: Array,
    catalogue: Array,
    tolerance: float,
    *,
    max_angle: float,
    max_spots: int = 20,
    min_stars: int = 4,
    most_false: float = 1e-5,
    most_false_triangle: float = 1e-2,
    certain_false: float = 1e-9,
) -> tuple[str, NDArray[np.int32]]:
    """(name of the reason, row of the catalogue for each spot)."""
    nothing = np.full(len(b), -1, np.int32)
    if len(b) < 3:
        return "TOO_FEW_STARS", nothing
    triangles = len(b) <= 4  # no fourth to spare
    triangle: tuple[float, NDArray[np.int32]] | None = None
    rivals = 0
    between = angles(catalogue, catalogue)
    between[(between > max_angle) | np.eye(len(catalogue), dtype=bool)] = np.inf
    measured = angles(b, b)
    mean = b.mean(axis=0) / np.linalg.norm(b.mean(axis=0))
    spread = float(np.arccos(np.clip(b @ mean, -1, 1)).max())
    best: tuple[float, NDArray[np.int32]] | None = None
    spots = min(len(b), max_spots)
    fits = {
        (i, j): np.abs(between - measured[i, j]) <= tolerance
        for i in range(spots)
        for j in range(spots)
        if i != j
    }
    for i, j, k in smart_triads(spots):
        sides = measured[i, j], measured[i, k], measured[j, k]
        volume = np.linalg.det(b[[i, j, k]])
        for star_i, star_j in np.argwhere(fits[i, j]):
            for star_k in np.flatnonzero(fits[i, k][star_i] & fits[j, k][star_j]):
                mirror = np.linalg.det(catalogue[[star_i, star_j, star_k]])
                if volume * mirror < 0 and min(abs(volume), abs(mirror)) > 2 * tolerance * (
                    max(sides) + tolerance
                ):
                    continue
                fourth = None
                corners, named = [i, j, k], [star_i, star_j, star_k]
                for spot in set() if triangles else set(range(spots)) - {i, j, k}:
                    completes = fits[i, spot][star_i] & fits[j, spot][star_j] & fits[k, spot][star_k]
                    if completes.any():
                        fourth = spot, int(np.flatnonzero(completes)[0])
                        break
                if fourth is not None:
                    corners.append(fourth[0])
                    named.append(fourth[1])
                elif not triangles:
                    continue
                least = 3 if triangles else min_stars
                a = attitude(b[corners], catalogue[named])
                for radius in (2 * tolerance, tolerance, tolerance):
                    trial = match(b, a, catalogue, radius)
                    if (trial >= 0).sum() < least:
                        break
                    a = attitude(b[trial >= 0], catalogue[trial[trial >= 0]])
                matched = int((trial >= 0).sum())
                if matched < least:
                    continue
                false = chance(len(catalogue), len(b), matched, spread, tolerance)
                if matched < min_stars:
                    if false <= most_false_triangle:
                        if triangle is None:
                            triangle = false, trial
                        both = (trial >= 0) & (triangle[1] >= 0)
                        rivals += bool((trial[both] != triangle[1][both]).any()) or both.sum() < 2
                    continue
                if false > most_false:
                    continue
                if best is not None:
                    both = (trial >= 0) & (best[1] >= 0)
                    other = (trial[both] != best[1][both]).any() or not both.any()
                    if other and min(false, best[0]) > certain_false:
                        return "AMBIGUOUS", nothing
                    if false >= best[0]:
                        continue
                best = false, trial
                if false <= certain_false:
                    return "NONE", trial
    if best is not None:
        return "NONE", best[1]
    if triangle is None:
        return "NO_MATCH", nothing
    return ("AMBIGUOUS", nothing) if rivals else ("UNCONFIRMED", triangle[1])
