"""Many measurements in a few numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def of_rounds(values: Sequence[float]) -> dict[str, float | int]:
    """Median, least and greatest of a few rounds."""
    return {
        "median": _rounded(float(np.median(values))),
        "least": _rounded(min(values)),
        "greatest": _rounded(max(values)),
        "rounds": len(values),
    }


def of_delays(values_ms: Sequence[float]) -> dict[str, float | int]:
    """p50, p99 and greatest of many delays, ms."""
    p50, p99 = np.percentile(values_ms, (50, 99))
    return {
        "p50_ms": _rounded(float(p50)),
        "p99_ms": _rounded(float(p99)),
        "greatest_ms": _rounded(float(max(values_ms))),
        "n": len(values_ms),
    }


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")
