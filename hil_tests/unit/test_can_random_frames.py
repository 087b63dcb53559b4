"""100,000 random frames on the unit's identifiers: all counted, as a second model of a receiver counts."""

import random
import struct
from dataclasses import dataclass, field
from typing import Any

import pytest

from hil_tests.vectors.received import EVENT
from hil_tests.vectors.reference_can import error_record, record, remote_record
from st_emulator.wire.can.wiring import CanWiring

from .conftest import MODE, CanBench, make_can

FRAMES, TOGETHER = 100_000, 20
#: The bus carries TOGETHER frames, and what the unit says meanwhile, in this time.
BATCH_MS = 5
ANSWER_MS = 10
TELECOMMAND, SYNC, TIME = 0x60A, 0x080, 0x100
OTHERS = (0x58A, 0x70A, 0x18A, 0x60B, 0x000, 0x7FF)  # the unit's own identifiers, another unit's


@dataclass(frozen=True)
class Frame:
    """What stands on the bus; ``kind``: data, fd, remote, extended or error."""

    kind: str
    identifier: int
    data: bytes

    @property
    def record(self) -> bytes:
        if self.kind == "error":
            return error_record(self.identifier, self.data)
        if self.kind == "remote":
            return remote_record(self.identifier, len(self.data))
        return record(self.identifier, self.data, fd=self.kind == "fd", extended=self.kind == "extended")

    @property
    def rank(self) -> tuple[int, ...]:
        """The lowest one wins the bus: an extended frame behind a standard one, remote behind data."""
        if self.kind == "extended":
            return self.identifier >> 18, 1, self.identifier & 0x3FFFF
        return self.identifier, 0, 0, self.kind == "remote"


@dataclass
class Receiver:
    """ISO 15765-2 read a second time: how a receiver of classic CAN counts frames, whatever their time."""

    counts: dict[str, int] = field(default_factory=dict)
    octets: int = 0
    length: int = 0
    got: int = 0
    sequence: int = 0
    latched: int | None = None

    def count(self, *names: str) -> None:
        for name in names:
            self.counts[name] = self.counts.get(name, 0) + 1

    def take(self, frame: Frame) -> None:
        if frame.kind == "error":
            self.count("error_frames")
            return
        self.count("rx_frames")
        if frame.kind in ("remote", "extended"):
            return
        if frame.identifier == SYNC:
            if frame.kind == "fd" or len(frame.data) > 1:
                self.count("syncs_ignored")
            else:
                self.count("syncs")
                self.latched = frame.data[0] if frame.data else 0
        elif frame.identifier == TIME:
            good = frame.kind == "data" and len(frame.data) == 8 and frame.data[0] == self.latched
            if not good:
                self.count("syncs_ignored")
        elif frame.identifier == TELECOMMAND:
            self.octets += len(frame.data)
            if frame.kind == "fd" and frame.data:
                self.count("frames_ignored", "bad_length")
            else:
                self.transport(frame.data)

    def interrupt(self) -> None:
        if self.length:
            self.count("receptions_failed", "unexpected_pdus")
            self.length = 0

    def transport(self, data: bytes) -> None:
        kind, low = (data[0] >> 4, data[0] & 15) if data else (None, 0)
        if kind == 0 and 0 < low < len(data):
            self.interrupt()
            self.count("pdus_received")
        elif kind == 1 and len(data) == 8 and self.announced(data) is not None:
            length = self.announced(data)
            self.interrupt()
            if length > 1024:
                self.count("receptions_failed", "too_long")
            else:
                self.length, self.got, self.sequence = length, 6, 1
        elif kind == 2 and not self.length:
            self.count("frames_ignored", "unexpected_pdus")
        elif kind == 2 and (len(data) == 8 or len(data) - 1 >= self.length - self.got):
            if low != self.sequence:
                self.count("receptions_failed", "wrong_sequence")
                self.length = 0
                return
            self.sequence = (self.sequence + 1) % 16
            self.got += 7
            if self.got >= self.length:
                self.count("pdus_received")
                self.length = 0
        elif kind == 3 and len(data) >= 3:
            self.count("frames_ignored", "unexpected_pdus")  # the unit sends nothing
        else:
            self.count("frames_ignored", "bad_length")

    @staticmethod
    def announced(data: bytes) -> int | None:
        """The length in a first frame that makes sense."""
        length = struct.unpack(">H", data[:2])[0] & 0xFFF
        if not length:
            length = struct.unpack(">I", data[2:6])[0]
            return length if length > 4095 else None
        return length if length >= 8 else None


def random_frames(seed: int, number: int) -> list[Frame]:
    """Of all kinds on all of the unit's identifiers; now and then what carries a transfer on."""
    dice = random.Random(seed)
    frames = []
    sequence = 0
    for _ in range(number):
        identifier = dice.choices((TELECOMMAND, SYNC, TIME, *OTHERS), (60, 8, 8, *[4] * len(OTHERS)))[0]
        kind = dice.choices(("data", "fd", "remote", "extended", "error"), (88, 3, 3, 3, 3))[0]
        data = dice.randbytes(dice.choices(range(9), (2, 2, 1, 1, 1, 1, 1, 2, 12))[0])
        if kind == "fd":
            data = dice.randbytes(dice.choice((0, 3, 8, 12, 48, 64)))
        elif kind == "extended":
            identifier = identifier << 18 | dice.getrandbits(18)
        elif kind == "error":
            # Every class but bus-off, in which a controller receives nothing.
            identifier, data = dice.choice((1, 2, 4, 8, 0x10, 0x20, 0x80, 0x200)), dice.randbytes(8)
        elif kind == "data" and identifier == TELECOMMAND and dice.random() < 0.6:
            if dice.random() < 0.25:
                sequence = 1
                data = struct.pack(">H", 0x1000 | dice.choice((8, 13, 20, 34, 62))) + dice.randbytes(6)
            else:
                data = bytes([0x20 | sequence]) + dice.randbytes(7)
                sequence = (sequence + 1) % 16
        elif kind == "data" and identifier in (SYNC, TIME) and dice.random() < 0.7:
            data = bytes([dice.randrange(3)]) + (dice.randbytes(7) if identifier == TIME else b"")
        frames.append(Frame(kind, identifier, data))
    return frames


def silenced(bench: CanBench) -> None:
    """Nothing that the flow control among the frames could answer: no events, no housekeeping."""
    bench.send("event_disable", {"event_ids": sorted(EVENT.values())}, ack=0)
    bench.function("CLEAR_COUNTERS", ack=0)
    bench.run(50)
    bench.forget()


def counters(bench: CanBench) -> dict[str, int]:
    return bench.emulator.dialect.cyclic.housekeeping()


def answered(bench: CanBench) -> None:
    count = bench.send("ping", source_id=0x1234)
    bench.run(ANSWER_MS)
    assert bench.stages(count) == ["acceptance_success", "completion_success"]


def nothing_piled_up(bench: CanBench) -> None:
    emulator = bench.emulator
    port = emulator.dialect.port
    assert port.bus.queued_frames == port.queued_bytes == 0
    assert len(emulator.clock._queue) < 50
    assert len(port._handed_over) == sum(map(len, port._cyclic.values())) == 0
    assert len(port.bus._others) == 0
    assert len(port.connection._receiver._data) <= 1024


@pytest.mark.parametrize("section", [{}, {"block_size": 1}], ids=["no blocks", "blocks of 1"])
def test_all_are_counted(section: dict[str, Any]) -> None:
    number = FRAMES if not section else FRAMES // 10
    bench = make_can(can_section={"heartbeat_ms": 0, **section}).boot()
    silenced(bench)
    model = Receiver()
    frames = random_frames(1, number)
    before = counters(bench)
    octets_before = bench.emulator.dialect.receiver.counters.rx_bytes
    for start in range(0, number, TOGETHER):
        batch = frames[start : start + TOGETHER]
        # Error messages are no frames of the bus: they count when they come.
        for frame in sorted(batch, key=lambda item: (item.kind != "error", item.rank)):
            model.take(frame)
        for frame in batch:
            bench.put(frame.record)
        bench.run(BATCH_MS)
    after = counters(bench)
    names = (
        "rx_frames", "error_frames", "pdus_received", "receptions_failed", "frames_ignored", "wrong_sequence",
        "unexpected_pdus", "too_long", "bad_length", "syncs", "syncs_ignored",
    )  # fmt: skip
    most = {"rx_frames": 1 << 32, "pdus_received": 1 << 32}
    wanted = {name: min(model.counts[name], most.get(name, 1 << 16) - 1) for name in names}
    assert min(wanted.values()) > 50 * number / FRAMES, "each of them comes up"
    assert {name: after[name] - before[name] for name in names} == wanted
    assert sum(model.counts[name] for name in ("rx_frames", "error_frames")) == number
    # Of the frames on the telecommand's identifier each is part of a packet or counted as bad.
    for name in ("timeouts_a", "timeouts_bs", "timeouts_cr", "flow_control_errors", "transmissions_failed"):
        assert after[name] == 0
    assert after["tx_frames"] == len(bench.groups)
    assert bench.emulator.dialect.receiver.counters.rx_bytes - octets_before == model.octets
    assert bench.emulator.device.mode == MODE["STANDBY"]
    answered(bench)
    assert bench.emulator.dialect.receiver.counters.tc_received == model.counts["pdus_received"] + 1
    nothing_piled_up(bench)


@pytest.mark.parametrize("fd", [False, True])
def test_while_the_unit_works(fd: bool) -> None:
    """It tracks, tells events, and the flow control among the frames meets its packets, bus-off included."""
    bench = make_can(can=CanWiring(fd=fd)).boot()
    bench.to_mode("TRACKING")
    bench.function("CLEAR_COUNTERS", ack=0)
    bench.run(20)
    before = counters(bench)
    frames = random_frames(2, 10_000)
    dice = random.Random(3)
    for start in range(0, len(frames), TOGETHER):
        for frame in frames[start : start + TOGETHER]:
            bench.put(frame.record)
        if dice.random() < 0.02:
            bench.put(error_record(0x40))
        if dice.random() < 0.02:
            bench.put(error_record(0x100))
        bench.run(BATCH_MS)
        assert bench.emulator.dialect.port.queued_bytes <= 49_152
    after = counters(bench)
    assert after["bus_off_count"] - before["bus_off_count"] > 2
    if not fd:  # in CAN FD few packets need flow control
        assert after["flow_control_errors"] > 0
        assert after["transmissions_failed"] > 0
    reasons = (
        "timeouts_a", "timeouts_bs", "timeouts_cr", "wrong_sequence", "unexpected_pdus",
        "flow_control_errors", "too_long", "bad_length",
    )  # fmt: skip
    failures = ("transmissions_failed", "receptions_failed", "frames_ignored")
    assert sum(after[name] for name in reasons) == sum(after[name] for name in failures)
    assert bench.emulator.device.mode == MODE["TRACKING"]
    bench.put(error_record(0x100))
    bench.run(3000)
    bench.forget()
    answered(bench)
    bench.run(1000)
    assert len(bench.of("attitude_report")) >= 3


def test_records_that_are_cut() -> None:
    bench = make_can(can_section={"heartbeat_ms": 0}).boot()
    whole = record(SYNC, b"\x07")
    for length in range(1, len(whole)):
        bench.put(whole[:length])
        bench.put(whole)
        bench.run(1)
    port = bench.emulator.dialect.port
    assert port.counters.malformed_records == len(whole) - 1
    assert len(bench.frames("sync_time")) == len(whole) - 1, "the whole ones are read"
    answered(bench)


def test_records_of_impossible_frames() -> None:
    bench = make_can(can_section={"heartbeat_ms": 0}).boot()
    bad = [
        struct.pack(">IBBxx", 0x60A, 9, 0) + bytes(9),  # 9 bytes in a classic frame
        struct.pack(">IBBxx", 0x60A, 11, 4) + bytes(11),  # no such length in CAN FD
        struct.pack(">IBBxx", 0x800, 1, 0) + bytes(1),  # 12 bits of identifier
        struct.pack(">IBBxx", 0x2000_0004, 3, 0) + bytes(3),  # an error message of 3 bytes
        struct.pack(">IBBxx", 0x4000_060A, 9, 0),  # a remote frame that asks for 9
        struct.pack(">IBBxx", 0x60A, 1, 0x80) + bytes(1),  # unknown flags
    ]
    for number, data in enumerate(bad, start=1):
        bench.put(data + record(SYNC, b"\x01"))
        bench.run(1)
        assert bench.emulator.dialect.port.counters.malformed_records == number
    assert bench.can()["syncs"] == len(bad)
    answered(bench)


@pytest.mark.parametrize("seed", range(3))
def test_garbage_from_the_link(seed: int) -> None:
    bench = make_can().boot()
    dice = random.Random(seed)
    for _ in range(1500):
        bench.put(dice.randbytes(dice.choice((1, 7, 8, 9, 16, 40, 300))))
        bench.run(dice.choice((0, 0.1, 5)))
    bench.run(3000)
    bench.forget()
    bench.emulator.receive(error_record(0x100))  # random bytes may have said bus-off
    bench.run(10)
    answered(bench)
