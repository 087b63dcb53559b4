"""Faults of the CAN bus: destroyed frames, error passive, bus-off and back, what a real controller says."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_tests.unit.can_bench import CanBench
from st_emulator.protocol.can.frames import CanFrame
from st_emulator.protocol.pus.enumerations import CanState
from st_emulator.wire.can.bus import BusError, Disturbance

ACTIVE, PASSIVE, OFF = CanState.ERROR_ACTIVE, CanState.ERROR_PASSIVE, CanState.BUS_OFF
US, MS = 1_000, 1_000_000
FRAME = CanFrame(0x5A5, b"\x55" * 8)  # 111 bits, nothing to stuff
BITS = 111
BIT_ERROR_BITS = BITS - 12 + 23  # up to the CRC delimiter, then flags, delimiter and intermission
ACK_ERROR_BITS = BITS - 11 + 23
RECOVERY_US = 100_000 + 128 * 11


class Faults:
    """Destroys what ``decide`` says, and writes down every attempt."""

    def __init__(self, decide: Disturbance) -> None:
        self.decide = decide
        self.attempts: list[tuple[int, bool, CanFrame]] = []

    def __call__(self, frame: CanFrame, own: bool, now_ns: int) -> BusError | None:
        self.attempts.append((now_ns, own, frame))
        return self.decide(frame, own, now_ns)

    def starts_us(self) -> list[int]:
        return [at_ns // US for at_ns, _, _ in self.attempts]


def first(errors: int, error: BusError = BusError.BIT, *, own: bool = True) -> Faults:
    left = [errors]

    def decide(frame: CanFrame, ours: bool, now_ns: int) -> BusError | None:
        if ours != own or not left[0]:
            return None
        left[0] -= 1
        return error

    return Faults(decide)


def message(classes: int, **details: int) -> CanFrame:
    data = bytearray(8)
    for index, value in details.items():
        data[int(index.removeprefix("d"))] = value
    return CanFrame(classes, bytes(data), error=True)


# -- frames of ours


def test_a_destroyed_frame_is_sent_again_at_once() -> None:
    faults = first(2)
    bench = CanBench(disturbance=faults)
    bench.send(FRAME)
    bench.advance(MS)
    assert faults.starts_us() == [0, BIT_ERROR_BITS, 2 * BIT_ERROR_BITS]
    end_ns = (2 * BIT_ERROR_BITS + BITS) * US
    assert bench.log == [(end_ns, "sent", FRAME), (end_ns, "told", FRAME)]
    assert bench.bus.counters.error_frames == 2
    assert bench.bus.counters.tx_frames == 1
    assert bench.bus.transmit_error_count == 8 + 8 - 1
    assert bench.states == []


def test_a_frame_that_is_more_urgent_passes_a_destroyed_one() -> None:
    bench = CanBench(disturbance=first(1))
    urgent = CanFrame(0x155, b"\x55" * 8)
    bench.send(FRAME)
    bench.at(1, lambda: bench.bus.arrive(urgent))
    bench.advance(MS)
    assert [frame for _, _, frame in bench.seen("sent", "received")] == [urgent, FRAME]
    assert bench.bus.counters.arbitration_lost == 1


def test_an_error_passive_sender_waits_eight_bits_behind_its_own_frames() -> None:
    faults = first(17)
    bench = CanBench(disturbance=faults)
    bench.send(FRAME)
    bench.send(FRAME)
    bench.advance(10 * MS)
    starts = [index * BIT_ERROR_BITS for index in range(16)]
    starts.append(16 * BIT_ERROR_BITS + 8)  # the sixteenth made it passive
    starts.append(17 * BIT_ERROR_BITS + 16)
    starts.append(17 * BIT_ERROR_BITS + 16 + BITS + 8)  # still: 136 - 1
    assert faults.starts_us() == starts
    assert bench.states == [(16 * BIT_ERROR_BITS * US, ACTIVE, PASSIVE)]
    assert bench.bus.state is PASSIVE
    assert bench.bus.transmit_error_count == 17 * 8 - 2


def test_others_go_first_in_those_eight_bits() -> None:
    other = CanFrame(0x7A5, b"\x55" * 8)
    bench = CanBench(disturbance=first(16))
    bench.send(FRAME)
    passive_us = 16 * BIT_ERROR_BITS
    bench.at(passive_us * US + 7_999, lambda: bench.bus.arrive(other))
    bench.advance(10 * MS)
    assert [frame for _, _, frame in bench.seen("sent", "received")] == [other, FRAME]
    assert bench.bus.counters.arbitration_lost == 0  # it did not take part
    later = CanBench(disturbance=first(16))
    later.send(FRAME)
    later.at(passive_us * US + 8_000, lambda: later.bus.arrive(other))
    later.advance(10 * MS)
    assert [frame for _, _, frame in later.seen("sent", "received")] == [FRAME, other]


def test_good_frames_lead_back_to_error_active() -> None:
    bench = CanBench(disturbance=first(16))
    for _ in range(2):
        bench.send(FRAME)
    bench.advance(10 * MS)
    assert [(before, after) for _, before, after in bench.states] == [(ACTIVE, PASSIVE), (PASSIVE, ACTIVE)]
    assert bench.bus.transmit_error_count == 126


def test_bus_off_and_recovery() -> None:
    faults = first(32)
    bench = CanBench(disturbance=faults)
    bench.send(FRAME)
    bench.advance(10 * MS)
    off_us = 32 * BIT_ERROR_BITS + 16 * 8  # pauses behind the sixteenth to the thirty-first
    assert bench.bus.state is OFF
    assert bench.bus.transmit_error_count == 256
    assert bench.log == []
    assert bench.bus.queued_frames == 1
    # It sends and receives nothing; the bus is as full as ever.
    other = CanFrame(0x155, b"\x55" * 8)
    bench.at(20 * MS, lambda: bench.bus.arrive(other))
    bench.at(20 * MS, lambda: bench.send(other))
    back_us = off_us + RECOVERY_US
    bench.advance(back_us * US - 1)
    assert bench.log == []
    assert bench.bus.state is OFF
    bench.advance(300 * MS)
    assert bench.states == [
        (16 * BIT_ERROR_BITS * US, ACTIVE, PASSIVE),
        (off_us * US, PASSIVE, OFF),
        (back_us * US, OFF, ACTIVE),
    ]
    assert [(at_ns // US, frame) for at_ns, _, frame in bench.seen("sent")] == [
        (back_us + BITS, other),
        (back_us + 2 * BITS, FRAME),
    ]
    assert bench.bus.transmit_error_count == bench.bus.receive_error_count == 0
    counters = bench.bus.counters
    assert (counters.bus_off_count, counters.error_frames, counters.rx_frames) == (1, 32, 0)


@pytest.mark.parametrize(("bitrate", "restart_ms"), [(125_000, 0), (500_000, 20)])
def test_the_time_of_the_recovery_follows_the_settings(bitrate: int, restart_ms: int) -> None:
    bench = CanBench(bitrate=bitrate, bus_off_restart_ms=restart_ms, disturbance=first(32))
    bench.send(FRAME)
    bench.advance(10**9)
    assert [after for _, _, after in bench.states] == [PASSIVE, OFF, ACTIVE]
    _, (off_ns, _, _), (back_ns, _, _) = bench.states
    assert back_ns - off_ns == restart_ms * MS + 128 * 11 * 10**9 // bitrate


def test_a_recovery_that_is_withheld_begins_anew() -> None:
    """As long as there are no recessive bits to count."""
    bench = CanBench(disturbance=first(32))
    held = [True]
    bench.bus._recovers = lambda: not held[0]
    bench.send(FRAME)
    bench.advance(10 * 10**9)
    assert bench.bus.state is OFF
    assert bench.bus.counters.bus_off_count == 1
    held[0] = False
    bench.advance(10 * 10**9 + 128 * 11 * US)
    assert bench.bus.state is ACTIVE
    assert [after for _, _, after in bench.states] == [PASSIVE, OFF, ACTIVE]


def test_a_bus_that_stays_broken_goes_off_again_and_again() -> None:
    bench = CanBench(disturbance=first(10**9))
    bench.send(FRAME)
    bench.advance(10**9)
    period_us = 32 * BIT_ERROR_BITS + 16 * 8 + RECOVERY_US
    assert bench.bus.counters.bus_off_count == 10**6 // period_us + 1
    assert bench.log == []


def test_a_restart_leads_out_of_bus_off() -> None:
    bench = CanBench(disturbance=first(32))
    bench.send(FRAME)
    bench.advance(10 * MS)
    known = list(bench.states)
    bench.bus.reset()
    assert bench.bus.state is ACTIVE
    bench.send(CanFrame(0x155, b"\x55" * 8))
    bench.advance(300 * MS)
    assert [frame.identifier for _, _, frame in bench.seen("sent")] == [0x155]
    assert bench.states == known  # who restarts it knows


def test_a_restart_in_a_destroyed_frame_forgets_it() -> None:
    bench = CanBench(disturbance=first(1))
    bench.send(FRAME)
    bench.advance(10 * US)
    bench.bus.reset()
    bench.advance(10 * MS)
    assert bench.log == []
    assert bench.bus.transmit_error_count == 0


def test_nobody_acknowledges() -> None:
    faults = first(10**9, BusError.ACK)
    bench = CanBench(disturbance=faults)
    bench.send(FRAME)
    bench.advance(1_500 * MS)
    assert [(before, after) for _, before, after in bench.states] == [(ACTIVE, PASSIVE)]
    assert bench.bus.transmit_error_count == 128
    assert bench.bus.counters.bus_off_count == 0
    starts = faults.starts_us()
    assert {b - a for a, b in pairwise(starts[20:])} == {ACK_ERROR_BITS + 8}
    assert bench.bus.load_permille == round(1000 * ACK_ERROR_BITS / (ACK_ERROR_BITS + 8))
    # Somebody is back.
    faults.decide = lambda frame, own, now_ns: None
    bench.advance(1_501 * MS)
    assert [kind for _, kind, _ in bench.log] == ["sent", "told"]
    assert bench.bus.state is ACTIVE


# -- frames of others


@pytest.mark.parametrize("error", list(BusError))
def test_a_destroyed_frame_of_another_comes_again(error: BusError) -> None:
    faults = first(3, error, own=False)
    bench = CanBench(disturbance=faults)
    ordered = [CanFrame(0x5A5, bytes([serial])) for serial in range(4)]
    for frame in ordered:
        bench.bus.arrive(frame)
    bench.advance(10 * MS)
    assert [frame for _, _, frame in bench.seen("received")] == ordered
    assert bench.bus.counters.error_frames == 3
    assert bench.bus.counters.rx_frames == 4
    assert bench.bus.receive_error_count == 0  # three, then four good ones
    assert bench.bus.transmit_error_count == 0
    assert [own for _, own, _ in faults.attempts] == [False] * 7


def test_errors_in_frames_of_others_make_passive_and_a_good_one_active() -> None:
    bench = CanBench(disturbance=first(140, own=False))
    bench.bus.arrive(FRAME)
    bench.advance(128 * BIT_ERROR_BITS * US)
    assert bench.states == [(128 * BIT_ERROR_BITS * US, ACTIVE, PASSIVE)]
    bench.advance(100 * MS)
    assert [(before, after) for _, before, after in bench.states[1:]] == [(PASSIVE, ACTIVE)]
    assert bench.bus.receive_error_count == 127
    assert bench.bus.counters.bus_off_count == 0


def test_who_does_not_listen_counts_no_errors() -> None:
    bench = CanBench(disturbance=first(10, own=False))
    bench.bus.listening = False
    bench.bus.arrive(FRAME)
    bench.advance(10 * MS)
    assert bench.bus.counters.error_frames == 0
    assert bench.bus.receive_error_count == 0


# -- what a driver says


def test_error_messages_are_counted_and_never_received() -> None:
    bench = CanBench(hardware=True)
    for one in (
        message(0x004, d1=0x20),
        message(0x002, d0=5),
        message(0x004, d1=0x01),
        message(0x0A8, d2=0x80),
    ):
        bench.bus.arrive(one)
    bench.advance(MS)
    assert bench.log == []
    counters = bench.bus.counters
    assert (counters.error_frames, counters.arbitration_lost, counters.rx_overruns) == (4, 1, 1)
    assert bench.states == [(0, ACTIVE, PASSIVE)]
    assert bench.bus.transmit_error_count == 128


def test_a_real_controller_says_when_it_is_off_and_back() -> None:
    bench = CanBench(hardware=True)
    bench.send(FRAME)
    bench.at(50 * US, lambda: bench.bus.arrive(message(0x040)))
    bench.at(60 * US, lambda: bench.send(FRAME))
    bench.at(2 * 10**9, lambda: bench.bus.arrive(message(0x100)))
    bench.advance(2 * 10**9 - 1)
    assert bench.bus.state is OFF  # no recovery of our own: it may take a command of the host
    assert len(bench.seen("sent")) == 1
    bench.advance(3 * 10**9)
    assert bench.states == [(50 * US, ACTIVE, OFF), (2 * 10**9, OFF, ACTIVE)]
    assert [at_ns for at_ns, _, _ in bench.seen("sent")] == [0, 2 * 10**9]
    assert bench.bus.counters.bus_off_count == 1


def test_a_frame_received_shows_that_a_real_controller_is_back() -> None:
    bench = CanBench(hardware=True)
    bench.bus.arrive(message(0x040))
    bench.bus.arrive(message(0x040))
    assert bench.bus.counters.bus_off_count == 1
    bench.send(FRAME)
    bench.at(MS, lambda: bench.bus.arrive(FRAME))
    bench.advance(10 * MS)
    assert bench.states == [(0, ACTIVE, OFF), (MS, OFF, ACTIVE)]
    assert [kind for _, kind, _ in bench.log] == ["received", "sent", "told"]


def test_a_refused_frame_waits_for_the_end_of_bus_off() -> None:
    bench = CanBench(hardware=True)
    bench.refusals = 1
    bench.send(FRAME)
    bench.at(1, lambda: bench.bus.arrive(message(0x040)))
    bench.at(500 * MS, lambda: bench.bus.arrive(message(0x100)))
    bench.advance(10**9)
    assert [(at_ns, kind) for at_ns, kind, _ in bench.log] == [
        (0, "refused"),
        (500 * MS, "sent"),
        (500 * MS + BITS * US, "told"),
    ]


def test_bus_off_told_by_the_link_of_a_modelled_bus_recovers_as_ever() -> None:
    bench = CanBench()
    bench.send(FRAME)
    bench.at(50 * US, lambda: bench.bus.arrive(message(0x040)))
    bench.advance(10**9)
    back_us = 50 + RECOVERY_US
    assert bench.states == [(50 * US, ACTIVE, OFF), (back_us * US, OFF, ACTIVE)]
    assert bench.seen("sent") == [((back_us + BITS) * US, "sent", FRAME)]
    # A restart told meanwhile comes first, and the recovery that was due is void.
    bench.at(2 * 10**9, lambda: bench.bus.arrive(message(0x040)))
    bench.at(2 * 10**9 + MS, lambda: bench.bus.arrive(message(0x100)))
    bench.at(2 * 10**9 + 2 * MS, lambda: bench.bus.arrive(message(0x004, d1=0x20)))
    bench.advance(3 * 10**9)
    assert bench.bus.state is PASSIVE


def test_a_real_bus_is_not_disturbed_by_us() -> None:
    faults = first(10**9)
    bench = CanBench(hardware=True, disturbance=faults)
    bench.send(FRAME)
    bench.bus.arrive(FRAME)
    bench.advance(MS)
    assert faults.attempts == []
    assert [kind for _, kind, _ in bench.log] == ["received", "sent", "told"]


# -- whatever happens

ACTIONS = st.one_of(
    st.tuples(st.just("send"), st.sampled_from([0x155, 0x2A5, 0x5A5])),
    st.tuples(st.just("arrive"), st.sampled_from([0x155, 0x2A5, 0x7A5])),
    st.tuples(st.just("refuse"), st.integers(1, 5)),
    st.tuples(st.just("cancel"), st.integers(0, 30)),
    st.tuples(st.just("told"), st.sampled_from([0x040, 0x100, 0x004])),
    st.tuples(st.just("reset"), st.just(0)),
    st.tuples(st.just("listen"), st.booleans()),
)
ERRORS = st.lists(st.sampled_from([None, None, *BusError]), max_size=60)


def history(actions: list, errors: list, hardware: bool, steps_ns: list[int]) -> tuple:
    script = iter(errors)
    bench = CanBench(hardware=hardware, disturbance=lambda frame, own, now_ns: next(script, None))
    handles: list[int] = []
    asked: list[CanFrame] = []
    cancelled: list[CanFrame] = []

    def act(index: int, kind: str, value: int) -> None:
        if kind == "send":
            asked.append(CanFrame(value, bytes([index])))
            handles.append(bench.send(asked[-1]))
        elif kind == "arrive":
            bench.bus.arrive(CanFrame(value, bytes([index])))
        elif kind == "refuse":
            bench.refusals = value
        elif kind == "cancel":
            if value < len(handles) and bench.bus.cancel(handles[value]):
                cancelled.append(asked[value])
        elif kind == "told":
            bench.bus.arrive(message(value, d1=0x20))
        elif kind == "reset":
            bench.bus.reset()
        else:
            bench.bus.listening = bool(value)

    at_ns = 0
    for index, (gap_ns, (kind, value)) in enumerate(actions):
        at_ns += gap_ns
        bench.at(at_ns, lambda index=index, kind=kind, value=value: act(index, kind, value))
    for step_ns in steps_ns:
        bench.advance(bench.clock.now_ns + step_ns)
    bench.advance(10**10)
    # A real controller that went off comes back when its driver says so.
    bench.bus.arrive(message(0x100))
    bench.advance(2 * 10**10)
    states = (bench.bus.state, bench.bus.transmit_error_count, bench.bus.receive_error_count)
    resets = any(kind == "reset" for _, (kind, _) in actions)
    return bench, asked, cancelled, resets, (bench.log, bench.states, bench.bus.counters, states)


@given(
    st.lists(st.tuples(st.integers(0, 300_000), ACTIONS), max_size=40),
    ERRORS,
    st.booleans(),
    st.lists(st.integers(0, 5_000_000), max_size=20),
)
@settings(max_examples=300)
def test_every_frame_leaves_once_or_is_taken_back(
    actions: list, errors: list, hardware: bool, steps_ns: list[int]
) -> None:
    bench, asked, cancelled, resets, result = history(actions, errors, hardware, steps_ns)
    told = [frame for _, kind, frame in bench.log if kind == "told"]
    sent = [frame for _, kind, frame in bench.log if kind == "sent"]
    assert len(set(told)) == len(told)
    assert len(set(sent)) == len(sent) == bench.bus.counters.tx_frames
    assert set(told) <= set(sent) <= set(asked)
    assert not set(sent) & set(cancelled)
    assert bench.bus.queued_frames == 0
    if not resets:
        assert set(told) == set(sent) == set(asked) - set(cancelled)
    received = [frame for _, kind, frame in bench.log if kind == "received"]
    assert len(set(received)) == len(received) == bench.bus.counters.rx_frames
    for identifier in (0x155, 0x2A5, 0x5A5, 0x7A5):  # in the order of their serial numbers
        for frames in (sent, received):
            serials = [frame.data[0] for frame in frames if frame.identifier == identifier]
            assert serials == sorted(serials)
    # The same again, in other steps of the clock, is the same to the nanosecond.
    assert history(actions, errors, hardware, [])[-1] == result
