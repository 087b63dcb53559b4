"""The processing unit's memory: star tables, frame buffers, working tables and program against what it has.

Star tables are the arrays that the firmware model holds, byte for byte. Working tables are sized for the
worst that their limits allow, as a program without dynamic memory has to.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bench.star_tables import star_tables
from ..device.calibration import firmware_configuration
from ..firmware_model.catalogue.pairs import PairCatalogue
from ..firmware_model.catalogue.tables import StarTables
from ..firmware_model.configuration import FirmwareConfiguration
from ..firmware_model.image.centroid import SPOT_FIELDS
from ..firmware_model.image.clustering import CLUSTER_FIELDS, RUN_FIELDS
from ..firmware_model.tracking import window_half_width_px
from ..protocol.pus.services.large_data import IMAGE_HEADER_BYTES
from .subject import Subject

MIB = 1 << 20
PIXEL_BYTES = 2
INT32, FLOAT64 = 4, 8

ARRAYS = "arrays of the model"
SIZED = "sized for the worst case"
ASSUMED = "ASSUMED"

# ASSUMED: one of each for interrupts and for the main loop, with room for a path of calls in software double
# precision; the deepest of the kernels needs a few KiB.
STACK_BYTES = 256 * 1024
# ASSUMED: the compiled kernels are under 0.2 MiB; drivers, boot and services are a few times that.
PROGRAM_BYTES = 1 * MIB
# ASSUMED: packets waiting for the line in both directions.
LINK_BUFFER_BYTES = 16 * 1024

# Sarvi et al. 2014, "Catalogue Structure": 2 million pairs, 38 MB, columns angle (deg), pivot id, pair id
PAPER_PAIRS = 2_000_000
PAPER_BYTES = 38_000_000


@dataclass(frozen=True)
class MemoryItem:
    """What takes memory: its group, name, bytes, how the size is known, and a remark."""

    group: str
    name: str
    nbytes: int
    basis: str
    remark: str = ""


@dataclass(frozen=True)
class PaperCatalogue:
    """The pair catalogue of Sarvi et al. 2014 beside the unit's own.

    pairs, pair_bytes: the unit's, k-vector included; max_angle_deg: its widest pair. wide_angle_deg,
    wide_pairs, wide_bytes: what its stars would give within twice the field, each pair once, by the density
    of the unit's own pairs.
    """

    paper_pairs: int
    paper_bytes: int
    pairs: int
    pair_bytes: int
    max_angle_deg: float
    wide_angle_deg: float
    wide_pairs: int
    wide_bytes: int
    total_with_papers_bytes: int

    def text(self) -> str:
        """Why the two differ, in words."""
        row_bytes = self.paper_bytes / self.paper_pairs
        own_bytes = self.pair_bytes / max(1, self.pairs)
        return (
            f"The paper's 38 MB are {row_bytes:.0f} bytes for each of 2 million rows (angle, pivot, pair), "
            f"with neighbours in a cone of twice the field. This unit holds {self.pairs:,} pairs, "
            f"each once and no wider than the diagonal of its field ({self.max_angle_deg:.1f} deg): "
            f"{own_bytes:.0f} bytes a pair (cosine 8, two rows of the catalogue 4 each, k-vector 4), "
            f"{self.pair_bytes / 1e6:.1f} MB; neighbours come from a grid of the sky instead. "
            f"Pairs within {self.wide_angle_deg:.1f} deg would be about {self.wide_pairs / 1e6:.1f} million "
            f"and {self.wide_bytes / 1e6:.0f} MB. With the paper's 38 MB in place of its own pairs the unit "
            f"would take {self.total_with_papers_bytes / MIB:.1f} MiB."
        )


@dataclass(frozen=True)
class Memory:
    """All items against what the unit has."""

    items: tuple[MemoryItem, ...]
    available_bytes: int
    paper: PaperCatalogue

    @property
    def total_bytes(self) -> int:
        return sum(item.nbytes for item in self.items)

    @property
    def assumed_bytes(self) -> int:
        """Of the total, what no array and no limit gives."""
        return sum(item.nbytes for item in self.items if item.basis == ASSUMED)

    @property
    def fits(self) -> bool:
        return self.total_bytes <= self.available_bytes

    @property
    def fits_at_bound(self) -> bool:
        """Also if what is assumed takes twice as much."""
        return self.total_bytes + self.assumed_bytes <= self.available_bytes

    def as_dict(self) -> dict[str, Any]:
        return {
            "available_bytes": self.available_bytes,
            "total_bytes": {
                "value": self.total_bytes,
                "low": self.total_bytes - self.assumed_bytes,
                "high": self.total_bytes + self.assumed_bytes,
            },
            "fits": self.fits,
            "items": [asdict(item) for item in self.items],
            "papers_catalogue": asdict(self.paper) | {"text": self.paper.text()},
        }


def memory_of(subject: Subject) -> Memory:
    """Where a unit's memory goes."""
    profile = subject.profile
    tables = star_tables(profile)
    configuration = firmware_configuration(profile, subject.parameters)
    image = profile.detector.columns * profile.detector.rows * PIXEL_BYTES
    buffers = 2 if subject.pipelined else 1
    items = [
        *_catalogue_items(tables),
        *_reference_items(subject, tables, configuration),
        MemoryItem(
            "images",
            f"frame buffers, {buffers} x {profile.detector.columns} x {profile.detector.rows} px x 2 bytes",
            buffers * image,
            SIZED,
            "one is read out while the other is worked on" if buffers == 2 else "not pipelined",
        ),
        MemoryItem("images", "image store for download", IMAGE_HEADER_BYTES + image, SIZED),
        *_detection_items(subject, configuration),
        *_streak_items(configuration),
        MemoryItem(
            "working tables",
            f"search of {profile.identification.algorithm}",
            search_bytes(profile.identification.algorithm, tables, configuration),
            SIZED,
            "tables of spots and stars of the search",
        ),
        MemoryItem("program", "program and constants", PROGRAM_BYTES, ASSUMED),
        MemoryItem("program", "stacks", STACK_BYTES, ASSUMED),
        MemoryItem("program", "link buffers", LINK_BUFFER_BYTES, ASSUMED),
    ]
    total = sum(item.nbytes for item in items)
    return Memory(
        tuple(items), round(profile.processor.memory_mbyte * MIB), _paper(subject, tables.pairs, total)
    )


def _nbytes(arrays: Iterable[NDArray[Any]]) -> int:
    return sum(array.nbytes for array in arrays)


def pair_bytes(pairs: PairCatalogue) -> int:
    """A pair list with its k-vector."""
    return _nbytes(pairs.to_arrays().values())


def _catalogue_items(tables: StarTables) -> list[MemoryItem]:
    catalogue, pairs = tables.catalogue, tables.pairs
    cells = catalogue.cells
    return [
        MemoryItem(
            "star tables",
            f"catalogue, {len(catalogue)} stars: number, direction, magnitude",
            _nbytes((catalogue.hip, catalogue.unit_vectors, catalogue.hp_mag)),
            ARRAYS,
        ),
        MemoryItem(
            "star tables",
            "grid of the sky: which stars are near a direction",
            _nbytes((cells.band_first_cell, cells.cell_start, cells.cell_star)),
            ARRAYS,
            "neighbours in tracking, stars of a field",
        ),
        MemoryItem(
            "star tables",
            f"pairs, {len(pairs)}: cosine and both stars",
            _nbytes((pairs.cos_angle, pairs.brighter, pairs.dimmer)),
            ARRAYS,
        ),
        MemoryItem("star tables", "k-vector of the pairs", _nbytes((pairs.kvector.count_below,)), ARRAYS),
    ]


def _reference_items(
    subject: Subject, tables: StarTables, configuration: FirmwareConfiguration
) -> list[MemoryItem]:
    if subject.profile.identification.algorithm != "brightness_referenced":
        return []
    limit = configuration.identification.brightness.bright_limit_mag
    pairs = tables.reference_pairs(limit)
    return [
        MemoryItem(
            "star tables",
            f"reference pairs, {len(pairs)}, a star under {limit:g} mag, with their k-vector",
            pair_bytes(pairs),
            ARRAYS,
        )
    ]


def _detection_items(subject: Subject, configuration: FirmwareConfiguration) -> list[MemoryItem]:
    detection, geometry = configuration.detection, configuration.geometry
    rows, runs = geometry.height_px, detection.max_runs
    run_table = runs * (RUN_FIELDS * INT32 + FLOAT64 + INT32) + (rows + 1) * INT32
    cluster_table = runs * (CLUSTER_FIELDS * FLOAT64 + SPOT_FIELDS * FLOAT64 + 1)
    tracking = configuration.tracking
    interval_s = (tracking.max_missed + 1) * subject.period_ns * 1e-9
    half = window_half_width_px(tracking, geometry, interval_s, configuration.exposure_ns * 1e-9)
    side = 2 * half + 1
    pixels = min(
        tracking.max_windows * min(side, geometry.width_px) * min(side, rows), geometry.width_px * rows
    )
    return [
        MemoryItem("working tables", f"runs with their labels, {runs}", run_table, SIZED),
        MemoryItem(
            "working tables",
            f"clusters and spots, {runs}",
            cluster_table,
            SIZED,
            "if every run were a cluster of its own",
        ),
        MemoryItem(
            "working tables",
            f"pixels of {tracking.max_windows} windows of {side} px",
            pixels * PIXEL_BYTES,
            SIZED,
            f"after {tracking.max_missed} frames lost; merged ones are no larger than the image",
        ),
    ]


def _streak_items(configuration: FirmwareConfiguration) -> list[MemoryItem]:
    """What a unit that measures its rate without an attitude keeps of a frame for the next: both at once."""
    if configuration.rate is None:
        return []
    runs, spots = configuration.detection.max_runs, configuration.detection.max_spots
    table = runs * RUN_FIELDS * INT32 + spots * (5 * INT32 + SPOT_FIELDS * FLOAT64)
    return [
        MemoryItem(
            "working tables",
            f"spots of two frames with their runs, {spots} and {runs} each",
            2 * table + runs * 2 * INT32,
            SIZED,
            "fusion of the frame before and this one; room to join pieces of streaks",
        )
    ]


def search_bytes(algorithm: str, tables: StarTables, configuration: FirmwareConfiguration) -> int:
    """Working tables of a search, as its kernel has them, for as many spots as it may be given.

    Each holds two matches of a star to every spot and a star's candidates besides.
    """
    stars = len(tables.catalogue)
    parameters = configuration.identification
    given = configuration.max_spots
    used = min(given, parameters.max_spots)
    matches = 2 * given * (INT32 + FLOAT64) + stars * INT32
    if algorithm == "pyramid":  # ranges and cosines of all pairs of spots; entries of two ranges
        return matches + used * used * (2 * INT32 + 2 * FLOAT64) + 2 * stars * INT32
    if algorithm == "brightness_referenced":  # the same, chains by star
        chains = 4 * _longest_range(tables.pairs, parameters.tolerance_rad)
        return matches + used * used * (2 * INT32 + 2 * FLOAT64) + 2 * stars * INT32 + 3 * chains * INT32
    if algorithm == "geometric_voting":  # a vote of each spot for each star
        return matches + given * given * 2 * FLOAT64 + given * stars * INT32
    # multi_poles: all pairs that fit a pole's angles, both ways round, in four columns; accepted sets
    room = (given - 1) * _longest_range(tables.pairs, parameters.tolerance_rad)
    return matches + 8 * room * INT32 + given * given * INT32 + stars * (2 * INT32 + 8)


def _longest_range(pairs: PairCatalogue, tolerance_rad: float) -> int:
    """Most pairs that one range query can give."""
    angles = np.arange(0.0, pairs.max_angle_rad + tolerance_rad, tolerance_rad)
    lengths = [end - first for first, end in (pairs.query(float(angle), tolerance_rad) for angle in angles)]
    return max(lengths, default=0)


def _paper(subject: Subject, pairs: PairCatalogue, total_bytes: int) -> PaperCatalogue:
    columns_deg, rows_deg = subject.profile.field_deg
    wide_rad = math.radians(2.0 * math.hypot(columns_deg, rows_deg))
    # pairs grow with the area of the cone about a star
    growth = (1.0 - math.cos(wide_rad)) / (1.0 - math.cos(pairs.max_angle_rad))
    each = pair_bytes(pairs) / max(1, len(pairs))
    wide = round(len(pairs) * growth)
    return PaperCatalogue(
        PAPER_PAIRS,
        PAPER_BYTES,
        len(pairs),
        pair_bytes(pairs),
        math.degrees(pairs.max_angle_rad),
        math.degrees(wide_rad),
        wide,
        round(wide * each),
        total_bytes - pair_bytes(pairs) + PAPER_BYTES,
    )
