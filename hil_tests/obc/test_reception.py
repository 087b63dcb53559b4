"""Bytes in, events and counters out: nothing damaged passes, nothing valid is lost."""

import struct
from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from st_emulator.obc import Counters, ObcProtocol
from st_emulator.obc.obc_protocol import (
    MAX_FRAME_BYTES,
    FrameLost,
    MalformedReceived,
    SequenceGapDetected,
    TelemetryReceived,
)


def receive(protocol: ObcProtocol, pieces: Iterable[bytes]) -> list[Any]:
    events: list[Any] = []
    for number, piece in enumerate(pieces):
        events += protocol.receive(piece, number)
    return events


def counted(protocol: ObcProtocol) -> dict[str, int]:
    """Counters that are not 0, bytes left out."""
    return {name: n for name, n in protocol.counters.as_dict().items() if n and name != "received_bytes"}


def test_a_packet_is_decoded(wire: Any) -> None:
    protocol = ObcProtocol()
    packet = wire.telemetry_packet(5, 1, struct.pack(">HHB", 1, 3, 2), count=11)
    (event,) = protocol.receive(wire.slip(packet), 77)
    assert isinstance(event, TelemetryReceived)
    assert event.time_ns == 77
    telemetry = event.telemetry
    assert (telemetry.name, telemetry.apid, telemetry.sequence_count) == ("event_info", wire.APID, 11)
    assert telemetry.fields == {"event_id": 1, "data": {"boot_count": 3, "reset_cause": 2}}
    assert (telemetry.message_count, telemetry.destination_id, telemetry.time_status) == (7, 9, 1)
    assert (telemetry.time.coarse, telemetry.time.fine) == (2_000_000_000, 1 << 23)
    assert telemetry.raw == packet
    assert protocol.counters == Counters(received_bytes=len(wire.slip(packet)), packets=1)


def damaged_stream(wire: Any) -> tuple[bytes, dict[str, int]]:
    """Every kind of damage, a valid packet after each; and what is to be counted."""
    good = [wire.slip(wire.telemetry_packet(17, 2, count=n)) for n in range(10)]
    bad_crc = bytearray(wire.telemetry_packet(17, 2, count=99))
    bad_crc[-1] ^= 1
    whole = wire.telemetry_packet(17, 2, count=99)
    stream = b"".join(
        (
            good[0],
            wire.slip(bytes(bad_crc)),
            good[1],
            wire.slip(whole[:-3]),  # truncated
            good[2],
            wire.slip(b"\x01\x02\x03"),  # far too short
            good[3],
            b"\xc0\xdb\x01abc\xc0",  # ESC followed by what may not follow
            good[4],
            b"\xc0" + bytes(MAX_FRAME_BYTES + 1) + b"\xc0",  # oversized
            good[5],
            wire.slip(whole)[:9],  # cut off by the next packet's END
            good[6],
            wire.slip(wire.telemetry_packet(200, 1, count=7)),  # a service that is not ours, sound otherwise
            wire.slip(wire.telemetry_packet(17, 2, count=8)),
            wire.slip(wire.telemetry_packet(3, 25, b"\x63\x00", count=9)),  # structure 99
            wire.slip(wire.telemetry_packet(17, 2, count=10)),
        )
    )
    return stream, {"packets": 9, "crc_errors": 1, "malformed": 3, "framing_errors": 2, "unknown": 2}


def test_each_damage_has_its_counter_and_costs_no_packet_after_it(wire: Any) -> None:
    stream, expected = damaged_stream(wire)
    protocol = ObcProtocol()
    events = receive(protocol, [stream])
    assert counted(protocol) == expected
    assert sum(isinstance(event, MalformedReceived) for event in events) == 6
    assert sum(isinstance(event, FrameLost) for event in events) == 2


def test_byte_by_byte_is_the_same(wire: Any) -> None:
    stream, expected = damaged_stream(wire)
    protocol = ObcProtocol()
    receive(protocol, (stream[n : n + 1] for n in range(len(stream))))
    assert counted(protocol) == expected


@given(cuts=st.lists(st.integers(0, 6000), max_size=20))
@settings(max_examples=50, deadline=None)
def test_any_chunks_are_the_same(wire: Any, cuts: list[int]) -> None:
    stream, expected = damaged_stream(wire)
    edges = [0, *sorted(cuts), len(stream)]
    protocol = ObcProtocol()
    receive(protocol, (stream[a:b] for a, b in pairwise(edges)))
    assert counted(protocol) == expected


@given(noise=st.binary(max_size=300))
@settings(max_examples=200, deadline=None)
def test_noise_never_raises_nor_swallows_a_packet(wire: Any, noise: bytes) -> None:
    protocol = ObcProtocol()
    good = wire.slip(wire.telemetry_packet(17, 2))
    events = receive(protocol, [good, noise, good])
    assert protocol.counters.packets == 2
    assert isinstance(events[-1], TelemetryReceived | SequenceGapDetected)


@pytest.mark.parametrize("kept", [1, 5, 15])
def test_the_rest_of_a_frame_under_way_at_the_start_is_no_error(wire: Any, kept: int) -> None:
    line = wire.slip(wire.telemetry_packet(17, 2, count=0))
    protocol = ObcProtocol()
    receive(protocol, [line[-kept - 1 :] + wire.slip(wire.telemetry_packet(17, 2, count=1))])
    assert counted(protocol) == {"packets": 1, "startup_fragments": 1}


def test_a_damaged_first_frame_that_is_whole_is_an_error(wire: Any) -> None:
    packet = bytearray(wire.telemetry_packet(17, 2))
    packet[8] ^= 0xFF
    protocol = ObcProtocol()
    receive(protocol, [wire.slip(bytes(packet))])
    assert counted(protocol) == {"crc_errors": 1}


def counts_received(
    wire: Any, counts: Iterable[int], apid: int | None = None
) -> tuple[ObcProtocol, list[Any]]:
    protocol = ObcProtocol()
    packets = (wire.telemetry_packet(17, 2, count=count, apid=apid or wire.APID) for count in counts)
    return protocol, receive(protocol, (wire.slip(packet) for packet in packets))


def test_a_gap_in_the_sequence_is_told_with_its_size(wire: Any) -> None:
    protocol, events = counts_received(wire, [5, 6, 9, 10, 11, 13])
    gaps = [event for event in events if isinstance(event, SequenceGapDetected)]
    assert [(gap.expected, gap.received, gap.missing) for gap in gaps] == [(7, 9, 2), (12, 13, 1)]
    assert counted(protocol) == {"packets": 6, "sequence_gaps": 2, "missing_packets": 3}


def test_the_sequence_wraps_without_a_gap(wire: Any) -> None:
    protocol, _ = counts_received(wire, [16_382, 16_383, 0, 1])
    assert counted(protocol) == {"packets": 4}


def test_a_gap_over_the_wrap_has_its_size(wire: Any) -> None:
    protocol, _ = counts_received(wire, [16_382, 3])
    assert counted(protocol) == {"packets": 2, "sequence_gaps": 1, "missing_packets": 4}


def test_a_restart_of_the_unit_is_no_gap(wire: Any) -> None:
    protocol, _ = counts_received(wire, [100, 0, 1])
    assert counted(protocol) == {"packets": 3, "restarts": 1}


def test_each_apid_counts_for_itself(wire: Any) -> None:
    protocol = ObcProtocol()
    for apid, count in [(1, 5), (2, 8), (1, 6), (2, 9), (1, 8)]:
        protocol.receive(wire.slip(wire.telemetry_packet(17, 2, count=count, apid=apid)), 0)
    assert counted(protocol) == {"packets": 5, "sequence_gaps": 1, "missing_packets": 1}


def test_with_an_apid_given_others_are_left_out(wire: Any) -> None:
    protocol = ObcProtocol(apid=5)
    assert protocol.receive(wire.slip(wire.telemetry_packet(17, 2, apid=6)), 0) == []
    assert counted(protocol) == {"other_apid": 1}
    assert protocol.destination_apid == 5


def test_the_apid_is_learned_from_the_first_telemetry(wire: Any) -> None:
    protocol = ObcProtocol()
    assert protocol.destination_apid == 0x64
    protocol.receive(wire.slip(wire.telemetry_packet(17, 2, apid=0x321)), 0)
    protocol.receive(wire.slip(wire.telemetry_packet(17, 2, apid=0x322)), 0)
    assert protocol.destination_apid == 0x321
    line, verification = protocol.telecommand("ping", {}, 0)
    assert verification.request_id.apid == 0x321
    assert wire.Request(wire.unslip(line)[0]).apid == 0x321


def test_what_is_sent_is_counted(wire: Any) -> None:
    protocol = ObcProtocol()
    line, _ = protocol.telecommand("ping", {}, 0)
    assert protocol.counters.sent_bytes == len(line)
    assert protocol.counters.telecommands_sent == 1
