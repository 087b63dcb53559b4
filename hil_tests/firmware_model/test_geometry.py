"""Camera geometry against plain formulas and scipy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from st_emulator.firmware_model.geometry import CameraGeometry

ROJA1 = CameraGeometry(752, 480, 41.1 / 0.006)  # paper R: 752 x 480 px of 6 um behind 41.1 mm
ZY3 = CameraGeometry(1024, 1024, 43.3 / 0.015)  # paper Z
BARREL = CameraGeometry(1024, 1024, 1500.0, 505.0, 520.0, k1=-0.2, k2=0.05, p1=1e-3, p2=-8e-4)
CAMERAS = {"roja1": ROJA1, "zy3": ZY3, "barrel": BARREL}

small = st.floats(-1.0, 1.0)
cameras = st.builds(
    lambda f, cx, cy, k1, k2, p1, p2: CameraGeometry(
        800, 600, f, 399.5 + 20 * cx, 299.5 + 20 * cy, 0.15 * k1, 0.05 * k2, 2e-3 * p1, 2e-3 * p2
    ),
    st.floats(1200.0, 8000.0),
    *[small] * 6,
)


def plain_projection(camera: CameraGeometry, v: np.ndarray) -> tuple[float, float]:
    """Brown's model written out for one star."""
    x, y = v[0] / v[2], v[1] / v[2]
    r2 = x * x + y * y
    radial = 1 + camera.k1 * r2 + camera.k2 * r2**2
    xd = x * radial + 2 * camera.p1 * x * y + camera.p2 * (r2 + 2 * x * x)
    yd = y * radial + camera.p1 * (r2 + 2 * y * y) + 2 * camera.p2 * x * y
    return camera.cx_px + camera.focal_px * xd, camera.cy_px + camera.focal_px * yd


def test_axes_of_the_sensor_frame() -> None:
    camera = CameraGeometry(101, 51, 1000.0)
    assert (camera.cx_px, camera.cy_px) == (50.0, 25.0)
    v = camera.unit_vectors(np.array([50.0, 60.0, 50.0]), np.array([25.0, 25.0, 35.0]))
    assert v[0] == pytest.approx([0, 0, 1])
    assert v[1, 0] > 0
    assert v[1, 1] == 0
    assert v[2, 1] > 0
    assert v[2, 0] == 0
    assert math.degrees(math.acos(v[0] @ v[1])) == pytest.approx(math.degrees(math.atan(0.01)))


def newton_steps(camera: CameraGeometry, x_px: float, y_px: float) -> int:
    """Steps of Newton's method with a matrix written out, until the correction is below 1e-14."""
    at = np.array([(x_px - camera.cx_px) / camera.focal_px, (y_px - camera.cy_px) / camera.focal_px])
    wanted = at.copy()
    for steps in range(1, 21):
        x, y = at
        r2 = x * x + y * y
        radial, slope = 1 + camera.k1 * r2 + camera.k2 * r2**2, 2 * camera.k1 + 4 * camera.k2 * r2
        off = [
            x * radial + 2 * camera.p1 * x * y + camera.p2 * (r2 + 2 * x * x),
            y * radial + camera.p1 * (r2 + 2 * y * y) + 2 * camera.p2 * x * y,
        ] - wanted
        mixed = slope * x * y + 2 * camera.p1 * x + 2 * camera.p2 * y
        xx = radial + slope * x * x + 2 * camera.p1 * y + 6 * camera.p2 * x
        yy = radial + slope * y * y + 6 * camera.p1 * y + 2 * camera.p2 * x
        step = np.linalg.solve([[xx, mixed], [mixed, yy]], off)
        at -= step
        if np.abs(step).sum() < 1e-14:
            return steps
    return 20


def test_steps_of_newtons_method_are_counted() -> None:
    x, y = np.array([505.0, 5.0, 1000.0, 700.0]), np.array([520.0, 5.0, 30.0, 350.0])
    vectors, steps = BARREL.counted_unit_vectors(x, y)
    assert (vectors == BARREL.unit_vectors(x, y)).all()
    assert steps == sum(newton_steps(BARREL, *place) for place in zip(x, y, strict=True))
    assert steps > 3 * 3  # off the axis one never does
    assert ZY3.counted_unit_vectors(x, y)[1] == 0


@settings(max_examples=50, deadline=None)
@given(cameras, st.integers(0, 2**32 - 1))
def test_projection_and_its_inverse(camera: CameraGeometry, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-0.5, 799.5, 40), rng.uniform(-0.5, 599.5, 40)
    v = camera.unit_vectors(x, y)
    assert np.linalg.norm(v, axis=1) == pytest.approx(np.ones(40), abs=1e-15)
    back_x, back_y, ahead = camera.project(v)
    assert ahead.all()
    assert np.abs(back_x - x).max() < 1e-9
    assert np.abs(back_y - y).max() < 1e-9
    for i in range(3):
        assert (back_x[i], back_y[i]) == pytest.approx(plain_projection(camera, v[i]), abs=1e-9)


def test_what_is_behind_is_not_ahead() -> None:
    x, y, ahead = ROJA1.project(np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    assert ahead.tolist() == [False, False, True]
    assert np.isnan(x[:2]).all()
    assert np.isnan(y[:2]).all()


def test_a_folding_distortion_shows_no_star_from_outside() -> None:
    """With k1 < 0 the polynomial comes back to the middle far off axis; such stars are not in the image."""
    camera = CameraGeometry(1000, 1000, 1000.0, k1=-0.25)
    off_axis = math.sqrt(1 / 0.25)  # r (1 - 0.25 r^2) = 0: projected right onto the centre
    v = np.array([[off_axis, 0.0, 1.0]]) / math.hypot(off_axis, 1.0)
    assert plain_projection(camera, v[0]) == pytest.approx((499.5, 499.5))
    assert not camera.project(v)[2][0]
    assert camera.project(camera.unit_vectors(np.array([0.0]), np.array([0.0])))[2][0]


@pytest.mark.parametrize("name", CAMERAS)
def test_field_normals_point_inwards(name: str) -> None:
    """Eq. (3): n_ij = b_i x b_j / |b_i x b_j| of the corners in turn."""
    camera = CAMERAS[name]
    b, n = camera.corner_vectors(), camera.field_normals()
    for i in range(4):
        j = (i + 1) % 4
        cross = np.cross(b[i], b[j])
        assert n[i] == pytest.approx(cross / np.linalg.norm(cross))
        assert n[i][2] > 0  # the boresight is inside
    x, y, _ = camera.project(b)
    w, h = camera.width_px - 0.5, camera.height_px - 0.5
    assert x == pytest.approx([-0.5, w, w, -0.5])
    assert y == pytest.approx([-0.5, -0.5, h, h])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([ROJA1, ZY3]), st.floats(-20, 50))
def test_four_planes_are_exact_without_distortion(seed: int, camera: CameraGeometry, margin: float) -> None:
    """Eq. (4) and the projection must agree on every star of a cap about the boresight."""
    rng = np.random.default_rng(seed)
    tilt = rng.uniform(0, 1.3 * camera.half_diagonal_rad, 200)
    v = Rotation.from_euler("yz", np.stack([tilt, rng.uniform(0, 2 * np.pi, 200)], 1)).apply([0, 0, 1])
    v[:20] *= -1
    x, y, ahead = camera.project(v)
    expected = ahead & camera.in_image(np.nan_to_num(x, nan=-1e9), np.nan_to_num(y, nan=-1e9), -margin)
    assert (camera.in_field(v, margin) == expected).all()


@settings(max_examples=40, deadline=None)
@given(cameras, st.integers(0, 2**32 - 1))
def test_four_planes_lose_no_star_of_a_distorted_image(camera: CameraGeometry, seed: int) -> None:
    rng = np.random.default_rng(seed)
    t = rng.uniform(0, 1, 50)
    x = np.concatenate([t * 799 - 0.4, np.full(50, -0.45), t * 799, np.full(50, 799.45)])
    y = np.concatenate([np.full(50, -0.45), t * 599, np.full(50, 599.45), t * 599])
    assert camera.in_field(camera.unit_vectors(x, y)).all()
    outside = camera.unit_vectors(np.array([-60.0, 400.0]), np.array([300.0, 670.0]))
    assert not camera.in_field(outside).any()  # and the planes stay near the edges


def test_fields_of_view_of_the_papers() -> None:
    # paper R, by geometry: 6.28 x 4.01 deg, diagonal 7.45 deg, 480 px / 4.01 deg = 119.7 px/deg
    assert ROJA1.field_of_view_deg == pytest.approx((6.28, 4.01), abs=0.01)
    assert 2 * math.degrees(ROJA1.half_diagonal_rad) == pytest.approx(7.45, abs=0.01)
    assert ROJA1.pixels_per_degree == pytest.approx(119.6, abs=0.1)
    assert ROJA1.pixels_per_degree == pytest.approx(480 / (2 * math.degrees(math.atan(240 / 6850))))
    # paper Z: 20 x 20 deg
    assert ZY3.field_of_view_deg == pytest.approx((20.1, 20.1), abs=0.05)


@pytest.mark.parametrize("name", CAMERAS)
def test_largest_scale_bounds_every_motion(name: str) -> None:
    """A star that turns by a small angle moves no more pixels than max_pixels_per_degree says."""
    camera = CAMERAS[name]
    rng = np.random.default_rng(1)
    v = camera.unit_vectors(
        rng.uniform(0, camera.width_px - 1, 300), rng.uniform(0, camera.height_px - 1, 300)
    )
    turned = Rotation.from_rotvec(np.radians(0.01) * np.array([0.6, -0.8, 0.0])).apply(v)
    x0, y0, _ = camera.project(v)
    x1, y1, _ = camera.project(turned)
    fastest = np.hypot(x1 - x0, y1 - y0).max() / 0.01
    assert fastest <= camera.max_pixels_per_degree * 1.001
    assert fastest >= camera.max_pixels_per_degree * 0.9


def test_no_stars_is_no_error() -> None:
    nothing = np.zeros(0)
    assert ROJA1.unit_vectors(nothing, nothing).shape == (0, 3)
    x, y, ahead = ROJA1.project(np.zeros((0, 3)))
    assert len(x) == len(y) == len(ahead) == len(ROJA1.in_field(np.zeros((0, 3)))) == 0


def test_a_distortion_that_folds_inside_the_image_is_refused() -> None:
    with pytest.raises(ValueError, match="folds back"):
        CameraGeometry(1000, 1000, 1000.0, k1=-0.3)


@pytest.mark.parametrize("bad", [(0, 10, 1.0), (10, 0, 1.0), (10, 10, 0.0), (10, 10, math.nan)])
def test_impossible_cameras_are_refused(bad: tuple[int, int, float]) -> None:
    with pytest.raises(ValueError, match="focal length"):
        CameraGeometry(*bad)
