"""The OBC's transport on a CAN bus: literal frames in, literal frames out, time as an argument."""

from __future__ import annotations

import struct
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_tests.obc.can_unit import heartbeat, record, segments
from hil_tests.obc.transport_ends import counted, drain, hexes, told
from st_emulator.obc import CanSettings, CanTransport, ObcProtocol, SlipTransport, State
from st_emulator.obc.obc_protocol import VerificationUpdated
from st_emulator.obc.transport import CyclicReceived, PacketReceived
from st_emulator.protocol.can.cyclic import CanIdentifiers
from st_emulator.protocol.can.frames import CanFrame
from st_emulator.protocol.can.transport import FrameIgnored, ReceptionFailed
from st_emulator.protocol.pus.enumerations import TransferFailure

MS = 1_000_000
S = 1_000_000_000
UNIT, OBC = 0x58A, 0x60A  # node 10
PACKET = bytes(range(1, 31))  # 30 bytes: a first frame and four consecutive ones
CLEAR_TO_SEND = record(UNIT, bytes.fromhex("300000CCCCCCCCCC"))


@pytest.fixture
def transport() -> CanTransport:
    return CanTransport(CanIdentifiers(10))


# Packets out


def test_a_short_packet_is_a_single_frame(transport: CanTransport) -> None:
    assert transport.encode(b"\x01\x02\x03", 0) == b""
    assert hexes(drain(transport)) == ["60A#03010203CCCCCCCC"]
    assert counted(transport) == {"transfers_sent": 1}


def test_block_size_and_separation_time_of_the_unit_are_kept(transport: CanTransport) -> None:
    transport.encode(PACKET, 0)
    assert hexes(drain(transport)) == ["60A#101E010203040506"]
    assert drain(transport, 5 * MS) == []
    transport.receive(record(UNIT, bytes.fromhex("300205CCCCCCCCCC")), 10 * MS)  # blocks of 2, 5 ms
    assert hexes(drain(transport, 10 * MS)) == ["60A#210708090A0B0C0D"]
    assert transport.next_deadline_ns() == 15 * MS
    assert drain(transport, 15 * MS - 1) == []
    assert hexes(drain(transport, 15 * MS)) == ["60A#220E0F1011121314"]
    assert drain(transport, 30 * MS) == []  # the block is over
    transport.receive(CLEAR_TO_SEND, 40 * MS)
    assert hexes(drain(transport, 40 * MS)) == ["60A#2315161718191A1B", "60A#241C1D1ECCCCCCCC"]
    assert counted(transport) == {"transfers_sent": 1}
    assert transport.next_deadline_ns() is None


def test_a_wait_of_the_unit_is_waited_for(transport: CanTransport) -> None:
    transport.encode(PACKET, 0)
    drain(transport)
    for n in range(1, 4):
        transport.receive(record(UNIT, b"\x31\x00\x00"), n * 900 * MS)
        assert drain(transport, n * 900 * MS) == []
    transport.receive(CLEAR_TO_SEND, 3 * S)
    assert len(drain(transport, 3 * S)) == 4
    assert counted(transport) == {"transfers_sent": 1, "wait_frames_received": 3}


def test_packets_queue_behind_the_one_under_way(transport: CanTransport) -> None:
    for first in range(3):
        transport.encode(bytes([first]) * 10, 0)
    sent = hexes(drain(transport))
    for now_ns in range(1, 4):
        transport.receive(CLEAR_TO_SEND, now_ns)
        sent += hexes(drain(transport, now_ns))
    assert sent == [
        frame
        for first in range(3)
        for frame in (f"60A#100A{f'{first:02X}' * 6}", f"60A#21{f'{first:02X}' * 4}CCCCCC")
    ]


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (b"\x32\x00\x00", TransferFailure.RECEIVER_OVERFLOW),
        (b"\x3f\x00\x00", TransferFailure.INVALID_FLOW_STATUS),
        (None, TransferFailure.TIMEOUT_BS),
    ],
)
def test_a_transfer_that_fails_ends_its_telecommand_and_the_next_goes_on(
    answer: bytes | None, reason: TransferFailure, transport: CanTransport
) -> None:
    protocol = ObcProtocol(0x123, 1, transport)
    _, first = protocol.telecommand("ping", {}, 0)
    _, second = protocol.telecommand("ping", {}, 0)
    drain(transport)
    if answer is None:
        assert transport.next_deadline_ns() == S
        assert protocol.receive(b"", S - 1) == []
        events = protocol.receive(b"", S)
    else:
        events = told(protocol.receive(record(UNIT, answer), 5))
    (event,) = events
    assert isinstance(event, VerificationUpdated)
    assert event.verification is first
    assert first.state is State.NOT_DELIVERED
    assert f"({reason.name})" in first.transfer
    assert (first.finished, second.finished) == (True, False)
    assert list(protocol.verifications) == [second]
    counters = counted(transport)
    assert counters.pop(reason.name.lower()) == 1
    assert counters == {
        "telecommands_sent": 2,
        "telecommands_not_delivered": 1,
        "transmissions_failed": 1,
    }
    assert len(drain(transport, S)) == 1  # the second begins
    transport.receive(CLEAR_TO_SEND, S)
    assert len(drain(transport, S)) == 1
    assert transport.counters.transfers_sent == 1


def test_a_telecommand_without_reports_is_not_verified_when_it_does_not_arrive(
    transport: CanTransport,
) -> None:
    protocol = ObcProtocol(0x123, 1, transport)
    _, verification = protocol.telecommand("ping", {}, 0, ack=0)
    assert verification.state is State.VERIFIED
    drain(transport)
    protocol.receive(b"", S)
    assert verification.state is State.NOT_DELIVERED
    assert protocol.counters.telecommands_verified == 0


def test_what_waits_longer_than_its_deadline_is_not_sent_late(transport: CanTransport) -> None:
    protocol = ObcProtocol(0x123, 1, transport)
    _, first = protocol.telecommand("ping", {}, 0, timeout_ns=100 * MS)
    _, second = protocol.telecommand("ping", {}, 0, timeout_ns=100 * MS)
    drain(transport)
    protocol.receive(b"", 100 * MS)
    assert first.state is second.state is State.TIMED_OUT
    assert first.transfer == "the unit has sent no flow control so far"
    assert "was not sent" in second.transfer
    transport.receive(CLEAR_TO_SEND, 200 * MS)
    drain(transport, 200 * MS)
    protocol.receive(b"", 5 * S)
    assert counted(transport) == {
        "telecommands_sent": 2,
        "telecommands_timed_out": 2,
        "transfers_sent": 1,
    }


def test_what_the_unit_said_of_a_transfer_is_told(transport: CanTransport) -> None:
    protocol = ObcProtocol(0x123, 1, transport)
    _, refused = protocol.telecommand("ping", {}, 0, timeout_ns=100 * MS)
    transport.outgoing(0)
    transport.written(0, 0)
    protocol.receive(b"", 100 * MS)
    assert refused.transfer == "the bus has not taken it so far"
    drain(transport, 100 * MS)
    transport.receive(CLEAR_TO_SEND, 100 * MS)
    drain(transport, 100 * MS)
    _, unanswered = protocol.telecommand("ping", {}, 100 * MS, timeout_ns=10 * MS)
    drain(transport, 100 * MS)
    protocol.receive(record(UNIT, b"\x01\x00"), 105 * MS)  # telemetry goes on meanwhile
    protocol.receive(b"", 110 * MS)
    assert unanswered.transfer == "the unit has sent no flow control so far"
    transport.receive(CLEAR_TO_SEND, 110 * MS)
    drain(transport, 110 * MS)
    _, waiting = protocol.telecommand("ping", {}, 110 * MS, timeout_ns=90 * MS)
    drain(transport, 100 * MS)
    protocol.receive(record(UNIT, b"\x31\x00\x00"), 150 * MS)
    protocol.receive(b"", 200 * MS)
    assert waiting.transfer == "it is not yet delivered"


def test_padding_and_timeouts_of_the_unit() -> None:
    transport = CanTransport(CanIdentifiers(10), CanSettings(padding=None, timeout_ns=250 * MS))
    transport.encode(b"\x01\x02", 0)
    transport.encode(PACKET, 0)
    assert hexes(drain(transport)) == ["60A#020102", "60A#101E010203040506"]
    assert transport.next_deadline_ns() == 250 * MS  # N_Bs
    assert len(told(transport.poll(250 * MS))) == 1
    first, *_ = segments(PACKET)
    transport.receive(record(UNIT, first), S)
    assert hexes(drain(transport, S)) == ["60A#300000"]
    assert transport.next_deadline_ns() == S + 250 * MS  # N_Cr
    transport.encode(b"\x01", 2 * S)
    transport.poll(2 * S)
    transport.outgoing(2 * S)
    transport.written(0, 2 * S)
    transport.poll(2 * S + 250 * MS)
    counters = counted(transport)
    assert (counters["timeout_bs"], counters["timeout_cr"], counters["timeout_a"]) == (1, 1, 1)


# A link that does not take everything


def test_a_frame_that_the_link_refuses_is_offered_again(transport: CanTransport) -> None:
    transport.encode(b"\x01", 0)
    line = transport.outgoing(0)
    transport.written(0, 0)
    assert transport.outgoing(MS - 1) == b""
    assert transport.next_deadline_ns() == MS
    assert transport.outgoing(MS) == line
    transport.written(3, MS)  # a link in memory cuts anywhere
    assert transport.outgoing(2 * MS) == line[3:]
    transport.written(len(line) - 3, 2 * MS)
    assert counted(transport) == {"transfers_sent": 1, "frames_refused": 2}
    assert transport.counters.sent_bytes == len(line)
    assert transport.next_deadline_ns() is None


def test_a_link_that_takes_nothing_ends_the_transfer_after_n_as(transport: CanTransport) -> None:
    protocol = ObcProtocol(0x123, 1, transport)
    _, verification = protocol.telecommand("ping", {}, 0)
    now_ns = 0
    while not verification.finished:
        assert transport.outgoing(now_ns)
        transport.written(0, now_ns)
        due_ns = transport.next_deadline_ns()
        assert due_ns is not None
        assert due_ns > now_ns
        now_ns = due_ns
        protocol.receive(b"", now_ns)
    assert now_ns == S
    assert "(TIMEOUT_A)" in verification.transfer
    assert transport.outgoing(now_ns + S) == b""  # what was given up does not leave later
    assert transport.counters.frames_sent == 0


def test_a_record_that_was_begun_is_finished_though_its_packet_was_given_up(
    transport: CanTransport,
) -> None:
    transport.encode(PACKET, 0)
    line = transport.outgoing(0)
    transport.written(5, 0)
    transport.poll(S)
    assert transport.counters.timeout_a == 1
    assert transport.outgoing(S) == line[5:]
    transport.written(len(line) - 5, S)
    transport.encode(b"\x07", S)
    assert hexes(drain(transport, S)) == ["60A#0107CCCCCCCCCCCC"]


def test_a_frame_of_its_own_is_given_up_in_time(transport: CanTransport) -> None:
    waiting = transport.send_frame(CanFrame(0x80, b"\x01"), 0)
    transport.outgoing(0)
    transport.written(0, 0)
    transport.poll(S - 1)
    assert not waiting.lost
    transport.poll(S)
    assert waiting.lost
    assert transport.outgoing(2 * S) == b""
    assert counted(transport) == {"frames_refused": 1, "frames_lost": 1}
    begun = transport.send_frame(CanFrame(0x81, b"\x02"), S)
    transport.outgoing(S)
    transport.written(5, S)
    transport.poll(2 * S)  # its time is over, and its rest must follow
    assert len(transport.outgoing(2 * S)) == 4
    transport.written(4, 2 * S)
    assert (begun.taken_ns, begun.lost) == (2 * S, False)
    taken = transport.send_frame(CanFrame(0x80, b"\x02"), 2 * S)
    assert hexes(drain(transport, 2 * S + 5)) == ["80#02"]
    assert taken.taken_ns == 2 * S + 5


# Packets in


def test_a_packet_is_put_together_and_flow_control_sent(transport: CanTransport) -> None:
    first, *others = segments(PACKET)
    assert told(transport.receive(record(UNIT, first), 3)) == []
    assert hexes(drain(transport, 3)) == ["60A#300000CCCCCCCCCC"]
    events = transport.receive(b"".join(record(UNIT, frame) for frame in others), 9)
    assert told(events) == [PacketReceived(PACKET, 9)]
    assert counted(transport) == {"transfers_received": 1, "flow_controls_sent": 1}


def test_our_own_block_size_and_separation_time_are_asked_for() -> None:
    transport = CanTransport(CanIdentifiers(10), CanSettings(block_size=2, separation_time_us=300))
    first, *others = segments(PACKET)
    transport.receive(record(UNIT, first), 0)
    sent = drain(transport)
    for frame in others:
        transport.receive(record(UNIT, frame), 0)
        sent += drain(transport)
    assert hexes(sent) == ["60A#3002F3CCCCCCCCCC"] * 2


@pytest.mark.parametrize("length", [8, 300, 4095])
def test_every_length_arrives(transport: CanTransport, length: int) -> None:
    packet = bytes(n % 251 for n in range(length))
    stream = b"".join(record(UNIT, frame) for frame in segments(packet))
    assert told(transport.receive(stream, 1)) == [PacketReceived(packet, 1)]


@given(cuts=st.lists(st.integers(0, 200), max_size=12))
@settings(max_examples=50, deadline=None)
def test_any_chunks_are_the_same(cuts: list[int]) -> None:
    transport = CanTransport(CanIdentifiers(10))
    stream = b"".join(record(UNIT, frame) for frame in segments(PACKET)) + record(0x70A, heartbeat())
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    events = [event for a, b in pairwise(edges) for event in transport.receive(stream[a:b], 0)]
    assert [type(event) for event in told(events)] == [PacketReceived, CyclicReceived]


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda frames: frames[:2] + frames[3:], TransferFailure.WRONG_SEQUENCE),  # lost
        (lambda frames: [frames[0], frames[2], frames[1], *frames[3:]], TransferFailure.WRONG_SEQUENCE),
        (lambda frames: [*frames[:3], frames[2], *frames[3:]], TransferFailure.WRONG_SEQUENCE),  # repeated
        (lambda frames: frames[:3], None),  # its end lost: the next packet begins
        (lambda frames: frames[1:], TransferFailure.UNEXPECTED_PDU),  # its begin lost
    ],
)
def test_a_damaged_transfer_is_counted_and_the_next_packet_arrives(
    transport: CanTransport, spoil: Any, reason: TransferFailure | None
) -> None:
    damaged = b"".join(record(UNIT, frame) for frame in spoil(segments(bytes(40))))
    good = b"".join(record(UNIT, frame) for frame in segments(PACKET))
    events = told(transport.receive(damaged + good, 0))
    assert events[-1] == PacketReceived(PACKET, 0)
    failures = events[:-1]
    assert failures
    assert all(isinstance(event, ReceptionFailed | FrameIgnored) for event in failures)
    reason = TransferFailure.UNEXPECTED_PDU if reason is None else reason
    assert failures[0].reason is reason
    assert getattr(transport.counters, reason.name.lower()) >= 1
    failed = transport.counters.receptions_failed + transport.counters.transfer_frames_ignored
    assert failed == len(failures)


def test_a_transfer_that_stops_ends_after_n_cr(transport: CanTransport) -> None:
    first, second, *_ = segments(PACKET)
    transport.receive(record(UNIT, first), 0)
    drain(transport, 0)
    transport.receive(record(UNIT, second), 400 * MS)
    assert transport.next_deadline_ns() == 1400 * MS
    (failed,) = transport.poll(1400 * MS)
    assert failed == ReceptionFailed(TransferFailure.TIMEOUT_CR, 30, 1400 * MS)
    assert transport.counters.timeout_cr == 1


# CAN FD, and how long a packet takes


def test_can_fd_has_longer_frames() -> None:
    transport = CanTransport(CanIdentifiers(10), CanSettings(fd=True))
    packet = bytes(range(100))
    transport.encode(packet, 0)
    line = transport.outgoing(0)
    assert struct.unpack(">IBBH", line[:8]) == (OBC, 64, 0x05, 0)  # FDF and BRS
    assert line[8:] == struct.pack(">H", 0x1000 | 100) + packet[:62]
    transport.written(len(line), 0)
    transport.receive(record(UNIT, b"\x30\x00\x00", flags=0x04), 1)
    line = transport.outgoing(1)
    assert line[8:] == b"\x21" + packet[62:] + b"\xcc" * 9  # 39 bytes go into a frame of 48
    transport.written(len(line), 1)
    stream = b"".join(record(UNIT, frame, flags=0x05) for frame in segments(packet, 64))
    assert told(transport.receive(stream, 2)) == [PacketReceived(packet, 2)]


def test_the_time_that_a_packet_takes(transport: CanTransport) -> None:
    # Three data frames and a flow control, each 111 bits and some stuff bits, at 1 Mbit/s.
    assert 4 * 111_000 < transport.transfer_ns(20) < 4 * 135_000
    assert 111_000 < transport.transfer_ns(7) < 135_000
    slow = CanTransport(CanIdentifiers(10), CanSettings(bitrate=125_000))
    assert slow.transfer_ns(20) == 8 * transport.transfer_ns(20)
    # On a serial line 8N1 with the two ENDs round it.
    assert SlipTransport(9600).transfer_ns(20) == 22 * 10 * S // 9600
    assert SlipTransport().transfer_ns(20) == 0
