"""Subscribed telemetry: rates, exact times, the budget of frames, beside requests."""

from __future__ import annotations

import itertools

import pytest

from hil_tests.dialects.sagitta import client
from hil_tests.dialects.sagitta.bench import MS, Bench, at_rest, line_ns, unit
from hil_tests.dialects.sagitta.client import POWER, REQUEST, SET, SOLUTION, SUBSCRIPTION, TEMPERATURE
from st_emulator.firmware_model.causes import FaultCause

PERIOD_NS = 250 * MS


def begun_ns(frame: client.Frame) -> int:
    return frame.t_ns - line_ns(frame.line_bytes)


def test_temperature_once_a_second_from_the_subscription_on() -> None:
    bench = at_rest()
    request = client.request(SET, SUBSCRIPTION, client.subscription(TEMPERATURE))
    taken_ns = bench.now_ns + line_ns(len(request)) + bench.latency_ns
    bench.put(request)
    bench.run(5100)
    frames = bench.subscribed(TEMPERATURE)
    assert [begun_ns(frame) for frame in frames] == [taken_ns + n * 1000 * MS for n in range(1, 6)]
    assert all(len(frame.body) == 32 and frame.status == 0 for frame in frames)


@pytest.mark.parametrize(("rate_hz", "period_ms"), [(2.0, 500), (0.5, 2000)])
def test_another_rate(rate_hz: float, period_ms: int) -> None:
    bench = at_rest(temperature_rate_hz=rate_hz)
    bench.subscribe(TEMPERATURE)
    bench.run(6100)
    times = [begun_ns(frame) for frame in bench.subscribed(TEMPERATURE)]
    assert len(times) == 6000 // period_ms
    assert {after - before for before, after in itertools.pairwise(times)} == {period_ms * MS}


def test_solutions_with_each_frame_while_there_is_no_attitude_too() -> None:
    bench = at_rest()
    bench.subscribe(SOLUTION)
    bench.run(2100)
    frames = bench.subscribed(SOLUTION)
    assert len(frames) >= 8
    assert all(begun_ns(frame) % PERIOD_NS == 0 for frame in frames)
    assert {client.solution(frame)["valid"] for frame in frames} == {0}


@pytest.mark.parametrize(
    ("period_ms", "rate_hz", "frames_between"),
    [(250, 5.0, 1), (200, 5.0, 1), (199, 5.0, 2), (100, 5.0, 2), (100, 3.0, 4), (250, 1.0, 4)],
)
def test_no_faster_than_the_rate(period_ms: int, rate_hz: float, frames_between: int) -> None:
    timing = {"frame_period_ms": period_ms, "exposure_ms": 50.0}
    profile = unit(timing=timing, autonomous=False, solution_rate_hz=rate_hz)
    bench = Bench(profile).boot()
    bench.subscribe(SOLUTION)
    bench.run(4000)
    numbers = [begun_ns(frame) // (period_ms * MS) for frame in bench.subscribed(SOLUTION)]
    assert numbers
    assert all(number % frames_between == 0 for number in numbers)
    assert numbers == list(range(numbers[0], numbers[-1] + 1, frames_between))


def test_beside_requests() -> None:
    bench = at_rest()
    bench.subscribe(SOLUTION, TEMPERATURE)
    bench.run(1000)
    bench.frames.clear()
    for _ in range(12):
        assert bench.one(REQUEST, POWER, ms=250).status == 0
    assert len(bench.subscribed(SOLUTION)) == 12
    assert len(bench.subscribed(TEMPERATURE)) == 3
    counters = [frame.counter for frame in bench.frames]
    assert counters == list(range(counters[0], counters[0] + len(counters)))


def test_the_driver_is_never_sent_more_than_it_reads() -> None:
    bench = at_rest(other_rate_hz=4.0)
    bench.subscribe(*client.TELEMETRY_BODY_BYTES)
    bench.run(5000)
    times = [begun_ns(frame) for frame in bench.frames if frame.type == client.ASYNCHRONOUS]
    assert len(times) > 30
    # Counted where they are queued; a frame may wait for others, less than 100 ms.
    assert all(after - before >= 900 * MS for before, after in zip(times, times[9:], strict=False))


def test_replies_are_never_left_out_and_count() -> None:
    bench = at_rest()
    bench.subscribe(SOLUTION)
    bench.run(2000)
    bench.frames.clear()
    bench.put(client.request(REQUEST, TEMPERATURE) * 9)
    frames = bench.run(900)
    assert len([frame for frame in frames if frame.type == client.TELEMETRY]) == 9
    assert bench.subscribed(SOLUTION, frames) == []
    assert len(bench.subscribed(SOLUTION, bench.run(1000))) >= 3


def test_a_wider_budget() -> None:
    bench = at_rest(most_frames_per_s=20)
    bench.subscribe(SOLUTION)
    bench.run(2000)
    bench.put(client.request(REQUEST, TEMPERATURE) * 9)
    assert len(bench.subscribed(SOLUTION, bench.run(900))) >= 3


def test_an_id_in_two_slots_comes_once_and_0_is_none() -> None:
    bench = at_rest()
    bench.subscribe(0, 27, 27, 0, 11)
    frames = bench.run(1100)
    assert [frame.id for frame in frames] == [27, 11]


def test_slots_that_count() -> None:
    bench = at_rest(subscription_slots=2)
    bench.subscribe(27, 0, 11)
    assert [frame.id for frame in bench.run(1100)] == [27]


def test_another_subscription_takes_the_place_of_the_first() -> None:
    bench = at_rest()
    bench.subscribe(27, 11)
    bench.run(400)
    bench.subscribe(11)
    frames = bench.run(2400)
    assert [frame.id for frame in frames] == [11, 11]
    bench.subscribe()
    assert bench.run(2400) == []


def test_a_refused_one_leaves_the_first() -> None:
    bench = at_rest()
    bench.subscribe(27)
    assert bench.status(SET, SUBSCRIPTION, client.subscription(11, 99)) == 2
    assert [frame.id for frame in bench.run(2100)] == [27, 27]


def test_nothing_is_subscribed_to_at_first() -> None:
    bench = at_rest()
    assert bench.one(client.READ, SUBSCRIPTION).arguments == client.subscription(24, 27)
    assert bench.run(2000) == []


def test_a_fault_is_told_as_invalid() -> None:
    bench = Bench(unit()).boot()
    bench.subscribe(SOLUTION)
    bench.run_until(lambda: any(client.solution(f)["valid"] for f in bench.subscribed(SOLUTION)))
    bench.device.enter_fault(FaultCause.COMMANDED)
    frames = bench.subscribed(SOLUTION, bench.run(1100))[-3:]
    assert len(frames) == 3
    for frame in frames:
        told = client.solution(frame)
        assert (told["valid"], told["stable"], told["mode"], told["strategy"]) == (0, 0, 1, 8)
