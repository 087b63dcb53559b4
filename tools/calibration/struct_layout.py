"""Layouts of the kernels' structs, from the debug information (DWARF) that the compiler left in the program.

Nothing here or in the bindings says where a member lies: a struct is packed and read by its members' names.
A member that is moved or retyped in C is followed; one that comes or goes is an error at the next packing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from elftools.common.exceptions import ELFError
from elftools.dwarf.die import DIE
from elftools.elf.elffile import ELFFile

from tools.arm_timing.errors import ArmError
from tools.arm_timing.machine import ArmMachine

__all__ = [
    "LayoutError",
    "StructLayout",
    "StructLayouts",
    "layout_of",
    "place_struct",
    "read_struct",
    "read_structs",
    "reserve_structs",
]

_POINTER = np.dtype("<u4")
# DWARF 5, 7.8: encodings of base types
_KINDS = {0x02: "u", 0x04: "f", 0x05: "i", 0x06: "i", 0x07: "u", 0x08: "u"}
_QUALIFIERS = ("DW_TAG_typedef", "DW_TAG_const_type", "DW_TAG_volatile_type", "DW_TAG_restrict_type")


class LayoutError(ArmError):
    """A struct or member that the program has not, or a value that a member cannot hold."""


@dataclass(frozen=True)
class StructLayout:
    """Where the members of one struct lie.

    dtype: a NumPy type of the struct's size with each member at its place; a pointer is a word, an array
        member a subarray, a struct within it a type of the same kind.
    item_bytes: size of what each pointer among the members points to; 0 of void.
    """

    name: str
    dtype: np.dtype[np.void]
    item_bytes: Mapping[str, int]

    @property
    def nbytes(self) -> int:
        """Size of the struct with its padding."""
        return self.dtype.itemsize

    @property
    def members(self) -> tuple[str, ...]:
        """Names in the order of their places."""
        return self.dtype.names or ()

    def offset(self, member: str) -> int:
        """Byte at which a member begins. LayoutError: there is no such member."""
        self._require(member)
        fields = self.dtype.fields
        assert fields is not None  # a struct's dtype has them
        return int(fields[member][1])

    def items_bytes(self, member: str, count: int) -> int:
        """Size of ``count`` of what a pointer points to. LayoutError: it is no pointer to something."""
        self._require(member)
        if not self.item_bytes.get(member):
            raise LayoutError(f"{self.name}.{member} is no pointer to anything of a size")
        return self.item_bytes[member] * count

    def pack(self, **members: Any) -> npt.NDArray[np.void]:
        """One struct, all members given by name: numbers, sequences for arrays, mappings for structs.

        LayoutError: a member is missing, unknown, or cannot hold its value.
        """
        return self.pack_array((), **members)

    def pack_array(self, shape: int | tuple[int, ...], **members: Any) -> npt.NDArray[np.void]:
        """As `pack`, an array of structs: each member has the array's shape, then its own."""
        packed = np.zeros(shape, self.dtype)
        _fill(packed, self.name, members)
        return packed

    def _require(self, member: str) -> None:
        if member not in self.members:
            raise LayoutError(f"{self.name} has no member {member!r}; it has {', '.join(self.members)}")


def _fill(packed: npt.NDArray[np.void], struct: str, members: Mapping[str, Any]) -> None:
    names = packed.dtype.names or ()
    unknown, missing = sorted(members.keys() - set(names)), [name for name in names if name not in members]
    if unknown:
        raise LayoutError(f"{struct} has no member {', '.join(unknown)}; it has {', '.join(names)}")
    if missing:
        raise LayoutError(f"{struct}: no value is given for {', '.join(missing)}")
    for name, value in members.items():
        place, where = packed[name], f"{struct}.{name}"
        if place.dtype.names is not None and isinstance(value, Mapping):
            _fill(place, where, value)
        else:
            place[...] = _held(np.asarray(value), place, where)


def _held(value: npt.NDArray[Any], place: npt.NDArray[Any], where: str) -> npt.NDArray[Any]:
    """The value, if it is of the member's shape and the member holds it as it is."""
    if value.shape != place.shape:
        raise LayoutError(f"{where} has the shape {place.shape}, not {value.shape}")
    if place.dtype.names is not None:
        fits = value.dtype == place.dtype
    elif place.dtype.kind == "f":
        fits = value.dtype.kind in "biuf"
    else:
        limits = np.iinfo(place.dtype)
        fits = value.dtype.kind in "biu" and bool(np.all((value >= limits.min) & (value <= limits.max)))
    if not fits:
        raise LayoutError(f"{where} is {place.dtype}, which does not hold {value}")
    return value


class StructLayouts:
    """The structs of a program by the names of their typedefs or tags."""

    def __init__(self, elf: Path) -> None:
        """LayoutError: the file has no debug information, or is no ELF file."""
        self._elf = elf
        self._known: dict[str, StructLayout] = {}
        self._found: dict[str, list[DIE]] = {}
        try:
            file = ELFFile(BytesIO(elf.read_bytes()))
            if not file.has_dwarf_info():
                raise LayoutError(f"{elf}: no debug information (compile with -g)")
            for unit in file.get_dwarf_info().iter_CUs():
                for entry in unit.get_top_DIE().iter_children():
                    self._note(entry)
        except ELFError as error:
            raise LayoutError(f"{elf}: not an ELF file ({error})") from error

    def _note(self, entry: DIE) -> None:
        name = entry.attributes.get("DW_AT_name")
        if name is None or "DW_AT_declaration" in entry.attributes:
            return
        struct = entry
        if entry.tag == "DW_TAG_typedef" and "DW_AT_type" in entry.attributes:
            struct = _unqualified(entry)
        if struct.tag == "DW_TAG_structure_type" and "DW_AT_byte_size" in struct.attributes:
            self._found.setdefault(name.value.decode(), []).append(struct)

    @property
    def names(self) -> frozenset[str]:
        """Of all structs."""
        return frozenset(self._found)

    def __getitem__(self, name: str) -> StructLayout:
        """The layout of a struct. LayoutError: there is none, several that differ, or what has no NumPy type
        (a bit field, a union, an array without a length).
        """
        if name not in self._known:
            if name not in self._found:
                raise LayoutError(f"{self._elf}: no struct {name!r}")
            first, *others = (_layout(name, entry) for entry in self._found[name])
            if any(other != first for other in others):
                raise LayoutError(f"{self._elf}: several structs {name!r} that differ")
            self._known[name] = first
        return self._known[name]


def _layout(name: str, entry: DIE) -> StructLayout:
    item_bytes = {}
    for member, kind, _ in _members(entry, name):
        target = _unqualified(kind)
        if target.tag == "DW_TAG_pointer_type":
            item_bytes[member] = _nbytes_pointed_to(target)
    return StructLayout(name, _struct_dtype(entry, name), item_bytes)


def _members(entry: DIE, where: str) -> Iterator[tuple[str, DIE, int]]:
    """(name, type, offset) of each member."""
    for child in entry.iter_children():
        if child.tag != "DW_TAG_member":
            continue
        name = child.attributes.get("DW_AT_name")
        if name is None or "DW_AT_bit_size" in child.attributes:
            raise LayoutError(f"{where}: a member without a name, or a bit field")
        offset = int(child.attributes["DW_AT_data_member_location"].value)
        yield name.value.decode(), child.get_DIE_from_attribute("DW_AT_type"), offset


def _struct_dtype(entry: DIE, where: str) -> np.dtype[np.void]:
    members = list(_members(entry, where))
    return np.dtype(
        {
            "names": [name for name, _, _ in members],
            "formats": [_dtype(kind, f"{where}.{name}") for name, kind, _ in members],
            "offsets": [offset for _, _, offset in members],
            "itemsize": int(entry.attributes["DW_AT_byte_size"].value),
        }
    )


def _dtype(entry: DIE, where: str) -> np.dtype[Any]:
    entry = _unqualified(entry)
    if entry.tag == "DW_TAG_pointer_type":
        return _POINTER
    if entry.tag == "DW_TAG_structure_type":
        return _struct_dtype(entry, where)
    if entry.tag == "DW_TAG_array_type":
        item = _dtype(entry.get_DIE_from_attribute("DW_AT_type"), where)
        return np.dtype((item, _shape(entry, where)))
    if entry.tag == "DW_TAG_enumeration_type" and "DW_AT_type" in entry.attributes:
        return _dtype(entry.get_DIE_from_attribute("DW_AT_type"), where)
    if entry.tag == "DW_TAG_base_type" and entry.attributes["DW_AT_encoding"].value in _KINDS:
        kind = _KINDS[entry.attributes["DW_AT_encoding"].value]
        return np.dtype(f"<{kind}{entry.attributes['DW_AT_byte_size'].value}")
    raise LayoutError(f"{where}: a {entry.tag} has no layout here")


def _shape(array: DIE, where: str) -> tuple[int, ...]:
    shape = []
    for dimension in array.iter_children():
        attributes = dimension.attributes
        if "DW_AT_upper_bound" in attributes:
            shape.append(int(attributes["DW_AT_upper_bound"].value) + 1)
        elif "DW_AT_count" in attributes:
            shape.append(int(attributes["DW_AT_count"].value))
        else:
            raise LayoutError(f"{where}: an array without a length")
    return tuple(shape)


def _nbytes_pointed_to(pointer: DIE) -> int:
    """0 where it has no size: void, functions, what is only declared. Structs are not looked into."""
    if "DW_AT_type" not in pointer.attributes:
        return 0
    target = _unqualified(pointer.get_DIE_from_attribute("DW_AT_type"))
    size = target.attributes.get("DW_AT_byte_size")
    return 0 if size is None else int(size.value)


def _unqualified(entry: DIE) -> DIE:
    while entry.tag in _QUALIFIERS and "DW_AT_type" in entry.attributes:
        entry = entry.get_DIE_from_attribute("DW_AT_type")
    return entry


@lru_cache(maxsize=8)
def _layouts(elf: Path) -> StructLayouts:
    return StructLayouts(elf)


def layout_of(machine: ArmMachine, name: str) -> StructLayout:
    """Layout of a struct of the machine's program, whose file is read once. LayoutError: there is none."""
    return _layouts(machine.program.path)[name]


def place_struct(machine: ArmMachine, struct: str, **members: Any) -> int:
    """A C struct in the machine's memory, all its members given by name; its address."""
    return machine.place(layout_of(machine, struct).pack(**members))


def reserve_structs(machine: ArmMachine, struct: str, count: int = 1) -> int:
    """Address of so many zeroed structs."""
    return machine.reserve(layout_of(machine, struct).nbytes * count)


def read_struct(machine: ArmMachine, struct: str, address: int) -> np.void:
    """A copy of a struct in memory, to be indexed by its members' names."""
    found: np.void = read_structs(machine, struct, address, 1)[0]
    return found


def read_structs(machine: ArmMachine, struct: str, address: int, count: int) -> npt.NDArray[np.void]:
    """A copy of an array of structs."""
    return machine.read(address, layout_of(machine, struct).dtype, count)
