"""ISO-TP byte by byte: what stands in the frames of good transfers ("CC" fills them: ISO 15765-2, 10.4.2)."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hil_tests.protocol.transport_bus import MS
from hil_tests.protocol.transport_end import (
    FD,
    GO_ON,
    UNIT,
    VIN,
    VIN_FRAMES,
    End,
    sending,
)
from st_emulator.protocol import LocalProtocolError
from st_emulator.protocol.can.frames import CanFrame
from st_emulator.protocol.can.transport import IsoTpSettings, PduReceived, PduSent

# --- Good transfers ---


def test_a_number_is_received() -> None:
    end = End()
    assert end.hears(VIN_FRAMES[0], 1 * MS) == []
    assert end.hands_over(1 * MS) == GO_ON
    assert end.leaves(2 * MS) == []
    assert end.hears(VIN_FRAMES[1], 3 * MS) == []
    assert end.hears(VIN_FRAMES[2], 4 * MS) == [PduReceived(VIN, 4 * MS)]
    assert end.deadline_ns is None
    assert end.connection.counters.pdus_received == end.connection.counters.flow_controls_sent == 1


def test_a_number_is_sent() -> None:
    end = sending()
    assert end.hands_over(1 * MS) == VIN_FRAMES[0]
    assert end.hands_over(1 * MS) is None
    assert end.leaves(2 * MS) == []
    assert end.hands_over(3 * MS) is None
    assert end.hears("30 00 00", 4 * MS) == []
    assert end.hands_over(4 * MS) == VIN_FRAMES[1]
    assert end.leaves(5 * MS) == []
    assert end.hands_over(5 * MS) == VIN_FRAMES[2]
    assert end.connection.sending
    assert end.leaves(6 * MS) == [PduSent(len(VIN), 6 * MS)]
    assert not end.connection.sending
    assert (end.deadline_ns, end.connection.counters.pdus_sent) == (None, 1)


def test_a_frame_has_its_identifier_and_format() -> None:
    classic = sending().connection.next_frame(0)
    assert classic == CanFrame(0x58A, bytes.fromhex(VIN_FRAMES[0]))
    settings = IsoTpSettings(0x18DAF110, 0x18DA10F1, extended=True, fd=True, frame_bytes=64)
    assert sending(b"\1", settings).connection.next_frame(0) == CanFrame(
        0x18DAF110, bytes.fromhex("0101CCCCCCCCCCCC"), extended=True, fd=True, bit_rate_switch=True
    )
    slow = replace(settings, bit_rate_switch=False)
    frame = sending(b"\1", slow).connection.next_frame(0)
    assert frame is not None
    assert not frame.bit_rate_switch


@pytest.mark.parametrize(
    ("settings", "length", "frame"),
    [  # 9.6.2.1 (SF_DL, tables 11 to 13) and 10.4.2
        (UNIT, 1, "01 AA CC CC CC CC CC CC"),
        (UNIT, 7, "07 AA AA AA AA AA AA AA"),
        (replace(UNIT, padding=0), 2, "02 AA AA 00 00 00 00 00"),
        (replace(UNIT, padding=None), 2, "02 AA AA"),
        (FD, 7, "07 AA AA AA AA AA AA AA"),
        (replace(FD, padding=None), 1, "01 AA"),
        (FD, 8, "00 08 AA AA AA AA AA AA AA AA CC CC"),
        (replace(FD, padding=None), 11, "00 0B" + " AA" * 11 + " CC CC CC"),
        (replace(FD, padding=0), 11, "00 0B" + " AA" * 11 + " 00 00 00"),
        (FD, 62, "00 3E" + " AA" * 62),
        (replace(FD, frame_bytes=12), 10, "00 0A" + " AA" * 10),
        # 9.6.3.1 (FF_DL, table 14)
        (UNIT, 8, "10 08" + " AA" * 6),
        (UNIT, 4095, "1F FF" + " AA" * 6),
        (UNIT, 4096, "10 00 00 00 10 00 AA AA"),
        (UNIT, 0x12345, "10 00 00 01 23 45 AA AA"),
        (FD, 63, "10 3F" + " AA" * 62),
        (FD, 4096, "10 00 00 00 10 00" + " AA" * 58),
        (replace(FD, frame_bytes=12), 11, "10 0B" + " AA" * 10),
        (replace(FD, frame_bytes=8), 8, "10 08" + " AA" * 6),
    ],
)
def test_single_and_first_frames(settings: IsoTpSettings, length: int, frame: str) -> None:
    assert sending(b"\xaa" * length, settings).hands_over() == frame


@pytest.mark.parametrize(
    ("settings", "length", "frames"),
    [
        (UNIT, 14, ["21" + " AA" * 7, "22 AA CC CC CC CC CC CC"]),
        (replace(UNIT, padding=None), 14, ["21" + " AA" * 7, "22 AA"]),
        (FD, 62 + 63 + 9, ["21" + " AA" * 63, "22" + " AA" * 9 + " CC CC"]),
        (replace(FD, frame_bytes=12), 22, ["21" + " AA" * 11, "22 AA CC CC CC CC CC CC"]),
        (replace(FD, frame_bytes=12, padding=None), 22, ["21" + " AA" * 11, "22 AA"]),
    ],
)
def test_consecutive_frames(settings: IsoTpSettings, length: int, frames: list[str]) -> None:
    end = sending(b"\xaa" * length, settings)
    assert end.says()
    assert end.hears("30 00 00") == []
    assert [end.says(), end.says()] == frames
    assert end.events == [PduSent(length, 0)]


def test_sequence_numbers_go_round() -> None:
    """9.6.4.3: the first frame counts as 0, 15 is followed by 0."""
    end = sending(bytes(6 + 34 * 7))
    assert end.says()
    end.hears("30 00 00")
    heads = "".join(str(end.says())[:2] for _ in range(34))
    assert heads == "2122232425262728292A2B2C2D2E2F20" * 2 + "2122"


@pytest.mark.parametrize(
    ("settings", "frame"),
    [  # 9.6.5.3, and 9.6.5.4 table 20
        (UNIT, "30 00 00 CC CC CC CC CC"),
        (replace(UNIT, block_size=255, separation_time_us=127_000), "30 FF 7F CC CC CC CC CC"),
        (replace(UNIT, block_size=8, separation_time_us=100, padding=None), "30 08 F1"),
        (replace(UNIT, separation_time_us=900, padding=0x55), "30 00 F9 55 55 55 55 55"),
        (replace(FD, separation_time_us=1000), "30 00 01 CC CC CC CC CC"),
    ],
)
def test_flow_control_asks_for_what_the_settings_say(settings: IsoTpSettings, frame: str) -> None:
    end = End(settings)
    assert end.hears("10 46" + "AA" * (62 if settings.fd else 6)) == []
    assert end.hands_over() == frame


def test_flow_control_comes_after_each_block_but_the_last() -> None:
    """9.6.5.3. Of 6 + 4 x 7 bytes in blocks of 2: after the first frame and after two of four."""
    end = End(replace(UNIT, block_size=2))
    end.hears("10 22" + "AA" * 6)
    said = [end.says()]
    for number in range(1, 5):
        events = end.hears(f"2{number}" + "AA" * 7, number)
        said.append(end.says(number))
    assert said == ["30 02 00 CC CC CC CC CC", None, "30 02 00 CC CC CC CC CC", None, None]
    assert events == [PduReceived(b"\xaa" * 34, 4)]


def test_a_block_ends_where_the_other_side_said() -> None:
    end = sending(bytes(6 + 6 * 7))
    assert end.says()
    said = []
    for flow_control in ("30 01 00", "30 03 00", "30 00 00"):  # 9.6.5.6: each may ask for other values
        assert end.says() is None
        assert end.hears(flow_control) == []
        while text := end.says():
            said.append(text[:2])
        said.append("-")
    assert said == ["21", "-", "22", "23", "24", "-", "25", "26", "-"]
    assert end.events == [PduSent(48, 0)]


@pytest.mark.parametrize(
    ("settings", "frame"),
    [
        (UNIT, "01 AA"),  # the other side does not fill its frames
        (UNIT, "03 AA BB CC 00 00 00 00"),
        (UNIT, "07 01 02 03 04 05 06 07"),
        (FD, "01 AA"),
        (FD, "00 08 01 02 03 04 05 06 07 08 CC CC"),
        (FD, "00 0B" + "AA" * 14),
        (FD, "00 2F" + "AA" * 62),
        (FD, "00 3E" + "AA" * 62),
    ],
)
def test_single_frames_are_received(settings: IsoTpSettings, frame: str) -> None:
    raw = bytes.fromhex(frame)
    start, length = (1, raw[0]) if len(raw) <= 8 else (2, raw[1])
    assert End(settings).hears(frame, 5) == [PduReceived(raw[start : start + length], 5)]


def test_long_frames_are_received_with_a_shorter_last_one() -> None:
    """9.5.4: RX_DL is the length of the first frame, here 16 bytes; the last one may be shorter."""
    for last in ("22 AA", "22 AA CC CC CC CC CC CC", "22 AA" + "CC" * 14):
        end = End(FD)
        assert end.hears("10 1E" + "AA" * 14) == []
        assert end.says() == GO_ON
        assert end.hears("21" + "AA" * 15) == []
        assert end.hears(last, 9) == [PduReceived(b"\xaa" * 30, 9)]


def test_a_connection_of_can_fd_takes_classic_frames_too() -> None:
    end = End(FD)
    assert end.hears(VIN_FRAMES[0], fd=False) == []
    end.says()
    assert end.hears(VIN_FRAMES[1], fd=False) == []
    assert end.hears(VIN_FRAMES[2], fd=False) == [PduReceived(VIN, 0)]


# --- Settings and misuse ---


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("transmit_identifier", 0x800),
        ("receive_identifier", -1),
        ("receive_identifier", 0x58A),
        ("frame_bytes", 12),
        ("frame_bytes", 7),
        ("padding", 256),
        ("block_size", 256),
        ("separation_time_us", 128_000),
        ("separation_time_us", 1_100),
        ("separation_time_us", 50),
        ("separation_time_us", -100),
        ("max_receive_bytes", 0),
        ("max_receive_bytes", 1 << 32),
        ("n_as_ns", 0),
        ("n_bs_ns", 0),
        ("n_cr_ns", -1),
        ("wait_frames_max", 256),
    ],
)
def test_settings_that_the_protocol_does_not_have(field: str, value: int) -> None:
    with pytest.raises(LocalProtocolError) as refused:
        replace(UNIT, **{field: value})
    assert (refused.value.field, refused.value.value) == (field, value)


@pytest.mark.parametrize("frame_bytes", [7, 9, 13, 65])
def test_frame_lengths_that_can_fd_does_not_have(frame_bytes: int) -> None:
    with pytest.raises(LocalProtocolError):
        replace(FD, frame_bytes=frame_bytes)


def test_sending_nonsense() -> None:
    end = End()
    with pytest.raises(LocalProtocolError):
        end.connection.send(b"", 0)
    end.connection.send(b"\1", 0)
    with pytest.raises(LocalProtocolError):
        end.connection.send(b"\2", 0)
    assert end.says() == "01 01 CC CC CC CC CC CC"
    assert end.events == [PduSent(1, 0)]
