"""ST[08] functions: the device's commands by their numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ....device.commands import (
    LISTENING,
    RUNNING,
    Acquire,
    CaptureImage,
    ClearCounters,
    Command,
    GoStandby,
    Reset,
    RestoreParameters,
    RunSelfTest,
    Shutdown,
    TrackFrom,
    modes_of,
)
from ....device.star_tracker import StarTracker
from ....firmware_model.causes import ResetCause
from ....firmware_model.modes import Mode
from ....protocol.pus.enumerations import FailureCode, FunctionId, ResetKind
from ..serving import Execute, Served, command
from ..verification import RejectedError, Request
from .large_data import LargeData

QUATERNION_NORM_TOLERANCE = 1e-3  # ASSUMED: float64 on the wire; more is a mistake, not rounding
RESET_CAUSES = {ResetKind.WARM: ResetCause.WARM_RESET, ResetKind.COLD: ResetCause.COLD_RESET}

Arguments = Mapping[str, Any]


def _track_from(arguments: Arguments) -> Command:
    x, y, z, w = (arguments[f"q_{name}"] for name in "xyzw")
    norm = sum(value * value for value in (x, y, z, w)) ** 0.5
    if not abs(norm - 1) <= QUATERNION_NORM_TOLERANCE:
        raise RejectedError(FailureCode.OUT_OF_RANGE, int(FunctionId.TRACK_FROM))
    return TrackFrom((x / norm, y / norm, z / norm, w / norm))


@dataclass(frozen=True)
class _Commanded:
    """A function that is a command of the device."""

    kind: type[Command]
    of: Callable[[Arguments], Command]


COMMANDED: dict[FunctionId, _Commanded] = {
    FunctionId.GO_STANDBY: _Commanded(GoStandby, lambda _: GoStandby()),
    FunctionId.START_ACQUISITION: _Commanded(Acquire, lambda _: Acquire()),
    FunctionId.START_SELF_TEST: _Commanded(RunSelfTest, lambda _: RunSelfTest()),
    FunctionId.RESET: _Commanded(Reset, lambda given: Reset(RESET_CAUSES[ResetKind(given["kind"])])),
    FunctionId.CAPTURE_IMAGE: _Commanded(CaptureImage, lambda _: CaptureImage()),
    FunctionId.SHUTDOWN: _Commanded(Shutdown, lambda _: Shutdown()),
    FunctionId.CLEAR_COUNTERS: _Commanded(ClearCounters, lambda _: ClearCounters()),
    FunctionId.RESTORE_DEFAULT_PARAMETERS: _Commanded(RestoreParameters, lambda _: RestoreParameters()),
    FunctionId.TRACK_FROM: _Commanded(TrackFrom, _track_from),
}

#: The modes of the functions that are this language's own.
OWN_MODES: dict[FunctionId, tuple[Mode, ...]] = {
    FunctionId.DOWNLOAD_IMAGE: (*RUNNING, Mode.FAULT),
    FunctionId.ABORT_DOWNLOAD: LISTENING,
}


def allowed_modes(function_id: FunctionId) -> tuple[Mode, ...]:
    """The modes in which a function is allowed."""
    commanded = COMMANDED.get(function_id)
    return OWN_MODES[function_id] if commanded is None else modes_of(commanded.kind)


class Functions:
    """Executes functions."""

    def __init__(self, device: StarTracker, image: LargeData) -> None:
        self._device = device
        self._image = image

    def perform(self, request: Request) -> Execute:
        function_id = FunctionId(request.fields["function_id"])
        match function_id:
            case FunctionId.DOWNLOAD_IMAGE:
                return self._image.download(request)
            case FunctionId.ABORT_DOWNLOAD:
                return self._image.abort_download(request)
        wanted = COMMANDED[function_id].of(request.fields["arguments"])
        return command(self._device, wanted, request)


SERVED = {
    "function": Served(lambda fields: allowed_modes(FunctionId(fields["function_id"])), Functions.perform)
}
