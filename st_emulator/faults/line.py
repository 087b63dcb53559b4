"""Faults of the line: octets of a serial line, and whole messages on any wire."""

from __future__ import annotations

from typing import Final, Literal

from ..wire.seam import Forward
from .fault import AtMessages, AtOctets, DirectedSettings, FaultKind


def goes(direction: str, to_obc: bool) -> bool:
    """Whether a fault of ``direction`` strikes what goes this way."""
    return direction == "both" or (direction == "to_obc") is to_obc


class BitsFlippedSettings(DirectedSettings):
    kind: Literal["line.bits_flipped"]


class BitsFlipped(AtOctets[BitsFlippedSettings]):
    """One bit of an octet that is struck."""

    def octets(self, octets: bytes, to_obc: bool) -> bytes:
        if not goes(self.settings.direction, to_obc):
            return octets
        return bytes(octet ^ 1 << self.random.randrange(8) if self.strikes() else octet for octet in octets)


class FramesLostSettings(DirectedSettings):
    kind: Literal["line.frames_lost"]


class FramesLost(AtMessages[FramesLostSettings]):
    def message(self, message: bytes, to_obc: bool, forward: Forward) -> None:
        if not goes(self.settings.direction, to_obc) or not self.strikes():
            forward(message)


KINDS: Final = (
    FaultKind(
        BitsFlippedSettings,
        BitsFlipped,
        what="In an octet that is struck one bit is another.",
        obc_sees="Frames whose check sum is wrong, or frames cut or joined where the octet was a delimiter.",
        afterwards="The next whole frame is good.",
        wires=("serial",),
    ),
    FaultKind(
        FramesLostSettings,
        FramesLost,
        what="A message that is struck does not go onto the wire, or is not heard.",
        obc_sees="Gaps in the sequence counts; telecommands without a report.",
        afterwards="The next message comes, with a count that shows the gap.",
    ),
)
