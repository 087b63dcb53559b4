"""Scenes of stars without pixels: directions and magnitudes as a detector would give them.

For what depends on identification alone: thousands of scenes a second. The sky is the on-board catalogue
itself. A scene depends on its seed and its case alone, so it is the same on any number of workers.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..compiled_kernels import keep_compiled_kernels
from ..firmware_model.catalogue.pairs import build_pair_catalogue
from ..firmware_model.catalogue.star_catalogue import StarCatalogue, build_star_catalogue
from ..firmware_model.catalogue.tables import StarTables
from ..firmware_model.identification.interface import Spikes
from ..world import quaternion
from ..world.stars import star_field

ARCSEC = np.pi / 180 / 3600
NORMAL_SIGMA_MAG = 0.2  # Zhang et al. 2014, simulations: magnitude uncertainty 0.2
SCATTER_SHARE = 0.31  # the same: intensities of one star in flight vary up to 31 %
OUTLIER_MAG = 0.7  # the same: a measured magnitude is up to 0.7 off
# ASSUMED: the paper prints no share. One dim star in ten is off by the whole 0.7, nine of ten of these too
# bright ("in most cases the measured magnitude is smaller", "only on a dim star").
OUTLIER_SHARE = 0.1
OUTLIER_BRIGHT_SHARE = 0.9
DIM_MAG = 3.0  # ASSUMED: dim is what is no reference star of the paper
EPOCH_JYEAR = 2026.0
COMPANION_MAG = 3.0  # companions up to so much dimmer move a merged spot
_FALSE_STREAM = 1  # of their own stream: the true stars stay the same, however many false ones there are

FloatArray = NDArray[np.float64]


class MagnitudeNoise(StrEnum):
    """How measured magnitudes differ from the catalogue's."""

    NORMAL = "normal"  # normal, sigma 0.2 mag
    FLIGHT = "flight"  # intensities uniform within +- 31 %, one dim star in ten 0.7 mag off


@dataclass(frozen=True)
class SceneSettings:
    """What scenes are like.

    field_deg: side of a square field (boresight to the middle of an edge is half of it), or diameter of a
        circular one.
    noise_arcsec: one sigma of a direction about each of the two axes across it.
    false_stars: spread evenly over the field, magnitudes even over the catalogue's range.
    most_spikes: only so many of the brightest (as measured) are given; None: all.
    """

    field_deg: float
    circular: bool = False
    noise_arcsec: float = 5.0
    magnitude_noise: MagnitudeNoise = MagnitudeNoise.NORMAL
    false_stars: int = 0
    most_spikes: int | None = None


@dataclass(frozen=True)
class StarScene:
    """One scene, brightest (as measured) first.

    b_vectors: float64[n, 3], sensor frame. magnitudes: float64[n], as measured. true_rows: int32[n], row of
    the catalogue, -1 for a false star. q: float64[4], true q_icrs_to_sensor. stars: catalogue stars in the
    field, those beyond most_spikes included.
    """

    b_vectors: FloatArray
    magnitudes: FloatArray
    true_rows: NDArray[np.int32]
    q: FloatArray
    stars: int

    @property
    def spikes(self) -> Spikes:
        """What an identification algorithm is given."""
        return Spikes(self.b_vectors, self.magnitudes)


@lru_cache(maxsize=4)
def scene_tables(
    limit_mag: float, max_angle_deg: float, resolution_arcsec: float = 0.0, epoch_jyear: float = EPOCH_JYEAR
) -> StarTables:
    """Hipparcos stars with Hp below the limit, and their pairs up to max_angle_deg; built in this process.

    resolution_arcsec: closer stars are one; 0: all are kept, the catalogue's rows are those of
    ``star_field(epoch_jyear, limit_mag)``.
    """
    keep_compiled_kernels()
    deeper = limit_mag + COMPANION_MAG if resolution_arcsec > 0 else limit_mag
    stars = star_field(epoch_jyear, deeper)
    catalogue = build_star_catalogue(
        stars.hip, stars.unit_vectors, stars.hp_mag, limit_mag, resolution_arcsec * ARCSEC
    )
    return StarTables(catalogue, build_pair_catalogue(catalogue, float(np.radians(max_angle_deg))))


def square_field_normals(field_deg: float) -> FloatArray:
    """``float64[4, 3]``: inward normals of a square field, as ``CameraGeometry.field_normals`` gives them."""
    half = np.radians(field_deg / 2)
    c, s = np.cos(half), np.sin(half)
    # in order round the field: two that follow each other meet in a corner
    return np.array([[c, 0.0, s], [0.0, c, s], [-c, 0.0, s], [0.0, -c, s]])


def stars_in_field(catalogue: StarCatalogue, q: FloatArray, settings: SceneSettings) -> NDArray[np.intp]:
    """Rows of the catalogue's stars in the field at attitude q, ascending."""
    a = quaternion.attitude_matrix(q)
    half = np.radians(settings.field_deg / 2)
    ahead = catalogue.unit_vectors @ a[2]
    if settings.circular:
        return np.flatnonzero(ahead > np.cos(half))
    corner = 1.0 / np.sqrt(1.0 + 2.0 * np.tan(half) ** 2)
    near = np.flatnonzero(ahead > corner - 1e-12)
    across = np.abs(catalogue.unit_vectors[near] @ a[:2].T)
    return near[np.all(across < np.tan(half) * ahead[near, np.newaxis], axis=1)]


def random_attitude(rng: np.random.Generator) -> FloatArray:
    """Uniform over all rotations, w >= 0."""
    return quaternion.canonical(rng.normal(size=4))


def make_scene(
    catalogue: StarCatalogue, settings: SceneSettings, seed: int, case: int, q: FloatArray | None = None
) -> StarScene:
    """Scene ``case`` of a seed: the attitude (unless given), the stars' noise and the false stars."""
    rng = np.random.default_rng([seed, case])
    drawn = random_attitude(rng)
    attitude = drawn if q is None else q
    rows = stars_in_field(catalogue, attitude, settings)
    true = catalogue.unit_vectors[rows] @ quaternion.attitude_matrix(attitude).T
    vectors = _displaced(true, settings.noise_arcsec * ARCSEC, rng)
    magnitudes = _measured(catalogue.hp_mag[rows].astype(np.float64), settings.magnitude_noise, rng)
    true_rows = rows.astype(np.int32)
    if settings.false_stars:
        stream = np.random.default_rng([seed, case, _FALSE_STREAM])
        false = _directions_in_field(settings, stream)
        brightest, dimmest = float(catalogue.hp_mag.min()), catalogue.limit_mag
        vectors = np.concatenate([vectors, false])
        magnitudes = np.concatenate([magnitudes, stream.uniform(brightest, dimmest, len(false))])
        true_rows = np.concatenate([true_rows, np.full(len(false), -1, np.int32)])
    order = np.argsort(magnitudes, kind="stable")[: settings.most_spikes]
    return StarScene(
        np.ascontiguousarray(vectors[order]), magnitudes[order], true_rows[order], attitude, len(rows)
    )


def _displaced(vectors: FloatArray, sigma_rad: float, rng: np.random.Generator) -> FloatArray:
    """Unit vectors moved by normal noise; its part along a direction drops out when it is normed."""
    moved = vectors + sigma_rad * rng.normal(size=vectors.shape)
    return np.asarray(moved / np.linalg.norm(moved, axis=1, keepdims=True))


def _measured(magnitudes: FloatArray, noise: MagnitudeNoise, rng: np.random.Generator) -> FloatArray:
    if noise is MagnitudeNoise.NORMAL:
        return magnitudes + NORMAL_SIGMA_MAG * rng.normal(size=len(magnitudes))
    scatter = -2.5 * np.log10(1.0 + SCATTER_SHARE * rng.uniform(-1.0, 1.0, len(magnitudes)))
    chance, side = rng.uniform(size=(2, len(magnitudes)))
    outlier = (magnitudes > DIM_MAG) & (chance < OUTLIER_SHARE)
    off = np.where(side < OUTLIER_BRIGHT_SHARE, -OUTLIER_MAG, OUTLIER_MAG)
    return np.where(outlier, magnitudes + off, magnitudes + scatter)


def _directions_in_field(settings: SceneSettings, rng: np.random.Generator) -> FloatArray:
    """``false_stars`` directions spread evenly (a square field: evenly over the plane of the image)."""
    count = settings.false_stars
    half = np.radians(settings.field_deg / 2)
    first, second = rng.uniform(size=(2, count))
    if settings.circular:
        z = 1.0 - first * (1.0 - np.cos(half))
        radius, angle = np.sqrt(1.0 - z * z), 2.0 * np.pi * second
        return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
    plane = np.stack([2.0 * first - 1.0, 2.0 * second - 1.0], axis=1) * np.tan(half)
    v = np.concatenate([plane, np.ones((count, 1))], axis=1)
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))
