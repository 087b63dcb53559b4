"""The virtual clock, the line's pace and the journal's file."""

import io
import json
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from st_emulator.bench.journal import JournalWriter, read_journal
from st_emulator.clock import VirtualClock
from st_emulator.errors import ConfigurationError
from st_emulator.wire.serial_line import SerialLine


def test_events_run_by_time_then_by_the_order_of_their_scheduling() -> None:
    clock, seen = VirtualClock(), []
    for name, at_ns in (("b", 20), ("a", 10), ("c", 20), ("d", 30)):
        clock.at(at_ns, lambda name=name: seen.append((name, clock.now_ns)))
    clock.at(20, lambda: clock.after(0, lambda: seen.append(("e", clock.now_ns))))
    clock.advance(25)
    assert seen == [("a", 10), ("b", 20), ("c", 20), ("e", 20)]
    assert clock.now_ns == 25
    assert clock.next_ns() == 30


def test_a_cancelled_event_is_void_and_the_past_is_refused() -> None:
    clock, seen = VirtualClock(), []
    clock.at(5, lambda: seen.append(1)).cancel()
    clock.advance(10)
    assert seen == []
    assert clock.next_ns() is None
    with pytest.raises(ValueError, match="clock is at 10 ns"):
        clock.at(9, lambda: None)
    clock.advance(3)  # never backwards
    assert clock.now_ns == 10


def wires(baud: int) -> tuple[VirtualClock, SerialLine, list, list]:
    clock = VirtualClock()
    sent: list[tuple[int, bytes]] = []
    received: list[tuple[int, bytes]] = []
    line = SerialLine(
        clock,
        baud,
        lambda data: sent.append((clock.now_ns, data)),
        lambda data: received.append((clock.now_ns, data)),
        delimiter=0xC0,
    )
    return clock, line, sent, received


@pytest.mark.parametrize("baud", [300, 9600, 115200, 921600, 4_000_000])
def test_ten_bits_a_byte_and_no_rounding_that_adds_up(baud: int) -> None:
    clock, line, sent, received = wires(baud)
    for _ in range(1000):
        line.send(b"0123456")
        line.arrive(b"abcdefg")  # no END: whole pieces as they came
    clock.advance(10**12)
    exact_ns = Fraction(7000 * 10 * 10**9, baud)
    for times, data in ((sent, b"0123456"), (received, b"abcdefg")):
        assert b"".join(piece for _, piece in times) == data * 1000
        assert exact_ns - 1 < times[-1][0] <= exact_ns
    # Every group ends when its own last bit does.
    total = 0
    for at_ns, piece in sent:
        total += len(piece)
        assert at_ns == total * 10**10 // baud


def test_groups_are_a_fifo_or_a_millisecond() -> None:
    for baud, size in ((115200, 16), (1_000_000, 100)):
        clock, line, sent, _ = wires(baud)
        line.send(bytes(250))
        clock.advance(10**10)
        full, rest = divmod(250, size)
        assert [len(piece) for _, piece in sent] == [size] * full + ([rest] if rest else [])


def test_a_pause_starts_the_pace_anew() -> None:
    clock, line, sent, received = wires(9600)
    line.send(b"x")
    line.arrive(b"x")
    clock.advance(5_000_000)
    line.send(b"y")
    line.arrive(b"y")
    clock.advance(10_000_000)
    byte_ns = 10**10 // 9600
    assert [at for at, _ in sent] == [byte_ns, 5_000_000 + byte_ns] == [at for at, _ in received]


def test_a_packet_is_received_when_its_own_end_is() -> None:
    clock, line, _, received = wires(115200)
    line.arrive(b"\xc0abc\xc0\xc0defgh\xc0rest")
    clock.advance(10**9)
    ends = [1, 5, 6, 12, 16]
    assert [piece for _, piece in received] == [b"\xc0", b"abc\xc0", b"\xc0", b"defgh\xc0", b"rest"]
    assert [at for at, _ in received] == [count * 10**10 // 115200 for count in ends]


def test_without_a_delimiter_each_byte_has_its_own_time() -> None:
    clock, received = VirtualClock(), []
    line = SerialLine(
        clock, 9600, lambda data: None, lambda data: received.append((clock.now_ns, data)), delimiter=None
    )
    line.arrive(b"\xc0ab")
    clock.advance(10**9)
    assert received == [(count * 10**10 // 9600, b"\xc0ab"[count - 1 : count]) for count in (1, 2, 3)]


def test_reception_is_not_paced_behind_a_real_port() -> None:
    clock, received = VirtualClock(), []
    line = SerialLine(clock, 9600, lambda data: None, received.append, delimiter=0xC0, pace_reception=False)
    line.arrive(b"\xc0abc\xc0\xc0")
    assert received == [b"\xc0abc\xc0\xc0"]


def test_flush_completes_the_group_on_the_wire() -> None:
    clock, line, sent, _ = wires(115200)
    line.send(bytes(range(100)))
    clock.advance(line.duration_ns(16) + 1)
    assert line.queued_bytes == 84
    assert line.flush() == 68
    line.send(b"next")
    clock.advance(10**9)
    assert b"".join(piece for _, piece in sent) == bytes(range(32)) + b"next"


@given(st.lists(st.integers(1, 40), max_size=30), st.lists(st.integers(0, 3_000_000), max_size=30))
def test_bytes_keep_their_order_and_never_come_faster_than_the_line(
    sizes: list[int], gaps: list[int]
) -> None:
    clock, line, sent, received = wires(115200)
    data = b""
    for size, gap in zip(sizes, gaps, strict=False):
        clock.advance(clock.now_ns + gap)
        piece = bytes((len(data) + n) % 200 for n in range(size))
        data += piece
        line.send(piece)
        line.arrive(piece)
    clock.advance(10**10)
    for groups in (sent, received):
        assert b"".join(piece for _, piece in groups) == data
        for (before_ns, _), (at_ns, piece) in pairwise(groups):
            assert at_ns - before_ns >= len(piece) * 10**10 // 115200 - 1


def test_a_journal_comes_back_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    with path.open("w") as file:
        writer = JournalWriter(file, {"seed": 7})
        writer.write(10, "rx", b"\x00\xc0")
        writer.write(20, "tx", b"\xff")
        writer.end(30)
    journal = read_journal(path)
    assert journal.header["seed"] == 7
    assert [(entry.t_ns, entry.direction, entry.data) for entry in journal.entries] == [
        (10, "rx", b"\x00\xc0"),
        (20, "tx", b"\xff"),
    ]
    assert journal.end_ns == 30
    assert journal.bytes_of("tx") == b"\xff"


def test_a_journal_killed_at_any_byte_still_reads(tmp_path: Path) -> None:
    text = io.StringIO()
    writer = JournalWriter(text, {"seed": 7})
    for t_ns in range(100, 105):
        writer.write(t_ns, "tx", bytes([t_ns, 1, 2]))
    whole = text.getvalue()
    path = tmp_path / "a.journal"
    first_line = whole.index("\n") + 1
    for end in range(first_line, len(whole) + 1):
        path.write_text(whole[:end])
        entries = read_journal(path).entries
        complete = whole[first_line:end].count("\n")
        assert complete <= len(entries) <= complete + 1  # a last line that lacks its line end only
        assert [entry.data[0] for entry in entries] == [100, 101, 102, 103, 104][: len(entries)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "first line"),
        ("5\n", "line 1"),
        ("[]\n", "line 1"),
        ("{}\n", "first line"),
        ("no json\n", "line 1"),
        (json.dumps({"format": "st-emulator journal 1"}) + '\n{"t_ns": 1, "rx": "c"}\n', "line 2"),
        (json.dumps({"format": "st-emulator journal 1"}) + '\n{"rx": "c0"}\n', "line 2"),
        (json.dumps({"format": "st-emulator journal 1"}) + "\n7\n", "line 2"),
        (json.dumps({"format": "st-emulator journal 1"}) + '\nx\n{"t_ns": 1, "rx": "c0"}\n', "line 2"),
    ],
)
def test_what_is_no_journal_is_named_with_its_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.journal"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=message) as caught:
        read_journal(path)
    assert str(path) in str(caught.value)


def test_a_missing_journal_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"nothing\.journal"):
        read_journal(tmp_path / "nothing.journal")
