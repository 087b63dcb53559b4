"""Errors on the bus as the unit tells them: error passive, bus-off and recovery, a queue that is full."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest

from hil_tests.vectors.reference_can import error_record, record
from st_emulator.protocol.can.frames import CanFrame
from st_emulator.wire.can.bus import BusError
from st_emulator.wire.can.wiring import CanWiring

from .conftest import MS, CanBench, make, make_can

ACTIVE, PASSIVE, OFF = 0, 1, 2
RECOVERY_NS = 100 * MS + 128 * 11 * 1000  # [can] bus_off_restart_ms, and at 1 Mbit/s 128 times 11 bits


class Fault:
    """Destroys the next ``number`` attempts that ``which`` picks."""

    def __init__(self) -> None:
        self.number = 0
        self.error = BusError.BIT
        self.which: Callable[[CanFrame, bool], bool] = lambda frame, own: own
        self.struck: list[tuple[int, int]] = []  # (time, identifier)

    def strike(
        self, number: int, error: BusError, which: Callable[[CanFrame, bool], bool] = lambda frame, own: own
    ) -> None:
        self.number, self.error, self.which = number, error, which

    def __call__(self, frame: CanFrame, own: bool, now_ns: int) -> BusError | None:
        if not self.number or not self.which(frame, own):
            return None
        self.number -= 1
        self.struck.append((now_ns, frame.identifier))
        return self.error


def faulty(**arguments: Any) -> tuple[CanBench, Fault]:
    fault = Fault()
    bench = make_can(disturbance=fault, **arguments).boot()
    bench.run_to(1010)
    bench.forget()
    return bench, fault


def counts(bench: CanBench) -> tuple[int, int, int]:
    """State, transmit and receive error counter."""
    structure = bench.emulator.dialect.cyclic.housekeeping()
    return tuple(structure[name] for name in ("can_state", "transmit_error_count", "receive_error_count"))


@pytest.mark.parametrize("error", [BusError.BIT, BusError.FORM, BusError.CRC, BusError.ACK])
def test_destroyed_frames_are_sent_again_and_nothing_is_lost(error: BusError) -> None:
    bench, fault = faulty()
    fault.strike(15, error)
    bench.send("ping")
    bench.run(20)
    assert [packet.name for packet in bench.packets] == ["acceptance_success", "pong", "completion_success"]
    state, transmit, receive = counts(bench)
    assert (state, receive) == (ACTIVE, 0)
    assert 0 < transmit < 15 * 8, "each good frame takes one back"
    structure = bench.can()
    assert structure["error_frames"] == 15
    assert structure["transmissions_failed"] == structure["receptions_failed"] == 0
    assert bench.events("CAN_ERROR_PASSIVE_ENTERED") == []


def test_error_passive_is_told_with_its_counters() -> None:
    bench, fault = faulty(can_section={"heartbeat_ms": 0})
    fault.strike(16, BusError.CRC)
    bench.send("ping", ack=0)
    bench.run(20)
    assert bench.events("CAN_ERROR_PASSIVE_ENTERED") == [{"transmit_errors": 128, "receive_errors": 0}]
    assert [packet.name for packet in bench.packets] == ["event_low", "pong"]
    state, transmit, _ = counts(bench)
    assert (state, transmit) == (ACTIVE, 128 - len(bench.groups))


def test_errors_in_frames_of_others_lead_there_too() -> None:
    bench, fault = faulty(can_section={"heartbeat_ms": 0})
    fault.strike(130, BusError.CRC, lambda frame, own: not own)
    bench.send("ping", ack=0)
    bench.run(40)
    (event,) = bench.events("CAN_ERROR_PASSIVE_ENTERED")
    assert event == {"transmit_errors": 0, "receive_errors": 128}
    assert len(bench.of("pong")) == 1, "received once, though its first frame was repeated"
    structure = bench.can()
    assert structure["error_frames"] == 130
    assert structure["can_state"] == ACTIVE
    assert structure["pdus_received"] == 3


def test_bus_off_and_recovery() -> None:
    bench, fault = faulty(can_section={"heartbeat_ms": 50})
    since = bench.emulator.dialect.transmitter._sequence_count
    fault.strike(32, BusError.BIT)
    bench.send("ping")
    bench.run(30)
    assert counts(bench)[0] == OFF
    assert fault.number == 0
    off_ns = fault.struck[-1][0]
    bench.run(70)
    assert bench.groups == [], "nothing leaves in bus-off"
    assert bench.peer.packets == []
    bench.run(400)
    first_ns = bench.groups[0][0]
    assert 0 <= first_ns - off_ns - RECOVERY_NS < MS
    assert bench.events("CAN_ERROR_PASSIVE_ENTERED") == [{"transmit_errors": 128, "receive_errors": 0}]
    assert bench.events("CAN_BUS_OFF_RECOVERED") == [{"duration_ms": RECOVERY_NS // MS, "count": 1}]
    names = [packet.name for packet in bench.packets]
    assert sorted(names) == sorted(
        ["acceptance_success", "pong", "completion_success", "event_low", "event_medium"]
    ), "the packets of before are there"
    assert [packet.decoded["sequence_count"] for packet in bench.packets] == list(range(since, since + 5))
    beats = bench.frames("heartbeat")
    assert len(beats) >= 6
    assert beats[0][1]["can_state"] == OFF, "of before the recovery, the newest"
    assert {values["can_state"] for _, values in beats[1:]} == {ACTIVE}
    structure = bench.can()
    assert (structure["bus_off_count"], structure["error_frames"]) == (1, 32)
    assert structure["cyclic_overruns"] == 1, "the heartbeat of 1100 ms took the place of that of 1050"
    assert structure["transmissions_failed"] == 0


@pytest.mark.parametrize(("bitrate", "restart_ms"), [(1_000_000, 0), (1_000_000, 400), (125_000, 20)])
def test_the_duration_follows_the_file(bitrate: int, restart_ms: int) -> None:
    bench, fault = faulty(can_section={"bitrate": bitrate, "bus_off_restart_ms": restart_ms})
    fault.strike(32, BusError.FORM)
    bench.send("ping")
    bench.run(1500)
    duration_ms = restart_ms + 128 * 11 * 1000 // bitrate
    assert bench.events("CAN_BUS_OFF_RECOVERED") == [{"duration_ms": duration_ms, "count": 1}]


def test_a_bus_that_stays_broken_for_seconds() -> None:
    """Bus-off again and again: old packets are lost, heartbeats replaced, all in bounds."""
    bench, fault = faulty(can_section={"heartbeat_ms": 50})
    bench.send("hk_enable", {"structure_ids": [1]}, ack=0)
    bench.run(1500)
    since = bench.packets[-1].decoded["sequence_count"]
    bench.forget()
    fault.strike(1_000_000, BusError.BIT)
    port, clock = bench.emulator.dialect.port, bench.emulator.clock
    for _ in range(50):
        bench.run(100)
        assert port.bus.queued_frames <= 3
        assert len(clock._queue) < 60
    assert bench.groups == []
    fault.number = 0
    bench.run(1300)
    (event,) = bench.events("CAN_PACKETS_LOST")
    sequence = [packet.decoded["sequence_count"] for packet in bench.packets]
    assert event == {"reason": 1, "packets": sequence[-1] - since - len(sequence)}
    assert event["packets"] > 3 + 45, "housekeeping and an event of each bus-off"
    structure = bench.can()
    assert structure["timeouts_a"] == structure["transmissions_failed"] > 0
    assert structure["bus_off_count"] > 40
    beats = bench.frames("heartbeat")
    assert {later[1]["counter"] - earlier[1]["counter"] for earlier, later in pairwise(beats)} == {1}
    assert structure["cyclic_overruns"] >= 95


def test_nobody_acknowledges() -> None:
    """Alone on the bus: error passive, never bus-off, and the unit goes on when somebody is there again."""
    bench, fault = faulty(can_section={"heartbeat_ms": 100})
    bench.send("hk_enable", {"structure_ids": [1]}, ack=0)
    bench.run(1500)
    fault.strike(1_000_000, BusError.ACK)
    bench.run(3000)
    assert counts(bench) == (PASSIVE, 128, 0)
    load = bench.emulator.dialect.port.bus.load_permille
    assert 930 < load < 960, "it tries again and again, with a pause of 8 bits each time"
    fault.number = 0
    bench.forget()
    bench.run(1500)
    assert len(bench.events("CAN_PACKETS_LOST")) == 1
    assert bench.events("CAN_BUS_OFF_RECOVERED") == []
    assert counts(bench)[0] == ACTIVE
    assert len(bench.frames("heartbeat")) in (15, 16)
    assert bench.can()["bus_off_count"] == 0


def test_a_frame_given_up_while_it_is_on_the_wire() -> None:
    """N_As ends in the middle of a destroyed attempt: the frame does not come up again."""
    bench, fault = faulty(can_section={"heartbeat_ms": 0, "timeout_ms": 10})
    fault.strike(1_000_000, BusError.ACK, lambda frame, own: own and frame.data[0] >> 4 == 1)
    bench.send("ping")
    bench.run(200)
    fault.number = 0
    bench.run(100)
    assert bench.packets == []
    assert bench.groups[1:] == [], "the flow control for the telecommand alone"
    bench.forget()
    bench.send("ping", ack=0)
    bench.run(20)
    assert [packet.name for packet in bench.packets] == ["pong", "event_low"]
    (event,) = bench.events("CAN_PACKETS_LOST")
    assert event == {"reason": 1, "packets": 4}, "three of the ping, and error passive"


# -- what the driver of a real controller says --------------------------------------------------------------

HARDWARE = CanWiring(hardware=True)
BUS_OFF, RESTARTED, CONTROLLER, COUNTERS, LOST = 0x40, 0x100, 0x04, 0x200, 0x02


def test_a_session_on_hardware() -> None:
    bench = make_can(can=HARDWARE).boot()
    bench.to_mode("TRACKING")
    bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 900})
    bench.run(500)
    assert len(bench.of("memory_dump_report")) == 1
    assert any(fields["valid"] for fields in bench.of("attitude_report"))
    structure = bench.can()
    assert structure["tx_frames"] > 150
    assert structure["transmissions_failed"] == structure["frames_ignored"] == 0


def test_sync_on_hardware_is_latched_when_it_is_read() -> None:
    bench = make_can(can=HARDWARE).boot()
    bench.put_frame("sync", b"\x01")
    now_ns = bench.emulator.now_ns
    bench.run(5)
    ((_, values),) = bench.frames("sync_time")
    assert values["seconds"] * 2**24 + values["fraction"] * 2**24 == now_ns * 2**24 // 10**9


def test_states_and_counters_are_the_drivers() -> None:
    bench = make_can(can=HARDWARE, can_section={"heartbeat_ms": 0}).boot()
    bench.put(error_record(CONTROLLER | COUNTERS, bytes([0, 0x20, 0, 0, 0, 0, 135, 7])))
    bench.run(5)
    assert counts(bench) == (PASSIVE, 135, 7)
    assert bench.events("CAN_ERROR_PASSIVE_ENTERED") == [{"transmit_errors": 135, "receive_errors": 7}]
    bench.put(error_record(CONTROLLER | COUNTERS, bytes([0, 0x40, 0, 0, 0, 0, 90, 3])))
    assert counts(bench) == (ACTIVE, 90, 3)
    bench.put(error_record(CONTROLLER, bytes([0, 0x10, 0, 0, 0, 0, 0, 0])))
    bench.run(5)
    assert counts(bench) == (PASSIVE, 90, 128)
    bench.put(error_record(LOST, bytes([0x0B, 0, 0, 0, 0, 0, 0, 0])))
    structure = bench.can()
    assert structure["arbitration_lost"] == 1
    assert structure["error_frames"] == 4


def test_bus_off_on_hardware_lasts_until_the_driver_says_so() -> None:
    bench = make_can(can=HARDWARE, can_section={"heartbeat_ms": 100}).boot()
    bench.run_to(1010)
    bench.forget()
    bench.put(error_record(BUS_OFF))
    bench.run(700)
    assert counts(bench)[0] == OFF
    assert bench.groups == []
    bench.put(error_record(RESTARTED))
    bench.run(300)
    assert bench.events("CAN_BUS_OFF_RECOVERED") == [{"duration_ms": 700, "count": 1}]
    assert bench.frames("heartbeat")[0][1]["can_state"] == OFF
    assert bench.frames("heartbeat")[1][1]["can_state"] == ACTIVE
    assert bench.can()["cyclic_overruns"] == 6


def test_counters_go_back_to_0() -> None:
    bench, fault = faulty()
    fault.strike(3, BusError.CRC)
    bench.put(record(0x60A, b"\x40\0\0\0\0\0\0\0"))
    bench.put(record(0x60A, b"\x00\0\0\0\0\0\0\0"))
    bench.put(record(0x100, b"\0"))
    bench.put(record(0x080, b"\0"))
    bench.run(30)
    before = bench.can()
    for name in ("error_frames", "frames_ignored", "bad_length", "syncs", "syncs_ignored", "rx_frames"):
        assert before[name] > 0, name
    bench.function("CLEAR_COUNTERS", ack=0)
    bench.run(20)
    after = bench.can()
    zero = ("error_frames", "frames_ignored", "bad_length", "syncs", "syncs_ignored", "pdus_sent")
    assert [after[name] for name in zero] == [0] * len(zero)
    # What came since: the telecommand for this structure, of a first frame and two more.
    assert (after["pdus_received"], after["rx_frames"], after["tx_frames"]) == (1, 3, 1)


# -- a full transmit queue ----------------------------------------------------------------------------------


@pytest.mark.parametrize("bus", [True, False], ids=["CAN", "serial line"])
def test_a_full_queue_loses_packets_and_tells_how_many(bus: bool) -> None:
    """As on the serial line: reports of service 1 and events find room in the reserve."""
    if bus:
        bench = make_can(can_section={"heartbeat_ms": 0}).boot()
        bench.peer.stmin = 2  # 7 bytes each 2.1 ms
    else:
        bench = make().boot()
    bench.run_to(1010)
    since = bench.emulator.dialect.transmitter._sequence_count
    bench.forget()
    most = 0
    for _ in range(60):
        bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 1024}, ack=9)
        bench.run(30)
        most = max(most, bench.emulator.dialect.port.queued_bytes)
    assert 32_768 - 1100 < most <= 32_768 + 16_384
    bench.run(20_000)
    bench.send("ping")
    bench.run(500)
    told = sum(event["packets"] for event in bench.events("TX_QUEUE_OVERFLOWED"))
    counts = [packet.decoded["sequence_count"] for packet in bench.packets]
    assert counts == sorted(counts)
    assert told == counts[-1] + 1 - since - len(counts) > 5
    for report in ("acceptance_success", "completion_success"):
        assert len(bench.of(report)) == 61, "the reserve is theirs"
    assert len(bench.of("memory_dump_report")) == 60 - told
