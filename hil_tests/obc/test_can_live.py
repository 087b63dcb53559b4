"""The OBC on CAN links: the reader's thread, deadlines, what names the unit. Time limits are for hangs."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from hil_tests.obc.can_unit import CanUnit, heartbeat, record
from st_emulator.errors import ConfigurationError
from st_emulator.links import Link, LinkError, memory_link_pair, open_link
from st_emulator.links.link import ClosesOnExit
from st_emulator.obc import (
    CanSettings,
    CanTransport,
    Obc,
    SteppedReader,
    TelecommandNotDelivered,
    UnitNotChosenError,
)
from st_emulator.protocol.can.cyclic import CanIdentifiers
from st_emulator.protocol.can.frames import CanFrame
from st_emulator.units.profile import load_unit, unit_text

PATIENCE_S = 30.0


@pytest.fixture
def bus_name(request: pytest.FixtureRequest) -> str:
    return f"can:virtual/{abs(hash(request.node.nodeid))}"


@pytest.fixture
def running(wire: Any, bus_name: str) -> Iterator[Callable[..., CanUnit]]:
    """Units of nodes of a virtual bus in a thread of their own."""
    links: list[Link] = []
    units: list[CanUnit] = []
    stop = threading.Event()

    def start(node: int, **options: Any) -> CanUnit:
        links.append(open_link(bus_name))
        unit = CanUnit(wire, links[-1], node, **options)  # type: ignore[arg-type]
        unit.fake.answer((17, 1), lambda request: unit.fake.send(17, 2))
        unit.fake.answer((6, 2))
        units.append(unit)
        return unit

    def run() -> None:
        now_ns = 0
        while not stop.is_set():
            for unit in list(units):
                unit.step(now_ns)
            now_ns += 1_000_000
            stop.wait(0.001)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield start
    finally:
        stop.set()
        thread.join()
        for link in links:
            link.close()


def test_over_a_virtual_bus(running: Any, bus_name: str, tmp_path: Path) -> None:
    unit = running(10, flow_control=b"\x30\x02\x01")
    with Obc.connect(bus_name, apid=0x123, node=10, record=tmp_path / "r") as obc:
        for _ in range(10):
            assert obc.ping(PATIENCE_S) > 0
        obc.memory_load("RAM", 0, bytes(256), PATIENCE_S)  # blocks of two frames, 1 ms apart: by deadlines
        unit.fake.attitude(frame=33)
        obc.wait_for("attitude_report", None, PATIENCE_S, since=0)
        counters = obc.counters.as_dict()
    assert (counters["telecommands_sent"], counters["telecommands_verified"]) == (11, 11)
    assert (counters["crc_errors"], counters["receptions_failed"], counters["transmissions_failed"]) == (
        0,
        0,
        0,
    )
    assert (tmp_path / "r" / "can.log").read_text().count("\n") == (
        counters["frames_received"] + counters["frames_sent"]
    )


def test_two_obcs_with_a_unit_each_on_a_virtual_bus(running: Any, bus_name: str) -> None:
    units = [running(node, heartbeat_ms=200) for node in (10, 11)]
    with Obc.connect(bus_name, apid=0x123, node=10) as first, Obc.connect(bus_name, node=11) as second:
        for _ in range(5):
            first.ping(PATIENCE_S)
            second.ping(PATIENCE_S)
        for obc in (first, second):
            assert obc.counters.sequence_gaps == 0
            assert obc.counters.as_dict()["transfer_frames_ignored"] == 0
    assert [len(unit.fake.requests) for unit in units] == [5, 5]
    with Obc.connect(bus_name) as third, pytest.raises(UnitNotChosenError, match="nodes 10, 11"):
        third.ping(PATIENCE_S)


def test_a_node_is_learned_on_a_virtual_bus(running: Any, bus_name: str) -> None:
    unit = running(99, heartbeat_ms=200)
    with Obc.connect(bus_name) as obc:
        unit.fake.attitude(after_ms=500)
        obc.ping(PATIENCE_S)
        assert obc.wait_for_cyclic("heartbeat", None, PATIENCE_S).values["mode"] == 2
    assert unit.fake.requests[0].apid == 0x123


def test_a_timeout_of_the_transport_ends_a_wait_by_itself(running: Any, bus_name: str) -> None:
    """Nothing arrives: only the deadline wakes the thread, after the frame went out in the caller's."""
    running(10, flow_control=None)
    with Obc.connect(bus_name, apid=0x123, node=10) as obc:
        verification = obc.begin("ping", timeout_s=PATIENCE_S)
        assert obc._reader.wait(lambda: verification.finished, obc.now_ns() + int(PATIENCE_S * 1e9))
        assert verification.state.value == "not delivered"
        assert 1.0 <= verification.seconds < PATIENCE_S  # type: ignore[operator]


class _SocketLink(ClosesOnExit):
    """A link with a descriptor, as SocketCAN has: nobody looks at it as long as nothing arrives."""

    name = "can:socket/pair"
    dropped_bytes = 0
    refusals = 0

    def __init__(self) -> None:
        self._ours, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        self._ours.setblocking(False)

    def fileno(self) -> int | None:
        return self._ours.fileno()

    def read(self) -> bytes:
        try:
            return self._ours.recv(65536)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> int:
        self.refusals -= 1
        return 0 if self.refusals >= 0 else self._ours.send(data)

    def close(self) -> None:
        self._ours.close()
        self.theirs.close()


def test_a_deadline_begun_in_the_callers_thread_wakes_the_readers() -> None:
    """The reader sleeps on its link without any time limit when the telecommand begins."""
    settings = CanSettings(timeout_ns=100_000_000)
    with Obc(_SocketLink(), apid=1, transport=CanTransport(CanIdentifiers(10), settings)) as obc:
        obc.wait(0.1)
        verification = obc.begin("ping", timeout_s=PATIENCE_S)
        with pytest.raises(TelecommandNotDelivered, match="no flow control"):
            obc.finish(verification)


def test_frames_that_come_do_not_put_a_deadline_off() -> None:
    link = _SocketLink()
    settings = CanSettings(timeout_ns=100_000_000)
    with Obc(link, apid=1, transport=CanTransport(CanIdentifiers(10), settings)) as obc:
        verification = obc.begin("ping", timeout_s=PATIENCE_S)
        link.theirs.send(record(0x70A, heartbeat()))
        with pytest.raises(TelecommandNotDelivered, match="no flow control"):
            obc.finish(verification)
        assert obc.cyclic("heartbeat") is not None


def test_a_frame_that_the_link_takes_later_ends_the_wait_for_it() -> None:
    link = _SocketLink()
    link.refusals = 3
    settings = CanSettings(timeout_ns=round(PATIENCE_S * 1e9))
    with Obc(link, apid=1, transport=CanTransport(CanIdentifiers(10), settings)) as obc:
        begun_ns = obc.now_ns()
        assert obc.send_frame(CanFrame(0x111)) > begun_ns
        assert obc.now_ns() - begun_ns < settings.timeout_ns
        assert link.theirs.recv(100) == record(0x111, b"")


# What is named


def test_a_units_file_gives_node_identifiers_and_rates(tmp_path: Path, bus_name: str) -> None:
    text = unit_text("roja1")[1].replace("bitrate = 1000000", "bitrate = 500000")
    text = text.replace("identifier_bits = 11", "identifier_bits = 29").replace(
        "padding = 0xCC", "padding = 0"
    )
    start = text.index("[can.identifiers]")
    text = text[:start] + text[text.index("[requirements]") :]
    file = tmp_path / "mine.toml"
    file.write_text(text.replace("timeout_ms = 1000 ", "timeout_ms = 250 "))
    with Obc.connect(bus_name, unit=str(file)) as obc:
        transport = obc.transport
        assert isinstance(transport, CanTransport)
        assert transport.identifiers == CanIdentifiers(10, True)
        settings = transport.settings
        assert (settings.bitrate, settings.padding, settings.timeout_ns) == (500_000, 0, 250_000_000)
        assert obc.destination_apid == load_unit("roja1").apid
    with Obc.connect(f"{bus_name}@250000", unit=str(file), node=33, apid=5) as obc:
        assert isinstance(obc.transport, CanTransport)
        assert (obc.transport.node, obc.transport.settings.bitrate) == (33, 250_000)
        assert obc.destination_apid == 5


def test_what_cannot_be_is_told(bus_name: str, tmp_path: Path) -> None:
    for node in (0, 128):
        with pytest.raises(ConfigurationError, match=f"CAN node {node}: allowed is a whole number from 1 to"):
            Obc.connect(bus_name, node=node)
        with pytest.raises(ConfigurationError, match=f"CAN node {node}"):
            Obc.connect(bus_name, unit="roja1", node=node)
    with pytest.raises(ConfigurationError, match="node 10: only a CAN bus has node numbers"):
        Obc.connect(f"pty:{tmp_path}/unit", node=10)
    with pytest.raises(ConfigurationError, match="no unit 'nothing'"):
        Obc.connect(bus_name, unit="nothing")
    with pytest.raises(LinkError, match="unknown CAN interface"):
        Obc.connect("can:carrier-pigeon/x")


def test_records_of_a_link_in_memory_may_be_cut(wire: Any) -> None:
    """A small link takes frames in pieces; they arrive whole."""
    unit_link, obc_link = memory_link_pair(20)
    taken = bytearray()

    def step(now_ns: int) -> None:
        taken.extend(unit_link.read())

    reader = SteppedReader(step)
    with Obc(obc_link, apid=1, reader=reader, transport=CanTransport(CanIdentifiers(10))) as obc:
        verification = obc.begin("ping", timeout_s=0.5)
        obc.send_frame(CanFrame(0x111, b"\x01\x02"))
        obc.wait(0.1)
        assert obc.counters.as_dict()["frames_refused"] == 1
    assert bytes(taken) == record(0x60A, b"\x10\x0d" + verification.packet[:6]) + record(0x111, b"\x01\x02")
