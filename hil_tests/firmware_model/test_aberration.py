"""Aberration and the velocity of the Earth, against erfa."""

from __future__ import annotations

import erfa
import numpy as np
import pytest

from hil_tests.firmware_model.synthetic_sky import ARCSEC, random_directions
from st_emulator.firmware_model.aberration import (
    SPEED_OF_LIGHT_KM_S,
    apparent_directions,
    earth_velocity_km_s,
)

AU_KM = 149_597_870.7
DAYS = [(2_451_545.0 + day) for day in np.linspace(-3000.0, 18_000.0, 300)]  # TDB, 1991 to 2049


def tai_ns(julian_date_tt: float) -> int:
    """TAI ns since 1958-01-01 (JD 2436204.5 TAI) of a TT date."""
    return round(((julian_date_tt - 2_436_204.5) * 86_400.0 - 32.184) * 1e9)


@pytest.mark.parametrize("day", DAYS[::30])
def test_the_earth_moves_as_erfa_says(day: float) -> None:
    _, barycentric = erfa.epv00(day, 0.0)
    velocity = earth_velocity_km_s(tai_ns(day))
    error = velocity - barycentric["v"] * AU_KM / 86_400.0
    assert np.linalg.norm(error) / SPEED_OF_LIGHT_KM_S / ARCSEC < 0.1


def test_the_largest_error_of_sixty_years_is_as_stated() -> None:
    error = [
        np.linalg.norm(earth_velocity_km_s(tai_ns(day)) - erfa.epv00(day, 0.0)[1]["v"] * AU_KM / 86_400.0)
        for day in DAYS
    ]
    assert max(error) < 0.04


def test_the_constant_of_aberration() -> None:
    speed = [np.linalg.norm(earth_velocity_km_s(tai_ns(day))) for day in DAYS]
    assert np.mean(speed) / SPEED_OF_LIGHT_KM_S / ARCSEC == pytest.approx(20.4955, abs=0.01)


def test_apparent_directions_equal_erfa() -> None:
    vectors = random_directions(np.random.default_rng(2), 500)
    for velocity in ([-20.0, 15.0, 25.0], [300.0, 0.0, 0.0]):
        beta = np.array(velocity) / SPEED_OF_LIGHT_KM_S
        expected = erfa.ab(vectors, beta, 1e12, np.sqrt(1 - beta @ beta))  # 1e12 au: no light deflection
        np.testing.assert_allclose(apparent_directions(vectors, np.array(velocity)), expected, atol=1e-13)


def test_a_star_moves_towards_the_apex() -> None:
    moved = apparent_directions(np.array([[1.0, 0.0, 0.0]]), np.array([0.0, 29.8, 0.0]))[0]
    assert np.arctan2(moved[1], moved[0]) / ARCSEC == pytest.approx(20.5, abs=0.05)


def test_an_observer_at_rest_sees_the_catalogue() -> None:
    vectors = random_directions(np.random.default_rng(4), 50)
    np.testing.assert_array_equal(apparent_directions(vectors, np.zeros(3)), vectors)
