"""Faults of whole messages: packets before they are framed, and as they have come in."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Final, Literal

from pydantic import Field

from ..clock import NS_PER_MS
from ..wire.seam import Forward
from .fault import AtMessages, DirectedSettings, FaultKind, Reach, SettingsT
from .timing import Held, Holding, goes

CHECK_OCTETS = 2
"""The last two octets of a message are of its check sum: all of the CRC of PUS and of the template of an own
dialect, half of sagitta's hash."""


class EachMessage(AtMessages[SettingsT]):
    """Asks for each message that goes its way whether it is struck."""

    def message(self, message: bytes, to_obc: bool, forward: Forward) -> None:
        assert isinstance(self.settings, DirectedSettings)
        if goes(self.settings.direction, to_obc) and self.strikes():
            self.struck(message, to_obc, forward)
        else:
            forward(message)

    def struck(self, message: bytes, to_obc: bool, forward: Forward) -> None:
        """Pass on what becomes of a message that is struck."""
        raise NotImplementedError


class FramesLostSettings(DirectedSettings):
    kind: Literal["line.frames_lost"]


class FramesLost(EachMessage[FramesLostSettings]):
    def struck(self, message: bytes, to_obc: bool, forward: Forward) -> None:
        pass


class FramesDoubledSettings(DirectedSettings):
    kind: Literal["line.frames_doubled"]


class FramesDoubled(EachMessage[FramesDoubledSettings]):
    def struck(self, message: bytes, to_obc: bool, forward: Forward) -> None:
        forward(message)
        forward(message)


class FramesDelayedSettings(DirectedSettings):
    kind: Literal["line.frames_delayed"]
    delay_ms: Annotated[float, Field(ge=0, le=3_600_000, description="of each that is struck")] = 500.0


class FramesDelayed(EachMessage[FramesDelayedSettings], Holding[FramesDelayedSettings]):
    def struck(self, message: bytes, to_obc: bool, forward: Forward) -> None:
        self.hold(partial(forward, message), to_obc, round(self.settings.delay_ms * NS_PER_MS))


class FramesReorderedSettings(DirectedSettings):
    kind: Literal["line.frames_reordered"]


class FramesReordered(EachMessage[FramesReorderedSettings], Holding[FramesReorderedSettings]):
    """One that is struck waits for the next one of its way and goes behind it."""

    def __init__(self, settings: FramesReorderedSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        self._waiting: dict[bool, Held] = {}

    def message(self, message: bytes, to_obc: bool, forward: Forward) -> None:
        waiting = self._waiting.pop(to_obc, None)
        if waiting is None:
            super().message(message, to_obc, forward)
        else:
            forward(message)
            self.let_go(waiting)

    def struck(self, message: bytes, to_obc: bool, forward: Forward) -> None:
        self._waiting[to_obc] = self.hold(partial(forward, message), to_obc)


class FramesCutSettings(DirectedSettings):
    kind: Literal["line.frames_cut"]
    keep: Annotated[
        int | None, Field(ge=1, le=4096, description="octets that are left; none: any number, by chance")
    ] = None


class FramesCut(EachMessage[FramesCutSettings]):
    """Only the first octets of one that is struck; one of a single octet is lost."""

    def struck(self, message: bytes, to_obc: bool, forward: Forward) -> None:
        keep = self.settings.keep
        if keep is None:
            keep = self.random.randrange(1, len(message)) if len(message) > 1 else 0
        if cut := message[:keep]:
            forward(cut)


class WrongCrcSettings(DirectedSettings):
    kind: Literal["line.wrong_crc"]


class WrongCrc(EachMessage[WrongCrcSettings]):
    """The check sum of one that is struck is another one, the rest is as it was."""

    def struck(self, message: bytes, to_obc: bool, forward: Forward) -> None:
        end = message[-CHECK_OCTETS:]
        change = self.random.randrange(1, 1 << 8 * len(end)) if end else 0
        changed = int.from_bytes(end, "big") ^ change
        forward(message[: len(message) - len(end)] + changed.to_bytes(len(end), "big"))


#: It has no messages of many frames: those of its frames are faults of the bus.
_NO_MESSAGES = ("canopen",)

KINDS: Final = (
    FaultKind(
        FramesLostSettings,
        FramesLost,
        what="A message that is struck does not go onto the wire, or is not heard.",
        obc_sees="Gaps in the sequence counts; telecommands without a report.",
        afterwards="The next message comes, with a count that shows the gap.",
        except_dialects=_NO_MESSAGES,
    ),
    FaultKind(
        FramesDoubledSettings,
        FramesDoubled,
        what="A message that is struck comes twice.",
        obc_sees="The same packet twice, with the same sequence count; of a telecommand two sets of reports, "
        "and TC_SEQUENCE_GAP_DETECTED where its count comes again.",
        afterwards="Each message comes once.",
        except_dialects=_NO_MESSAGES,
    ),
    FaultKind(
        FramesDelayedSettings,
        FramesDelayed,
        what="A message that is struck goes onto the wire delay_ms later; others overtake it.",
        obc_sees="Packets whose time is older than usual, behind younger ones where not all are struck.",
        afterwards="What is still held back comes at once, in its order; then all is in time.",
        except_dialects=_NO_MESSAGES,
    ),
    FaultKind(
        FramesReorderedSettings,
        FramesReordered,
        what="A message that is struck changes places with the next one of its way.",
        obc_sees="Sequence counts such as 5, 4, 7, 6; no packet is missing and each is whole.",
        afterwards="One that still waits comes at once; then the order is right.",
        except_dialects=_NO_MESSAGES,
    ),
    FaultKind(
        FramesCutSettings,
        FramesCut,
        what="Of a message that is struck only the first octets go into the frame; the frame itself is "
        "whole.",
        obc_sees="Well framed packets that are shorter than their own header says.",
        afterwards="The next packet is whole.",
        except_dialects=_NO_MESSAGES,
    ),
    FaultKind(
        WrongCrcSettings,
        WrongCrc,
        what="The last two octets of a message that is struck, which are of its check sum (PUS: its packet "
        "error control; sagitta: the end of its hash), are others. nos3 and canopen have no check sum of "
        "their own and no such fault.",
        obc_sees="Well framed packets of the right length whose check sum is wrong, and nothing else that "
        "is. The unit drops such a telecommand and tells it by TC_CRC_FAILED.",
        afterwards="The next packet is good, its count shows the gap.",
        except_dialects=("nos3", *_NO_MESSAGES),
    ),
)
