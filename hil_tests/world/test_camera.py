"""Projection of the true camera."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from st_emulator.world.camera import CameraModel

PLAIN = CameraModel(
    width_px=1024,
    height_px=1000,
    focal_px=2886.67,
    psf_sigma_px=0.6,
    electrons_per_s_mag0=7.3e6,
    electrons_per_dn=10.0,
    full_well_electrons=60000.0,
    read_noise_electrons=50.0,
)
BENT = dataclasses.replace(PLAIN, k1=-0.2, k2=0.6, p1=0.002, p2=-0.001, cx_px=500.0, cy_px=507.25)


def test_pixel_axes_and_default_principal_point() -> None:
    assert PLAIN.principal_point_px == (511.5, 499.5)
    x, y, ahead = PLAIN.project([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.1, 1.0], [0.0, 0.0, -1.0]])
    np.testing.assert_allclose(x[:3], [511.5, 511.5 + 288.667, 511.5])
    np.testing.assert_allclose(y[:3], [499.5, 499.5, 499.5 + 288.667])
    assert ahead.tolist() == [True, True, True, False]


def test_distortion_terms_one_by_one() -> None:
    """Each coefficient moves a point as the formula says, worked by hand for x = 0.1, y = 0.2, r2 = 0.05."""
    moved = {"k1": (0.1 * 0.05, 0.2 * 0.05), "k2": (0.1 * 0.0025, 0.2 * 0.0025)}
    moved["p1"] = (2 * 0.1 * 0.2, 0.05 + 2 * 0.04)
    moved["p2"] = (0.05 + 2 * 0.01, 2 * 0.1 * 0.2)
    for name, (dx, dy) in moved.items():
        x, y, _ = dataclasses.replace(PLAIN, **{name: 0.01}).project([0.1, 0.2, 1.0])
        assert float(x) == pytest.approx(511.5 + 2886.67 * (0.1 + 0.01 * dx), abs=1e-9)
        assert float(y) == pytest.approx(499.5 + 2886.67 * (0.2 + 0.01 * dy), abs=1e-9)


@given(st.floats(-0.5, 1023.5), st.floats(-0.5, 999.5))
def test_pixels_and_directions_are_inverse(x: float, y: float) -> None:
    for camera in (PLAIN, BENT):
        vector = camera.unit_vectors(x, y)
        assert np.linalg.norm(vector) == pytest.approx(1.0, abs=1e-15)
        back_x, back_y, ahead = camera.project(vector)
        assert bool(ahead)
        assert float(back_x) == pytest.approx(x, abs=1e-9)
        assert float(back_y) == pytest.approx(y, abs=1e-9)


def test_half_diagonal_is_the_farthest_corner() -> None:
    expected = np.arctan(np.hypot(512.0, 500.0) / 2886.67)
    assert PLAIN.half_diagonal_rad() == pytest.approx(expected, rel=1e-12)
    corner = BENT.unit_vectors(1023.5, -0.5)
    assert BENT.half_diagonal_rad() >= np.arccos(corner[2])


@pytest.mark.parametrize(
    ("name", "value"),
    [("bits", 17), ("psf_sigma_px", 0.0), ("width_px", 0), ("prnu", -0.1), ("focal_px", float("nan"))],
)
def test_an_impossible_camera_is_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name} is .*; allowed is"):
        dataclasses.replace(PLAIN, **{name: value})
