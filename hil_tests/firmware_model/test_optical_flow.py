"""Optical flow of stars against a plain search over every shift, and against images made here."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import ndimage

from st_emulator.firmware_model.image.optical_flow import FlowParameters, flow_between, light_up

OFFSET_DN, NOISE_DN = 40.0, 2.0


def streak(
    image: np.ndarray, x: float, y: float, dx: float, dy: float, light: float, sigma: float = 0.8
) -> None:
    """Adds a star that moves from (x, y) - d / 2 to (x, y) + d / 2: erf over pixels, every 0.02 px."""
    steps = max(1, math.ceil(math.hypot(dx, dy) / 0.02))
    rows, columns = image.shape
    for part in (np.arange(steps) + 0.5) / steps - 0.5:
        px, py = x + part * dx, y + part * dy
        c0, c1 = max(math.floor(px) - 5, 0), min(math.floor(px) + 7, columns)
        r0, r1 = max(math.floor(py) - 5, 0), min(math.floor(py) + 7, rows)
        edges_x = [math.erf((c - 0.5 - px) / sigma / math.sqrt(2)) for c in range(c0, c1 + 1)]
        edges_y = [math.erf((r - 0.5 - py) / sigma / math.sqrt(2)) for r in range(r0, r1 + 1)]
        image[r0:r1, c0:c1] += light / steps * np.outer(np.diff(edges_y), np.diff(edges_x)) / 4


def digitised(light: np.ndarray, seed: int) -> np.ndarray:
    noisy = light + OFFSET_DN + np.random.default_rng(seed).normal(0, NOISE_DN, light.shape)
    return np.clip(np.rint(noisy), 0, 1023).astype(np.uint16)


def pair(
    stars: list[tuple[float, float, float]], shift: tuple[float, float], share: float, size: int = 160
) -> tuple[np.ndarray, np.ndarray]:
    """Two images of the same stars (x, y, light); share: of its shift each star's streak is long."""
    images = []
    for number in range(2):
        light = np.zeros((size, size))
        for x, y, amount in stars:
            streak(
                light,
                x + number * shift[0],
                y + number * shift[1],
                share * shift[0],
                share * shift[1],
                amount,
            )
        images.append(digitised(light, 7 + number))
    return images[0], images[1]


STARS = [(40.3, 50.6, 900.0), (100.7, 45.2, 1500.0), (70.5, 100.4, 1200.0), (118.2, 110.9, 4000.0)]


def level_dn(image: np.ndarray) -> float:
    """The image's mean, rounded down to 1/16 DN as FlowFrame says."""
    return math.floor(16 * image.mean()) / 16


def test_the_threshold_is_mean_and_three_sigma_of_the_whole_image() -> None:
    image, _ = pair(STARS, (0.0, 0.0), 0.0)
    frame, work = light_up(image, FlowParameters())
    assert frame.mean_dn == pytest.approx(image.mean(), rel=1e-12)
    assert frame.sigma_dn == pytest.approx(image.std(), rel=1e-9)
    lit = image > image.mean() + 3 * image.std()
    assert len(frame.values) == lit.sum() == work["lit_pixels"]
    np.testing.assert_array_equal(frame.values / 16, image[lit] - level_dn(image))
    assert work["flow_pixels"] == image.size
    label, count = ndimage.label(lit, np.ones((3, 3)))
    sizes = ndimage.sum_labels(lit, label, range(1, count + 1))
    assert len(frame) == (sizes >= 3).sum()
    wanted = ndimage.center_of_mass(np.where(lit, image - level_dn(image), 0), label, range(1, count + 1))
    wanted = [place for place, size in zip(wanted, sizes, strict=True) if size >= 3]
    found = sorted(zip(frame.y_px, frame.x_px, strict=True))
    np.testing.assert_allclose(found, sorted(wanted), atol=1e-9)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (3.4, -2.7), (-11.3, 7.8), (0.4, 17.6)])
@pytest.mark.parametrize("share", [0.0, 0.8])
def test_stars_are_found_where_they_are(shift: tuple[float, float], share: float) -> None:
    first, second = pair(STARS, shift, share)
    before, _ = light_up(first, FlowParameters())
    after, _ = light_up(second, FlowParameters())
    for foreseen in (None, np.tile(np.array(shift) + np.array([3.0, -4.0]), (len(before), 1))):
        flow, _ = flow_between(before, after, FlowParameters(largest_shift_px=24), foreseen)
        assert len(flow) == len(STARS)
        np.testing.assert_allclose(flow.x_px - flow.x_before_px, shift[0], atol=0.45)
        np.testing.assert_allclose(flow.y_px - flow.y_before_px, shift[1], atol=0.45)


def test_the_coarse_shift_is_that_of_the_least_squared_differences() -> None:
    """Against the sum written out, over every shift, of the thresholded images."""
    first, second = pair(STARS, (5.3, -6.2), 0.8)
    parameters = FlowParameters(centrings=1, largest_shift_px=10)
    before, _ = light_up(first, parameters)
    after, _ = light_up(second, parameters)
    flow, _ = flow_between(before, after, parameters)

    def lit(image: np.ndarray) -> np.ndarray:
        return np.where(image > image.mean() + 3 * image.std(), image - level_dn(image), 0.0)

    one, two = lit(first), lit(second)
    for star, x, y, mismatch in zip(flow.star, flow.x_px, flow.y_px, flow.mismatch, strict=True):
        x0, x1, y0, y1 = before.box[star]
        own = one[y0 : y1 + 1, x0 : x1 + 1]
        sums = {
            (dx, dy): ((own - two[y0 + dy : y1 + 1 + dy, x0 + dx : x1 + 1 + dx]) ** 2).sum()
            for dx in range(-10, 11)
            for dy in range(-10, 11)
        }
        dx, dy = min(sums, key=sums.__getitem__)
        assert mismatch == pytest.approx(sums[dx, dy] / (own**2).sum(), rel=1e-6)
        window = two[y0 + dy - 2 : y1 + dy + 3, x0 + dx - 2 : x1 + dx + 3]  # F: the star's and 2 px
        rows, columns = np.indices(window.shape)
        assert x == pytest.approx((window * columns).sum() / window.sum() + x0 + dx - 2, abs=1e-6)
        assert y == pytest.approx((window * rows).sum() / window.sum() + y0 + dy - 2, abs=1e-6)


def test_a_star_that_leaves_the_image_is_left_out() -> None:
    first, second = pair([*STARS, (150.0, 80.0, 3000.0)], (12.0, 0.0), 0.0)
    before, _ = light_up(first, FlowParameters())
    after, _ = light_up(second, FlowParameters())
    flow, _ = flow_between(before, after, FlowParameters(largest_shift_px=20))  # no other star is so near
    assert len(before) == 5
    assert len(flow) == 4


def test_an_empty_sky_flows_nowhere() -> None:
    image = digitised(np.zeros((64, 64)), 1)
    parameters = FlowParameters(sigma_factor=6.0)
    frame, _ = light_up(image, parameters)
    flow, _ = flow_between(frame, frame, parameters)
    assert len(frame) == len(flow) == 0


def test_an_image_that_is_all_lit_overflows_and_has_no_stars() -> None:
    image = np.zeros((64, 64), np.uint16)
    image[::2, ::7] = 1000
    frame, _ = light_up(image, FlowParameters(sigma_factor=0.5, max_runs=50))
    assert frame.overflowed
    assert len(frame) == 0


def test_errors_grow_along_a_streak_that_is_seen_in_part() -> None:
    first, second = pair(STARS, (0.4, 17.6), 0.8)
    before, _ = light_up(first, FlowParameters())
    after, _ = light_up(second, FlowParameters())
    flow, _ = flow_between(before, after, FlowParameters())
    along, across = flow.errors_px(np.full(len(flow), 60.0), 0.1)
    assert (along > 10 * across).all()
    along, _ = flow.errors_px(np.zeros(len(flow)), 0.1)
    assert (along < 1).all()


def test_what_is_no_image_or_no_pair_is_refused() -> None:
    with pytest.raises(ValueError, match="uint16"):
        light_up(np.zeros((4, 4)), FlowParameters())
    one, _ = light_up(np.zeros((16, 16), np.uint16), FlowParameters())
    two, _ = light_up(np.zeros((16, 18), np.uint16), FlowParameters())
    with pytest.raises(ValueError, match="same size"):
        flow_between(one, two, FlowParameters())
    with pytest.raises(ValueError, match="min_pixels must be positive"):
        FlowParameters(min_pixels=0)
