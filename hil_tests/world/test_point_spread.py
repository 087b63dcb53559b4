"""The tabulated normal distribution function against scipy's."""

from __future__ import annotations

import numpy as np
from scipy import stats

from st_emulator.world import point_spread


def test_phi_between_and_on_the_tables_points() -> None:
    x = np.concatenate((np.linspace(-6.9, 6.9, 20_011), np.arange(-192, 193) / 32.0))
    found = np.array([point_spread.phi(value, point_spread.PHI_TABLE) for value in x])
    assert np.abs(found - stats.norm.cdf(x)).max() < 1e-10


def test_phi_beyond_the_table_is_its_end() -> None:
    for far in (7.5, 1e6):
        assert 1.0 - point_spread.phi(far, point_spread.PHI_TABLE) < 2e-12
        assert point_spread.phi(-far, point_spread.PHI_TABLE) < 2e-12
