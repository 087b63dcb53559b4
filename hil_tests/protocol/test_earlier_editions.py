"""A message that has grown at its end is still read as an older unit sends it."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil_tests.protocol.message_strategies import message_fields, smallest_fields
from hil_tests.vectors import reference_decoder
from st_emulator.protocol import (
    REGISTRY,
    CucTime,
    LocalProtocolError,
    Malformed,
    MalformedReason,
    Telemetry,
    encode_telemetry,
    field_violation,
    parse_telemetry,
    slip_encode,
)
from st_emulator.protocol.framing import FrameReceived, SlipDecoder
from st_emulator.protocol.pus.fields import DataLayout

REPORT = REGISTRY.by_name("attitude_report")
HEADER = {
    "apid": 100, "sequence_count": 3, "message_count": 4, "destination_id": 1, "time": CucTime(5, 6),
    "time_status": 1,
}  # fmt: skip
OLD_DATA_BYTES, DATA_BYTES, HEADERS_BYTES = 126, 151, 20
ADDED = (
    "rate_covariance_valid",
    *(f"rate_covariance_{axes}" for axes in ("xx", "xy", "xz", "yy", "yz", "zz")),
)


def sealed(body: bytes) -> bytes:
    """A packet whose length and error control are right for it, made with struct alone."""
    head = body[:4] + struct.pack(">H", len(body) + 2 - 7)
    return head + body[6:] + struct.pack(">H", reference_decoder.crc16(head + body[6:]))


def of_length(packet: bytes, data_bytes: int) -> bytes:
    """The packet with so many bytes of source data: cut, or with zeros behind."""
    body = packet[:-2][: HEADERS_BYTES + data_bytes]
    return sealed(body.ljust(HEADERS_BYTES + data_bytes, b"\0"))


REPORTS = message_fields(REPORT)


@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(fields=REPORTS)
def test_an_older_units_report_is_read_without_what_it_does_not_say(fields: dict[str, Any]) -> None:
    packet = encode_telemetry("attitude_report", fields, **HEADER)
    assert len(packet) == HEADERS_BYTES + DATA_BYTES + 2
    older = of_length(packet, OLD_DATA_BYTES)
    read = parse_telemetry(older)
    assert isinstance(read, Telemetry)
    assert read.fields == {name: value for name, value in fields.items() if name not in ADDED}
    assert field_violation(read) is None
    # By hand, and nothing of what stands before has moved.
    by_hand = reference_decoder.Reader(older[HEADERS_BYTES:-2]).record(reference_decoder.ATTITUDE)
    whole = reference_decoder.decode_telemetry(packet)["fields"]
    assert whole.items() >= by_hand.items()
    assert set(whole) - set(by_hand) == set(ADDED)


@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(fields=REPORTS, data_bytes=st.integers(0, 400))
def test_no_other_length_is_a_report(fields: dict[str, Any], data_bytes: int) -> None:
    packet = of_length(encode_telemetry("attitude_report", fields, **HEADER), data_bytes)
    read = parse_telemetry(packet)
    if data_bytes in (OLD_DATA_BYTES, DATA_BYTES):
        assert isinstance(read, Telemetry)
        assert ("rate_covariance_xx" in read.fields) is (data_bytes == DATA_BYTES)
    else:
        assert isinstance(read, Malformed)
        assert read.reason is MalformedReason.BAD_FIELDS


@settings(max_examples=40, suppress_health_check=[HealthCheck.too_slow])
@given(
    reports=st.lists(st.tuples(REPORTS, st.booleans()), min_size=1, max_size=3),
    size=st.integers(1, 64),
    behind=st.binary(max_size=20),
)
def test_both_editions_off_the_line_in_any_pieces(
    reports: list[tuple[dict[str, Any], bool]], size: int, behind: bytes
) -> None:
    """Whole, byte by byte or in between, with other bytes behind the last frame."""
    packets = [
        of_length(
            encode_telemetry("attitude_report", fields, **HEADER), OLD_DATA_BYTES if old else DATA_BYTES
        )
        for fields, old in reports
    ]
    line = b"".join(slip_encode(packet) for packet in packets) + behind.replace(b"\xc0", b"")
    decoder = SlipDecoder(4096)
    found = []
    for start in range(0, len(line), size):
        found += decoder.receive(line[start : start + size], start)
    raws = [event.data for event in found if isinstance(event, FrameReceived)]
    assert raws == packets
    for raw, (fields, old) in zip(raws, reports, strict=True):
        read = parse_telemetry(raw)
        assert isinstance(read, Telemetry)
        assert read.fields == {n: v for n, v in fields.items() if not (old and n in ADDED)}


def test_what_is_wrong_in_an_older_report_is_found() -> None:
    older = bytearray(encode_telemetry("attitude_report", smallest_fields(REPORT), **HEADER))
    older[HEADERS_BYTES + 13] = 2  # the flag `valid`
    read = parse_telemetry(of_length(bytes(older), OLD_DATA_BYTES))
    assert isinstance(read, Telemetry)
    violation = field_violation(read)
    assert violation is not None
    assert violation.field == "valid"


def test_a_report_is_built_whole_or_not_at_all() -> None:
    fields = smallest_fields(REPORT)
    for name in ADDED:
        del fields[name]
    with pytest.raises(LocalProtocolError) as caught:
        encode_telemetry("attitude_report", fields, **HEADER)
    assert caught.value.field == ADDED[0]


def test_every_earlier_end_has_a_length_of_its_own() -> None:
    for message in REGISTRY:
        names = [element.name for element in message.fields]
        sizes = [
            DataLayout(message.fields[: names.index(name) + 1]).group.size_bytes
            for name in message.earlier_ends
        ]
        assert None not in sizes, "of fixed size up to there"
        assert len({*sizes, message.data.group.size_bytes}) == len(sizes) + 1
