"""All that the light on a frame's pixels follows from, as the compiled kernels take it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]


class Scene(NamedTuple):
    """What the mean charge of every pixel of one frame follows from.

    xs, ys float64[n, steps], light float64[n], box int32[n, 4]: the stars, see `star_index.image_paths`;
    sigma_px of the point spread; stray: electrons in the exposure, uniform; glow_columns float32[g, width],
    glow_rows float32[g, height]: g more layers of stray light, each the product of its column and row
    factors; response, dark: see `noise.fixed_pattern`; exposure_s.

    row_starts float64[height], row_span: with a rolling shutter, when each row's exposure starts, and how
    long it lasts, in sub-steps; xs, ys are then [n, steps + 1] at the ends of the sub-steps, and lit int32[n,
    2] the first sub-step that matters for a star and the one behind the last; share_table: of
    `exposed_rows`. row_span 0: all rows are exposed in all sub-steps, and these four are not looked at.
    """

    xs: F64
    ys: F64
    light: F64
    box: I32
    sigma_px: float
    phi_table: F64
    stray: float
    glow_columns: F32
    glow_rows: F32
    response: F32
    dark: F32
    exposure_s: float
    row_starts: F64
    row_span: float
    lit: I32
    share_table: F32
