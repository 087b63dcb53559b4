"""All conventions at once against photographs: catalogue, attitude, roll, projection, reading of pixels.

Three frames of the openstartracker project with the astrometric solutions of an independent solver.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from st_emulator.world import quaternion
from st_emulator.world.camera import CameraModel
from st_emulator.world.recorded import RecordedFrames
from st_emulator.world.stars import StarField

FRAMES = Path(__file__).parents[3] / "shared" / "data" / "real_sky"

# file: right ascension, declination, "up is ... degrees E of N", as printed with the frames. The solver
# counts rows upwards, as FITS viewers do, while these files begin with the top row: its "up" is the
# direction of growing rows, and the position angle of the picture's top edge is 180 degrees from it. In
# img2 the brightest star, gamma Leonis, shows it: 0.92 deg east and 0.68 deg north of the centre (position
# angle 53.4), it lies 22 deg to the left of straight up.
SOLUTIONS = {
    "img2.png": (154.0158, 19.1582, -147.895),
    "img3.png": (169.9860, 13.7507, -167.509),
    "img4.png": (179.8172, 15.7356, 178.431),
}

CAMERA = CameraModel(
    width_px=1392,
    height_px=1040,
    focal_px=206264.806 / 15.72,
    psf_sigma_px=1.0,
    electrons_per_s_mag0=1e7,
    electrons_per_dn=1.0,
    full_well_electrons=1e5,
    read_noise_electrons=1.0,
)


@pytest.mark.skipif(not FRAMES.is_dir(), reason="the real frames are not beside this checkout")
@pytest.mark.parametrize("name", SOLUTIONS)
def test_catalogue_stars_lie_on_the_photograph(name: str, hipparcos: StarField) -> None:
    image = RecordedFrames(FRAMES / name, 1392, 1040)[0].full().astype(np.float64)
    ra, dec, growing_rows = SOLUTIONS[name]
    q = quaternion.quaternion_from_pointing(ra, dec, growing_rows + 180.0)
    bright = hipparcos.hp_mag < 7.0
    x, y, ahead = CAMERA.project(quaternion.rotate(q, hipparcos.unit_vectors[bright]))
    magnitude = hipparcos.hp_mag[bright]
    inside = ahead & (x > 20) & (x < 1371) & (y > 20) & (y < 1019)
    assert inside.sum() >= 8
    offsets, light = [], []
    for column, row in zip(x[inside], y[inside], strict=True):
        box = image[round(row) - 12 : round(row) + 13, round(column) - 12 : round(column) + 13]
        box = np.clip(box - np.median(box) - 15.0, 0.0, None)
        total = box.sum()
        assert total > 0.0
        rows, columns = np.mgrid[-12:13, -12:13]
        offsets.append((np.sum(box * columns) / total, np.sum(box * rows) / total))
        light.append(total)
    # the lens's distortion and 8 arcsec of aberration and solver are left in
    assert np.median(np.linalg.norm(offsets, axis=1)) < 4.0
    # brighter stars are brighter
    assert np.corrcoef(np.log10(light), magnitude[inside])[0, 1] < -0.7
    # turned over or turned about, the same stars are not there
    wrong = 0
    for column, row in zip(1391 - x[inside], y[inside], strict=True):
        box = image[round(row) - 4 : round(row) + 5, round(column) - 4 : round(column) + 5]
        wrong += bool(box.max() > np.median(box) + 60.0)
    assert wrong < 0.3 * inside.sum()
