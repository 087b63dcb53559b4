"""The pacer on a computer that does not let it run for seconds: no timeout passes while its answer waits."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from hil_tests.vectors.reference_can import Peer
from st_emulator.bench.emulator import Emulator
from st_emulator.drivers import realtime
from st_emulator.protocol.can.cyclic import TELEMETRY
from st_emulator.units.profile import load_unit
from st_emulator.wire.can.wiring import CanWiring

HELD_UP_NS = 1_500_000_000  # over N_Bs; over twice N_Bs it is a time for which no bench can answer


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


def test_flow_control_that_waits_in_the_link_is_no_timeout(monkeypatch: pytest.MonkeyPatch) -> None:
    now = SimpleNamespace(ns=0, held_up=0, rested_ns=0)
    peer = Peer(0x60A, 0x58A)
    emulator = Emulator(load_unit("roja1"), can=CanWiring(), transmit=peer.take)
    assert emulator.dialect.port.settings.identifiers.identifier(TELEMETRY) == peer.telemetry

    def wait(readable: list, writable: list, exceptional: list, wait_s: float) -> tuple[list, list, list]:
        now.ns += round(wait_s * 1e9) + 1000
        if peer.outbox and now.ns >= now.rested_ns:  # an answer waits, and the computer does something else
            now.held_up += 1
            now.ns += HELD_UP_NS
            now.rested_ns = now.ns + 2 * HELD_UP_NS
        return [], [], []

    monkeypatch.setattr(realtime.time, "monotonic_ns", lambda: now.ns)
    monkeypatch.setattr(realtime.select, "select", wait)
    stop = realtime.StopSignal()
    realtime.run_paced(emulator, PeerLink(peer), stop=stop, until_ns=12_000_000_000)
    stop.close()
    assert now.held_up >= 2
    assert emulator.dialect.cyclic.housekeeping()["timeouts_bs"] == 0
    assert len(peer.packets) >= 10  # housekeeping each second
