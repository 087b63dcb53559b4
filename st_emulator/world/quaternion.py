"""Attitude algebra of the truth side.

Conventions, held everywhere in this room:

- a quaternion is ``float64[..., 4]``, ``[x, y, z, w]``, scalar last;
- it is passive and says its direction: ``q_icrs_to_sensor`` turns the components of a vector in ICRS into its
  components in the sensor frame, ``v_S = A(q) v_ICRS`` with ``A(q) = (w^2 - v.v) I + 2 v v^T - 2 w [v x]``
  (Shuster, "A Survey of Attitude Representations", J. Astronaut. Sci. 41 (1993), equation 97);
- products keep the order of the matrices: ``A(multiply(a, b)) = A(a) A(b)`` (the same paper, equations
  171-172);
- the canonical sign is ``w >= 0``.

All functions broadcast over leading axes. Angles in radians unless a suffix says otherwise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

IDENTITY: Array = np.array([0.0, 0.0, 0.0, 1.0])


def canonical(q: ArrayLike) -> Array:
    """The same attitude as a unit quaternion with ``w >= 0``. Raises ValueError for a zero or non-finite
    one."""
    q = np.asarray(q, dtype=np.float64)
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if not np.all(np.isfinite(norm)) or np.any(norm == 0.0):
        raise ValueError("a quaternion needs four finite numbers, not all zero")
    return np.asarray(np.where(q[..., 3:4] < 0.0, -q, q) / norm)


def conjugate(q: ArrayLike) -> Array:
    """The inverse rotation of a unit quaternion."""
    return np.asarray(np.asarray(q, dtype=np.float64) * np.array([-1.0, -1.0, -1.0, 1.0]))


def multiply(a: ArrayLike, b: ArrayLike) -> Array:
    """First b, then a: ``A(multiply(a, b)) = A(a) A(b)``."""
    a, b = np.broadcast_arrays(np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64))
    ax, ay, az, aw = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bx, by, bz, bw = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    # vector part: a_w b + b_w a - a x b
    return np.stack(
        (
            aw * bx + bw * ax - (ay * bz - az * by),
            aw * by + bw * ay - (az * bx - ax * bz),
            aw * bz + bw * az - (ax * by - ay * bx),
            aw * bw - ax * bx - ay * by - az * bz,
        ),
        axis=-1,
    )


def attitude_matrix(q: ArrayLike) -> Array:
    """A(q), ``float64[..., 3, 3]``, of unit quaternions."""
    q = np.asarray(q, dtype=np.float64)
    x, y, z, w = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    matrix = np.empty((*q.shape[:-1], 3, 3))
    matrix[..., 0, 0] = w * w + x * x - y * y - z * z
    matrix[..., 0, 1] = 2.0 * (x * y + w * z)
    matrix[..., 0, 2] = 2.0 * (x * z - w * y)
    matrix[..., 1, 0] = 2.0 * (x * y - w * z)
    matrix[..., 1, 1] = w * w - x * x + y * y - z * z
    matrix[..., 1, 2] = 2.0 * (y * z + w * x)
    matrix[..., 2, 0] = 2.0 * (x * z + w * y)
    matrix[..., 2, 1] = 2.0 * (y * z - w * x)
    matrix[..., 2, 2] = w * w - x * x - y * y + z * z
    return matrix


def from_matrix(matrix: ArrayLike) -> Array:
    """The canonical quaternion of one proper orthogonal matrix ``float64[3, 3]`` (Shepperd's method)."""
    m = np.asarray(matrix, dtype=np.float64)
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    largest = int(np.argmax([m[0, 0], m[1, 1], m[2, 2], trace]))
    q = np.empty(4)
    if largest == 3:
        q[:] = (m[1, 2] - m[2, 1], m[2, 0] - m[0, 2], m[0, 1] - m[1, 0], 1.0 + trace)
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        q[i] = 1.0 + m[i, i] - m[j, j] - m[k, k]
        q[j] = m[i, j] + m[j, i]
        q[k] = m[i, k] + m[k, i]
        q[3] = m[j, k] - m[k, j]
    return canonical(q)


def rotate(q: ArrayLike, vectors: ArrayLike) -> Array:
    """``A(q) v``: for ``q_icrs_to_sensor`` the sensor components of ICRS vectors ``[..., 3]``."""
    q = np.asarray(q, dtype=np.float64)
    v = np.asarray(vectors, dtype=np.float64)
    return np.asarray(np.einsum("...ij,...j->...i", attitude_matrix(q), v))


def from_rotation_vector(rotation: ArrayLike) -> Array:
    """``A = exp(-[rotation x])``: the frame turned by the vector ``[..., 3]`` (rad), given in either frame's
    axes.

    Not made canonical, so that a sequence of growing rotations stays continuous.
    """
    rotation = np.asarray(rotation, dtype=np.float64)
    angle = np.linalg.norm(rotation, axis=-1, keepdims=True)
    # np.sinc(x) = sin(pi x) / (pi x): exact at zero without a branch
    return np.concatenate((0.5 * np.sinc(angle / (2.0 * np.pi)) * rotation, np.cos(0.5 * angle)), axis=-1)


def to_rotation_vector(q: ArrayLike) -> Array:
    """The inverse of `from_rotation_vector`, the shortest one: angle in [0, pi] rad."""
    q = canonical(q)
    v, w = q[..., :3], q[..., 3:4]
    sine = np.linalg.norm(v, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, w)
    scale = np.where(sine > 1e-12, angle / np.where(sine > 1e-12, sine, 1.0), 2.0)
    return np.asarray(scale * v)


def error_rotation_vector(q_estimated: ArrayLike, q_true: ArrayLike) -> Array:
    """Attitude error ``[..., 3]`` in rad, sensor axes: ``A(q_estimated) = exp(-[e x]) A(q_true)``.

    e[0], e[1] are the errors about the two cross-boresight axes, e[2] the one about the boresight (roll).
    """
    return to_rotation_vector(multiply(q_estimated, conjugate(q_true)))


def quaternion_from_pointing(ra_deg: float, dec_deg: float, roll_deg: float) -> Array:
    """q_icrs_to_sensor that looks at (ra, dec) with the image "up" (-Y) at position angle roll, degrees east
    of north."""
    ra, dec, roll = np.radians([ra_deg, dec_deg, roll_deg])
    boresight = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    north = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    y_axis = -(np.cos(roll) * north + np.sin(roll) * east)
    x_axis = np.cross(y_axis, boresight)
    return from_matrix(np.stack((x_axis, y_axis, boresight)))


def pointing_from_quaternion(q_icrs_to_sensor: ArrayLike) -> tuple[float, float, float]:
    """(ra, dec, roll) in degrees of one attitude: ra in [0, 360), roll in (-180, 180], as in
    `quaternion_from_pointing`.

    At a celestial pole right ascension and roll are one angle: whatever ``atan2`` makes of the rounding.
    """
    matrix = attitude_matrix(canonical(q_icrs_to_sensor))
    bx, by, bz = matrix[2]
    up = -matrix[1]
    ra = np.arctan2(by, bx)
    dec = np.arctan2(bz, np.hypot(bx, by))
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    north = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    roll = np.degrees(np.arctan2(up @ east, up @ north))
    return (
        float(np.degrees(ra) % 360.0 % 360.0),  # twice: -1e-16 % 360 is 360
        float(np.degrees(dec)),
        float(roll) if roll > -180.0 else 180.0,
    )
