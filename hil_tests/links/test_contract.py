"""What every link must do, held to each of them: memory, the unit's pseudo-terminal, a serial port, and CAN
within this process, by an slcan adapter and on a vcan0.
"""

import os
import select
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import pytest

from hil_tests.links.can_far_ends import EXTENDED, REMOTE, LawicelEnd, Record, SocketEnd, VirtualEnd
from st_emulator.links import Link, LinkError, memory_link_pair
from st_emulator.links.can.bus import CanLink
from st_emulator.links.pty import PtyLink
from st_emulator.links.serial_port import SerialLink

# Only bounds a hang: a kernel hands bytes from one side of a pseudo-terminal to the other in its own time.
PATIENCE_S = 10.0


# -- what passes: a link takes and gives whole units, which are bytes or the records of CAN frames


class Traffic(Protocol):
    everything: bytes
    """Every value that there is: of a byte, or of a frame's bytes, kinds and lengths."""

    def piece(self, number: int) -> bytes:
        """A few units, others for each number."""
        ...

    def block(self, number: int) -> bytes:
        """About a kilobyte."""
        ...


class Bytes:
    everything = bytes(range(256))

    def piece(self, number: int) -> bytes:
        return bytes([number % 251, number % 256]) * (1 + number % 7)

    def block(self, number: int) -> bytes:
        return number.to_bytes(4, "big") * 256


class Records:
    everything = b"".join(
        [
            *(Record(n * 66, 8, data=bytes(range(8 * n, 8 * n + 8))).pack() for n in range(32)),
            *(Record(EXTENDED | 0x1FFFFFFF - n, n, data=bytes(n)).pack() for n in range(9)),
            *(Record(0x7FF - n, n, data=b"\xff" * n).pack() for n in range(9)),
            *(Record(REMOTE | n, n).pack() for n in range(9)),
            *(Record(EXTENDED | REMOTE | n, n).pack() for n in range(9)),
        ]
    )

    def piece(self, number: int) -> bytes:
        length = number % 9
        return Record(number % 0x800, length, data=number.to_bytes(8, "big")[8 - length :]).pack()

    def block(self, number: int) -> bytes:
        return b"".join(Record(i, 8, data=number.to_bytes(8, "big")).pack() for i in range(64))


# -- the links, each with a far end


class FarEnd(Protocol):
    def write(self, data: bytes) -> int: ...

    def read(self) -> bytes:
        """What has arrived; where that takes a moment, wait for it."""
        ...


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


@dataclass
class Wire:
    """A link under test, its far end, and how the far end goes away.

    notices_hang_up: the far end's leaving can be seen. sender_loses: what nobody reads is refused to the
    sender, which counts it. On a bus of many it is lost at each receiver that does not read, and all the
    sender knows is that it was sent.
    """

    link: Link
    far: FarEnd
    hang_up: Callable[[], None]
    traffic: Traffic
    notices_hang_up: bool
    sender_loses: bool


def memory_wire(tmp_path: Path) -> Iterator[Wire]:
    link, far = memory_link_pair()
    yield Wire(link, far, far.close, Bytes(), notices_hang_up=True, sender_loses=True)


def pty_wire(tmp_path: Path) -> Iterator[Wire]:
    link = PtyLink(tmp_path / "unit", monotonic_ns=lambda: 0)  # time stands still: nothing becomes stale
    fd = os.open(tmp_path / "unit", os.O_RDWR | os.O_NOCTTY)
    # The unit's end stays open for the next OBC, so it does not notice that one leaves.
    yield Wire(link, RawEnd(fd), lambda: os.close(fd), Bytes(), notices_hang_up=False, sender_loses=True)
    link.close()


def serial_wire(tmp_path: Path) -> Iterator[Wire]:
    master, slave = os.openpty()
    tty.setraw(slave)
    link = SerialLink(os.ttyname(slave), 115_200)
    os.close(slave)
    yield Wire(
        link, RawEnd(master), lambda: os.close(master), Bytes(), notices_hang_up=True, sender_loses=True
    )
    link.close()


def virtual_wire(tmp_path: Path) -> Iterator[Wire]:
    with CanLink("virtual", str(tmp_path), 1_000_000) as link:
        far = VirtualEnd(str(tmp_path))
        yield Wire(link, far, far.close, Records(), notices_hang_up=False, sender_loses=False)
        far.close()


def slcan_wire(tmp_path: Path) -> Iterator[Wire]:
    master, slave = os.openpty()
    tty.setraw(slave)
    with CanLink("slcan", os.ttyname(slave), 1_000_000, opening_s=0) as link:
        os.close(slave)
        yield Wire(
            link,
            LawicelEnd(master),
            lambda: os.close(master),
            Records(),
            notices_hang_up=True,
            sender_loses=True,
        )


def vcan_wire(tmp_path: Path) -> Iterator[Wire]:
    with CanLink("socketcan", "vcan0", 1_000_000) as link:
        far = SocketEnd()
        yield Wire(link, far, far.close, Records(), notices_hang_up=False, sender_loses=False)
        far.close()


@pytest.fixture(
    params=[
        pytest.param(memory_wire, id="memory"),
        pytest.param(pty_wire, id="pty"),
        pytest.param(serial_wire, id="serial"),
        pytest.param(virtual_wire, id="can-virtual"),
        pytest.param(slcan_wire, id="can-slcan"),
        pytest.param(vcan_wire, id="can-vcan0", marks=pytest.mark.vcan),
    ]
)
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


def receive_far(wire: Wire, length: int) -> bytes:
    """`length` bytes at the far end, while the link's user goes on reading, as it does."""
    received = bytearray()
    while len(received) < length and (data := wire.far.read()):
        received += data
        assert wire.link.read() == b""
    return bytes(received)


def test_nothing_is_read_when_nothing_has_arrived(wire: Wire) -> None:
    assert wire.link.read() == b""


def test_every_value_passes_unchanged_both_ways(wire: Wire) -> None:
    everything = wire.traffic.everything
    assert wire.link.write(everything) == len(everything)
    assert receive_far(wire, len(everything)) == everything
    assert wire.far.write(everything) == len(everything)
    assert receive(wire.link, len(everything)) == everything
    assert wire.link.dropped_bytes == 0


def test_units_keep_their_order_over_many_small_writes(wire: Wire) -> None:
    # As many as a far end on vcan0 holds without reading: some 270 frames.
    pieces = [wire.traffic.piece(number) for number in range(200)]
    for number, piece in enumerate(pieces):
        assert wire.link.write(piece) == len(piece)
        assert wire.far.write(pieces[-1 - number]) == len(pieces[-1 - number])
    expected = b"".join(reversed(pieces))
    assert receive(wire.link, len(expected)) == expected
    expected = b"".join(pieces)
    assert receive_far(wire, len(expected)) == expected


def test_a_transfer_larger_than_any_buffer_arrives_whole(wire: Wire) -> None:
    for number in range(200):
        block = wire.traffic.block(number)
        assert wire.link.write(block) == len(block)
        assert receive_far(wire, len(block)) == block
        assert wire.far.write(block) == len(block)
        assert receive(wire.link, len(block)) == block
    assert wire.link.dropped_bytes == 0


def test_writing_without_a_reader_returns_and_counts_what_is_lost(wire: Wire) -> None:
    offered = taken = 0
    for number in range(300):
        block = wire.traffic.block(number)
        offered += len(block)
        taken += wire.link.write(block)
    assert wire.link.dropped_bytes == offered - taken
    # 300 kB and more are more than any of them holds.
    assert (taken < offered) == wire.sender_loses


def test_what_was_sent_before_an_overflow_arrives_and_nothing_else(wire: Wire) -> None:
    sent = bytearray()
    number = 0
    while not wire.link.dropped_bytes and number < 10_000:
        piece = wire.traffic.piece(number)
        sent += piece[: wire.link.write(piece)]
        number += 1
    assert bool(wire.link.dropped_bytes) == wire.sender_loses
    if wire.sender_loses:
        assert receive_far(wire, len(sent)) == sent
    else:
        arrived = wire.far.read()
        assert sent.startswith(arrived)
        assert 0 < len(arrived) < len(sent)
    # Room again: it works as before.
    piece = wire.traffic.piece(7)
    assert wire.link.write(piece) == len(piece)
    assert receive_far(wire, len(piece)) == piece


def test_nothing_to_write_is_no_write(wire: Wire) -> None:
    assert wire.link.write(b"") == 0
    assert wire.link.dropped_bytes == 0


def test_closing_twice_is_closing_once_and_then_nothing_works(wire: Wire) -> None:
    wire.link.close()
    wire.link.close()
    with pytest.raises(LinkError, match="closed"):
        wire.link.read()
    with pytest.raises(LinkError, match="closed"):
        wire.link.write(wire.traffic.piece(1))


def test_a_with_block_closes(wire: Wire) -> None:
    piece = wire.traffic.piece(1)
    with wire.link as link:
        assert link.write(piece) == len(piece)
    with pytest.raises(LinkError):
        link.write(piece)


def test_the_far_end_going_away(wire: Wire) -> None:
    last_words = wire.traffic.piece(6)
    wire.far.write(last_words)
    assert receive(wire.link, len(last_words)) == last_words
    wire.hang_up()
    if wire.notices_hang_up:
        with pytest.raises(LinkError, match=r"other side has closed"):
            wire.link.read()
    else:
        assert wire.link.read() == b""
        assert wire.link.write(last_words) == len(last_words)


def test_the_name_is_one_line_for_a_person(wire: Wire) -> None:
    assert wire.link.name
    assert "\n" not in wire.link.name
