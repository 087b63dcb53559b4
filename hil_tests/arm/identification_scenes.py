"""Spikes for the identification kernels: skies of random stars seen by two cameras, and all that goes wrong.

The two skies are those of a narrow field with many dim stars and of a wide field with few bright ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from hil_tests.firmware_model.synthetic_sky import (
    ARCSEC,
    SyntheticSky,
    random_attitude,
    vectors_of,
)
from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.geometry import CameraGeometry
from st_emulator.firmware_model.identification.interface import (
    IdentificationAlgorithm,
    IdentificationParameters,
    Spikes,
)

NARROW = CameraGeometry(752, 480, 41.1 / 0.006)
WIDE = CameraGeometry(1024, 1024, 43.3 / 0.015)
PARAMETERS = {
    "narrow": IdentificationParameters(8 * ARCSEC, field_normals=NARROW.field_normals(-6.0)),
    "wide": IdentificationParameters(25 * ARCSEC, field_normals=WIDE.field_normals(-6.0)),
}


@cache
def sky(name: str) -> SyntheticSky:
    """12,500 stars to 6.9 mag for the narrow field, 2600 to 5.5 mag for the wide one."""
    if name == "narrow":
        return SyntheticSky.make(1, 12_500, NARROW, 6.9)
    return SyntheticSky.make(2, 2617, WIDE, 5.5)


@dataclass(frozen=True)
class Scene:
    """Spikes of an image with what they truly are: true_rows[n] of the catalogue, -1 for a false one."""

    name: str
    spikes: Spikes
    true_rows: NDArray[np.intp]
    parameters: IdentificationParameters

    def record(self, algorithm: IdentificationAlgorithm) -> StepRecord:
        """The step ``identify`` of a frame with these spikes."""
        tables = sky(self.name).tables
        found, work = algorithm(self.spikes, tables, self.parameters)
        arguments = {
            "algorithm": algorithm,
            "spikes": self.spikes,
            "tables": tables,
            "parameters": self.parameters,
        }
        return StepRecord("identify", arguments, found, work)


def seen(name: str, seed: int, *, stars: int = 60, false: int = 0, noise_px: float = 0.05) -> Scene:
    """An image of so many of the brightest stars, with false ones anywhere; brightest first."""
    rng = np.random.default_rng([seed, len(name)])
    world = sky(name)
    view = world.view(random_attitude(rng))
    count = min(stars, len(view))
    camera = world.camera
    x = np.concatenate([view.x_px[:count], rng.uniform(3, camera.width_px - 4, false)])
    y = np.concatenate([view.y_px[:count], rng.uniform(3, camera.height_px - 4, false)])
    x, y = x + rng.normal(0, noise_px, len(x)), y + rng.normal(0, noise_px, len(y))
    magnitude = np.concatenate([view.magnitude[:count], rng.uniform(3.0, world.limit_mag, false)])
    magnitude = magnitude + rng.normal(0, 0.2, len(magnitude))
    rows = np.concatenate([view.row[:count], np.full(false, -1)])
    order = np.argsort(magnitude, kind="stable")
    spikes = Spikes(np.ascontiguousarray(vectors_of(camera, x, y)[order]), magnitude[order])
    return Scene(name, spikes, rows[order], PARAMETERS[name])


def nothing_of_the_sky(name: str, seed: int, count: int) -> Scene:
    """Spikes none of which is a star."""
    return seen(name, seed, stars=0, false=count)


def with_unusable(scene: Scene, seed: int) -> Scene:
    """The same with a third of the spikes spoilt: NaN, infinite, no unit vector."""
    rng = np.random.default_rng(seed)
    b, magnitudes = scene.spikes.b_vectors.copy(), scene.spikes.magnitudes.copy()
    rows = scene.true_rows.copy()
    for place in rng.choice(len(b), len(b) // 3, replace=False):
        rows[place] = -1
        kind = rng.integers(4)
        if kind == 0:
            b[place, rng.integers(3)] = np.nan
        elif kind == 1:
            b[place] *= 1.0 + 3e-6
        elif kind == 2:
            magnitudes[place] = np.nan
        else:
            magnitudes[place] = np.inf
    return replace(scene, spikes=Spikes(b, magnitudes), true_rows=rows)


def with_parameters(scene: Scene, **changes: object) -> Scene:
    """The same with other parameters."""
    return replace(scene, parameters=replace(scene.parameters, **changes))  # type: ignore[arg-type]


def of_three_stars(name: str, seed: int) -> Scene:
    """Three stars alone: never more than unconfirmed, often ambiguous."""
    return seen(name, seed, stars=3)


def doubled(name: str, seed: int) -> Scene:
    """Every star twice, a tolerance apart: two spikes for one star, which only the nearer gets."""
    scene = seen(name, seed, stars=9)
    rng = np.random.default_rng(seed)
    b = scene.spikes.b_vectors
    beside = b + rng.normal(0, scene.parameters.tolerance_rad, b.shape)
    beside /= np.linalg.norm(beside, axis=1, keepdims=True)
    b = np.concatenate([b, beside])
    magnitudes = np.concatenate([scene.spikes.magnitudes, scene.spikes.magnitudes + 0.01])
    order = np.argsort(magnitudes, kind="stable")
    rows = np.concatenate([scene.true_rows, scene.true_rows])
    return replace(
        scene, spikes=Spikes(np.ascontiguousarray(b[order]), magnitudes[order]), true_rows=rows[order]
    )


def of_odd_brightness(name: str, seed: int) -> Scene:
    """Five stars, of which none, one or two are far too dim: one may be."""
    scene = seen(name, seed, stars=5, noise_px=0.02)
    magnitudes = scene.spikes.magnitudes.copy()
    magnitudes[-1 - seed % 3 :][1:] += 3.0
    return replace(scene, spikes=Spikes(scene.spikes.b_vectors, magnitudes))


def in_line(name: str, seed: int) -> Scene:
    """Three stars in line, whose triangle the noise has turned over."""
    rng = np.random.default_rng(seed)
    world = sky(name)
    while True:
        view = world.view(random_attitude(rng))
        b = vectors_of(world.camera, view.x_px, view.y_px)[:40]
        crossed = np.cross(b[:, np.newaxis], b)
        volumes = np.abs(np.einsum("ai,bci->abc", b, crossed))
        apart = np.linalg.norm(b[:, np.newaxis] - b, axis=2) < 0.02
        volumes[apart[:, :, np.newaxis] | apart[:, np.newaxis, :] | apart[np.newaxis]] = np.inf
        three = np.sort(np.unravel_index(volumes.argmin(), volumes.shape))
        true = b[three]
        for _ in range(100):
            moved = true + rng.normal(0, 0.2 * PARAMETERS[name].tolerance_rad, (3, 3))
            moved /= np.linalg.norm(moved, axis=1, keepdims=True)
            if np.linalg.det(moved) * np.linalg.det(true) < 0.0:
                spikes = Spikes(np.ascontiguousarray(moved), view.magnitude[three])
                scene = Scene(name, spikes, view.row[three], PARAMETERS[name])
                return with_parameters(scene, field_normals=None, most_false_triangles=1.0)


def two_skies(name: str, seed: int) -> Scene:
    """Four stars of one sky and four of another: either attitude has as many."""
    one, other = (seen(name, 2 * seed + half, stars=4) for half in range(2))
    b = np.concatenate([one.spikes.b_vectors, other.spikes.b_vectors])
    magnitudes = np.concatenate([one.spikes.magnitudes, other.spikes.magnitudes])
    order = np.argsort(magnitudes, kind="stable")
    rows = np.concatenate([one.true_rows, other.true_rows])[order]
    # Four stars are to be neither too few nor certain, whatever the tolerance and the field.
    scene = replace(one, spikes=Spikes(np.ascontiguousarray(b[order]), magnitudes[order]), true_rows=rows)
    return with_parameters(
        scene, field_normals=None, most_false_solutions=1.0, certain_false_solutions=1e-30, max_spots=8
    )


SCENES: dict[str, Callable[[str, int], Scene]] = {
    "stars": lambda name, seed: seen(name, seed),
    "noisy": lambda name, seed: seen(name, seed, noise_px=0.3),
    "few": lambda name, seed: seen(name, seed, stars=5, false=2),
    "false stars": lambda name, seed: seen(name, seed, false=12),
    "mostly false": lambda name, seed: with_parameters(seen(name, seed, stars=6, false=24), max_spots=12),
    "nothing of the sky": lambda name, seed: nothing_of_the_sky(name, seed, 9),
    "three": of_three_stars,
    "three of many": lambda name, seed: with_parameters(
        seen(name, seed, stars=3), tolerance_rad=6 * PARAMETERS[name].tolerance_rad, most_false_triangles=1e3
    ),
    "two skies": two_skies,
    "in line": in_line,
    "odd brightness": of_odd_brightness,
    "four": lambda name, seed: seen(name, seed, stars=4),
    "doubled": doubled,
    "unusable": lambda name, seed: with_unusable(seen(name, seed, stars=14), seed),
    "without field": lambda name, seed: with_parameters(seen(name, seed), field_normals=None),
    "wide tolerance": lambda name, seed: with_parameters(
        seen(name, seed, stars=10), tolerance_rad=4 * PARAMETERS[name].tolerance_rad
    ),
    "too few": lambda name, seed: seen(name, seed, stars=seed % 3),
}
