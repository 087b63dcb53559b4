"""Coefficients of the counts from samples: non-negative least squares of relative errors, with uncertainty.

Stages that share counts (an identification solves for attitudes) are fitted together, others each alone.
Every target (core cycles, instructions, accesses, line fills of each cache size) is a fit of its own on the
same samples. An error is relative to what the sample takes in all: core cycles to core cycles, line fills at
their nominal time to the whole run's cycles, so that fills of a run that hardly has any do not rule the fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from tools.calibration.samples import CYCLES_PER_FILL, TARGETS, Sample, fills_target, total_cycles

__all__ = ["RESAMPLES", "Collinearity", "Estimate", "Fit", "fit"]

FloatArray = NDArray[np.float64]

RESAMPLES: Final = 300  # of the bootstrap: a sigma to 4 %
# Belsley, Kuh & Welsch 1980, ch. 3: a condition index over 30 with two counts that each have more than half
# of their variance there is a near dependency.
CONDITION_INDEX: Final = 30.0
VARIANCE_SHARE: Final = 0.5


@dataclass(frozen=True)
class Estimate:
    """A coefficient and its uncertainty, one sigma."""

    value: float
    sigma: float


@dataclass(frozen=True)
class Collinearity:
    """Counts whose numbers nearly depend on each other in the samples: only their sum is well known.

    condition_index: largest singular value over that of the dependency, columns of length one.
    inflation: of the variance of each of the counts (variance inflation factor).
    """

    counts: tuple[str, ...]
    condition_index: float
    inflation: tuple[float, ...]

    def __str__(self) -> str:
        named = ", ".join(f"{n} (VIF {v:.3g})" for n, v in zip(self.counts, self.inflation, strict=True))
        return f"nearly collinear, condition index {self.condition_index:.0f}: {named}"


@dataclass(frozen=True)
class Fit:
    """What was fitted.

    coefficients: count -> target -> estimate. frames: count -> how many frames have it. collinear: warnings.
    """

    coefficients: Mapping[str, Mapping[str, Estimate]]
    frames: Mapping[str, int]
    collinear: tuple[Collinearity, ...] = field(default=())

    def predict(self, sample: Sample) -> dict[str, float]:
        """Each target by the coefficients. KeyError: a count that no sample of the fit had."""
        return {
            target: sum(number * self.coefficients[name][target].value for name, number in sample.counts)
            for target in TARGETS
        }


def fit(samples: Sequence[Sample], *, seed: int = 1, resamples: int = RESAMPLES) -> Fit:
    """Coefficients of every count that the samples have.

    The uncertainty is a bootstrap over whole sequences of frames (their samples are not independent of each
    other), ``resamples`` times. The same samples and seed give the same result.
    """
    coefficients: dict[str, dict[str, Estimate]] = {}
    collinear: list[Collinearity] = []
    for number, group in enumerate(connected(samples)):
        names = sorted({name for sample in group for name, _ in sample.counts})
        system = _System(group, names)
        collinear += system.collinearities()
        coefficients.update({name: {} for name in names})
        for target in TARGETS:
            values = system.solve(target)
            sigmas = system.bootstrap(target, np.random.default_rng([seed, number]), resamples)
            for name, value, sigma in zip(names, values, sigmas, strict=True):
                coefficients[name][target] = Estimate(float(value), float(sigma))
    frames: dict[str, set[tuple[int, int]]] = {}
    for sample in samples:
        for name, _ in sample.counts:
            frames.setdefault(name, set()).add((sample.sequence, sample.frame))
    return Fit(coefficients, {name: len(found) for name, found in sorted(frames.items())}, tuple(collinear))


def connected(samples: Sequence[Sample]) -> list[list[Sample]]:
    """Samples in groups that share no count with each other; samples without counts are left out."""
    leader: dict[str, str] = {}

    def find(name: str) -> str:
        while leader[name] != name:
            name = leader[name]
        return name

    for sample in samples:
        names = [name for name, _ in sample.counts]
        for name in names:
            leader.setdefault(name, name)
            first, other = find(names[0]), find(name)
            leader[max(first, other)] = min(first, other)
    groups: dict[str, list[Sample]] = {}
    for sample in samples:
        if sample.counts:
            groups.setdefault(find(sample.counts[0][0]), []).append(sample)
    return [groups[name] for name in sorted(groups)]


def scale_of(sample: Sample, target: str) -> float:
    """What an error of a target is relative to, in the target's own unit."""
    values = dict(zip(TARGETS, sample.values, strict=True))
    if target == "core_cycles" or not target.startswith(fills_target(0)[:-1]):
        return max(float(values[target]), 1.0)
    kib = int(target.rpartition("_")[2])
    return max(total_cycles(values, kib), 1.0) / CYCLES_PER_FILL


class _System:
    """Samples as a matrix: a row a sample, a column a count."""

    def __init__(self, samples: Sequence[Sample], names: Sequence[str]) -> None:
        self.names = names
        place = {name: column for column, name in enumerate(names)}
        self.counts = np.zeros((len(samples), len(names)))
        for row, sample in enumerate(samples):
            for name, number in sample.counts:
                self.counts[row, place[name]] = number
        self.samples = samples
        sequences = sorted({sample.sequence for sample in samples})
        order = {sequence: number for number, sequence in enumerate(sequences)}
        self.sequence = np.array([order[sample.sequence] for sample in samples])
        self.sequences = len(sequences)

    def weighted(self, target: str) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(rows relative to the samples' scale with columns of length one, right side, lengths)."""
        scale = np.array([scale_of(sample, target) for sample in self.samples])
        rows = self.counts / scale[:, np.newaxis]
        lengths = np.linalg.norm(rows, axis=0)
        right = np.array([sample.value(target) for sample in self.samples]) / scale
        return rows / lengths, right, lengths

    def solve(self, target: str) -> FloatArray:
        rows, right, lengths = self.weighted(target)
        solution, _ = nnls(rows, right)
        return np.asarray(solution / lengths)

    def bootstrap(self, target: str, rng: np.random.Generator, resamples: int) -> FloatArray:
        """Standard deviation of the coefficients over sequences drawn with replacement."""
        rows, right, lengths = self.weighted(target)
        both = np.column_stack([rows, right])
        products = np.zeros((self.sequences, both.shape[1], both.shape[1]))
        for number in range(self.sequences):
            own = both[self.sequence == number]
            products[number] = own.T @ own
        found = np.empty((resamples, len(self.names)))
        for number in range(resamples):
            drawn = np.bincount(rng.integers(0, self.sequences, self.sequences), minlength=self.sequences)
            found[number] = _from_products(np.tensordot(drawn, products, 1)) / lengths
        return np.asarray(found.std(axis=0, ddof=1)) if resamples > 1 else np.zeros(len(self.names))

    def collinearities(self) -> list[Collinearity]:
        """Near dependencies between counts, after Belsley, Kuh & Welsch."""
        rows, _, _ = self.weighted("core_cycles")
        if rows.shape[1] < 2:
            return []
        _, singular, directions = np.linalg.svd(rows, full_matrices=False)
        least = singular[0] * 1e-12
        parts = (directions / np.maximum(singular, least)[:, np.newaxis]) ** 2  # [direction, count]
        inflation = parts.sum(axis=0)
        found = []
        for index, part in zip(singular[0] / np.maximum(singular, least), parts, strict=True):
            within = np.flatnonzero(part / inflation > VARIANCE_SHARE)
            if index > CONDITION_INDEX and len(within) > 1:
                names = tuple(self.names[column] for column in within)
                found.append(
                    Collinearity(names, float(index), tuple(float(inflation[column]) for column in within))
                )
        return found


def _from_products(product: FloatArray) -> FloatArray:
    """Non-negative least squares from [A b]^T [A b]; a column that is not there gets 0."""
    size = len(product) - 1
    present = np.flatnonzero(np.diag(product)[:size] > 0)
    solution = np.zeros(size)
    if len(present):
        normal = product[np.ix_(present, present)]
        # a little on the diagonal: with few sequences drawn two columns can be the same
        factor = np.linalg.cholesky(normal + 1e-12 * np.trace(normal) * np.eye(len(present)))
        right = solve_triangular(factor, product[present, size], lower=True)
        solution[present], _ = nnls(factor.T, right)
    return solution
