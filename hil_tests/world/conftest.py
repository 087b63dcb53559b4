"""Small worlds for the tests of the truth side."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from st_emulator.world.camera import CameraModel
from st_emulator.world.stars import StarField, star_field


def made_field(unit_vectors: ArrayLike, hp_mag: ArrayLike) -> StarField:
    """A sky of our own making, numbered from 1."""
    vectors = np.asarray(unit_vectors, dtype=np.float64).reshape(-1, 3)
    return StarField(
        hip=np.arange(1, len(vectors) + 1, dtype=np.int32),
        unit_vectors=vectors,
        hp_mag=np.asarray(hp_mag, dtype=np.float32).reshape(-1),
        parallax_rad=np.zeros(len(vectors), dtype=np.float32),
        epoch_jyear=2026.0,
    )


@pytest.fixture(scope="session")
def make_field() -> Callable[..., StarField]:
    return made_field


@pytest.fixture(scope="session")
def hipparcos() -> StarField:
    """Every star at J2026.0."""
    return star_field(2026.0)


@pytest.fixture(scope="session")
def camera() -> CameraModel:
    """A small camera with every effect: 160 x 120 px, 20 arcsec/px."""
    return CameraModel(
        width_px=160,
        height_px=120,
        focal_px=10313.24,
        psf_sigma_px=0.7,
        electrons_per_s_mag0=2e7,
        electrons_per_dn=4.0,
        full_well_electrons=30000.0,
        read_noise_electrons=9.0,
        bits=12,
        offset_dn=40.0,
        dark_electrons_s=400.0,
        dark_nonuniformity=0.1,
        stray_electrons_s=900.0,
        prnu=0.02,
        hot_pixel_fraction=0.01,
        hot_pixel_electrons_s=9000.0,
        k1=-0.3,
        k2=2.0,
        p1=0.001,
        p2=-0.002,
    )


def directions(
    q_icrs_to_sensor: NDArray[np.float64], camera: CameraModel, xy: ArrayLike
) -> NDArray[np.float64]:
    """ICRS unit vectors that fall on pixel coordinates [n, 2] at an attitude; scipy does the rotation."""
    from scipy.spatial.transform import Rotation

    points = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
    in_sensor = camera.unit_vectors(points[:, 0], points[:, 1])
    # q_icrs_to_sensor turns components; as an active rotation it turns sensor components back to ICRS
    return Rotation.from_quat(q_icrs_to_sensor).apply(in_sensor)


@pytest.fixture(scope="session")
def place_stars() -> Callable[..., NDArray[np.float64]]:
    return directions
