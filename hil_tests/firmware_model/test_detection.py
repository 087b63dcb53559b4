"""Full-frame detection: what is found, what is rejected and why, and the work counted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from st_emulator.firmware_model.image.background import NOISE_SAMPLES
from st_emulator.firmware_model.image.detection import DetectionParameters, detect
from st_emulator.firmware_model.image.spots import Rejections, Spots
from st_emulator.firmware_model.work import COUNTS

Render = Callable[..., NDArray[np.float64]]
Expose = Callable[..., NDArray[np.uint16]]
ROJA1 = (480, 752)
ELECTRONS_AT_6 = 5400.0
ZERO_POINT = ELECTRONS_AT_6 / 8 * 10 ** (0.4 * 6)  # DN in the exposure, 8 electrons/DN


def parameters(**changes: Any) -> DetectionParameters:
    settings: dict[str, Any] = {
        "zero_point_dn_per_s": ZERO_POINT / 0.2,
        "exposure_s": 0.2,
        "magnitude_limit": 6.9,
        "saturation_dn": 4095,
    }
    return DetectionParameters(**{**settings, **changes})


def star_grid(magnitude: float, rng: np.random.Generator, step: int = 24) -> list[tuple[float, float, float]]:
    flux = ELECTRONS_AT_6 * 10 ** (-0.4 * (magnitude - 6))
    return [
        (x + rng.uniform(-0.5, 0.5), y + rng.uniform(-0.5, 0.5), flux)
        for y in range(step, ROJA1[0] - step + 1, step)
        for x in range(step, ROJA1[1] - step + 1, step)
    ]


def test_half_of_the_stars_at_the_limit_are_detected(render_stars: Render, expose: Expose) -> None:
    rng = np.random.default_rng(11)
    share = {}
    for magnitude in (6.75, 6.85, 6.9, 6.95, 7.05):
        stars = star_grid(magnitude, rng)
        spots, _ = detect(expose(render_stars(ROJA1, stars), rng), parameters())
        share[magnitude] = len(spots) / len(stars)
        assert (np.diff(spots.flux_dn) <= 0).all()  # brightest first
        assert spots.rejected.faint == len(stars) - len(spots)
    assert share[6.75] > 0.98
    assert share[7.05] < 0.02
    assert 0.35 < share[6.9] < 0.65
    assert share[6.85] - share[6.95] > 0.5  # most of the change within 0.1 mag


def test_pure_noise_gives_no_spots(expose: Expose) -> None:
    rng = np.random.default_rng(12)
    found = 0
    for _ in range(8):
        spots, _ = detect(expose(np.zeros(ROJA1), rng), parameters(magnitude_limit=99.0))
        found += len(spots)
        assert spots.noise_dn == pytest.approx(np.hypot(19 / 8, 12**-0.5), rel=0.05)
        assert spots.background_dn == pytest.approx(100.0, abs=0.2)
    assert found <= 1


def test_isolated_hot_pixels_are_dropped(expose: Expose) -> None:
    rng = np.random.default_rng(13)
    hot = np.zeros(ROJA1)
    hot[rng.choice(240, 50, replace=False) * 2, rng.choice(376, 50, replace=False) * 2] = 20000.0
    image = expose(hot, rng)
    spots, _ = detect(image, parameters())
    assert len(spots) == 0
    assert spots.rejected.small + spots.rejected.edge >= 45
    # with min_pixels 1 it is the sharpness that gives them away
    spots, _ = detect(image, parameters(min_pixels=1))
    assert len(spots) == 0
    assert spots.rejected.sharp >= 45


def test_large_clusters_are_no_stars(render_stars: Render, expose: Expose) -> None:
    rng = np.random.default_rng(14)
    signal = render_stars(ROJA1, [(100.2, 100.7, 20000.0)])
    y, x = np.ogrid[: ROJA1[0], : ROJA1[1]]
    signal[(x - 400) ** 2 + (y - 240) ** 2 < 60**2] += 20000.0  # the Moon
    spots, _ = detect(expose(signal, rng), parameters())
    assert spots.rejected.large >= 1
    assert len(spots) == 1
    assert (spots.x_px[0], spots.y_px[0]) == pytest.approx((100.2, 100.7), abs=0.03)


def test_a_long_thin_cluster_is_no_star() -> None:
    image = np.full((300, 300), 100, np.uint16)
    image[np.arange(20, 280), np.arange(20, 280)] = 1000
    spots, _ = detect(image, parameters())
    assert len(spots) == 0
    assert spots.rejected == Rejections(large=1)


def test_the_dimmest_are_surplus(render_stars: Render) -> None:
    stars = [(20.0 + 15 * i, 40.0, 3000.0 + 500 * i) for i in range(10)]
    image = np.rint(100 + render_stars((80, 200), stars) / 8).astype(np.uint16)
    spots, _ = detect(image, parameters(max_spots=4))
    assert spots.x_px == pytest.approx([155, 140, 125, 110], abs=0.05)
    assert spots.rejected == Rejections(surplus=6)


def test_exposure_and_zero_point_make_the_magnitude(render_stars: Render) -> None:
    image = np.rint(100 + render_stars((60, 60), [(30.2, 29.7, 54000)]) / 8).astype(np.uint16)
    full, _ = detect(image, parameters(magnitude_limit=20.0))
    assert full.magnitude[0] == pytest.approx(3.5, abs=0.01)
    half, _ = detect(image, parameters(magnitude_limit=20.0, exposure_s=0.1))
    assert half.magnitude[0] == pytest.approx(full.magnitude[0] - 2.5 * np.log10(2))


def test_saturation_is_flagged(render_stars: Render, expose: Expose) -> None:
    signal = render_stars((100, 100), [(30.2, 29.7, 400_000.0), (70.0, 70.0, 20_000.0)])
    spots, _ = detect(expose(signal, np.random.default_rng(1)), parameters())
    assert spots.saturated.tolist() == [True, False]
    assert spots.peak_dn[0] == pytest.approx(4095 - 100, abs=2)


def test_a_full_run_table_is_told() -> None:
    rng = np.random.default_rng(15)
    image = rng.integers(0, 2, (200, 300)).astype(np.uint16) * 4000
    spots, work = detect(image, parameters(sigma_factor=0.5, max_runs=500))
    assert spots.overflowed
    assert work["runs"] == 500
    assert not detect(image, parameters())[0].overflowed


def test_work_counts_what_was_done(render_stars: Render) -> None:
    stars = [(30.0, 40.0, 8000.0), (90.5, 60.5, 8000.0)]
    image = np.rint(100 + render_stars((100, 120), stars) / 8).astype(np.uint16)
    spots, work = detect(image, parameters(tau_min_dn=12.0))
    over = image > 112
    over_by_block = np.pad(over, ((0, 0), (0, 8))).reshape(100, 4, 32).any(axis=2)
    assert len(spots) == 2
    assert work["threshold_pixels"] == 12000
    assert work["noise_samples"] == NOISE_SAMPLES
    assert work["noise_passes"] % NOISE_SAMPLES == 0
    assert work["noise_passes"] >= 3 * NOISE_SAMPLES  # mean difference, one r.m.s. or more, background
    assert work["block_pixels"] == 32 * over_by_block.sum() - 8 * over_by_block[:, 3].sum()
    assert work["rows_joined"] == 100
    assert work["clusters_refused"] == 0
    squares = rows_of_squares = marked = looked_at = 0
    for (
        x,
        y,
        _,
    ) in stars:  # the square: window of +-2.5 px about the cluster's centre of mass, 1 px, ring of 3 px
        near = np.zeros_like(over)
        near[int(y) - 5 : int(y) + 7, int(x) - 5 : int(x) + 7] = True
        rows, columns = np.nonzero(over & near)
        excess = image[rows, columns] - 100.0
        x_com, y_com = (columns * excess).sum() / excess.sum(), (rows * excess).sum() / excess.sum()
        first, last = np.floor(y_com - 2.5) - 4, np.ceil(y_com + 2.5) + 4
        squares += (last + 1 - first) * (np.ceil(x_com + 2.5) - np.floor(x_com - 2.5) + 9)
        rows_of_squares += last + 1 - first
        marked += sum(3 * ((rows == row).sum() + 2) for row in set(rows))  # no row of these two has a gap
        looked_at += (np.diff(over[int(first) - 1 : int(last) + 2].astype(int), axis=1, prepend=0) == 1).sum()
    assert work["mask_pixels"] == squares
    assert work["mask_rows"] == rows_of_squares
    assert work["marked_pixels"] == marked
    assert work["mask_runs"] == looked_at
    assert work["clusters"] == 2
    assert work["cluster_pixels"] == over.sum() == spots.pixels.sum()
    assert work["runs"] == (np.diff(over.astype(int), axis=1, prepend=0) == 1).sum()
    assert work["centroid_stars"] == 4  # two passes each
    assert work["centroid_pixels"] == 2 * (5 * 5 + 6 * 6)  # a 5 px window touches 6 px off the grid
    assert work["spots_judged"] == 2
    for refused, judged in ((parameters(magnitude_limit=-20.0), 2), (parameters(min_pixels=500), 0)):
        kept, other = detect(image, replace(refused, tau_min_dn=12.0))
        assert (len(kept), other["spots_judged"]) == (0, judged)
    assert work["spots_sorted"] == 2
    assert set(work.counts) <= set(COUNTS)
    again, same = detect(image, parameters(tau_min_dn=12.0))
    assert same == work
    assert (again.x_px == spots.x_px).all()


@settings(max_examples=150, deadline=None)
@given(
    arrays(
        np.uint16,
        st.tuples(st.integers(1, 40), st.integers(2, 40)),
        elements=st.sampled_from([0, 1, 5, 100, 101, 4095, 65535]) | st.integers(0, 65535),
    ),
    st.floats(0.1, 10),
    st.integers(1, 7),
    st.integers(1, 5),
)
def test_any_image_gives_finite_spots(
    image: NDArray[np.uint16], sigma_factor: float, half_window: int, min_pixels: int
) -> None:
    chosen = parameters(
        sigma_factor=sigma_factor,
        centroid_half_window_px=half_window,
        min_pixels=min_pixels,
        magnitude_limit=50.0,
    )
    spots, work = detect(image, chosen)
    rows, columns = image.shape
    for values in (spots.x_px, spots.y_px, spots.flux_dn, spots.magnitude, spots.peak_dn):
        assert np.isfinite(values).all()
    assert ((spots.x_px >= -0.5) & (spots.x_px <= columns - 0.5)).all()
    assert ((spots.y_px >= -0.5) & (spots.y_px <= rows - 0.5)).all()
    assert (spots.flux_dn > 0).all()
    assert (spots.pixels >= min_pixels).all()
    assert len(spots) + spots.rejected.total == work["clusters"]


@pytest.mark.parametrize("level", [0, 123, 65535])
def test_a_constant_image_has_no_spots(level: int) -> None:
    spots, _ = detect(np.full((50, 60), level, np.uint16), parameters())
    assert len(spots) == 0
    assert (spots.background_dn, spots.noise_dn) == (level, 0.0)
    assert spots.rejected.total == 0


def test_other_arrays_are_refused() -> None:
    for bad in (np.zeros((5, 5)), np.zeros(5, np.uint16), np.zeros((5, 1), np.uint16)):
        with pytest.raises(ValueError, match="uint16"):
            detect(bad, parameters())  # type: ignore[arg-type]


def test_a_view_of_an_image_gives_the_same(render_stars: Render) -> None:
    image = np.rint(100 + render_stars((80, 90), [(30.2, 29.7, 54000)]) / 8).astype(np.uint16)
    spots, _ = detect(np.ascontiguousarray(image[:, ::-1])[:, ::-1], parameters())
    assert (spots.x_px[0], spots.y_px[0]) == pytest.approx((30.2, 29.7), abs=0.01)


@pytest.mark.parametrize(
    "bad",
    ["sigma_factor", "tau_min_dn", "min_pixels", "centroid_half_window_px", "exposure_s", "max_runs"],
)
def test_parameters_must_be_positive(bad: str) -> None:
    with pytest.raises(ValueError, match=bad):
        parameters(**{bad: 0})


def test_ideal_spots_are_sorted_and_selectable() -> None:
    spots = Spots.at(np.array([1.0, 2.0, 3.0]), np.zeros(3), np.array([5.0, 2.0, 4.0]), zero_point_dn=1e5)
    assert spots.x_px.tolist() == [2.0, 3.0, 1.0]
    assert spots.flux_dn == pytest.approx(1e5 * 10 ** (-0.4 * np.array([2.0, 4.0, 5.0])))
    assert spots.brightest(2).x_px.tolist() == [2.0, 3.0]
    assert spots.take(spots.magnitude > 3).x_px.tolist() == [3.0, 1.0]
    assert len(Spots.empty(7.0)) == 0
    assert Spots.empty(7.0).background_dn == 7.0


REAL_SKY = Path(__file__).parents[2].parent / "shared" / "data" / "real_sky"


@pytest.mark.skipif(not REAL_SKY.is_dir(), reason="the recorded frames are not beside the checkout")
def test_real_frames() -> None:
    """Places of the stars of Hp < 6.4 in the three frames, from the frames' published attitudes.

    Hipparcos stars, pinhole of 15.73 arcsec/px; frames of 8-bit colour, half of them clipped at 0, with
    interpolated hot pixels: the spots that are no stars must stay few.
    """
    from PIL import Image

    stars = {
        "img2.png": [(598.3, 275.2), (564.6, 354.3), (1008.5, 172.2), (219.7, 164.5)],
        "img3.png": [(1086.8, 211.9), (895.3, 667.4), (253.6, 27.9), (304.3, 976.0),
                     (1173.1, 471.5), (88.3, 236.1)],
        "img4.png": [(1267.5, 773.0), (894.5, 536.2), (1292.1, 838.2), (1244.9, 390.6)],
    }  # fmt: skip
    chosen = DetectionParameters(
        sigma_factor=6.0,
        min_pixels=2,
        centroid_half_window_px=1,
        zero_point_dn_per_s=10 ** (0.4 * 13.05) / 0.05,
        exposure_s=0.05,
        magnitude_limit=7.4,
        saturation_dn=765,
    )
    for name, places in stars.items():
        with Image.open(REAL_SKY / name) as file:
            image = np.asarray(file)[..., :3].sum(axis=2, dtype=np.uint16)
        spots, _ = detect(image, chosen)
        assert 8 <= len(spots) <= 16
        for x, y in places:
            assert np.hypot(spots.x_px - x, spots.y_px - y).min() < 1.0
