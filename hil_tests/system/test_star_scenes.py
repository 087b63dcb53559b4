"""Star-level scenes: what is in the field, and the noise that was asked for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from st_emulator.campaigns.star_scenes import (
    MagnitudeNoise,
    SceneSettings,
    make_scene,
    random_attitude,
    scene_tables,
    square_field_normals,
    stars_in_field,
)
from st_emulator.firmware_model.geometry import CameraGeometry

ARCSEC = np.pi / 180 / 3600
TABLES = scene_tables(5.0, 20.0)
CATALOGUE = TABLES.catalogue


def in_sensor_frame(q: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """By scipy, whose rotations are active: the passive one is the inverse."""
    return Rotation.from_quat(q).inv().apply(vectors)


def test_the_sky_is_that_of_the_paper():
    assert len(CATALOGUE) == 165 + 315 + 991  # Zhang et al. 2014, table 2, Hp < 5
    assert np.all(CATALOGUE.hp_mag < 5.0)
    apart = np.degrees(np.arccos(np.clip(TABLES.pairs.cos_angle, -1, 1)))
    assert 19.99 < apart.max() <= 20.0


@pytest.mark.parametrize("circular", [False, True])
def test_stars_in_the_field(circular):
    rng = np.random.default_rng(5)
    for _ in range(50):
        q = random_attitude(rng)
        v = in_sensor_frame(q, CATALOGUE.unit_vectors)
        if circular:
            inside = np.degrees(np.arccos(v[:, 2])) < 10.0
        else:
            inside = v[:, 2] > 0
            for axis in (0, 1):
                inside &= np.abs(np.degrees(np.arctan2(v[:, axis], v[:, 2]))) < 10.0
        rows = stars_in_field(CATALOGUE, q, SceneSettings(20.0, circular))
        assert rows.tolist() == np.flatnonzero(inside).tolist()
        if not circular:
            planes = np.all(v @ square_field_normals(20.0).T > 0, axis=1)
            assert planes.tolist() == inside.tolist()


def test_square_field_normals_are_those_of_a_camera():
    focal_px = 512 / np.tan(np.radians(10.0))
    camera = CameraGeometry(1024, 1024, focal_px)
    rng = np.random.default_rng(1)
    v = in_sensor_frame(random_attitude(rng), CATALOGUE.unit_vectors)
    ours, theirs = square_field_normals(20.0), camera.field_normals(0.0)
    assert np.all(v @ ours.T > 0, axis=1).tolist() == np.all(v @ theirs.T > 0, axis=1).tolist()
    for normals in (ours, theirs):  # normals that follow each other meet in a corner of the field
        corners = np.cross(normals, np.roll(normals, -1, axis=0))
        assert np.degrees(np.arccos(np.abs(corners[:, 2]) / np.linalg.norm(corners, axis=1))).min() > 13.0


def test_noise_of_directions():
    settings = SceneSettings(20.0, noise_arcsec=5.0)
    off = []
    for case in range(300):
        scene = make_scene(CATALOGUE, settings, 3, case)
        true = in_sensor_frame(scene.q, CATALOGUE.unit_vectors[scene.true_rows])
        assert scene.stars == len(true)
        np.testing.assert_allclose(np.linalg.norm(scene.b_vectors, axis=1), 1.0, atol=1e-14)
        off.append(np.linalg.norm(np.cross(true, scene.b_vectors), axis=1) / ARCSEC)
    squared = np.mean(np.concatenate(off) ** 2)
    assert np.sqrt(squared / 2) == pytest.approx(5.0, rel=0.03)  # two axes


def magnitude_errors(noise: MagnitudeNoise) -> tuple[np.ndarray, np.ndarray]:
    scenes = [
        make_scene(CATALOGUE, SceneSettings(20.0, magnitude_noise=noise), 8, case) for case in range(600)
    ]
    true = np.concatenate([CATALOGUE.hp_mag[scene.true_rows] for scene in scenes]).astype(float)
    return true, np.concatenate([scene.magnitudes for scene in scenes]) - true


def test_normal_magnitude_noise():
    _, error = magnitude_errors(MagnitudeNoise.NORMAL)
    assert error.std() == pytest.approx(0.2, rel=0.05)
    assert error.mean() == pytest.approx(0.0, abs=0.01)


def test_magnitudes_as_in_flight():
    true, error = magnitude_errors(MagnitudeNoise.FLIGHT)
    off = np.isclose(np.abs(error), 0.7)
    intensity = 10 ** (-0.4 * error[~off])
    assert 0.69 <= intensity.min() < 0.72
    assert 1.28 < intensity.max() <= 1.31
    assert np.all(true[off] > 3.0)
    assert np.mean(off[true > 3.0]) == pytest.approx(0.1, abs=0.02)
    assert np.mean(error[off] < 0) == pytest.approx(0.9, abs=0.04)


@pytest.mark.parametrize("circular", [False, True])
def test_false_stars_lie_in_the_field_and_leave_the_true_ones_as_they_are(circular):
    without = SceneSettings(20.0, circular)
    with_false = SceneSettings(20.0, circular, false_stars=50)
    places = []
    for case in range(40):
        plain, mixed = (make_scene(CATALOGUE, item, 2, case) for item in (without, with_false))
        true = mixed.true_rows >= 0
        assert np.sum(~true) == 50
        assert np.array_equal(mixed.b_vectors[true], plain.b_vectors)
        assert np.array_equal(mixed.true_rows[true], plain.true_rows)
        assert np.all(np.diff(mixed.magnitudes) >= 0)
        places.append(mixed.b_vectors[~true])
        assert mixed.magnitudes[~true].max() < 5.0
        assert mixed.magnitudes[~true].min() > -1.5
    v = np.concatenate(places)
    if circular:
        # evenly over the cap: the cosine is even
        z = (v[:, 2] - np.cos(np.radians(10))) / (1 - np.cos(np.radians(10)))
        assert z.min() >= 0
        assert np.histogram(z, 4, (0, 1))[0] == pytest.approx([500] * 4, abs=80)
    else:
        plane = v[:, :2] / v[:, 2:] / np.tan(np.radians(10))
        counts = np.histogram2d(plane[:, 0], plane[:, 1], 2, [(-1, 1), (-1, 1)])[0]
        assert counts.sum() == 2000
        assert counts == pytest.approx(np.full((2, 2), 500), abs=80)


def test_most_spikes_keeps_the_brightest():
    all_of_them = make_scene(CATALOGUE, SceneSettings(20.0, false_stars=3), 4, 7)
    cut = make_scene(CATALOGUE, SceneSettings(20.0, false_stars=3, most_spikes=5), 4, 7)
    assert len(cut.spikes) == 5
    assert cut.stars == all_of_them.stars
    assert np.array_equal(cut.b_vectors, all_of_them.b_vectors[:5])


def test_attitudes_are_even_over_the_sphere_and_depend_on_seed_and_case_alone():
    settings = SceneSettings(20.0)
    q = np.array([make_scene(CATALOGUE, settings, 6, case).q for case in range(2000)])
    boresight = Rotation.from_quat(q).apply([0.0, 0.0, 1.0])
    assert boresight.mean(axis=0) == pytest.approx([0, 0, 0], abs=0.05)
    assert np.mean(boresight**2, axis=0) == pytest.approx([1 / 3] * 3, abs=0.03)
    one = make_scene(CATALOGUE, settings, 6, 11)
    assert np.array_equal(one.q, q[11])
    assert not np.array_equal(one.q, make_scene(CATALOGUE, settings, 7, 11).q)


def test_stars_closer_than_the_resolution_are_one():
    merged = scene_tables(5.0, 20.0, 210.0).catalogue
    v = merged.unit_vectors
    cosine = v @ v.T - 2 * np.eye(len(v))
    assert np.degrees(np.arccos(cosine.max())) * 3600 > 210.0
    cosine = CATALOGUE.unit_vectors @ CATALOGUE.unit_vectors.T - 2 * np.eye(len(CATALOGUE))
    assert np.degrees(np.arccos(min(1.0, cosine.max()))) * 3600 < 60.0
