"""Whatever the bus and the OBC do: a telemetry packet is received once and in its turn, or told as lost."""

from typing import Any

from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from hil_tests.vectors.reference_can import record
from st_emulator.wire.can.bus import BusError
from st_emulator.wire.can.wiring import CanWiring

from .conftest import CanBench, make_can
from .test_can_unit_faults import Fault

DUMP = {"memory_id": 1, "start_address": 0, "length": 600}
TROUBLE = st.sampled_from(
    ["none", "deaf", "full link", "bit errors", "nobody acknowledges", "flood", "overflow", "waits"]
)
SECTIONS = st.sampled_from(
    [{}, {"timeout_ms": 100}, {"block_size": 1, "padding": -1}, {"bitrate": 125_000, "bus_off_restart_ms": 0}]
)


def trouble(bench: CanBench, fault: Fault, kind: str, ms: float) -> None:
    """One kind of it for a time."""
    peer = bench.peer
    peer.deaf = kind == "deaf"
    bench.refusing = kind == "full link"
    fault.number = 0
    if kind == "bit errors":
        fault.strike(1 + int(ms), BusError.BIT)
    elif kind == "nobody acknowledges":
        fault.strike(1_000_000, BusError.ACK)
    elif kind == "flood":
        frames_a_ms = bench.emulator.dialect.port.settings.bus.bitrate / 1000 / 140
        for number in range(int(ms * frames_a_ms)):
            bench.put(record(0x010, bytes([number & 0xFF] * 8)))
    elif kind == "overflow":
        peer.answers.extend([b"\x32\0\0"] * 3)
    elif kind == "waits":
        for _ in range(20):
            bench.put(record(peer.telecommand, b"\x31\0\0"))
    bench.run(ms)
    peer.answers.clear()


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    section=SECTIONS,
    fd=st.booleans(),
    steps=st.lists(
        st.tuples(TROUBLE, st.sampled_from([0.3, 20, 300, 1100, 2500]), st.booleans()), max_size=8
    ),
)
# A flow control and a packet of the unit run out of time at the same instant, and an event tells of the one.
@example(section={}, fd=False, steps=[("flood", 2500, True), ("nobody acknowledges", 2500, True)])
def test_received_or_told(section: dict[str, Any], fd: bool, steps: list[tuple[str, float, bool]]) -> None:
    fault = Fault()
    bench = make_can(disturbance=fault, can_section=section, can=CanWiring(fd=fd))
    bench.run(450)
    bench.send("hk_set_interval", {"intervals": [{"structure_id": 1, "interval_ms": 250}]}, ack=0)
    bench.run(50)
    for kind, ms, dump in steps:
        if dump:
            bench.send("memory_dump", DUMP, ack=15)
        trouble(bench, fault, kind, ms)
    trouble(bench, fault, "none", 5000)
    bench.send("hk_disable", {"structure_ids": [1]}, ack=0)
    bench.send("memory_dump", DUMP, ack=15)  # needs flow control in CAN FD, too
    bench.run(1500)
    assert bench.emulator.dialect.port.queued_bytes == 0
    counts = [packet.decoded["sequence_count"] for packet in bench.packets]
    assert counts == sorted(set(counts))
    assert counts[-1] == bench.emulator.dialect.transmitter._sequence_count - 1
    lost = counts[-1] + 1 - len(counts)
    told = bench.events("CAN_PACKETS_LOST") + bench.events("TX_QUEUE_OVERFLOWED")
    assert sum(event["packets"] for event in told) == lost
    assert bench.emulator.dialect.port.counters.packets_lost == lost
