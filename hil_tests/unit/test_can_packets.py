"""Packets by ISO-TP on the unit's port: lengths, blocks, times between frames, several units on one bus."""

from itertools import pairwise

import pytest

from hil_tests.vectors import reference_can as can
from hil_tests.vectors import reference_decoder as wire
from hil_tests.vectors.reference_can import Peer, classic_bits
from st_emulator.bench.emulator import Emulator
from st_emulator.obc.listening import TelemetryListener
from st_emulator.units.profile import load_unit
from st_emulator.wire.can.wiring import CanWiring

from .conftest import SOURCE, WIDE, CanBench, make_can

TOO_SHORT, BAD_FIELDS = 1, 6
TOO_LONG = 9
LENGTHS = [*range(8, 140), *range(140, 1024, 47), 1023, 1024]
WIRINGS = {
    "classic": {},
    "29 bits": {"can_section": WIDE},
    "fd": {"can": CanWiring(fd=True)},
    "blocks of 3": {"can_section": {"block_size": 3}},
    "no padding": {"can_section": {"padding": -1}},
}


@pytest.mark.parametrize("kind", WIRINGS)
def test_packets_of_every_length(kind: str) -> None:
    bench = make_can(**WIRINGS[kind]).boot()
    for length in LENGTHS:
        bench.forget()
        bench.count += 1
        data = bytes(number * 7 & 0xFF for number in range(length))
        if length < 13:
            bench.put_packet(data)  # cannot be a packet
        else:
            packet = wire.telecommand_packet(17, 1, data[13:], bench.apid, bench.count, SOURCE)
            assert len(packet) == length
            bench.put_packet(packet)
        bench.run(30 if length < 300 else 220)
        if length < 13:
            (event,) = bench.events("TC_MALFORMED")
            assert event["length"] == length
        elif length == 13:
            assert bench.stages(bench.count) == ["acceptance_success", "completion_success"]
        else:
            assert bench.failure(bench.count) == ("acceptance_failure", BAD_FIELDS, length)
    structure = bench.can()
    assert structure["pdus_received"] == len(LENGTHS) + 2  # with the one of boot() and this one
    failed = ("receptions_failed", "frames_ignored", "transmissions_failed")
    assert [structure[name] for name in failed] == [0, 0, 0]


@pytest.mark.parametrize("length", range(1, 8))
def test_single_frames(length: int) -> None:
    bench = make_can().boot()
    bench.put_packet(bytes(range(length)))
    bench.run(20)
    assert bench.events("TC_MALFORMED") == [{"reason": TOO_SHORT, "count": 1, "length": length}]
    assert bench.peer.asked == [], "no flow control for a single frame"


def test_what_arrives_is_what_was_sent() -> None:
    bench = make_can().boot()
    data = bytes(range(256))
    for start in range(0, 1024, 256):
        load = {"memory_id": 1, "start_address": start, "data": data, "checksum": wire.crc16(data)}
        bench.send("memory_load", load, ack=0)
    bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 1024})
    bench.run(500)
    assert bench.of("memory_dump_report")[0]["data"] == data * 4


def test_a_longer_one_is_answered_by_overflow() -> None:
    bench = make_can().boot()
    bench.put_packet(bytes(1025))
    bench.run(20)
    ((_, answer),) = bench.peer.asked
    assert answer[:3] == bytes([0x32, 0, 0])
    assert bench.events("CAN_TRANSFER_FAILED") == [{"reason": TOO_LONG, "count": 1}]
    bench.peer._sending.clear()
    bench.peer._pieces.clear()
    bench.run(10)
    count = bench.send("ping")
    bench.run(20)
    assert bench.stages(count) == ["acceptance_success", "completion_success"]
    structure = bench.can()
    assert (structure["too_long"], structure["receptions_failed"]) == (1, 1)


# -- what the unit asks for, and what the OBC asks for ------------------------------------------------------

STMIN = {0: 0, 100: 0xF1, 900: 0xF9, 1000: 1, 127_000: 0x7F}


@pytest.mark.parametrize("block_size", [0, 1, 8, 255])
@pytest.mark.parametrize("separation_us", STMIN)
def test_block_size_and_separation_time_of_the_file_are_asked_for(
    block_size: int, separation_us: int
) -> None:
    section = {"block_size": block_size, "separation_time_us": separation_us, "padding": 0x99}
    bench = make_can(can_section=section).boot()
    bench.forget()
    length = 200
    bench.put_packet(bytes(length))
    bench.run(60)
    frames = -(-(length - 6) // 7)
    answers = 1 if not block_size else -(-frames // block_size)
    wanted = bytes([0x30, block_size, STMIN[separation_us]]) + b"\x99" * 5
    assert [payload for _, payload in bench.peer.asked] == [wanted] * answers
    assert len(bench.events("TC_MALFORMED")) == 1, "it came whole"


def consecutive(bench: CanBench) -> list[tuple[int, bytes]]:
    """(time, data) of the consecutive frames that the unit sent."""
    sent = [(t_ns, can.records(record)[0]) for t_ns, record in bench.groups]
    return [
        (t_ns, data) for t_ns, (number, data) in sent if number == bench.peer.telemetry and data[0] >> 4 == 2
    ]


def dump(bench: CanBench, length: int) -> None:
    bench.forget()
    bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": length}, ack=0)


@pytest.mark.parametrize("stmin", [0, 0xF1, 0xF5, 1, 9])
def test_the_obcs_separation_time_is_kept(stmin: int) -> None:
    bench = make_can(can_section={"heartbeat_ms": 0}).boot()
    bench.peer.stmin = stmin
    dump(bench, 300)
    bench.run(600)
    assert len(bench.of("memory_dump_report")) == 1
    sent = consecutive(bench)
    assert len(sent) == 47
    separation_ns = {0: 0, 0xF1: 100_000, 0xF5: 500_000, 1: 1_000_000, 9: 9_000_000}[stmin]
    for (before_ns, _), (t_ns, data) in pairwise(sent):
        # From the end of one frame to the start of the next, which is alone on the bus.
        assert t_ns - before_ns == separation_ns + classic_bits(0x58A, data) * 1000


@pytest.mark.parametrize("stmin", [0x80, 0xF0, 0xFA, 0xFF])
def test_a_reserved_separation_time_is_the_longest(stmin: int) -> None:
    bench = make_can(can_section={"heartbeat_ms": 0}).boot()
    bench.peer.stmin = stmin
    dump(bench, 20)
    bench.run(1000)
    sent = consecutive(bench)
    assert len(sent) == 7
    assert {(t_ns - before_ns) // 1_000_000 for (before_ns, _), (t_ns, _) in pairwise(sent)} == {127}


@pytest.mark.parametrize("block_size", [1, 2, 7, 255])
def test_the_obcs_block_size_is_kept(block_size: int) -> None:
    bench = make_can().boot()
    bench.peer.block_size = block_size
    dump(bench, 1024)
    bench.run(400)
    assert len(bench.of("memory_dump_report")) == 1
    frames = len(consecutive(bench))
    assert frames == -(-(1024 + 31 - 6) // 7)
    given = [payload for payload in bench.peer.said if payload[0] >> 4 == 3]
    assert len(given) == -(-frames // block_size)
    # Without the next flow control nothing comes behind a block.
    bench.peer.answers.append(bytes([0x30, block_size, 0]))
    bench.peer.deaf = True
    dump(bench, 1024)
    bench.run(800)
    assert len(consecutive(bench)) == min(block_size, frames)


@pytest.mark.parametrize("fd", [False, True])
def test_a_listener_hears_what_the_obc_receives(fd: bool) -> None:
    """Also through pauses for which the OBC asks, longer than a receiver would wait by itself."""
    bench = make_can(can=CanWiring(fd=fd))
    listener = TelemetryListener(can=bench.emulator.dialect.port.settings.identifiers, fd=fd)
    bench.run(500)
    bench.peer.stmin = 30
    bench.peer.answers.append(b"\x31\0\0")
    bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 600})
    for _ in range(3):
        bench.run(900)
        bench.peer.put(b"\x31\0\0")
    bench.peer.put(b"\x30\0\x1e")
    bench.run(6000)
    for t_ns, data in bench.groups:
        listener.transmitted(data, t_ns)
    assert len(bench.of("memory_dump_report")) == 1
    assert listener.malformed == 0
    assert [(t_ns, packet.raw) for t_ns, packet in listener.packets] == bench.peer.packets


def test_packets_cross() -> None:
    """Telecommands come in while telemetry goes out, whose frames leave room for others."""
    bench = make_can().boot()
    bench.peer.stmin = 0xF3
    dump(bench, 1024)
    bench.run(3)
    first = bench.count + 1
    for _ in range(20):
        bench.send("ping")
    bench.run(300)
    assert len(bench.of("pong")) == 20
    assert len(bench.of("memory_dump_report")) == 1
    for count in range(first, first + 20):
        assert bench.stages(count) == ["acceptance_success", "completion_success"]
    structure = bench.can()
    assert [structure[name] for name in ("receptions_failed", "transmissions_failed", "frames_ignored")] == [
        0
    ] * 3


def test_a_bus_of_can_fd_takes_classic_frames_and_the_other_way_round_does_not() -> None:
    bench = make_can(can=CanWiring(fd=True)).boot()
    assert bench.peer.frame_bytes == 64
    bench.peer.frame_bytes = 8
    count = bench.send("ping")
    bench.run(20)
    assert bench.stages(count) == ["acceptance_success", "completion_success"]
    bench = make_can().boot()
    bench.peer.frame_bytes = 64
    count = bench.send("ping")
    bench.run(20)
    assert bench.stages(count) == []
    bench.peer.frame_bytes = 8
    assert bench.can()["frames_ignored"] == 2, "the ping, and the flow control for the event that told it"


# -- several units on one bus -------------------------------------------------------------------------------

UNITS = {"roja1": 10, "zy3": 11, "science_cam": 12, "aps_rs": 13}


class Bus:
    """Units on one bus, each with its OBC: every frame of one reaches all others."""

    def __init__(self) -> None:
        self.peers = {name: Peer(0x600 + node, 0x580 + node) for name, node in UNITS.items()}
        self.sent: list[tuple[str, int, bytes]] = []
        self.emulators = {name: self._emulator(name) for name in UNITS}

    def _emulator(self, name: str) -> Emulator:
        return Emulator(
            load_unit(name), transmit=lambda data, t_ns: self.transmitted(name, data, t_ns), can=CanWiring()
        )

    def transmitted(self, sender: str, data: bytes, t_ns: int) -> None:
        self.sent.append((sender, t_ns, data))
        for peer in self.peers.values():
            peer.take(data, t_ns)

    def advance(self, until_ns: int) -> None:
        while True:
            for peer in self.peers.values():
                while peer.outbox:
                    record = peer.outbox.popleft()
                    for emulator in self.emulators.values():
                        emulator.receive(record)
            number = len(self.sent)
            due_ns = min(emulator.next_event_ns() for emulator in self.emulators.values())
            if due_ns > until_ns:
                break
            for emulator in self.emulators.values():
                emulator.advance(due_ns)
            for sender, _, data in self.sent[number:]:
                for name, emulator in self.emulators.items():
                    if name != sender:
                        emulator.receive(data)
        for emulator in self.emulators.values():
            emulator.advance(until_ns)


def test_four_units_on_one_bus_are_never_mixed() -> None:
    bus = Bus()
    bus.advance(600_000_000)
    for number, (name, peer) in enumerate(bus.peers.items()):
        apid = bus.emulators[name].profile.apid
        for count, (telecommand, fields) in enumerate(
            [
                ("memory_load", {"memory_id": 1, "start_address": 0, "data": bytes([number]) * 200,
                                 "checksum": wire.crc16(bytes([number]) * 200)}),
                ("memory_dump", {"memory_id": 1, "start_address": 0, "length": 1024}),
                ("hk_one_shot", {"structure_ids": [1, 2, 3, 4]}),
                ("function", {"function_id": 2, "arguments": {}}),
            ]
        ):  # fmt: skip
            peer.send(wire.encode_telecommand(telecommand, fields, apid, count, number, 15))
    bus.advance(4_000_000_000)
    for number, (name, peer) in enumerate(bus.peers.items()):
        profile = bus.emulators[name].profile
        assert peer.broken == 0
        packets = [wire.decode_telemetry(packet) for _, packet in peer.packets]
        assert {packet["apid"] for packet in packets} == {profile.apid}
        assert [packet["sequence_count"] for packet in packets] == list(range(len(packets)))
        names = [packet["name"] for packet in packets]
        assert names.count("completion_success") == 4
        (dump,) = [packet["fields"] for packet in packets if packet["name"] == "memory_dump_report"]
        assert dump["data"] == bytes([number]) * 200 + bytes(824)
        reports = [packet["fields"] for packet in packets if packet["name"] == "attitude_report"]
        indices = [report["frame_index"] for report in reports]
        assert indices == list(range(indices[0], indices[0] + len(indices)))
        assert len(reports) >= 5
        # Its cyclic frames, as any of the OBCs saw them.
        for other in bus.peers.values():
            node = UNITS[name]
            counters = [data[0] for _, identifier, data in other.frames if identifier == 0x180 + node]
            assert counters == [index & 0xFF for index in indices]
        structure = bus.emulators[name].dialect.cyclic.housekeeping()
        assert structure["pdus_received"] == 4
        assert structure["pdus_sent"] == len(packets)
        for counter in ("frames_ignored", "receptions_failed", "transmissions_failed", "syncs_ignored"):
            assert structure[counter] == 0
        others = sum(sender != name for sender, _, _ in bus.sent)
        assert structure["rx_frames"] > others, "it received them all, and the frames of the OBCs"
