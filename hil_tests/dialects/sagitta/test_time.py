"""Time: Unix microseconds on the wire, TAI in the device, words in either order."""

from __future__ import annotations

import struct

import pytest

from hil_tests.dialects.sagitta import client
from hil_tests.dialects.sagitta.bench import MS, START_UNIX_US, at_rest, line_ns
from hil_tests.dialects.sagitta.client import ACTION, SET_TIME
from st_emulator.dialects.sagitta.unix_time import tai_ns_from_unix, unix_us_from_tai

PERIOD_MS = 250
# Seconds from 1958 to 1970: 12 years, of which 1960, 1964 and 1968 are leap years.
EPOCHS_S = (12 * 365 + 3) * 86400


def test_known_times() -> None:
    # TAI - UTC: 37 s since 2017, 36 s in 2016 (IERS Bulletin C).
    assert tai_ns_from_unix(START_UNIX_US) == (1_768_435_200 + EPOCHS_S + 37) * 10**9
    before, after = 1_483_228_799_000_000, 1_483_228_800_000_000  # around 2017-01-01T00:00:00Z
    assert tai_ns_from_unix(before) == (1_483_228_799 + EPOCHS_S + 36) * 10**9
    assert tai_ns_from_unix(after) == (1_483_228_800 + EPOCHS_S + 37) * 10**9


@pytest.mark.parametrize(
    "unix_us", [63_072_000_000_000, 1_483_228_799_999_999, 1_483_228_800_000_000, START_UNIX_US + 123_457]
)
def test_there_and_back(unix_us: int) -> None:
    tai_ns = tai_ns_from_unix(unix_us)
    assert tai_ns is not None
    assert unix_us_from_tai(tai_ns) == unix_us


def test_what_the_clock_cannot_hold() -> None:
    turnover_us = (2**32 - EPOCHS_S) * 10**6
    assert tai_ns_from_unix(turnover_us) is None
    assert tai_ns_from_unix(turnover_us - 37 * 10**6) is None  # TAI is 37 s ahead
    assert tai_ns_from_unix(2**64 - 1) is None
    assert tai_ns_from_unix(0) is not None


def set_time(bench, octets: bytes) -> int:
    """Sends it; the virtual time of the last bit's arrival."""
    line = client.request(ACTION, SET_TIME, octets)
    arrival_ns = bench.now_ns + line_ns(len(line))
    bench.put(line)
    (reply,) = bench.run(20)
    assert (reply.type, reply.id, reply.status) == (client.ACTION_REPLY, SET_TIME, 0)
    return arrival_ns


def test_time_is_right_from_the_next_frame_on() -> None:
    bench = at_rest()
    before = bench.telemetry(client.TEMPERATURE)
    assert before.time_us < 10_000_000  # since the start
    arrival_ns = set_time(bench, START_UNIX_US.to_bytes(8, "little"))
    bench.run(PERIOD_MS)
    for id_ in (client.TIME, client.POWER):
        frame = bench.telemetry(id_)
        sent_ns = frame.t_ns - line_ns(frame.line_bytes)
        assert abs(frame.time_us - (START_UNIX_US + (sent_ns - arrival_ns) / 1000)) <= 1
    assert struct.unpack("<IQ", bench.telemetry(client.TIME).data)[1] == bench.frames[-1].time_us


def test_not_before_the_next_frame() -> None:
    bench = at_rest()
    period_ns = PERIOD_MS * MS
    start_ns = (bench.now_ns // period_ns + 1) * period_ns
    bench.emulator.advance(start_ns + 5 * MS)
    set_time(bench, START_UNIX_US.to_bytes(8, "little"))
    assert bench.telemetry(client.TIME).time_us < 10_000_000
    bench.emulator.advance(start_ns + period_ns)
    assert bench.telemetry(client.TIME).time_us >= START_UNIX_US


def test_the_upper_word_first() -> None:
    bench = at_rest(set_time_words="high_first")
    octets = struct.pack("<II", START_UNIX_US >> 32, START_UNIX_US & 0xFFFFFFFF)
    set_time(bench, octets)
    bench.run(PERIOD_MS)
    assert 0 < bench.telemetry(client.TIME).time_us - START_UNIX_US < 1_000_000


def test_a_leap_second_reads_as_the_second_after_it() -> None:
    bench = at_rest()
    arrival_ns = set_time(bench, (1_483_228_799_000_000).to_bytes(8, "little"))  # one second before 2017
    bench.run(PERIOD_MS)
    times = []
    for _ in range(30):
        frame = bench.telemetry(client.TEMPERATURE)
        sent_ns = frame.t_ns - line_ns(frame.line_bytes)
        times.append((frame.time_us, (sent_ns - arrival_ns) // 1000))
        bench.run(100)
    for time_us, since_us in times:
        leap_us = 1_000_000 if since_us > 2_000_000 else 0
        if since_us < 1_000_000 or leap_us:
            assert abs(time_us - (1_483_228_799_000_000 + since_us - leap_us)) <= 1
        else:  # within the leap second
            assert abs(time_us - (1_483_228_799_000_000 + since_us)) <= 1_000_000
    assert times[-1][1] > 3_000_000
