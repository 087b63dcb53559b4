"""How this computer rounds: a digest of floating-point results that depend on processor and libraries."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import numba
import numpy as np

RECORDED = Path(__file__).with_name("numerics.txt")


@numba.njit
def _loop(x: np.ndarray) -> float:
    total = 0.0
    for value in x:
        total += math.sin(value) * math.exp(-value) + value * total
    return total


def numerics_digest() -> str:
    """Equal on two computers that give the same journals."""
    generator = np.random.default_rng(1)
    digest = hashlib.sha256()
    x = generator.uniform(0.01, 3, 4000)
    for function in (np.sin, np.cos, np.exp, np.log, np.sqrt, np.arctan, np.arcsin):
        digest.update(function(x / 3.1).tobytes())
    digest.update(np.float64(x.sum()).tobytes() + np.float64(x @ x).tobytes())
    for size in (3, 4, 30):
        matrix = generator.normal(size=(size, size))
        symmetric = matrix @ matrix.T
        digest.update(symmetric.tobytes())
        digest.update(np.abs(np.linalg.eigh(symmetric)[1]).tobytes())
        digest.update(np.linalg.svd(matrix)[1].tobytes() + np.linalg.inv(matrix).tobytes())
    digest.update(np.float64(_loop(x[:200] / 10)).tobytes())
    return digest.hexdigest()


def rounds_as_recorded() -> bool:
    """Whether the kept journals were recorded on a computer that rounds as this one."""
    return RECORDED.read_text().split()[0] == numerics_digest()
