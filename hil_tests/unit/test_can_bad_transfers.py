"""Transfers that go wrong: each frame of them counted, the next good telecommand answered."""

import struct
from collections.abc import Callable

import pytest

from hil_tests.vectors import reference_decoder as wire
from hil_tests.vectors.reference_can import record

from .conftest import CanBench, make_can

TIMEOUT_CR, WRONG_SEQUENCE, UNEXPECTED, INVALID, WAIT_LIMIT, OVERFLOW = 3, 4, 5, 6, 7, 8
TOO_LONG, BAD_LENGTH, BAD_PCI = 9, 10, 11
COUNTERS = (
    "pdus_received", "receptions_failed", "frames_ignored", "transmissions_failed", "timeouts_a",
    "timeouts_bs", "timeouts_cr", "wrong_sequence", "unexpected_pdus", "flow_control_errors", "too_long",
    "bad_length",
)  # fmt: skip
#: A good telecommand is answered within this time of its first frame, whatever came before: 0.5 ms are the
#: unit's own latency, its frames and those of three reports with their flow control make 18, each 0.13 ms.
ANSWER_MS = 4


def standby() -> CanBench:
    bench = make_can(can_section={"heartbeat_ms": 0}).boot()
    bench.function("CLEAR_COUNTERS", ack=0)
    bench.run(20)
    bench.forget()
    return bench


def split(packet: bytes) -> list[bytes]:
    """A packet's frames: first frame and consecutive ones."""
    frames = [struct.pack(">H", 0x1000 | len(packet)) + packet[:6]]
    for number, start in enumerate(range(6, len(packet), 7), start=1):
        frames.append((bytes([0x20 | number & 15]) + packet[start : start + 7]).ljust(8, b"\x55"))
    return frames


def put(bench: CanBench, *payloads: bytes) -> None:
    for payload in payloads:
        bench.put(record(0x60A, payload))


def load(bench: CanBench) -> list[bytes]:
    """20 bytes of a memory_load in frames: a first frame and five more."""
    fields = {"memory_id": 1, "start_address": 0, "data": bytes(18), "checksum": wire.crc16(bytes(18))}
    frames = split(bench.packet("memory_load", fields))
    assert len(frames) == 6
    return frames


def counted(bench: CanBench) -> dict[str, int]:
    """What is not zero of the counters of transfers."""
    counters = bench.emulator.dialect.cyclic.housekeeping()
    return {name: counters[name] for name in COUNTERS if counters[name]}


def answered(bench: CanBench) -> None:
    start_ns = bench.emulator.now_ns
    count = bench.send("ping")
    bench.run(ANSWER_MS)
    assert bench.stages(count) == ["acceptance_success", "completion_success"]
    assert bench.packets[-1].t_ns - start_ns <= ANSWER_MS * 1e6


def without(frames: list[bytes], number: int) -> list[bytes]:
    return frames[:number] + frames[number + 1 :]


#: What is sent in place of the frames, and what it counts; the first reason is that of the first event.
BROKEN: dict[str, tuple[Callable[[list[bytes]], list[bytes]], int, dict[str, int]]] = {
    "first frame lost": (
        lambda f: f[1:], UNEXPECTED, {"frames_ignored": 5, "unexpected_pdus": 5},
    ),
    "second frame lost": (
        lambda f: without(f, 1), WRONG_SEQUENCE,
        {"receptions_failed": 1, "wrong_sequence": 1, "frames_ignored": 3, "unexpected_pdus": 3},
    ),
    "fourth frame lost": (
        lambda f: without(f, 3), WRONG_SEQUENCE,
        {"receptions_failed": 1, "wrong_sequence": 1, "frames_ignored": 1, "unexpected_pdus": 1},
    ),
    "last frame lost": (
        lambda f: f[:-1], TIMEOUT_CR, {"receptions_failed": 1, "timeouts_cr": 1},
    ),
    "all but the first frame lost": (
        lambda f: f[:1], TIMEOUT_CR, {"receptions_failed": 1, "timeouts_cr": 1},
    ),
    "third frame repeated": (
        lambda f: [*f[:3], *f[2:]], WRONG_SEQUENCE,
        {"receptions_failed": 1, "wrong_sequence": 1, "frames_ignored": 3, "unexpected_pdus": 3},
    ),
    "first frame repeated": (
        lambda f: [f[0], *f], UNEXPECTED,
        {"receptions_failed": 1, "unexpected_pdus": 1, "pdus_received": 1},
    ),
    "last frame repeated": (
        lambda f: [*f, f[-1]], UNEXPECTED, {"pdus_received": 1, "frames_ignored": 1, "unexpected_pdus": 1},
    ),
    "two frames swapped": (
        lambda f: [*f[:2], f[3], f[2], *f[4:]], WRONG_SEQUENCE,
        {"receptions_failed": 1, "wrong_sequence": 1, "frames_ignored": 3, "unexpected_pdus": 3},
    ),
    "the last one first": (
        lambda f: [f[-1], *f[:-1]], UNEXPECTED,
        {"frames_ignored": 1, "unexpected_pdus": 1, "receptions_failed": 1, "timeouts_cr": 1},
    ),
    "a frame a byte short": (
        lambda f: [*f[:2], f[2][:-1], *f[3:]], BAD_LENGTH,
        {
            "frames_ignored": 3, "bad_length": 1, "receptions_failed": 1, "wrong_sequence": 1,
            "unexpected_pdus": 2,
        },
    ),
    "a short frame and the whole one behind it": (
        lambda f: [*f[:2], f[2][:3], *f[2:]], BAD_LENGTH,
        {"frames_ignored": 1, "bad_length": 1, "pdus_received": 1},
    ),
    "an empty frame in between": (
        lambda f: [*f[:3], b"", *f[3:]], BAD_LENGTH,
        {"frames_ignored": 1, "bad_length": 1, "pdus_received": 1},
    ),
    "first frame of 7 bytes": (
        lambda f: [f[0][:7], *f[1:]], BAD_LENGTH,
        {"frames_ignored": 6, "bad_length": 1, "unexpected_pdus": 5},
    ),
    "first frame of a length for a single one": (
        lambda f: [b"\x10\x07" + bytes(6)], BAD_LENGTH, {"frames_ignored": 1, "bad_length": 1},
    ),
    "escape of a short length": (
        lambda f: [b"\x10\x00\x00\x00\x0f\xff\0\0"], BAD_LENGTH, {"frames_ignored": 1, "bad_length": 1},
    ),
    "4 GiB announced": (
        lambda f: [b"\x10\x00\xff\xff\xff\xff\0\0", *f[1:3]], TOO_LONG,
        {"receptions_failed": 1, "too_long": 1, "frames_ignored": 2, "unexpected_pdus": 2},
    ),
    "1025 bytes announced": (
        lambda f: [b"\x14\x01" + bytes(6)], TOO_LONG, {"receptions_failed": 1, "too_long": 1},
    ),
    "single frames of no and of impossible lengths": (
        lambda f: [b"\x00" + bytes(7), b"\x08" + bytes(7), b"\x0f" + bytes(7), b"\x05\1\2"], BAD_LENGTH,
        {"frames_ignored": 4, "bad_length": 4},
    ),
    "kinds of frames that do not exist": (
        lambda f: [bytes([kind << 4]) + bytes(7) for kind in range(4, 16)], BAD_PCI,
        {"frames_ignored": 12, "bad_length": 12},
    ),
    "flow control for nothing": (
        lambda f: [b"\x30\0\0", b"\x31\0\0", b"\x32\0\0", b"\x3f\0\0", b"\x30\0"], UNEXPECTED,
        {"frames_ignored": 5, "unexpected_pdus": 4, "bad_length": 1},
    ),
    "a single frame in the middle": (
        lambda f: [*f[:3], b"\x02\x00\x00" + bytes(5), *f[3:]], UNEXPECTED,
        {"receptions_failed": 1, "pdus_received": 1, "frames_ignored": 3, "unexpected_pdus": 4},
    ),
    "flow control in the middle": (
        lambda f: [*f[:3], b"\x30\0\0", *f[3:]], UNEXPECTED,
        {"frames_ignored": 1, "unexpected_pdus": 1, "pdus_received": 1},
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", BROKEN)
def test_broken_receptions(kind: str) -> None:
    frames_of, reason, wanted = BROKEN[kind]
    bench = standby()
    for payload in frames_of(load(bench)):
        put(bench, payload)
        bench.run(1)
    bench.run(5)
    if "timeouts_cr" in wanted:
        assert "timeouts_cr" not in counted(bench)
        bench.run(1000)
    assert counted(bench) == wanted
    answered(bench)
    bench.run(2500)
    events = bench.events("CAN_TRANSFER_FAILED")
    assert events[0] == {"reason": reason, "count": 1}, "told at once"
    told = sum(event["count"] for event in events)
    assert told == wanted.get("receptions_failed", 0) + wanted.get("frames_ignored", 0)


#: There, the flow control would answer the event that tells of the first of it.
FAST = [kind for kind in BROKEN if kind != "flow control for nothing"]


@pytest.mark.parametrize("kind", FAST)
def test_the_same_at_the_rate_of_the_bus(kind: str) -> None:
    """Without a pause between the frames, and a telecommand right behind them: it ends what is under way."""
    frames_of, _, wanted = BROKEN[kind]
    bench = standby()
    put(bench, *frames_of(load(bench)))
    late = wanted.get("timeouts_cr", 0)
    wanted = dict(wanted)
    if late:  # the telecommand interrupts what would have timed out
        del wanted["timeouts_cr"]
        wanted["unexpected_pdus"] = wanted.get("unexpected_pdus", 0) + 1
    bench.send("ping")
    wanted["pdus_received"] = wanted.get("pdus_received", 0) + 1
    bench.run(ANSWER_MS + 3)
    assert bench.stages(bench.count) == ["acceptance_success", "completion_success"]
    bench.run(1500)
    assert counted(bench) == wanted


def test_at_most_one_event_a_second_while_failures_go_on() -> None:
    bench = standby()
    start_ms = bench.now_ms
    for _ in range(500):
        put(bench, b"\x40" + bytes(7))
        bench.run(10)
    bench.run(3000)
    told = [item for item in bench.packets if item.fields.get("event_id") == 22]
    assert [item.fields["data"]["count"] for item in told] == [1, 99, *[100] * 4]
    for number, item in enumerate(told):
        assert item.t_ns / 1e6 == pytest.approx(start_ms + 1000 * number, abs=2)
    assert {item.fields["data"]["reason"] for item in told} == {BAD_PCI}


# -- flow control that the OBC gives ------------------------------------------------------------------------

CTS, WAIT = b"\x30\0\0", b"\x31\0\0"


def dump(bench: CanBench, *answers: bytes) -> None:
    """A long packet, whose first frames are answered like this; a pong behind it."""
    bench.peer.answers.extend(answers)
    bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 900}, ack=0)
    bench.send("ping", ack=0)


@pytest.mark.parametrize(
    ("answer", "reason", "wanted"),
    [
        (b"\x32\0\0", OVERFLOW, {"flow_control_errors": 1}),
        (b"\x33\0\0", INVALID, {"flow_control_errors": 1}),
        (b"\x3f\0\0", INVALID, {"flow_control_errors": 1}),
        (b"\x32\0\0\xcc\xcc\xcc\xcc\xcc", OVERFLOW, {"flow_control_errors": 1}),
    ],
)
def test_the_packet_is_lost_and_the_next_one_goes(answer: bytes, reason: int, wanted: dict[str, int]) -> None:
    bench = standby()
    dump(bench, answer)
    bench.run(20)
    assert counted(bench) == {"pdus_received": 2, "transmissions_failed": 1, **wanted}
    assert [packet.name for packet in bench.packets] == ["pong", "event_low"]
    assert bench.events("CAN_PACKETS_LOST") == [{"reason": reason, "packets": 1}]
    answered(bench)


def test_ten_waits_in_a_row_are_borne_and_eleven_are_not() -> None:
    bench = standby()
    dump(bench, WAIT)
    for _ in range(9):
        bench.run(900)  # within N_Bs each
        put(bench, WAIT)
    bench.run(900)
    put(bench, CTS)
    bench.run(200)
    assert [packet.name for packet in bench.packets] == ["memory_dump_report", "pong"]
    assert counted(bench) == {"pdus_received": 2}
    bench.forget()
    dump(bench, WAIT)
    bench.run(5)
    put(bench, *[WAIT] * 10)
    bench.run(20)
    assert counted(bench) == {"pdus_received": 4, "transmissions_failed": 1, "flow_control_errors": 1}
    assert bench.events("CAN_PACKETS_LOST") == [{"reason": WAIT_LIMIT, "packets": 1}]
    assert len(bench.of("pong")) == 1
    answered(bench)


def test_a_flood_of_waits() -> None:
    """10,000 of them: each packet costs eleven, the rest is ignored, and all are counted."""
    bench = standby()
    bench.send("hk_set_interval", {"intervals": [{"structure_id": 1, "interval_ms": 250}]}, ack=0)
    bench.send("hk_enable", {"structure_ids": [1]}, ack=0)
    bench.run(10)
    bench.peer.deaf = True
    before = bench.emulator.dialect.port.connection.counters.wait_frames_received
    for _ in range(100):
        put(bench, *[WAIT] * 100)
        bench.run(50)
    bench.peer.deaf = False
    counters = counted(bench)
    waits = bench.emulator.dialect.port.connection.counters.wait_frames_received - before
    lost = counters["transmissions_failed"]
    assert 24 <= lost <= 26, "one each 250 ms, and an event each second"
    assert counters["flow_control_errors"] == lost
    assert waits == 11 * lost
    assert counters["frames_ignored"] == counters["unexpected_pdus"] == 10_000 - waits
    bench.run(1500)
    told = bench.events("CAN_PACKETS_LOST")
    assert [event["reason"] for event in told] == [WAIT_LIMIT]
    assert told[0]["packets"] >= lost
    answered(bench)


def test_frames_behind_a_block_wait_for_flow_control_that_is_long_enough() -> None:
    bench = standby()
    bench.peer.block_size = 5
    dump(bench, b"\x30\x05\0", b"\x30\0")
    bench.run(500)
    assert counted(bench) == {"pdus_received": 2, "frames_ignored": 1, "bad_length": 1}
    assert bench.packets == []
    put(bench, CTS)
    bench.run(200)
    assert len(bench.of("memory_dump_report")) == 1


def test_flow_control_in_the_middle_of_a_block_is_ignored() -> None:
    bench = standby()
    dump(bench, b"\x30\0\x01")  # a millisecond between its frames: those of the OBC get through
    bench.run(10)
    put(bench, CTS, WAIT, b"\x32\0\0")
    bench.run(200)
    assert len(bench.of("memory_dump_report")) == 1
    assert counted(bench) == {"pdus_received": 2, "frames_ignored": 3, "unexpected_pdus": 3}


def test_every_second_to_every_40th_frame_is_lost() -> None:
    """What comes whole is executed once, nothing else is."""
    bench = standby()
    whole = position = 0
    for every in range(2, 41):
        for frames in [load(bench) for _ in range(3)]:
            position += len(frames)
            kept = [
                frame for number, frame in enumerate(frames, start=position - len(frames)) if number % every
            ]
            for frame in kept:
                put(bench, frame)
                bench.run(0.3)
            whole += len(kept) == len(frames)
            bench.run(3)
    bench.run(3000)
    assert sum(packet.name == "completion_success" for packet in bench.packets) == whole
    assert 60 < whole < 100
    assert bench.emulator.dialect.receiver.counters.crc_errors == 0
    answered(bench)
