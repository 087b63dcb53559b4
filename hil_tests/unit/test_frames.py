"""When an attitude leaves, and what a processor that is too slow does to it: every time computed by hand."""

import math
from typing import Any

import pytest

from st_emulator.firmware_model.work import Work

from .conftest import MODE, MS, Bench, MakeBench, Packet

PERIOD_NS, EXPOSURE_NS, READOUT_NS = 250 * MS, 100 * MS, 16_700_000
OVERRUN, FRAME_DROPPED, BLINDED = 0x10, 0x40, 0x04
BYTE_NS = 1e10 / 115200


def reports(bench: Bench) -> list[Packet]:
    return [packet for packet in bench.packets if packet.name == "attitude_report"]


def ns_of(packet: Packet) -> float:
    coarse, fine = packet.decoded["time"]
    return coarse * 1e9 + fine * 1e9 / 2**24


def first_cycles(new_bench: MakeBench, **parameters: float) -> int:
    """Cycles of frame 5, the first one of an acquisition that :func:`acquire_at_5` starts."""
    bench = new_bench(parameters=parameters).boot()
    acquire_at_5(bench)
    bench.run(1500)
    assert reports(bench)[0].fields["frame_index"] == 5
    return reports(bench)[0].fields["cycles"]


def acquire_at_5(bench: Bench) -> None:
    bench.run_to(1010)
    bench.function("START_ACQUISITION", ack=0)
    bench.run_to(1249)


def test_an_attitude_leaves_when_its_cycles_are_spent(bench: Bench) -> None:
    bench.to_mode("LOST_IN_SPACE")
    bench.run(2000)
    seen = reports(bench)
    assert {packet.fields["mode"] for packet in seen} == {3, 4}
    for packet in seen:
        fields = packet.fields
        assert fields["cycles"] > 1_000_000
        start_ns = fields["frame_index"] * PERIOD_NS
        done_ns = start_ns + EXPOSURE_NS + READOUT_NS + fields["cycles"] * 1e9 / 400e6
        assert ns_of(packet) == pytest.approx(done_ns, abs=100)
        assert fields["latency_us"] == pytest.approx((done_ns - start_ns - EXPOSURE_NS / 2) / 1e3, abs=1)
        assert fields["late"] == 0
        # 151 bytes of data, 22 of headers and control, two ENDs, and the escapes.
        assert 175 * BYTE_NS - 2000 <= packet.t_ns - done_ns <= 189 * BYTE_NS
    frames = [packet.fields["frame_index"] for packet in seen]
    assert frames == list(range(frames[0], frames[0] + len(frames)))


def test_half_the_clock_doubles_the_core_and_leaves_the_memory(new_bench: MakeBench) -> None:
    seen: dict[int, dict[int, dict[str, Any]]] = {}
    memory_cycles: dict[int, int] = {}
    last = 0
    for clock_hz in (400_000_000, 200_000_000):
        bench = new_bench(parameters={"clock_hz": clock_hz}).boot()
        bench.to_mode("TRACKING")
        bench.run(1000)
        values = bench.housekeeping(3)
        last, memory_cycles[clock_hz] = values["frame_index"], values["cycles_memory"]
        seen[clock_hz] = {p.fields["frame_index"]: p.fields for p in reports(bench)}
    for frame, fast in seen[400_000_000].items():
        slow = seen[200_000_000][frame]
        fixed_us = (EXPOSURE_NS / 2 + READOUT_NS) / 1e3
        for fields, cycle_us in ((fast, 1 / 400), (slow, 1 / 200)):
            assert fields["latency_us"] - fixed_us == pytest.approx(fields["cycles"] * cycle_us, abs=2)
        assert slow["cycles"] < fast["cycles"] < 2 * slow["cycles"]
    # The memory's nanoseconds are half the cycles of half the clock; what is left is the core's.
    assert memory_cycles[400_000_000] == pytest.approx(2 * memory_cycles[200_000_000], abs=2)
    fast, slow = seen[400_000_000][last], seen[200_000_000][last]
    core = fast["cycles"] - memory_cycles[400_000_000]
    assert core == pytest.approx(slow["cycles"] - memory_cycles[200_000_000], abs=8)


@pytest.mark.parametrize(("name", "value"), [("line_fill", 2), ("cache_kib", 4)])
def test_a_slower_memory_or_a_smaller_cache_takes_longer(new_bench: MakeBench, name: str, value: int) -> None:
    cycles = []
    for parameters in ({}, {name: value}):
        bench = new_bench(parameters=parameters).boot()
        bench.to_mode("TRACKING")
        bench.run(500)
        values = bench.housekeeping(3)
        assert values[name] == parameters.get(name, {"line_fill": 1, "cache_kib": 32}[name])
        cycles.append(values["cycles_memory"])
    assert cycles[1] > (1.4 if name == "line_fill" else 1.0) * cycles[0]


def test_telemetry_loads_the_processor(new_bench: MakeBench) -> None:
    quiet, busy = (new_bench(parameters={"attitude_report": report}).boot() for report in (0, 1))
    cycles = []
    for bench in (quiet, busy):
        bench.to_mode("TRACKING")
        bench.run(2000)
        cycles.append(bench.housekeeping(3)["cycles_telemetry"])
    assert cycles[1] > cycles[0] + 1000  # a report is 173 bytes


def test_work_on_the_line_is_that_of_its_packets(new_bench: MakeBench) -> None:
    bench = new_bench().boot()
    unit, dialect = bench.emulator.device, bench.emulator.dialect
    counters = dialect.receiver.counters
    unit.link_work()
    sent, received = dialect.transmitter.bytes, counters.rx_bytes
    bench.send("ping")
    bench.run(20)  # less than to the next frame, which takes the work
    work = unit.link_work()
    assert work["telecommands"] == 1
    assert work["telecommand_bytes"] == counters.rx_bytes - received
    assert 0 < work["telemetry_bytes"] <= dialect.transmitter.bytes - sent  # escapes and ENDs are more
    assert work["crc_bytes"] == work["telemetry_bytes"] + 13  # the ping's packet
    assert work["image_bytes"] == 0
    assert work["sending_rounds"] == work["receiving_rounds"] == 1
    assert unit.link_work() == Work()


def test_timing_structure_adds_up(bench: Bench) -> None:
    values = bench.housekeeping(3)
    assert values["cycles_total"] == 0
    assert values["cycles_budget"] == 100_000_000
    assert values["clock_hz"] == 400_000_000
    bench.to_mode("TRACKING")
    bench.run(1000)
    values = bench.housekeeping(3)
    last = reports(bench)[-1].fields
    stages = ("threshold", "clustering", "centroid", "identification", "tracking", "attitude", "telemetry")
    assert values["frame_index"] == last["frame_index"]
    assert values["cycles_total"] == last["cycles"] == sum(values[f"cycles_{stage}"] for stage in stages)
    assert values["margin_us"] == pytest.approx((100_000_000 - last["cycles"]) / 400, abs=1)
    assert values["worst_cycles"] == max(packet.fields["cycles"] for packet in reports(bench))
    assert values["worst_cycles"] > values["cycles_total"]


def test_an_overrun_is_late_and_drops_the_next(new_bench: MakeBench) -> None:
    clock_hz = 20_000_000
    bench = new_bench(parameters={"clock_hz": clock_hz}).boot()
    acquire_at_5(bench)
    bench.run(3000)
    seen = reports(bench)
    first = seen[0].fields
    by_frame = {packet.fields["frame_index"]: packet for packet in seen}
    late = by_frame[5]
    cycles = late.fields["cycles"]
    processing_ns = cycles * 1e9 / clock_hz
    assert 250e6 < processing_ns < 1000e6, "lost in space is too much for this clock"
    dropped = math.ceil(processing_ns / PERIOD_NS) - 1  # frames whose read-out finds the processor busy
    assert first["frame_index"] == (6 if dropped else 5), (
        "a dropped frame is told before the late one is done"
    )
    assert late.fields["late"] == 1
    assert late.fields["valid"] == 1, "late, but right"
    assert late.fields["reasons"] == 0
    assert ns_of(late) == pytest.approx(5 * PERIOD_NS + EXPOSURE_NS + READOUT_NS + processing_ns, abs=200)
    (overran,) = [event for event in bench.events("FRAME_OVERRAN") if event["frame_index"] == 5]
    assert overran["cycles"] == cycles
    assert overran["budget"] == clock_hz // 4
    assert overran["late_us"] == pytest.approx((processing_ns - PERIOD_NS) / 1e3, abs=1)
    for number in range(dropped):
        frame = 6 + number
        told = by_frame[frame]
        assert told.fields["valid"] == told.fields["late"] == 0
        assert told.fields["reasons"] == FRAME_DROPPED | OVERRUN
        assert told.fields["frames_dropped_before"] == number
        assert told.fields["latency_us"] == told.fields["cycles"] == 0
        assert ns_of(told) == pytest.approx(frame * PERIOD_NS + EXPOSURE_NS + READOUT_NS, abs=200)
    assert [e for e in bench.events("FRAME_DROPPED") if e["frame_index"] < 6 + dropped] == [
        {"frame_index": 6 + number, "cause": 0} for number in range(dropped)
    ]
    behind = by_frame[6 + dropped].fields
    assert behind["frames_dropped_before"] == dropped
    assert behind["mode"] == MODE["TRACKING"]
    assert behind["valid"] == 1
    status = bench.housekeeping(1)
    assert status["frames_late"] == len(bench.events("FRAME_OVERRAN"))
    assert status["frames_dropped"] == len(bench.events("FRAME_DROPPED"))
    assert status["frames_processed"] == sum(p.fields["cycles"] > 0 for p in reports(bench))


def test_dropped_frames_are_counted_before_the_next_one_with_the_longest_exposure(
    new_bench: MakeBench,
) -> None:
    """Exposure and read-out are longer than a period: a frame is read out when the next one is exposed."""
    cycles = first_cycles(new_bench, exposure_us=250_000)
    clock_hz = round(cycles / 0.625)  # two and a half periods
    bench = new_bench(parameters={"clock_hz": clock_hz, "exposure_us": 250_000}).boot()
    acquire_at_5(bench)
    bench.run(3500)
    by_frame = {packet.fields["frame_index"]: packet.fields for packet in reports(bench)}
    assert [by_frame[frame]["frames_dropped_before"] for frame in (5, 6, 7, 8, 9)] == [0, 0, 1, 2, 0]
    assert [event["frame_index"] for event in bench.events("FRAME_DROPPED")][:2] == [6, 7]
    assert [by_frame[frame]["cycles"] > 0 for frame in (5, 6, 7, 8)] == [True, False, False, True]


def test_without_overlap_a_frame_has_what_is_left_of_its_period(new_bench: MakeBench) -> None:
    bench = new_bench(parameters={"pipelined": 0}).boot()
    budget = bench.housekeeping(3)["cycles_budget"]
    assert budget == int((PERIOD_NS - EXPOSURE_NS - READOUT_NS) * 400e6 / 1e9)
    bench.to_mode("TRACKING")
    bench.run(1000)
    assert all(packet.fields["late"] == 0 for packet in reports(bench))
    assert bench.events("FRAME_DROPPED") == []


def test_without_overlap_a_busy_processor_lets_no_exposure_start(new_bench: MakeBench) -> None:
    clock_hz = round(first_cycles(new_bench) / 0.2)
    bench = new_bench(parameters={"pipelined": 0, "clock_hz": clock_hz}).boot()
    acquire_at_5(bench)
    bench.run(1500)
    by_frame = {packet.fields["frame_index"]: packet for packet in reports(bench)}
    late = by_frame[5]
    processing_ns = late.fields["cycles"] * 1e9 / clock_hz
    budget_ns = PERIOD_NS - EXPOSURE_NS - READOUT_NS
    assert budget_ns < processing_ns < PERIOD_NS, "with overlap this frame would be in time"
    assert late.fields["late"] == 1
    overran = bench.events("FRAME_OVERRAN")[0]
    assert overran["frame_index"] == 5
    assert overran["budget"] == int(budget_ns * clock_hz / 1e9) < overran["cycles"] == late.fields["cycles"]
    assert overran["late_us"] == pytest.approx((processing_ns - budget_ns) / 1e3, abs=1)
    assert bench.events("FRAME_DROPPED")[0] == {"frame_index": 6, "cause": 1}
    told = by_frame[6]
    assert told.fields["reasons"] == FRAME_DROPPED | OVERRUN
    assert ns_of(told) == pytest.approx(6 * PERIOD_NS, abs=200)
    assert by_frame[7].fields["valid"] == 1
    assert bench.housekeeping(1)["frames_dropped"] == len(bench.events("FRAME_DROPPED"))


def test_the_slowest_clock_stays_within_the_fields(new_bench: MakeBench) -> None:
    bench = new_bench(parameters={"clock_hz": 1_000_000}).boot()
    bench.function("START_ACQUISITION")
    bench.run(30_000)
    (overran,) = bench.events("FRAME_OVERRAN")
    assert overran["budget"] == 250_000
    assert overran["late_us"] == pytest.approx(overran["cycles"] - 250_000, abs=1)
    values = bench.housekeeping(3)
    assert values["margin_us"] == -overran["late_us"]
    assert len(bench.events("FRAME_DROPPED")) > 20


def test_the_fastest_clock_and_longest_period_stay_within_the_fields(new_bench: MakeBench) -> None:
    bench = new_bench(parameters={"clock_hz": 2_000_000_000}, timing={"frame_period_ms": 10_000}).boot()
    assert bench.housekeeping(3)["cycles_budget"] == 0xFFFFFFFF  # of 2e10
    assert bench.housekeeping(3)["margin_us"] == 10_000_000


def test_a_mode_command_gives_up_frames_in_flight(bench: Bench) -> None:
    bench.to_mode("TRACKING")
    bench.run_to((bench.now_ms // 250 + 2) * 250 + 105)  # read out is at 116.7 ms
    frame = int(bench.now_ms // 250)
    bench.function("GO_STANDBY")
    bench.run(1500)
    assert frame not in [packet.fields["frame_index"] for packet in reports(bench)]
    assert max(packet.fields["frame_index"] for packet in reports(bench)) == frame - 1
    bench.forget()
    bench.run_to((bench.now_ms // 250 + 1) * 250 + 10)
    start = int(bench.now_ms // 250)
    bench.function("START_ACQUISITION")
    bench.run(1000)
    assert reports(bench)[0].fields["frame_index"] == start + 1, "from the next exposure on"
    assert reports(bench)[0].fields["mode"] == MODE["LOST_IN_SPACE"]
    bench.run_to((bench.now_ms // 250 + 1) * 250 + 60)
    again = int(bench.now_ms // 250)
    bench.function("START_ACQUISITION")
    bench.run(600)
    modes = {packet.fields["frame_index"]: packet.fields["mode"] for packet in reports(bench)}
    assert again not in modes
    assert modes[again + 1] == MODE["LOST_IN_SPACE"]


def test_acquisition_superseded_and_aborted(new_bench: MakeBench) -> None:
    bench = new_bench(detection={"blinded_background_dn": 1}).boot()  # never an attitude
    first = bench.function("START_ACQUISITION")
    bench.run(400)
    second = bench.function("START_ACQUISITION")
    bench.run(400)
    assert bench.failure(first) == ("completion_failure", 15, 0)
    bench.function("GO_STANDBY")
    bench.run(100)
    assert bench.failure(second) == ("completion_failure", 17, 0)
    third = bench.function("START_ACQUISITION")
    bench.run(400)
    bench.function("RESET", {"kind": 0})
    bench.run(600)
    assert bench.failure(third) == ("completion_failure", 17, 0)
    assert len(bench.events("SENSOR_BLINDED")) == 1, "told when it begins, and not again before it has ended"


def test_a_blinded_sensor_says_so(new_bench: MakeBench) -> None:
    bench = new_bench(detection={"blinded_background_dn": 1}).boot()
    bench.function("START_ACQUISITION")
    bench.run(1500)
    for packet in reports(bench):
        assert packet.fields["valid"] == 0
        assert packet.fields["reasons"] == BLINDED
        assert packet.fields["stars_identified"] == 0
    (event,) = bench.events("SENSOR_BLINDED")
    assert event["background_dn"] == pytest.approx(reports(bench)[0].fields["background_dn"], abs=1)
    assert bench.housekeeping(1)["last_reasons"] == BLINDED


def test_acquired_and_lost_are_events(bench: Bench) -> None:
    bench.to_mode("LOST_IN_SPACE")
    bench.run(1500)
    first = next(packet.fields for packet in reports(bench) if packet.fields["valid"])
    assert bench.events("ATTITUDE_ACQUIRED") == [
        {"frame_index": first["frame_index"], "stars": first["stars_identified"]}
    ]
    assert bench.events("MODE_CHANGED")[-1] == {"from_mode": 3, "to_mode": 4, "cause": 12}
    bench.set_parameters(blinded_background_dn=1)
    bench.run(1500)
    bad = [packet.fields for packet in reports(bench) if not packet.fields["valid"]]
    (lost,) = bench.events("TRACKING_LOST")
    assert lost["frame_index"] == bad[2]["frame_index"], "tracking_max_missed is 2: the third loses it"
    assert lost["reasons"] == BLINDED
    assert [fields["mode"] for fields in bad[:4]] == [4, 4, 4, 3]
    # A careless reader of an invalid report finds the last attitude, not a jump.
    good = [packet.fields for packet in reports(bench) if packet.fields["valid"]][-1]
    assert all(bad[-1][name] == good[name] for name in ("q_x", "q_y", "q_z", "q_w"))


def test_track_from_a_wrong_attitude_falls_back_to_lost_in_space(bench: Bench) -> None:
    count = bench.function("TRACK_FROM", {"q_x": 1.0, "q_y": 0.0, "q_z": 0.0, "q_w": 0.0})
    bench.run(2500)
    modes = [packet.fields["mode"] for packet in reports(bench)]
    assert modes[:4] == [4, 4, 4, 3]
    assert modes[-1] == 4
    assert bench.stages(count) == ["acceptance_success", "start_success", "completion_success"]


def test_no_attitude_report_when_the_parameter_says_so(new_bench: MakeBench) -> None:
    bench = new_bench(parameters={"attitude_report": 0, "clock_hz": 20_000_000}).boot()
    bench.to_mode("LOST_IN_SPACE")
    bench.run(2500)
    assert reports(bench) == []
    assert len(bench.events("FRAME_DROPPED")) >= 1
    assert bench.housekeeping(1)["frames_valid"] > 1


def test_exposure_shortened_behind_a_long_frame(new_bench: MakeBench) -> None:
    """A frame that is in time can still be busy at the earlier read-out of a shorter exposure behind it."""
    clock_hz = round(first_cycles(new_bench, exposure_us=250_000) / 0.2)
    bench = new_bench(parameters={"clock_hz": clock_hz, "exposure_us": 250_000}).boot()
    acquire_at_5(bench)
    bench.run_to(1260)
    bench.set_parameters(exposure_us=100)
    bench.run(1000)
    by_frame = {packet.fields["frame_index"]: packet.fields for packet in reports(bench)}
    assert by_frame[5]["late"] == 0
    processing_ms = by_frame[5]["cycles"] / clock_hz * 1e3
    busy_until_ms = 1250 + 250 + 16.7 + processing_ms
    assert busy_until_ms > 1500 + 0.1 + 16.7
    assert by_frame[6]["reasons"] == FRAME_DROPPED | OVERRUN
    assert bench.events("FRAME_DROPPED")[0] == {"frame_index": 6, "cause": 0}
