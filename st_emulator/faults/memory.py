"""Faults of the memory: upsets of what lies there, and of what is being written."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field, model_validator

from ..device.memories import PROGRAM_BYTES, catalogue_octets
from .fault import AtWriting, Fault, FaultKind, FaultSettings, Reach
from .store import CHECK_OCTETS, STORE_OCTETS, checked_again, unseen_upsets, with_upset

Caught = Annotated[
    bool,
    Field(
        strict=True,
        description="whether the check sum finds it; false: it was computed behind the upset, no check "
        "finds it",
    ),
]


class BitUpsetSettings(FaultSettings):
    kind: Literal["memory.bit_upset"]
    memory: Annotated[
        Literal["catalogue", "parameters", "program"],
        Field(
            description="catalogue: the star catalogue in operation memory; parameters: the image in the "
            "non-volatile memory; program: the software in operation memory"
        ),
    ]
    address: Annotated[
        int | None,
        Field(
            ge=0,
            description="octet in the memory; none: by the seed. Catalogue: star n (in the order of "
            "Hipparcos numbers) has its direction at 24 n, three floats of 8 octets, little endian; "
            "magnitudes of 4 octets follow behind the last direction. Parameters: up to 2047, of which "
            "those behind the stored text are not used. Program: up to 131071",
        ),
    ] = None
    bit: Annotated[
        int | None, Field(ge=0, le=7, description="of the octet, 0 the least; none: by the seed")
    ] = None
    caught: Caught = True


class BitUpset(Fault[BitUpsetSettings]):
    instant = True

    def __init__(self, settings: BitUpsetSettings, reach: Reach, seed: int) -> None:
        super().__init__(settings, reach, seed)
        last = self._octets() - 1
        if settings.address is not None and settings.address > last:
            raise ValueError(
                f"address: found {settings.address}; allowed is a whole number from 0 to {last} in the "
                f"{settings.memory} of this unit"
            )

    def _octets(self) -> int:
        match self.settings.memory:
            case "catalogue":
                return catalogue_octets(self.reach.device.memories.tables)
            case "program":
                return PROGRAM_BYTES
        return STORE_OCTETS

    def begin(self) -> None:
        if not self.strikes():
            return
        settings = self.settings
        if settings.memory == "parameters":
            self._upset_store()
            return
        address = self.random.randrange(self._octets()) if settings.address is None else settings.address
        self.reach.device.memories.upset(settings.memory, address, self._bit(), caught=settings.caught)

    def _bit(self) -> int:
        return self.random.randrange(8) if self.settings.bit is None else self.settings.bit

    def _upset_store(self) -> None:
        settings, store = self.settings, self.reach.store
        image = store.image()
        if image is None:
            return  # nothing that could be spoilt
        if settings.caught:
            address = self.random.randrange(len(image)) if settings.address is None else settings.address
            store.upset(address, self._bit(), caught=True)
            return
        addresses = range(len(image) - CHECK_OCTETS) if settings.address is None else (settings.address,)
        if settings.address is not None and settings.bit is not None:
            store.upset(settings.address, settings.bit, caught=False)
            return
        fits = self.reach.device.parameters.fits
        unseen = [
            (address, bit)
            for address in addresses
            for bit in unseen_upsets(image, address, fits)
            if settings.bit in (None, bit)
        ]
        if unseen:
            store.upset(*self.random.choice(unseen), caught=False)


class UpsetWhileWrittenSettings(FaultSettings):
    kind: Literal["memory.upset_while_written"]
    memory: Annotated[
        Literal["parameters", "ram", "program"] | None,
        Field(description="the one whose writes are struck; none: all"),
    ] = None
    caught: Annotated[
        bool,
        Field(
            strict=True,
            description="of the parameters: whether the check sum finds it; false: it was computed behind "
            "the upset. A memory load is checked by whoever loads it (service 6), and the program by the "
            "unit",
        ),
    ] = True

    @model_validator(mode="after")
    def _has_a_check(self) -> UpsetWhileWrittenSettings:
        if not self.caught and self.memory in ("ram", "program"):
            raise ValueError(f"caught = false is for the parameters alone, and memory is {self.memory}")
        return self


class UpsetWhileWritten(AtWriting[UpsetWhileWrittenSettings]):
    """One bit of each octet that is struck."""

    def written(self, memory: str, octets: bytes) -> bytes:
        if self.settings.memory not in (None, memory):
            return octets
        if memory == "parameters" and not self.settings.caught:
            return self._unseen(octets)
        return bytes(octet ^ 1 << self.random.randrange(8) if self.strikes() else octet for octet in octets)

    def _unseen(self, image: bytes) -> bytes:
        fits = self.reach.device.parameters.fits
        for address in range(len(image) - CHECK_OCTETS):
            if self.strikes() and (bits := unseen_upsets(image, address, fits)):
                image = checked_again(with_upset(image, address, self.random.choice(bits)))
        return image


KINDS: Final = (
    FaultKind(
        BitUpsetSettings,
        BitUpset,
        what="At one instant one bit of a memory is another (a single-event upset). It is over at once, "
        "whatever end is given.",
        obc_sees="Catalogue or program, caught: within 2 s MODE_CHANGED to FAULT and FAULT_ENTERED with "
        "CATALOGUE_DAMAGED or PROGRAM_DAMAGED, no more attitudes; a self-test fails with the same part. Not "
        "caught: no event and a self-test that passes; a star whose direction is another is missing in "
        "stars_identified or draws the attitude away unnoticed; a memory check of the program gives "
        "another check sum than the OBC's own copy. Parameters, caught: nothing until the next start or "
        "self-test; then BOOT_COMPLETED with boot_count 1, PARAMETER_STORE_INVALID with BAD_CHECKSUM and "
        "factory parameters. Not caught: after the next start a parameter (or boot_count) with another "
        "value.",
        afterwards="Catalogue and program are copied anew at the next start: RESET leads out of FAULT. "
        "Parameters stay as they are until they are written anew, by a telecommand or by the count of the "
        "next start.",
    ),
    FaultKind(
        UpsetWhileWrittenSettings,
        UpsetWhileWritten,
        what="Of the octets that are written while it lasts, by a parameter write or a memory load, those "
        "that are struck have one other bit.",
        obc_sees="The telecommand completes. Memory load: a check or dump (service 6) gives another check "
        "sum than that of the data sent; into the program it leads to FAULT with PROGRAM_DAMAGED within 2 "
        "s. Parameters: the value in force is the one that was sent, and the stored one is spoilt: a "
        "self-test fails with PARAMETER_STORE, the next start has PARAMETER_STORE_INVALID and factory "
        "parameters; not caught, it has another value and no event.",
        afterwards="The next write is whole and mends what was spoilt; RAM and program are as new after a "
        "start.",
    ),
)
