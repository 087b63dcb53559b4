"""Scenes for the tests of the improved multi-poles."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from hil_tests.firmware_model.synthetic_sky import (
    ARCSEC,
    SyntheticSky,
    View,
    turn_between,
    vectors_of,
)
from st_emulator.firmware_model.geometry import CameraGeometry
from st_emulator.firmware_model.identification.interface import (
    Identification,
    IdentificationParameters,
    Spikes,
)
from st_emulator.firmware_model.identification.multi_poles import identify
from st_emulator.firmware_model.work import Work

CAMERA = CameraGeometry(1024, 1024, 52.0 / 0.018)  # as the paper: 20 x 20 deg, 71.4 arcsec a pixel
PARAMETERS = IdentificationParameters(100 * ARCSEC, field_normals=CAMERA.field_normals(-6.0))
FINE = replace(PARAMETERS, tolerance_rad=25 * ARCSEC)


@cache
def sky() -> SyntheticSky:
    return SyntheticSky.make(3, 2617, CAMERA, 5.5, deeper_mag=1.0)


def measure(
    rng: np.random.Generator,
    view: View,
    noise_px: float = 0.1,
    false: int = 0,
    camera: CameraGeometry = CAMERA,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(directions, magnitudes, true rows or -1), brightest first, with noise and false spots."""
    x = np.concatenate(
        [view.x_px + rng.normal(0, noise_px, len(view)), rng.uniform(3, camera.width_px - 4, false)]
    )
    y = np.concatenate(
        [view.y_px + rng.normal(0, noise_px, len(view)), rng.uniform(3, camera.height_px - 4, false)]
    )
    magnitude = np.concatenate([view.magnitude + rng.normal(0, 0.2, len(view)), rng.uniform(-1, 5.5, false)])
    row = np.concatenate([view.row, np.full(false, -1)])
    order = np.argsort(magnitude, kind="stable")
    return vectors_of(camera, x, y)[order], magnitude[order], row[order]


def chosen(view: View, rows: np.ndarray | slice) -> View:
    return View(view.row[rows], view.x_px[rows], view.y_px[rows], view.magnitude[rows])


def catalogued(view: View) -> View:
    return chosen(view, view.magnitude < np.float32(5.5))


def solve(
    b: np.ndarray, magnitude: np.ndarray, parameters: IdentificationParameters = PARAMETERS, **changes: object
) -> tuple[Identification, Work]:
    return identify(Spikes(b, magnitude), sky().tables, replace(parameters, **changes))  # type: ignore[arg-type]


def is_right(found: Identification, q: np.ndarray) -> bool:
    assert found.q_icrs_to_sensor is not None
    return bool(np.linalg.norm(turn_between(q, found.q_icrs_to_sensor)[:2]) < 100 * ARCSEC)
