"""Time on the bus: its load, what a flood of more urgent frames costs, how fast an image comes down."""

from typing import Any

import pytest

from hil_tests.vectors import reference_can as can
from hil_tests.vectors import reference_decoder as wire
from hil_tests.vectors.reference_can import classic_bits, record
from st_emulator.wire.can.wiring import CanWiring

from .conftest import MS, WIDE, CanBench, make_can

SECOND_NS = 10**9
EXTENDED = 0x8000_0000


def bits_of(data: bytes) -> int:
    """Of a record of one classic frame."""
    word = int.from_bytes(data[:4], "big")
    return classic_bits(word & 0x1FFF_FFFF, data[8:], extended=bool(word & EXTENDED))


class Recording:
    """Every record that goes onto the bus, from either side, by the bench's own hand."""

    def __init__(self, bench: CanBench) -> None:
        self.records: list[bytes] = []
        emulator = bench.emulator
        receive, transmit = emulator.receive, emulator._external_transmit

        def received(data: bytes) -> None:
            self.records.append(data)
            receive(data)

        def transmitted(data: bytes, t_ns: int) -> int | None:
            self.records.append(data)
            return transmit(data, t_ns)

        emulator.receive = received
        emulator._external_transmit = transmitted

    def bits(self) -> int:
        return sum(bits_of(data) for data in self.records)


@pytest.mark.parametrize("section", [{}, WIDE, {"bitrate": 125_000}, {"padding": 0}], ids=str)
def test_bus_load_is_the_sum_of_the_frames(section: dict[str, Any]) -> None:
    bitrate = section.get("bitrate", 1_000_000)
    bench = make_can(can_section=section).boot()
    bench.to_mode("TRACKING")
    bench.run_to(1998)
    assert bench.emulator.dialect.port.bus.queued_frames == 0
    recording = Recording(bench)
    for _ in range(9):
        bench.run(60)
        bench.send("hk_one_shot", {"structure_ids": [1, 2, 3, 4]})
        bench.put(record(0x123, bytes(8)))
        bench.put(record(0x7FF, b"\xff" * 5))
    bench.run_to(2998)
    assert bench.emulator.dialect.port.bus.queued_frames == 0
    bits = recording.bits()
    bench.run_to(3001)
    wanted = (bits * SECOND_NS // bitrate * 1000 + SECOND_NS // 2) // SECOND_NS
    assert 40 < wanted < 1000
    assert bench.can()["bus_load"] == wanted
    bench.run_to(4001)
    assert bench.can()["bus_load"] < wanted, "that of the last second alone"


def test_an_idle_bus_has_none_and_a_busy_one_a_full_load() -> None:
    bench = make_can(can_section={"heartbeat_ms": 0}).boot()
    bench.run_to(2500)
    assert bench.can()["bus_load"] == 0
    for _ in range(3):
        for _ in range(9500):
            bench.put(record(0x001, b"\0"))
        bench.run(1000)
    bench.put(b"")
    assert bench.emulator.dialect.port.bus.load_permille == pytest.approx(
        9500 * bits_of(record(1, b"\0")) / 1000, abs=3
    )


# -- arbitration --------------------------------------------------------------------------------------------


def dump_ends_ns(flood: list[bytes], at_ms: float = 8) -> tuple[int, int, CanBench]:
    """When the dump that begins at 2.0 s is received, with ``flood`` put onto the bus ``at_ms`` later."""
    bench = make_can(can_section={"heartbeat_ms": 0}).boot()
    bench.run_to(2000)
    bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 1024}, ack=0)
    bench.run(at_ms)
    lost = bench.emulator.dialect.port.bus.counters.arbitration_lost
    for data in flood:
        bench.put(data)
    bench.run(1000)
    (packet,) = [item for item in bench.packets if item.name == "memory_dump_report"]
    return packet.t_ns, bench.emulator.dialect.port.bus.counters.arbitration_lost - lost, bench


FLOODS = {
    "urgent": ([record(0x000, bytes([n, 0, 0xFF])) for n in range(100)], True),
    "extended": ([record(0x0AAAAAAA, b"\0" * 8, extended=True) for _ in range(40)], True),
    "just more urgent": ([record(0x589, bytes(8))] * 300, True),
    "just less urgent": ([record(0x58B, bytes(8))] * 300, False),
}


@pytest.mark.parametrize("kind", FLOODS)
def test_a_transfer_is_delayed_by_the_more_urgent_frames(kind: str) -> None:
    flood, delays = FLOODS[kind]
    alone_ns, _, _ = dump_ends_ns([])
    ends_ns, lost, bench = dump_ends_ns(flood)
    delay_ns = sum(bits_of(data) for data in flood) * 1000 if delays else 0
    assert ends_ns - alone_ns == delay_ns
    assert lost == (len(flood) if delays else 0), "each of them won over the frame that waited"
    assert bench.can()["arbitration_lost"] >= lost
    assert bench.emulator.dialect.receiver.counters.tc_accepted == 3, "with the one of boot() and can()"


def test_a_flood_for_seconds_ends_the_transfer_and_the_unit_recovers() -> None:
    """Longer than N_As: the packet is lost, heartbeats are replaced, all goes on behind it."""
    bench = make_can(can_section={"heartbeat_ms": 100}).boot()
    bench.run_to(2050)
    bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 1024}, ack=0)
    bench.run(8)
    bench.forget()
    urgent = record(0x000, bytes(8))
    number = 2_000_000_000 // (bits_of(urgent) * 1000)
    for _ in range(number):
        bench.put(urgent)
    bench.run(1900)
    assert len(bench.groups) <= 1
    bench.run(400)
    structure = bench.can()
    assert structure["timeouts_a"] == 1
    assert structure["cyclic_overruns"] in (18, 19)
    assert bench.of("memory_dump_report") == []
    assert bench.events("CAN_PACKETS_LOST") == [{"reason": 1, "packets": 1}]
    assert structure["rx_frames"] > number


# -- an image -----------------------------------------------------------------------------------------------

IMAGE_BYTES = 23 + 2 * 752 * 480
PART_BYTES = 4095 - 22 - 4


def downloaded(busy: bool, parts: int = 0, **arguments: Any) -> tuple[CanBench, float, dict[str, float]]:
    """The bench, the seconds from the first to the last frame of the image, and figures of the bus."""
    section = {} if busy else {"heartbeat_ms": 0}
    bench = make_can(can_section=section, **arguments).boot()
    bench.function("CAPTURE_IMAGE", ack=0)
    bench.run(500)
    if busy:
        bench.to_mode("TRACKING")
        bench.send(
            "hk_set_interval",
            {"intervals": [{"structure_id": n, "interval_ms": 1000} for n in (1, 2, 3, 4)]},
            ack=0,
        )
        bench.send("hk_enable", {"structure_ids": [1, 2, 3, 4]}, ack=0)
        bench.run(50)
    bench.forget()
    start_ns = bench.emulator.now_ns
    arguments = {"transaction_id": 1, "first_part": 0, "parts": parts}
    count = bench.function("DOWNLOAD_IMAGE", arguments, ack=1)
    bench.run_until(lambda: "completion_success" in bench.stages(count), 20_000)
    image = [packet for packet in bench.packets if packet.name.startswith("image_")]
    seconds = (image[-1].t_ns - start_ns) / 1e9
    return bench, seconds, {"bytes": sum(len(packet.fields["data"]) for packet in image)}


def test_an_image_uses_the_bus() -> None:
    """Alone: over 90 % even of frames without a single stuff bit, over 98 % of those with theirs."""
    bench, seconds, figures = downloaded(busy=False)
    data = b"".join(packet.fields["data"] for packet in bench.packets if packet.name.startswith("image_"))
    assert len(data) == IMAGE_BYTES
    assert wire.decode_image_header(data[:23])["crc"] == wire.crc16(data[23:])
    assert data == bench.emulator.dialect.image.data
    share, of_unstuffed = shares(bench, figures["bytes"] / seconds)
    print(f"image: {figures['bytes'] / seconds:.0f} byte/s, {share:.3f}, unstuffed {of_unstuffed:.3f}")
    assert share > 0.98
    assert of_unstuffed > 0.9


def shares(bench: CanBench, rate: float) -> tuple[float, float]:
    """``rate`` (byte/s) of what full consecutive frames back to back carry: with the stuff bits of those that
    were sent, and without any.
    """
    sent = [(number, data) for _, group in bench.groups for number, data in can.records(group)]
    full = [data for number, data in sent if number == 0x58A and data[0] >> 4 == 2][::37]
    mean_bits = sum(classic_bits(0x58A, data) for data in full) / len(full)
    return rate / (7e6 / mean_bits), rate / (7e6 / 111)


def test_an_image_with_attitudes_and_housekeeping_going_on() -> None:
    bench, seconds, figures = downloaded(busy=True, parts=60)
    share, _ = shares(bench, figures["bytes"] / seconds)
    print(f"image beside attitudes and housekeeping: {figures['bytes'] / seconds:.0f} byte/s, {share:.3f}")
    assert share > 0.9
    reports = bench.of("attitude_report")
    indices = [report["frame_index"] for report in reports]
    assert indices == list(range(indices[0], indices[0] + len(indices)))
    assert len(indices) >= seconds * 4 - 2
    assert all(report["valid"] for report in reports)
    assert len(bench.frames("attitude_1")) == len(bench.frames("attitude_2")) >= len(indices)
    assert {report["structure_id"] for report in bench.of("hk_report")} == {1, 2, 3, 4}
    # No report waits for more than the part that is under way, one that is queued and its own frames.
    for packet in bench.packets:
        if packet.name == "attitude_report":
            coarse, fine = packet.decoded["time"]
            assert packet.t_ns - (coarse * 1e9 + fine * 1e9 / 2**24) < 3 * PART_BYTES / 7 * 0.135 * MS
    assert [packet.decoded["sequence_count"] for packet in bench.packets] == list(
        range(bench.packets[0].decoded["sequence_count"], bench.packets[-1].decoded["sequence_count"] + 1)
    )


def test_the_attitude_frames_do_not_wait_for_the_image() -> None:
    """They win the bus behind the frame that is on it."""
    bench, _, _ = downloaded(busy=True, parts=40)
    done = {
        packet.fields["frame_index"] & 0xFF: packet.decoded["time"]
        for packet in bench.packets
        if packet.name == "attitude_report"
    }
    assert len(done) >= 8
    for t_ns, values in bench.frames("attitude_1"):
        if values["counter"] in done:
            coarse, fine = done[values["counter"]]
            assert t_ns - (coarse * 1e9 + fine * 1e9 / 2**24) < 2 * 135_000


def test_can_fd_is_several_times_as_fast() -> None:
    _, seconds, figures = downloaded(busy=False, parts=40, can=CanWiring(fd=True))
    rate = figures["bytes"] / seconds
    print(f"image in CAN FD, 1 and 4 Mbit/s: {rate:.0f} byte/s")
    assert rate > 4 * 7e6 / 111
