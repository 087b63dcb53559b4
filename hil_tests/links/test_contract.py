"""What every link must do, held to each of them: memory, the unit's pseudo-terminal, a serial port."""

import os
import select
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from st_emulator.links import Link, LinkError, memory_link_pair
from st_emulator.links.pty import PtyLink
from st_emulator.links.serial_port import SerialLink

ALL_VALUES = bytes(range(256))
# Only bounds a hang: a kernel hands bytes from one side of a pseudo-terminal to the other in its own time.
PATIENCE_S = 10.0


class RawEnd:
    """The far end as a bare file descriptor, so that what is under test is not also its own witness."""

    def __init__(self, fd: int) -> None:
        self.fd = fd
        os.set_blocking(fd, False)

    def write(self, data: bytes) -> int:
        return os.write(self.fd, data)

    def read(self) -> bytes:
        ready, _, _ = select.select([self.fd], [], [], PATIENCE_S)
        return os.read(self.fd, 65536) if ready else b""


class MemoryEnd:
    def __init__(self, link: Link) -> None:
        self.link = link

    def write(self, data: bytes) -> int:
        return self.link.write(data)

    def read(self) -> bytes:
        return self.link.read()


@dataclass
class Wire:
    """A link under test, its far end, and how the far end goes away."""

    link: Link
    far: RawEnd | MemoryEnd
    hang_up: Callable[[], None]
    notices_hang_up: bool


def memory_wire(tmp_path: Path) -> Iterator[Wire]:
    link, far = memory_link_pair()
    yield Wire(link, MemoryEnd(far), far.close, True)


def pty_wire(tmp_path: Path) -> Iterator[Wire]:
    link = PtyLink(tmp_path / "unit", monotonic_ns=lambda: 0)  # time stands still: nothing becomes stale
    fd = os.open(tmp_path / "unit", os.O_RDWR | os.O_NOCTTY)
    # The unit's end stays open for the next OBC, so it does not notice that one leaves.
    yield Wire(link, RawEnd(fd), lambda: os.close(fd), False)
    link.close()


def serial_wire(tmp_path: Path) -> Iterator[Wire]:
    master, slave = os.openpty()
    tty.setraw(slave)
    link = SerialLink(os.ttyname(slave), 115_200)
    os.close(slave)
    yield Wire(link, RawEnd(master), lambda: os.close(master), True)
    link.close()


@pytest.fixture(params=[memory_wire, pty_wire, serial_wire], ids=["memory", "pty", "serial"])
def wire(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Wire]:
    yield from request.param(tmp_path)


def receive(link: Link, length: int) -> bytes:
    """`length` bytes from the link, waiting as its user would: by select() where it has a descriptor."""
    received = bytearray()
    while len(received) < length:
        fd = link.fileno()
        if fd is not None and not select.select([fd], [], [], PATIENCE_S)[0]:
            break
        data = link.read()
        if not data and fd is None:
            break
        received += data
    return bytes(received)


def receive_far(far: RawEnd | MemoryEnd, length: int) -> bytes:
    received = bytearray()
    while len(received) < length and (data := far.read()):
        received += data
    return bytes(received)


def test_nothing_is_read_when_nothing_has_arrived(wire: Wire) -> None:
    assert wire.link.read() == b""


def test_every_value_passes_unchanged_both_ways(wire: Wire) -> None:
    assert wire.link.write(ALL_VALUES) == 256
    assert receive_far(wire.far, 256) == ALL_VALUES
    assert wire.far.write(ALL_VALUES) == 256
    assert receive(wire.link, 256) == ALL_VALUES
    assert wire.link.dropped_bytes == 0


def test_bytes_keep_their_order_over_many_small_writes(wire: Wire) -> None:
    pieces = [bytes([i % 256]) * (1 + i % 7) for i in range(300)]
    for piece in pieces:
        assert wire.link.write(piece) == len(piece)
        assert wire.far.write(piece[::-1]) == len(piece)
    expected = b"".join(pieces)
    assert receive_far(wire.far, len(expected)) == expected
    assert receive(wire.link, len(expected)) == expected


def test_a_transfer_larger_than_any_buffer_arrives_whole(wire: Wire) -> None:
    block = ALL_VALUES * 8
    total = 100
    for _ in range(total):
        assert wire.link.write(block) == len(block)
        assert receive_far(wire.far, len(block)) == block
        assert wire.far.write(block) == len(block)
        assert receive(wire.link, len(block)) == block
    assert wire.link.dropped_bytes == 0


def test_writing_without_a_reader_returns_and_counts_what_is_lost(wire: Wire) -> None:
    block = bytes(1000)
    offered = taken = 0
    for _ in range(300):
        offered += len(block)
        taken += wire.link.write(block)
    assert taken < offered  # 300 kB are more than any of them holds
    assert wire.link.dropped_bytes == offered - taken


def test_what_was_taken_before_an_overflow_arrives_and_nothing_else(wire: Wire) -> None:
    taken = bytearray()
    number = 0
    while not wire.link.dropped_bytes:
        data = number.to_bytes(4, "big") * 64
        taken += data[: wire.link.write(data)]
        number += 1
    assert receive_far(wire.far, len(taken)) == taken


def test_no_bytes_are_no_write(wire: Wire) -> None:
    assert wire.link.write(b"") == 0
    assert wire.link.dropped_bytes == 0


def test_closing_twice_is_closing_once_and_then_nothing_works(wire: Wire) -> None:
    wire.link.close()
    wire.link.close()
    with pytest.raises(LinkError, match="closed"):
        wire.link.read()
    with pytest.raises(LinkError, match="closed"):
        wire.link.write(b"x")


def test_a_with_block_closes(wire: Wire) -> None:
    with wire.link as link:
        assert link.write(b"x") == 1
    with pytest.raises(LinkError):
        link.write(b"x")


def test_the_far_end_going_away(wire: Wire) -> None:
    wire.far.write(b"last words")
    assert receive(wire.link, 10) == b"last words"
    wire.hang_up()
    if wire.notices_hang_up:
        with pytest.raises(LinkError, match=r"other side has closed"):
            wire.link.read()
    else:
        assert wire.link.read() == b""
        assert wire.link.write(b"still here") == 10


def test_the_name_is_one_line_for_a_person(wire: Wire) -> None:
    assert wire.link.name
    assert "\n" not in wire.link.name
