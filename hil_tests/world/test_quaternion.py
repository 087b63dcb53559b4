"""The attitude algebra against scipy's rotations and astropy's position angles."""

from __future__ import annotations

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from st_emulator.world import quaternion
from st_emulator.world.quaternion import pointing_from_quaternion, quaternion_from_pointing

component = st.floats(-1.0, 1.0).map(lambda x: round(x, 6))
quaternions = (
    st.tuples(component, component, component, component)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: quaternion.canonical(np.array(q)))
)
small = st.tuples(*[st.floats(-1.5, 1.5)] * 3).map(np.array)


@given(quaternions)
def test_matrix_is_the_transpose_of_the_active_rotation(q: np.ndarray) -> None:
    np.testing.assert_allclose(quaternion.attitude_matrix(q), Rotation.from_quat(q).as_matrix().T, atol=1e-14)


@given(quaternions, quaternions)
def test_product_keeps_the_order_of_the_matrices(a: np.ndarray, b: np.ndarray) -> None:
    product = quaternion.attitude_matrix(quaternion.multiply(a, b))
    np.testing.assert_allclose(
        product, Rotation.from_quat(a).as_matrix().T @ Rotation.from_quat(b).as_matrix().T, atol=1e-14
    )


@given(quaternions)
def test_matrix_and_quaternion_are_inverse(q: np.ndarray) -> None:
    back = quaternion.from_matrix(quaternion.attitude_matrix(q))
    assert abs(abs(back @ q) - 1.0) < 1e-14
    assert back[3] >= 0.0


@given(small)
def test_rotation_vector_is_the_exponential(rotation: np.ndarray) -> None:
    q = quaternion.from_rotation_vector(rotation)
    np.testing.assert_allclose(
        quaternion.attitude_matrix(q), Rotation.from_rotvec(rotation).as_matrix().T, atol=1e-14
    )
    np.testing.assert_allclose(quaternion.to_rotation_vector(q), rotation, atol=1e-12)


@given(quaternions, st.tuples(*[st.floats(-1e-3, 1e-3)] * 3).map(np.array))
def test_error_is_in_sensor_axes(q_true: np.ndarray, error: np.ndarray) -> None:
    # A(q_est) = exp(-[e x]) A(q_true), the exponential taken from scipy
    estimated = Rotation.from_rotvec(error).as_matrix().T @ quaternion.attitude_matrix(q_true)
    found = quaternion.error_rotation_vector(quaternion.from_matrix(estimated), q_true)
    np.testing.assert_allclose(found, error, atol=1e-13)


def test_a_small_rotation_keeps_its_digits() -> None:
    tiny = np.array([3e-11, -2e-11, 1e-11])
    np.testing.assert_allclose(
        quaternion.to_rotation_vector(quaternion.from_rotation_vector(tiny)), tiny, rtol=1e-12
    )


@pytest.mark.parametrize("bad", [[0.0, 0.0, 0.0, 0.0], [np.nan, 0.0, 0.0, 1.0], [np.inf, 0.0, 0.0, 1.0]])
def test_no_attitude_of_nothing(bad: list[float]) -> None:
    with pytest.raises(ValueError, match="four finite numbers"):
        quaternion.canonical(bad)


@given(st.floats(0.0, 359.999), st.floats(-89.9, 89.9), st.floats(-179.99, 180.0))
def test_pointing_there_and_back(ra: float, dec: float, roll: float) -> None:
    back = pointing_from_quaternion(quaternion_from_pointing(ra, dec, roll))
    assert abs((back[0] - ra + 180.0) % 360.0 - 180.0) < 1e-9
    assert abs(back[1] - dec) < 1e-9
    assert abs((back[2] - roll + 180.0) % 360.0 - 180.0) < 1e-9
    assert 0.0 <= back[0] < 360.0
    assert -180.0 < back[2] <= 180.0


@pytest.mark.parametrize(
    ("ra", "dec", "roll"), [(83.8, -5.4, 0.0), (12.0, 60.0, 35.0), (300.0, -75.0, -120.0), (0.0, 10.0, 179.0)]
)
def test_roll_is_astropys_position_angle_of_up(ra: float, dec: float, roll: float) -> None:
    matrix = quaternion.attitude_matrix(quaternion_from_pointing(ra, dec, roll))
    centre = SkyCoord(ra * u.deg, dec * u.deg)
    step = np.radians(0.01)
    for axis, angle in ((-matrix[1], roll), (matrix[1], roll + 180.0), (-matrix[0], roll + 90.0)):
        x, y, z = np.cos(step) * matrix[2] + np.sin(step) * axis
        beside = SkyCoord(x=x, y=y, z=z, representation_type="cartesian").represent_as("unitspherical")
        found = centre.position_angle(SkyCoord(beside.lon, beside.lat)).deg
        # an ordinary photograph with north up has east on its left: -X is 90 degrees east of -Y
        assert abs((found - angle + 180.0) % 360.0 - 180.0) < 1e-6


def test_axes_of_an_attitude_worked_by_hand() -> None:
    # Looking at (ra 0, dec 0) with north up: boresight +x of ICRS, image down -z, image right = west = -y.
    q = quaternion_from_pointing(0.0, 0.0, 0.0)
    expected = [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]
    np.testing.assert_allclose(quaternion.attitude_matrix(q), expected, atol=1e-15)


def test_functions_broadcast() -> None:
    q = quaternion.from_rotation_vector(np.linspace(0.0, 1.0, 12).reshape(4, 3))
    assert quaternion.attitude_matrix(q).shape == (4, 3, 3)
    assert quaternion.rotate(q, [1.0, 0.0, 0.0]).shape == (4, 3)
    np.testing.assert_allclose(
        quaternion.multiply(q, quaternion.conjugate(q)), np.tile([0, 0, 0, 1.0], (4, 1)), atol=1e-15
    )
