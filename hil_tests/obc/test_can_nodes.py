"""The OBC among the nodes of a CAN bus: whose frames count, which unit is meant, what cyclic frames say."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_tests.obc.can_unit import bits, half, heartbeat, record, segments, status
from hil_tests.obc.transport_ends import counted, drain, hexes, told
from st_emulator.obc import CanTransport, ObcProtocol, UnitNotChosenError
from st_emulator.obc.obc_protocol import TelemetryReceived
from st_emulator.obc.transport import CyclicMalformed, PacketReceived
from st_emulator.protocol.can.cyclic import CanIdentifiers

UNIT, OBC = 0x58A, 0x60A  # node 10
PACKET = bytes(range(1, 31))


@pytest.fixture
def transport() -> CanTransport:
    return CanTransport(CanIdentifiers(10))


# Whose frames


def test_interleaved_transfers_of_three_nodes_are_not_mixed(wire: Any) -> None:
    packets = {node: wire.telemetry_packet(17, 2, bytes([node]) * 50) for node in (10, 11, 12)}
    by_node = {node: segments(packet) for node, packet in packets.items()}
    stream = b"".join(
        record(0x580 + node, frame)
        for row in zip(*by_node.values(), strict=True)
        for node, frame in zip(by_node, row, strict=True)
    )
    for node in packets:
        transport = CanTransport(CanIdentifiers(node))
        assert told(transport.receive(stream, 0)) == [PacketReceived(packets[node], 0)]
        assert transport.counters.frames_of_others == 2 * len(by_node[10])


def test_what_is_not_the_units_is_counted_and_left_alone(transport: CanTransport) -> None:
    foreign = [
        record(0x70B, heartbeat()),  # another node
        record(OBC, b"\x02\x01\x02"),  # another OBC's telecommand
        record(0x080, b"\x01"),  # another's SYNC
        record(UNIT, b"\x02\x01\x02", extended=True),  # 29 bits, the same number
        record(0x7FF, b""),
        record(UNIT | 1 << 30, b"")[:4] + bytes([8, 0, 0, 0]),  # a remote frame
    ]
    assert told(transport.receive(b"".join(foreign), 0)) == []
    assert drain(transport) == []
    assert counted(transport) == {"frames_of_others": 6}
    error = record(0x2000_0040, bytes(8))
    unreal = record(0x123, bytes(9))
    transport.receive(error + unreal + foreign[0], 0)
    assert counted(transport) == {"frames_of_others": 7, "error_frames": 1, "malformed_records": 1}


@given(stream=st.lists(st.tuples(st.integers(0, 9), st.binary(max_size=8)), max_size=40))
@settings(max_examples=200, deadline=None)
def test_noise_on_the_units_identifiers_never_raises_and_the_next_packet_arrives(
    wire: Any, stream: list[tuple[int, bytes]]
) -> None:
    names = [0x58A, 0x60A, 0x70A, 0x18A, 0x28A, 0x38A, 0x48A, 0x50A, 0x40A, 0x080]
    protocol = ObcProtocol(wire.APID, 1, CanTransport(CanIdentifiers(10)))
    for number, (place, data) in enumerate(stream):
        protocol.receive(record(names[place], data), number)
        while line := protocol.transport.outgoing(number):
            protocol.written(len(line), number)
    good = wire.telemetry_packet(17, 2)
    events = protocol.receive(b"".join(record(UNIT, frame) for frame in segments(good)), 100)
    assert any(isinstance(event, TelemetryReceived) for event in events)


# Cyclic frames


def test_cyclic_frames_are_decoded(transport: CanTransport) -> None:
    rates = bits((200, 8), (1, 1), (0, 1), (-131_072, 18), (131_071, 18), (-1, 18))
    stream = (
        record(0x70A, heartbeat(9, mode=4, boot_count=3, uptime_s=77))
        + record(0x18A, half(200, -1.0, 0.5))
        + record(0x38A, rates)
        + record(0x48A, status(200, valid=0, reasons=4))
    )
    events = told(transport.receive(stream, 5))
    assert [event.name for event in events] == ["heartbeat", "attitude_1", "rates", "status"]
    beat, attitude, rate, state = (event.values for event in events)
    assert beat == {
        "counter": 9,
        "mode": 4,
        "attitude_valid": 1,
        "time_set": 1,
        "can_state": 0,
        "boot_count": 3,
        "uptime_s": 77,
    }
    assert attitude == {"counter": 200, "q_x": -1.0, "q_y": 0.5}
    assert rate == {"counter": 200, "rate_valid": 1, "rate_x": -0.25, "rate_y": 131_071 / 2**19} | {
        "rate_z": -(2.0**-19)
    }
    assert (state["valid"], state["reasons"], state["stars_identified"]) == (0, 4, 12)
    assert counted(transport) == {"cyclic_frames": 4}


def test_a_cyclic_frame_of_another_length_is_counted(transport: CanTransport) -> None:
    (event,) = told(transport.receive(record(0x18A, b"\x01\x02"), 5))
    assert event == CyclicMalformed("attitude_1", b"\x01\x02", 5)
    assert counted(transport) == {"cyclic_malformed": 1}


# Which unit


def test_the_first_heartbeat_tells_the_node() -> None:
    transport = CanTransport()
    packet = b"".join(record(0x58B, frame) for frame in segments(PACKET))
    assert told(transport.receive(packet, 0)) == []
    with pytest.raises(UnitNotChosenError, match="no unit's heartbeat came; name the one"):
        transport.settle()
    transport.encode(b"\x05", 0)
    assert drain(transport) == []
    transport.receive(record(0x70B, heartbeat()), 1)
    assert transport.node == 11
    assert told(transport.receive(packet, 2)) == [PacketReceived(PACKET, 2)]
    assert hexes(drain(transport, 2)) == ["60B#0105CCCCCCCCCCCC"]
    transport.settle()
    transport.receive(record(0x70C, heartbeat()), 3)
    transport.check_choice()  # it was clear when it was chosen
    assert transport.node == 11


def test_several_units_heard_are_an_error_that_lists_them() -> None:
    transport = CanTransport()
    for node in (12, 10, 11):
        transport.receive(record(0x700 + node, heartbeat()), 0)
    with pytest.raises(UnitNotChosenError, match="several units are on the bus: nodes 10, 11, 12; name"):
        transport.settle()
    with pytest.raises(UnitNotChosenError):
        transport.check_choice()
    named = CanTransport(CanIdentifiers(11))
    for node in (12, 10, 11):
        named.receive(record(0x700 + node, heartbeat()), 0)
    named.settle()
    named.check_choice()


def test_a_heartbeat_with_29_bits_is_another_ones() -> None:
    transport = CanTransport()
    transport.receive(record(0x70A, heartbeat(), extended=True), 0)
    assert (transport.node, transport.nodes_heard) == (None, set())


def test_29_bits_and_bases_of_a_units_own() -> None:
    bases = {name: base + 0x1000_0000 for name, base in CanIdentifiers(1).bases.items()}
    transport = CanTransport(CanIdentifiers(5, True, bases))
    events = transport.receive(record(0x1000_0705, heartbeat(), extended=True), 0)
    assert [event.name for event in told(events)] == ["heartbeat"]
    transport.encode(b"\x01", 0)
    assert drain(transport) == [(0x8000_0000 | 0x1000_0605, b"\x01\x01" + b"\xcc" * 6)]
