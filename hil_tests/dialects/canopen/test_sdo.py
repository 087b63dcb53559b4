"""Transfers: their kinds, what breaks them, what time does to them."""

from __future__ import annotations

import struct

import pytest

from hil_tests.dialects.canopen import client
from hil_tests.dialects.canopen.bench import Bench, make
from hil_tests.dialects.canopen.client import AbortedError, SdoClient
from st_emulator.protocol.canopen.sdo import AbortCode
from st_emulator.protocol.canopen.sdo_server import SdoServer
from st_emulator.wire.can.wiring import CanWiring

SECOND = 1_000_000_000
LONG = bytes(n * 7 & 0xFF for n in range(3001))  # 428.7 segments: four blocks, the last one short


class Store:
    """A dictionary of one long object, 2000h."""

    def __init__(self, data: bytes = LONG) -> None:
        self.data = data
        self.written_ns: int | None = None

    def read(self, index: int, sub: int) -> bytes | AbortCode:
        return self.data if index == 0x2000 else AbortCode.NO_OBJECT

    def writable_bytes(self, index: int, sub: int) -> tuple[int, int] | AbortCode:
        return (0, 5000) if index == 0x2000 else AbortCode.NO_OBJECT

    def write(self, index: int, sub: int, data: bytes, at_ns: int) -> AbortCode | None:
        self.data, self.written_ns = data, at_ns
        return None


def served(store: Store, **arguments: int) -> SdoClient:
    server = SdoServer(store, SECOND, **arguments)
    return SdoClient(lambda request: server.receive(request, 0))


@pytest.mark.parametrize("length", [0, 1, 4, 5, 7, 8, 13, 14, 15, 889, 890, 3001])
def test_uploads_of_any_length(length):
    data = LONG[:length]
    sdo = served(Store(data))
    assert sdo.read(0x2000) == data
    assert sdo.read_by_blocks(0x2000) == data
    assert sdo.read_by_blocks(0x2000, block=1 if length < 900 else 20, crc=False) == data


@pytest.mark.parametrize("length", [1, 4, 5, 7, 8, 13, 14, 15, 889, 890, 3001])
def test_downloads_of_any_length(length):
    data = LONG[:length]
    for way in ("plain", "segmented", "blocks", "short blocks"):
        store = Store(b"?")
        sdo = served(store, **({"block_size": 10} if way == "short blocks" else {}))
        if "blocks" in way:
            sdo.write_by_blocks(0x2000, 0, data)
        else:
            sdo.write(0x2000, 0, data, segmented=way == "segmented")
        assert store.data == data, way


@pytest.mark.parametrize("lost", [{1}, {2}, {126}, {127}, {128}, {429}, {1, 200, 300, 429}])
def test_lost_segments_are_sent_again(lost):
    sdo = served(Store())
    sdo.drop = set(lost)
    assert sdo.read_by_blocks(0x2000) == LONG
    assert not sdo.drop
    store = Store(b"")
    sdo = served(store)
    # The last of a block is what the acknowledgement waits for: the client would have to time out.
    sdo.drop = {number for number in lost if number not in (127, 429)}
    sdo.write_by_blocks(0x2000, 0, LONG)
    assert not sdo.drop
    assert store.data == LONG


def test_a_wrong_crc():
    store = Store(b"before")
    with pytest.raises(AbortedError) as error:
        served(store).write_by_blocks(0x2000, 0, LONG, crc=client.crc16(LONG) ^ 1)
    assert error.value.code == client.CRC
    assert store.data == b"before"


def ask(server: SdoServer, text: str, now_ns: int = 0) -> list[str]:
    return [answer.hex() for answer in server.receive(bytes.fromhex(text).ljust(8, b"\0"), now_ns)]


ABORTS = {
    # a toggle bit that does not alternate, up and down
    "upload toggle": (["40002000", "70"], client.TOGGLE_BIT),
    "download toggle": (["2100200010000000", "10"], client.TOGGLE_BIT),
    # fewer octets than were announced: 16, then one segment of 7, the last
    "announced": (["2100200010000000", "0161626364656667"], client.LENGTH),
    "announced by blocks": (["c200200010000000", "8161626364656667", "c10000"], client.LENGTH),
    # more than the object takes
    "too long": (["21002000ffff0000"], client.TOO_LONG),
    "too long by blocks": (["c6002000ffff0000"], client.TOO_LONG),
    # segment 0 does not exist; 8 of 7 octets unused cannot be
    "segment 0": (["c400200000000000", "00"], client.SEQUENCE),
    # segments that nobody began
    "no download": (["0161"], client.COMMAND),
    "no upload": (["60"], client.COMMAND),
    "no block": (["a3"], client.COMMAND),
    "no end": (["c1"], client.COMMAND),
    # an acknowledgement before the start, of more than was sent, with a block of 0 or 128 segments
    "not started": (["a40020007f00", "a2017f"], client.COMMAND),
    "too many": (["a40020000500", "a3", "a20605"], client.SEQUENCE),
    "block of 0": (["a40020000500", "a3", "a20500"], client.BLOCK_SIZE),
    "block of 128": (["a40020000500", "a3", "a20580"], client.BLOCK_SIZE),
    "first block of 128": (["a40020008000"], client.BLOCK_SIZE),
    # a block that ends before its last segment
    "end in a block": (["a40020000500", "a3", "a1"], client.COMMAND),
    # other kinds of segments in the middle
    "mixed up": (["40002000", "00"], client.COMMAND),
    "mixed down": (["2100200010000000", "60"], client.COMMAND),
}


@pytest.mark.parametrize("name", ABORTS)
def test_what_breaks_a_transfer(name):
    requests, code = ABORTS[name]
    server = SdoServer(Store(), SECOND)
    for request in requests[:-1]:
        for answer in ask(server, request):
            assert not answer.startswith("80")
    (answer,) = ask(server, requests[-1])
    assert client.abort_code(bytes.fromhex(answer)) == code
    assert not server.busy
    assert ask(server, "40012000")[0].startswith("80012000")  # and the next is served


def test_time_out_to_the_nanosecond():
    server = SdoServer(Store(), SECOND)
    ask(server, "40002000", 5)
    assert server.next_deadline_ns() == SECOND + 5
    assert server.poll(SECOND + 4) == []
    assert server.poll(SECOND + 5) == [bytes.fromhex("80 0020 00") + struct.pack("<I", client.TIMED_OUT)]
    assert server.poll(2 * SECOND) == []
    assert server.next_deadline_ns() is None


def test_a_frame_that_leaves_late_moves_the_time_out():
    server = SdoServer(Store(), SECOND)
    ask(server, "40002000", 0)
    server.touch(700)
    assert server.poll(SECOND) == []
    assert server.poll(SECOND + 700) != []


def test_a_new_transfer_ends_the_one_under_way():
    server = SdoServer(Store(), SECOND)
    ask(server, "40002000")
    assert ask(server, "a40020007f00") == ["c6002000" + struct.pack("<I", len(LONG)).hex()]
    ask(server, "2100200004000000")
    assert ask(server, "0761626364")[0].startswith("20")


def test_an_abort_of_the_client_is_taken_anywhere():
    for opening in ("40002000", "2100200010000000", "c600200010000000", "a40020007f00"):
        server = SdoServer(Store(), SECOND)
        ask(server, opening)
        assert server.busy
        assert ask(server, "8000200000000008") == []
        assert not server.busy


@pytest.mark.parametrize("length", [0, 1, 7])
def test_frames_that_are_no_sdo(length):
    assert SdoServer(Store(), SECOND).receive(bytes(length), 0) == []


def test_silence_on_the_bus_is_timed_out():
    bench = make(sdo_timeout_ms=200).boot()
    bench.exchange(bytes.fromhex("4008100000000000"))
    bench.forget()
    bench.run(190)
    assert bench.of(0x5AC) == []
    bench.run(15)
    ((_, data),) = bench.of(0x5AC)
    assert data == bytes.fromhex("80 0810 00") + struct.pack("<I", client.TIMED_OUT)


def test_an_answer_comes_behind_the_units_latency():
    bench = make().boot()
    bench.put(0x62C, bytes.fromhex("4000400000000000"))
    start_ns = bench.emulator.now_ns
    bench.run(3)
    ((t_ns, _),) = bench.of(0x5AC)
    latency_ns = bench.emulator.profile.timing.telecommand_latency_us * 1000
    # Two frames of 8 octets, of 111 to 135 bits each at 1 Mbit/s, about the latency.
    assert latency_ns + 2 * 111_000 <= t_ns - start_ns <= latency_ns + 2 * 135_000


def test_requests_at_once_are_answered_in_their_order():
    bench = make().boot()
    reads = [(0x1017, 0), (0x4000, 0), (0x9999, 0), (0x1018, 1)]
    bench.emulator.receive(
        b"".join(client.record(0x62C, (b"\x40" + client.place(*one)).ljust(8, b"\0")) for one in reads)
    )
    bench.run(5)
    assert [data[1:4] for _, data in bench.of(0x5AC)] == [client.place(*one) for one in reads]


def test_a_block_that_takes_longer_than_the_time_out():
    bench = make(can=CanWiring(bitrate=10_000)).boot()
    bench.put(0x62C, bytes.fromhex("2f00400005000000"))  # CAPTURE
    bench.run(1100)
    bench.put(0x62C, b"\xa4" + client.place(0x4001, 5) + b"\x7f\0\0\0")
    bench.run(50)
    bench.forget()
    bench.put(0x62C, b"\xa3" + bytes(7))
    bench.run(2200)
    answers = [data for _, data in bench.of(0x5AC)]
    assert [data[0] for data in answers] == list(range(1, 128))  # 1.6 s at 10 kbit/s, and no abort
    assert bench.of(0x5AC)[-1][0] - bench.of(0x5AC)[0][0] > SECOND
    bench.run(900)
    assert [client.abort_code(data) for _, data in bench.of(0x5AC)[127:]] == [client.TIMED_OUT]


def test_a_block_download_on_the_bus():
    bench = make().boot()
    bench.sdo.write_by_blocks(0x2010, 0, client.scet(1_800_000_000, 5))
    bench.run(300)
    assert 1_800_000_000 <= bench.sdo.number(0x3003, 4) <= 1_800_000_001


def read_image(bench: Bench) -> tuple[bytes, float]:
    begun = bench.now_ms
    return bench.sdo.read_by_blocks(0x4001, 5), bench.now_ms - begun


def test_a_long_transfer_beside_attitudes():
    bench = make().boot()
    bench.ask_for("STAR_TRACK")
    bench.run(800)
    bench.forget()
    image, took_ms = read_image(bench)
    assert image.startswith(b"\x89PNG")
    assert took_ms < 4000
    assert len(bench.attitudes) >= 3
    assert bench.emergencies == []
