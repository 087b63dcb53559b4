"""On-board time: set at a frame's start, carried in every packet, reported at its rate."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_tests.vectors import reference_decoder as wire
from st_emulator.device.onboard_time import OnboardTime
from st_emulator.protocol.pus.packets import CucTime

from .conftest import MS, Bench, MakeBench

TICK_NS = 1e9 / 2**24
PERIOD_MS = 250
SUPERSEDED, ABORTED, NOT_ALLOWED = 15, 17, 7


def ns_of(time: tuple[int, int]) -> float:
    return time[0] * 1e9 + time[1] * TICK_NS


def test_before_it_is_set_it_counts_from_power_on(bench: Bench) -> None:
    start_ns = bench.emulator.now_ns
    bench.send("ping")
    bench.run(20)
    for packet in bench.packets:
        assert packet.decoded["time_status"] == 0
        assert start_ns < ns_of(packet.decoded["time"]) <= packet.t_ns


def test_it_is_taken_over_at_the_next_frame_start(bench: Bench) -> None:
    bench.run_to(10 * PERIOD_MS + 60)
    line = bench.packet("set_time", {"time": (2_000_000_000, 1 << 23)})
    put_ns = bench.emulator.now_ns
    frame = wire.slip_frame(line)
    bench.put(frame)
    last_byte_ns = put_ns + len(frame) * 10**10 // 115200
    bench.run_to(11 * PERIOD_MS - 1)
    assert bench.stages(bench.count) == ["acceptance_success", "start_success"]
    assert all(packet.decoded["time_status"] == 0 for packet in bench.packets)
    bench.run_to(11 * PERIOD_MS + 30)
    assert bench.stages(bench.count)[2:] == ["completion_success"]
    (event,) = bench.events("TIME_SET")
    frame_start_ns = 11 * PERIOD_MS * MS
    assert ns_of(event["old"]) == pytest.approx(frame_start_ns, abs=2 * TICK_NS)
    expected = 2_000_000_000.5e9 + frame_start_ns - last_byte_ns
    assert ns_of(event["new"]) == pytest.approx(expected, abs=300)  # float64 resolves 256 ns here
    told = [packet for packet in bench.packets if packet.fields.get("event_id") == 12]
    assert told[0].decoded["time_status"] == 1
    assert told[0].decoded["time"] == event["new"]
    assert bench.housekeeping(1)["time_status"] == 1


def test_a_later_one_supersedes_an_earlier(bench: Bench) -> None:
    bench.run_to(4 * PERIOD_MS + 50)
    first = bench.send("set_time", {"time": (100, 0)})
    bench.run(20)
    second = bench.send("set_time", {"time": (1_000_000, 0)})
    bench.run_to(5 * PERIOD_MS + 20)
    assert bench.stages(first) == ["acceptance_success", "start_success", "completion_failure"]
    assert bench.failure(first) == ("completion_failure", SUPERSEDED, 0)
    assert bench.stages(second) == ["acceptance_success", "start_success", "completion_success"]
    (event,) = bench.events("TIME_SET")
    assert event["new"][0] == 1_000_000


def test_it_is_aborted_by_a_reset(bench: Bench) -> None:
    bench.run_to(4 * PERIOD_MS + 50)
    count = bench.send("set_time", {"time": (100, 0)})
    bench.run(10)
    bench.function("RESET", {"kind": 0})
    bench.run(800)
    assert bench.failure(count) == ("completion_failure", ABORTED, 0)
    assert bench.events("TIME_SET") == []
    assert bench.packets[-1].decoded["time_status"] == 0


@pytest.mark.parametrize(("kind", "kept"), [(0, True), (1, False)])
def test_a_warm_reset_keeps_it(bench: Bench, kind: int, kept: bool) -> None:
    bench.send("set_time", {"time": (2_000_000_000, 0)})
    bench.run(300)
    bench.function("RESET", {"kind": kind})
    bench.run(30)
    bench.forget()
    reset_ms = bench.now_ms
    bench.run(450)
    (boot,) = [packet for packet in bench.packets if packet.fields.get("event_id") == 1]
    assert boot.decoded["time_status"] == int(kept)
    seconds = ns_of(boot.decoded["time"]) / 1e9
    if kept:
        assert 2_000_000_000.3 < seconds < 2_000_000_001.5
    else:
        assert seconds == pytest.approx(0.4, abs=1e-6), "it counts from the reset"
    assert reset_ms > 700


def test_attitude_is_stamped_at_mid_exposure(new_bench: MakeBench) -> None:
    bench = new_bench().boot()
    bench.to_mode("TRACKING")
    bench.run(700)
    exposure_ns = 100 * MS
    for packet in bench.packets:
        if packet.name == "attitude_report" and packet.fields["time_status"] == 0:
            fields = packet.fields
            expected = fields["frame_index"] * PERIOD_MS * MS + exposure_ns / 2
            assert ns_of(fields["mid_exposure_time"]) == pytest.approx(expected, abs=2 * TICK_NS)
            done_ns = expected + fields["latency_us"] * 1e3
            assert ns_of(packet.decoded["time"]) == pytest.approx(done_ns, abs=1e3)
    bench.forget()
    bench.send("set_time", {"time": (2_000_000_000, 0)})
    bench.run(1500)
    (event,) = bench.events("TIME_SET")
    offset_ns = ns_of(event["new"]) - ns_of(event["old"])
    stamped = [fields for fields in bench.of("attitude_report") if fields["time_status"] == 1]
    assert len(stamped) >= 4
    for fields in stamped:
        expected = fields["frame_index"] * PERIOD_MS * MS + exposure_ns / 2 + offset_ns
        assert ns_of(fields["mid_exposure_time"]) == pytest.approx(expected, abs=800)


def test_a_time_set_to_zero_behind_a_frame_in_flight_turns_over(new_bench: MakeBench) -> None:
    """A frame exposed before the instant that is set to 0 has a time before 0: the counter turned over."""
    bench = new_bench(parameters={"clock_hz": 100_000_000}).boot()  # results come behind the next frame start
    bench.to_mode("TRACKING")
    start = round(bench.now_ms // PERIOD_MS + 2) * PERIOD_MS
    bench.run_to(start + 200)
    bench.send("set_time", {"time": (0, 0)})
    bench.run(1000)
    (event,) = bench.events("TIME_SET")
    assert event["new"][0] == 0
    assert bench.packets[-1].decoded["time"][0] < 5


def test_it_turns_over_behind_its_last_second(bench: Bench) -> None:
    bench.send("set_time", {"time": (0xFFFFFFFF, 0)})
    bench.run(2500)
    bench.forget()
    bench.send("ping")
    bench.run(20)
    assert [packet.decoded["time"][0] for packet in bench.packets] == [1, 1, 1]


def test_time_reports_come_each_power_of_two_frames(bench: Bench) -> None:
    assert bench.of("time_report") == []
    for exponent in (0, 1, 3):
        bench.send("time_report_rate", {"rate_exponent": exponent}, ack=0)
        bench.run(10)
        bench.forget()
        first = int(bench.now_ms // PERIOD_MS) + 1
        bench.run_to((first + 24) * PERIOD_MS - 100)
        reports = [packet for packet in bench.packets if packet.name == "time_report"]
        wanted = [frame for frame in range(first, first + 24) if frame % 2**exponent == 0]
        assert [packet.fields["rate_exponent"] for packet in reports] == [exponent] * len(wanted)
        for frame, packet in zip(wanted, reports, strict=True):
            assert ns_of(packet.fields["time"]) == pytest.approx(frame * PERIOD_MS * MS, abs=2 * TICK_NS)
            assert packet.fields["time_status"] == 0


def test_fine_time_is_in_units_of_2_to_the_minus_24_s(bench: Bench) -> None:
    bench.send("set_time", {"time": (5, 0xABCDEF)})
    bench.run(300)
    (event,) = bench.events("TIME_SET")
    raw = struct.pack(">IBH", event["new"][0], event["new"][1] >> 16, event["new"][1] & 0xFFFF)
    assert len(raw) == 7
    assert ns_of(event["new"]) / 1e9 == pytest.approx(5 + 0xABCDEF / 2**24, abs=0.26)


@given(st.integers(0, 2**32 - 1), st.integers(0, 2**24 - 1), st.integers(0, 10**12), st.integers(0, 10**12))
def test_offset_arithmetic(coarse: int, fine: int, at_ns: int, later_ns: int) -> None:
    time = OnboardTime()
    time.prepare(CucTime(coarse, fine).to_ns(), at_ns)
    assert time.apply(at_ns + later_ns) is not None
    ticks = (coarse << 24) + fine
    now = CucTime.from_ns(time.tai_ns(at_ns))
    assert (now.coarse << 24) + now.fine == ticks
    later = CucTime.from_ns(time.tai_ns(at_ns + later_ns))
    elapsed = ((later.coarse << 24) + later.fine - ticks) % 2**56
    assert abs(elapsed - later_ns * 2**24 / 1e9) <= 1
