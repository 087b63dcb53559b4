"""ST[20] parameters."""

from __future__ import annotations

from ....device.commands import SetParameters, modes_of
from ....device.star_tracker import StarTracker
from ....protocol.pus.enumerations import ParameterId
from ..serving import ANY, Execute, Served, command
from ..verification import Request


def _name(parameter_id: int) -> str:
    return ParameterId(parameter_id).name.lower()


class ParameterManagement:
    """Reports and sets the device's parameters by their numbers."""

    def __init__(self, device: StarTracker) -> None:
        self._device = device

    def report(self, request: Request) -> Execute:
        values = [
            {"parameter_id": number, "value": self._device.parameters[_name(number)]}
            for number in request.fields["parameter_ids"]
        ]

        def execute() -> None:
            request.answer("parameter_values", {"values": values})
            request.completed()

        return execute

    def set(self, request: Request) -> Execute:
        settings = {_name(item["parameter_id"]): item["value"] for item in request.fields["settings"]}
        return command(self._device, SetParameters(settings), request)


SERVED = {
    "parameter_report": Served(ANY, ParameterManagement.report),
    "parameter_set": Served(modes_of(SetParameters), ParameterManagement.set),
}
