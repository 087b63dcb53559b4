"""Octets worked out by hand from CiA 301 and the card's tables; where each comes from stands beside it."""

from __future__ import annotations

import struct
from binascii import crc_hqx

import pytest

from hil_tests.dialects.canopen import client
from hil_tests.dialects.canopen.bench import MS, make
from st_emulator.protocol.canopen.time_codes import scet_of, unix_us_of_scet, unix_us_of_utc, utc_of
from st_emulator.protocol.canopen.transfers import crc16


def octets(text: str) -> bytes:
    return bytes.fromhex(text)


#: (request, answers), on 62Ch and 5ACh, of a unit that has booted.
VECTORS = {
    # 40: upload (2 << 5) of 1017h. 4B: answer (2 << 5) | n=2 << 2 | e | s; 03E8h = 1000 ms.
    "heartbeat time": ("40 1710 00 00000000", ["4b 1710 00 e803 0000"]),
    # 4F: n=3, one octet: STANDBY is 2.
    "status": ("40 0040 00 00000000", ["4f 0040 00 02 000000"]),
    # 43: n=0, four octets: 0.0 as IEEE 754.
    "attitude_real": ("40 0240 05 00000000", ["43 0240 05 00000000"]),
    # RPDO 1's only mapped object: 2010h, sub 0, 64 = 40h bits.
    "mapping": ("40 0016 01 00000000", ["43 0016 01 40001020"]),
    # 181h: TPDO 1 of node 1.
    "RPDO 1": ("40 0014 01 00000000", ["43 0014 01 81010000"]),
    # TPDO 5: 181h + 2Ch = 1ADh.
    "TPDO 5": ("40 0418 01 00000000", ["43 0418 01 ad010000"]),
    # 23: download, n=0, e, s: delay 4001h:2 = 1000 = 3E8h; 60: done (3 << 5).
    "write delay": ("23 0140 02 e8030000", ["60 0140 02 00000000"]),
    # 06020000h, little-endian: no object.
    "no object": ("40 9999 00 00000000", ["80 9999 00 00000206"]),
    # 06090011h: no sub-index.
    "no sub-index": ("40 1810 09 00000000", ["80 1810 09 11000906"]),
    # 06010002h: write of a read-only object; 2F: n=3.
    "read only": ("2f 0110 00 01000000", ["80 0110 00 02000106"]),
    # 06010001h: read of a write-only object, 3003h:1.
    "write only": ("40 0330 01 00000000", ["80 0330 01 01000106"]),
    # 06070012h: four octets for an u16.
    "too long": ("23 1710 00 e8030000", ["80 1710 00 12000706"]),
    # 06090031h: 3003h:1 is at most 4.
    "too high": ("2f 0330 01 05000000", ["80 0330 01 31000906"]),
    # 05040001h: command specifier 7 does not exist.
    "command": ("e0 0000 00 00000000", ["80 0000 00 01000405"]),
    # "roja1": 5 octets do not fit; 41: segmented, size 5.
    "segmented": ("40 0810 00 00000000", ["41 0810 00 05000000"]),
    # A4: block upload with CRC; 7F segments, no switch. C6: (6 << 5) | CRC | size.
    "block upload": ("a4 0810 00 7f 00 0000", ["c6 0810 00 05000000"]),
    # Switch threshold 5: as an ordinary upload.
    "switched": ("a4 0810 00 7f 05 0000", ["41 0810 00 05000000"]),
    # 05040002h: a block of 0 segments.
    "block size": ("a4 0810 00 00 00 0000", ["80 0810 00 02000405"]),
    # An abort is not answered.
    "abort": ("80 0810 00 00000008", []),
}


@pytest.fixture(scope="module")
def booted():
    return make().boot()


@pytest.mark.parametrize("name", VECTORS)
def test_request_and_answer(booted, name):
    request, answers = VECTORS[name]
    assert booted.exchange(octets(request)) == [octets(answer) for answer in answers]
    booted.exchange(octets("80 0000 00 00000000"))  # whatever transfer it began is over


def test_segments_of_the_name(booted):
    assert booted.exchange(octets("40 0810 00 00000000")) == [octets("41 0810 00 05000000")]
    # 60: the first segment, toggle 0. 05: n = 2 unused << 1 | last; 72 6f 6a 61 31 is "roja1".
    assert booted.exchange(octets("60 00000000000000")) == [octets("05 726f6a6131 0000")]


def test_a_block_of_the_name(booted):
    assert booted.exchange(octets("a4 0810 00 7f 00 0000")) == [octets("c6 0810 00 05000000")]
    # A3: go on. 81: segment 1, the last.
    assert booted.exchange(octets("a3 00000000000000")) == [octets("81 726f6a6131 0000")]
    # A2: segment 1 is here. C9: (6 << 5) | 2 unused << 2 | 1; then the CRC, computed bit by bit.
    crc = client.crc16(b"roja1")
    assert booted.exchange(octets("a2 01 7f 0000000000")) == [b"\xc9" + struct.pack("<H", crc) + bytes(5)]
    assert booted.exchange(octets("a1 00000000000000")) == []


def test_boot_up_heartbeat_and_timers():
    bench = make(heartbeat_ms=100)
    bench.run(506)
    (boot, boot_data), (first, first_data), *_ = bench.heartbeats
    assert boot_data == b"\x00"  # the boot-up message
    assert first_data == b"\x05"  # operational
    assert abs(first - boot - 100 * MS) < 10_000  # but for stuff bits of 1 us


def test_the_check_word_of_the_standard():
    # The check value of CRC-16/XMODEM, which CiA 301 takes: 31C3h of "123456789".
    assert crc16(b"123456789") == 0x31C3
    assert client.crc16(b"123456789") == crc_hqx(b"123456789", 0) == 0x31C3


def test_time_codes():
    # 2026-01-15T00:00:00Z is 1768435200 = 69682E00h; half a second is 500000 = 07A120h microseconds.
    value = scet_of(1_768_435_200_500_000)
    assert value.to_bytes(8, "little") == octets("002e6869 20a107 00")
    assert unix_us_of_scet(value) == 1_768_435_200_500_000
    # 20468 days = 4FF4h since 1970; 500 ms = 1F4h, 7 us.
    value = utc_of(1_768_435_200_500_007)
    assert value.to_bytes(8, "little") == octets("f44f f4010000 0700")
    assert unix_us_of_utc(value) == 1_768_435_200_500_007


def test_times_that_are_none():
    assert unix_us_of_scet(1_000_000 << 32) is None
    assert unix_us_of_scet(999_999 << 32 | 0xAB << 56) == 999_999  # the last octet is not looked at
    assert unix_us_of_utc(86_400_000 << 16) is None
    assert unix_us_of_utc(1000 << 48) is None
