"""Small ARM programs as words with their assembly beside them, linked without any tool."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

CODE = 0x10000
RETURN = "e12fff1e  bx lr"

EM_ARM, EM_386 = 40, 3
_EABI5_SOFT = 0x0500_0200
_SECTIONS = b"\0.symtab\0.strtab\0.shstrtab\0"


def words_of(listing: str) -> list[int]:
    """The words of lines "e0802003  add r2, r0, r3"; empty lines and lines of comment (;) are left out."""
    lines = [line.strip() for line in listing.splitlines()]
    return [int(line.split()[0], 16) for line in lines if line and not line.startswith(";")]


def texts_of(listing: str) -> list[str]:
    """The assembly beside the words."""
    lines = [line.strip() for line in listing.splitlines()]
    kept = [line for line in lines if line and not line.startswith(";")]
    return [re.sub(r"\s*;.*", "", " ".join(line.split()[1:])) for line in kept]


def write_elf(
    path: Path,
    functions: Mapping[str, Sequence[int]],
    *,
    address: int = CODE,
    machine: int = EM_ARM,
    flags: int = _EABI5_SOFT,
    kind: int = 2,
    thumb: bool = False,
    data: tuple[int, bytes] | None = None,
) -> Path:
    """An executable with functions one after the other, and bytes elsewhere if wished."""
    code, symbols = b"", []
    for name, words in functions.items():
        symbols.append((name, address + len(code) + thumb))
        code += struct.pack(f"<{len(words)}I", *words)
    names, table = b"\0", bytes(16)
    for name, value in symbols:
        table += struct.pack("<IIIBBH", len(names), value, 0, 0x12, 0, 1)  # global function
        names += name.encode() + b"\0"
    segments = [(address, code, 5), *([(data[0], data[1], 6)] if data else [])]
    offset = 52 + 32 * len(segments)
    headers, body = b"", b""
    for start, contents, access in segments:
        size = len(contents)
        headers += struct.pack("<8I", 1, offset + len(body), start, start, size, size, access, 4)
        body += contents
    places = []
    for contents in (table, names, _SECTIONS):
        places.append((offset + len(body), len(contents)))
        body += contents
    body += bytes(-len(body) % 4)
    sections = bytes(40) + b"".join(
        struct.pack("<10I", name, sort, 0, 0, *place, link, 1 if link else 0, 1, entry)
        for (name, sort, link, entry), place in zip(
            ((1, 2, 2, 16), (9, 3, 0, 0), (17, 3, 0, 0)), places, strict=True
        )
    )
    header = struct.pack(
        "<16sHHIIIIIHHHHHH",
        b"\x7fELF\x01\x01\x01" + bytes(9),
        kind,
        machine,
        1,
        symbols[0][1],
        52,
        offset + len(body),
        flags,
        52,
        32,
        len(segments),
        40,
        4,
        3,
    )
    path.write_bytes(header + headers + body + sections)
    return path
