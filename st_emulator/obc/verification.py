"""Telecommand verification (service 1) seen from the OBC: which reports came for which telecommand.

Bytes and time are arguments; nothing here reads a clock. Times are nanoseconds of whatever clock the caller
uses. Source: ECSS-E-ST-70-41C clause 6.1 (request verification service).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import Enum, IntEnum

from ..clock import NS_PER_S
from ..protocol.pus.enumerations import MEANINGS, FailureCode, TransferFailure
from ..protocol.pus.packets import ACK_ACCEPTANCE, ACK_COMPLETION, ACK_START, RequestId, Telemetry

VERIFICATION_SERVICE = 1


class State(Enum):
    """Where a telecommand stands."""

    PENDING = "pending"
    VERIFIED = "verified"
    FAILED = "failed"
    TIMED_OUT = "timed out"
    NOT_DELIVERED = "not delivered"


class Stage(IntEnum):
    """Stages of a telecommand; the order is the order in time."""

    ROUTING = 0
    ACCEPTANCE = 1
    START = 2
    PROGRESS = 3
    COMPLETION = 4


SUCCESS_STAGES = {
    "acceptance_success": Stage.ACCEPTANCE,
    "start_success": Stage.START,
    "progress": Stage.PROGRESS,
    "completion_success": Stage.COMPLETION,
}
FAILURE_STAGES = {
    "routing_failure": Stage.ROUTING,
    "acceptance_failure": Stage.ACCEPTANCE,
    "start_failure": Stage.START,
    "completion_failure": Stage.COMPLETION,
}
STEP_FAILURE = "progress_failure"
_STAGE_OF_ACK = {ACK_ACCEPTANCE: Stage.ACCEPTANCE, ACK_START: Stage.START, ACK_COMPLETION: Stage.COMPLETION}


@dataclass
class Verification:
    """A sent telecommand and what has come back for it.

    `accepted`, `started`, `completed`: True or False as reported, None while (or because) nothing was.
    `steps`: step numbers of the progress reports; `failed_steps`: step numbers and failure codes of failed
    ones, after which execution goes on. `*_ns`: reception times. `failure_*`: of the failure report that
    ended it, if one came. `deadline_ns` may be moved by whoever sees that the unit is still at work.
    `packet` is what was sent. `transfer` says in words what kept it from the unit, where that is known (on
    a CAN bus).
    """

    request_id: RequestId
    name: str
    label: str
    ack: int
    sent_ns: int
    deadline_ns: int
    accepted: bool | None = None
    started: bool | None = None
    completed: bool | None = None
    steps: list[int] = field(default_factory=list)
    failed_steps: list[tuple[int, int]] = field(default_factory=list)
    accepted_ns: int | None = None
    started_ns: int | None = None
    completed_ns: int | None = None
    failed_ns: int | None = None
    failure_stage: Stage | None = None
    failure_code: int | None = None
    failure_data: int = 0
    state: State = State.PENDING
    packet: bytes = field(default=b"", repr=False)
    transfer: str = ""

    @property
    def finished(self) -> bool:
        """Whether nothing more is waited for."""
        return self.state is not State.PENDING

    @property
    def missing(self) -> tuple[str, ...]:
        """Reports that were asked for and have not come, as words.

        A telecommand that is executed at once has no start report, so completion stands for start too.
        """
        if self.state is State.FAILED:
            return ()
        reported = {
            Stage.ACCEPTANCE: self.accepted,
            Stage.START: self.completed if self.started is None else self.started,
            Stage.COMPLETION: self.completed,
        }
        return tuple(
            f"{stage.name.lower()} report" for stage in self.requested_stages if reported[stage] is None
        )

    @property
    def requested_stages(self) -> tuple[Stage, ...]:
        """Stages that the acknowledgement flags ask for; without progress, whose number is not known."""
        return tuple(stage for bit, stage in _STAGE_OF_ACK.items() if self.ack & bit)

    @property
    def failure_name(self) -> str:
        """Name of the failure code, "" when there was no failure."""
        if self.failure_code is None:
            return ""
        try:
            return FailureCode(self.failure_code).name
        except ValueError:
            return f"CODE_{self.failure_code}"

    @property
    def failure_text(self) -> str:
        """The failure in words: stage, name, number, data and meaning."""
        if self.failure_code is None or self.failure_stage is None:
            return ""
        meaning = "not a code of this interface"
        if self.failure_code in FailureCode.__members__.values():
            meaning = MEANINGS.get(FailureCode(self.failure_code), "")
        return (
            f"{self.failure_stage.name.lower()} failed: {self.failure_name} ({self.failure_code}), "
            f"data {self.failure_data} ({meaning})"
        )

    @property
    def seconds(self) -> float | None:
        """From sending to the report that ended it, None before."""
        failed = self.state in (State.FAILED, State.NOT_DELIVERED)
        ended_ns = self.failed_ns if failed else self._last_report_ns()
        return None if ended_ns is None else (ended_ns - self.sent_ns) / NS_PER_S

    def _last_report_ns(self) -> int | None:
        times = [t for t in (self.accepted_ns, self.started_ns, self.completed_ns) if t is not None]
        return max(times, default=None)

    def take(self, telemetry: Telemetry, now_ns: int) -> None:
        """Note a verification report that carries this telecommand's request ID."""
        if telemetry.name in FAILURE_STAGES:
            self._fail(FAILURE_STAGES[telemetry.name], telemetry, now_ns)
            return
        if telemetry.name == STEP_FAILURE:
            self.failed_steps.append((int(telemetry.fields["step"]), int(telemetry.fields["failure_code"])))
            return
        stage = SUCCESS_STAGES[telemetry.name]
        if stage is Stage.ACCEPTANCE:
            self.accepted, self.accepted_ns = True, now_ns
        elif stage is Stage.START:
            self.started, self.started_ns = True, now_ns
        elif stage is Stage.PROGRESS:
            self.steps.append(int(telemetry.fields["step"]))
        else:
            self.completed, self.completed_ns = True, now_ns
        if self.state is State.PENDING and not self.missing:
            self.state = State.VERIFIED

    def not_delivered(self, reason: TransferFailure, now_ns: int) -> None:
        """The unit did not take the packet off the bus."""
        self.transfer = f"{MEANINGS.get(reason, '')} ({reason.name})"
        self.failed_ns = now_ns
        self.state = State.NOT_DELIVERED

    def _fail(self, stage: Stage, telemetry: Telemetry, now_ns: int) -> None:
        self.failure_stage = stage
        self.failure_code = int(telemetry.fields["failure_code"])
        self.failure_data = int(telemetry.fields.get("failure_data", 0))
        self.failed_ns = now_ns
        self.state = State.FAILED
        if stage <= Stage.ACCEPTANCE:
            self.accepted = False
        elif stage is Stage.START:
            self.started = False
        else:
            self.completed = False


class VerificationTracker:
    """Every telecommand sent and not yet finished, by request ID."""

    def __init__(self) -> None:
        self._pending: dict[RequestId, Verification] = {}

    def __len__(self) -> int:
        return len(self._pending)

    def __iter__(self) -> Iterator[Verification]:
        return iter(list(self._pending.values()))

    def sent(self, verification: Verification) -> None:
        """A telecommand has left. Without any requested report it counts as verified at once."""
        if not verification.requested_stages:
            # A failure may still be reported, and then must find its telecommand.
            verification.state = State.VERIFIED
        self._pending[verification.request_id] = verification

    def take(self, telemetry: Telemetry, now_ns: int) -> Verification | None:
        """The telecommand that a report is about, brought up to date; None when it is not ours."""
        verification = self._pending.get(RequestId.from_fields(telemetry.fields["request_id"]))
        if verification is None:
            return None
        verification.take(telemetry, now_ns)
        ended = verification.state is State.FAILED or verification.completed
        if ended and not verification.missing:
            del self._pending[verification.request_id]
        return verification

    def not_delivered(self, packet: bytes, reason: TransferFailure, now_ns: int) -> Verification | None:
        """The telecommand of a packet that did not reach the unit; None when nobody waits for it."""
        for verification in self:
            if verification.packet is packet:
                del self._pending[verification.request_id]
                verification.not_delivered(reason, now_ns)
                return verification
        return None

    def expire(self, now_ns: int) -> list[Verification]:
        """Telecommands that now count as timed out; verified ones whose time is over are just forgotten."""
        expired = []
        for verification in self:
            if now_ns < verification.deadline_ns:
                continue
            del self._pending[verification.request_id]
            if verification.state is State.PENDING:
                verification.state = State.TIMED_OUT
                expired.append(verification)
        return expired


def is_verification(telemetry: Telemetry) -> bool:
    """Whether `telemetry` is a report of service 1."""
    return telemetry.service == VERIFICATION_SERVICE
