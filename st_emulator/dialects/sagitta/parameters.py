"""The parameters of the language: kept as they came, and given to the device where it has the like.

They are gone with each start of the unit, and so is what they changed in the device. ASSUMED: the known
driver sends all of them after each boot.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from typing import Any

from ...device.commands import CaptureImage, Refusal, RefusedError, SetParameters
from ...device.star_tracker import StarTracker
from ...firmware_model.parameter_table import PARAMETERS_BY_NAME as DEVICE_PARAMETERS
from ...protocol.sagitta.frames import Status
from ...protocol.sagitta.parameters import PARAMETER_TABLE, PARAMETERS
from ...protocol.sagitta.parameters import PARAMETERS_BY_NAME as DEFINITIONS
from ...protocol.sagitta.telemetry import TELEMETRY
from .solution import Validation
from .wire_frame import WireFrame

IMAGE_MODE = 1
LENGTH_TOLERANCE = 1e-3  # of a mounting quaternion; that of the known driver
Values = Mapping[str, Any]


class _BadArgumentsError(Exception):
    """An argument is out of range."""


class ParameterMemory:
    """What was set in this life.

    Args:
        device: takes what it understands.
        wire_frame: takes the mounting.
        validation: takes the limits of a valid solution.
        subscribe: takes the subscribed telemetry, in the order of its slots.
    """

    def __init__(
        self,
        device: StarTracker,
        wire_frame: WireFrame,
        validation: Validation,
        subscribe: Callable[[list[int]], None],
    ) -> None:
        self._device = device
        self._wire_frame = wire_frame
        self._validation = validation
        self._subscribe = subscribe
        self._before: dict[str, float | int] = {}
        self._arguments: dict[int, bytes] = {}
        self._mapped: dict[str, Callable[[Values], None]] = {
            "mounting": self._set_mounting,
            "camera": self._set_camera,
            "image_processor": self._set_image_processor,
            "centroiding": self._set_centroiding,
            "validation": self._set_validation,
            "algorithm": self._set_algorithm,
            "subscription": self._set_subscription,
        }
        assert set(self._mapped) == {entry.name for entry in PARAMETER_TABLE if entry.mapping}
        self.reset()

    def reset(self) -> None:
        """The defaults. What the device still holds of the life before waits for :meth:`give_back`."""
        self._arguments = {entry.id: entry.arguments.defaults for entry in PARAMETER_TABLE}
        self._wire_frame.mount((0.0, 0.0, 0.0, 1.0))
        default = DEFINITIONS["validation"].arguments.unpack(self._arguments[DEFINITIONS["validation"].id])
        assert default is not None
        self._set_validation(default)

    def give_back(self) -> None:
        """The device's own parameters again; at a later start where its mode does not take them."""
        if not self._before:
            return
        command = SetParameters(self._before)
        try:
            self._device.check(command)
        except RefusedError:
            return
        self._device.execute(command)
        self._before = {}

    def read(self, id_: int) -> bytes | None:
        """The arguments of a parameter as they were set; None: there is no such parameter."""
        return self._arguments.get(id_)

    def set(self, id_: int, arguments: bytes) -> Status:
        """Set a parameter; where the status is not OK nothing has changed."""
        definition = PARAMETERS.get(id_)
        if definition is None:
            return Status.NOT_IMPLEMENTED
        values = definition.arguments.unpack(arguments)
        if values is None:
            return Status.BAD_ARGUMENTS
        take = self._mapped.get(definition.name)
        if take is not None:
            try:
                take(values)
            except _BadArgumentsError:
                return Status.BAD_ARGUMENTS
            except RefusedError as error:
                late = error.refusal is Refusal.NOT_ALLOWED_IN_MODE
                return Status.NOT_NOW if late else Status.BAD_ARGUMENTS
        self._arguments[id_] = arguments
        return Status.OK

    # -- what the device understands

    def _give(self, name: str, value: float | int) -> None:
        device = self._device
        command = SetParameters({name: value})
        device.check(command)
        present = device.parameters[name]
        if DEVICE_PARAMETERS[name].stored(value) != present:
            self._before.setdefault(name, present)
            device.execute(command)

    def _set_mounting(self, values: Values) -> None:
        x, y, z, w = (float(values[axis]) for axis in "xyzw")
        length = math.sqrt(x * x + y * y + z * z + w * w)
        if not abs(length - 1.0) <= LENGTH_TOLERANCE:
            raise _BadArgumentsError
        self._wire_frame.mount((x / length, y / length, z / length, w / length))

    def _set_camera(self, values: Values) -> None:
        exposure_s = values["exposure_s"]
        if not math.isfinite(exposure_s):
            raise _BadArgumentsError
        self._give("exposure_us", round(exposure_s * 1e6))

    def _set_image_processor(self, values: Values) -> None:
        if values["mode"] != IMAGE_MODE:
            return
        try:
            self._device.check(CaptureImage())
        except RefusedError as error:
            if error.refusal is not Refusal.BUSY:  # one is on its way: it serves as well
                raise
        else:
            self._device.execute(CaptureImage())

    def _set_centroiding(self, values: Values) -> None:
        limit = values["max_magnitude"]
        if limit > DEVICE_PARAMETERS["magnitude_limit"].maximum:
            (limit,) = struct.unpack("<f", struct.pack("<f", self._device.profile.detection.magnitude_limit))
        self._give("magnitude_limit", limit)

    def _set_validation(self, values: Values) -> None:
        difference_deg, confidence = values["max_difference_deg"], values["min_confidence"]
        if math.isnan(difference_deg) or math.isnan(confidence):
            raise _BadArgumentsError
        self._validation.stable_count = values["stable_count"]
        self._validation.max_difference_deg = difference_deg
        self._validation.min_confidence = confidence
        self._validation.min_stars = values["min_stars"]

    def _set_algorithm(self, values: Values) -> None:
        self._give("tracking_min_stars", values["tracking_to_lisa_stars"])

    def _set_subscription(self, values: Values) -> None:
        wanted = [id_ for id_ in values["telemetry_ids"] if id_]
        if any(id_ not in TELEMETRY for id_ in wanted):
            raise _BadArgumentsError
        self._subscribe(values["telemetry_ids"])
