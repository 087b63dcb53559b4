"""Telecommands in: acceptance. Each kind of bad input has its counter, event or failure report."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, Protocol

from ...device.counters import saturated
from ...device.star_tracker import StarTracker
from ...protocol.pus.enumerations import EventId, FailureCode, MalformedReason
from ...protocol.pus.field_types import FieldViolation
from ...protocol.pus.packets import SEQUENCE_MODULO, Malformed, RequestId, Telecommand
from ...protocol.pus.registry import field_violation, parse_telecommand
from .serving import Execute, Served
from .verification import RejectedError, Request, Send


@dataclass
class LinkCounters:
    """Counters in the housekeeping structure LINK, from power-on or the last CLEAR_COUNTERS."""

    tc_received: int = 0
    tc_accepted: int = 0
    tc_rejected: int = 0
    crc_errors: int = 0
    framing_errors: int = 0
    length_errors: int = 0
    oversized_frames: int = 0
    unknown_apid: int = 0
    unknown_service: int = 0
    sequence_gaps: int = 0
    not_allowed_in_mode: int = 0
    bad_parameters: int = 0
    rx_bytes: int = 0

    def clear(self) -> None:
        for item in fields(self):
            setattr(self, item.name, 0)


class RaiseEvent(Protocol):
    """Sends an event report, unless it is disabled."""

    def __call__(self, event: EventId, **data: Any) -> None: ...


Check = Callable[[Request], Execute]


@dataclass(frozen=True)
class _Bound:
    """How a telecommand is served, and by the service of this unit."""

    served: Served[Any]
    check: Check


class Receiver:
    """Packets as they were received to executed telecommands.

    Args:
        device: whose mode decides what is allowed.
        send, raise_event: reports out.
        apid: the unit's.
    """

    def __init__(self, device: StarTracker, send: Send, raise_event: RaiseEvent, apid: int) -> None:
        self._device = device
        self._send = send
        self._raise_event = raise_event
        self._apid = apid
        self._served: dict[str, _Bound] = {}
        self.counters = LinkCounters()
        self._expected_sequence: dict[int, int] = {}

    def serve(self, service: Any, table: Mapping[str, Served[Any]]) -> None:
        """``service`` serves the telecommands of a service module's table."""
        for name, served in table.items():
            self._served[name] = _Bound(served, partial(served.check, service))

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
        self._raise_event(
            EventId.TC_MALFORMED, reason=int(reason), count=saturated(count, 16), length=saturated(length, 16)
        )

    def handle(self, raw: bytes, received_ns: int) -> None:
        """Check and execute one frame whose last bit came in at ``received_ns``."""
        self.counters.tc_received += 1
        parsed = parse_telecommand(raw, apids=(self._apid,))
        if isinstance(parsed, Malformed):
            self._reject_malformed(parsed)
            return
        self._check_sequence(parsed.source_id, parsed.sequence_count)
        request = Request(parsed, received_ns, self._send)
        try:
            check = self._allowed(parsed)
            violation = field_violation(parsed)
            if violation is not None:
                raise _refusal(parsed, violation)
            execute = check(request)
        except RejectedError as rejection:
            self._count_rejection(rejection.code)
            self._fail_acceptance(
                parsed.source_id, RequestId.from_packet(raw), rejection.code, rejection.data
            )
            return
        self.counters.tc_accepted += 1
        request.accepted()
        execute()

    def _allowed(self, telecommand: Telecommand) -> Check:
        """What checks a telecommand, if there is somebody and the present mode allows it."""
        bound = self._served.get(telecommand.name)
        if bound is None:
            number = telecommand.service << 8 | telecommand.subservice
            raise RejectedError(FailureCode.UNKNOWN_SUBSERVICE, number)
        if self._device.mode not in bound.served.modes_for(telecommand.fields):
            raise RejectedError(FailureCode.NOT_ALLOWED_IN_MODE, int(self._device.mode))
        return bound.check

    def _check_sequence(self, source: int, received: int) -> None:
        """Look at the sequence count of a whole and undamaged telecommand, executed or refused."""
        expected = self._expected_sequence.get(source)
        self._expected_sequence[source] = (received + 1) % SEQUENCE_MODULO
        # A count of 0 out of turn is an OBC that started anew, not a gap.
        if expected is not None and received not in (expected, 0):
            self.counters.sequence_gaps += 1
            self._raise_event(
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
        self._send(
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
            self._raise_event(
                EventId.TC_CRC_FAILED, count=saturated(counters.crc_errors, 16), length=saturated(length, 16)
            )
        elif reason == MalformedReason.UNKNOWN_APID and malformed.request_id is not None:
            counters.unknown_apid += 1
            counters.tc_rejected += 1
            self._send(
                "routing_failure",
                {
                    "request_id": malformed.request_id.as_fields(),
                    "failure_code": int(FailureCode.UNKNOWN_APID),
                    "failure_data": malformed.request_id.apid,
                },
                malformed.source_id,
            )
        elif reason.failure_code in (FailureCode.LENGTH, FailureCode.HEADER) or malformed.request_id is None:
            counters.length_errors += 1
            self._malformed(reason, counters.length_errors, length)
        else:
            source_id = malformed.source_id
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


def _failure_data(malformed: Malformed) -> int:
    """The data that goes with the failure code (see its meaning in the interface control document)."""
    match malformed.reason:
        case MalformedReason.UNKNOWN_SERVICE:
            return malformed.service
        case MalformedReason.UNKNOWN_SUBSERVICE:
            return malformed.service << 8 | malformed.subservice
        case MalformedReason.UNKNOWN_ID:
            return 0
        case _:
            return len(malformed.raw)
