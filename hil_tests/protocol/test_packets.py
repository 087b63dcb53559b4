"""Space packets, headers, time and error control."""

from __future__ import annotations

import struct
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_tests.vectors import reference_decoder
from st_emulator.protocol import (
    CucTime,
    LocalProtocolError,
    Malformed,
    PacketHeader,
    RequestId,
    Telecommand,
    Telemetry,
    crc16_ccitt,
    encode_raw_telecommand,
    encode_telecommand,
    encode_telemetry,
    parse_telecommand,
    parse_telemetry,
)

TELEMETRY_HEADER = {
    "apid": 100,
    "sequence_count": 0,
    "message_count": 0,
    "destination_id": 0,
    "time": CucTime(0, 0),
    "time_status": 0,
}


@pytest.mark.parametrize(
    ("data", "crc"),
    [
        # ECSS-E-ST-70-41C annex B, table B-2: verification of compliance.
        ("0000", 0x1D0F),
        ("000000", 0xCC9C),
        ("ABCDEF01", 0x04A2),
        ("1456F89A0001", 0x7FD5),
        # The check value by which catalogues of CRCs name this one (CRC-16/IBM-3740).
        ("313233343536373839", 0x29B1),
        ("", 0xFFFF),
    ],
)
def test_crc_gives_the_published_values(data: str, crc: int) -> None:
    assert crc16_ccitt(bytes.fromhex(data)) == crc


@given(st.binary(max_size=200))
def test_crc_equals_the_bitwise_definition(data: bytes) -> None:
    crc = crc16_ccitt(data)
    assert crc == reference_decoder.crc16(data)
    assert crc16_ccitt(data + crc.to_bytes(2, "big")) == 0


def test_cuc_time_is_tai_since_1958() -> None:
    time = pytest.importorskip("astropy.time")
    moment = time.Time("2026-01-01T00:00:00", scale="tai")
    epoch = time.Time("1958-01-01T00:00:00", scale="tai")
    seconds = round((moment - epoch).sec)
    assert CucTime.from_ns(seconds * 10**9 + 500_000_000) == CucTime(seconds, 1 << 23)
    assert CucTime(seconds, 1 << 23).as_bytes() == struct.pack(">I", seconds) + b"\x80\x00\x00"


@given(st.integers(0, 2**32 * 10**9 - 1))
def test_cuc_time_is_the_last_tick_not_after_the_instant(tai_ns: int) -> None:
    time = CucTime.from_ns(tai_ns)
    tick = Fraction(10**9, 2**24)
    exact_ns = time.coarse * 10**9 + time.fine * tick
    assert exact_ns <= tai_ns < exact_ns + tick
    assert 0 <= time.to_ns() - exact_ns < 1
    assert CucTime.from_ns(time.to_ns()) == time
    assert CucTime.from_bytes(time.as_bytes()) == time


@given(st.integers(0, 2**32 * 10**9 - 1), st.integers(0, 2**32 * 10**9 - 1))
def test_cuc_times_order_as_their_instants(first_ns: int, second_ns: int) -> None:
    low, high = sorted((first_ns, second_ns))
    assert CucTime.from_ns(low) <= CucTime.from_ns(high)


@pytest.mark.parametrize("tai_ns", [-1, 2**32 * 10**9])
def test_cuc_time_outside_its_4_bytes_is_refused(tai_ns: int) -> None:
    with pytest.raises(LocalProtocolError, match=r"CucTime: coarse = -?\d+; allowed: 0..4294967295"):
        CucTime.from_ns(tai_ns)


def test_cuc_time_parts_are_checked() -> None:
    with pytest.raises(LocalProtocolError, match=r"fine = 16777216; allowed: 0..16777215"):
        CucTime(0, 1 << 24)
    with pytest.raises(LocalProtocolError, match="7 bytes"):
        CucTime.from_bytes(bytes(6))


HEADERS = st.builds(
    PacketHeader,
    version=st.integers(0, 7),
    packet_type=st.integers(0, 1),
    secondary_header=st.integers(0, 1),
    apid=st.integers(0, 2047),
    sequence_flags=st.integers(0, 3),
    sequence_count=st.integers(0, 16383),
    data_length=st.integers(0, 65535),
)


@given(HEADERS)
def test_primary_header_bits_stand_where_ccsds_puts_them(header: PacketHeader) -> None:
    raw = header.as_bytes()
    bits = "".join(f"{byte:08b}" for byte in raw)
    assert [
        int(bits[a:b], 2) for a, b in ((0, 3), (3, 4), (4, 5), (5, 16), (16, 18), (18, 32), (32, 48))
    ] == [
        header.version,
        header.packet_type,
        header.secondary_header,
        header.apid,
        header.sequence_flags,
        header.sequence_count,
        header.data_length,
    ]
    assert PacketHeader.from_bytes(raw + b"anything") == header
    request_id = RequestId.from_packet(raw)
    assert request_id.as_bytes() == raw[:4]
    assert RequestId.from_fields(request_id.as_fields()) == request_id


def test_headers_need_their_bytes() -> None:
    with pytest.raises(ValueError, match="6 bytes"):
        PacketHeader.from_bytes(bytes(5))
    with pytest.raises(ValueError, match="4 bytes"):
        RequestId.from_packet(bytes(3))


@given(
    apid=st.integers(0, 2046),
    sequence_count=st.integers(0, 16383),
    source_id=st.integers(0, 65535),
    ack=st.integers(0, 15),
)
def test_telecommand_header_survives(apid: int, sequence_count: int, source_id: int, ack: int) -> None:
    raw = encode_telecommand("ping", apid=apid, sequence_count=sequence_count, source_id=source_id, ack=ack)
    packet = parse_telecommand(raw)
    assert packet == Telecommand(apid, sequence_count, 17, 1, "ping", {}, source_id, ack, raw)
    assert isinstance(packet, Telecommand)
    assert packet.request_id == RequestId.from_packet(raw)


@given(
    apid=st.integers(0, 2046),
    sequence_count=st.integers(0, 16383),
    message_count=st.integers(0, 65535),
    destination_id=st.integers(0, 65535),
    coarse=st.integers(0, 2**32 - 1),
    fine=st.integers(0, 2**24 - 1),
    time_status=st.integers(0, 15),
)
def test_telemetry_header_survives(
    apid: int,
    sequence_count: int,
    message_count: int,
    destination_id: int,
    coarse: int,
    fine: int,
    time_status: int,
) -> None:
    time = CucTime(coarse, fine)
    raw = encode_telemetry(
        "pong",
        {},
        apid=apid,
        sequence_count=sequence_count,
        message_count=message_count,
        destination_id=destination_id,
        time=time,
        time_status=time_status,
    )
    assert parse_telemetry(raw) == Telemetry(
        apid, sequence_count, 17, 2, "pong", {}, message_count, destination_id, time_status, time, raw
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"apid": 2048}, "packet primary header: apid = 2048; allowed: 0..2047"),
        ({"apid": 2047}, "telecommand packet: apid = 2047; allowed: 0..2046"),
        ({"apid": -1}, "apid = -1"),
        ({"sequence_count": 16384}, "packet primary header: sequence_count = 16384; allowed: 0..16383"),
        ({"sequence_count": None}, "sequence_count = None"),
        ({"source_id": 65536}, "telecommand secondary header: source_id = 65536; allowed: 0..65535"),
        ({"ack": 16}, "telecommand secondary header: ack = 16; allowed: 0..15"),
    ],
)
def test_telecommand_header_values_are_checked(change: dict[str, int], message: str) -> None:
    with pytest.raises(LocalProtocolError) as caught:
        encode_telecommand("ping", **({"apid": 100, "sequence_count": 0} | change))
    assert message in str(caught.value)
    assert caught.value.field == next(iter(change))
    assert caught.value.value == next(iter(change.values()))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"message_count": 65536}, "telemetry secondary header: message_count = 65536; allowed: 0..65535"),
        ({"destination_id": -1}, "telemetry secondary header: destination_id = -1; allowed: 0..65535"),
        ({"time_status": 16}, "telemetry secondary header: time_status = 16; allowed: 0..15"),
        ({"apid": 2047}, "telemetry packet: apid = 2047"),
    ],
)
def test_telemetry_header_values_are_checked(change: dict[str, int], message: str) -> None:
    with pytest.raises(LocalProtocolError) as caught:
        encode_telemetry("pong", {}, **(TELEMETRY_HEADER | change))
    assert message in str(caught.value)


def test_raw_telecommand_of_a_type_nobody_knows() -> None:
    raw = encode_raw_telecommand(200, 7, b"\x01\x02", apid=1, sequence_count=2, source_id=3, ack=15)
    assert raw[:-2].hex() == "1801c0020008" + "2fc8070003" + "0102"
    malformed = parse_telecommand(raw)
    assert isinstance(malformed, Malformed)
    assert malformed.reason.name == "UNKNOWN_SERVICE"


def test_largest_packets() -> None:
    assert len(encode_raw_telecommand(8, 1, bytes(1011), apid=1, sequence_count=0)) == 1024
    with pytest.raises(LocalProtocolError, match="length = '1025 bytes'; allowed: at most 1024 bytes"):
        encode_raw_telecommand(8, 1, bytes(1012), apid=1, sequence_count=0)
    part = {"transaction_id": 1, "part_number": 2, "data": bytes(4069)}
    assert len(encode_telemetry("image_part", part, **TELEMETRY_HEADER)) == 4095
    with pytest.raises(
        LocalProtocolError, match=r"image_part: data = '4070 octets'; allowed: 1..4069 octets"
    ):
        encode_telemetry("image_part", part | {"data": bytes(4070)}, **TELEMETRY_HEADER)
