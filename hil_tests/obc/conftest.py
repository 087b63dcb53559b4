"""A small star tracker made with struct alone, so that the OBC is never tested against our own encoder.

Layouts are written down here a second time, from the standards and the interface document: CCSDS 133.0-B
clause 4.1, ECSS-E-ST-70-41C clauses 7.4 and 8, RFC 1055.
"""

import heapq
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest

from st_emulator.links import MemoryLink, memory_link_pair
from st_emulator.obc import Obc, SteppedReader

APID = 0x123
MS = 1_000_000
CUC = struct.pack(">IBH", 2_000_000_000, 0x80, 0)  # 2e9 s and a half
STATUS = struct.Struct(">BBHIBHIIIIIIIhB")
ATTITUDE = struct.Struct(">I7sBBBI4d6fB3f4H3f3IBHf")
RATE_COVARIANCE = struct.Struct(">B6f")  # behind it, since it has grown


def crc16(data: bytes) -> int:
    """ECSS-E-ST-70-41C annex B, bit by bit."""
    register = 0xFFFF
    for octet in data:
        for bit in range(7, -1, -1):
            feedback = (register >> 15) ^ (octet >> bit & 1)
            register = register << 1 & 0xFFFF
            if feedback:
                register ^= 0x1021
    return register


def slip(packet: bytes) -> bytes:
    escaped = bytearray()
    for octet in packet:
        escaped += {0xC0: b"\xdb\xdc", 0xDB: b"\xdb\xdd"}.get(octet, bytes([octet]))
    return b"\xc0" + escaped + b"\xc0"


def unslip(line: bytes) -> list[bytes]:
    return [
        part.replace(b"\xdb\xdc", b"\xc0").replace(b"\xdb\xdd", b"\xdb")
        for part in line.split(b"\xc0")
        if part
    ]


def telemetry_packet(
    service: int, subservice: int, data: bytes = b"", *, count: int = 0, apid: int = APID, time: bytes = CUC
) -> bytes:
    """A telemetry packet, headers and error control included."""
    secondary = struct.pack(">BBBHH", 0x21, service, subservice, 7, 9) + time
    body = secondary + data
    packet = struct.pack(">HHH", 0x0800 | apid, 0xC000 | count, len(body) + 2 - 1) + body
    return packet + struct.pack(">H", crc16(packet))


def attitude_data(
    *,
    frame: int = 5,
    mode: int = 4,
    valid: int = 1,
    reasons: int = 0,
    q: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
    rate: tuple[float, float, float] | None = (0.0, 0.0, 0.0),
    time: bytes = CUC,
    late: int = 0,
    rate_covariance: tuple[float, ...] | None = None,
    older: bool = False,
) -> bytes:
    """Source data of an attitude report (130,1); ``older``: of a unit that knows no covariance of a rate."""
    behind = RATE_COVARIANCE.pack(int(rate_covariance is not None), *(rate_covariance or (0.0,) * 6))
    report = ATTITUDE.pack(
        frame, time, 1, mode, valid, reasons, *q,
        1e-12, 2e-13, 3e-13, 4e-12, 5e-13, 6e-11,
        int(rate is not None), *(rate or (0.0, 0.0, 0.0)),
        20, 12, 12, 9,
        0.25, 101.5, 2.5, 100_000, 12_345_678, 150_000,
        late, 0, 2.0**-20 if valid else 1.0,
    )  # fmt: skip
    return report if older else report + behind


@dataclass(frozen=True)
class Request:
    """A telecommand as the unit sees it."""

    packet: bytes

    @property
    def identity(self) -> bytes:
        return self.packet[:4]

    @property
    def apid(self) -> int:
        return struct.unpack(">H", self.packet[:2])[0] & 0x7FF

    @property
    def count(self) -> int:
        return struct.unpack(">H", self.packet[2:4])[0] & 0x3FFF

    @property
    def ack(self) -> int:
        return self.packet[6] & 0x0F

    @property
    def type(self) -> tuple[int, int]:
        return self.packet[7], self.packet[8]

    @property
    def source_id(self) -> int:
        return struct.unpack(">H", self.packet[9:11])[0]

    @property
    def data(self) -> bytes:
        return self.packet[11:-2]


Handler = Callable[[Request], None]


@dataclass
class FakeUnit:
    """Answers what it has a handler for, at the times the handler says. Everything else stays unanswered."""

    link: MemoryLink
    now_ns: int = 0
    count: int = 0
    mode: int = 2
    requests: list[Request] = field(default_factory=list)
    handlers: dict[tuple[int, int], Handler] = field(default_factory=dict)
    spoil: Callable[[bytes], bytes | None] = lambda packet: packet
    _due: list[tuple[int, int, bytes]] = field(default_factory=list)
    _order: int = 0
    _line: bytes = b""

    def step(self, now_ns: int) -> None:
        self.now_ns = now_ns
        self._line += self.link.read()
        end = self._line.rfind(b"\xc0") + 1
        for packet in unslip(self._line[:end]):
            self._receive(packet)
        self._line = self._line[end:]
        while self._due and self._due[0][0] <= now_ns:
            self.link.write(heapq.heappop(self._due)[2])

    def _receive(self, packet: bytes) -> None:
        (word, sequence, length) = struct.unpack(">HHH", packet[:6])
        assert crc16(packet) == 0
        assert word >> 11 == 0b00011, "version 0, telecommand, secondary header"
        assert sequence >> 14 == 0b11
        assert len(packet) == length + 7
        assert packet[6] >> 4 == 2, "PUS version"
        request = Request(packet)
        self.requests.append(request)
        if handler := self.handlers.get(request.type):
            handler(request)

    def send_line(self, line: bytes, after_ms: float = 0) -> None:
        self._order += 1
        heapq.heappush(self._due, (self.now_ns + round(after_ms * MS), self._order, line))

    def send(
        self, service: int, subservice: int, data: bytes = b"", after_ms: float = 0, time: bytes = CUC
    ) -> None:
        """Telemetry with the next sequence count; `spoil` may damage or (None) lose it on its way."""
        packet = telemetry_packet(service, subservice, data, count=self.count, time=time)
        self.count = (self.count + 1) % 16384
        sent = self.spoil(packet)
        if sent is not None:
            self.send_line(slip(sent), after_ms)

    def report(self, request: Request, subservice: int, extra: bytes = b"", after_ms: float = 0) -> None:
        """A verification report."""
        self.send(1, subservice, request.identity + extra, after_ms)

    def fail(self, request: Request, subservice: int, code: int, data: int = 0, after_ms: float = 0) -> None:
        self.report(request, subservice, struct.pack(">HI", code, data), after_ms)

    def complete(self, request: Request, after_ms: float = 0) -> None:
        """Acceptance and completion, when asked for."""
        if request.ack & 8:
            self.report(request, 1, after_ms=after_ms)
        if request.ack & 1:
            self.report(request, 7, after_ms=after_ms)

    def answer(self, type: tuple[int, int], *then: Callable[[Request], None]) -> None:
        """Complete requests of this type at once, after doing `then`."""

        def handle(request: Request) -> None:
            for action in then:
                action(request)
            self.complete(request)

        self.handlers[type] = handle

    def event(
        self, event_id: int, data: bytes, severity: int = 1, after_ms: float = 0, time: bytes = CUC
    ) -> None:
        self.send(5, severity, struct.pack(">H", event_id) + data, after_ms, time)

    def attitude(self, after_ms: float = 0, **values: object) -> None:
        self.send(130, 1, attitude_data(**values), after_ms)  # type: ignore[arg-type]

    def status(self, request: Request | None = None) -> None:
        """Housekeeping structure STATUS."""
        values = (self.mode, 0, 3, 1234, 1, 0, 77, 0, 70, 60, 50, 1, 2, -250, 1)
        self.send(3, 25, b"\x01" + STATUS.pack(*values))


class Wire:
    """Everything that the tests take from here, in one fixture, since test files cannot import each other."""

    APID = APID
    CUC = CUC
    MS = MS
    FakeUnit = FakeUnit
    Request = Request
    crc16 = staticmethod(crc16)
    slip = staticmethod(slip)
    unslip = staticmethod(unslip)
    telemetry_packet = staticmethod(telemetry_packet)
    attitude_data = staticmethod(attitude_data)


@pytest.fixture(scope="session")
def wire() -> type[Wire]:
    return Wire


@pytest.fixture
def link_pair() -> tuple[MemoryLink, MemoryLink]:
    return memory_link_pair(capacity_bytes=1 << 22)


@pytest.fixture
def unit(link_pair: tuple[MemoryLink, MemoryLink]) -> FakeUnit:
    return FakeUnit(link_pair[0])


@pytest.fixture
def obc(unit: FakeUnit, link_pair: tuple[MemoryLink, MemoryLink]) -> Iterator[Obc]:
    """An OBC whose time is made of steps of one millisecond of the fake unit."""
    with Obc(link_pair[1], apid=APID, source_id=42, reader=SteppedReader(unit.step)) as opened:
        yield opened
