"""ISO-TP between two of our ends on a bus in virtual time: good transfers of every kind, frames lost,
repeated, out of order or never acknowledged, and garbage.
"""

from __future__ import annotations

import random
import tracemalloc
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_tests.protocol.transport_bus import (
    FRAME_NS,
    GOOD,
    LOST,
    MS,
    NOT_ACKNOWLEDGED,
    TWICE,
    Bus,
    Fate,
    Ours,
    S,
    pair,
)
from hil_tests.protocol.transport_end import UNIT
from hil_tests.protocol.transport_reference import Reference
from st_emulator.protocol.can.frames import CAN_FD_LENGTHS, CanFrame
from st_emulator.protocol.can.transport import (
    IsoTpConnection,
    IsoTpEvent,
    IsoTpSettings,
    PduReceived,
    PduSent,
    ReceptionFailed,
    TransmissionFailed,
)

SEPARATIONS_US = [0, 100, 900, 1_000, 5_000]


def pattern(length: int, seed: int = 1) -> bytes:
    return random.Random(seed * 100_003 + length).randbytes(length)


def both(*packets: bytes, back: tuple[bytes, ...] = (), **choices: object) -> tuple[Ours, Ours]:
    one, other = (Ours(side) for side in pair(**choices))
    one.to_send.extend(packets)
    other.to_send.extend(back)
    return one, other


def kinds(bus: Bus) -> Counter[str]:
    return Counter(wire.frame.data.hex()[0] for wire in bus.log)


# --- Good transfers ---


@settings(max_examples=200, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 4095), min_size=1, max_size=3),
    back=st.lists(st.integers(1, 4095), max_size=3),
    block_size=st.sampled_from([0, 1, 2, 7, 15, 16, 255]),
    separation_time_us=st.sampled_from(SEPARATIONS_US),
    frame_bytes=st.sampled_from([0, 8, 12, 16, 20, 24, 32, 48, 64]),
    extended=st.booleans(),
    padding=st.sampled_from([None, 0, 0xCC]),
)
def test_what_is_sent_is_received(
    lengths: list[int],
    back: list[int],
    block_size: int,
    separation_time_us: int,
    frame_bytes: int,
    extended: bool,
    padding: int | None,
) -> None:
    """Both directions at once. The frames are counted, and the separation is kept by what was on the wire."""
    fd = {"fd": True, "frame_bytes": frame_bytes} if frame_bytes else {}  # 0: classic CAN
    one, other = both(
        *map(pattern, lengths),
        back=tuple(map(pattern, back)),
        block_size=block_size,
        separation_time_us=separation_time_us,
        extended=extended,
        padding=padding,
        **fd,
    )
    bus = Bus((one, other))
    bus.run(600 * S)
    assert (other.received, one.received) == (list(map(pattern, lengths)), list(map(pattern, back)))
    assert (one.sent, other.sent) == (lengths, back)
    assert one.failures == other.failures == []
    assert one.is_idle()
    assert other.is_idle()

    size = frame_bytes or 8
    expected = Counter()
    for length in lengths + back:
        if length <= size - (1 if size == 8 else 2):
            expected["0"] += 1
            continue
        consecutive = -(-(length - size + 2) // (size - 1))
        expected += {"1": 1, "2": consecutive}
        expected["3"] += 1 + ((consecutive - 1) // block_size if block_size else 0)
    assert kinds(bus) == expected

    last_end_ns: dict[int, int] = {}
    for wire in bus.log:
        kind, sender = wire.frame.data[0] >> 4, wire.frame.identifier
        if kind == 2 and sender in last_end_ns:
            assert wire.handed_over_ns - last_end_ns[sender] >= separation_time_us * 1000
        if kind == 2:
            last_end_ns[sender] = wire.ended_ns
        elif kind in (0, 1):
            last_end_ns.pop(sender, None)


@pytest.mark.parametrize("frame_bytes", [8, 64])
def test_every_length(frame_bytes: int) -> None:
    some = [*range(1, 300), *range(300, 4080, 41), *range(4080, 4096)]
    lengths = range(1, 4096) if frame_bytes == 64 else some
    fd = {"fd": frame_bytes > 8, "frame_bytes": frame_bytes}
    one, other = both(*map(pattern, lengths), **fd, block_size=13)
    Bus((one, other)).run(36_000 * S)
    assert other.received == list(map(pattern, lengths))


@pytest.mark.parametrize("frame_bytes", [8, 64])
@pytest.mark.parametrize("length", [4095, 4096, 70_000])
def test_lengths_beyond_twelve_bits(frame_bytes: int, length: int) -> None:
    one, other = both(
        pattern(length), fd=frame_bytes > 8, frame_bytes=frame_bytes, max_receive_bytes=length, block_size=100
    )
    Bus((one, other)).run()
    assert other.received == [pattern(length)]


@pytest.mark.parametrize("length", [4096, 70_000])
def test_too_long_for_the_other_side(length: int) -> None:
    one, other = both(pattern(length), b"after")
    bus = Bus((one, other))
    bus.run()
    assert one.failures == [("TransmissionFailed", "RECEIVER_OVERFLOW")]
    assert other.failures == [("ReceptionFailed", "TOO_LONG")]
    assert other.received == [b"after"]
    assert kinds(bus) == {"1": 1, "3": 1, "0": 1}


def test_the_time_of_a_transfer_is_that_of_its_frames() -> None:
    """4095 bytes at 1 Mbit/s: nothing waits for anything but the wire."""
    one, other = both(pattern(4095))
    bus = Bus((one, other))
    bus.run()
    frames = 1 + 1 + -(-(4095 - 6) // 7)
    assert one.events == [PduSent(4095, frames * FRAME_NS)]
    assert other.events == [PduReceived(pattern(4095), frames * FRAME_NS)]


# --- Disturbed transfers ---

# 6 + 6 x 7 bytes in blocks of 2. Frame by frame: what goes wrong at the sender and at the receiver when just
# this one does.
SCRIPT = ["FF", "FC", "CF1", "CF2", "FC", "CF3", "CF4", "FC", "CF5", "CF6"]
T_BS, T_A = ("TransmissionFailed", "TIMEOUT_BS"), ("TransmissionFailed", "TIMEOUT_A")
R_CR, R_A = ("ReceptionFailed", "TIMEOUT_CR"), ("ReceptionFailed", "TIMEOUT_A")
R_SN, R_UN = ("ReceptionFailed", "WRONG_SEQUENCE"), ("ReceptionFailed", "UNEXPECTED_PDU")
IGNORED = ("FrameIgnored", "UNEXPECTED_PDU")

Failures = tuple[list[tuple[str, str]], list[tuple[str, str]]]
LOSSES: dict[int, Failures] = {
    0: ([T_BS], []),
    1: ([T_BS], [R_CR]),
    2: ([T_BS], [R_SN]),
    3: ([T_BS], [R_CR]),
    4: ([T_BS], [R_CR]),
    5: ([T_BS], [R_SN]),
    6: ([T_BS], [R_CR]),
    7: ([T_BS], [R_CR]),
    8: ([], [R_SN]),  # the sender hears nothing of it: ISO-TP does not acknowledge the end
    9: ([], [R_CR]),
}
REPEATS: dict[int, Failures] = {
    0: ([], [R_UN]),  # the same first frame again: a new reception, which goes well
    1: ([IGNORED], []),
    2: ([T_BS], [R_SN, IGNORED]),
    3: ([T_BS], [R_SN]),
    4: ([IGNORED], []),
    5: ([T_BS], [R_SN, IGNORED]),
    6: ([T_BS], [R_SN]),
    7: ([IGNORED], []),
    8: ([], [R_SN, IGNORED]),
    9: ([], [IGNORED]),
}
UNACKNOWLEDGED: dict[int, Failures] = {
    0: ([T_A], []),
    1: ([T_BS], [R_A]),
    2: ([T_A], [R_CR]),
    3: ([T_A], [R_CR]),
    4: ([T_BS], [R_A]),
    5: ([T_A], [R_CR]),
    6: ([T_A], [R_CR]),
    7: ([T_BS], [R_A]),
    8: ([T_A], [R_CR]),
    9: ([T_A], [R_CR]),
}
# Overtaken by the frame behind it, where one follows without an answer between them.
OVERTAKEN: dict[int, Failures] = {
    2: ([T_BS], [R_SN, IGNORED]),
    5: ([T_BS], [R_SN, IGNORED]),
    8: ([], [R_SN, IGNORED]),
}
OVERTAKEN_FATE = Fate(arrivals_ns=(FRAME_NS + FRAME_NS // 2,))
DISTURBED = [
    (name, number, fate, *failures)
    for name, fate, table in (
        ("lost", LOST, LOSSES),
        ("repeated", TWICE, REPEATS),
        ("not acknowledged", NOT_ACKNOWLEDGED, UNACKNOWLEDGED),
        ("overtaken", OVERTAKEN_FATE, OVERTAKEN),
    )
    for number, failures in table.items()
]


def test_the_script_is_what_goes_over_the_bus() -> None:
    one, other = both(pattern(48), block_size=2)
    bus = Bus((one, other))
    bus.run()
    names = {0x10: "FF", 0x30: "FC"} | {0x20 + number: f"CF{number}" for number in range(1, 7)}
    assert [names[wire.frame.data[0]] for wire in bus.log] == SCRIPT


@pytest.mark.parametrize(
    ("number", "fate", "at_sender", "at_receiver"),
    [case[1:] for case in DISTURBED],
    ids=[f"{case[0]}-{case[1]}-{SCRIPT[case[1]]}" for case in DISTURBED],
)
def test_one_frame_goes_wrong(
    number: int, fate: Fate, at_sender: list[tuple[str, str]], at_receiver: list[tuple[str, str]]
) -> None:
    one, other = both(pattern(48), block_size=2)
    bus = Bus((one, other), fate=lambda n, frame: fate if n == number else GOOD)
    bus.run()
    assert (one.failures, other.failures) == (at_sender, at_receiver)
    assert one.sent == ([] if any(kind == "TransmissionFailed" for kind, _ in at_sender) else [48])
    begun = number > 0 or fate.arrivals_ns
    whole = at_receiver == [R_UN] or all(kind != "ReceptionFailed" for kind, _ in at_receiver)
    assert other.received == ([pattern(48)] if begun and whole else [])
    for timed_out in one.events + other.events:
        if isinstance(timed_out, ReceptionFailed | TransmissionFailed) and "TIMEOUT" in timed_out.reason.name:
            # From the end of a frame of the script, or of its hand-over; nothing waits longer than its timer.
            assert (timed_out.time_ns - 1 * S) % FRAME_NS == 0
            assert 0 <= timed_out.time_ns - 1 * S <= (len(SCRIPT) + 1) * FRAME_NS
    assert one.is_idle()
    assert other.is_idle()

    one.to_send.append(pattern(500))
    other.to_send.append(pattern(333))
    before = len(one.failures), len(other.failures)
    bus.run(bus.now_ns + 10 * S)
    assert (other.received[-1], one.received[-1]) == (pattern(500), pattern(333))
    assert (len(one.failures), len(other.failures)) == before


def test_a_single_frame_may_come_twice() -> None:
    one, other = both(b"\1\2")
    Bus((one, other), fate=lambda number, frame: TWICE).run()
    assert other.received == [b"\1\2", b"\1\2"]


def test_a_dead_other_side() -> None:
    """No acknowledgement at all, then acknowledgement by somebody but no flow control."""
    one, other = both(*[pattern(100)] * 3, b"\1")
    bus = Bus((one, other), fate=lambda number, frame: NOT_ACKNOWLEDGED if number < 2 else LOST)
    bus.run()
    assert one.failures == [T_A, T_A, T_BS]
    assert one.sent == [1]
    assert [event.time_ns for event in one.events[:2]] == [1 * S, 2 * S]


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([0.002, 0.02, 0.2]), st.sampled_from([0, 3]), st.booleans())
def test_any_number_of_frames_go_wrong(seed: int, rate: float, block_size: int, fd: bool) -> None:
    """Every PDU ends once at its sender, nothing is stuck, and on a good bus again all comes through."""
    chance = random.Random(seed)
    packets = [pattern(chance.choice([3, 40, 300, 1000]), seed=number) for number in range(8)]
    size = {"fd": True, "frame_bytes": 32} if fd else {}
    one, other = both(*packets, back=tuple(packets[:4]), block_size=block_size, **size)
    bad = [LOST, TWICE, NOT_ACKNOWLEDGED, Fate(arrivals_ns=(250_000,)), Fate(arrivals_ns=(0, 900_000))]
    bus = Bus((one, other), fate=lambda n, frame: chance.choice(bad) if chance.random() < rate else GOOD)
    bus.run(3600 * S)
    for end, count in ((one, 8), (other, 4)):
        ended = [event for event in end.events if isinstance(event, PduSent | TransmissionFailed)]
        assert len(ended) == count
        assert end.is_idle()
        counters = end.connection.counters
        assert counters.pdus_sent + counters.transmissions_failed == count
        assert counters.pdus_received == len(end.received)
        assert sum(counters.by_reason.values()) == len(end.failures)
    bus.fate = lambda number, frame: GOOD
    one.to_send.append(pattern(2000))
    other.to_send.append(pattern(2001))
    bus.run(bus.now_ns + 100 * S)
    assert (other.received[-1], one.received[-1]) == (pattern(2000), pattern(2001))


# --- Garbage ---


def text(event: IsoTpEvent) -> str:
    if isinstance(event, PduReceived):
        return f"received {event.data.hex().upper()}"
    assert not isinstance(event, PduSent)
    kind = "failed" if isinstance(event, ReceptionFailed) else "ignored"
    return f"{kind} {event.reason.name}"


def garbage(chance: random.Random) -> bytes:
    """Half of it begins as something good does, else nothing would ever get beyond the first byte."""
    data = bytearray(chance.randbytes(chance.choice([0, 1, 2, 3, 7, 8, 8, 8, 8])))
    if data and chance.random() < 0.5:
        data[0] = chance.choice([0x00, 0x03, 0x07, 0x10, 0x10, 0x1F, 0x30, 0x21, 0x22, 0x23, 0x24])
        if data[0] == 0x10 and len(data) == 8:
            data[1] = chance.choice([0, 7, 8, 9, 14, 20, 27])
            if data[1] == 0:
                data[2:4] = chance.choice([b"\0\0", data[2:4]])
    return bytes(data)


def test_garbage_frame_by_frame_as_a_second_reading_of_the_standard_says() -> None:
    chance = random.Random(20160401)
    connection, reference = IsoTpConnection(UNIT), Reference(UNIT.max_receive_bytes)
    seen: Counter[str] = Counter()
    for number in range(100_000):
        data = garbage(chance)
        events = [text(e) for e in connection.receive(CanFrame(UNIT.receive_identifier, data), number)]
        assert events == reference.takes(data.hex().upper()), (number, data.hex())
        answer = connection.next_frame(number)
        assert (answer and answer.data.hex()[:2]) == reference.asked, (number, data.hex())
        reference.asked = None
        if answer is not None:
            connection.confirmed(answer, number)
        seen.update(events if events else ["progress"])
    counters = connection.counters
    assert counters.pdus_received == sum(n for name, n in seen.items() if name.startswith("received"))
    assert counters.frames_ignored == sum(n for name, n in seen.items() if name.startswith("ignored"))
    assert counters.receptions_failed == sum(n for name, n in seen.items() if name.startswith("failed"))
    ends = {name for name in seen if not name.startswith("received")}
    assert ends == {"progress", "failed UNEXPECTED_PDU", "failed WRONG_SEQUENCE", "failed TOO_LONG"} | {
        f"ignored {reason}" for reason in ("BAD_LENGTH", "BAD_PCI", "UNEXPECTED_PDU")
    }
    assert sum(len(name) > len("received ") + 2 * 7 for name in seen if name.startswith("received")) > 10


@pytest.mark.parametrize("fd", [False, True])
def test_a_good_transfer_after_any_garbage(fd: bool) -> None:
    """100,000 frames in both directions' way while PDUs are sent: none raises, each is progress or an event,
    and the next good PDU comes through, each way.
    """
    chance = random.Random(15765)
    one, other = (Ours(side) for side in pair(fd=fd, frame_bytes=64 if fd else 8))
    bus = Bus((one, other))
    good = 0
    for block in range(500):
        one.to_send.append(pattern(200, block))
        bus.run(bus.now_ns)  # its first frame is under way
        for _ in range(200):
            data = garbage(chance)
            if fd and data and chance.random() < 0.5:
                data = data[:1] + chance.randbytes(chance.choice(CAN_FD_LENGTHS[1:]) - 1)
            frame = CanFrame(one.connection.settings.receive_identifier, data, fd=fd)
            before = sum(one.connection.counters.by_reason.values())
            events = one.connection.receive(frame, bus.now_ns)
            reasons = sum(not isinstance(event, PduReceived) for event in events)
            assert sum(one.connection.counters.by_reason.values()) - before == reasons
        bus.run(bus.now_ns + 20 * S)
        for length in (5, 150):
            other.to_send.append(pattern(length, block))
            one.to_send.append(pattern(length + 1, block))
            bus.run(bus.now_ns + 20 * S)
            good += one.received[-1] == pattern(length, block)
            good += other.received[-1] == pattern(length + 1, block)
            assert one.is_idle()
        one.events.clear()
        other.events.clear()
    assert good == 2000


def test_memory_is_bounded() -> None:
    """Good frames without end, none of which completes what it begins."""
    limits = IsoTpSettings(1, 2, max_receive_bytes=4095)
    connection = IsoTpConnection(limits)
    first, chance = CanFrame(2, b"\x1f\xff" + bytes(6)), random.Random(1)
    tracemalloc.start()
    try:
        for number in range(5_000):
            connection.receive(first, number)
            for sequence in range(1, chance.randrange(20)):
                connection.receive(CanFrame(2, bytes([0x20 | sequence & 15]) + bytes(7)), number)
            connection.next_frame(number)
        assert tracemalloc.get_traced_memory()[0] < 50_000
    finally:
        tracemalloc.stop()
    assert connection.next_deadline_ns() == 1 * S  # of the one flow control that never left
    assert connection.poll(20 * MS) == []
