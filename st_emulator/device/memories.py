"""The unit's memories that hold octets, and the checks of what must not change in them.

``ram`` is a patch area, empty after each start. ``program`` is the software, copied from its store at each
start. The star tables are read in place, by the firmware. All writing goes through here, so that a check that
comes round has something to do only when there was some.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..firmware_model.causes import FaultCause
from ..firmware_model.configuration import StarTables
from .commands import LoadMemory, Refusal, RefusedError

RAM_BYTES = 65536  # ASSUMED: a patch area of 64 KiB
PROGRAM_BYTES = 131072  # ASSUMED: room for the compiled stages, about 60 KiB, and as much again


class Memories:
    """Reads and writes by memory and address; every check is made before anything changes.

    Args:
        unit_name: decides what stands in the program memory.
        tables: the on-board catalogue as it was stored.
        written: what of octets stands in a memory after they were written (see
            :class:`~st_emulator.device.seams.DeviceSeams`).
    """

    def __init__(
        self,
        unit_name: str,
        tables: StarTables,
        written: Callable[[str, bytes], bytes] = lambda memory, octets: octets,
    ) -> None:
        self._written = written
        # ASSUMED: octets that stand for the software; nothing runs them.
        self._stored_program = hashlib.shake_256(unit_name.encode()).digest(PROGRAM_BYTES)
        self._stored_tables = tables
        self._digest: bytes | None = None
        self.reset()

    def reset(self) -> None:
        """As after a start: the patch area is empty, program and catalogue are copied from their stores."""
        self.ram = bytearray(RAM_BYTES)
        self.program = bytearray(self._stored_program)
        self._tables = self._stored_tables
        # What the check words agree with: a damage whose check word was computed behind it is in both.
        self._checked_program = self._stored_program
        self._checked_tables = self._stored_tables
        self._changed = False

    @property
    def tables(self) -> StarTables:
        """The on-board catalogue as it stands in memory now."""
        return self._tables

    def overwrite_tables(self, tables: StarTables) -> None:
        """Other octets stand where the catalogue was: the seam where its damage enters."""
        self._tables = tables
        self._changed = True

    def upset(self, memory: str, address: int, bit: int, *, caught: bool) -> None:
        """One bit of "program" or "catalogue" is another, until the next start.

        ``address``: in the octets of the program, or of :func:`catalogue_octets`. ``caught``: its check word
        does not agree; else it was computed behind the upset, and no check finds it.
        """
        if memory == "program":
            self.program[address] ^= 1 << bit
            if not caught:
                checked = bytearray(self._checked_program)
                checked[address] ^= 1 << bit
                self._checked_program = bytes(checked)
        else:
            self._tables = with_upset(self._tables, address, bit)
            if not caught:
                self._checked_tables = with_upset(self._checked_tables, address, bit)
        self._changed = True

    def _writable(self, memory: str) -> bytearray:
        match memory:
            case "ram":
                return self.ram
            case "program":
                return self.program
            case _:
                raise RefusedError(Refusal.READ_ONLY, memory)

    def check_load(self, command: LoadMemory) -> None:
        """Refuse a memory that cannot be written and an address outside it."""
        if command.start + len(command.data) > len(self._writable(command.memory)):
            raise RefusedError(Refusal.ADDRESS, command.start)

    def load(self, command: LoadMemory) -> None:
        """Write."""
        octets = self._written(command.memory, command.data)
        self._writable(command.memory)[command.start : command.start + len(octets)] = octets
        self._changed |= command.memory == "program"

    def ram_works(self) -> bool:
        """Write and read back two patterns, then restore the contents."""
        kept = bytes(self.ram)
        works = True
        for pattern in (0x55, 0xAA):
            self.ram[:] = bytes([pattern]) * RAM_BYTES
            works = works and self.ram.count(pattern) == RAM_BYTES
        self.ram[:] = kept
        return works

    def program_is_whole(self) -> bool:
        """Whether the program agrees with its check word."""
        return self.program == self._checked_program

    def catalogue_is_whole(self) -> bool:
        """Whether the catalogue agrees with its check word."""
        return digest_of(self._tables) == self._digest_of_checked()

    def _digest_of_checked(self) -> bytes:
        if self._checked_tables is not self._stored_tables:
            return digest_of(self._checked_tables)
        if self._digest is None:
            self._digest = digest_of(self._stored_tables)
        return self._digest

    def damage(self) -> FaultCause | None:
        """What is not as it was stored, None when all is whole; looked at again only after a writing."""
        if not self._changed:
            return None
        if not self.program_is_whole():
            return FaultCause.PROGRAM_DAMAGED
        if not self.catalogue_is_whole():
            return FaultCause.CATALOGUE_DAMAGED
        self._changed = False
        return None


def digest_of(tables: StarTables) -> bytes:
    """Digest of the on-board star tables."""
    digest = hashlib.sha256()
    for array in tables.arrays():
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.digest()


def catalogue_octets(tables: StarTables) -> int:
    """Octets of the star catalogue in which an upset can be: three directions of 8 octets for each star, then
    a magnitude of 4 octets for each.

    ASSUMED: the sky grid and the pair table are not among them: whatever reads beyond a memory by a wrong
    index is no model of a unit.
    """
    catalogue = tables.catalogue
    return catalogue.unit_vectors.nbytes + catalogue.hp_mag.nbytes


def with_upset(tables: StarTables, address: int, bit: int) -> StarTables:
    """The tables with one bit of :func:`catalogue_octets` another."""
    catalogue = tables.catalogue
    if address < catalogue.unit_vectors.nbytes:
        vectors = catalogue.unit_vectors.copy()
        vectors.view(np.uint8).reshape(-1)[address] ^= np.uint8(1 << bit)
        return replace(tables, catalogue=replace(catalogue, unit_vectors=vectors))
    magnitudes = catalogue.hp_mag.copy()
    magnitudes.view(np.uint8)[address - catalogue.unit_vectors.nbytes] ^= np.uint8(1 << bit)
    return replace(tables, catalogue=replace(catalogue, hp_mag=magnitudes))
