"""SLIP: every case whole, byte by byte, with something behind it; no garbage costs a frame that follows."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_tests.vectors import reference_decoder
from st_emulator.protocol import (
    FrameDiscarded,
    FrameEvent,
    FrameReceived,
    FramingReason,
    LocalProtocolError,
    SlipDecoder,
    encode_telecommand,
    parse_telecommand,
    slip_encode,
)

LIMIT = 16


def received(text: str) -> FrameReceived:
    return FrameReceived(bytes.fromhex(text), 0)


def oversized(length: int) -> FrameDiscarded:
    return FrameDiscarded(FramingReason.OVERSIZED, length, 0)


def bad_escape(length: int) -> FrameDiscarded:
    return FrameDiscarded(FramingReason.BAD_ESCAPE, length, 0)


CASES: dict[str, tuple[str, list[FrameEvent]]] = {
    "nothing": ("", []),
    "frame": ("C0 01 02 03 C0", [received("010203")]),
    "two frames share nothing": ("C0 01 C0 C0 02 C0", [received("01"), received("02")]),
    "two frames share an END": ("C0 01 C0 02 C0", [received("01"), received("02")]),
    "empty frames": ("C0 C0 C0 C0", []),
    "END escaped": ("C0 DB DC C0", [received("C0")]),
    "ESC escaped": ("C0 DB DD C0", [received("DB")]),
    "escape codes as data": ("C0 DC DD C0", [received("DCDD")]),
    "all special": ("C0 DB DC DB DD DB DD DB DC C0", [received("C0DBDBC0")]),
    "garbage before the first END": ("11 22 C0 01 C0", [received("1122"), received("01")]),
    "unfinished": ("C0 01 02", []),
    "ESC before END": ("C0 01 DB C0 02 C0", [bad_escape(2), received("02")]),
    "ESC alone": ("C0 DB C0 02 C0", [bad_escape(1), received("02")]),
    "ESC ESC": ("C0 01 DB DB 03 C0 02 C0", [bad_escape(4), received("02")]),
    "ESC and something else": ("C0 01 DB 05 03 C0 02 C0", [bad_escape(4), received("02")]),
    "escapes after a bad one do not matter": ("C0 DB 05 DB DC DB C0 02 C0", [bad_escape(5), received("02")]),
    "as long as allowed": ("C0" + "01" * LIMIT + "C0", [received("01" * LIMIT)]),
    "as long as allowed, escaped": ("C0" + "DBDC" * LIMIT + "C0", [received("C0" * LIMIT)]),
    "one too long": ("C0" + "01" * (LIMIT + 1) + "C0 02 C0", [oversized(LIMIT + 1), received("02")]),
    "one too long by an escape": (
        "C0" + "01" * LIMIT + "DBDD C0 02 C0",
        [oversized(LIMIT + 2), received("02")],
    ),
    "much too long": ("C0" + "01" * 1000 + "C0 02 C0", [oversized(1000), received("02")]),
    "too long, then a bad escape": ("C0" + "01" * (LIMIT + 1) + "DB05 C0", [oversized(LIMIT + 3)]),
    "a bad escape, then too long": ("C0 DB05" + "01" * (LIMIT + 1) + "C0", [bad_escape(LIMIT + 3)]),
}


# What stands behind an unfinished frame belongs to it, so that only finished ones get something behind them.
BEHIND: dict[str, list[FrameEvent]] = {
    "": [],
    "33": [],
    "C0": [],
    "DB": [],
    "C0 44 C0": [received("44")],
}
WITH_BEHIND = [
    (case, behind)
    for case, (text, _) in CASES.items()
    for behind in BEHIND
    if not behind or text.endswith("C0")
]


@pytest.mark.parametrize(("case", "behind"), WITH_BEHIND)
def test_case(case: str, behind: str) -> None:
    text, events = CASES[case]
    expected = events + BEHIND[behind]
    line = bytes.fromhex(text) + bytes.fromhex(behind)

    assert SlipDecoder(LIMIT).receive(line, 0) == expected

    slow = SlipDecoder(LIMIT)
    assert [event for byte in line for event in slow.receive(bytes([byte]), 0)] == expected

    halves = SlipDecoder(LIMIT)
    cut = len(line) // 2
    assert halves.receive(line[:cut], 0) + halves.receive(line[cut:], 0) == expected


def test_a_frame_has_the_time_of_its_closing_end() -> None:
    decoder = SlipDecoder(LIMIT)
    assert decoder.receive(b"\xc0\x01", 10) == []
    assert decoder.receive(b"\x02\xc0\x03", 20) == [FrameReceived(b"\x01\x02", 20)]
    assert decoder.receive(b"\xdb", 30) == []
    assert decoder.receive(b"\xc0", 40) == [FrameDiscarded(FramingReason.BAD_ESCAPE, 2, 40)]


def test_reset_forgets_the_frame_in_progress() -> None:
    decoder = SlipDecoder(LIMIT)
    decoder.receive(b"\xc0\x01\xdb", 0)
    decoder.reset()
    assert decoder.receive(b"\x02\xc0", 0) == [FrameReceived(b"\x02", 0)]


def test_memory_is_bounded() -> None:
    decoder = SlipDecoder(LIMIT)
    for _ in range(1000):
        decoder.receive(b"\x01" * 1000, 0)
        assert len(decoder._frame) <= LIMIT
    assert decoder.receive(b"\xc0", 0) == [oversized(1_000_000)]


def test_a_decoder_needs_room_for_a_byte() -> None:
    with pytest.raises(LocalProtocolError, match="max_frame_bytes = 0; allowed: 1 or more"):
        SlipDecoder(0)


def test_encoding_by_hand() -> None:
    assert slip_encode(bytes.fromhex("00C001DBDCDD")).hex(" ") == "c0 00 db dc 01 db dd dc dd c0"


FRAMES = st.binary(min_size=1, max_size=LIMIT)
LINE_BYTES = st.sampled_from([0xC0, 0xDB, 0xDC, 0xDD, 0x00, 0x41]) | st.integers(0, 255)
GARBAGE = st.lists(LINE_BYTES, max_size=40).map(bytes)


@given(st.binary(max_size=100))
def test_encoding_equals_the_reference(data: bytes) -> None:
    assert slip_encode(data) == reference_decoder.slip_frame(data)


@given(st.lists(FRAMES, max_size=6), st.data())
def test_frames_come_back_however_the_line_is_cut(frames: list[bytes], data: st.DataObject) -> None:
    line = b"".join(slip_encode(frame) for frame in frames)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(line)), max_size=8)))
    decoder = SlipDecoder(LIMIT)
    events: list[FrameEvent] = []
    for start, end in zip([0, *cuts], [*cuts, len(line)], strict=True):
        events += decoder.receive(line[start:end], 0)
    assert events == [FrameReceived(frame, 0) for frame in frames]


@given(st.lists(st.tuples(GARBAGE, FRAMES), min_size=1, max_size=6), GARBAGE)
def test_no_garbage_costs_a_frame_that_follows(parts: list[tuple[bytes, bytes]], behind: bytes) -> None:
    line = b"".join(garbage + slip_encode(frame) for garbage, frame in parts) + behind
    events = SlipDecoder(LIMIT).receive(line, 0)
    found = iter(event.data for event in events if isinstance(event, FrameReceived))
    assert all(frame in found for _, frame in parts)  # in this order


@given(GARBAGE)
def test_any_line_decodes_as_the_reference_says(line: bytes) -> None:
    events = SlipDecoder(1000).receive(line, 0)
    assert [
        event.data for event in events if isinstance(event, FrameReceived)
    ] == reference_decoder.slip_frames(line)


@given(st.lists(st.tuples(GARBAGE, st.integers(0, 16383)), min_size=1, max_size=5))
def test_every_telecommand_in_garbage_is_found(parts: list[tuple[bytes, int]]) -> None:
    line = b"".join(
        garbage + slip_encode(encode_telecommand("ping", apid=0xC0, sequence_count=count))
        for garbage, count in parts
    )
    decoder = SlipDecoder(1024)
    events = [event for byte in line for event in decoder.receive(bytes([byte]), 0)]
    packets = [parse_telecommand(event.data) for event in events if isinstance(event, FrameReceived)]
    good = [packet for packet in packets if hasattr(packet, "name")]
    assert [packet.sequence_count for packet in good] == [count for _, count in parts]
