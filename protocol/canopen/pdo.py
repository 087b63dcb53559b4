"""Process data objects (CiA 301, 7.2.2): when they are sent, and what is in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from .dictionary import Dictionary
from .sdo import AbortCode

PDO_BYTES: Final = 8
RECEIVE_PARAMETERS: Final = 0x1400
RECEIVE_MAPPING: Final = 0x1600
TRANSMIT_PARAMETERS: Final = 0x1800
TRANSMIT_MAPPING: Final = 0x1A00
NOT_VALID: Final = 1 << 31
IDENTIFIER_MASK: Final = 0x7FF

COB_ID, TRANSMISSION_TYPE, INHIBIT_TIME, EVENT_TIMER, SYNC_START = 1, 2, 3, 5, 6

ACYCLIC_SYNC: Final = 0
MOST_SYNCS: Final = 240
EVENT_TYPES: Final = (0xFE, 0xFF)
TICK_NS: Final = 100_000  # of an inhibit time
NS_PER_MS: Final = 1_000_000


def transmission_type_exists(value: int) -> bool:
    """241 to 251 are reserved; 252 and 253 answer to remote frames, which the card does not."""
    return value <= MOST_SYNCS or value in EVENT_TYPES


def mapped(index: int, sub: int, bits: int) -> int:
    """A mapping entry."""
    return index << 16 | sub << 8 | bits


def mapping_of(dictionary: Dictionary, index: int) -> list[tuple[int, int, int]]:
    """(index, sub-index, octets) of the objects that the mapping at ``index`` names, in their order."""
    found = []
    for place in range(1, dictionary.number(index, 0) + 1):
        value = dictionary.number(index, place)
        found.append((value >> 16, value >> 8 & 0xFF, (value & 0xFF) // 8))
    return found


def pack(dictionary: Dictionary, index: int) -> bytes:
    """The present octets of the objects that the mapping at ``index`` names."""
    data = b""
    for item, sub, size in mapping_of(dictionary, index):
        octets = dictionary.octets(item, sub)
        data += bytes(size) if isinstance(octets, AbortCode) else octets[:size].ljust(size, b"\0")
    return data


@dataclass
class TransmitPdo:
    """When one TPDO goes out; its parameters are read from the dictionary each time.

    ``number`` counts from 1. ``wanted``: an event came up that has not been sent: the inhibit time runs, or a
    SYNC is waited for.
    """

    dictionary: Dictionary
    number: int
    wanted: bool = False
    syncs: int = 0
    sent_ns: int | None = None
    timer_from_ns: int = 0

    def _parameter(self, sub: int) -> int:
        return self.dictionary.number(TRANSMIT_PARAMETERS + self.number - 1, sub)

    @property
    def valid(self) -> bool:
        return not self._parameter(COB_ID) & NOT_VALID

    @property
    def identifier(self) -> int:
        return self._parameter(COB_ID) & IDENTIFIER_MASK

    @property
    def data(self) -> bytes:
        return pack(self.dictionary, TRANSMIT_MAPPING + self.number - 1)

    @property
    def _event_driven(self) -> bool:
        return self._parameter(TRANSMISSION_TYPE) in EVENT_TYPES

    def start(self, now_ns: int) -> None:
        """The node has become operational: timers and counters begin."""
        self.wanted = False
        self.syncs = 0
        self.sent_ns = None
        self.timer_from_ns = now_ns

    def _free_ns(self) -> int:
        """From when on it may be sent."""
        if self.sent_ns is None:
            return 0
        return self.sent_ns + self._parameter(INHIBIT_TIME) * TICK_NS

    def _send(self, now_ns: int) -> bool:
        self.wanted = False
        self.sent_ns = self.timer_from_ns = now_ns
        return True

    def event(self, now_ns: int) -> bool:
        """Its objects have something new. True: it is to be sent now."""
        if not self.valid:
            return False
        if self._event_driven and now_ns >= self._free_ns():
            return self._send(now_ns)
        self.wanted = self._event_driven or self._parameter(TRANSMISSION_TYPE) == ACYCLIC_SYNC
        return False

    def sync(self, now_ns: int) -> bool:
        """A SYNC came. True: it is to be sent now."""
        kind = self._parameter(TRANSMISSION_TYPE)
        if not self.valid or kind > MOST_SYNCS:
            return False
        if kind == ACYCLIC_SYNC:
            return self.wanted and self._send(now_ns)
        self.syncs += 1
        if self.syncs < kind:
            return False
        self.syncs = 0
        return self._send(now_ns)

    def _due_ns(self) -> int | None:
        if not self.valid or not self._event_driven:
            return None
        if self.wanted:
            return self._free_ns()
        period_ms = self._parameter(EVENT_TIMER)
        if not period_ms:
            return None
        return max(self.timer_from_ns + period_ms * NS_PER_MS, self._free_ns())

    def next_deadline_ns(self) -> int | None:
        """When :meth:`poll` has to be called though nothing happens."""
        return self._due_ns()

    def poll(self, now_ns: int) -> bool:
        """Whether the time sends it now."""
        due_ns = self._due_ns()
        return due_ns is not None and now_ns >= due_ns and self._send(now_ns)


@dataclass
class ReceivePdo:
    """One RPDO. ``held``: octets of a synchronous one that wait for a SYNC, with the time they came at."""

    dictionary: Dictionary
    number: int
    held: tuple[bytes, int] | None = None

    def _parameter(self, sub: int) -> int:
        return self.dictionary.number(RECEIVE_PARAMETERS + self.number - 1, sub)

    def takes(self, identifier: int) -> bool:
        """Whether a frame of ``identifier`` is this PDO."""
        cob_id = self._parameter(COB_ID)
        return not cob_id & NOT_VALID and cob_id & IDENTIFIER_MASK == identifier

    def receive(self, data: bytes, at_ns: int) -> bool:
        """Its frame came; what is behind its objects is ignored. False: too short, nothing is done."""
        mapping = mapping_of(self.dictionary, RECEIVE_MAPPING + self.number - 1)
        if len(data) < sum(size for _, _, size in mapping):
            return False
        if self._parameter(TRANSMISSION_TYPE) in EVENT_TYPES:
            self._write(data, at_ns)
        else:
            self.held = (data, at_ns)
        return True

    def sync(self) -> None:
        """A SYNC came."""
        if self.held is not None:
            held, self.held = self.held, None
            self._write(*held)

    def _write(self, data: bytes, at_ns: int) -> None:
        start = 0
        for index, sub, size in mapping_of(self.dictionary, RECEIVE_MAPPING + self.number - 1):
            self.dictionary.write(index, sub, data[start : start + size], at_ns)
            start += size
