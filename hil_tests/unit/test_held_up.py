"""The pacer on a computer that does not let it run for seconds: no timeout passes while its answer waits."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import pytest

from hil_tests.vectors.reference_can import Peer
from st_emulator.bench.emulator import Emulator
from st_emulator.drivers import realtime
from st_emulator.protocol.can.cyclic import TELEMETRY
from st_emulator.units.profile import load_unit
from st_emulator.wire.can.wiring import CanWiring

NS_PER_S = 1_000_000_000


class PeerLink:
    """The OBC at the far end of a link that cannot be waited for; it answers at once."""

    def __init__(self, peer: Peer) -> None:
        self.peer = peer

    def fileno(self) -> None:
        return None

    def read(self) -> bytes:
        data = b"".join(self.peer.outbox)
        self.peer.outbox.clear()
        return data


@pytest.mark.parametrize("held_up_s", [1.5, 5.0])  # over N_Bs, 1 s
def test_flow_control_that_waits_in_the_link_is_no_timeout(
    monkeypatch: pytest.MonkeyPatch, held_up_s: float
) -> None:
    now = SimpleNamespace(ns=0, held_up=0, rested_ns=0)
    peer = Peer(0x60A, 0x58A)
    emulator = Emulator(load_unit("roja1"), can=CanWiring(), transmit=peer.take)
    assert emulator.dialect.port.settings.identifiers.identifier(TELEMETRY) == peer.telemetry

    def wait(readable: list, writable: list, exceptional: list, wait_s: float) -> tuple[list, list, list]:
        now.ns += round(wait_s * NS_PER_S) + 1000
        if peer.outbox and now.ns >= now.rested_ns:  # an answer waits, and the computer does something else
            now.held_up += 1
            now.ns += round(held_up_s * NS_PER_S)
            now.rested_ns = now.ns + 10 * NS_PER_S
        return [], [], []

    monkeypatch.setattr(realtime.time, "monotonic_ns", lambda: now.ns)
    monkeypatch.setattr(realtime.select, "select", wait)
    stop = realtime.StopSignal()
    realtime.run_paced(emulator, PeerLink(peer), stop=stop, until_ns=20 * NS_PER_S)
    stop.close()
    assert now.held_up >= 2
    assert emulator.dialect.cyclic.housekeeping()["timeouts_bs"] == 0
    assert len(peer.packets) >= 18  # housekeeping each second


def test_what_is_late_comes_no_faster_than_it_can_be_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    """The reports of 3 s in which the computer did nothing: one after the other, until the delay is gone."""
    now = SimpleNamespace(ns=0, held_up=False)
    sent: list[tuple[int, int]] = []  # (the computer's clock, virtual)

    def wait(readable: list, writable: list, exceptional: list, wait_s: float) -> tuple[list, list, list]:
        now.ns += round(wait_s * NS_PER_S) + 1000
        if not now.held_up and now.ns > 2 * NS_PER_S:
            now.held_up = True
            now.ns += 3 * NS_PER_S
        return [], [], []

    monkeypatch.setattr(realtime.time, "monotonic_ns", lambda: now.ns)
    monkeypatch.setattr(realtime.select, "select", wait)
    emulator = Emulator(load_unit("roja1"), transmit=lambda data, t_ns: sent.append((now.ns, t_ns)))
    stop = realtime.StopSignal()
    silent = SimpleNamespace(fileno=lambda: None, read=lambda: b"")
    realtime.run_paced(emulator, silent, stop=stop, until_ns=25 * NS_PER_S)
    stop.close()
    assert now.held_up
    # 3 s are made up in 12 s of 15 virtual ones, and nothing between is lost or runs ahead.
    for (wall, virtual), (next_wall, next_virtual) in itertools.pairwise(sent):
        passed = next_wall - wall
        assert next_virtual - virtual <= realtime.CATCH_UP * passed + 1_000_000
    late = [wall - virtual for wall, virtual in sent]
    assert max(late) == pytest.approx(3 * NS_PER_S, abs=0.3 * NS_PER_S)
    assert all(
        abs(one) < 1_000_000 for (wall, _), one in zip(sent, late, strict=True) if wall > 18 * NS_PER_S
    )
    assert sum(1 for wall, _ in sent if wall > 18 * NS_PER_S) > 5
