"""Geometric voting written slowly and plainly: what the firmware's loops must give, vote for vote."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hil_tests.firmware_model.reference_pyramid import Array, angles, attitude, chance, match

Identity = tuple[int, int]  # spot, star
MOST_SPOTS = 128
MOST_IDENTITIES = 32
MOST_IDENTITIES_IN_ALL = 768


class Election:
    """Both votes over one image, and what they cost."""

    def __init__(self, b: Array, catalogue: Array, tolerance: float, max_angle: float) -> None:
        self.tolerance = tolerance
        self.measured = angles(b, b)
        self.between = angles(catalogue, catalogue)
        one, other = np.triu_indices(len(catalogue), 1)
        near = self.between[one, other] <= max_angle
        self.pairs = np.stack([one[near], other[near]], axis=1)
        self.pair_angles = self.between[one, other][near]
        self.votes: dict[int, Counter[int]] = {spot: Counter() for spot in range(len(b))}
        self.stars = len(catalogue)
        self.hits = self.queries = self.counted = 0

    def cast(self, before: int, spots: int) -> None:
        """First vote, of the pairs of spots that the first `before` do not hold."""
        for i in range(spots):
            for j in range(max(i + 1, before), spots):
                fits = np.abs(self.pair_angles - self.measured[i, j]) <= self.tolerance
                for pair in self.pairs[fits]:
                    for star in pair.tolist():
                        self.votes[i][star] += 1
                        self.votes[j][star] += 1
                        self.counted += 2
                self.hits += int(fits.sum())
                self.queries += 1

    def first(self, spot: int) -> list[int]:
        """The stars in the first place, unless it says nothing."""
        self.counted += self.stars
        most = max(self.votes[spot].values(), default=0)
        leading = sorted(star for star, number in self.votes[spot].items() if number == most)
        return leading if most >= 2 and len(leading) <= MOST_IDENTITIES else []

    def with_runners_up(self, spot: int, spots: int) -> list[int]:
        """Place after place of the vote, as long as they are not too many."""
        self.counted += 2 * self.stars
        room = min(MOST_IDENTITIES, MOST_IDENTITIES_IN_ALL // spots)
        taken: list[int] = []
        for number in range(max(self.votes[spot].values(), default=0), 1, -1):
            place = [star for star, given in self.votes[spot].items() if given == number]
            if len(taken) + len(place) > room:
                break
            taken += place
        return sorted(taken)

    def clusters(self, identities: list[Identity]) -> Iterator[list[Identity]]:
        """Second vote; clusters of three and more, those about the best supported identity first."""

        def fits(a: Identity, b: Identity) -> bool:
            if a[0] == b[0] or a[1] == b[1]:
                return False
            return bool(abs(self.between[a[1], b[1]] - self.measured[a[0], b[0]]) <= self.tolerance)

        support: Counter[Identity] = Counter()
        friends = {a: {b for b in identities if fits(a, b)} for a in identities}
        for a in identities:
            support[a] = len(friends[a])
            self.counted += len(friends[a])
        order = sorted(identities, key=lambda a: -support[a])
        clustered: set[Identity] = set()
        for seed in order:
            if support[seed] < 2:
                return
            if seed in clustered:
                continue
            cluster = [seed]
            for a in order:
                reads = 0
                for member in cluster:
                    reads += 1
                    if member not in friends[a]:
                        break
                else:
                    cluster.append(a)
                self.counted += reads
            if len(cluster) >= 3:
                clustered |= set(cluster)
                yield cluster


def identify(
    b: Array,
    catalogue: Array,
    tolerance: float,
    *,
    max_angle: float,
    max_spots: int = 20,
    min_stars: int = 4,
    most_false: float = 1e-5,
    most_false_triangles: float = 1e-2,
    certain_false: float = 1e-9,
) -> tuple[str, NDArray[np.int32], Election]:
    """(name of the reason, row of the catalogue for each spot, the votes)."""
    nothing = np.full(len(b), -1, np.int32)
    election = Election(b, catalogue, tolerance, max_angle)
    if len(b) < 3:
        return "TOO_FEW_STARS", nothing, election
    mean = b.mean(axis=0) / np.linalg.norm(b.mean(axis=0))
    spread = float(np.arccos(np.clip(b @ mean, -1, 1)).max())
    best: tuple[float, NDArray[np.int32]] | None = None
    triangles: list[NDArray[np.int32]] = []
    voters = [min(len(b), max_spots)]
    while voters[-1] < min(len(b), MOST_SPOTS):
        voters.append(min(2 * voters[-1], len(b), MOST_SPOTS))
    for turn, spots in enumerate([*voters, voters[-1]]):
        if turn < len(voters):
            election.cast(0 if turn == 0 else voters[turn - 1], spots)
            names = {spot: election.first(spot) for spot in range(spots)}
        else:
            names = {spot: election.with_runners_up(spot, spots) for spot in range(spots)}
        for cluster in election.clusters([(spot, star) for spot in range(spots) for star in names[spot]]):
            rows = [spot for spot, _ in cluster]
            a = attitude(b[rows], catalogue[[star for _, star in cluster]])
            for radius in (2 * tolerance, tolerance, tolerance):
                trial = match(b, a, catalogue, radius)
                matched = int((trial >= 0).sum())
                if matched < 3:
                    break
                a = attitude(b[trial >= 0], catalogue[trial[trial >= 0]])
            if matched < 3:
                continue
            false = chance(len(catalogue), len(b), matched, spread, tolerance)
            if matched < min_stars:
                if false <= most_false_triangles and not any((trial == t).all() for t in triangles):
                    triangles.append(trial)
                continue
            if false > most_false:
                continue
            if best is not None:
                both = (trial >= 0) & (best[1] >= 0)
                other = (trial[both] != best[1][both]).any() or not both.any()
                if other and min(false, best[0]) > certain_false:
                    return "AMBIGUOUS", nothing, election
                if false >= best[0]:
                    continue
            best = false, trial
            if false <= certain_false:
                return "NONE", trial, election
    if best is not None:
        return "NONE", best[1], election
    if len(triangles) == 1:
        return "UNCONFIRMED", triangles[0], election
    return ("AMBIGUOUS" if triangles else "NO_MATCH"), nothing, election
