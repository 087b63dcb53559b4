"""The k-vector: range search in a sorted list without comparisons.

Mortari 1996; the form and the numbers of the equations are those of Zhang et al. 2014, (11)-(14), with
indices from 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]


@dataclass(frozen=True)
class KVector:
    """A straight line y(i) = slope * i + offset over the sorted values, and how many values lie below it.

    count_below: int32[m + 1]; count_below[i] is the number of values p with p < y(i), and count_below[m] = m.
    """

    slope: float
    offset: float
    count_below: IntArray


def build_kvector(ascending: FloatArray) -> KVector:
    """The k-vector of the values ascending[m], (11)-(12). An empty list gives a k-vector of one zero."""
    count = len(ascending)
    if count == 0:
        return KVector(1.0, 0.0, np.zeros(1, np.int32))
    # The line runs a little steeper than through the end points, so that rounding loses neither end
    # (Mortari's xi).
    spread = max(float(ascending[-1] - ascending[0]), 1e-12)
    xi = spread * 1e-9 + 1e-15
    offset = float(ascending[0]) - xi
    slope = (spread + 2.0 * xi) / count
    line = offset + slope * np.arange(count + 1)
    below = np.searchsorted(ascending, line, side="left").astype(np.int32)
    below[0] = 0
    below[count] = count
    return KVector(slope, offset, below)


@numba.njit(nogil=True)
def range_kernel(
    ascending: FloatArray, slope: float, offset: float, count_below: IntArray, lowest: float, highest: float
) -> tuple[int, int, int]:
    """(first, end, values compared) of the values p with lowest <= p <= highest.

    (13)-(14) give a range that holds them all and about one more at each end; those are then cut off by
    comparison.
    """
    steps = len(count_below) - 1
    if steps == 0 or lowest > highest:
        return 0, 0, 0
    bottom = math.floor((lowest - offset) / slope)
    top = math.ceil((highest - offset) / slope)
    # One step outwards where a bound falls on the line itself, where rounding could put it on the wrong side.
    first = count_below[min(max(bottom, 0), steps)]
    end = count_below[min(max(top + 1, 0), steps)]
    compared = 0
    while first < end:
        compared += 1
        if ascending[first] >= lowest:
            break
        first += 1
    while end > first:
        compared += 1
        if ascending[end - 1] <= highest:
            break
        end -= 1
    return first, end, compared
