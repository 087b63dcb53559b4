"""Five units at once in real time: two of other languages on lines of their own, and on one vcan0 three of
two languages. Each is heard by a reader made with struct alone; none disturbs another.
"""

from __future__ import annotations

import os
import select
import socket
import struct
import termios
import threading
import time
import tty
from contextlib import ExitStack
from pathlib import Path

import pytest

from hil_tests.cli.live import LiveUnit
from hil_tests.dialects.nos3 import client as nos3
from hil_tests.dialects.sagitta import client as sagitta
from st_emulator.obc import Obc

pytestmark = [pytest.mark.vcan, pytest.mark.slow]

SECONDS = 12.0
PATIENCE_S = 60.0  # only bounds a hang
BUS = "can:socketcan/vcan0"
PUS_NODES = (1, 2)
CARD = 44
STAR_TRACK = 4


class Line:
    """The OBC's end of a pseudo-terminal."""

    def __init__(self, path: Path) -> None:
        self.descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self.descriptor, termios.TCSANOW)
        self.octets = b""

    def write(self, data: bytes) -> None:
        os.write(self.descriptor, data)

    def listen(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            if select.select([self.descriptor], [], [], left)[0]:
                self.octets += os.read(self.descriptor, 4096)

    def close(self) -> None:
        os.close(self.descriptor)


class Bus:
    """Frames of vcan0, as the kernel gives them: its buffer is small, so a thread takes them out."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self.socket.bind(("vcan0",))
        self.socket.settimeout(0.2)
        self.frames: list[tuple[int, bytes]] = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._take, daemon=True)
        self._thread.start()

    def send(self, identifier: int, data: bytes) -> None:
        self.socket.send(struct.pack("=IB3x8s", identifier, len(data), data))

    def _take(self) -> None:
        while not self._over.is_set():
            try:
                identifier, length, data = struct.unpack("=IB3x8s", self.socket.recv(16))
            except TimeoutError:
                continue
            self.frames.append((identifier & 0x1FFFFFFF, data[:length]))

    def of(self, identifier: int) -> list[bytes]:
        return [data for found, data in list(self.frames) if found == identifier]

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self.socket.close()


def unit(*arguments: str) -> LiveUnit:
    return LiveUnit(*arguments, "--store", "none")


class Session:
    """What each OBC has seen."""

    def __init__(self) -> None:
        self.sagitta: list[sagitta.Frame] = []
        self.nos3 = b""
        self.polls = 0
        self.bus: Bus
        self.pus: dict[int, tuple[int, int, dict[str, int]]] = {}


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    folder = tmp_path_factory.mktemp("five")
    seen = Session()
    with ExitStack() as stack:
        seen.bus = bus = Bus()
        stack.callback(bus.close)
        obcs = {node: stack.enter_context(Obc.connect(BUS, unit="roja1", node=node)) for node in PUS_NODES}
        units = [
            LiveUnit(
                "roja1", "--dialect", "sagitta", "--link", f"pty:{folder / 'sagitta'}", "--store", "none"
            ),
            LiveUnit("zy3", "--dialect", "nos3", "--link", f"pty:{folder / 'nos3'}", "--store", "none"),
            *(unit("roja1", "--link", BUS, "--node", str(node)) for node in PUS_NODES),
            unit("roja1", "--dialect", "canopen", "--node", str(CARD), "--link", BUS),
        ]
        for one in units:
            stack.callback(one.stop, 15)
        for one in units:
            one.await_running()
        lines = {name: Line(folder / name) for name in ("sagitta", "nos3")}
        for line in lines.values():
            stack.callback(line.close)
        for obc in obcs.values():
            obc.wait_for_event("BOOT_COMPLETED", timeout_s=PATIENCE_S, since=0)
        deadline = time.monotonic() + PATIENCE_S
        while not bus.of(0x700 + CARD):
            assert time.monotonic() < deadline, "no heartbeat of the card"
            time.sleep(0.01)
        for obc in obcs.values():
            obc.acquire(timeout_s=PATIENCE_S)
        lines["sagitta"].write(sagitta.framed(sagitta.body(sagitta.ACTION, sagitta.BOOT, b"\x01")))
        lines["sagitta"].listen(4.5)  # boot loader, boot
        lines["sagitta"].write(sagitta.framed(sagitta.body(sagitta.SET, 18, bytes([24, 27]) + bytes(14))))
        # SDO download of one octet: object 4000h, the state that is asked for
        bus.send(0x600 + CARD, struct.pack("<BHBI", 0x2F, 0x4000, 0, STAR_TRACK))
        begun = time.monotonic()
        while time.monotonic() - begun < SECONDS:
            lines["sagitta"].write(sagitta.framed(sagitta.body(sagitta.REQUEST, sagitta.SOLUTION)))
            lines["nos3"].write(nos3.command("data"))
            seen.polls += 1
            for obc in obcs.values():
                obc.ping(timeout_s=PATIENCE_S)
            for line in lines.values():
                line.listen(0.25)
        for node, obc in obcs.items():
            attitudes = obc.attitudes()
            valid = sum(attitude.valid for attitude in attitudes)
            seen.pus[node] = (len(attitudes), valid, obc.counters.as_dict())
        seen.sagitta = sagitta.Reader().take(0, lines["sagitta"].octets, 0.0)
        seen.nos3 = lines["nos3"].octets
    return seen


def test_sagitta_on_its_line(session: Session) -> None:
    kinds = (sagitta.TELEMETRY, sagitta.ASYNCHRONOUS)
    frames = [frame for frame in session.sagitta if frame.type in kinds and frame.id == sagitta.SOLUTION]
    assert {len(frame.body) for frame in frames} == {sagitta.TELEMETRY_BODY_BYTES[sagitta.SOLUTION]}
    assert {frame.type for frame in frames} == set(kinds), "asked for, and subscribed"
    assert sum(frame.body[77] for frame in frames) >= SECONDS, "valid ones"


def test_nos3_on_its_line(session: Session) -> None:
    size = 9 + nos3.reply_size("data")
    answers = [session.nos3[start : start + size] for start in range(0, len(session.nos3), size)]
    assert session.polls - 2 <= len(answers) <= session.polls
    decoded = [nos3.decode("data", answer[9:]) for answer in answers if len(answer) == size]
    assert {answer[:9] for answer in answers} == {nos3.command("data")}
    assert sum(values["valid"] for values in decoded) >= len(decoded) / 2


def test_two_units_in_pus_on_the_bus(session: Session) -> None:
    for node, (attitudes, valid, counters) in session.pus.items():
        assert valid >= 4 * SECONDS * 0.8, node
        assert attitudes - valid <= 12, node
        assert counters["sequence_gaps"] == counters["crc_errors"] == counters["malformed"] == 0


def test_the_card_beside_them(session: Session) -> None:
    bus = session.bus
    assert bus.of(0x580 + CARD)[0][:4] == struct.pack("<BHB", 0x60, 0x4000, 0), "the write was acknowledged"
    heartbeats = bus.of(0x700 + CARD)
    assert len(heartbeats) >= SECONDS * 0.8
    assert set(heartbeats) <= {b"\0", b"\x05"}
    three, four, five = (bus.of(identifier) for identifier in (0x380 + CARD, 0x480 + CARD, 0x181 + CARD))
    assert len(three) >= 4 * SECONDS * 0.7
    assert abs(len(three) - len(four)) <= 1 >= abs(len(four) - len(five))
    for (real, i), (j, k) in zip(
        (struct.unpack("<ff", data) for data in four),
        (struct.unpack("<ff", data) for data in five),
        strict=False,
    ):
        assert real**2 + i**2 + j**2 + k**2 == pytest.approx(1, abs=1e-5)


def test_nobody_answers_for_another(session: Session) -> None:
    """Node numbers keep the two languages of the bus apart."""
    own = {0x700, 0x580, 0x380, 0x480, 0x180, 0x280, 0x80}
    card = {identifier for identifier, _ in session.bus.frames if identifier & 0x7F == CARD}
    assert {identifier & 0x780 for identifier in card} <= own | {0x600}
    assert {identifier & 0x7F for identifier, _ in session.bus.frames} <= {CARD, CARD + 1, *PUS_NODES, 0}
