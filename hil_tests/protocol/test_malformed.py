"""Nothing that is received raises: every kind of damage has its reason, and any bytes at all are taken."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_tests.protocol.message_strategies import message_fields, smallest_fields
from hil_tests.vectors import reference_decoder
from st_emulator.protocol import (
    REGISTRY,
    CucTime,
    FailureCode,
    FramingReason,
    Malformed,
    MalformedReason,
    RequestId,
    Telecommand,
    Telemetry,
    encode_raw_telecommand,
    encode_telecommand,
    encode_telemetry,
    parse_telecommand,
    parse_telemetry,
)

TM_HEADER = {
    "apid": 100,
    "sequence_count": 1,
    "message_count": 2,
    "destination_id": 3,
    "time": CucTime(4, 5),
    "time_status": 1,
}
PING = encode_telecommand("ping", apid=100, sequence_count=7)
PONG = encode_telemetry("pong", {}, **TM_HEADER)


def sealed(packet: bytes) -> bytes:
    """With the length field and the error control made right again, by the reference."""
    body = packet[:4] + (len(packet) + 2 - 7).to_bytes(2, "big") + packet[6:]
    return body + reference_decoder.crc16(body).to_bytes(2, "big")


def changed(packet: bytes, byte: int, value: int) -> bytes:
    """One byte replaced, sealed again."""
    return sealed(packet[:byte] + bytes([value]) + packet[byte + 1 : -2])


def raw(service: int, subservice: int, data: str = "") -> bytes:
    return encode_raw_telecommand(service, subservice, bytes.fromhex(data), apid=100, sequence_count=7)


TELECOMMAND_CASES: dict[str, tuple[bytes, MalformedReason, str]] = {
    "nothing": (b"", MalformedReason.TOO_SHORT, "0 bytes, a packet header has 6"),
    "three bytes": (PING[:3], MalformedReason.TOO_SHORT, "3 bytes"),
    "only a header": (PING[:6], MalformedReason.TOO_SHORT, "6 bytes, the smallest packet has 13"),
    "smallest minus one": (sealed(PING[:-3]), MalformedReason.TOO_SHORT, "12 bytes"),
    "larger than allowed": (sealed(PING[:-2] + bytes(1012)), MalformedReason.TOO_LONG, "1025 bytes"),
    "cut": (PING[:-1] + b"", MalformedReason.TOO_SHORT, "12 bytes"),
    "cut with data": (
        raw(8, 1, "0401")[:-1],
        MalformedReason.LENGTH_MISMATCH,
        "14 bytes, the header says 15",
    ),
    "something behind": (PING + b"\0", MalformedReason.LENGTH_MISMATCH, "14 bytes, the header says 13"),
    "length field wrong": (
        PING[:4] + b"\xff\xff" + PING[6:],
        MalformedReason.LENGTH_MISMATCH,
        "13 bytes, the header says 65542",
    ),
    "crc wrong": (PING[:-1] + bytes([PING[-1] ^ 1]), MalformedReason.BAD_CRC, "received 0x"),
    "bit flipped": (
        PING[:7] + bytes([PING[7] ^ 0x10]) + PING[8:],
        MalformedReason.BAD_CRC,
        f"received 0x{int.from_bytes(PING[-2:], 'big'):04X}, computed 0x",
    ),
    "packet version 1": (changed(PING, 0, 0x38), MalformedReason.BAD_VERSION, "packet version 1, expected 0"),
    "telemetry": (PONG, MalformedReason.NOT_TELECOMMAND, "packet type 0"),
    "other apid": (changed(PING, 1, 101), MalformedReason.UNKNOWN_APID, "APID 101"),
    "no secondary header": (
        changed(PING, 0, 0x10),
        MalformedReason.NO_SECONDARY_HEADER,
        "secondary header flag 0, expected 1",
    ),
    "first segment": (changed(PING, 2, 0x40), MalformedReason.SEGMENTED, "sequence flags 1, expected 3"),
    "pus version 1": (changed(PING, 6, 0x1F), MalformedReason.BAD_PUS_VERSION, "PUS version 1, expected 2"),
    "service": (raw(18, 1), MalformedReason.UNKNOWN_SERVICE, "TC[18,1]"),
    "service of telemetry only": (raw(130, 1), MalformedReason.UNKNOWN_SERVICE, "TC[130,1]"),
    "subservice": (raw(17, 99), MalformedReason.UNKNOWN_SUBSERVICE, "TC[17,99]"),
    "subservice of telemetry": (raw(17, 2), MalformedReason.UNKNOWN_SUBSERVICE, "TC[17,2]"),
    "function": (raw(8, 1, "63"), MalformedReason.UNKNOWN_ID, "function: function_id 99 is not known"),
    "parameter": (
        raw(20, 3, "01 0063 00"),
        MalformedReason.UNKNOWN_ID,
        "parameter_set: parameter_id 99 is not known",
    ),
    "no data": (raw(8, 1), MalformedReason.BAD_FIELDS, "function, 0 bytes of data"),
    "data missing": (raw(8, 1, "04"), MalformedReason.BAD_FIELDS, "function, 1 bytes of data"),
    "data left over": (raw(8, 1, "04 01 00"), MalformedReason.BAD_FIELDS, "1 bytes too many"),
    "data for a message without": (raw(17, 1, "00"), MalformedReason.BAD_FIELDS, "1 bytes too many"),
    "more items promised": (raw(3, 5, "03 01 02"), MalformedReason.BAD_FIELDS, "hk_enable, 3 bytes of data"),
    "fewer items promised": (raw(3, 5, "01 01 02"), MalformedReason.BAD_FIELDS, "1 bytes too many"),
    "octets promised": (raw(6, 2, "01 00000000 0100 00"), MalformedReason.BAD_FIELDS, "memory_load"),
}


@pytest.mark.parametrize("case", TELECOMMAND_CASES)
def test_telecommand_case(case: str) -> None:
    packet, reason, detail = TELECOMMAND_CASES[case]
    malformed = parse_telecommand(packet, apids=(100,))
    assert isinstance(malformed, Malformed)
    assert malformed.reason is reason
    assert detail in malformed.detail
    assert malformed.raw == packet
    assert (malformed.header is not None) == (len(packet) >= 6)
    assert malformed.request_id == (RequestId.from_packet(packet) if len(packet) >= 4 else None)
    assert isinstance(malformed.reason.failure_code, FailureCode)


TELEMETRY_CASES: dict[str, tuple[bytes, MalformedReason]] = {
    "nothing": (b"", MalformedReason.TOO_SHORT),
    "smallest minus one": (sealed(PONG[:-3]), MalformedReason.TOO_SHORT),
    "larger than allowed": (sealed(PONG[:-2] + bytes(4074)), MalformedReason.TOO_LONG),
    "cut": (encode_telemetry("hk_report", smallest_fields(REGISTRY.by_name("hk_report")), **TM_HEADER)[:-1],
            MalformedReason.LENGTH_MISMATCH),
    "crc wrong": (PONG[:-1] + bytes([PONG[-1] ^ 1]), MalformedReason.BAD_CRC),
    "packet version": (changed(PONG, 0, 0xE8), MalformedReason.BAD_VERSION),
    "telecommand": (sealed(PING[:-2] + bytes(9)), MalformedReason.NOT_TELEMETRY),
    "no secondary header": (changed(PONG, 0, 0), MalformedReason.NO_SECONDARY_HEADER),
    "segment": (changed(PONG, 2, 0x80), MalformedReason.SEGMENTED),
    "pus version": (changed(PONG, 6, 0x11), MalformedReason.BAD_PUS_VERSION),
    "service": (changed(PONG, 7, 99), MalformedReason.UNKNOWN_SERVICE),
    "subservice": (changed(PONG, 8, 1), MalformedReason.UNKNOWN_SUBSERVICE),
    "structure": (sealed(changed(changed(PONG, 7, 3), 8, 25)[:-2] + b"\x09"), MalformedReason.UNKNOWN_ID),
    "event of another severity": (
        sealed(changed(changed(PONG, 7, 5), 8, 1)[:-2] + b"\x00\x0d\x01"),
        MalformedReason.UNKNOWN_ID,
    ),
    "data left over": (sealed(PONG[:-2] + b"\0"), MalformedReason.BAD_FIELDS),
}  # fmt: skip


@pytest.mark.parametrize("case", TELEMETRY_CASES)
def test_telemetry_case(case: str) -> None:
    packet, reason = TELEMETRY_CASES[case]
    malformed = parse_telemetry(packet)
    assert isinstance(malformed, Malformed)
    assert malformed.reason is reason
    assert malformed.detail
    assert malformed.raw == packet


def test_every_reason_has_a_case() -> None:
    seen = {reason for _, reason, _ in TELECOMMAND_CASES.values()} | {r for _, r in TELEMETRY_CASES.values()}
    framing = {reason.malformed_reason for reason in FramingReason}
    assert seen | framing == set(MalformedReason)
    assert not seen & framing


def test_apids_are_looked_at_only_when_given() -> None:
    assert isinstance(parse_telecommand(changed(PING, 1, 101)), Telecommand)
    assert isinstance(parse_telecommand(PING, apids={100}), Telecommand)
    malformed = parse_telecommand(PING, apids=())
    assert isinstance(malformed, Malformed)
    assert malformed.reason is MalformedReason.UNKNOWN_APID


PARSERS = pytest.mark.parametrize("parse", [parse_telecommand, parse_telemetry])
Parser = Callable[[bytes], Telecommand | Telemetry | Malformed]


@PARSERS
@given(st.binary(max_size=300))
def test_any_bytes_are_taken(parse: Parser, data: bytes) -> None:
    result = parse(data)
    assert result.raw == data
    if isinstance(result, Malformed):
        assert result.detail


@PARSERS
@settings(max_examples=300)
@given(
    service=st.sampled_from(sorted({message.service for message in REGISTRY})) | st.integers(0, 255),
    subservice=st.integers(0, 40) | st.integers(0, 255),
    data=st.binary(max_size=80),
)
def test_any_data_in_a_good_packet_are_taken(
    parse: Parser, service: int, subservice: int, data: bytes
) -> None:
    start = PING[:6] if parse is parse_telecommand else PONG[:6]
    second = b"\x29" + bytes([service, subservice]) + bytes(2 if parse is parse_telecommand else 11)
    result = parse(sealed(start + second + data))
    if isinstance(result, Malformed):
        assert result.reason.name in ("UNKNOWN_SERVICE", "UNKNOWN_SUBSERVICE", "UNKNOWN_ID", "BAD_FIELDS")
    else:
        assert (result.service, result.subservice) == (service, subservice)


@given(data=st.data())
def test_any_damage_to_any_message_is_taken(data: st.DataObject) -> None:
    """Cut, lengthened or changed, and sealed again so that it gets past the error control."""
    message = data.draw(st.sampled_from(list(REGISTRY)))
    fields = data.draw(message_fields(message))
    if message.kind == "TC":
        packet = encode_telecommand(message.name, fields, apid=100, sequence_count=7)
    else:
        packet = encode_telemetry(message.name, fields, **TM_HEADER)
    body = bytearray(packet[:-2])
    for _ in range(data.draw(st.integers(0, 3))):
        body[data.draw(st.integers(6, len(body) - 1))] = data.draw(st.integers(0, 255))
    size = data.draw(st.integers(0, len(body) + 3))
    result = (parse_telecommand if message.kind == "TC" else parse_telemetry)(
        sealed(bytes(body.ljust(size, b"\xa5")[:size])) if size >= 6 else bytes(body[:size])
    )
    assert isinstance(result, Telecommand | Telemetry | Malformed)


@given(start=st.integers(0, 8 * len(PING) - 1), pattern=st.integers(0, 0xFFFF))
def test_bursts_of_up_to_16_bits_never_pass(start: int, pattern: int) -> None:
    """What the error control promises."""
    everything = (1 << 8 * len(PING)) - 1
    damaged = int.from_bytes(PING, "big") ^ ((pattern | 1) << start & everything)
    assert isinstance(parse_telecommand(damaged.to_bytes(len(PING), "big")), Malformed)


def test_memoryviews_and_bytearrays_are_bytes_too() -> None:
    assert (
        parse_telecommand(bytearray(PING)) == parse_telecommand(memoryview(PING)) == parse_telecommand(PING)
    )
