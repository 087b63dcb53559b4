"""Detection in windows against a plain version, and on simulated stars."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy import ndimage

from st_emulator.firmware_model.image.detection import DetectionParameters
from st_emulator.firmware_model.image.frame import rectangles
from st_emulator.firmware_model.image.spots import WindowSpots, WindowStatus
from st_emulator.firmware_model.image.windows import detect_in_windows, smoothed_runs
from st_emulator.firmware_model.work import Work

Render = Callable[..., NDArray[np.float64]]
Expose = Callable[..., NDArray[np.uint16]]
ZERO_POINT = 675.0 * 10 ** (0.4 * 6)


def cut(image: NDArray[np.uint16], rects: NDArray[np.int32]) -> tuple[NDArray[np.uint16], NDArray[np.int64]]:
    parts = [image[y0:y1, x0:x1].ravel() for x0, y0, x1, y1 in rects]
    offsets = np.concatenate([[0], np.cumsum([len(p) for p in parts], dtype=np.int64)]).astype(np.int64)
    return np.concatenate([np.zeros(0, np.uint16), *parts]), offsets


def search(
    image: NDArray[np.uint16],
    rects: Any,
    *,
    keep: Any = 1,
    expected_flux_dn: NDArray[np.float64] | None = None,
    **changes: Any,
) -> tuple[WindowSpots, Work]:
    rects = np.asarray(rects, np.int32).reshape(-1, 4)
    settings: dict[str, Any] = {"zero_point_dn_per_s": ZERO_POINT, "exposure_s": 1.0, "magnitude_limit": 9.0}
    flat, offsets = cut(image, rects)
    return detect_in_windows(
        flat,
        offsets,
        rects,
        DetectionParameters(**{**settings, **changes}),
        width_px=image.shape[1],
        height_px=image.shape[0],
        keep=keep,
        expected_flux_dn=expected_flux_dn,
    )


def sky(
    render_stars: Render, expose: Expose, stars: Any, seed: int = 1, **options: Any
) -> NDArray[np.uint16]:
    return expose(render_stars((200, 300), stars, **options), np.random.default_rng(seed))


@settings(max_examples=100, deadline=None)
@given(
    arrays(np.uint16, st.tuples(st.integers(2, 20), st.integers(2, 20)), elements=st.integers(0, 300)),
    st.integers(0, 2700),
)
def test_smoothed_runs_equal_scipy(window: NDArray[np.uint16], limit: int) -> None:
    runs, row_start = np.zeros((500, 3), np.int32), np.zeros(window.shape[0] + 1, np.int32)
    count = smoothed_runs(window, limit, runs, row_start, np.zeros(20, np.int32))
    mask = np.zeros(window.shape, np.bool_)
    for row, first, end in runs[:count]:
        mask[row, first:end] = True
    sums = ndimage.convolve(window.astype(int), np.ones((3, 3), int), mode="mirror")
    assert (mask == (sums > limit)).all()
    assert (np.diff(row_start) == [(np.diff(line.astype(int), prepend=0) == 1).sum() for line in mask]).all()


def test_stars_are_found_where_they_are(render_stars: Render, expose: Expose) -> None:
    """One window a star, the star anywhere inside: at most 0.04 px of error, 1 sigma, at 5400 electrons."""
    rng = np.random.default_rng(21)
    error_x, error_y = [], []
    for trial in range(20):
        stars = [(x + rng.uniform(-0.5, 0.5), y + rng.uniform(-0.5, 0.5), 5400.0) for y in (30, 90, 150)
                 for x in (30, 90, 150, 210, 270)]  # fmt: skip
        image = sky(render_stars, expose, stars, trial)
        true = np.array(stars)
        rects, whole = rectangles(*(true[:, :2] + rng.uniform(-8, 8, (15, 2))).T, 13.2, 300, 200)
        assert whole.all()
        assert (rects[:, 2] - rects[:, 0] == 29).all()
        found, _ = search(image, rects)
        assert (found.status == WindowStatus.FOUND).all()
        assert (found.window == np.arange(15)).all()
        error_x += list(found.spots.x_px - true[:, 0])
        error_y += list(found.spots.y_px - true[:, 1])
        assert found.background_dn == pytest.approx(np.full(15, 100.0), abs=1.0)
        assert found.noise_dn.mean() == pytest.approx(2.4, abs=0.15)
        assert found.spots.magnitude == pytest.approx(np.full(15, 6.0), abs=0.15)
    assert 0.02 < np.sqrt(np.mean(np.square(error_x))) < 0.033
    assert 0.02 < np.sqrt(np.mean(np.square(error_y))) < 0.033


def test_a_window_does_not_depend_on_the_others(render_stars: Render, expose: Expose) -> None:
    image = sky(render_stars, expose, [(50.2, 50.7, 5400), (150.1, 80.3, 9000), (60.4, 150.2, 3000)])
    rects = np.array([[40, 40, 63, 61], [140, 70, 161, 91], [100, 100, 130, 121], [50, 140, 75, 161]])
    together, work = search(image, rects)
    assert together.status.tolist() == [1, 1, 0, 1]
    assert together.window.tolist() == [0, 1, 3]
    parts = [search(image, rect) for rect in rects]
    assert np.concatenate([p.spots.x_px for p, _ in parts]).tolist() == together.spots.x_px.tolist()
    assert np.concatenate([p.spots.flux_dn for p, _ in parts]).tolist() == together.spots.flux_dn.tolist()
    total = Work()
    for _, each in parts:
        total += each
    apart = {"spots_sorted", "clusterings", "measurings", "first_centroids"}  # n log n; once a frame
    assert {k: v for k, v in work.counts.items() if k not in apart} == {
        k: v for k, v in total.counts.items() if k not in apart
    }
    for once in ("clusterings", "measurings", "first_centroids"):
        assert (work[once], total[once]) == (1, 3)
    assert work["windows"] == 4
    assert work["window_pixels"] == sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in rects)
    # every 2nd, 2nd, 4th (30 columns are divisible by 3) and 3rd pixel of 483, 441, 630 and 525
    assert work["window_samples"] == 242 + 221 + 158 + 175
    passes = work["window_noise_pixels"] / work["window_pixels"]
    assert 1 <= passes <= 12


@pytest.mark.parametrize(("width", "large"), [(128, False), (129, True)])
def test_of_a_window_larger_than_the_cache_nothing_is_left_there(
    render_stars: Render, expose: Expose, width: int, large: bool
) -> None:
    image = sky(render_stars, expose, [(50.2, 50.7, 5400), (110.1, 80.3, 9000)])
    found, work = search(image, [[10, 20, 10 + width, 148]], keep=2)
    assert len(found) == 2
    assert work["reread_pixels"] == (work["window_noise_pixels"] if large else 0)
    assert work["cold_runs"] == (work["runs"] if large else 0)


def test_the_brightest_or_the_expected_one(render_stars: Render, expose: Expose) -> None:
    image = sky(render_stars, expose, [(90.2, 90.7, 20000), (105.3, 99.6, 5400), (95.0, 112.0, 9000)])
    rect = [[75, 75, 125, 125]]
    assert search(image, rect)[0].spots.x_px == pytest.approx([90.2], abs=0.1)
    for flux, x in ((5000, 105.3), (9500, 95.0), (40000, 90.2), (np.nan, 90.2)):
        found, _ = search(image, rect, expected_flux_dn=np.array([flux / 8]))
        assert found.spots.x_px == pytest.approx([x], abs=0.1)
        assert found.spots.rejected.surplus == 2
    # a merged window gives as many as it is asked for, brightest first
    two, _ = search(image, rect, keep=np.array([2], np.int32))
    assert two.spots.x_px == pytest.approx([90.2, 95.0], abs=0.1)
    assert two.window.tolist() == [0, 0]
    assert len(search(image, rect, keep=5)[0]) == 3
    assert len(search(image, rect, keep=0)[0]) == 0


@pytest.mark.parametrize(("x", "y"), [(60.0, 80.0), (99.6, 80.0), (80.0, 60.3), (80.0, 99.0), (61.0, 98.7)])
def test_a_star_cut_by_the_window_is_rejected(
    render_stars: Render, expose: Expose, x: float, y: float
) -> None:
    image = sky(render_stars, expose, [(x, y, 9000)])
    found, _ = search(image, [[60, 60, 100, 100]])
    assert len(found) == 0
    assert found.status.tolist() == [WindowStatus.CLIPPED]
    assert found.spots.rejected.edge == 1


def test_a_star_cut_by_the_images_edge_is_no_fault_of_the_window(
    render_stars: Render, expose: Expose
) -> None:
    image = sky(render_stars, expose, [(0.3, 80.0, 9000), (299.5, 20.0, 9000)])
    found, _ = search(image, [[0, 60, 21, 100], [279, 0, 300, 40]])
    assert len(found) == 0
    assert found.status.tolist() == [WindowStatus.REJECTED, WindowStatus.REJECTED]


def test_close_to_a_side_a_spot_is_right_or_rejected(render_stars: Render) -> None:
    for x in np.arange(58.0, 68.0, 0.1):
        image = np.rint(100 + render_stars((200, 300), [(x, 80.0, 3000)])).astype(np.uint16)
        found, _ = search(image, [[60, 60, 100, 100]], tau_min_dn=20.0)
        if len(found):
            assert found.spots.x_px[0] == pytest.approx(x, abs=0.015)
        else:
            assert x < 63.5
    assert len(found) == 1


def test_faint_stars_and_hot_pixels(render_stars: Render, expose: Expose) -> None:
    faint = 5400 * 10 ** (-0.4 * 1.5)
    image = sky(render_stars, expose, [(50.2, 50.7, faint)])
    image[150, 150] = 3000
    rects = [[35, 35, 66, 66], [135, 135, 166, 166], [200, 30, 231, 61]]
    found, _ = search(image, rects, magnitude_limit=6.9)
    assert found.status.tolist() == [WindowStatus.FAINT, WindowStatus.REJECTED, WindowStatus.EMPTY]
    assert (found.spots.rejected.faint, found.spots.rejected.sharp) == (1, 1)
    magnitude = search(image, rects)[0].spots.magnitude[0]
    assert magnitude == pytest.approx(7.5, abs=0.5)
    # the margin for windows is 0.3 mag
    assert search(image, rects, magnitude_limit=magnitude - 0.29)[0].window.tolist() == [0]
    assert search(image, rects, magnitude_limit=magnitude - 0.31)[0].window.tolist() == []


@pytest.mark.parametrize("streak", [(12.0, 0.0), (0.0, 12.0), (8.5, 8.5), (-10.0, 6.0)])
def test_streaks_of_the_dimmest_stars(
    render_stars: Render, expose: Expose, streak: tuple[float, float]
) -> None:
    """0.5 deg/s in 0.2 s: the light of a star at the limit over 12 px, each pixel 4 to 5 sigma."""
    flux = 5400 * 10 ** (-0.4 * 0.9)
    stars = [(x + 0.3, y - 0.2, flux) for y in (50, 120) for x in (50, 120, 190, 250)]
    image = sky(render_stars, expose, stars, streak_px=streak)
    true = np.array(stars)
    rects, _ = rectangles(true[:, 0] + 7, true[:, 1] - 6, 26, 300, 200)
    found, _ = search(image, rects, magnitude_limit=6.9)
    assert (found.status == WindowStatus.FOUND).all()
    assert np.abs(found.spots.x_px - true[:, 0]).max() < 1.2
    assert np.sqrt(np.mean((found.spots.x_px - true[:, 0]) ** 2)) < 0.6
    assert np.sqrt(np.mean((found.spots.y_px - true[:, 1]) ** 2)) < 0.6


def test_noise_alone_gives_few_spots(expose: Expose) -> None:
    image = expose(np.zeros((1000, 1000)), np.random.default_rng(31))
    rects = [[x, y, x + 33, y + 33] for y in range(0, 960, 40) for x in range(0, 960, 40)]
    found, _ = search(image, rects, magnitude_limit=99.0)
    assert len(found) <= 12  # of 576 windows, at 4 sigma of the 3 x 3 sums
    assert len(search(image, rects, magnitude_limit=6.9)[0]) == 0


def test_no_windows_is_no_error() -> None:
    found, work = search(np.zeros((10, 10), np.uint16), np.zeros((0, 4), np.int32))
    assert len(found) == len(found.status) == 0
    assert work["windows"] == work["window_pixels"] == 0


@settings(max_examples=80, deadline=None)
@given(
    arrays(
        np.uint16,
        st.tuples(st.integers(1, 25), st.integers(1, 25)),
        elements=st.sampled_from([0, 100, 65535]) | st.integers(90, 110),
    ),
    st.integers(1, 7),
)
def test_any_window_gives_finite_spots(window: NDArray[np.uint16], half_window: int) -> None:
    rows, columns = window.shape
    found, _ = search(
        window, [[0, 0, columns, rows]], keep=10, magnitude_limit=50.0, centroid_half_window_px=half_window
    )
    assert np.isfinite(found.spots.x_px).all()
    assert np.isfinite(found.spots.magnitude).all()
    assert ((found.spots.x_px >= -0.5) & (found.spots.x_px <= columns - 0.5)).all()
    assert (found.status[0] == WindowStatus.FOUND) == (len(found) > 0)


def test_rectangles_are_clipped_and_tell() -> None:
    x, y = np.array([10.4, 2.0, 299.0, -50.0]), np.array([10.6, 100.0, 199.0, 50.0])
    rects, whole = rectangles(x, y, 4.2, 300, 200)
    assert rects.tolist()[0] == [5, 6, 16, 17]
    assert rects.tolist()[1] == [0, 95, 8, 106]
    assert rects.tolist()[2] == [294, 194, 300, 200]
    assert rects[3, 2] <= rects[3, 0]  # wholly outside: empty
    assert whole.tolist() == [True, False, False, False]
