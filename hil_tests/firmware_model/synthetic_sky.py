"""Skies made up for the tests, and a camera written out plainly; of the firmware only its data types."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from st_emulator.firmware_model.catalogue.pairs import PairCatalogue, build_pair_catalogue
from st_emulator.firmware_model.catalogue.star_catalogue import StarCatalogue, build_star_catalogue
from st_emulator.firmware_model.catalogue.tables import StarTables
from st_emulator.firmware_model.geometry import CameraGeometry

ARCSEC = np.pi / 180 / 3600
Array = NDArray[np.float64]


def random_directions(rng: np.random.Generator, count: int) -> Array:
    """Unit vectors evenly over the sphere."""
    v = rng.normal(size=(count, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def random_attitude(rng: np.random.Generator) -> Array:
    """A quaternion q_icrs_to_sensor, evenly over all attitudes."""
    q = Rotation.random(random_state=int(rng.integers(2**31))).as_quat()
    return np.asarray(q if q[3] >= 0 else -q)


def matrix(q: Array) -> Array:
    """A(q) by scipy, whose matrices are active: ours is the transpose."""
    return np.asarray(Rotation.from_quat(q).as_matrix().T)


def turned(q: Array, rotation_vector_rad: Array) -> Array:
    """The attitude after the sensor has turned by a rotation vector given in sensor axes."""
    after = (Rotation.from_quat(q) * Rotation.from_rotvec(rotation_vector_rad)).as_quat()
    return np.asarray(after if after[3] >= 0 else -after)


def turn_between(q_before: Array, q_after: Array) -> Array:
    """Rotation vector, sensor axes, from one attitude to the other; by scipy."""
    return np.asarray((Rotation.from_quat(q_before).inv() * Rotation.from_quat(q_after)).as_rotvec())


@dataclass(frozen=True)
class View:
    """What the camera sees, brightest first: rows of the sky, places, magnitudes."""

    row: NDArray[np.intp]
    x_px: Array
    y_px: Array
    magnitude: Array

    def __len__(self) -> int:
        return len(self.row)


@dataclass(frozen=True)
class SyntheticSky:
    """Stars in random directions, more of them the dimmer, as in the real sky (about 10^(0.5 m))."""

    vectors: Array
    magnitude: NDArray[np.float32]
    camera: CameraGeometry
    limit_mag: float

    @classmethod
    def make(
        cls, seed: int, stars: int, camera: CameraGeometry, limit_mag: float = 6.0, deeper_mag: float = 0.0
    ) -> SyntheticSky:
        """`stars` brighter than the limit, and all those down to deeper_mag below it."""
        rng = np.random.default_rng(seed)
        total = int(stars * 10 ** (0.5 * deeper_mag))
        magnitude = limit_mag + deeper_mag + 2.0 * np.log10(rng.uniform(1e-5, 1.0, total))
        return cls(random_directions(rng, total), magnitude.astype(np.float32), camera, limit_mag)

    @cached_property
    def catalogue(self) -> StarCatalogue:
        """The on-board catalogue of this sky; hip is the row plus 1."""
        hip = np.arange(1, len(self.vectors) + 1)
        return build_star_catalogue(hip, self.vectors, self.magnitude, self.limit_mag, 0.0)

    @cached_property
    def pairs(self) -> PairCatalogue:
        """All pairs that fit into the field."""
        return build_pair_catalogue(self.catalogue, 2.0 * self.camera.half_diagonal_rad)

    @cached_property
    def tables(self) -> StarTables:
        """Catalogue and pairs."""
        return StarTables(self.catalogue, self.pairs)

    def view(self, q: Array, border_px: float = 3.0) -> View:
        """Stars in the image (pinhole, written out), at least border_px from its edge."""
        v = self.vectors @ matrix(q).T
        ahead = np.flatnonzero(v[:, 2] > 0.2)
        x = self.camera.cx_px + self.camera.focal_px * v[ahead, 0] / v[ahead, 2]
        y = self.camera.cy_px + self.camera.focal_px * v[ahead, 1] / v[ahead, 2]
        inside = (x > border_px) & (x < self.camera.width_px - 1 - border_px)
        inside &= (y > border_px) & (y < self.camera.height_px - 1 - border_px)
        rows = ahead[inside]
        order = np.argsort(self.magnitude[rows], kind="stable")
        return View(
            rows[order], x[inside][order], y[inside][order], self.magnitude[rows][order].astype(np.float64)
        )


def vectors_of(camera: CameraGeometry, x_px: Array, y_px: Array) -> Array:
    """Directions of pixels for a camera without distortion, written out."""
    v = np.stack(
        [(x_px - camera.cx_px) / camera.focal_px, (y_px - camera.cy_px) / camera.focal_px, np.ones(len(x_px))]
    )
    return np.asarray((v / np.linalg.norm(v, axis=0)).T)


class ImageFrame:
    """A frame whose pixels are there already."""

    def __init__(self, image: NDArray[np.uint16], bits: int = 12) -> None:
        self._image = image
        self.height_px, self.width_px = image.shape
        self.bits = bits
        self.pixels_read = 0

    def full(self) -> NDArray[np.uint16]:
        self.pixels_read += self._image.size
        return self._image

    def windows(self, rects: NDArray[np.int32]) -> tuple[NDArray[np.uint16], NDArray[np.int64]]:
        cut = [self._image[y0:y1, x0:x1].ravel() for x0, y0, x1, y1 in rects.tolist()]
        offsets = np.concatenate([[0], np.cumsum([len(part) for part in cut])]).astype(np.int64)
        flat = np.concatenate(cut) if cut else np.zeros(0, np.uint16)
        self.pixels_read += len(flat)
        return flat, offsets
