"""The OBC on a computer that does not let it run for seconds: that time counts against nobody."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import SimpleNamespace

import pytest

from hil_tests.obc.can_unit import record
from hil_tests.obc.transport_ends import counted
from st_emulator.obc import CanTransport, reading
from st_emulator.protocol.can.cyclic import CanIdentifiers

MS = 1_000_000
S = 1_000_000_000
UNIT = 0x58A  # node 10
PACKET = bytes(range(1, 31))  # 30 bytes: a first frame and four consecutive ones
CLEAR_TO_SEND = record(UNIT, bytes.fromhex("300000CCCCCCCCCC"))


def test_a_frame_that_the_link_took_while_nobody_looked_is_sent() -> None:
    transport = CanTransport(CanIdentifiers(10))
    transport.encode(PACKET, 0)
    now_ns = 0
    for frame in range(5):
        offered = transport.outgoing(now_ns)
        now_ns += 3 * S  # over N_As, 1 s
        assert len(transport.written(len(offered), now_ns)) == 1  # no more than that it was sent
        if frame == 0:
            transport.receive(CLEAR_TO_SEND, now_ns)
    assert counted(transport) == {"transfers_sent": 1}


def test_the_answer_is_waited_for_from_then_on() -> None:
    transport = CanTransport(CanIdentifiers(10))
    transport.encode(PACKET, 0)
    transport.written(len(transport.outgoing(0)), 3 * S)
    assert transport.next_deadline_ns() == 4 * S  # N_Bs
    assert transport.poll(4 * S - 1) == []
    assert len(transport.poll(4 * S)) == 1


class Held:
    """A thread that waits on a made clock; `woken`: what the computer does before it lets it go on."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, woken: Callable[[Held], None] = lambda held: None
    ) -> None:
        self.woken = woken
        self.now_ns = 0
        self.waits: list[float] = []
        self.taken: list[tuple[bytes, int]] = []
        self.inbox = b""
        self.due_ns: int | None = S
        monkeypatch.setattr(reading, "time", SimpleNamespace(monotonic_ns=lambda: self.now_ns))
        monkeypatch.setattr(reading, "select", SimpleNamespace(select=self.wait))
        self.reader = reading.LiveReader()

    def wait(self, readable: list, writable: list, exceptional: list, timeout_s: float | None) -> tuple:
        assert timeout_s is not None
        self.waits.append(timeout_s)
        self.now_ns += round(timeout_s * S)
        self.woken(self)
        return [], [], []

    def read(self) -> bytes:
        data, self.inbox = self.inbox, b""
        return data

    def take(self, data: bytes, now_ns: int) -> bool:
        self.taken.append((data, now_ns))
        self.due_ns = None if data else self.due_ns
        self.reader._stopping.set()
        return True

    def listen(self) -> None:
        link = SimpleNamespace(fileno=lambda: 77, read=self.read)
        thread = threading.Thread(
            target=self.reader.start, args=(link, self.take, lambda: self.due_ns), daemon=True
        )
        thread.start()
        thread.join(10)
        assert self.reader._thread is not None
        self.reader._thread.join(10)
        assert not self.reader._thread.is_alive()
        assert self.reader._failure is None


def test_a_deadline_in_time_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    held = Held(monkeypatch)
    held.listen()
    assert held.taken == [(b"", S)]


@pytest.mark.parametrize(("held_up_ms", "excused_ms"), [(500, 500), (5000, 1000)])
def test_a_deadline_that_passed_meanwhile_is_put_off(
    monkeypatch: pytest.MonkeyPatch, held_up_ms: int, excused_ms: int
) -> None:
    def woken(held: Held) -> None:
        if len(held.waits) == 1:
            held.now_ns += held_up_ms * MS

    held = Held(monkeypatch, woken)
    held.listen()
    assert held.waits == [1.0, excused_ms / 1000]
    assert held.taken == [(b"", S + (held_up_ms + excused_ms) * MS)]


def test_what_comes_in_that_time_came_before_the_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    def woken(held: Held) -> None:
        if len(held.waits) == 1:
            held.now_ns += 3 * S
        else:
            held.inbox = b"answer"

    held = Held(monkeypatch, woken)
    held.listen()
    assert held.taken == [(b"answer", S - 1)]
