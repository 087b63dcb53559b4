"""Faults of the signal on a serial line: break, another bit rate, silence, and somebody who talks."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field

from . import uart
from .fault import AtOctets, DirectedSettings, FaultKind, Reach
from .timing import Repeating, goes

BITS_PER_OCTET = uart.BITS_PER_OCTET
Always = Annotated[float, Field(ge=1, le=1, description="1: it lasts, or it does not")]


class BreakSettings(DirectedSettings):
    kind: Literal["line.break"]


class Break(AtOctets[BreakSettings]):
    """The line is held low. An octet is struck: octets that are struck one behind the other are one break."""

    def __init__(self, settings: BreakSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        self._low = {True: False, False: False}

    def begin(self) -> None:
        if self.settings.probability < 1:
            return
        for to_obc, put in ((True, self.reach.to_obc), (False, self.reach.to_unit)):
            if goes(self.settings.direction, to_obc):
                self._low[to_obc] = True
                put(b"\0")

    def octets(self, octets: bytes, to_obc: bool) -> bytes:
        if not goes(self.settings.direction, to_obc):
            return octets
        passed = bytearray()
        for octet in octets:
            struck = self.strikes()
            if not struck:
                passed.append(octet)
            elif not self._low[to_obc]:
                passed.append(0)
            self._low[to_obc] = struck
        return bytes(passed)


class BaudErrorSettings(DirectedSettings):
    kind: Literal["line.baud_error"]
    percent: Annotated[
        float, Field(ge=-95, le=2000, description="by which the unit's bit rate is above that of the OBC")
    ] = 6.0
    frame_errors: Annotated[
        Literal["kept", "dropped"],
        Field(description="what the receiver's driver does with an octet whose stop bit is low"),
    ] = "kept"


class BaudError(AtOctets[BaudErrorSettings]):
    """Each group of octets is read at the other rate."""

    def octets(self, octets: bytes, to_obc: bool) -> bytes:
        if not goes(self.settings.direction, to_obc) or not self.strikes():
            return octets
        ratio = 1.0 + self.settings.percent / 100.0
        keep = self.settings.frame_errors == "kept"
        found = uart.read(octets, ratio if to_obc else 1.0 / ratio)
        return bytes(one.value for one in found if keep or not one.framing_error)


class SilenceSettings(DirectedSettings):
    kind: Literal["line.silence"]
    probability: Always = 1.0


class Silence(AtOctets[SilenceSettings]):
    def octets(self, octets: bytes, to_obc: bool) -> bytes:
        return b"" if goes(self.settings.direction, to_obc) else octets


class BabbleSettings(DirectedSettings):
    kind: Literal["line.babble"]
    octets_per_s: Annotated[
        float, Field(ge=0.001, le=1_000_000, description="at most what the line carries")
    ] = 1000.0


class Babble(Repeating[BabbleSettings]):
    """Random octets at a steady rate."""

    def __init__(self, settings: BabbleSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        most = reach.baud / BITS_PER_OCTET
        if settings.octets_per_s > most:
            raise ValueError(
                f"octets_per_s = {settings.octets_per_s:g} is more than the line carries at {reach.baud} "
                f"baud; allowed are 0.001 to {most:g}"
            )

    def rate_hz(self) -> float:
        return self.settings.octets_per_s

    def once(self) -> None:
        octet = bytes((self.random.randrange(256),))
        if goes(self.settings.direction, True):
            self.reach.to_obc(octet)
        if goes(self.settings.direction, False):
            self.reach.to_unit(octet)


KINDS: Final = (
    FaultKind(
        BreakSettings,
        Break,
        what="The line is held low: at its begin a receiver of eight bits reads one octet 00 (its framing "
        "error does not go through a link of octets), then nothing; what is sent meanwhile is lost. With a "
        "probability below 1 each octet that is struck is such a break in its place.",
        obc_sees="One octet 00, then nothing while it lasts; the frame that it meets is broken.",
        afterwards="The next whole frame is good; sequence counts show what was lost.",
        wires=("serial",),
    ),
    FaultKind(
        BaudErrorSettings,
        BaudError,
        what="The unit's bit rate is percent above that of the OBC (below with a minus), both ways: the "
        "receiver looks at the line in the middle of bits of its own length, from the edge of the start bit "
        "on. ASSUMED: groups of octets that leave the transmitter at once are one wave form, between lines "
        "at rest. A group, or what the link brings at once, is struck whole or not.",
        obc_sees="Nothing up to 5 % below and above, where all ten samples still lie in their bits; beyond "
        "it octets with wrong high bits, octets with framing errors, and at a multiple of the rate "
        "other numbers of octets: hardly a frame that is good.",
        afterwards="The next whole frame is good.",
        wires=("serial",),
    ),
    FaultKind(
        SilenceSettings,
        Silence,
        what="No octet gets through, as through a wire that is cut.",
        obc_sees="Nothing; a unit that is still alive when it is over, with counts that went on.",
        afterwards="The next whole frame is good; sequence counts show what was lost.",
        wires=("serial",),
    ),
    FaultKind(
        BabbleSettings,
        Babble,
        what="Somebody else puts random octets on the line, octets_per_s of them. ASSUMED: they stand "
        "between the groups of octets of the other sender, which they leave whole.",
        obc_sees="Octets between and in frames that nobody sent; frames in which they stand are broken.",
        afterwards="The frame that was begun is broken still, the next is good.",
        wires=("serial",),
    ),
)
