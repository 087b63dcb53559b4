"""What can go wrong for an OBC, as exceptions that name the telecommand and what was expected of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .verification import Verification


class ObcError(Exception):
    """Base of the OBC simulator's errors; one line for a person."""


class VerificationError(ObcError):
    """The unit answered a telecommand with a failure report; `verification` holds code, name and stage."""

    def __init__(self, verification: Verification) -> None:
        self.verification = verification
        super().__init__(f"{verification.label}: {verification.failure_text}")

    @property
    def failure_code(self) -> int | None:
        """Number of the failure code."""
        return self.verification.failure_code

    @property
    def failure_name(self) -> str:
        """Name of the failure code, such as NOT_ALLOWED_IN_MODE."""
        return self.verification.failure_name


class TelecommandTimeout(ObcError):  # noqa: N818  # reads better where it is caught
    """What a telecommand should have brought did not come in time; `missing` names it."""

    def __init__(self, label: str, missing: tuple[str, ...], timeout_s: float, detail: str = "") -> None:
        self.label = label
        self.missing = missing
        self.timeout_s = timeout_s
        what = f"{label}: within {timeout_s:g} s never came: {', '.join(missing)}"
        super().__init__(f"{what}; {detail}" if detail else what)


class TelecommandNotDelivered(TelecommandTimeout):
    """The unit did not take a telecommand off the bus; `detail` says how that showed after `after_s`."""

    def __init__(self, label: str, missing: tuple[str, ...], after_s: float, detail: str) -> None:
        super().__init__(label, missing, after_s, detail)
        self.detail = detail
        self.args = (f"{label}: not delivered: {detail}, after {after_s:.3g} s",)


class UnitNotChosenError(ObcError):
    """Nobody said which unit of the bus is meant, and heartbeats do not tell; `nodes` were heard."""

    def __init__(self, nodes: Sequence[int]) -> None:
        self.nodes = tuple(nodes)
        if self.nodes:
            heard = f"several units are on the bus: nodes {', '.join(map(str, self.nodes))}"
        else:
            heard = "no unit's heartbeat came"
        super().__init__(f"{heard}; name the one that is meant: its node number, or its unit file")


class NoBusError(ObcError):
    """What only a CAN bus has was asked for on another link."""


class TelemetryTimeout(ObcError):  # noqa: N818
    """Telemetry that was waited for did not come in time; `last` says what was seen instead."""

    def __init__(self, awaited: str, timeout_s: float, last: str = "") -> None:
        self.awaited = awaited
        self.timeout_s = timeout_s
        super().__init__(f"{awaited}: did not come within {timeout_s:g} s" + (f"; {last}" if last else ""))


class DownloadError(ObcError):
    """Parts of an image or memory stayed missing, or its checksum does not match."""


class RecordingError(ObcError):
    """A recording cannot be written or read; the message names the file."""
