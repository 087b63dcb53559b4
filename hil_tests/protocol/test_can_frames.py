"""CAN frames, their records and candump's text, against struct, python-can and can-utils."""

from __future__ import annotations

import io
import os
import shutil
import struct
import subprocess
from dataclasses import astuple
from pathlib import Path

import pytest
from can import Message
from can.io.canutils import CanutilsLogReader, CanutilsLogWriter
from hypothesis import given
from hypothesis import strategies as st

from hil_tests.protocol.can_frame_strategies import bus_frames, frames
from st_emulator.protocol import LocalProtocolError
from st_emulator.protocol.can.frames import (
    CAN_FD_LENGTHS,
    MAX_RECORD_BYTES,
    CanFrame,
    RecordDecoder,
    candump_line,
    encode_record,
    padded_length,
    parse_candump,
)

KNOWN = [
    (CanFrame(0x123), "00000123 00 00 0000", "123#"),
    (CanFrame(0x044, b"\x2a\x36\x6c"), "00000044 03 00 0000 2A366C", "044#2A366C"),
    (CanFrame(0x7FF, bytes(8)), "000007FF 08 00 0000 0000000000000000", "7FF#0000000000000000"),
    (CanFrame(0x18DAF110, b"\x3e", extended=True), "98DAF110 01 00 0000 3E", "18DAF110#3E"),
    (CanFrame(0x1, extended=True), "80000001 00 00 0000", "00000001#"),
    (CanFrame(0x123, remote=True, remote_dlc=5), "40000123 05 00 0000", "123#R5"),
    (CanFrame(0x123, extended=True, remote=True), "C0000123 00 00 0000", "00000123#R"),
    (CanFrame(0x123, b"\x11" * 12, fd=True), f"00000123 0C 04 0000 {'11' * 12}", "123##0" + "11" * 12),
    (CanFrame(0x123, fd=True, bit_rate_switch=True), "00000123 00 05 0000", "123##1"),
    (
        CanFrame(0x5, b"\xab", True, fd=True, bit_rate_switch=True, error_state_indicator=True),
        "80000005 01 07 0000 AB",
        "00000005##3AB",
    ),
    (
        CanFrame(0x040, bytes(6) + b"\x88\x01", error=True),
        "20000040 08 00 0000 0000000000008801",
        "20000040#0000000000008801",
    ),
]
IDS = [text for *_, text in KNOWN]


@pytest.mark.parametrize(("frame", "record", "text"), KNOWN, ids=IDS)
def test_known(frame: CanFrame, record: str, text: str) -> None:
    assert encode_record(frame) == bytes.fromhex(record)
    assert RecordDecoder().receive(bytes.fromhex(record)) == [frame]
    assert frame.candump() == text
    assert parse_candump(f"(1436509052.249713) vcan0 {text}") == (1436509052249713000, "vcan0", frame)


@pytest.mark.parametrize(
    ("field", "arguments"),
    [
        ("identifier", {"identifier": 0x800}),
        ("identifier", {"identifier": -1}),
        ("identifier", {"identifier": 1 << 29, "extended": True}),
        ("identifier", {"identifier": 1 << 29, "error": True, "data": bytes(8)}),
        ("data", {"identifier": 1, "data": bytes(9)}),
        ("data", {"identifier": 1, "data": bytearray(2)}),
        ("data", {"identifier": 1, "data": bytes(9), "fd": True}),
        ("data", {"identifier": 1, "data": bytes(65), "fd": True}),
        ("bit_rate_switch", {"identifier": 1, "bit_rate_switch": True}),
        ("error_state_indicator", {"identifier": 1, "error_state_indicator": True}),
        ("remote", {"identifier": 1, "fd": True, "remote": True}),
        ("data", {"identifier": 1, "data": b"x", "remote": True}),
        ("remote_dlc", {"identifier": 1, "remote": True, "remote_dlc": 9}),
        ("remote_dlc", {"identifier": 1, "remote": True, "remote_dlc": -1}),
        ("remote_dlc", {"identifier": 1, "data": bytes(3), "remote_dlc": 3}),
        ("error", {"identifier": 1, "data": bytes(8), "error": True, "extended": True}),
        ("error", {"identifier": 1, "data": bytes(8), "error": True, "fd": True}),
        ("error", {"identifier": 1, "error": True, "remote": True}),
        ("data", {"identifier": 1, "data": bytes(7), "error": True}),
    ],
)
def test_frames_that_cannot_be(field: str, arguments: dict) -> None:
    with pytest.raises(LocalProtocolError) as caught:
        CanFrame(**arguments)
    assert caught.value.field == field


def test_padded_length() -> None:
    for length in range(65):
        assert padded_length(length) == min(valid for valid in CAN_FD_LENGTHS if valid >= length)
    for length in (-1, 65, 4095):
        with pytest.raises(LocalProtocolError):
            padded_length(length)


# -- arbitration


def arbitration_bits(frame: CanFrame) -> str:
    """The arbitration field and IDE as they are sent: the first difference decides, dominant (0) wins."""
    last = str(int(frame.remote))
    if not frame.extended:
        return f"{frame.identifier:011b}{last}0"
    bits = f"{frame.identifier:029b}"
    return f"{bits[:11]}11{bits[11:]}{last}"


@given(bus_frames(), bus_frames())
def test_the_key_decides_as_the_bits_do(first: CanFrame, second: CanFrame) -> None:
    bits = arbitration_bits(first), arbitration_bits(second)
    assert (first.arbitration_key < second.arbitration_key) == (bits[0] < bits[1])
    assert (first.arbitration_key == second.arbitration_key) == (bits[0] == bits[1])


def test_the_order_of_frames_that_share_their_first_bits() -> None:
    base = 0x123
    ordered = [
        CanFrame(base - 1, extended=False),
        CanFrame(base),
        CanFrame(base, remote=True),
        CanFrame(base << 18, extended=True),
        CanFrame(base << 18, extended=True, remote=True),
        CanFrame((base << 18) + 1, extended=True),
        CanFrame((base << 18) + 0x3FFFF, extended=True),
        CanFrame(base + 1),
    ]
    keys = [frame.arbitration_key for frame in ordered]
    assert keys == sorted(set(keys))


# -- records


def decode_with_struct(record: bytes) -> tuple:
    """Fields of a LINKTYPE_CAN_SOCKETCAN packet in the order of CanFrame's."""
    word, length, flags, reserved = struct.unpack_from(">IBBH", record)
    assert reserved == 0
    extended, remote, error = (bool(word & bit) for bit in (1 << 31, 1 << 30, 1 << 29))
    payload = record[struct.calcsize(">IBBH") :]
    assert len(payload) == (0 if remote else length)
    fd, switch, passive = (bool(flags & bit) for bit in (4, 1, 2))
    assert flags < 8
    return (
        word & (1 << 29) - 1,
        payload,
        extended,
        fd,
        switch,
        remote,
        error,
        length if remote else 0,
        passive,
    )


@given(frames())
def test_records_against_struct(frame: CanFrame) -> None:
    record = encode_record(frame)
    assert len(record) <= MAX_RECORD_BYTES
    assert decode_with_struct(record) == astuple(frame)


@given(st.lists(frames(), max_size=6), st.data())
def test_records_in_any_pieces(sent: list[CanFrame], data: st.DataObject) -> None:
    stream = b"".join(encode_record(frame) for frame in sent)
    decoder, received, start = RecordDecoder(), [], 0
    while start < len(stream):
        end = data.draw(st.integers(start + 1, len(stream)))
        received += decoder.receive(stream[start:end])
        start = end
    assert received == sent
    assert decoder.malformed == 0


MALFORMED = {
    "11 bits exceeded": "00000800 00 00 0000",
    "classic of 9 bytes": f"00000001 09 00 0000 {'00' * 9}",
    "FD of 9 bytes": f"00000001 09 04 0000 {'00' * 9}",
    "65 bytes": f"00000001 41 04 0000 {'00' * 65}",
    "255 bytes": f"00000001 FF 04 0000 {'00' * 255}",
    "BRS without FDF": "00000001 00 01 0000",
    "unknown flag": "00000001 00 0C 0000",
    "remote FD": "40000001 00 04 0000",
    "remote DLC 9": "40000001 09 00 0000",
    "error of 7 bytes": f"20000001 07 00 0000 {'00' * 7}",
    "error, extended": f"A0000001 08 00 0000 {'00' * 8}",
}


@pytest.mark.parametrize("case", MALFORMED)
def test_malformed_records_are_counted_and_the_next_is_received(case: str) -> None:
    frame = CanFrame(0x123, b"\x01\x02")
    record = bytes.fromhex(MALFORMED[case])
    decoder = RecordDecoder()
    assert decoder.receive(encode_record(frame) + record + encode_record(frame)) == [frame, frame]
    assert decoder.malformed == 1
    slow = RecordDecoder()
    assert [one for byte in record + encode_record(frame) for one in slow.receive(bytes([byte]))] == [frame]
    assert slow.malformed == 1


def test_reserved_bytes_are_not_looked_at() -> None:
    assert RecordDecoder().receive(bytes.fromhex("00000001 01 00 FFFF AB")) == [CanFrame(1, b"\xab")]


def test_reset_forgets_the_record_in_progress() -> None:
    decoder = RecordDecoder()
    assert decoder.receive(encode_record(CanFrame(1, bytes(8)))[:-1]) == []
    assert decoder.incomplete
    decoder.reset()
    assert not decoder.incomplete
    assert decoder.malformed == 1
    assert decoder.receive(encode_record(CanFrame(2))) == [CanFrame(2)]
    decoder.reset()  # nothing was in progress
    assert decoder.malformed == 1


@given(st.binary(max_size=400))
def test_any_bytes_are_frames_and_counted_records(stream: bytes) -> None:
    decoder = RecordDecoder()
    received = decoder.receive(stream)
    records = start = 0
    while start + 8 <= len(stream):
        end = start + 8 + (0 if stream[start] & 0x40 else stream[start + 4])
        if end > len(stream):
            break
        records, start = records + 1, end
    assert len(received) + decoder.malformed == records
    for frame in received:
        assert encode_record(frame)[:6] in stream


# -- candump


@given(frames(), st.integers(0, 4 * 10**18), st.sampled_from(["vcan0", "can1", "slcan0"]))
def test_candump_lines_come_back(frame: CanFrame, time_ns: int, channel: str) -> None:
    line = candump_line(frame, time_ns, channel)
    assert parse_candump(line) == (time_ns // 1000 * 1000, channel, frame)
    assert parse_candump(line.lower().replace("#r", "#R") + "\n") == parse_candump(line)
    assert parse_candump(line.split(maxsplit=1)[1]) == (None, channel, frame)
    assert line.startswith(f"({time_ns // 10**9:010d}.{time_ns % 10**9 // 1000:06d}) {channel} ")


def fields_of(message: Message) -> tuple:
    return (
        message.arbitration_id,
        b"" if message.is_remote_frame else bytes(message.data),
        message.is_extended_id,
        message.is_fd,
        bool(message.bitrate_switch),
        message.is_remote_frame,
        message.dlc if message.is_remote_frame else 0,
        bool(message.error_state_indicator),
    )


def fields_of_ours(frame: CanFrame) -> tuple:
    return (
        frame.identifier,
        frame.data,
        frame.extended,
        frame.fd,
        frame.bit_rate_switch,
        frame.remote,
        frame.remote_dlc,
        frame.error_state_indicator,
    )


@given(st.lists(bus_frames(), min_size=1, max_size=8))
def test_python_can_reads_what_we_write(sent: list[CanFrame]) -> None:
    times = [1_700_000_000_000_001_000 + 111_000 * index for index in range(len(sent))]
    log = "".join(
        candump_line(frame, time_ns, "vcan0") + "\n" for frame, time_ns in zip(sent, times, strict=True)
    )
    messages = list(CanutilsLogReader(io.StringIO(log)))
    assert [fields_of(message) for message in messages] == [fields_of_ours(frame) for frame in sent]
    assert [round(message.timestamp * 10**6) * 1000 for message in messages] == times
    assert {message.channel for message in messages} == {"vcan0"}


@given(st.lists(bus_frames(), min_size=1, max_size=8))
def test_we_read_what_python_can_writes(sent: list[CanFrame]) -> None:
    log = io.StringIO()
    writer = CanutilsLogWriter(log, channel="can0")
    for index, frame in enumerate(sent):
        writer.on_message_received(
            Message(
                timestamp=1_700_000_000.25 + index,
                arbitration_id=frame.identifier,
                is_extended_id=frame.extended,
                is_remote_frame=frame.remote,
                is_fd=frame.fd,
                bitrate_switch=frame.bit_rate_switch,
                error_state_indicator=frame.error_state_indicator,
                dlc=frame.remote_dlc if frame.remote else len(frame.data),
                data=None if frame.remote else frame.data,
                is_rx=index % 2 == 0,
                check=True,
            )
        )
    lines = [parse_candump(line) for line in log.getvalue().splitlines()]
    # Its writer leaves out how many bytes a remote frame asks for.
    expected = [CanFrame(f.identifier, extended=f.extended, remote=True) if f.remote else f for f in sent]
    assert [line and line.frame for line in lines] == expected
    assert [line and line.time_ns for line in lines] == [
        1_700_000_000_250_000_000 + index * 10**9 for index in range(len(sent))
    ]


def test_python_can_and_we_write_error_messages_alike() -> None:
    log = io.StringIO()
    CanutilsLogWriter(log).on_message_received(Message(timestamp=1.0, is_error_frame=True))
    assert parse_candump(log.getvalue()) is None  # it writes none of the eight bytes that the driver gave
    line = candump_line(CanFrame(0x88, bytes(8), error=True), 10**9, "vcan0")
    assert [message.is_error_frame for message in CanutilsLogReader(io.StringIO(line))] == [True]


@pytest.mark.skipif(
    shutil.which("log2asc") is None and not os.environ.get("CI"), reason="can-utils are not installed"
)
def test_can_utils_read_what_we_write(tmp_path: Path) -> None:
    log = tmp_path / "frames.log"
    sent = [frame for frame, *_ in KNOWN]
    log.write_text("".join(candump_line(f, 10**9 + n * 1000, "vcan0") + "\n" for n, f in enumerate(sent)))
    done = subprocess.run(
        ["log2asc", "-I", str(log), "vcan0"], capture_output=True, text=True, check=True, timeout=60
    )
    shown = [line.split() for line in done.stdout.splitlines()[3:]]
    assert len(shown) == len(sent)
    for frame, words in zip(sent, shown, strict=True):
        if frame.error:
            assert words[2] == "ErrorFrame"
            continue
        name = f"{frame.identifier:X}" + ("x" if frame.extended else "")
        if frame.fd:
            flags = [str(int(frame.bit_rate_switch)), str(int(frame.error_state_indicator))]
            assert words[1] == "CANFD"
            assert words[4:7] == [name, *flags]
            assert int(words[8]) == len(frame.data)
            assert bytes.fromhex("".join(words[9 : 9 + len(frame.data)])) == frame.data
        elif frame.remote:
            assert words[2:] == [name, "Rx", "r", str(frame.remote_dlc)]
        else:
            assert words[2:6] == [name, "Rx", "d", str(len(frame.data))]
            assert bytes.fromhex("".join(words[6:])) == frame.data


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        # README of can-utils: log format
        ("(1436509052.249713) vcan0 044#2A366C2BBA", (1436509052249713000, "vcan0", 0x044)),
        ("(1436509053.850870) vcan0 0A6#R2 T", (1436509053850870000, "vcan0", 0x0A6)),
        ("(0.000000001) can0 12345678#  R", (1, "can0", 0x12345678)),
        ("(1.5) can0 123##5AA", (1_500_000_000, "can0", 0x123)),  # newer kernels: with the FDF bit
        ("can0 123#1122334455667788_B", (None, "can0", 0x123)),  # raw DLC above 8
    ],
)
def test_lines_of_can_utils(line: str, expected: tuple) -> None:
    parsed = parse_candump(line)
    assert parsed is not None
    assert (parsed.time_ns, parsed.channel, parsed.frame.identifier) == expected


@pytest.mark.parametrize(
    "line",
    [
        "",
        "\n",
        "# comment",
        "(1.0) vcan0",
        "(1.0) vcan0 12#00",
        "(1.0) vcan0 1234#00",
        "(1.0) vcan0 800#00",
        "(1.0) vcan0 FFFFFFFF#00",
        "(1.0) vcan0 40000001#00",
        "(1.0) vcan0 40000001#",
        "(1.0) vcan0 123#0",
        "(1.0) vcan0 123#R9",
        "(1.0) vcan0 123#001122334455667788",
        "(1.0) vcan0 123##0" + "00" * 9,
        "(1.0) vcan0 123##800",
        "(1.0) vcan0 123#0x",
        "(1.0) vcan0 20000001#00",
        "(x) vcan0 123#00",
        "(1) vcan0 123#00",
        "(-1.0) vcan0 123#00",
        "(1.0) vcan0 123#00 X",
        "(1.0) vcan0 123#\u0661\u0662",
    ],
)
def test_what_is_no_line(line: str) -> None:
    assert parse_candump(line) is None


@given(st.text(alphabet="0123456789ABCDEFabcdef#R.() _vcan\u0664\n", max_size=60))
def test_any_text_is_a_line_or_none(text: str) -> None:
    parsed = parse_candump(text)
    if parsed is not None:
        assert parse_candump(f"{parsed.channel} {parsed.frame.candump()}") == (
            None,
            parsed.channel,
            parsed.frame,
        )


def test_lines_that_cannot_be() -> None:
    frame = CanFrame(1)
    for time_ns, channel in ((-1, "vcan0"), (0, ""), (0, "two words"), (0, " vcan0")):
        with pytest.raises(LocalProtocolError):
            candump_line(frame, time_ns, channel)
