"""What an object of the dictionary is: index, sub-indices, types, access, ranges."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import Enum
from typing import Final

from .data_types import DataType, Value, size_of


class Access(Enum):
    """Who may do what by SDO."""

    CONST = "const"
    READ_ONLY = "ro"
    READ_WRITE = "rw"
    WRITE_ONLY = "wo"


READABLE: Final = (Access.CONST, Access.READ_ONLY, Access.READ_WRITE)
WRITABLE: Final = (Access.READ_WRITE, Access.WRITE_ONLY)

_RANGES: Final = {
    DataType.BOOLEAN: 1,
    DataType.UNSIGNED8: 0xFF,
    DataType.UNSIGNED16: 0xFFFF,
    DataType.UNSIGNED32: 0xFFFF_FFFF,
    DataType.UNSIGNED64: 0xFFFF_FFFF_FFFF_FFFF,
}


@dataclass(frozen=True)
class Entry:
    """One sub-index. ``default``: its value after a start; ``maximum``: the type's where None.

    ``mappable``: it may be in a PDO. A value that the node makes when it is asked has a default as well.
    """

    sub: int
    name: str
    type: DataType
    access: Access
    default: Value
    meaning: str = ""
    unit: str = ""
    maximum: int | None = None
    mappable: bool = False

    @property
    def bits(self) -> int:
        """Bits of the value in a PDO; 0 where the length varies."""
        size = size_of(self.type)
        return 0 if size is None else 8 * size

    @property
    def highest(self) -> int | None:
        """The largest value; None where there is none."""
        return _RANGES.get(self.type) if self.maximum is None else self.maximum


@dataclass(frozen=True)
class DictionaryObject:
    """One index: a variable has one entry, of sub-index 0; a record or an array several."""

    index: int
    name: str
    entries: tuple[Entry, ...]
    meaning: str = ""
    subs: dict[int, Entry] = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "subs", {entry.sub: entry for entry in self.entries})

    @property
    def is_variable(self) -> bool:
        return len(self.entries) == 1


def variable(
    index: int,
    name: str,
    data_type: DataType,
    access: Access,
    default: Value,
    meaning: str = "",
    *,
    unit: str = "",
    maximum: int | None = None,
    mappable: bool = False,
) -> DictionaryObject:
    """An object of one value."""
    entry = Entry(0, name, data_type, access, default, meaning, unit, maximum, mappable)
    return DictionaryObject(index, name, (entry,), meaning)


def record(index: int, name: str, entries: Iterable[Entry], meaning: str = "") -> DictionaryObject:
    """An object of several values; sub-index 0, the highest sub-index, is added."""
    own = tuple(entries)
    highest = Entry(
        0,
        "highest_sub_index",
        DataType.UNSIGNED8,
        Access.CONST,
        max(entry.sub for entry in own),
        "highest sub-index",
    )
    return DictionaryObject(index, name, (highest, *own), meaning)
