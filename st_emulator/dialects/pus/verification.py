"""A telecommand on its way: what it asked for is reported to where it came from (service 1)."""

from __future__ import annotations

from typing import Any, Protocol

from ...device.commands import Failure
from ...protocol.pus.enumerations import FailureCode
from ...protocol.pus.packets import (
    ACK_ACCEPTANCE,
    ACK_COMPLETION,
    ACK_PROGRESS,
    ACK_START,
    RequestId,
    Telecommand,
)

FAILURE_CODES = {
    Failure.SUPERSEDED: FailureCode.SUPERSEDED,
    Failure.SELF_TEST_FAILED: FailureCode.SELF_TEST_FAILED,
    Failure.ABORTED: FailureCode.ABORTED,
}


class RejectedError(Exception):
    """A telecommand is refused; ``code`` and ``data`` go into its failure report. Nothing was changed."""

    def __init__(self, code: FailureCode, data: int = 0) -> None:
        super().__init__(f"{code.name} ({data})")
        self.code = code
        self.data = data


class Send(Protocol):
    """Sends a telemetry message by name. False: it is lost, or the unit is silent."""

    def __call__(self, name: str, fields: dict[str, Any], destination_id: int | None = None) -> bool: ...


class Request:
    """A telecommand and, once it is accepted, its reports, as its acknowledgement flags ask for them.

    It is the :class:`~st_emulator.device.commands.Running` of the device's command that it became.
    ``received_ns``: when its last bit came in, virtual time.
    """

    def __init__(self, telecommand: Telecommand, received_ns: int, send: Send) -> None:
        self.telecommand = telecommand
        self.received_ns = received_ns
        self._telemeter = send
        self._request_id = RequestId.from_packet(telecommand.raw).as_fields()
        self._open = True

    @property
    def fields(self) -> dict[str, Any]:
        """Those of the telecommand."""
        return self.telecommand.fields

    def _send(self, name: str, fields: dict[str, Any]) -> None:
        self._telemeter(name, fields, self.telecommand.source_id)

    def answer(self, name: str, fields: dict[str, Any]) -> None:
        """Send the telemetry that the telecommand asks for, to where it came from."""
        self._send(name, fields)

    def accepted(self) -> None:
        """Every check was passed."""
        if self.telecommand.ack & ACK_ACCEPTANCE:
            self._send("acceptance_success", {"request_id": self._request_id})

    def started(self) -> None:
        if self._open and self.telecommand.ack & ACK_START:
            self._send("start_success", {"request_id": self._request_id})

    def progressed(self, step: int) -> None:
        if self._open and self.telecommand.ack & ACK_PROGRESS:
            self._send("progress", {"request_id": self._request_id, "step": step})

    def completed(self) -> None:
        if self._open and self.telecommand.ack & ACK_COMPLETION:
            self._send("completion_success", {"request_id": self._request_id})
        self._open = False

    def failed(self, failure: Failure, data: int = 0) -> None:
        """The execution failed (always reported)."""
        if self._open:
            self._send(
                "completion_failure",
                {
                    "request_id": self._request_id,
                    "failure_code": int(FAILURE_CODES[failure]),
                    "failure_data": data,
                },
            )
        self._open = False
