"""How a telecommand is served: in which modes, what checks it, what runs it.

A telecommand is checked in this order: the mode, the identifiers and ranges of the message table, then what
only its service can know. ``check`` raises :class:`RejectedError` and returns what executes the
telecommand, so that a refused one has changed nothing. Each service module ends with its table of these.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from ...device.commands import LISTENING, Command, Refusal, RefusedError
from ...device.star_tracker import StarTracker
from ...firmware_model.modes import Mode
from ...protocol.pus.enumerations import FailureCode, ParameterId
from .verification import RejectedError, Request

ANY = LISTENING

Execute = Callable[[], None]
ServiceT = TypeVar("ServiceT")


@dataclass(frozen=True)
class Served(Generic[ServiceT]):
    """One telecommand of a service. ``modes``: where it is allowed, or what says so for its fields."""

    modes: Sequence[Mode] | Callable[[dict[str, Any]], Sequence[Mode]]
    check: Callable[[ServiceT, Request], Execute]

    def modes_for(self, fields: dict[str, Any]) -> Sequence[Mode]:
        """The modes in which the telecommand with these fields is allowed."""
        return self.modes(fields) if callable(self.modes) else self.modes


REFUSAL_CODES = {
    Refusal.NOT_ALLOWED_IN_MODE: FailureCode.NOT_ALLOWED_IN_MODE,
    Refusal.OUT_OF_RANGE: FailureCode.OUT_OF_RANGE,
    Refusal.UNKNOWN_ID: FailureCode.UNKNOWN_ID,
    Refusal.READ_ONLY: FailureCode.READ_ONLY,
    Refusal.BUSY: FailureCode.BUSY,
    Refusal.NO_IMAGE: FailureCode.NO_IMAGE,
    Refusal.ADDRESS: FailureCode.ADDRESS,
}


def command(device: StarTracker, wanted: Command, request: Request) -> Execute:
    """What executes ``wanted`` for a request; refused as the device refuses it."""
    try:
        device.check(wanted)
    except RefusedError as refused:
        raise RejectedError(REFUSAL_CODES[refused.refusal], _data(refused.subject)) from None
    return lambda: device.execute(wanted, request)


def _data(subject: str | int | None) -> int:
    if isinstance(subject, str):  # a parameter
        return int(ParameterId[subject.upper()])
    return subject or 0
