"""The CAN bus in virtual time: who goes first, how long it takes, how full the bus is; without faults."""

from __future__ import annotations

from fractions import Fraction
from itertools import count

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_tests.unit.can_bench import CanBench, Log
from st_emulator.protocol import LocalProtocolError
from st_emulator.protocol.can.bits import frame_duration_ns
from st_emulator.protocol.can.frames import CanFrame
from st_emulator.wire.can import bus as can_bus

MS = 1_000_000
BARE_NS = 111_000  # of the frames below at 1 Mbit/s: nothing to stuff in them


def bare(identifier: int = 0x5A5) -> CanFrame:
    return CanFrame(identifier, b"\x55" * 8)


def timed(frame: CanFrame, bitrate: int = 1_000_000, data_bitrate: int = 4_000_000) -> int:
    return frame_duration_ns(frame, bitrate, data_bitrate)


def test_a_frame_of_ours_leaves_when_its_bits_are_over() -> None:
    bench = CanBench()
    bench.at(5_000, lambda: bench.send(bare()))
    bench.advance(5_000 + BARE_NS - 1)
    assert bench.log == []
    assert bench.bus.queued_frames == 1
    bench.advance(5_000 + BARE_NS)
    assert bench.log == [(5_000 + BARE_NS, "sent", bare()), (5_000 + BARE_NS, "told", bare())]
    assert bench.bus.queued_frames == 0
    assert bench.bus.counters == can_bus.CanBusCounters(tx_frames=1)


def test_a_frame_of_another_is_received_when_its_bits_are_over() -> None:
    bench = CanBench()
    bench.at(5_000, lambda: bench.bus.arrive(bare()))
    bench.advance(MS)
    assert bench.log == [(5_000 + BARE_NS, "received", bare())]
    assert bench.bus.counters == can_bus.CanBusCounters(rx_frames=1)


def test_the_rate_of_the_data_phase_counts() -> None:
    frame = CanFrame(0x5A5, b"\x55" * 64, fd=True, bit_rate_switch=True)
    bench = CanBench(bitrate=500_000, data_bitrate=2_000_000)
    bench.bus.arrive(frame)
    bench.advance(MS)
    assert bench.log == [(58_000 + 275_000, "received", frame)]


def test_of_one_instant_the_lowest_identifier_goes_first() -> None:
    bench = CanBench()
    low, middle, high = bare(0x155), bare(0x2A5), bare(0x5A5)
    bench.send(high)
    bench.bus.arrive(middle)
    bench.send(low)
    bench.advance(MS)
    starts = timed(low), timed(middle), timed(high)
    assert bench.seen("sent", "received") == [
        (starts[0], "sent", low),
        (starts[0] + starts[1], "received", middle),
        (sum(starts), "sent", high),
    ]
    assert bench.bus.counters.arbitration_lost == 1  # high against middle; low against high was among ours


def test_a_frame_on_the_wire_is_not_interrupted() -> None:
    bench = CanBench()
    bench.send(bare(0x5A5))
    bench.at(1, lambda: bench.bus.arrive(bare(0x155)))
    bench.advance(MS)
    assert [frame.identifier for _, _, frame in bench.seen("sent", "received")] == [0x5A5, 0x155]
    assert bench.bus.counters.arbitration_lost == 0


def test_every_arbitration_lost_counts() -> None:
    bench = CanBench()
    bench.send(bare(0x5A5))
    bench.send(bare(0x6A5))  # the controller takes part with its best frame alone
    for _ in range(3):
        bench.bus.arrive(bare(0x155))
    bench.advance(MS)
    assert bench.bus.counters.arbitration_lost == 3
    delay_ns = 3 * timed(bare(0x155))
    assert bench.seen("sent")[0] == (delay_ns + BARE_NS, "sent", bare(0x5A5))


def test_formats_that_share_their_first_bits() -> None:
    bench = CanBench()
    base = 0x2A5
    ordered = [
        CanFrame(base, b"\x01"),
        CanFrame(base, remote=True),
        CanFrame(base << 18, b"\x01", extended=True),
        CanFrame((base << 18) + 1, b"\x01", extended=True),
        CanFrame(base + 1, b"\x01"),
    ]
    for frame in reversed(ordered):
        bench.bus.arrive(frame)
    bench.advance(10 * MS)
    assert [frame for _, _, frame in bench.log] == ordered


def test_what_is_sent_on_a_frames_end_competes_for_the_next_place() -> None:
    bench = CanBench()
    first, second, other = bare(0x155), bare(0x2A5), bare(0x5A5)
    bench.bus.send(first, lambda: bench.send(second))
    bench.bus.arrive(other)
    bench.advance(MS)
    order = [frame.identifier for _, kind, frame in bench.log if kind != "told"]
    assert order == [0x155, 0x2A5, 0x5A5]


def test_error_messages_cannot_be_sent() -> None:
    with pytest.raises(LocalProtocolError):
        CanBench().bus.send(CanFrame(0x40, bytes(8), error=True))


# -- against a simulation that goes from frame to frame instead of from event to event

IDENTIFIERS = [(0x0A0, False), (0x155, False), (0x155 << 18, True), (0x5A5, False), (0x7FF, False)]
STEP = st.tuples(st.integers(0, 400_000), st.booleans(), st.sampled_from(IDENTIFIERS), st.integers(0, 6))


def program_of(steps: list) -> list[tuple[int, bool, CanFrame]]:
    """(time, ours, frame), by time; every frame is told apart by a serial number in its data."""
    now_ns, serial, program = 0, count(), []
    for gap_ns, ours, (identifier, extended), more in steps:
        now_ns += gap_ns // 1000 * 1000  # ends of frames fall on such times: ties come up
        data = next(serial).to_bytes(2, "big") + bytes(more)
        program.append((now_ns, ours, CanFrame(identifier, data, extended)))
    return program


def simulated(program: list, bitrate: int = 1_000_000) -> tuple[Log, int, list[tuple[int, int]]]:
    log: Log = []
    occupied = []
    waiting: list[tuple] = []
    now_ns = index = lost = 0
    while index < len(program) or waiting:
        if not waiting:
            now_ns = max(now_ns, program[index][0])
        while index < len(program) and program[index][0] <= now_ns:
            _, ours, frame = program[index]
            bits = f"{frame.identifier:011b}000" if not frame.extended else None
            if bits is None:
                text = f"{frame.identifier:029b}"
                bits = f"{text[:11]}11{text[11:]}"
            waiting.append((bits, index, ours, frame))
            index += 1
        winner = min(waiting)
        lost += not winner[2] and any(ours for _, _, ours, _ in waiting)
        waiting.remove(winner)
        end_ns = now_ns + timed(winner[3], bitrate)
        occupied.append((now_ns, end_ns))
        log.append((end_ns, "sent" if winner[2] else "received", winner[3]))
        now_ns = end_ns
    return log, lost, occupied


def run(program: list, steps_ns: list[int], bitrate: int = 1_000_000) -> CanBench:
    bench = CanBench(bitrate=bitrate)
    for at_ns, ours, frame in program:
        bench.at(at_ns, lambda frame=frame, ours=ours: (bench.send if ours else bench.bus.arrive)(frame))
    for step_ns in steps_ns:
        bench.advance(bench.clock.now_ns + step_ns)
    bench.advance(10**10)
    return bench


@given(st.lists(STEP, max_size=40), st.lists(st.integers(0, 2_000_000), max_size=20))
@settings(max_examples=200)
def test_any_traffic(steps: list, advances_ns: list[int]) -> None:
    program = program_of(steps)
    expected, lost, _ = simulated(program)
    bench = run(program, advances_ns)
    assert bench.seen("sent", "received") == expected
    assert bench.bus.counters.arbitration_lost == lost
    assert bench.bus.counters.tx_frames == sum(ours for _, ours, _ in program)
    assert bench.bus.counters.rx_frames == sum(not ours for _, ours, _ in program)
    # on_sent once for each, at the same time
    told = [(at_ns, frame) for at_ns, kind, frame in bench.log if kind == "told"]
    assert told == [(at_ns, frame) for at_ns, kind, frame in expected if kind == "sent"]
    # of one identifier in the order of the calls, each way
    for ours in (True, False):
        for identifier, _ in IDENTIFIERS:
            asked = [f for _, own, f in program if own == ours and f.identifier == identifier]
            kind = "sent" if ours else "received"
            assert [f for _, k, f in bench.log if k == kind and f.identifier == identifier] == asked


@given(st.lists(STEP, max_size=60), st.sampled_from([10_000, 20_000, 1_000_000]))
@settings(max_examples=60)
def test_the_load_is_that_of_the_last_whole_second(steps: list, bitrate: int) -> None:
    program = [(at_ns * 200, ours, frame) for at_ns, ours, frame in program_of(steps)]
    _, _, occupied = simulated(program, bitrate)
    bench = CanBench(bitrate=bitrate)
    for at_ns, ours, frame in program:
        bench.at(at_ns, lambda frame=frame, ours=ours: (bench.send if ours else bench.bus.arrive)(frame))
    for second in range(6):
        for within_ns in (0, 1, 400 * MS, 10**9 - 1):
            bench.advance(second * 10**9 + within_ns)
            start, end = (second - 1) * 10**9, second * 10**9
            busy_ns = sum(max(min(b, end) - max(a, start), 0) for a, b in occupied)
            assert abs(bench.bus.load_permille - Fraction(busy_ns, MS)) <= Fraction(1, 2)


def test_a_frame_across_the_second_counts_in_both() -> None:
    bench = CanBench(bitrate=10_000)
    bench.at(10**9 - 3 * MS, lambda: bench.bus.arrive(bare()))  # 11.1 ms
    bench.advance(10**9)
    assert bench.bus.load_permille == 3
    bench.advance(2 * 10**9)
    assert bench.bus.load_permille == 8
    bench.advance(3 * 10**9)
    assert bench.bus.load_permille == 0


def test_a_steady_load_is_shown_second_by_second() -> None:
    bench = CanBench(bitrate=10_000)
    for index in range(100):
        bench.at(index * 200 * MS, lambda: bench.bus.arrive(bare()))
    for second in range(1, 21):
        bench.advance(second * 10**9)
        assert bench.bus.load_permille == 56  # 5 x 11.1 ms
        bench.advance(second * 10**9 + 950 * MS)
        assert bench.bus.load_permille == 56


def test_a_full_bus_has_a_load_of_1000() -> None:
    bench = CanBench(bitrate=125_000)

    def again() -> None:
        bench.bus.send(bare(), again)

    again()
    assert bench.bus.load_permille == 0
    bench.advance(2_500 * MS)
    assert bench.bus.load_permille == 1000
    assert bench.bus.counters.tx_frames == 2_500 * MS // (8 * BARE_NS)


# -- taking back, restart, not listening, too much


def test_frames_that_wait_can_be_taken_back() -> None:
    bench = CanBench()
    on_wire = bench.send(bare(0x155))
    waiting = [bench.send(bare(0x2A5)), bench.send(bare(0x2A5)), bench.send(bare(0x5A5))]
    bench.advance(1_000)
    assert not bench.bus.cancel(on_wire)
    assert bench.bus.cancel(waiting[0])
    assert not bench.bus.cancel(waiting[0])
    assert not bench.bus.cancel(12345)
    bench.advance(MS)
    assert not bench.bus.cancel(waiting[1])  # it has left
    assert [frame.identifier for _, _, frame in bench.seen("told")] == [0x155, 0x2A5, 0x5A5]
    assert [frame.identifier for _, _, frame in bench.seen("sent")] == [0x155, 0x2A5, 0x5A5]


def test_all_taken_back_leaves_the_bus_idle() -> None:
    bench = CanBench()
    handles = [bench.send(bare(0x155)), bench.send(bare(0x2A5))]
    assert all(bench.bus.cancel(handle) for handle in handles)
    bench.advance(MS)
    assert bench.log == []
    bench.send(bare())
    bench.advance(2 * MS)
    assert bench.seen("sent") == [(MS + BARE_NS, "sent", bare())]


def test_a_restart_completes_what_is_on_the_wire_and_forgets_the_rest() -> None:
    bench = CanBench()
    bench.send(bare(0x155))
    bench.send(bare(0x2A5))
    bench.bus.arrive(bare(0x5A5))
    bench.advance(1_000)
    bench.bus.reset()
    assert bench.bus.queued_frames == 0
    bench.send(bare(0x6A5))
    bench.advance(10 * MS)
    order = [(kind, frame.identifier) for _, kind, frame in bench.log]
    assert order == [("sent", 0x155), ("received", 0x5A5), ("sent", 0x6A5), ("told", 0x6A5)]


def test_a_unit_that_does_not_listen_receives_nothing_and_the_bus_is_as_full() -> None:
    bench = CanBench()
    bench.bus.listening = False
    for _ in range(100):
        bench.bus.arrive(bare())
    bench.advance(10**9)
    assert bench.log == []
    assert bench.bus.counters.rx_frames == 0
    assert bench.bus.load_permille == 11  # 11.1 ms
    bench.bus.listening = True
    bench.bus.arrive(bare(0x155))
    bench.advance(2 * 10**9)
    assert [frame.identifier for _, _, frame in bench.log] == [0x155]


def test_frames_of_others_beyond_the_most_are_lost_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    assert can_bus.MOST_PENDING_FRAMES == 65_536
    monkeypatch.setattr(can_bus, "MOST_PENDING_FRAMES", 16)
    bench = CanBench()
    for serial in range(20):
        bench.bus.arrive(CanFrame(0x5A5, bytes([serial])))
    bench.advance(100 * MS)
    assert [frame.data[0] for _, _, frame in bench.seen("received")] == list(range(16))
    assert bench.bus.counters.rx_overruns == 4
    bench.bus.arrive(bare())
    bench.advance(200 * MS)
    assert bench.log[-1][2] == bare()


# -- a link that cannot take a frame now


def test_a_refused_frame_is_offered_each_millisecond_in_its_order() -> None:
    bench = CanBench()
    bench.refusals = 3
    first, second, urgent, other = bare(0x2A5), bare(0x5A5), bare(0x155), bare(0x7A5)
    bench.send(first)
    bench.send(second)
    bench.at(1, lambda: bench.send(urgent))
    bench.at(2, lambda: bench.bus.arrive(other))
    bench.advance(10 * MS)
    end_ns = timed(first)
    accepted_ns = end_ns + 3 * MS
    assert bench.log == [
        *((end_ns + index * MS, "refused", first) for index in range(1)),
        (end_ns + timed(other), "received", other),  # the bus goes on
        *((end_ns + index * MS, "refused", first) for index in range(1, 3)),
        (accepted_ns, "sent", first),
        (accepted_ns, "told", first),
        (accepted_ns + timed(urgent), "sent", urgent),
        (accepted_ns + timed(urgent), "told", urgent),
        (accepted_ns + timed(urgent) + timed(second), "sent", second),
        (accepted_ns + timed(urgent) + timed(second), "told", second),
    ]
    assert bench.bus.counters.tx_refused == 3
    assert bench.bus.counters.tx_frames == 3


def test_a_link_that_takes_nothing_costs_no_bus_time_and_the_frame_can_be_taken_back() -> None:
    bench = CanBench()
    bench.refusals = 10**9
    handle = bench.send(bare(0x155))
    bench.send(bare())
    bench.advance(10**9)
    assert bench.bus.load_permille == 0  # 0.1 of it
    assert bench.bus.counters.tx_refused == 1000
    assert bench.bus.cancel(handle)
    bench.refusals = 0
    bench.advance(2 * 10**9)
    assert bench.seen("sent") == [(10**9 + BARE_NS, "sent", bare())]
    assert bench.bus.counters.tx_refused == 1000


def test_a_restart_forgets_a_refused_frame() -> None:
    bench = CanBench()
    bench.refusals = 1
    bench.send(bare(0x155))
    bench.advance(MS)
    bench.bus.reset()
    bench.send(bare())
    bench.advance(10 * MS)
    assert [frame for _, _, frame in bench.seen("sent")] == [bare()]
    # ... and one that is refused at the end of its bits, the restart lying within them
    bench.refusals = 1
    bench.send(bare(0x155))
    bench.advance(bench.clock.now_ns + 1_000)
    bench.bus.reset()
    bench.send(bare())
    bench.advance(30 * MS)
    assert [frame for _, _, frame in bench.seen("sent")] == [bare(), bare()]


# -- a real bus behind the link


def test_on_hardware_a_frame_goes_over_at_its_start() -> None:
    bench = CanBench(hardware=True)
    bench.at(5_000, lambda: bench.send(bare(0x2A5)))
    bench.at(5_000, lambda: bench.send(bare(0x5A5)))
    bench.advance(MS)
    first_ns = timed(bare(0x2A5))
    assert bench.log == [
        (5_000, "sent", bare(0x2A5)),
        (5_000 + first_ns, "told", bare(0x2A5)),
        (5_000 + first_ns, "sent", bare(0x5A5)),
        (5_000 + first_ns + BARE_NS, "told", bare(0x5A5)),
    ]


def test_on_hardware_frames_are_received_at_once_and_hold_nobody_up() -> None:
    bench = CanBench(hardware=True)
    bench.at(100, lambda: [bench.bus.arrive(bare(0x155)) for _ in range(9)])
    bench.at(100, lambda: bench.send(bare()))
    bench.advance(10**9)
    assert bench.seen("received") == [(100, "received", bare(0x155))] * 9
    assert bench.seen("sent") == [(100, "sent", bare())]
    assert bench.bus.load_permille == round((9 * timed(bare(0x155)) + BARE_NS) / MS)
    assert bench.bus.counters.arbitration_lost == 0
    bench.bus.listening = False
    bench.bus.arrive(bare(0x155))
    assert bench.bus.counters.rx_frames == 9


def test_on_hardware_a_refused_frame_has_not_begun() -> None:
    bench = CanBench(hardware=True)
    bench.refusals = 2
    bench.send(bare(0x5A5))
    bench.at(1, lambda: bench.send(bare(0x155)))
    bench.advance(10 * MS)
    urgent_ns = timed(bare(0x155))
    assert bench.log == [
        (0, "refused", bare(0x5A5)),
        (MS, "refused", bare(0x155)),  # in place of the other: nothing of it is on the bus
        (2 * MS, "sent", bare(0x155)),
        (2 * MS + urgent_ns, "told", bare(0x155)),
        (2 * MS + urgent_ns, "sent", bare(0x5A5)),
        (2 * MS + urgent_ns + BARE_NS, "told", bare(0x5A5)),
    ]
    assert bench.bus.counters.tx_refused == 2


def test_a_load_above_the_bus_is_shown_as_full() -> None:
    bench = CanBench(hardware=True)
    for _ in range(20_000):  # read late, after a stop of the program
        bench.bus.arrive(bare())
    bench.advance(10**9)
    assert bench.bus.load_permille == 1000
