"""The same session on the serial line and on a CAN bus: the same telemetry, nothing lost on either."""

import io
import json
from typing import Any

import pytest

from hil_tests.vectors import reference_decoder as wire
from hil_tests.vectors.received import EVENT
from st_emulator.bench.scenario import parse_scenario
from st_emulator.protocol.pus.registry import REGISTRY
from st_emulator.wire.can.wiring import CanWiring

from .conftest import FUNCTION, WIDE, Bench, CanBench, make, make_can
from .test_verification import EXAMPLES

Q = {"q_x": 0.0, "q_y": 0.0, "q_z": 0.0, "q_w": 1.0}
PATCH = bytes(range(256))
IMAGE_BYTES = 23 + 2 * 752 * 480
DOWNLOAD = "DOWNLOAD_IMAGE"
#: (at ms, telecommand, its fields): clear of each other and of the frames, so that what follows from them
#: does not depend on how long they take on their wire.
SESSION: list[tuple[int, str, dict[str, Any]]] = [
    (560, "ping", {}),
    (620, "function START_SELF_TEST", {}),
    (1330, "set_time", {"time": (2_000_000_000, 1 << 20)}),
    (1560, "hk_set_interval", {"intervals": [{"structure_id": 1, "interval_ms": 700}]}),
    (1580, "hk_one_shot", {"structure_ids": [1, 3]}),
    (1600, "hk_disable", {"structure_ids": [1]}),
    (1680, "memory_load", {"memory_id": 1, "start_address": 9, "data": PATCH, "checksum": wire.crc16(PATCH)}),
    (1730, "memory_dump", {"memory_id": 1, "start_address": 9, "length": len(PATCH)}),
    (1830, "memory_check", {"memory_id": 1, "start_address": 0, "length": 2000}),
    (1850, "parameter_set", {"settings": [{"parameter_id": 1, "value": 80_000}]}),
    (1870, "parameter_report", {"parameter_ids": list(range(1, 21))}),
    (1890, "event_disable", {"event_ids": [EVENT["ATTITUDE_ACQUIRED"], EVENT["IMAGE_CAPTURED"]]}),
    (1910, "event_report_disabled", {}),
    (1930, "function START_ACQUISITION", {}),
    (3930, "function GO_STANDBY", {}),
    (4060, "function TRACK_FROM", Q),
    (4930, "function TRACK_FROM", {**Q, "q_w": 3.0}),
    (4960, "function START_ACQUISITION", {}),
    (5930, "time_report_rate", {"rate_exponent": 1}),
    (6180, "function CAPTURE_IMAGE", {}),
    (6680, f"function {DOWNLOAD}", {"transaction_id": 3, "first_part": 1}),
    (8680, "function SHUTDOWN", {}),
]
END_MS = 9000
#: 60 parts of 1024 bytes are 15 of 4069 and some more.
PARTS = {"serial": 60, "can": 15}


def run(kind: str, **arguments: Any) -> Bench:
    if kind == "serial":
        bench = make(wire={"baud": 1_000_000}, **arguments)
    else:
        bench = make(can=arguments.pop("can", CanWiring()), **arguments)
    for at_ms, name, fields in SESSION:
        bench.run_to(at_ms)
        telecommand, _, function = name.partition(" ")
        if not function:
            bench.send(telecommand, fields)
            continue
        parts = {"parts": PARTS["serial" if kind == "serial" else "can"]} if function == DOWNLOAD else {}
        bench.function(function, fields | parts)
    bench.run_to(END_MS)
    return bench


@pytest.fixture(scope="module")
def serial() -> Bench:
    return run("serial")


WIRINGS = {"classic": ({}, {}), "fd": ({"fd": True}, {}), "29 bits": ({}, WIDE)}


@pytest.fixture(scope="module", params=WIRINGS)
def bus(request: Any) -> CanBench:
    wiring, section = WIRINGS[request.param]
    bench = run("can", can=CanWiring(**wiring), can_section=section)
    assert isinstance(bench, CanBench)
    return bench


def image_of(bench: Bench) -> bytes:
    parts = [packet for packet in bench.packets if packet.name.startswith("image_")]
    assert [packet.fields["part_number"] for packet in parts] == list(range(1, len(parts) + 1))
    return b"".join(packet.fields["data"] for packet in parts)


#: What depends on how long a telecommand took on its wire: the time that set_time has set, when it was
#: executed.
OF_THE_WIRE = {"time", "mid_exposure_time", "old", "new", "uptime_ms"}
#: What the work of the link weighs in: SLIP has more bytes than the packets, and a packet may be taken in
#: a frame earlier or later.
OF_THE_LINK_CYCLES = {"cycles", "cycles_total", "cycles_telemetry", "cycles_memory", "worst_cycles"}
OF_THE_LINK_US = {"latency_us", "margin_us"}
LINK_CYCLES = 4_000_000  # a download at 4 Mbit/s: 60 kB a frame, some 50 cycles a byte


def content(packet: dict[str, Any]) -> Any:
    def without(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: of_a_link(name, item) for name, item in value.items() if name not in OF_THE_WIRE}
        return pytest.approx(value, rel=1e-6, abs=1e-9) if isinstance(value, float) else value

    def of_a_link(name: str, value: Any) -> Any:
        if name in OF_THE_LINK_CYCLES:
            return pytest.approx(value, abs=LINK_CYCLES)
        if name in OF_THE_LINK_US:
            return pytest.approx(value, abs=LINK_CYCLES / 400)
        return without(value)

    return packet["name"], packet["destination_id"], packet["time_status"], without(packet["fields"])


def times_of(value: Any) -> list[float]:
    if not isinstance(value, dict):
        return []
    found = [
        item / 1000 if name == "uptime_ms" else item[0] + item[1] / 2**24
        for name, item in value.items()
        if name in OF_THE_WIRE
    ]
    return found + [time for item in value.values() for time in times_of(item)]


def test_the_same_telemetry_in_the_same_order(serial: Bench, bus: CanBench) -> None:
    download = [name for _, name, _ in SESSION].index(f"function {DOWNLOAD}")

    def split(bench: Bench) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        """What the download sends comes at the rate of its wire, in between all else."""
        of_download = {id(packet) for packet in bench.reports(download)}
        wanted = [packet for packet in bench.packets if not packet.name.startswith("image_")]
        return (
            [packet.decoded for packet in wanted if id(packet) not in of_download],
            [packet.decoded for packet in wanted if id(packet) in of_download],
        )

    for ours, theirs in zip(split(bus), split(serial), strict=True):
        assert [packet["name"] for packet in ours] == [packet["name"] for packet in theirs]
        for one, other in zip(ours, theirs, strict=True):
            assert content(one) == content(other)
            # A set_time came a little earlier or later, and is in force from the same frame on.
            assert times_of(one["fields"]) == pytest.approx(times_of(other["fields"]), abs=2e-3)
    assert [len(part) for part in split(bus)] == [len(split(serial)[0]), 12]
    assert len(split(bus)[0]) > 100


def test_it_was_a_whole_session(serial: Bench, bus: CanBench) -> None:
    for bench in (serial, bus):
        for name in ("BOOT_COMPLETED", "SELF_TEST_COMPLETED", "TIME_SET", "PARAMETERS_STORED"):
            assert len(bench.events(name)) == 1, name
        assert bench.events("ATTITUDE_ACQUIRED") == bench.events("IMAGE_CAPTURED") == []
        assert bench.of("memory_dump_report")[0]["data"] == PATCH
        assert len(bench.of("pong")) == 1
        assert sum(fields["valid"] for fields in bench.of("attitude_report")) > 20
        assert len(bench.of("hk_report")) == 3
        assert len(bench.of("completion_success")) == len(SESSION) - 2
        assert [fields["failure_code"] for fields in bench.of("acceptance_failure")] == [8]
        assert [fields["failure_code"] for fields in bench.of("completion_failure")] == [15]
        assert bench.emulator.device.mode == 6
        assert bench.packets[-1].name == "completion_success"


def test_the_same_image(serial: Bench, bus: CanBench) -> None:
    ours, theirs = image_of(bus), image_of(serial)
    assert len(theirs) == PARTS["serial"] * 1024
    assert len(ours) == PARTS["can"] * 4069 > len(theirs) - 1024
    length = min(len(ours), len(theirs))
    assert ours[:23] != theirs[:23]  # the time of mid-exposure, see above
    assert ours[23:length] == theirs[23:length]
    assert wire.decode_image_header(ours[:23])["crc"] == wire.decode_image_header(theirs[:23])["crc"]
    assert len(bus.emulator.dialect.image.data) == IMAGE_BYTES


def test_nothing_lost(serial: Bench, bus: CanBench) -> None:
    for bench in (serial, bus):
        assert [packet.decoded["sequence_count"] for packet in bench.packets] == list(
            range(len(bench.packets))
        )
        kinds: dict[tuple[int, int], int] = {}
        for packet in bench.packets:
            kind = packet.decoded["service"], packet.decoded["subservice"]
            assert packet.decoded["message_count"] == kinds.get(kind, 0)
            kinds[kind] = kinds.get(kind, 0) + 1
    peer, counters = bus.peer, bus.emulator.dialect.cyclic.housekeeping()
    assert peer.broken == 0
    assert not peer.outbox
    assert counters["pdus_sent"] == len(bus.packets) == len(peer.packets)
    assert counters["pdus_received"] == len(SESSION)
    assert counters["tx_frames"] == len(bus.groups)
    lost = ("transmissions_failed", "receptions_failed", "frames_ignored", "error_frames", "tx_refused")
    assert [counters[name] for name in lost] == [0] * len(lost)
    assert counters["cyclic_overruns"] == 0


def test_every_telecommand_of_the_registry() -> None:
    names = {definition.name for definition in REGISTRY.telecommands()}
    assert {telecommand for telecommand, _ in EXAMPLES.values()} == names
    assert {name.split()[1] for name in EXAMPLES if name.startswith("function")} == set(FUNCTION)
    bench = make_can().boot()
    last = ["function CAPTURE_IMAGE", "function DOWNLOAD_IMAGE", "function RESET", "function SHUTDOWN"]
    for name in [name for name in EXAMPLES if name not in last] + last:
        telecommand, fields = EXAMPLES[name]
        if name in ("memory_load", "function START_SELF_TEST"):  # in STANDBY alone
            bench.function("GO_STANDBY", ack=0)
            bench.run(10)
        if name == "function DOWNLOAD_IMAGE":
            fields = {**fields, "arguments": {**fields["arguments"], "parts": 3}}
        count = bench.send(telecommand, fields)
        bench.run(1300)
        stages = bench.stages(count)
        assert stages[0] == "acceptance_success", name
        if name == "function RESET":
            assert stages[-1] == "start_success"
            assert len(bench.events("BOOT_COMPLETED")) == 1
        else:
            assert stages[-1] == "completion_success", name
    assert bench.emulator.device.mode == 6


SCENARIO = """
schema = 1
name = "on a bus"
[[telecommands]]
at_s = 0.5
name = "ping"
fields = {}
[[telecommands]]
at_s = 0.6
raw_hex = "c0deadbeefc0c0"
[[telecommands]]
at_s = 0.1
name = "ping"
fields = {}
"""


def test_scenario_telecommands_come_in_by_the_transport_like_any_other() -> None:
    journal = io.StringIO()
    bench = make_can(scenario=parse_scenario(SCENARIO, "on a bus"), journal=journal)
    bench.run_to(499.9)
    assert bench.of("pong") == []
    bench.run_to(599.9)
    assert len(bench.of("pong")) == 1, "the other one came in BOOT and was lost"
    answers = [packet for packet in bench.packets if packet.name in ("pong", "completion_success")]
    assert {packet.decoded["destination_id"] for packet in answers} == {0x5C}
    bench.run_to(700)
    assert bench.events("TC_MALFORMED") == [{"reason": 1, "count": 1, "length": 4}]
    lines = [json.loads(line) for line in journal.getvalue().splitlines()[1:]]
    received = [(line["t_ns"], bytes.fromhex(line["rx"])) for line in lines if "rx" in line]
    begun = [t_ns for t_ns, frame in received if frame[:4] == b"\0\0\6\x0a" and frame[8] >> 4 in (0, 1)]
    assert begun == [100e6, 500e6, 600e6], "at their times, whether the one before was answered or not"
    assert any(bytes.fromhex("04deadbeef") in frame for _, frame in received)
    assert bench.peer.asked, "the unit's flow control for a telecommand of several frames"
    assert bench.can()["pdus_received"] == 3, "the ping, the four octets, the request for this structure"
