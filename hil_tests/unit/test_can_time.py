"""SYNC and the time that follows it: latched at the last bit, in force at the next frame start."""

from typing import Any

import pytest

from hil_tests.vectors import reference_can_frames as cyclic
from hil_tests.vectors.reference_can import classic_bits, remote_record

from .conftest import MODE, MS, WIDE, CanBench, make_can

PERIOD_MS = 250
TICK_NS = 1e9 / 2**24
SUPERSEDED = 15
PAUSE_BITS = 3  # of the intermission, which belongs to no frame


def ns_of(time: tuple[int, int]) -> float:
    return time[0] * 1e9 + time[1] * TICK_NS


def quiet(**arguments: Any) -> CanBench:
    bench = make_can(**arguments).boot()
    assert isinstance(bench, CanBench)
    bench.run_to(1010)
    bench.forget()
    return bench


def sync(bench: CanBench, payload: bytes = b"\x07") -> int:
    """Put a SYNC on the idle bus; the time of its last bit (ns)."""
    identifier = bench.identifier("sync")
    bits = classic_bits(identifier, payload, extended=bench.peer.extended)
    bitrate = bench.emulator.dialect.port.settings.bus.bitrate
    bench.put_frame("sync", payload)
    return bench.emulator.now_ns + (bits - PAUSE_BITS) * 10**9 // bitrate


def time_at_sync(bench: CanBench, seconds: int, fine: int, counter: int = 7) -> None:
    raw = {"sync_counter": counter, "seconds": seconds, "fraction": fine}
    bench.put_frame("time_at_sync", cyclic.encode("time_at_sync", raw))


def told(bench: CanBench) -> tuple[int, int]:
    """The counter and the time (in ticks) of the one answer to a SYNC."""
    ((_, values),) = bench.frames("sync_time")
    return values["sync_counter"], values["seconds"] * 2**24 + round(values["fraction"] * 2**24)


@pytest.mark.parametrize("bitrate", [1_000_000, 125_000, 50_000])
@pytest.mark.parametrize("section", [{}, WIDE], ids=["11 bits", "29 bits"])
def test_the_time_at_the_last_bit(bitrate: int, section: dict[str, Any]) -> None:
    bench = quiet(can_section={"bitrate": bitrate, **section})
    last_bit_ns = sync(bench)
    bench.run(20)
    counter, ticks = told(bench)
    assert counter == 7
    assert ticks == last_bit_ns * 2**24 // 10**9, "to the tick of 60 ns"


def test_its_answer_leaves_next() -> None:
    bench = quiet()
    last_bit_ns = sync(bench)
    bench.run(5)
    ((t_ns, identifier, payload),) = bench.peer.frames
    assert identifier == 0x40A
    assert t_ns == last_bit_ns + (PAUSE_BITS + classic_bits(0x40A, payload)) * 1000


def test_the_load_of_the_bus_does_not_matter() -> None:
    """The unit's own transfer is under way, SYNC wins the bus behind the frame that is on it."""
    bench = quiet()
    bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 1024}, ack=0)
    bench.run(5)
    assert bench.emulator.dialect.port.bus.state == 0
    put_ns = bench.emulator.now_ns
    sync(bench)
    bench.run(5)
    latched_ns = told(bench)[1] * TICK_NS
    ends = [t_ns for t_ns, _ in bench.groups if t_ns >= put_ns]
    start_ns = ends[0]  # the frame that was on the bus when SYNC came
    assert start_ns - put_ns < 135_000
    bits = classic_bits(0x080, b"\x07")
    assert latched_ns == pytest.approx(start_ns + (bits - PAUSE_BITS) * 1000, abs=61)


def test_an_empty_sync_counts_as_0() -> None:
    bench = quiet()
    sync(bench, b"")
    bench.run(5)
    assert told(bench)[0] == 0
    time_at_sync(bench, 1000, 0, counter=0)
    bench.run(300)
    assert len(bench.events("TIME_SET")) == 1
    assert bench.can()["syncs"] == 1


@pytest.mark.parametrize("fine", [0, 1, 0xABCDEF, 0xFFFFFF])
def test_time_at_sync_sets_the_time_at_the_next_frame_start(fine: int) -> None:
    bench = quiet()
    last_bit_ns = sync(bench)
    bench.run(60)
    time_at_sync(bench, 2_000_000_000, fine)
    bench.run_to(5 * PERIOD_MS - 1)
    assert bench.events("TIME_SET") == []
    assert bench.emulator.device.time.synchronised is False
    bench.run_to(5 * PERIOD_MS + 20)
    (event,) = bench.events("TIME_SET")
    frame_start_ns = 5 * PERIOD_MS * MS
    assert ns_of(event["old"]) == pytest.approx(frame_start_ns, abs=2 * TICK_NS)
    # Whole ticks, as float64 resolves 256 ns here.
    ticks = (event["new"][0] - 2_000_000_000) * 2**24 + event["new"][1] - fine
    elapsed = (frame_start_ns - last_bit_ns) * 2**24 / 10**9
    assert abs(ticks - elapsed) <= 1
    (packet,) = [item for item in bench.packets if item.fields.get("event_id") == 12]
    assert packet.decoded["time_status"] == 1
    assert packet.decoded["time"] == event["new"]
    structure = bench.can()
    assert (structure["syncs"], structure["syncs_ignored"]) == (1, 0)


def test_sync_and_telecommand_tell_the_same_time_from_then_on() -> None:
    """After the setting, a SYNC's answer is the given time plus what has passed between the two SYNCs."""
    bench = quiet()
    first_ns = sync(bench)
    bench.run(10)
    time_at_sync(bench, 5000, 1 << 23)
    bench.run_to(5000)
    bench.forget()
    second_ns = sync(bench, b"\x08")
    bench.run(5)
    elapsed = (second_ns - first_ns) * 2**24 / 10**9
    assert abs(told(bench)[1] - (5000 * 2**24 + (1 << 23)) - elapsed) <= 1


IGNORED = {
    "another counter": lambda bench: (sync(bench), bench.run(10), time_at_sync(bench, 9, 9, counter=8)),
    "no SYNC": lambda bench: time_at_sync(bench, 9, 9),
    "too late": lambda bench: (sync(bench), bench.run(1001), time_at_sync(bench, 9, 9)),
    "another SYNC since": lambda bench: (
        sync(bench), bench.run(10), sync(bench, b"\x08"), bench.run(10), time_at_sync(bench, 9, 9),
    ),
    "7 bytes": lambda bench: (sync(bench), bench.put_frame("time_at_sync", b"\x07" + bytes(6))),
    "empty": lambda bench: (sync(bench, b""), bench.put_frame("time_at_sync", b"")),
    "a SYNC of 2 bytes": lambda bench: bench.put_frame("sync", b"\x07\x07"),
}  # fmt: skip


@pytest.mark.parametrize("kind", IGNORED)
def test_ignored_and_counted(kind: str) -> None:
    bench = quiet()
    IGNORED[kind](bench)
    bench.run(600)
    assert bench.events("TIME_SET") == []
    structure = bench.can()
    assert structure["syncs_ignored"] == 1
    assert structure["syncs"] == {"no SYNC": 0, "another SYNC since": 2, "a SYNC of 2 bytes": 0}.get(kind, 1)
    assert len(bench.frames("sync_time")) == structure["syncs"]
    assert bench.emulator.device.time.synchronised is False
    sync(bench)
    bench.run(1)
    time_at_sync(bench, 9, 9)
    bench.run(300)
    assert len(bench.events("TIME_SET")) == 1, "the next good one is taken"


def test_just_in_time() -> None:
    bench = quiet()
    sync(bench)
    bench.run(999)
    time_at_sync(bench, 9, 9)
    bench.run(300)
    assert len(bench.events("TIME_SET")) == 1


def test_a_remote_frame_is_no_sync() -> None:
    bench = quiet()
    bench.peer.outbox.append(remote_record(0x080, 1))
    bench.peer.outbox.append(remote_record(0x60A, 8))
    bench.run(10)
    assert bench.groups == []
    structure = bench.can()
    assert (structure["syncs"], structure["syncs_ignored"], structure["frames_ignored"]) == (0, 0, 0)


def test_not_in_self_test_where_set_time_is_refused() -> None:
    bench = quiet()
    bench.to_mode("SELF_TEST")
    bench.forget()
    last_bit_ns = sync(bench)
    bench.run(10)
    assert told(bench)[1] == last_bit_ns * 2**24 // 10**9, "clocks can be compared in every mode"
    time_at_sync(bench, 9, 9)
    bench.run(300)
    assert bench.emulator.device.mode == MODE["SELF_TEST"]
    assert bench.events("TIME_SET") == []
    assert bench.can()["syncs_ignored"] == 1


def test_nothing_in_boot() -> None:
    bench = make_can()
    bench.run(100)
    sync(bench)
    bench.run(10)
    time_at_sync(bench, 9, 9)
    bench.run(800)
    assert bench.frames("sync_time") == bench.events("TIME_SET") == []
    counters = bench.emulator.dialect.cyclic.housekeeping()
    assert (counters["syncs"], counters["syncs_ignored"]) == (0, 0)
    # The receiver was off: only the OBC's flow control since is counted.
    assert counters["rx_frames"] == len(bench.peer.said) > 0


def test_it_supersedes_a_set_time_that_waits() -> None:
    bench = quiet()
    count = bench.send("set_time", {"time": (1000, 0)})
    bench.run(20)
    sync(bench)
    bench.run(20)
    time_at_sync(bench, 3_000_000_000, 0)
    bench.run_to(5 * PERIOD_MS + 20)
    assert bench.stages(count) == ["acceptance_success", "start_success", "completion_failure"]
    assert bench.failure(count) == ("completion_failure", SUPERSEDED, 0)
    (event,) = bench.events("TIME_SET")
    assert event["new"][0] == 3_000_000_000


def test_a_set_time_supersedes_it() -> None:
    bench = quiet()
    sync(bench)
    bench.run(20)
    time_at_sync(bench, 3_000_000_000, 0)
    bench.run(20)
    count = bench.send("set_time", {"time": (1000, 0)})
    bench.run_to(5 * PERIOD_MS + 20)
    assert bench.stages(count) == ["acceptance_success", "start_success", "completion_success"]
    (event,) = bench.events("TIME_SET")
    assert event["new"][0] == 1000


def test_set_time_by_packet_counts_from_its_last_bit() -> None:
    bench = quiet()
    packet = bench.packet("set_time", {"time": (2_000_000_000, 0)}, ack=0)
    bench.put_packet(packet)
    bench.run(5)
    ((answered_ns, _),) = bench.groups  # the unit's flow control, at the end of its pause
    rest = [packet[6:13], packet[13:]]
    consecutive = [(bytes([0x21 + n]) + part).ljust(8, b"\x55") for n, part in enumerate(rest)]
    last_bit_ns = answered_ns + (sum(classic_bits(0x60A, data) for data in consecutive) - PAUSE_BITS) * 1000
    bench.run(300)
    (event,) = bench.events("TIME_SET")
    ticks = (event["new"][0] - 2_000_000_000) * 2**24 + event["new"][1]
    assert abs(ticks - (5 * PERIOD_MS * MS - last_bit_ns) * 2**24 / 10**9) <= 1
