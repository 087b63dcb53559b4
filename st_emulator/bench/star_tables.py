"""The star tables that are loaded into a unit before it flies."""

from __future__ import annotations

from functools import lru_cache

from ..device.calibration import camera_geometry
from ..firmware_model.configuration import StarTables
from ..units.profile import UnitProfile
from .tables_cache import TableFigures, star_tables_of


@lru_cache(maxsize=4)
def _tables(figures: TableFigures) -> StarTables:
    return star_tables_of(figures)


def star_tables(profile: UnitProfile) -> StarTables:
    """The unit's on-board catalogue and pair table: built once, kept in the user's cache folder."""
    geometry = camera_geometry(profile)
    return _tables(
        TableFigures(
            limit_mag=profile.catalogue.limit_mag,
            epoch_jyear=profile.catalogue.epoch_jyear,
            resolution_rad=profile.catalogue.resolution_px / profile.focal_px,
            max_angle_rad=round(2 * geometry.half_diagonal_rad, 6),
        )
    )
