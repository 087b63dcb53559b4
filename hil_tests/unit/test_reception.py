"""What arrives on the line: each bad frame is counted and told once, and costs nothing that follows."""

import struct

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil_tests.vectors import reference_decoder as wire

from .conftest import MODE, SOURCE, Bench, MakeBench, make

LENGTH_MISMATCH, TOO_SHORT, BAD_VERSION, NOT_TELECOMMAND = 3, 1, 5, 6
NO_SECONDARY_HEADER, SEGMENTED, BAD_PUS_VERSION, OVERSIZED, BAD_ESCAPE = 9, 10, 11, 16, 17
UNKNOWN_APID, UNKNOWN_SERVICE, UNKNOWN_SUBSERVICE, BAD_FIELDS, OUT_OF_RANGE, UNKNOWN_ID = 1, 4, 5, 6, 8, 9


def with_crc(packet: bytes) -> bytes:
    return packet + struct.pack(">H", wire.crc16(packet))


def changed(packet: bytes, word: int, mask: int, value: int) -> bytes:
    """A header word with some of its bits replaced, the error control made anew."""
    words = list(struct.unpack(">HHH", packet[:6]))
    words[word] = words[word] & ~mask | value
    return with_crc(struct.pack(">HHH", *words) + packet[6:-2])


def ping(bench: Bench, **header: int) -> bytes:
    return bench.packet("ping", **header)


def ended(line: bytes) -> bytes:
    return b"\xc0" + line + b"\xc0"


BAD_LENGTHS_AND_HEADERS = {
    "one byte": (lambda b: b"\x18", TOO_SHORT),
    "header alone": (lambda b: ping(b)[:6], TOO_SHORT),
    "cut by a byte": (lambda b: ping(b, count=3)[:-1], TOO_SHORT),
    "longer than it says": (lambda b: ping(b) + b"\0", LENGTH_MISMATCH),
    "shorter than it says": (lambda b: changed(ping(b), 2, 0xFFFF, 900), LENGTH_MISMATCH),
    "version 1": (lambda b: changed(ping(b), 0, 0xE000, 0x2000), BAD_VERSION),
    "telemetry": (lambda b: changed(ping(b), 0, 0x1000, 0), NOT_TELECOMMAND),
    "no secondary header": (lambda b: changed(ping(b), 0, 0x0800, 0), NO_SECONDARY_HEADER),
    "first segment": (lambda b: changed(ping(b), 1, 0xC000, 0x4000), SEGMENTED),
    "PUS version 1": (lambda b: with_crc(ping(b)[:6] + b"\x1f" + ping(b)[7:-2]), BAD_PUS_VERSION),
}


@pytest.mark.parametrize("kind", BAD_LENGTHS_AND_HEADERS)
def test_wrong_length_or_header_is_an_event(bench: Bench, kind: str) -> None:
    make_packet, reason = BAD_LENGTHS_AND_HEADERS[kind]
    raw = make_packet(bench)
    before = bench.housekeeping(2)
    bench.put(wire.slip_frame(raw))
    count = bench.send("ping")
    bench.run(30)
    assert bench.events("TC_MALFORMED") == [{"reason": reason, "count": 1, "length": len(raw)}]
    assert "completion_success" in bench.stages(count)
    after = bench.housekeeping(2)
    assert after["length_errors"] == before["length_errors"] + 1
    assert after["tc_rejected"] == before["tc_rejected"] + 1
    assert after["tc_received"] - before["tc_received"] == 3
    assert after["tc_received"] == after["tc_accepted"] + after["tc_rejected"]


def test_a_wrong_crc_is_an_event_of_its_own(bench: Bench) -> None:
    for number in (1, 2):
        raw = bytearray(ping(bench))
        raw[-1] ^= 1
        bench.put(wire.slip_frame(bytes(raw)))
        bench.run(30)
        assert bench.events("TC_CRC_FAILED")[-1] == {"count": number, "length": 13}
    assert not bench.reports(bench.count)
    link = bench.housekeeping(2)
    assert link["crc_errors"] == 2
    assert link["tc_rejected"] == 2
    assert link["length_errors"] == 0


@pytest.mark.parametrize(
    ("line", "reason", "counter", "length"),
    [
        (b"\x01" * 1025, OVERSIZED, "oversized_frames", 1025),
        (b"\x01" * 70000, OVERSIZED, "oversized_frames", 65535),
        (b"ab\xdbcd", BAD_ESCAPE, "framing_errors", 5),
        (b"ab\xdb", BAD_ESCAPE, "framing_errors", 3),
    ],
)
def test_what_is_no_frame_is_an_event(
    bench: Bench, line: bytes, reason: int, counter: str, length: int
) -> None:
    bench.put(ended(line))
    count = bench.send("ping")
    bench.run(7000 if len(line) > 2000 else 200)
    assert bench.events("TC_MALFORMED") == [{"reason": reason, "count": 1, "length": length}]
    assert "completion_success" in bench.stages(count)
    link = bench.housekeeping(2)
    assert link[counter] == 1
    assert link["tc_received"] == link["tc_accepted"] + link["tc_rejected"]
    assert link["tc_rejected"] == 1


def test_the_largest_packet_is_taken(bench: Bench) -> None:
    data = bytes(range(256))
    load = {"memory_id": 1, "start_address": 0, "data": data, "checksum": wire.crc16(data)}
    assert len(bench.packet("memory_load", load)) < 1024
    whole = wire.telecommand_packet(17, 1, bytes(1024 - 13), bench.apid, 9, SOURCE, 15)
    assert len(whole) == 1024
    bench.put(wire.slip_frame(whole))
    bench.run(200)
    assert bench.failure(9) == ("acceptance_failure", BAD_FIELDS, 1024)
    assert bench.events("TC_MALFORMED") == []


def test_garbage_without_end_takes_no_memory(bench: Bench) -> None:
    for _ in range(50):
        bench.put(b"\x55" * 1000)
        bench.run(90)
    decoder = bench.emulator.dialect.port._decoder
    assert len(decoder._frame) <= 1024
    bench.put(b"\xc0")
    count = bench.send("ping")
    bench.run(100)
    assert [event["reason"] for event in bench.events("TC_MALFORMED")] == [OVERSIZED]
    assert "completion_success" in bench.stages(count)


def test_garbage_as_the_first_bytes_ever(new_bench: MakeBench) -> None:
    bench = new_bench()
    bench.put(b"\x00\xff\xdb garbage of a line that wakes up")
    bench.run(450)
    bench.put(b"more garbage")
    count = bench.send("ping")
    bench.run(30)
    # What came in BOOT is lost; the rest is one frame that ends with the ping's first END.
    assert bench.events("TC_MALFORMED") == [{"reason": TOO_SHORT, "count": 1, "length": 12}]
    assert bench.stages(count) == ["acceptance_success", "completion_success"]
    assert len(bench.of("pong")) == 1


def test_unknown_apid_is_a_routing_failure(bench: Bench) -> None:
    bench.put(wire.slip_frame(ping(bench, apid=99, count=77)))
    count = bench.send("ping", count=0)
    bench.run(20)
    assert bench.failure(77) == ("routing_failure", UNKNOWN_APID, 99)
    (report,) = bench.reports(77)
    assert report.fields["request_id"]["apid"] == 99
    assert report.decoded["destination_id"] == SOURCE
    assert "completion_success" in bench.stages(count)
    link = bench.housekeeping(2)
    assert (link["unknown_apid"], link["tc_rejected"], link["sequence_gaps"]) == (1, 1, 0)


@pytest.mark.parametrize(
    ("service", "subservice", "data", "failure", "counter"),
    [
        (99, 1, b"", (UNKNOWN_SERVICE, 99), "unknown_service"),
        (1, 1, b"", (UNKNOWN_SERVICE, 1), "unknown_service"),
        (17, 9, b"", (UNKNOWN_SUBSERVICE, 17 * 256 + 9), "unknown_service"),
        (17, 1, b"\0", (BAD_FIELDS, 14), "bad_parameters"),
        (3, 5, b"\x02\x01", (BAD_FIELDS, 15), "bad_parameters"),
        (3, 5, b"\x00", (OUT_OF_RANGE, 0), "bad_parameters"),
        (3, 5, b"\x01\x07", (UNKNOWN_ID, 7), "bad_parameters"),
        (8, 1, b"\x63", (UNKNOWN_ID, 0), "bad_parameters"),
        (20, 3, b"\x01\x00\x63\x00", (UNKNOWN_ID, 0), "bad_parameters"),
        (20, 1, b"\x01\x00\x63", (UNKNOWN_ID, 99), "bad_parameters"),
        (5, 6, b"\x01\x00\x63", (UNKNOWN_ID, 99), "bad_parameters"),
    ],
)
def test_refused_with_its_code_and_no_gap_behind(
    bench: Bench, service: int, subservice: int, data: bytes, failure: tuple[int, int], counter: str
) -> None:
    bench.count += 1
    bench.put(
        wire.slip_frame(
            wire.telecommand_packet(service, subservice, data, bench.apid, bench.count, SOURCE, 0)
        )
    )
    refused = bench.count
    bench.run(20)
    assert bench.stages(refused) == ["acceptance_failure"], "a failure is told whatever the flags ask"
    assert bench.failure(refused) == ("acceptance_failure", *failure)
    assert bench.reports(refused)[0].decoded["destination_id"] == SOURCE
    link = bench.housekeeping(2)
    assert link[counter] == 1
    assert link["sequence_gaps"] == 0, "the refused telecommand was received: its count is no gap"
    assert bench.events("TC_SEQUENCE_GAP_DETECTED") == []


def test_sequence_gap_is_told_and_the_telecommand_executed(bench: Bench) -> None:
    bench.send("ping", count=100)
    bench.run(30)
    bench.forget()
    bench.send("ping", count=103)
    bench.run(30)
    assert bench.events("TC_SEQUENCE_GAP_DETECTED") == [
        {"source_id": SOURCE, "expected": 101, "received": 103}
    ]
    assert bench.stages(103) == ["acceptance_success", "completion_success"]
    bench.forget()
    bench.send("ping", count=103)  # a repetition is one, too
    bench.run(30)
    assert bench.events("TC_SEQUENCE_GAP_DETECTED") == [
        {"source_id": SOURCE, "expected": 104, "received": 103}
    ]


def test_no_gap_at_the_first_at_the_turnover_at_a_restart_and_between_sources(bench: Bench) -> None:
    bench.send("ping", count=16383)
    bench.run(30)
    bench.forget()
    bench.send("ping", count=0)  # the turnover
    bench.send("ping", count=1)
    bench.send("ping", count=900, source_id=7)  # another source has its own counts
    bench.send("ping", count=2)
    bench.send("ping", count=0)  # the OBC started anew
    bench.send("ping", count=1)
    bench.run(50)
    assert bench.events("TC_SEQUENCE_GAP_DETECTED") == []
    assert len(bench.of("pong")) == 6


def test_byte_by_byte_in_any_rhythm(bench: Bench) -> None:
    frame = wire.slip_frame(ping(bench, count=0xC0))  # its count has to be escaped
    for byte in frame:
        bench.put(bytes([byte]))
        bench.run(37)
    assert bench.stages(0xC0) == ["acceptance_success", "completion_success"]


def test_a_burst_is_answered_in_order(bench: Bench) -> None:
    burst = b"".join(wire.slip_frame(ping(bench)) for _ in range(60))
    first = bench.count - 59
    bench.put(burst)
    bench.run(500)
    assert len(bench.of("pong")) == 60
    completed = [
        packet.fields["request_id"]["sequence_count"]
        for packet in bench.packets
        if packet.name == "completion_success"
    ]
    assert completed == list(range(first, first + 60))


def test_garbage_between_two_packets_is_told_once(bench: Bench) -> None:
    bench.run(1)
    one = bench.packet("ping")
    two = bench.packet("ping")
    bench.put(wire.slip_frame(one) + b"garbage" + wire.slip_frame(two))
    bench.run(50)
    assert len(bench.of("pong")) == 2
    assert bench.events("TC_MALFORMED") == [{"reason": TOO_SHORT, "count": 1, "length": 7}]


def test_one_end_between_two_frames_and_many_are_the_same(bench: Bench) -> None:
    one, two = bench.packet("ping"), bench.packet("ping")
    bench.put(wire.slip_frame(one)[:-1] + b"\xc0" * 5 + wire.slip_frame(two)[1:])
    bench.run(50)
    assert len(bench.of("pong")) == 2
    assert bench.events("TC_MALFORMED") == []


def test_latency_runs_from_the_last_byte(bench: Bench) -> None:
    start = bench.emulator.now_ns
    frame = wire.slip_frame(ping(bench, ack=0))
    bench.put(frame)
    bench.run(20)
    (pong,) = bench.packets
    sent = 2 + 22  # a pong and its two ENDs
    latency_ns = bench.emulator.profile.timing.telecommand_latency_us * 1000
    expected = start + len(frame) * 10**10 // 115200 + latency_ns
    assert abs(pong.t_ns - expected - sent * 10**10 // 115200) <= 3 * 10**10 // 115200  # escapes in the pong


def test_counters_stop_at_their_highest_value(bench: Bench) -> None:
    counters = bench.emulator.dialect.receiver.counters
    counters.crc_errors = 0xFFFF
    counters.tc_received = 0xFFFFFFFF
    raw = ping(bench)
    bench.put(wire.slip_frame(raw[:-1] + bytes([raw[-1] ^ 1])))
    bench.run(30)
    assert bench.events("TC_CRC_FAILED") == [{"count": 0xFFFF, "length": 13}]
    link = bench.housekeeping(2)
    assert link["crc_errors"] == 0xFFFF
    assert link["tc_received"] == 0xFFFFFFFF


@pytest.fixture(scope="module")
def shared() -> Bench:
    return make().boot()


SAFE = st.binary(max_size=60)
PIECES = st.lists(
    st.one_of(
        SAFE,
        st.just(b"\xc0"),
        st.just(b"\xdb"),
        st.builds(
            lambda service, subservice, data: wire.slip_frame(
                wire.telecommand_packet(service, subservice, data, 1073, 5, 3, 15)
            ),
            st.sampled_from([3, 5, 6, 9, 17, 20, 200]),
            st.integers(0, 255),
            SAFE,
        ),
    ),
    max_size=8,
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(pieces=PIECES, cut=st.integers(1, 50))
def test_whatever_comes_a_ping_behind_it_is_answered(shared: Bench, pieces: list[bytes], cut: int) -> None:
    bench = shared
    line = b"".join(pieces)
    for start in range(0, len(line), cut):
        bench.put(line[start : start + cut])
        bench.run(1)
    bench.put(b"\xc0")
    bench.run(600)
    bench.forget()
    count = bench.send("ping", source_id=0x7777, count=1234)
    bench.run(400)
    assert "completion_success" in bench.stages(count)
    assert bench.emulator.device.mode == MODE["STANDBY"]
    counters = bench.emulator.dialect.receiver.counters
    assert counters.tc_received == counters.tc_accepted + counters.tc_rejected
