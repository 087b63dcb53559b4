"""Cyclic frames: their times, and their bits against the attitude report of the same frame."""

from typing import Any

import pytest

from hil_tests.vectors.reference_can import classic_bits, record
from st_emulator.bench.scenario import parse_scenario
from st_emulator.wire.can.wiring import CanWiring

from .conftest import MODE, MS, WIDE, CanBench, make_can
from .test_images import Gaps

PERIOD_MS = 250
KINDS = ("attitude_1", "attitude_2", "rates", "status", "mid_exposure_time")
TURNING = """
schema = 1
name = "turning"
[trajectory]
kind = "constant_rate"
ra_deg = 83.0
dec_deg = -3.0
rate_deg_s = [0.05, -0.1, 0.2]
"""


def turning(**arguments: Any) -> CanBench:
    return make_can(scenario=parse_scenario(TURNING, "turning"), **arguments).boot()


def tracking() -> CanBench:
    """Tracked frames, some of them before the time is set, one that the sensor does not deliver."""
    bench = turning()
    bench.to_mode("TRACKING")
    bench.run(1000)
    bench.send("set_time", {"time": (2_000_000_000, 0xABCDEF)}, ack=0)
    bench.run(1000)
    Gaps(bench.emulator, {bench.emulator.device.last_frame_index + 2})
    bench.run(2000)
    return bench


def blinded() -> CanBench:
    bench = make_can(detection={"blinded_background_dn": 1}).boot()
    bench.to_mode("LOST_IN_SPACE")
    bench.run(2000)
    return bench


def late() -> CanBench:
    """A processor too slow for its frames: late ones and dropped ones."""
    bench = make_can()
    bench.run(420)
    bench.set_parameters(clock_hz=25_000_000)
    bench.to_mode("LOST_IN_SPACE")
    bench.run(4000)
    return bench


RUNS = {
    "tracking": tracking, "blinded": blinded, "late": late,
    "29 bits": lambda: tracked_with(can_section=WIDE),
    "fd": lambda: tracked_with(can=CanWiring(fd=True)),
}  # fmt: skip


def tracked_with(**arguments: Any) -> CanBench:
    bench = turning(**arguments)
    bench.to_mode("TRACKING")
    bench.run(1000)
    return bench


@pytest.fixture(scope="module", params=RUNS)
def seen(request: Any) -> CanBench:
    return RUNS[request.param]()


def by_frame(bench: CanBench) -> list[tuple[dict[str, Any], dict[str, dict[str, Any]]]]:
    """Each attitude report with the cyclic frames of its counter."""
    reports = bench.of("attitude_report")
    assert len(reports) >= 4
    frames = {kind: {values["counter"]: values for _, values in bench.frames(kind)} for kind in KINDS}
    return [
        (report, {kind: frames[kind][report["frame_index"] & 0xFF] for kind in KINDS}) for report in reports
    ]


def test_one_of_each_kind_for_each_report(seen: CanBench) -> None:
    indices = [report["frame_index"] for report in seen.of("attitude_report")]
    assert len(set(indices)) == len(indices) < 256
    for kind in KINDS:
        assert [values["counter"] for _, values in seen.frames(kind)] == [index & 0xFF for index in indices]


def test_attitude_within_half_a_step(seen: CanBench) -> None:
    for report, frames in by_frame(seen):
        halves = frames["attitude_1"] | frames["attitude_2"]
        for axis in "xyzw":
            assert abs(halves[f"q_{axis}"] - min(report[f"q_{axis}"], 1 - 2**-27)) <= 2**-28
        assert halves["q_w"] >= 0
    valid = [report for report in seen.of("attitude_report") if report["valid"]]
    assert len({report["q_x"] for report in valid}) == len(valid), "each frame has its own"


def test_rates_within_half_a_step(seen: CanBench) -> None:
    for report, frames in by_frame(seen):
        assert frames["rates"]["rate_valid"] == report["rate_valid"]
        for axis in "xyz":
            assert abs(frames["rates"][f"rate_{axis}"] - report[f"rate_{axis}"]) <= 2**-20


def test_status_says_what_the_report_says(seen: CanBench) -> None:
    for report, frames in by_frame(seen):
        status = frames["status"]
        for name in ("mode", "valid", "rate_valid", "late", "reasons"):
            assert status[name] == report[name], name
        for name in ("stars_identified", "spots_detected", "frames_dropped_before"):
            assert status[name] == min(report[name], 255), name
        assert status["time_set"] == report["time_status"]


def test_time_at_mid_exposure_is_the_reports_bit_by_bit(seen: CanBench) -> None:
    for report, frames in by_frame(seen):
        coarse, fine = report["mid_exposure_time"]
        assert frames["mid_exposure_time"]["seconds"] == coarse
        assert frames["mid_exposure_time"]["fraction"] * 2**24 == fine


def test_they_leave_when_the_result_counts(seen: CanBench) -> None:
    """In the order of their identifiers, back to back, before the report's first frame."""
    shift = 18 if seen.peer.extended else 0
    sent = [(t_ns, number >> shift & ~0x7F, payload) for t_ns, number, payload in seen.peer.frames]
    reports = [packet for packet in seen.packets if packet.name == "attitude_report"]
    assert reports
    for packet in reports:
        coarse, fine = packet.decoded["time"]
        if packet.decoded["time_status"]:
            continue  # it counts from power-on no more
        at_ns = coarse * 1e9 + fine * 1e9 / 2**24
        counter = packet.fields["frame_index"] & 0xFF
        for base in (0x180, 0x280, 0x380, 0x480, 0x500):
            (found,) = [item for item in sent if item[1] == base and item[2][0] == counter]
            identifier = (base << shift) + 10
            at_ns += classic_bits(identifier, found[2], extended=bool(shift)) * 1000
            # A frame of another kind, or of a packet, may be on the bus when the result is there.
            assert at_ns - 60 <= found[0] <= at_ns + 170_000
        assert packet.t_ns > at_ns


def test_the_runs_show_all_that_is_to_be_seen() -> None:
    """So that the comparisons above do not compare zeros."""
    reports = [
        report for name in ("tracking", "blinded", "late") for report in RUNS[name]().of("attitude_report")
    ]
    for name in ("valid", "rate_valid", "late", "time_status"):
        assert {report[name] for report in reports} == {0, 1}, name
    assert {report["mode"] for report in reports} == {MODE["LOST_IN_SPACE"], MODE["TRACKING"]}
    assert {report["frames_dropped_before"] for report in reports} >= {0, 1}
    reasons = 0
    for report in reports:
        reasons |= report["reasons"]
    assert reasons & (0x04 | 0x40 | 0x800 | 0x10) == 0x04 | 0x40 | 0x800 | 0x10
    assert max(abs(report["rate_z"]) for report in reports) > 1e-3


def test_classic_frames_on_a_bus_of_can_fd() -> None:
    bench = RUNS["fd"]()
    flags = {(record[0] << 24 | int.from_bytes(record[1:4], "big"), record[5]) for _, record in bench.groups}
    assert {(0x18A, 0), (0x28A, 0), (0x38A, 0), (0x48A, 0), (0x50A, 0), (0x70A, 0)} < flags
    assert {flag for number, flag in flags if number == 0x58A} == {5}


@pytest.mark.parametrize(
    ("attitude", "rates", "status", "time"), [(1, 2, 3, 4), (0, 0, 0, 0), (5, 1, 0, 1000), (0, 3, 2, 0)]
)
def test_periods(attitude: int, rates: int, status: int, time: int) -> None:
    section = {
        "attitude_frames": attitude, "rates_frames": rates, "status_frames": status, "time_frames": time,
        "heartbeat_ms": 0,
    }  # fmt: skip
    bench = make_can(can_section=section).boot()
    bench.to_mode("TRACKING")
    bench.run(3000)
    indices = [report["frame_index"] for report in bench.of("attitude_report")]
    assert indices == list(range(indices[0], indices[0] + len(indices)))
    assert len(indices) >= 12
    for kind, interval in zip(KINDS, (attitude, attitude, rates, status, time), strict=True):
        wanted = [index for index in indices if interval and index % interval == 0]
        assert [values["counter"] for _, values in bench.frames(kind)] == wanted, kind
    assert bench.frames("heartbeat") == []


def test_without_attitude_reports_the_frames_still_come() -> None:
    bench = make_can().boot()
    bench.set_parameters(attitude_report=0)
    bench.forget()
    bench.to_mode("TRACKING")
    bench.run(2000)
    assert bench.of("attitude_report") == []
    for kind in KINDS:
        counters = [values["counter"] for _, values in bench.frames(kind)]
        assert len(counters) >= 8
        assert counters == list(range(counters[0], counters[0] + len(counters)))
    assert any(values["valid"] for _, values in bench.frames("status"))


def test_the_counter_turns_over() -> None:
    bench = make_can(can_section={"heartbeat_ms": 0}).boot()
    bench.run_to(252 * PERIOD_MS + 10)
    bench.to_mode("TRACKING")
    bench.run_to(260 * PERIOD_MS)
    wanted = [253, 254, 255, 0, 1, 2]
    indices = [report["frame_index"] for report in bench.of("attitude_report")]
    assert indices[:6] == list(range(253, 259))
    for kind in KINDS:
        assert [values["counter"] for _, values in bench.frames(kind)][:6] == wanted


# -- heartbeat --------------------------------------------------------------------------------------------

BEAT_MS = 40


def beating(**arguments: Any) -> CanBench:
    section = {"heartbeat_ms": BEAT_MS} | arguments.pop("can_section", {})
    return make_can(can_section=section, **arguments)


def test_heartbeats_from_the_end_of_the_boot_at_their_period() -> None:
    bench = beating()
    bench.run_to(400)
    assert bench.groups == []
    bench.run_to(30_000)
    beats = [item for item in bench.peer.frames if item[1] == 0x70A]
    assert len(beats) == len(bench.peer.frames) == (30_000 - 400) // BEAT_MS
    waited_ns = []
    for number, (t_ns, _, payload) in enumerate(beats):
        due_ns = (400 + number * BEAT_MS) * MS
        uptime_s = due_ns // 10**9
        assert payload == bytes([number & 0xFF, 2, 0, 1]) + uptime_s.to_bytes(4, "big")
        waited_ns.append(t_ns - due_ns - classic_bits(0x70A, payload) * 1000)
    # The boot event and the housekeeping of each second may be on the bus before.
    assert min(waited_ns) == 0
    assert max(waited_ns) < 1.5 * MS
    assert waited_ns.count(0) >= len(beats) - 31


def test_a_heartbeat_in_each_mode_and_none_in_boot_and_off() -> None:
    bench = beating(detection={"blinded_background_dn": 300}, timing={"self_test_ms": 400})
    bench.run(500)

    def modes(run_ms: float) -> list[int]:
        bench.run(5)
        bench.forget()
        bench.run(run_ms)
        return [values["mode"] for _, values in bench.frames("heartbeat")]

    count = 200 // BEAT_MS
    assert modes(200) == [MODE["STANDBY"]] * count
    bench.to_mode("SELF_TEST")
    assert modes(200) == [MODE["SELF_TEST"]] * count
    bench.run(600)
    bench.to_mode("TRACKING")
    assert modes(200) == [MODE["TRACKING"]] * count
    assert {values["attitude_valid"] for _, values in bench.frames("heartbeat")} == {1}
    bench.set_parameters(blinded_background_dn=1)
    bench.run_until(lambda: bench.emulator.device.mode == MODE["LOST_IN_SPACE"])
    assert modes(200) == [MODE["LOST_IN_SPACE"]] * count
    assert {values["attitude_valid"] for _, values in bench.frames("heartbeat")} == {0}
    assert {values["time_set"] for _, values in bench.frames("heartbeat")} == {0}
    bench.send("set_time", {"time": (2_000_000_000, 0)}, ack=0)
    bench.run(300)
    bench.to_mode("FAULT")
    assert modes(200) == [MODE["FAULT"]] * count
    assert {values["time_set"] for _, values in bench.frames("heartbeat")} == {1}
    assert {values["boot_count"] for _, values in bench.frames("heartbeat")} == {1}
    bench.function("RESET", {"kind": 0}, ack=0)
    bench.run_until(lambda: bench.emulator.device.mode == MODE["BOOT"])
    assert modes(390) == []
    assert bench.groups == []
    bench.run(100)
    _, first = bench.frames("heartbeat")[0]
    assert (first["counter"], first["mode"], first["boot_count"], first["uptime_s"]) == (0, 2, 2, 0)
    assert first["time_set"] == 1, "a warm reset keeps the time"
    bench.function("SHUTDOWN", ack=0)
    bench.run_until(lambda: bench.emulator.device.mode == MODE["OFF"])
    bench.run(2)
    bench.forget()
    bench.run(3000)
    assert bench.groups == []


def test_one_that_cannot_leave_is_replaced_and_counted() -> None:
    bench = beating().boot()
    bench.run_to(1000 + BEAT_MS / 2)
    before = bench.frames("heartbeat")[-1][1]["counter"]
    bench.refusing = True
    bench.run(25 * BEAT_MS)
    bench.refusing = False
    bench.forget()
    bench.run(2)
    ((_, values),) = bench.frames("heartbeat")
    assert values["counter"] == (before + 25) & 0xFF, "the newest alone"
    structure = bench.can()
    assert structure["cyclic_overruns"] == 24
    assert structure["tx_refused"] == bench.refused > 900, "it was offered again each millisecond"


def test_one_on_the_wire_is_not_replaced() -> None:
    bench = beating().boot()
    bench.run_to(1119)
    due_ms = 1120 + BEAT_MS  # of the heartbeat behind the one that comes up in a moment
    urgent = record(0x001, b"")
    for _ in range(int((due_ms - bench.now_ms - 0.02) * 1000) // classic_bits(0x001, b"")):
        bench.put(urgent)
    bench.forget()
    while not bench.frames("heartbeat"):
        bench.run(0.01)
    assert due_ms < bench.now_ms < due_ms + 0.15, "it was on the wire when the next one came"
    bench.refusing = True
    bench.run_to(due_ms + BEAT_MS + 10)
    bench.refusing = False
    bench.run(5)
    counters = [values["counter"] for _, values in bench.frames("heartbeat")]
    assert counters == [counters[0], counters[0] + 2], "the one behind it was"
    assert bench.can()["cyclic_overruns"] == 1


def test_halves_of_a_quaternion_are_replaced_each_for_itself() -> None:
    """Neither is ever sent with the counter of another image."""
    bench = make_can(can_section={"heartbeat_ms": 0}).boot()
    bench.to_mode("TRACKING")
    bench.run(500)
    before = bench.can()["cyclic_overruns"]
    bench.refusing = True
    bench.run(4 * PERIOD_MS)
    bench.refusing = False
    bench.forget()
    bench.run(100)
    (one,), (other,) = bench.frames("attitude_1"), bench.frames("attitude_2")
    assert one[1]["counter"] == other[1]["counter"]
    assert bench.can()["cyclic_overruns"] - before == 3 * len(KINDS)
