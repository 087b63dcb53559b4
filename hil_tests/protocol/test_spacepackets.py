"""The other side is not our code: the PyPI package `spacepackets` reads our packets and we read its."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from spacepackets.ccsds.spacepacket import PacketType, SequenceFlags, SpacePacketHeader
from spacepackets.ecss.fields import PacketFieldEnum
from spacepackets.ecss.pus_1_verification import ManagedParamsVerification, Service1Tm
from spacepackets.ecss.req_id import RequestId as TheirRequestId
from spacepackets.ecss.tc import InvalidTcCrc16Error, PusTc
from spacepackets.ecss.tm import MiscParams, PusTm

from st_emulator.protocol import (
    CucTime,
    PacketHeader,
    RequestId,
    Telecommand,
    Telemetry,
    encode_raw_telecommand,
    encode_telecommand,
    encode_telemetry,
    parse_telecommand,
    parse_telemetry,
)

APIDS = st.integers(0, 2046)
COUNTS = st.integers(0, 16383)
U16 = st.integers(0, 65535)


@given(
    packet_type=st.integers(0, 1),
    secondary_header=st.integers(0, 1),
    apid=st.integers(0, 2047),
    flags=st.integers(0, 3),
    count=COUNTS,
    length=U16,
)
def test_primary_header(
    packet_type: int, secondary_header: int, apid: int, flags: int, count: int, length: int
) -> None:
    theirs = SpacePacketHeader(
        packet_type=PacketType(packet_type),
        apid=apid,
        seq_count=count,
        data_len=length,
        sec_header_flag=bool(secondary_header),
        seq_flags=SequenceFlags(flags),
    )
    ours = PacketHeader(0, packet_type, secondary_header, apid, flags, count, length)
    assert bytes(theirs.pack()) == ours.as_bytes()
    assert PacketHeader.from_bytes(bytes(theirs.pack())) == ours
    assert SpacePacketHeader.unpack(ours.as_bytes()) == theirs


@given(
    service=st.integers(0, 255),
    subservice=st.integers(0, 255),
    data=st.binary(max_size=100),
    apid=APIDS,
    count=COUNTS,
    source=U16,
    ack=st.integers(0, 15),
)
def test_they_read_our_telecommands(
    service: int, subservice: int, data: bytes, apid: int, count: int, source: int, ack: int
) -> None:
    raw = encode_raw_telecommand(
        service, subservice, data, apid=apid, sequence_count=count, source_id=source, ack=ack
    )
    theirs = PusTc.unpack(raw)
    second = theirs.pus_tc_sec_header
    assert (theirs.apid, theirs.seq_count, theirs.service, theirs.message_subtype) == (
        apid,
        count,
        service,
        subservice,
    )
    assert (bytes(theirs.app_data), second.source_id, second.ack_flags) == (data, source, ack)
    assert bytes(theirs.pack()) == raw
    assert RequestId.from_packet(raw).as_bytes() == TheirRequestId.from_pus_tc(theirs).pack()


@given(kind=st.integers(0, 1), apid=APIDS, count=COUNTS, source=U16, ack=st.integers(0, 15))
def test_we_read_their_telecommands(kind: int, apid: int, count: int, source: int, ack: int) -> None:
    theirs = PusTc(
        service=8,
        message_subtype=1,
        apid=apid,
        seq_count=count,
        source_id=source,
        ack_flags=ack,
        app_data=bytes([4, kind]),
    )
    packet = parse_telecommand(bytes(theirs.pack()))
    assert packet == Telecommand(
        apid,
        count,
        8,
        1,
        "function",
        {"function_id": 4, "arguments": {"kind": kind}},
        source,
        ack,
        bytes(theirs.pack()),
    )


def test_they_find_our_packet_damaged_when_it_is() -> None:
    raw = bytearray(encode_telecommand("ping", apid=1, sequence_count=2))
    raw[-1] ^= 1
    with pytest.raises(InvalidTcCrc16Error):
        PusTc.unpack(raw)


@given(
    apid=APIDS,
    count=COUNTS,
    message_count=U16,
    destination=U16,
    coarse=st.integers(0, 2**32 - 1),
    fine=st.integers(0, 2**24 - 1),
    status=st.integers(0, 15),
    cycles=st.integers(0, 2**32 - 1),
)
def test_they_read_our_telemetry_and_we_theirs(
    apid: int,
    count: int,
    message_count: int,
    destination: int,
    coarse: int,
    fine: int,
    status: int,
    cycles: int,
) -> None:
    time = CucTime(coarse, fine)
    fields = {"event_id": 4, "data": {"frame_index": 1, "cycles": cycles, "budget": 2, "late_us": 3}}
    raw = encode_telemetry(
        "event_low",
        fields,
        apid=apid,
        sequence_count=count,
        message_count=message_count,
        destination_id=destination,
        time=time,
        time_status=status,
    )
    theirs = PusTm.unpack(raw, timestamp_len=7)
    second = theirs.pus_tm_sec_header
    assert (theirs.apid, theirs.seq_count, theirs.service, theirs.message_subtype) == (apid, count, 5, 2)
    assert (second.message_counter, second.dest_id, second.spacecraft_time_ref) == (
        message_count,
        destination,
        status,
    )
    assert bytes(theirs.timestamp) == time.as_bytes()
    assert bytes(theirs.source_data) == bytes.fromhex("0004 00000001") + cycles.to_bytes(
        4, "big"
    ) + bytes.fromhex("00000002 00000003")

    back = PusTm(
        service=5,
        message_subtype=2,
        timestamp=time.as_bytes(),
        source_data=theirs.source_data,
        apid=apid,
        seq_count=count,
        message_counter=message_count,
        destination_id=destination,
        misc_params=MiscParams(spacecraft_time_ref=status),
    )
    assert bytes(back.pack()) == raw
    assert parse_telemetry(bytes(back.pack())) == Telemetry(
        apid, count, 5, 2, "event_low", fields, message_count, destination, status, time, raw
    )


@pytest.mark.parametrize(
    ("name", "extra", "step", "code"),
    [
        ("acceptance_success", {}, None, None),
        ("start_success", {}, None, None),
        ("completion_success", {}, None, None),
        ("progress", {"step": 7}, 7, None),
        ("acceptance_failure", {"failure_code": 7, "failure_data": 2}, None, 7),
        ("start_failure", {"failure_code": 11, "failure_data": 0}, None, 11),
        ("progress_failure", {"step": 9, "failure_code": 17, "failure_data": 0}, 9, 17),
        ("completion_failure", {"failure_code": 16, "failure_data": 32}, None, 16),
    ],
)
def test_they_read_our_verification_reports(
    name: str, extra: dict[str, int], step: int | None, code: int | None
) -> None:
    ping = PusTc(service=17, message_subtype=1, apid=5, seq_count=1000)
    raw = encode_telemetry(
        name,
        {"request_id": RequestId.from_packet(bytes(ping.pack())), **extra},
        apid=5,
        sequence_count=0,
        message_count=0,
        destination_id=0,
        time=CucTime(0, 0),
        time_status=0,
    )
    managed = ManagedParamsVerification(bytes_step_id=1, bytes_err_code=2)
    report = Service1Tm.from_tm(PusTm.unpack(raw, timestamp_len=7), managed)
    assert report.tc_req_id == TheirRequestId.from_pus_tc(ping)
    assert report.step_id == (None if step is None else PacketFieldEnum.with_byte_size(1, step))
    assert (None if report.error_code is None else report.error_code.val) == code
