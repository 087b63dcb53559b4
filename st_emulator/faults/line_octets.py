"""Faults of single octets of a serial line: each octet that passes may be struck."""

from __future__ import annotations

from typing import Final, Literal

from .fault import AtOctets, DirectedSettings, FaultKind, SettingsT
from .timing import goes


class EachOctet(AtOctets[SettingsT]):
    """Asks for each octet that goes its way whether it is struck."""

    def octets(self, octets: bytes, to_obc: bool) -> bytes:
        assert isinstance(self.settings, DirectedSettings)
        if not goes(self.settings.direction, to_obc):
            return octets
        return b"".join(
            self.struck(bytes((octet,))) if self.strikes() else bytes((octet,)) for octet in octets
        )

    def struck(self, octet: bytes) -> bytes:
        """What stands in the place of an octet that is struck."""
        raise NotImplementedError


class BitsFlippedSettings(DirectedSettings):
    kind: Literal["line.bits_flipped"]


class BitsFlipped(EachOctet[BitsFlippedSettings]):
    """One bit of an octet that is struck."""

    def struck(self, octet: bytes) -> bytes:
        return bytes((octet[0] ^ 1 << self.random.randrange(8),))


class BytesLostSettings(DirectedSettings):
    kind: Literal["line.bytes_lost"]


class BytesLost(EachOctet[BytesLostSettings]):
    def struck(self, octet: bytes) -> bytes:
        return b""


class BytesDoubledSettings(DirectedSettings):
    kind: Literal["line.bytes_doubled"]


class BytesDoubled(EachOctet[BytesDoubledSettings]):
    def struck(self, octet: bytes) -> bytes:
        return octet + octet


class BytesInsertedSettings(DirectedSettings):
    kind: Literal["line.bytes_inserted"]


class BytesInserted(EachOctet[BytesInsertedSettings]):
    """A random octet in front of one that is struck."""

    def struck(self, octet: bytes) -> bytes:
        return bytes((self.random.randrange(256),)) + octet


_NEXT = "The next whole frame is good; nothing that was destroyed is sent again."

KINDS: Final = (
    FaultKind(
        BitsFlippedSettings,
        BitsFlipped,
        what="In an octet that is struck one bit is another.",
        obc_sees="Frames whose check sum is wrong, or frames cut or joined where the octet was a delimiter. "
        "A telecommand that is struck is not carried out; the unit counts and tells it (TC_CRC_FAILED, "
        "TC_MALFORMED).",
        afterwards=_NEXT,
        wires=("serial",),
    ),
    FaultKind(
        BytesLostSettings,
        BytesLost,
        what="An octet that is struck is not there, as after an overrun of a UART.",
        obc_sees="Frames shorter than their length says, or two frames that have become one.",
        afterwards=_NEXT,
        wires=("serial",),
    ),
    FaultKind(
        BytesDoubledSettings,
        BytesDoubled,
        what="An octet that is struck comes twice.",
        obc_sees="Frames longer than their length says; a delimiter that comes twice does no harm.",
        afterwards=_NEXT,
        wires=("serial",),
    ),
    FaultKind(
        BytesInsertedSettings,
        BytesInserted,
        what="In front of an octet that is struck stands one that nobody sent, of any value.",
        obc_sees="Frames longer than their length says, and octets between frames, to be skipped.",
        afterwards=_NEXT,
        wires=("serial",),
    ),
)
