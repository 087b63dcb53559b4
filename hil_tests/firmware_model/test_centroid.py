"""Centre of mass: against a plain version, and its errors on simulated stars."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from st_emulator.firmware_model.image.detection import DetectionParameters, detect
from st_emulator.firmware_model.image.spots import Spots

Render = Callable[..., NDArray[np.float64]]
ZERO_POINT = 675.0 * 10 ** (0.4 * 6)  # 5400 electrons of 8 electrons/DN for magnitude 6


def parameters(**changes: Any) -> DetectionParameters:
    settings: dict[str, Any] = {"zero_point_dn_per_s": ZERO_POINT, "exposure_s": 1.0}
    return DetectionParameters(**{**settings, **changes})


def measured(signal_dn: NDArray[np.float64], background_dn: int = 1000, **changes: Any) -> Spots:
    """Spots of a noise-free image."""
    image = np.rint(signal_dn + background_dn).astype(np.uint16)
    return detect(image, parameters(**{"tau_min_dn": 20.0, **changes}))[0]


def plain_centroid(
    signal: NDArray[np.float64], x: float, y: float, half_width: float
) -> tuple[float, float, float]:
    """Eqs. (1)-(3) of paper Z in a window of fractional pixels, twice re-centred; the background is zero."""
    flux = 0.0
    for _ in range(2):
        columns, rows = np.arange(signal.shape[1]), np.arange(signal.shape[0])
        low, high = np.maximum(columns - 0.5, x - half_width), np.minimum(columns + 0.5, x + half_width)
        wx = np.clip(high - low, 0, None)
        low, high = np.maximum(rows - 0.5, y - half_width), np.minimum(rows + 0.5, y + half_width)
        wy = np.clip(high - low, 0, None)
        weighted = signal * wy[:, None] * wx[None, :]
        flux = weighted.sum()
        x, y = (weighted.sum(0) @ columns) / flux, (weighted.sum(1) @ rows) / flux
    return x, y, flux


@settings(max_examples=120, deadline=None)
@given(
    st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0.6, 0.9), st.integers(2, 4), st.integers(400, 1500)
)
def test_centroid_equals_the_plain_version(
    render_stars: Render, dx: float, dy: float, sigma: float, half_window: int, flux: int
) -> None:
    signal = np.rint(render_stars((41, 41), [(20 + dx, 20 + dy, flux)], sigma_px=sigma))
    spots = measured(signal, centroid_half_window_px=half_window)
    assert len(spots) == 1
    over = np.where(signal > 20, signal, 0)
    start_x = (over.sum(0) @ np.arange(41)) / over.sum()
    start_y = (over.sum(1) @ np.arange(41)) / over.sum()
    rows, columns = np.nonzero(over)
    # the window grows with the cluster: half a pixel round its box, seen from the centre
    reach_x = max(columns.max() + 1 - start_x, start_x - columns.min() + 1)
    reach_y = max(rows.max() + 1 - start_y, start_y - rows.min() + 1)
    if max(reach_x, reach_y) > half_window + 0.45:
        return  # the plain version knows the fixed window only
    if np.any(np.abs(signal - 20.5) < 3):
        return  # the moving average, with a little of the star in it, decides about a pixel at the threshold
    x, y, total = plain_centroid(signal, start_x, start_y, half_window + 0.5)
    # the start differs by what the moving average takes in of the star; two passes leave nothing of that
    assert (spots.x_px[0], spots.y_px[0]) == pytest.approx((x, y), abs=1e-5)
    assert spots.flux_dn[0] == pytest.approx(total, rel=1e-5)
    assert spots.peak_dn[0] == signal.max()
    assert spots.pixels[0] == len(rows)
    assert spots.magnitude[0] == pytest.approx(-2.5 * np.log10(total / ZERO_POINT))


@pytest.mark.parametrize("sigma", [0.7, 0.75, 0.8])
def test_pixel_phase_error_is_below_a_two_hundredth_pixel(render_stars: Render, sigma: float) -> None:
    worst = 0.0
    for phase in np.linspace(-0.5, 0.5, 21):
        x, y = 20 + phase, 20 + 0.37 - phase
        spots = measured(render_stars((41, 41), [(x, y, 20000)], sigma_px=sigma), tau_min_dn=350.0)
        worst = max(worst, abs(spots.x_px[0] - x), abs(spots.y_px[0] - y))
    assert worst < 0.005


def test_noise_of_the_centroid(render_stars: Render, expose: Callable[..., NDArray[np.uint16]]) -> None:
    """5400 electrons over 19 electrons r.m.s.: at most 0.04 px, 1 sigma, on each axis."""
    rng = np.random.default_rng(42)
    places = [(x + rng.uniform(-0.5, 0.5), y + rng.uniform(-0.5, 0.5)) for y in range(20, 470, 20)
              for x in range(20, 740, 20)]  # fmt: skip
    image = expose(render_stars((480, 752), [(x, y, 5400) for x, y in places]), rng)
    spots, _ = detect(image, parameters())
    true = np.array(places)
    distance = np.hypot(spots.x_px[:, None] - true[:, 0], spots.y_px[:, None] - true[:, 1])
    assert len(spots) == len(true)
    assert distance.min(axis=0).max() < 0.2
    nearest = distance.argmin(axis=1)
    error_x, error_y = spots.x_px - true[nearest, 0], spots.y_px - true[nearest, 1]
    assert 0.02 < np.sqrt(np.mean(error_x**2)) < 0.033
    assert 0.02 < np.sqrt(np.mean(error_y**2)) < 0.033
    assert abs(error_x.mean()) < 0.004
    assert abs(error_y.mean()) < 0.004
    assert spots.magnitude.mean() == pytest.approx(6.0, abs=0.015)
    assert spots.magnitude.std() < 0.04


def test_the_background_is_local(render_stars: Render) -> None:
    """On a slope of the background, steep against the stars' light, place and flux nearly stay."""
    places = [(50.3, 60.2), (150.3, 140.2), (250.1, 190.0)]
    signal = render_stars((220, 300), [(x, y, 2000) for x, y in places])
    signal += np.arange(220)[:, None] * 0.5 + np.arange(300)[None, :] * 0.05
    spots = measured(signal)
    found = spots.take(np.argsort(spots.x_px))
    assert found.x_px == pytest.approx([x for x, _ in places], abs=0.01)
    assert found.y_px == pytest.approx([y for _, y in places], abs=0.04)
    assert found.flux_dn == pytest.approx(np.full(3, 2000), rel=0.01)


@pytest.mark.parametrize("separation", [6.0, 7.0, 8.0])
def test_a_neighbour_does_not_pull(render_stars: Render, separation: float) -> None:
    signal = render_stars((60, 60), [(25.2, 30.4, 700), (25.2 + separation, 30.4, 7000)])
    spots = measured(signal)
    assert len(spots) == 2
    assert spots.x_px == pytest.approx([25.2 + separation, 25.2], abs=0.02)
    assert spots.y_px == pytest.approx([30.4, 30.4], abs=0.02)


def test_a_hot_pixel_beside_a_star_does_not_pull(render_stars: Render) -> None:
    signal = render_stars((60, 60), [(25.2, 30.4, 700)])
    alone = measured(signal)
    signal[34, 25] += 500  # 3.6 px away: outside of the star's cluster
    spots = measured(signal)
    assert len(spots) == 1
    assert spots.rejected.small == 1
    assert (spots.x_px[0], spots.y_px[0]) == pytest.approx((alone.x_px[0], alone.y_px[0]), abs=0.005)


def test_the_window_grows_with_a_saturated_star(render_stars: Render) -> None:
    for x, y in [(30.0, 30.0), (30.4, 29.7), (30.5, 30.5)]:
        signal = np.minimum(render_stars((61, 61), [(x, y, 400_000)], sigma_px=1.2), 3000)
        spots = measured(signal, background_dn=100, saturation_dn=3100)
        assert len(spots) == 1
        assert spots.saturated[0]
        assert spots.pixels[0] > 49
        assert (spots.x_px[0], spots.y_px[0]) == pytest.approx((x, y), abs=0.03)
        assert spots.flux_dn[0] == pytest.approx(signal.sum(), rel=0.01)


@pytest.mark.parametrize("streak", [(15.0, 0.0), (0.0, 15.0), (11.0, -11.0), (4.0, 14.0)])
def test_streaks_are_measured_whole(render_stars: Render, streak: tuple[float, float]) -> None:
    signal = render_stars((80, 80), [(40.3, 39.6, 8000)], streak_px=streak)
    spots = measured(signal)
    assert len(spots) == 1
    assert (spots.x_px[0], spots.y_px[0]) == pytest.approx((40.3, 39.6), abs=0.03)
    assert spots.flux_dn[0] == pytest.approx(8000, rel=0.03)


def test_at_the_edge_a_spot_is_right_or_rejected(render_stars: Render) -> None:
    narrowed = 0
    for x in np.arange(-1.0, 6.0, 0.1):
        spots = measured(render_stars((40, 40), [(x, 20.0, 3000)]), tau_min_dn=60.0)
        assert len(spots) + spots.rejected.edge <= 1
        if len(spots):
            assert abs(spots.x_px[0] - x) < 0.015
            assert spots.at_edge[0] == (spots.x_px[0] < 2.0)
            narrowed += int(spots.at_edge[0])
        assert len(spots) == (x > 1.4) or 1.4 < x < 2.4
    assert narrowed > 0


@pytest.mark.parametrize("corner", [(0, 0), (39, 0), (0, 39), (39, 39)])
def test_a_star_in_the_corner_is_rejected(render_stars: Render, corner: tuple[int, int]) -> None:
    spots = measured(render_stars((40, 40), [(*corner, 5000)]))
    assert len(spots) == 0
    assert spots.rejected.edge == 1
