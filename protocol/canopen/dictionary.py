"""The object dictionary at work: its values, and who makes or takes some of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from .data_types import Value, decode_value, encode_value, size_of
from .objects import READABLE, WRITABLE, DictionaryObject, Entry
from .sdo import AbortCode

Place = tuple[int, int]
"""Index and sub-index."""

Read = Callable[[], Value | AbortCode]
Written = Callable[[Value, int], AbortCode | None]
"""Takes a value that was received at a time (ns), or says why it does not."""

MOST_VARIABLE_BYTES = 4096  # ASSUMED: a buffer for objects whose length varies


class Dictionary:
    """Values of objects, by index and sub-index.

    What a client may do is checked here: existence, access, length, range. ``on_read`` makes the value of a
    place when it is asked for, ``on_write`` is asked before a value is kept.
    """

    def __init__(self, objects: Iterable[DictionaryObject]) -> None:
        self.objects = {item.index: item for item in objects}
        self._values: dict[Place, Value] = {}
        self._reads: dict[Place, Read] = {}
        self._writes: dict[Place, Written] = {}
        self.restore(0, 0xFFFF)

    def restore(self, first: int, last: int) -> None:
        """Default values for every object of the indices ``first`` to ``last``."""
        for item in self.objects.values():
            if first <= item.index <= last:
                for entry in item.entries:
                    self._values[item.index, entry.sub] = entry.default

    def on_read(self, index: int, sub: int, read: Read) -> None:
        """``read`` makes this value from now on."""
        self._reads[index, sub] = read

    def on_write(self, index: int, sub: int, written: Written) -> None:
        """``written`` is asked before a value of a client is kept."""
        self._writes[index, sub] = written

    def entry(self, index: int, sub: int) -> Entry | AbortCode:
        """The definition of a place."""
        item = self.objects.get(index)
        if item is None:
            return AbortCode.NO_OBJECT
        return item.subs.get(sub, AbortCode.NO_SUB_INDEX)

    def __getitem__(self, place: Place) -> Value:
        return self._values[place]

    def __setitem__(self, place: Place, value: Value) -> None:
        self._values[place] = value

    def number(self, index: int, sub: int) -> int:
        """The value of a place that holds a whole number."""
        value = self._values[index, sub]
        assert isinstance(value, int)
        return value

    # -- a client's access

    def octets(self, index: int, sub: int) -> bytes | AbortCode:
        """The present value of an existing place as octets, whoever may read it."""
        entry = self.entry(index, sub)
        if isinstance(entry, AbortCode):
            return entry
        read = self._reads.get((index, sub))
        value = self._values[index, sub] if read is None else read()
        return value if isinstance(value, AbortCode) else encode_value(entry.type, value)

    def read(self, index: int, sub: int) -> bytes | AbortCode:
        """The octets that a client gets."""
        entry = self.entry(index, sub)
        if isinstance(entry, AbortCode):
            return entry
        if entry.access not in READABLE:
            return AbortCode.WRITE_ONLY
        return self.octets(index, sub)

    def writable_bytes(self, index: int, sub: int) -> tuple[int, int] | AbortCode:
        """(fewest, most) octets that a client may write."""
        entry = self.entry(index, sub)
        if isinstance(entry, AbortCode):
            return entry
        if entry.access not in WRITABLE:
            return AbortCode.READ_ONLY
        size = size_of(entry.type)
        return (0, MOST_VARIABLE_BYTES) if size is None else (size, size)

    def write(self, index: int, sub: int, data: bytes, at_ns: int) -> AbortCode | None:
        """A client's octets, received at ``at_ns``; None: they are in force."""
        limits = self.writable_bytes(index, sub)
        if isinstance(limits, AbortCode):
            return limits
        fewest, most = limits
        if len(data) > most:
            return AbortCode.TOO_LONG
        if len(data) < fewest:
            return AbortCode.TOO_SHORT
        entry = self.objects[index].subs[sub]
        value = decode_value(entry.type, data)
        if value is None:
            return AbortCode.VALUE
        if isinstance(value, int) and entry.highest is not None and value > entry.highest:
            return AbortCode.VALUE_TOO_HIGH
        written = self._writes.get((index, sub))
        refused = None if written is None else written(value, at_ns)
        if refused is None:
            self._values[index, sub] = value
        return refused
