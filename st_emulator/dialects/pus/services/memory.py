"""ST[06] memory: a patch area, the program, the stored parameters, the captured image."""

from __future__ import annotations

import json
from typing import Any

from ....device.commands import LoadMemory, modes_of
from ....device.star_tracker import StarTracker
from ....protocol.pus.enumerations import FailureCode, MemoryId
from ....protocol.pus.packets import crc16_ccitt
from ..serving import ANY, Execute, Served, command
from ..verification import RejectedError, Request
from .large_data import LargeData

NON_VOLATILE_BYTES = 2048  # ASSUMED: room for every parameter as JSON text, the rest zero
WRITABLE = {MemoryId.RAM: "ram", MemoryId.PROGRAM: "program"}


class MemoryManagement:
    """Loads, dumps and checks memories by their numbers."""

    def __init__(self, device: StarTracker, image: LargeData) -> None:
        self._device = device
        self._image = image

    def contents(self, memory_id: int) -> bytes | bytearray:
        """All octets of a memory; refuses an unknown one and an image that was never captured."""
        match memory_id:
            case MemoryId.RAM:
                return self._device.memories.ram
            case MemoryId.PROGRAM:
                return self._device.memories.program
            case MemoryId.NON_VOLATILE:
                text = json.dumps(self._device.parameters.stored_values(), sort_keys=True).encode()
                return text.ljust(NON_VOLATILE_BYTES, b"\0")
            case MemoryId.IMAGE:
                if not self._image.data:
                    raise RejectedError(FailureCode.NO_IMAGE)
                return self._image.data
        raise RejectedError(FailureCode.UNKNOWN_ID, memory_id)

    def _wanted(self, fields: dict[str, Any]) -> bytes:
        contents = self.contents(fields["memory_id"])
        start = fields["start_address"]
        end = start + fields["length"]
        if end > len(contents):
            raise RejectedError(FailureCode.ADDRESS, start)
        return bytes(contents[start:end])

    def load(self, request: Request) -> Execute:
        fields = request.fields
        memory_id, data = fields["memory_id"], fields["data"]
        if memory_id not in WRITABLE:
            self.contents(memory_id)
            raise RejectedError(FailureCode.READ_ONLY, memory_id)
        execute = command(
            self._device, LoadMemory(WRITABLE[memory_id], fields["start_address"], data), request
        )
        checksum = crc16_ccitt(data)
        if checksum != fields["checksum"]:
            raise RejectedError(FailureCode.BAD_CHECKSUM, checksum)
        return execute

    def dump(self, request: Request) -> Execute:
        fields, data = request.fields, self._wanted(request.fields)

        def execute() -> None:
            request.answer(
                "memory_dump_report",
                {
                    "memory_id": fields["memory_id"],
                    "start_address": fields["start_address"],
                    "data": data,
                    "checksum": crc16_ccitt(data),
                },
            )
            request.completed()

        return execute

    def check(self, request: Request) -> Execute:
        fields, data = request.fields, self._wanted(request.fields)

        def execute() -> None:
            names = ("memory_id", "start_address", "length")
            request.answer(
                "memory_check_report",
                {name: fields[name] for name in names} | {"checksum": crc16_ccitt(data)},
            )
            request.completed()

        return execute


SERVED = {
    "memory_load": Served(modes_of(LoadMemory), MemoryManagement.load),
    "memory_dump": Served(ANY, MemoryManagement.dump),
    "memory_check": Served(ANY, MemoryManagement.check),
}
