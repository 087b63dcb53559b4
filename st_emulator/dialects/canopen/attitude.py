"""The device's quaternion as the card's four numbers."""

from __future__ import annotations

from ...device.commands import Quaternion
from .settings import CanopenSettings

#: From the device's frame (x along columns, y along rows, +Z boresight) to one with +X boresight, +Y against
#: the columns and +Z against the rows: components (z, -x, -y).
TO_X_BORESIGHT: Quaternion = (0.5, -0.5, 0.5, 0.5)


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """First b, then a, of quaternions that turn components."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + bw * ax - (ay * bz - az * by),
        aw * by + bw * ay - (az * bx - ax * bz),
        aw * bz + bw * az - (ax * by - ay * bx),
        aw * bw - ax * bx - ay * by - az * bz,
    )


def card_quaternion(q_icrs_to_sensor: Quaternion, settings: CanopenSettings) -> Quaternion:
    """(i, j, k, real) as the card says it."""
    quaternion = q_icrs_to_sensor
    if settings.boresight == "x":
        quaternion = product(TO_X_BORESIGHT, quaternion)
    x, y, z, w = quaternion
    return (-x, -y, -z, w) if settings.direction == "sensor_to_icrs" else quaternion
