"""Halves of an attitude are joined when they are of one frame of the camera, and never otherwise."""

from __future__ import annotations

from collections import Counter
from itertools import accumulate
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from st_emulator.obc.cyclic import AttitudeJoiner

MS = 1_000_000
NAMES = ("attitude_1", "attitude_2", "status", "mid_exposure_time")
LONGEST_DELAY_MS = 400


def values_of(name: str, index: int) -> dict[str, Any]:
    """What a part of frame `index` says: its index in every value."""
    part = index / 4096
    return {"counter": index % 256} | {
        "attitude_1": {"q_x": part, "q_y": -part},
        "attitude_2": {"q_z": part, "q_w": -part},
        "status": {"valid": 1, "reasons": index % 8},
        "mid_exposure_time": {"seconds": index, "fraction": 0.0},
    }[name]


arrivals = st.lists(
    st.tuples(
        # The step to this frame: mostly the next one, often one whose counter is the same or nearly.
        st.sampled_from([1, 1, 1, 1, 2, 255, 256, 257, 512]),
        # When each part comes, and again; None: it is lost.
        st.tuples(*[st.none() | st.integers(0, LONGEST_DELAY_MS)] * len(NAMES)),
        st.tuples(*[st.none() | st.integers(0, LONGEST_DELAY_MS)] * len(NAMES)),
    ),
    max_size=30,
)


@given(frames=arrivals, period_ms=st.sampled_from([10, 100, 250]))
@settings(max_examples=500, deadline=None)
def test_losses_and_another_order_never_mix_two_frames(frames: list[Any], period_ms: int) -> None:
    indices = list(accumulate(step for step, _, _ in frames))
    stream = [
        (index * period_ms + delay_ms, index, name)
        for index, (_, *times) in zip(indices, frames, strict=True)
        for delays in times
        for name, delay_ms in zip(NAMES, delays, strict=True)
        if delay_ms is not None
    ]
    joiner = AttitudeJoiner()
    for time_ms, index, name in sorted(stream, key=lambda entry: entry[0]):
        joiner.take(name, values_of(name, index), time_ms * MS)
    came = Counter()
    for attitude in joiner.attitudes():
        index = round(attitude.q_icrs_to_sensor[0] * 4096)
        assert attitude.q_icrs_to_sensor.tolist() == [part * index / 4096 for part in (1, -1, 1, -1)]
        assert attitude.counter == index % 256
        assert attitude.status is None or attitude.reasons == index % 8
        assert attitude.time is None or attitude.time.coarse == index
        came[index] += 1
    parts = {(index, name) for _, index, name in stream}
    assert came == Counter(i for i in indices if (i, "attitude_1") in parts and (i, "attitude_2") in parts)


def test_the_same_counter_later_is_another_frame() -> None:
    joiner = AttitudeJoiner()
    joiner.take("attitude_1", values_of("attitude_1", 3), 0)
    joiner.take("attitude_2", values_of("attitude_2", 3 + 256), 2_560 * MS)
    assert joiner.attitudes() == []
    joiner.take("attitude_1", values_of("attitude_1", 3 + 256), 2_561 * MS)
    (attitude,) = joiner.attitudes()
    assert attitude.q_icrs_to_sensor[0] == 259 / 4096
    assert attitude.received_ns == 2_561 * MS


def test_what_the_unit_says_of_an_attitude_may_come_after_it() -> None:
    joiner = AttitudeJoiner()
    joiner.take("attitude_2", values_of("attitude_2", 3), 0)
    joiner.take("attitude_1", values_of("attitude_1", 3), 1)
    (attitude,) = joiner.attitudes()
    assert (attitude.valid, attitude.reasons, attitude.time) == (None, None, None)
    joiner.take("status", values_of("status", 3), 2)
    (attitude,) = joiner.attitudes()
    assert attitude.valid is True


def test_another_value_of_a_part_that_came_is_of_another_frame() -> None:
    """As after a start of the unit that nothing told of."""
    joiner = AttitudeJoiner()
    for name, index in (("attitude_1", 3), ("attitude_1", 259), ("attitude_2", 259), ("attitude_1", 515)):
        joiner.take(name, values_of(name, index), 0)
    (attitude,) = joiner.attitudes()
    assert attitude.q_icrs_to_sensor.tolist() == [part * 259 / 4096 for part in (1, -1, 1, -1)]
