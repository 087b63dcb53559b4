"""Components of a quaternion in 16 bits: u = trunc(q * 32767 + 32768), and back q = (u - 32768) / 32767.

In double precision, as the reference simulator computes. u is never above the exact product, so that what the
driver computes is up to one step (1 / 32767) too low and 0.5 on average; 0 comes back as 0 exactly.
A component gives 1 (for -1) to 65535 (for 1), and 0 only where rounding has brought it below -1.
"""

from __future__ import annotations

from typing import Final

SCALE: Final = 32767
OFFSET: Final = 32768
STEP: Final = 1 / SCALE
HIGHEST: Final = 0xFFFF


def quantised(component: float) -> int:
    """The 16 bits of a finite component.

    ASSUMED: beyond what 16 bits hold the nearest end is sent. The reference leaves it undefined (a conversion
    in C++), and a unit quaternion never gets there.
    """
    return max(0, min(HIGHEST, int(component * float(SCALE) + float(OFFSET))))


def component_of(u: int) -> float:
    """The component as the driver computes it."""
    return (u - OFFSET) / SCALE
