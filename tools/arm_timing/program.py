"""An ELF file for ARM926EJ-S, read and checked."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path

from elftools.common.exceptions import ELFError
from elftools.elf.elffile import ELFFile

from .errors import ArmError

_EF_ARM_ABI_FLOAT_HARD = 0x400  # ELF for the ARM Architecture (IHI 0044), e_flags
_EXECUTABLE = 1  # p_flags, PF_X


@dataclass(frozen=True)
class Segment:
    """A piece of a program in memory."""

    address: int
    contents: bytes
    nbytes: int  # in memory; beyond the contents it is zero
    executable: bool


@dataclass(frozen=True)
class Program:
    """What of an ELF file is needed to run it."""

    path: Path
    entry: int
    segments: tuple[Segment, ...]
    symbols: dict[str, int]
    functions: tuple[tuple[int, str], ...]  # (address, name) in order of address

    @classmethod
    def read(cls, path: Path) -> Program:
        """Read a statically linked 32-bit little-endian ARM executable; ArmError for anything else."""
        try:
            with open(path, "rb") as stream:
                return cls._of(path, ELFFile(stream))
        except OSError as error:
            raise ArmError(f"{path}: {error.strerror or error}") from error
        except ELFError as error:
            raise ArmError(f"{path}: not an ELF file ({error})") from error

    @classmethod
    def _of(cls, path: Path, elf: ELFFile) -> Program:
        if elf["e_machine"] != "EM_ARM" or elf.elfclass != 32:
            raise ArmError(
                f"{path}: built for {elf.get_machine_arch()}, {elf.elfclass} bit; this runs 32-bit ARM"
            )
        if not elf.little_endian:
            raise ArmError(f"{path}: big-endian; this runs little-endian ARM")
        if elf["e_type"] != "ET_EXEC":
            raise ArmError(f"{path}: not a linked executable (link it with -static, without -pie or -r)")
        if elf["e_flags"] & _EF_ARM_ABI_FLOAT_HARD:
            raise ArmError(f"{path}: built for hard float; ARM926EJ-S needs -mfloat-abi=soft")
        segments = []
        for segment in elf.iter_segments():
            if segment["p_type"] == "PT_INTERP":
                raise ArmError(f"{path}: dynamically linked; link it with -static")
            if segment["p_type"] == "PT_LOAD" and segment["p_memsz"]:
                executable = bool(segment["p_flags"] & _EXECUTABLE)
                segments.append(Segment(segment["p_vaddr"], segment.data(), segment["p_memsz"], executable))
        if not segments:
            raise ArmError(f"{path}: nothing to load")
        symbols: dict[str, int] = {}
        functions: dict[int, str] = {}
        table = elf.get_section_by_name(".symtab")
        for symbol in table.iter_symbols() if table else ():
            if not symbol.name or symbol.name.startswith("$") or symbol["st_shndx"] == "SHN_UNDEF":
                continue
            kind = symbol["st_info"]["type"]
            if kind in ("STT_FUNC", "STT_NOTYPE", "STT_OBJECT"):
                symbols.setdefault(symbol.name, symbol["st_value"])
            if kind in ("STT_FUNC", "STT_NOTYPE"):
                functions.setdefault(symbol["st_value"], symbol.name)
        return cls(path, elf["e_entry"], tuple(segments), symbols, tuple(sorted(functions.items())))

    def place_of(self, address: int) -> str:
        """An address as a person reads it: 0x00010a3c (scan+0x1c)."""
        index = bisect_right(self.functions, (address, "\uffff")) - 1
        inside = any(part.address <= address < part.address + part.nbytes for part in self.segments)
        if index < 0 or not inside:
            return f"0x{address:08x}"
        start, name = self.functions[index]
        return f"0x{address:08x} ({name}+0x{address - start:x})"
