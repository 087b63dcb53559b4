"""Bits of a frame on the wire, against a frame built bit by bit, can-utils' count and published lengths."""

from __future__ import annotations

from fractions import Fraction
from math import ceil

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hil_tests.protocol.can_frame_strategies import bus_frames, data_of
from st_emulator.protocol import LocalProtocolError
from st_emulator.protocol.can.bits import (
    BUS_OFF_RECOVERY_BITS,
    bits_duration_ns,
    frame_bits,
    frame_duration_ns,
)
from st_emulator.protocol.can.frames import CAN_FD_LENGTHS, CanFrame

# -- the frame, bit by bit, from the text of ISO 11898-1: (bit, the field it belongs to)


def bits_of(value: int, count: int) -> list[int]:
    return [value >> shift & 1 for shift in range(count - 1, -1, -1)]


def crc(bits: list[int], width: int, polynomial: int, register: int) -> int:
    """The pseudo-code of the CAN specification, 3.1.1 "CRC sequence"."""
    for bit in bits:
        next_bit = bit ^ (register >> width - 1 & 1)
        register = register << 1 & (1 << width) - 1
        if next_bit:
            register ^= polynomial
    return register


def stuffed(tagged: list[tuple[int, str]], *, behind_last: bool) -> list[tuple[int, str]]:
    out: list[tuple[int, str]] = []
    for index, item in enumerate(tagged):
        out.append(item)
        last = [bit for bit, _ in out[-5:]]
        # Five equal ones of the stream, stuff bits counted in, none of them already answered by one.
        run = 1
        while run < len(out) and out[-run - 1][0] == item[0]:
            run += 1
        if run == 5 and (behind_last or index < len(tagged) - 1):
            assert last == [item[0]] * 5
            out.append((1 - item[0], f"stuff {item[1]}"))
    return out


def wire(frame: CanFrame) -> list[tuple[int, str]]:
    identifier = frame.identifier
    head: list[tuple[int, str]] = [(0, "SOF")]
    if frame.extended:
        head += [(bit, "identifier") for bit in bits_of(identifier >> 18, 11)]
        head += [(1, "SRR"), (1, "IDE")]
        head += [(bit, "identifier") for bit in bits_of(identifier & 0x3FFFF, 18)]
    else:
        head += [(bit, "identifier") for bit in bits_of(identifier, 11)]
    if not frame.fd:
        dlc = frame.remote_dlc if frame.remote else len(frame.data)
        head += [(int(frame.remote), "RTR")]
        head += [(0, "r1"), (0, "r0")] if frame.extended else [(0, "IDE"), (0, "r0")]
        head += [(bit, "DLC") for bit in bits_of(dlc, 4)]
        head += [(bit, "data") for byte in frame.data for bit in bits_of(byte, 8)]
        sequence = crc([bit for bit, _ in head], 15, 0x4599, 0)
        head += [(bit, "CRC") for bit in bits_of(sequence, 15)]
        body = stuffed(head, behind_last=True)
    else:
        head += [(0, "RRS")]
        if not frame.extended:
            head += [(0, "IDE")]
        head += [(1, "FDF"), (0, "res"), (int(frame.bit_rate_switch), "BRS")]
        head += [(int(frame.error_state_indicator), "ESI")]
        head += [(bit, "DLC") for bit in bits_of(CAN_FD_LENGTHS.index(len(frame.data)), 4)]
        head += [(bit, "data") for byte in frame.data for bit in bits_of(byte, 8)]
        body = stuffed(head, behind_last=False)
        count = (len(body) - len(head)) % 8
        stuff_count = bits_of(count ^ count >> 1, 3)  # Gray code
        stuff_count.append(sum(stuff_count) % 2)  # even parity
        width, polynomial = (17, 0x1685B) if len(frame.data) <= 16 else (21, 0x102899)
        covered = [bit for bit, _ in body] + stuff_count
        field = stuff_count + bits_of(crc(covered, width, polynomial, 1 << width - 1), width)
        for index, bit in enumerate(field):
            if index % 4 == 0:
                body.append((1 - body[-1][0], "fixed stuff"))
            body.append((bit, "CRC"))
    tail = [(1, "CRC delimiter"), (0, "ACK"), (1, "ACK delimiter")]
    return body + tail + [(1, "EOF")] * 7 + [(1, "intermission")] * 3


DATA_PHASE = {"ESI", "DLC", "data", "CRC", "fixed stuff", "CRC delimiter"}


def counted(frame: CanFrame) -> tuple[int, int]:
    fields = [name for _, name in wire(frame)]
    if not frame.bit_rate_switch:
        return len(fields), 0
    data = sum(name.removeprefix("stuff ") in DATA_PHASE for name in fields)
    return len(fields) - data, data


@pytest.mark.parametrize(
    ("width", "polynomial", "check"),
    # Catalogue of parametrised CRC algorithms: CRC-15/CAN, CRC-17/CAN-FD, CRC-21/CAN-FD
    [(15, 0x4599, 0x059E), (17, 0x1685B, 0x04F03), (21, 0x102899, 0x0ED841)],
)
def test_the_reference_has_the_published_crcs(width: int, polynomial: int, check: int) -> None:
    message = [bit for byte in b"123456789" for bit in bits_of(byte, 8)]
    assert crc(message, width, polynomial, 0) == check


@given(bus_frames())
@settings(max_examples=300)
def test_the_reference_never_has_six_equal_bits_before_the_crc_delimiter(frame: CanFrame) -> None:
    bits = wire(frame)
    end = [name for _, name in bits].index("CRC delimiter")
    text = "".join(str(bit) for bit, _ in bits[:end])
    assert "000000" not in text
    assert "111111" not in text


@given(bus_frames())
@settings(max_examples=1000)
@example(CanFrame(0))
@example(CanFrame(0x7FF, fd=True, bit_rate_switch=True, error_state_indicator=True))
@example(CanFrame(1, bytes(64), fd=True, bit_rate_switch=True))
# Five equal bits end the data field: the fixed stuff bit is the only one there.
@example(CanFrame(0x555, b"\xaa" * 7 + b"\xa0", fd=True))
@example(CanFrame(0x555, b"\x55" * 7 + b"\x5f", fd=True, bit_rate_switch=True))
@example(CanFrame(0x15555555, b"\x55" * 63 + b"\x1f", extended=True, fd=True, bit_rate_switch=True))
def test_against_the_frame_built_bit_by_bit(frame: CanFrame) -> None:
    assert frame_bits(frame) == counted(frame)


def test_all_data_lengths_and_kinds() -> None:
    for extended in (False, True):
        for length in CAN_FD_LENGTHS:
            for data in (bytes(length), b"\xff" * length, (b"\x0f\x83" * 32)[:length]):
                kinds = [{"fd": True}, {"fd": True, "bit_rate_switch": True}] + [{}] * (length <= 8)
                for kind in kinds:
                    frame = CanFrame(0x0F0, data, extended, **kind)
                    assert frame_bits(frame) == counted(frame)
    for dlc in range(9):
        frame = CanFrame(0x0F0, remote=True, remote_dlc=dlc)
        assert frame_bits(frame) == counted(frame)


# What can-utils' canframelen.c counts, method "exact" (as canbusload -e).
CAN_UTILS = """
000 - 53
7FF - 50
555 - 48
2AA 55 56
123 DEADBEEF 81
000 0000000000000000 127
7FF FFFFFFFFFFFFFFFF 126
078 3C3C3C3C3C3C3C3C 131
480 3C3C3C3C3C3C3C80 132
100 00CA22FF5566AADF 117
08A 0123456789ABCDEF 114
18A 0A7FFFFFF8000000 122
70A 0102000200000E10 121
555 AAAAAAAAAAAAAAAA 112
5A5 5555555555555555 111
3C1 E1C3870F1E3C78F0 112
00000000 - 74
1FFFFFFF - 74
15555555 5555555555555555 131
18DAF110 0322F190CCCCCCCC 135
0000000A 0000000000000000 149
1FFFFFFF FFFFFFFFFFFFFFFF 149
01E0F078 3C3C3C3C3C3C3C3C 152
1EFBDFFC 3C3C3C3C3C3C3C20 154
16280A0A 30000ACCCCCCCCCC 138
14AAAAAA AAAAAAAAAAAAAAAA 131
"""


@pytest.mark.parametrize("case", CAN_UTILS.strip().splitlines())
def test_against_can_utils(case: str) -> None:
    name, data, bits = case.split()
    content = b"" if data == "-" else bytes.fromhex(data)
    frame = CanFrame(int(name, 16), content, extended=len(name) == 8)
    assert frame_bits(frame) == (int(bits), 0)


@pytest.mark.parametrize(
    ("extended", "fd", "length", "bare", "longest"),
    # Lengths with intermission, without and with the most stuff bits: the table in the Linux kernel's commit
    # "can: length: refactor frame lengths definition to add size in bits" (include/linux/can/length.h).
    [
        (False, False, 8, 111, 135),
        (True, False, 8, 131, 160),
        (False, True, 64, 579, 712),
        (True, True, 64, 598, 736),
    ],
)
def test_published_lengths(extended: bool, fd: bool, length: int, bare: int, longest: int) -> None:
    # Alternating bits leave nothing to stuff but perhaps in a CRC.
    identifier = 0x15555555 if extended else 0x5A5
    frame = CanFrame(identifier, b"\x55" * length, extended, fd=fd, bit_rate_switch=fd)
    assert sum(frame_bits(frame)) == bare

    @given(data_of(length), st.integers(0, (1 << (29 if extended else 11)) - 1))
    def within(data: bytes, identifier: int) -> None:
        assert bare <= sum(frame_bits(CanFrame(identifier, data, extended, fd=fd))) <= longest

    within()
    # The densest data there are, a stuff bit for every four bits of them, come close to the limit.
    dense = [
        sum(frame_bits(CanFrame(0x078 << 18 * extended, bytes([byte]) * length, extended, fd=fd)))
        for byte in (0x3C, 0x78, 0xF0, 0xE1, 0xC3, 0x87, 0x0F, 0x1E)
    ]
    assert max(dense) > longest - 12


def test_an_error_message_is_no_frame_of_the_bus() -> None:
    with pytest.raises(LocalProtocolError):
        frame_bits(CanFrame(0x40, bytes(8), error=True))


# -- durations


SAMPLE_POINTS = st.fractions(Fraction(1, 2), Fraction(9, 10), max_denominator=80)


def exact_duration_s(
    frame: CanFrame, bitrate: int, data_bitrate: int, points: tuple[Fraction, Fraction]
) -> Fraction:
    """Bit by bit; the rate changes at the sample points of BRS and of the CRC delimiter, the rest of them
    has the other rate. ``points``: the sample points, as parts of a bit, of the slow and of the fast rate.
    """
    slow, fast = Fraction(1, bitrate), Fraction(1, data_bitrate)
    total, now_fast = Fraction(0), False
    for _, name in wire(frame):
        if name == "BRS" and frame.bit_rate_switch:
            total += points[0] * slow + (1 - points[1]) * fast
            now_fast = True
        elif name == "CRC delimiter" and now_fast:
            total += points[1] * fast + (1 - points[0]) * slow
            now_fast = False
        else:
            total += fast if now_fast else slow
    return total


@given(
    bus_frames(),
    st.sampled_from([10_000, 83_333, 125_000, 500_000, 1_000_000]),
    st.sampled_from([500_000, 1_999_999, 4_000_000, 8_000_000]),
    SAMPLE_POINTS,
    SAMPLE_POINTS,
)
def test_durations_wherever_the_sample_points_lie(
    frame: CanFrame, bitrate: int, data_bitrate: int, slow: Fraction, fast: Fraction
) -> None:
    exact = exact_duration_s(frame, bitrate, data_bitrate, (slow, fast))
    assert frame_duration_ns(frame, bitrate, data_bitrate) == ceil(exact * 10**9)


def test_known_durations() -> None:
    frame = CanFrame(0x5A5, b"\x55" * 8)  # 111 bits
    assert frame_duration_ns(frame, 1_000_000, 4_000_000) == 111_000
    assert frame_duration_ns(frame, 500_000, 4_000_000) == 222_000
    long = CanFrame(0x5A5, b"\x55" * 64, fd=True, bit_rate_switch=True)  # 29 bits slow, 550 fast
    assert frame_duration_ns(long, 1_000_000, 4_000_000) == 29_000 + 137_500
    assert frame_duration_ns(long, 500_000, 2_000_000) == 58_000 + 275_000
    assert bits_duration_ns(BUS_OFF_RECOVERY_BITS, 1_000_000) == 1_408_000
    assert bits_duration_ns(1, 3_000_000) == 334
