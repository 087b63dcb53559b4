"""From the device's sensor frame to the frame of the quaternions on the wire."""

from __future__ import annotations

from typing import Final

import numpy as np

from ...device.commands import Quaternion
from ...firmware_model.attitude import quaternion_product

#: Passive turns from the device's frame (x columns, y rows, z boresight), scalar last. "+x": the wire's x, y
#: and z are the device's z, x and y, the matrix [[0, 0, 1], [1, 0, 0], [0, 1, 0]].
TURNS: Final[dict[str, Quaternion]] = {
    "+x": (-0.5, -0.5, -0.5, 0.5),
    "+z": (0.0, 0.0, 0.0, 1.0),
}


class WireFrame:
    """Turns attitudes: by the axis of the boresight, and behind that by the mounting.

    Args:
        boresight: axis of the boresight, a key of :data:`TURNS`.
    """

    def __init__(self, boresight: str) -> None:
        self._boresight = np.array(TURNS[boresight])
        self._turn = self._boresight

    def mount(self, mounting: Quaternion) -> None:
        """From now on turn by ``mounting`` (a unit quaternion, passive, scalar last) as well."""
        self._turn = quaternion_product(np.array(mounting), self._boresight)

    def of(self, q_icrs_to_sensor: Quaternion) -> Quaternion:
        """The attitude on the wire, inertial to wire frame, scalar last and never negative."""
        x, y, z, w = (float(value) for value in quaternion_product(self._turn, np.array(q_icrs_to_sensor)))
        return (x, y, z, w) if w >= 0.0 else (-x, -y, -z, -w)
