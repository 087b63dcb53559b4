"""Faults of the clock: the on-board time, not the frame grid."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field

from ..clock import NS_PER_S
from .fault import AtSynchronisation, Fault, FaultKind, FaultSettings


class DriftSettings(FaultSettings):
    kind: Literal["clock.drift"]
    ppm: Annotated[
        float, Field(ge=-100_000, le=100_000, description="parts per million; below 0 it runs too slowly")
    ] = 100.0


class Drift(Fault[DriftSettings]):
    """ASSUMED: the frame grid has an oscillator of its own and does not follow."""

    _ppb = 0

    def begin(self) -> None:
        if self.strikes():
            self._ppb = round(self.settings.ppm * 1000)
            self._change(self._ppb)

    def end(self) -> None:
        self._change(-self._ppb)

    def _change(self, ppb: int) -> None:
        self.reach.device.time.drift(ppb, self.reach.clock.now_ns)


class JumpSettings(FaultSettings):
    kind: Literal["clock.jump"]
    seconds: Annotated[
        float, Field(ge=-(10**9), le=10**9, description="so much later it is then; below 0: earlier")
    ] = 1.0


class Jump(Fault[JumpSettings]):
    instant = True

    def begin(self) -> None:
        if self.strikes():
            self.reach.device.time.jump(round(self.settings.seconds * NS_PER_S))


class MissedSyncSettings(FaultSettings):
    kind: Literal["clock.missed_sync"]


class MissedSync(AtSynchronisation[MissedSyncSettings]):
    """Asked at each frame's start while a set time waits."""

    def synchronises(self) -> bool:
        return not self.strikes()


KINDS: Final = (
    FaultKind(
        DriftSettings,
        Drift,
        what="The on-board time runs faster or slower than it should. The frame grid does not.",
        obc_sees="Mid-exposure times that run away from the frames: from one attitude report to the next "
        "more or less than a frame period, while the reports come at the same rate. Every attitude is "
        "valid, the time status says SET; only a comparison with the OBC's own time shows it.",
        afterwards="It runs right again, and keeps the error that has come together, until the time is set "
        "or the unit starts anew.",
    ),
    FaultKind(
        JumpSettings,
        Jump,
        what="At one instant the on-board time is another. It is over at once, whatever end is given.",
        obc_sees="One step in the time stamps and mid-exposure times, without event TIME_SET; time stamps "
        "that go back when it is below 0. The time status still says SET, the attitudes are valid.",
        afterwards="The error stays until the time is set or the unit starts anew.",
    ),
    FaultKind(
        MissedSyncSettings,
        MissedSync,
        what="The instant at which a set time (by telecommand or by SYNC) comes into force is missed, at "
        "each frame start that is struck. The setting waits.",
        obc_sees="The telecommand is accepted and started, and its completion and event TIME_SET do not "
        "come; the time status stays FREE_RUNNING (or the old time stays). A further setting takes the "
        "place of the one that waits, which fails with SUPERSEDED.",
        afterwards="The setting that waits comes into force at the next frame start, late and right: "
        "completion, TIME_SET and time status SET follow.",
    ),
)
