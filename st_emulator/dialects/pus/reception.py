"""Telecommands in: acceptance, verification. Each kind of bad input has its counter, event or
failure report.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, Protocol

from ...device.counters import LinkCounters, saturated
from ...protocol.pus.enumerations import EventId, FailureCode, MalformedReason
from ...protocol.pus.field_types import FieldViolation
from ...protocol.pus.packets import (
    ACK_ACCEPTANCE,
    ACK_COMPLETION,
    ACK_PROGRESS,
    ACK_START,
    Malformed,
    RequestId,
    Telecommand,
)
from ...protocol.pus.registry import field_violation, parse_telecommand

SEQUENCE_MODULO = 1 << 14


class RejectedError(Exception):
    """A telecommand is refused; ``code`` and ``data`` go into its failure report. Nothing was changed."""

    def __init__(self, code: FailureCode, data: int = 0) -> None:
        super().__init__(f"{code.name} ({data})")
        self.code = code
        self.data = data


class Telemeter(Protocol):
    """Sends a telemetry message by name."""

    def __call__(self, name: str, fields: dict[str, Any], destination_id: int | None = None) -> bool: ...


class Request:
    """An accepted telecommand on its way to completion; reports what its acknowledgement flags ask for."""

    def __init__(self, telecommand: Telecommand, send: Telemeter) -> None:
        self.telecommand = telecommand
        self._telemeter = send
        self._request_id = RequestId.from_packet(telecommand.raw).as_fields()
        self.open = True

    def _send(self, name: str, fields: dict[str, Any]) -> None:
        self._telemeter(name, fields, self.telecommand.source_id)

    def answer(self, name: str, fields: dict[str, Any]) -> None:
        """Send the telemetry that the telecommand asks for, to where it came from."""
        self._send(name, fields)

    def accepted(self) -> None:
        if self.telecommand.ack & ACK_ACCEPTANCE:
            self._send("acceptance_success", {"request_id": self._request_id})

    def started(self) -> None:
        if self.open and self.telecommand.ack & ACK_START:
            self._send("start_success", {"request_id": self._request_id})

    def progressed(self, step: int) -> None:
        if self.open and self.telecommand.ack & ACK_PROGRESS:
            self._send("progress", {"request_id": self._request_id, "step": step})

    def completed(self) -> None:
        if self.open and self.telecommand.ack & ACK_COMPLETION:
            self._send("completion_success", {"request_id": self._request_id})
        self.open = False

    def failed(self, code: FailureCode, data: int = 0) -> None:
        """Report that the execution failed (always sent)."""
        if self.open:
            self._send(
                "completion_failure",
                {"request_id": self._request_id, "failure_code": int(code), "failure_data": data},
            )
        self.open = False


#: A handler checks a telecommand (raising :class:`RejectedError`) and returns what executes it.
Handler = Callable[[Telecommand], Callable[[Request], None]]


class RequestClient(Protocol):
    """What the receiving side needs from the unit."""

    def send(self, name: str, fields: dict[str, Any], destination_id: int | None = None) -> bool: ...

    def raise_event(self, event: EventId, **data: int) -> None: ...

    def handler(self, telecommand: Telecommand) -> Handler:
        """What checks and executes a telecommand; refuses one that the present mode does not allow."""


class Receiver:
    """Packets as they were received to executed telecommands."""

    def __init__(self, client: RequestClient, apid: int, counters: LinkCounters) -> None:
        self._client = client
        self._apid = apid
        self.counters = counters
        self._expected_sequence: dict[int, int] = {}

    def reset(self) -> None:
        """As after power-on: no telecommand has come yet."""
        self._expected_sequence.clear()

    def discarded(self, reason: MalformedReason, length: int) -> None:
        """Count and report bytes of which the framing could make no packet."""
        self.counters.tc_received += 1
        if reason == MalformedReason.FRAME_OVERSIZED:
            self.counters.oversized_frames += 1
            self._malformed(reason, self.counters.oversized_frames, length)
        else:
            self.counters.framing_errors += 1
            self._malformed(reason, self.counters.framing_errors, length)

    def _malformed(self, reason: MalformedReason, count: int, length: int) -> None:
        self.counters.tc_rejected += 1
        self._client.raise_event(
            EventId.TC_MALFORMED, reason=int(reason), count=saturated(count, 16), length=saturated(length, 16)
        )

    def handle(self, raw: bytes) -> None:
        """Check and execute one frame."""
        self.counters.tc_received += 1
        parsed = parse_telecommand(raw, apids=(self._apid,))
        if isinstance(parsed, Malformed):
            self._reject_malformed(parsed)
            return
        self._check_sequence(parsed.source_id, parsed.sequence_count)
        request = Request(parsed, self._client.send)
        try:
            handler = self._client.handler(parsed)
            violation = field_violation(parsed)
            if violation is not None:
                raise _refusal(parsed, violation)
            execute = handler(parsed)
        except RejectedError as rejection:
            self._count_rejection(rejection.code)
            self._fail_acceptance(
                parsed.source_id, RequestId.from_packet(raw), rejection.code, rejection.data
            )
            return
        self.counters.tc_accepted += 1
        request.accepted()
        execute(request)

    def _check_sequence(self, source: int, received: int) -> None:
        """Look at the sequence count of a whole and undamaged telecommand, executed or refused."""
        expected = self._expected_sequence.get(source)
        self._expected_sequence[source] = (received + 1) % SEQUENCE_MODULO
        # A count of 0 out of turn is an OBC that started anew, not a gap.
        if expected is not None and received not in (expected, 0):
            self.counters.sequence_gaps += 1
            self._client.raise_event(
                EventId.TC_SEQUENCE_GAP_DETECTED, source_id=source, expected=expected, received=received
            )

    def _count_rejection(self, code: FailureCode) -> None:
        self.counters.tc_rejected += 1
        if code == FailureCode.NOT_ALLOWED_IN_MODE:
            self.counters.not_allowed_in_mode += 1
        elif code in (FailureCode.UNKNOWN_SERVICE, FailureCode.UNKNOWN_SUBSERVICE):
            self.counters.unknown_service += 1
        else:
            self.counters.bad_parameters += 1

    def _fail_acceptance(self, source_id: int, request_id: RequestId, code: FailureCode, data: int) -> None:
        self._client.send(
            "acceptance_failure",
            {
                "request_id": request_id.as_fields(),
                "failure_code": int(code),
                "failure_data": data & 0xFFFFFFFF,
            },
            source_id,
        )

    def _reject_malformed(self, malformed: Malformed) -> None:
        """A packet whose checksum holds can be answered to its sender; one whose checksum fails can only
        be counted.
        """
        reason, counters, length = malformed.reason, self.counters, len(malformed.raw)
        if reason == MalformedReason.BAD_CRC:
            counters.crc_errors += 1
            counters.tc_rejected += 1
            self._client.raise_event(
                EventId.TC_CRC_FAILED, count=saturated(counters.crc_errors, 16), length=saturated(length, 16)
            )
        elif reason == MalformedReason.UNKNOWN_APID and malformed.request_id is not None:
            counters.unknown_apid += 1
            counters.tc_rejected += 1
            self._client.send(
                "routing_failure",
                {
                    "request_id": malformed.request_id.as_fields(),
                    "failure_code": int(FailureCode.UNKNOWN_APID),
                    "failure_data": malformed.request_id.apid,
                },
                _source_id(malformed.raw),
            )
        elif reason.failure_code in (FailureCode.LENGTH, FailureCode.HEADER) or malformed.request_id is None:
            counters.length_errors += 1
            self._malformed(reason, counters.length_errors, length)
        else:
            source_id = _source_id(malformed.raw)
            self._check_sequence(source_id, malformed.request_id.sequence_count)
            self._count_rejection(reason.failure_code)
            self._fail_acceptance(
                source_id, malformed.request_id, reason.failure_code, _failure_data(malformed)
            )


def _refusal(telecommand: Telecommand, violation: FieldViolation) -> RejectedError:
    """The failure of a value that the message table does not allow.

    Its data is the unknown identifier, or the identifier of the thing to which the value belongs (0 when it
    belongs to none): the structure, parameter, function or memory that stands beside it.
    """
    if violation.failure_code == FailureCode.UNKNOWN_ID and isinstance(violation.value, int):
        return RejectedError(violation.failure_code, violation.value)
    fields: dict[str, Any] = telecommand.fields
    if (item := _ITEM.match(violation.field)) is not None:
        entry = fields[item["list"]][int(item["number"])]
        fields = entry if isinstance(entry, dict) else {}
    identifiers = [value for name, value in fields.items() if name in _IDENTIFIERS]
    return RejectedError(violation.failure_code, identifiers[0] if identifiers else 0)


_ITEM = re.compile(r"(?P<list>\w+)\[(?P<number>\d+)\]")
_IDENTIFIERS = ("structure_id", "parameter_id", "function_id", "memory_id")


def _source_id(raw: bytes) -> int:
    """Source ID of a telecommand packet whose checksum holds."""
    return int.from_bytes(raw[9:11], "big")


def _failure_data(malformed: Malformed) -> int:
    """The data that goes with the failure code (see its meaning in the interface control document)."""
    raw = malformed.raw
    match malformed.reason:
        case MalformedReason.UNKNOWN_SERVICE:
            return raw[7]
        case MalformedReason.UNKNOWN_SUBSERVICE:
            return raw[7] << 8 | raw[8]
        case MalformedReason.UNKNOWN_ID:
            return 0
        case _:
            return len(raw)
