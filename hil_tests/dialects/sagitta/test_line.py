"""The line: whole, byte by byte, joined, garbage before, between and after; timing; the hash; the address."""

from __future__ import annotations

import pytest

from hil_tests.dialects.sagitta import client
from hil_tests.dialects.sagitta.bench import MS, Bench, at_rest, line_ns, make
from hil_tests.dialects.sagitta.client import READ, REQUEST, SET

WANTED = (13, 14, 30)
JOINED = b"".join(client.request(READ, id_) for id_ in WANTED)


def read(bench: Bench, ms: float = 100) -> list[tuple[int, bytes]]:
    """The parameters that came."""
    frames = bench.run(ms)
    assert all(frame.type == client.READ_REPLY for frame in frames)
    return [(frame.id, frame.arguments) for frame in frames]


RIGHT = [(id_, client.DEFAULTS[id_]) for id_ in WANTED]


def test_joined() -> None:
    bench = at_rest()
    bench.put(JOINED)
    assert read(bench) == RIGHT


def test_one_delimiter_between_two() -> None:
    bench = at_rest()
    bench.put(JOINED.replace(b"\xc0\xc0", b"\xc0"))
    assert read(bench) == RIGHT


def test_octet_by_octet() -> None:
    bench = at_rest()
    for number in range(len(JOINED)):
        bench.put(JOINED[number : number + 1])
        bench.run(3)
    assert [(frame.id, frame.arguments) for frame in bench.frames[-3:]] == RIGHT


@pytest.mark.parametrize("cut", range(1, len(JOINED)))
def test_cut_anywhere(cut: int) -> None:
    bench = at_rest()
    bench.put(JOINED[:cut])
    bench.run(10)
    bench.put(JOINED[cut:])
    bench.run(100)
    assert [(frame.id, frame.arguments) for frame in bench.frames[-3:]] == RIGHT


@pytest.mark.parametrize(
    "garbage",
    [
        b"\x00",
        b"\xdb",
        b"\xdb\xc0",
        b"\xc0\xc0\xc0",
        b"\x21\x01\x0d",
        b"\xdb\x00\x21",
        client.request(READ, 13)[:-3],
        client.request(READ, 13, address=0x22),
        bytes(5000),
        bytes(range(256)),
    ],
    ids=lambda garbage: garbage[:6].hex(),
)
def test_garbage_before_between_and_after(garbage: bytes) -> None:
    bench = at_rest()
    parts = [client.request(READ, id_) for id_ in WANTED]
    bench.put(garbage + parts[0] + garbage + parts[1] + garbage + parts[2] + garbage)
    assert read(bench, 2000) == RIGHT


def test_replies_in_the_order_of_the_requests_and_in_time() -> None:
    bench = at_rest()
    begun_ns = bench.now_ns
    bench.put(JOINED)
    bench.run(100)
    arrival_ns, free_ns = begun_ns, 0
    for frame, id_ in zip(bench.frames[-3:], WANTED, strict=True):
        arrival_ns += line_ns(len(client.request(READ, id_)))
        free_ns = max(arrival_ns + bench.latency_ns, free_ns) + line_ns(frame.line_bytes)
        assert abs(frame.t_ns - free_ns) <= 3  # each rounds to a nanosecond


def test_a_frame_leaves_without_gaps() -> None:
    bench = at_rest()
    bench.groups.clear()
    frame = bench.telemetry(client.MATCHED)
    sizes = [len(data) for _, data in bench.groups]
    assert sum(sizes) == frame.line_bytes
    begun_ns = frame.t_ns - line_ns(frame.line_bytes)
    sent = 0
    for t_ns, data in bench.groups:
        sent += len(data)
        assert t_ns == begun_ns + line_ns(sent)


def test_a_wrong_hash_is_not_answered_unless_it_is_not_looked_at() -> None:
    bad = bytearray(client.body(READ, 13))
    bad[-1] ^= 1
    for checked, count in ((True, 0), (False, 1)):
        bench = at_rest() if checked else at_rest(hash_checked=False)
        bench.put(client.framed(bytes(bad)))
        assert len(bench.run(50)) == count


def test_another_address() -> None:
    bench = make(boot_loader=False, autonomous=False, address=0xC0).to_loader()  # it is escaped
    bench.put(client.request(READ, 13, address=0xC0))
    (frame,) = bench.run(50)
    assert frame.body[0] == 0xC0
    assert bench.ask(READ, 13) == []


def test_what_finds_no_room_is_lost_whole_and_the_unit_goes_on() -> None:
    bench = at_rest()
    bench.put(client.request(REQUEST, client.MATCHED) * 100)  # 900 octets in, 34,300 out
    frames = bench.run(4000)
    assert 12 <= len(frames) < 60
    assert all(len(frame.body) == 341 for frame in frames)
    assert bench.status(SET, 13, client.DEFAULTS[13]) == 0
    # The counter goes on over those that were lost.
    assert bench.telemetry(client.POWER).counter == 100


def test_counts_for_people() -> None:
    bench = at_rest()
    received, sent = bench.emulator.dialect.messages_received, bench.emulator.dialect.messages_sent
    bench.put(JOINED + b"\xc0\xdb\x01\xc0")
    bench.run(50)
    assert bench.emulator.dialect.messages_received == received + 4
    assert bench.emulator.dialect.messages_sent == sent + 3


def test_requests_and_replies_are_work() -> None:
    bench = at_rest()
    bench.run(300)
    bench.emulator.dialect.take_work()
    request = client.request(READ, 13)
    # Within a frame period: its end takes the work away.
    bench.emulator.advance((bench.now_ns // (250 * MS) + 1) * 250 * MS)
    bench.put(request)
    bench.run(50)
    counts = {name: count for name, count in bench.emulator.dialect.take_work().counts.items() if count}
    # 15 bytes out; 9 in, of which 7 are checked
    assert counts == {
        "telemetry_bytes": 15,
        "telecommand_bytes": len(request),
        "telecommands": 1,
        "crc_bytes": 15 + 7,
        "sending_rounds": 1,
        "receiving_rounds": 1,
    }
