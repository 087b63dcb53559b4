"""Optical flow: the match of a star's picture in the next frame."""

from __future__ import annotations

import numpy as np
import pytest

from st_emulator.firmware_model.image.optical_flow import FlowParameters, flow_between, light_up

PARAMETERS = FlowParameters(largest_shift_px=12)


def image(*places: tuple[int, int], dn: int = 83) -> np.ndarray:
    """Stars alike to the bit, on a level that is no whole number in the mean."""
    found = np.full((90, 130), 30, np.uint16)
    found[::7, ::3] += 1
    for x, y in places:
        found[y - 1 : y + 2, x - 1 : x + 2] = dn + np.outer([1, 3, 2], [2, 3, 1]) * 17
    return found


@pytest.mark.parametrize("dn", range(61, 97, 5))
def test_a_picture_that_is_the_same_to_the_bit_is_found(dn: int) -> None:
    """Its mismatch is 0, and was below it by the rounding of three sums that were not whole numbers."""
    places = ((30, 40), (80, 60), (100, 20))
    before, _ = light_up(image(*places, dn=dn), PARAMETERS)
    after, _ = light_up(image(*((x + 5, y - 4) for x, y in places), dn=dn), PARAMETERS)
    flow, _ = flow_between(before, after, PARAMETERS)
    assert sorted(flow.star.tolist()) == [0, 1, 2]
    assert flow.mismatch.tolist() == [0.0, 0.0, 0.0]
    assert flow.x_px - flow.x_before_px == pytest.approx([5.0] * 3, abs=1e-12)
    assert flow.y_px - flow.y_before_px == pytest.approx([-4.0] * 3, abs=1e-12)


def test_a_star_that_went_is_not_found() -> None:
    before, _ = light_up(image((30, 40), (80, 60)), PARAMETERS)
    after, _ = light_up(image((32, 41)), PARAMETERS)
    flow, work = flow_between(before, after, PARAMETERS)
    assert flow.x_before_px.tolist() == [pytest.approx(30, abs=0.5)]
    assert work["stars_followed"] == 2


def test_work_grows_with_the_search_and_with_what_is_lit() -> None:
    one, _ = light_up(image((30, 40)), PARAMETERS)
    two, _ = light_up(image((30, 40), (80, 60)), PARAMETERS)
    _, small = flow_between(one, one, PARAMETERS, np.zeros((1, 2)))
    _, large = flow_between(one, one, PARAMETERS)
    _, both = flow_between(two, two, PARAMETERS)
    assert small["flow_rows"] < large["flow_rows"]
    assert small["pixels_matched"] == large["pixels_matched"] == 81  # all nine with all nine
    assert (large["lines_matched"], large["shift_rows"], large["shifts_compared"]) == (27, 5, 25)
    assert both["pixels_matched"] == 2 * large["pixels_matched"]
