"""Camera geometry: pixels to unit vectors and back, and the four-plane test of the field of view.

Sensor frame S: +Z boresight, outwards; +X to increasing column, +Y to increasing row. Pixel coordinates:
x = column, y = row, an integer is the centre of a pixel. Distortion: Brown's model with two radial and two
tangential terms, ``r2 = x^2 + y^2``, ``xd = x (1 + k1 r2 + k2 r2^2) + 2 p1 x y + p2 (r2 + 2 x^2)``,
``yd = y (1 + k1 r2 + k2 r2^2) + p1 (r2 + 2 y^2) + 2 p2 x y`` of ``(x, y) = (X/Z, Y/Z)``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["CameraGeometry"]

FloatArray = NDArray[np.float64]


@numba.njit(nogil=True)
def _unit_vectors(x_px: FloatArray, y_px: FloatArray, camera: tuple[float, ...], vectors: FloatArray) -> int:
    """Write the unit vectors; returns the steps of Newton's method that all of them took."""
    steps = 0
    focal, cx, cy, k1, k2, p1, p2, _ = camera
    distorted = k1 != 0.0 or k2 != 0.0 or p1 != 0.0 or p2 != 0.0
    for i in range(x_px.shape[0]):
        xd = (x_px[i] - cx) / focal
        yd = (y_px[i] - cy) / focal
        x = xd
        y = yd
        if distorted:
            # Newton's method; a few steps suffice, since the distortion of a lens is a small correction
            for _step in range(20):
                steps += 1
                r2 = x * x + y * y
                radial = 1.0 + (k1 + k2 * r2) * r2
                slope = 2.0 * (k1 + 2.0 * k2 * r2)
                ex = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - xd
                ey = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y - yd
                jxx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
                jxy = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
                jyy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
                determinant = jxx * jyy - jxy * jxy
                if determinant == 0.0:
                    break
                dx = (jyy * ex - jxy * ey) / determinant
                dy = (jxx * ey - jxy * ex) / determinant
                x -= dx
                y -= dy
                if abs(dx) + abs(dy) < 1e-14:
                    break
        scale = 1.0 / math.sqrt(1.0 + x * x + y * y)
        vectors[i, 0] = x * scale
        vectors[i, 1] = y * scale
        vectors[i, 2] = scale
    return steps


@numba.njit(nogil=True)
def _project(
    vectors: FloatArray,
    camera: tuple[float, ...],
    x_px: FloatArray,
    y_px: FloatArray,
    ahead: NDArray[np.bool_],
) -> None:
    focal, cx, cy, k1, k2, p1, p2, r2_limit = camera
    for i in range(vectors.shape[0]):
        if vectors[i, 2] <= 0.0:
            x_px[i] = np.nan
            y_px[i] = np.nan
            ahead[i] = False
            continue
        x = vectors[i, 0] / vectors[i, 2]
        y = vectors[i, 1] / vectors[i, 2]
        r2 = x * x + y * y
        if r2 > r2_limit:
            x_px[i] = np.nan
            y_px[i] = np.nan
            ahead[i] = False
            continue
        radial = 1.0 + (k1 + k2 * r2) * r2
        x_px[i] = cx + focal * (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x))
        y_px[i] = cy + focal * (y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y)
        ahead[i] = True


@numba.njit(nogil=True)
def _in_field(vectors: FloatArray, normals: FloatArray, inside: NDArray[np.bool_]) -> None:
    for i in range(vectors.shape[0]):
        v0, v1, v2 = vectors[i, 0], vectors[i, 1], vectors[i, 2]
        inside[i] = True
        for j in range(4):
            if v0 * normals[j, 0] + v1 * normals[j, 1] + v2 * normals[j, 2] <= 0.0:
                inside[i] = False
                break


def _monotonic_r2(k1: float, k2: float) -> float:
    """Largest (X/Z)^2 + (Y/Z)^2 up to which the radial distortion still grows outwards.

    Beyond it the polynomial folds back, and a star far outside would seem to be in the image.
    """
    # d/dr of r + k1 r^3 + k2 r^5 = 1 + 3 k1 s + 5 k2 s^2 with s = r^2; 1 / s is a root of t^2 + 3 k1 t + 5 k2
    discriminant = 9.0 * k1 * k1 - 20.0 * k2
    if discriminant < 0.0:
        return math.inf
    largest = 0.5 * (-3.0 * k1 + math.sqrt(discriminant))
    return 1.0 / largest if largest > 1e-300 else math.inf


@dataclass(frozen=True)
class CameraGeometry:
    """Pinhole with distortion. ``cx_px, cy_px`` left out (nan): the middle of the image.

    Raises ValueError for an impossible size or focal length, and where the distortion folds back inside the
    image (no direction belongs to some of its pixels).
    """

    width_px: int
    height_px: int
    focal_px: float
    cx_px: float = math.nan
    cy_px: float = math.nan
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    _camera: tuple[float, ...] = field(init=False, repr=False, compare=False)
    _edge_sag_px: float = field(init=False, repr=False, compare=False)
    _normals: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.width_px < 1 or self.height_px < 1 or not self.focal_px > 0.0:
            raise ValueError("a camera needs at least one pixel and a positive focal length")
        cx = (self.width_px - 1) / 2 if math.isnan(self.cx_px) else float(self.cx_px)
        cy = (self.height_px - 1) / 2 if math.isnan(self.cy_px) else float(self.cy_px)
        object.__setattr__(self, "cx_px", cx)
        object.__setattr__(self, "cy_px", cy)
        camera = (float(self.focal_px), cx, cy, *(float(k) for k in (self.k1, self.k2, self.p1, self.p2)))
        object.__setattr__(self, "_camera", (*camera, _monotonic_r2(self.k1, self.k2)))
        # nan where a corner's undistorted place lies beyond the fold
        if not self.project(self.corner_vectors())[2].all():
            raise ValueError("the distortion folds back inside the image: k1, k2 do not fit the focal length")
        object.__setattr__(self, "_edge_sag_px", self._find_edge_sag())
        object.__setattr__(self, "_normals", self.field_normals(self._edge_sag_px))

    @property
    def distorted(self) -> bool:
        """Whether any distortion term is not zero."""
        return any((self.k1, self.k2, self.p1, self.p2))

    @property
    def kernel_parameters(self) -> tuple[float, ...]:
        """Focal length, cx, cy, k1, k2, p1, p2 and the largest (X/Z)^2 + (Y/Z)^2 before the distortion folds
        back (inf: it never does).
        """
        return self._camera

    @property
    def plane_normals(self) -> FloatArray:
        """Normals of the planes of ``in_field`` without a margin, ``float64[4, 3]``."""
        return self._normals

    def unit_vectors(self, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        """Directions in S of points of the image: ``float64[n], float64[n] -> float64[n, 3]``, unit."""
        return self.counted_unit_vectors(x_px, y_px)[0]

    def counted_unit_vectors(self, x_px: FloatArray, y_px: FloatArray) -> tuple[FloatArray, int]:
        """As ``unit_vectors``, with the steps of Newton's method that they took (0: no distortion)."""
        x = np.ascontiguousarray(x_px, np.float64).reshape(-1)
        y = np.ascontiguousarray(y_px, np.float64).reshape(-1)
        vectors = np.empty((len(x), 3))
        steps = _unit_vectors(x, y, self._camera, vectors)
        return vectors, int(steps)

    def project(self, v_sensor: FloatArray) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Image points of directions in S: ``float64[n, 3] -> x_px[n], y_px[n], ahead[n]``.

        ``ahead`` is False (and the point nan) for directions behind the camera, and for those so far off
        axis that the distortion polynomial folds back.
        """
        v = np.ascontiguousarray(v_sensor, np.float64).reshape(-1, 3)
        x, y, ahead = np.empty(len(v)), np.empty(len(v)), np.empty(len(v), np.bool_)
        _project(v, self._camera, x, y, ahead)
        return x, y, ahead

    def in_image(self, x_px: FloatArray, y_px: FloatArray, border_px: float = 0.0) -> NDArray[np.bool_]:
        """Whether points lie on the detector, at least ``border_px`` from its edge (negative: beyond it)."""
        low = border_px - 0.5
        right, bottom = self.width_px - 0.5 - border_px, self.height_px - 0.5 - border_px
        return np.asarray((x_px >= low) & (x_px <= right) & (y_px >= low) & (y_px <= bottom))

    def corner_vectors(self, margin_px: float = 0.0) -> FloatArray:
        """Unit vectors b_1..b_4 in S of the detector's outer corners, ``float64[4, 3]``.

        Order: top left, top right, bottom right, bottom left, which makes the normals of eq. (3) point
        inwards. ``margin_px`` moves the corners outwards (negative: inwards).
        """
        low = -0.5 - margin_px
        right, bottom = self.width_px - 0.5 + margin_px, self.height_px - 0.5 + margin_px
        return self.unit_vectors(np.array([low, right, right, low]), np.array([low, low, bottom, bottom]))

    def field_normals(self, margin_px: float = 0.0) -> FloatArray:
        """Inward normals n_12, n_23, n_34, n_41 of the four planes, ``float64[4, 3]``, paper R eq. (3)."""
        b = self.corner_vectors(margin_px)
        normals = np.cross(b, np.roll(b, -1, axis=0))
        return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))

    def in_field(self, v_sensor: FloatArray, margin_px: float = 0.0) -> NDArray[np.bool_]:
        """Four-plane test, paper R eq. (4): ``float64[n, 3] -> bool[n]``.

        Exact for a camera without distortion. With distortion the edges of the field are curved: the planes
        then enclose the field (they are moved out by the largest sag of an edge), so that no star of the
        image is lost; ``project`` and ``in_image`` decide exactly.
        """
        v = np.ascontiguousarray(v_sensor, np.float64).reshape(-1, 3)
        normals = self._normals if margin_px == 0.0 else self.field_normals(self._edge_sag_px + margin_px)
        inside = np.empty(len(v), np.bool_)
        _in_field(v, normals, inside)
        return inside

    @property
    def field_of_view_deg(self) -> tuple[float, float]:
        """Angles between the middles of opposite edges: across the columns, across the rows; degrees."""
        middle_x, middle_y = (self.width_px - 1) / 2, (self.height_px - 1) / 2
        x = np.array([-0.5, self.width_px - 0.5, middle_x, middle_x])
        y = np.array([middle_y, middle_y, -0.5, self.height_px - 0.5])
        v = self.unit_vectors(x, y)
        return _angle_deg(v[0], v[1]), _angle_deg(v[2], v[3])

    @property
    def pixels_per_degree(self) -> float:
        """eps of paper R eq. (1), RowPixel / FOV_y, with the field of view that the geometry gives."""
        return self.height_px / self.field_of_view_deg[1]

    @property
    def max_pixels_per_degree(self) -> float:
        """Largest scale anywhere in the image (a tangent projection stretches outwards), for sizing windows.

        ASSUMED: the scale is largest at a corner or in the middle, as for any lens of moderate distortion.
        """
        step = 1e-4
        largest = 0.0
        middle = self.unit_vectors(np.array([self.cx_px]), np.array([self.cy_px]))
        for v in (*self.corner_vectors(), *middle):
            # two tangential directions: outwards, and across
            side = np.cross([0.0, 0.0, 1.0], v) if abs(v[2]) < 1.0 - 1e-9 else np.array([1.0, 0.0, 0.0])
            side /= np.linalg.norm(side)
            for direction in (side, np.cross(side, v)):
                ends = np.stack([v - 0.5 * step * direction, v + 0.5 * step * direction])
                x, y, _ = self.project(ends)
                largest = max(largest, math.hypot(x[1] - x[0], y[1] - y[0]) / math.degrees(step))
        return largest

    @property
    def half_diagonal_rad(self) -> float:
        """Largest angle between the boresight (+Z) and a corner."""
        corners = self.corner_vectors()
        return float(np.arccos(np.clip(corners[:, 2], -1.0, 1.0)).max())

    def _find_edge_sag(self) -> float:
        """How far, in px, an edge of the field bulges beyond the plane through its two corners."""
        if not self.distorted:
            return 0.0
        t = np.linspace(0.0, 1.0, 65)
        nought = 0.0 * t
        left, right, top, bottom = -0.5, self.width_px - 0.5, -0.5, self.height_px - 0.5
        across, down = t * (right - left), t * (bottom - top)
        x = np.concatenate([left + across, nought + right, right - across, nought + left])
        y = np.concatenate([nought + top, top + down, nought + bottom, bottom - down])
        edges = self.unit_vectors(x, y).reshape(4, len(t), 3)
        depth_rad = np.einsum("ijk,ik->ij", edges, self.field_normals())
        sag = -float(depth_rad.min()) * self.max_pixels_per_degree * math.degrees(1.0)
        return 1.25 * sag + 0.01 if sag > 1e-9 else 0.0  # a little more: the planes turn as they move


def _angle_deg(a: FloatArray, b: FloatArray) -> float:
    return math.degrees(math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b)))
