"""Every row of ISO 15765-2's tables of errors but the timers: frames to ignore, unexpected arrivals, sequence
numbers, flow status, STmin.
"""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import pytest

from hil_tests.protocol.transport_bus import MS, US, S
from hil_tests.protocol.transport_end import (
    FD,
    GO_ON,
    UNIT,
    VIN,
    VIN_FRAMES,
    End,
    failed,
    lost,
    receiving,
    sending,
)
from st_emulator.protocol.can.frames import CanFrame
from st_emulator.protocol.can.transport import FrameIgnored, IsoTpSettings, PduReceived, PduSent
from st_emulator.protocol.pus.enumerations import TransferFailure as Why

# --- Frames to ignore ---


@pytest.mark.parametrize(
    ("settings", "frame", "reason"),
    [
        (UNIT, "", Why.BAD_LENGTH),
        (UNIT, "00 11 22 33 44 55 66 77", Why.BAD_LENGTH),  # 9.6.2.2: SF_DL is 0
        (UNIT, "00", Why.BAD_LENGTH),
        (UNIT, "08 11 22 33 44 55 66 77", Why.BAD_LENGTH),  # SF_DL beyond the frame
        (UNIT, "0F 11 22 33 44 55 66 77", Why.BAD_LENGTH),
        (UNIT, "02 11", Why.BAD_LENGTH),
        (UNIT, "10 14 11 22 33 44 55", Why.BAD_LENGTH),  # 9.6.3.2: a first frame below 8 bytes
        (UNIT, "10", Why.BAD_LENGTH),
        (UNIT, "10 07 11 22 33 44 55 66", Why.BAD_LENGTH),  # FF_DL below its minimum (table 14)
        (UNIT, "10 00 00 00 0F FF 11 22", Why.BAD_LENGTH),  # the escape where 12 bits are enough
        (UNIT, "10 00 00 00 00 00 11 22", Why.BAD_LENGTH),
        (UNIT, "21 11 22 33 44 55 66 77", Why.UNEXPECTED_PDU),  # 9.8.3, idle
        (UNIT, "20", Why.UNEXPECTED_PDU),
        (UNIT, "30 00 00", Why.UNEXPECTED_PDU),
        (UNIT, "32 00 00", Why.UNEXPECTED_PDU),
        (UNIT, "3F 00 00", Why.UNEXPECTED_PDU),
        (UNIT, "30 00", Why.BAD_LENGTH),  # 10.4.3
        (UNIT, "40 11 22", Why.BAD_PCI),  # 9.6.1, table 9: reserved
        (UNIT, "FF FF FF FF FF FF FF FF", Why.BAD_PCI),
        (FD, "08" + "AA" * 11, Why.BAD_LENGTH),  # 9.6.2.2: above 8 bytes only with the escape
        (FD, "08 0A" + "AA" * 10, Why.BAD_LENGTH),
        (FD, "00 07" + "AA" * 10, Why.BAD_LENGTH),  # table 13: 12 bytes carry 8 to 10
        (FD, "00 0B" + "AA" * 10, Why.BAD_LENGTH),
        (FD, "00 0A" + "AA" * 14, Why.BAD_LENGTH),  # 16 bytes carry 11 to 14
        (FD, "00 2E" + "AA" * 62, Why.BAD_LENGTH),  # 64 bytes carry 47 to 62
        (FD, "00 3F" + "AA" * 62, Why.BAD_LENGTH),
        (FD, "10 3E" + "AA" * 62, Why.BAD_LENGTH),  # it would have fitted into a single frame of 64
        (FD, "10 0A" + "AA" * 10, Why.BAD_LENGTH),
    ],
)
def test_ignored_in_idle_and_during_a_transfer(settings: IsoTpSettings, frame: str, reason: Why) -> None:
    end = End(settings)
    assert end.hears(frame, 7) == [FrameIgnored(reason, 7)]
    assert end.deadline_ns is None
    assert end.connection.counters.frames_ignored == end.connection.counters.by_reason[reason] == 1
    if reason is not Why.UNEXPECTED_PDU:
        busy = receiving(settings) if not settings.fd else End(settings)
        if settings.fd:
            busy.hears("10 3F" + "11" * 62)
            busy.says()
        assert busy.hears(frame, 7) == [FrameIgnored(reason, 7)]
        events = busy.hears(VIN_FRAMES[1] if not settings.fd else "21 11", 8)
        assert events == ([] if not settings.fd else [PduReceived(b"\x11" * 63, 8)])


def test_frames_that_are_not_ours() -> None:
    end = receiving()
    for other in (
        CanFrame(0x60B, bytes.fromhex(VIN_FRAMES[1])),
        CanFrame(0x60A, bytes.fromhex(VIN_FRAMES[1]), extended=True),
        CanFrame(0x60A, remote=True, remote_dlc=8),
        CanFrame(0x60A, bytes(8), error=True),
        CanFrame(0x58A, bytes.fromhex(VIN_FRAMES[1])),
    ):
        assert end.connection.receive(other, 5 * S) == []
    assert end.connection.counters.frames_ignored == 0


def test_a_classic_connection_ignores_can_fd() -> None:
    end = receiving()
    assert end.hears(VIN_FRAMES[1], fd=True) == [FrameIgnored(Why.BAD_PCI, 0)]
    assert end.hears(VIN_FRAMES[1]) == []


@pytest.mark.parametrize("frame", ["21 47 44 4D 39 41 58", "21", "22 47"])
def test_a_consecutive_frame_that_is_too_short_is_ignored(frame: str) -> None:
    """10.4.3; also where its sequence number is wrong: nothing in it is looked at."""
    end = receiving()
    assert end.hears(frame, 1) == [FrameIgnored(Why.BAD_LENGTH, 1)]
    assert end.hears(VIN_FRAMES[1], 2) == []
    assert end.hears("22 50 30 34 32 37 38", 3) == [FrameIgnored(Why.BAD_LENGTH, 3)]
    assert end.hears(VIN_FRAMES[2], 4) == [PduReceived(VIN, 4)]


def test_a_consecutive_frame_longer_than_the_first_is_ignored() -> None:
    end = End(FD)
    end.hears(VIN_FRAMES[0], fd=False)
    end.says()
    assert end.hears("21" + "47" * 15, 1) == [FrameIgnored(Why.BAD_LENGTH, 1)]
    assert end.hears(VIN_FRAMES[1], 2) == []


# --- Unexpected arrivals (9.8.3) and sequence errors (9.6.4.4) ---


def test_a_single_frame_ends_a_reception_and_is_received() -> None:
    end = receiving()
    assert end.hears("02 11 22", 5) == [*lost(Why.UNEXPECTED_PDU, 5), PduReceived(b"\x11\x22", 5)]
    assert end.hears(VIN_FRAMES[1], 6) == [FrameIgnored(Why.UNEXPECTED_PDU, 6)]
    assert end.deadline_ns is None


def test_a_first_frame_ends_a_reception_and_begins_another() -> None:
    end = receiving()
    end.hears(VIN_FRAMES[1], 1)
    assert end.hears("10 09" + "EE" * 6, 5) == lost(Why.UNEXPECTED_PDU, 5)
    assert end.says(5) == GO_ON
    assert end.hears("21 EE EE EE", 6) == [PduReceived(b"\xee" * 9, 6)]


def test_a_first_frame_again_gets_one_flow_control() -> None:
    end = End()
    assert end.hears(VIN_FRAMES[0]) == []
    assert end.hears(VIN_FRAMES[0], 1) == lost(Why.UNEXPECTED_PDU, 1)
    assert [end.says(2), end.says(2)] == [GO_ON, None]
    end.hears(VIN_FRAMES[1], 3)
    assert end.hears(VIN_FRAMES[2], 4) == [PduReceived(VIN, 4)]


@pytest.mark.parametrize("frame", ["20", "22", "2F"])
def test_a_wrong_sequence_number_ends_the_reception(frame: str) -> None:
    end = receiving()
    assert end.hears(frame + "AA" * 7, 5) == lost(Why.WRONG_SEQUENCE, 5)
    assert end.hears(VIN_FRAMES[1], 6) == [FrameIgnored(Why.UNEXPECTED_PDU, 6)]
    assert end.deadline_ns is None


def test_the_same_consecutive_frame_twice() -> None:
    end = receiving()
    assert end.hears(VIN_FRAMES[1]) == []
    assert end.hears(VIN_FRAMES[1], 3) == lost(Why.WRONG_SEQUENCE, 3)


@pytest.mark.parametrize("status", ["30", "31", "32", "37"])
@pytest.mark.parametrize("block", ["00", "02"])  # one block of all that is left
def test_flow_control_that_is_not_awaited_changes_nothing(status: str, block: str) -> None:
    """9.8.3: between the frames of a block, after the last one, before the first was handed over."""
    flow_control = f"{status} 01 7F"
    ignored = [FrameIgnored(Why.UNEXPECTED_PDU, 0)]
    end = sending()
    assert end.hears(flow_control) == ignored
    assert end.says() == VIN_FRAMES[0]
    end.hears(f"30 {block} 00")
    assert end.hears(flow_control) == ignored
    assert end.hands_over() == VIN_FRAMES[1]
    assert end.hears(flow_control) == ignored
    end.leaves(0)
    assert end.hands_over() == VIN_FRAMES[2]
    assert end.hears(flow_control) == ignored
    assert end.leaves(0) == [PduSent(len(VIN), 0)]


def test_both_directions_at_once() -> None:
    """9.8.3, full duplex: what comes does not touch what goes, and flow control overtakes."""
    end = sending()
    assert end.hands_over(0) == VIN_FRAMES[0]
    mine = end.frame
    assert end.hears(VIN_FRAMES[0], 1) == []
    assert end.says(1) == GO_ON
    assert end.hears("02 11 22", 2) == [*lost(Why.UNEXPECTED_PDU, 2), PduReceived(b"\x11\x22", 2)]
    assert end.connection.confirmed(mine, 3) == []
    end.hears("30 00 00", 4)
    assert end.hears(VIN_FRAMES[0], 5) == []
    assert [end.says(5), end.says(5)] == [GO_ON, VIN_FRAMES[1]]
    assert end.hears(VIN_FRAMES[1], 6) == []
    assert end.says(7) == VIN_FRAMES[2]
    assert end.events == [PduSent(len(VIN), 7)]
    assert end.hears(VIN_FRAMES[2], 8) == [PduReceived(VIN, 8)]


# --- Flow status (9.6.5.1, 9.6.5.2) and STmin (9.6.5.4, 9.6.5.5) ---


@pytest.mark.parametrize(
    ("flow_control", "reason"),
    [("32 00 00", Why.RECEIVER_OVERFLOW)]
    + [(f"3{status:X} 00 00", Why.INVALID_FLOW_STATUS) for status in range(3, 16)],
)
def test_flow_control_that_ends_the_transmission(flow_control: str, reason: Why) -> None:
    end = sending()
    end.says()
    assert end.hears(flow_control, 5) == failed(reason, 5)
    assert (end.connection.sending, end.deadline_ns) == (False, None)
    end.connection.send(b"\1", 6)
    assert end.says(6) == "01 01 CC CC CC CC CC CC"


@pytest.mark.parametrize("most", [0, 1, 10])
def test_wait_frames_have_a_limit(most: int) -> None:
    end = sending(bytes(6 + 7 + 7), replace(UNIT, wait_frames_max=most))
    end.says()
    for now_ns in range(most):
        assert end.hears("31 00 00", now_ns) == []
        assert end.says(now_ns) is None
    if most:  # to go on begins the count anew
        end.hears("30 01 00", 50)
        assert end.says(50)
        for _ in range(most):
            assert end.hears("31 00 00", 51) == []
    assert end.hears("31 00 00", 52) == failed(Why.WAIT_LIMIT, 52)
    assert end.connection.counters.wait_frames_received == (2 * most if most else 0) + 1


def test_a_pdu_that_is_too_long_gets_overflow() -> None:
    """9.6.3.2."""
    end = End(replace(UNIT, max_receive_bytes=20))
    assert end.hears("10 15" + "AA" * 6, 5) == lost(Why.TOO_LONG, 5, 21)
    assert end.says(5) == "32 00 00 CC CC CC CC CC"
    assert end.deadline_ns is None
    assert end.hears("10 00 FF FF FF FF AA AA", 6) == lost(Why.TOO_LONG, 6, 0xFFFFFFFF)
    assert end.hears(VIN_FRAMES[0], 7) == []
    assert [end.says(7), end.says(7)] == [GO_ON, None]  # the newest answer stands
    assert end.hears("10 15" + "AA" * 6, 8) == [*lost(Why.UNEXPECTED_PDU, 8), *lost(Why.TOO_LONG, 8, 21)]


def test_a_single_frame_that_is_too_long_is_lost() -> None:
    end = End(replace(UNIT, max_receive_bytes=2))
    assert end.hears("03 11 22 33", 1) == lost(Why.TOO_LONG, 1, 3)
    assert end.hears("02 11 22", 2) == [PduReceived(b"\x11\x22", 2)]


def test_an_announced_length_takes_no_memory() -> None:
    end = End(replace(UNIT, max_receive_bytes=0xFFFFFFFF))
    tracemalloc.start()
    try:
        assert end.hears("10 00 FF FF FF FF AA AA") == []
        assert tracemalloc.get_traced_memory()[1] < 100_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("stmin", "separation_ns"),
    [("00", 0), ("01", MS), ("7F", 127 * MS), ("F1", 100 * US), ("F9", 900 * US)]
    + [(f"{reserved:02X}", 127 * MS) for reserved in (0x80, 0xF0, 0xFA, 0xFF)],
)
def test_separation_time(stmin: str, separation_ns: int) -> None:
    """From the end of one consecutive frame to the hand-over of the next; not before the first."""
    end = sending()
    end.says(10)
    end.hears(f"30 00 {stmin}", 20)
    assert end.hands_over(20) == VIN_FRAMES[1]
    assert end.leaves(500) == []
    due_ns = 500 + separation_ns
    assert end.deadline_ns == due_ns
    assert end.hands_over(due_ns - 1) is None
    assert end.poll(due_ns - 1) == []
    assert end.hands_over(due_ns) == VIN_FRAMES[2]


def test_separation_time_holds_over_flow_control() -> None:
    """The newest value counts, from the frame before on."""
    end = sending()
    end.says()
    end.hears("30 01 00", 0)
    assert end.says(1 * MS) == VIN_FRAMES[1]
    end.hears("30 01 05", 3 * MS)
    assert end.deadline_ns == 6 * MS
    assert (end.hands_over(6 * MS - 1), end.hands_over(6 * MS)) == (None, VIN_FRAMES[2])


def test_a_reserved_separation_time_holds_up_to_the_end_of_the_pdu() -> None:
    end = sending(bytes(6 + 4 * 7))
    end.says()
    end.hears("30 01 80", 0)
    assert end.says(0)
    end.hears("30 00 00", 0)
    assert end.deadline_ns == 127 * MS
    assert end.says(127 * MS)
    assert end.deadline_ns == 254 * MS


def test_the_longest_separation_time_holds_up_to_the_next_flow_control() -> None:
    end = sending()
    end.says()
    end.hears("30 01 7F", 0)
    assert end.says(0)
    end.hears("30 00 00", 5)
    assert end.deadline_ns == 5
