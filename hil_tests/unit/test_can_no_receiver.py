"""An OBC that gives no flow control, a link that takes no frames: what is lost, told, and goes on."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest

from st_emulator.protocol.pus.enumerations import EventId
from st_emulator.wire.can.wiring import CanWiring

from .conftest import FUNCTION, MODE, MS, CanBench, Packet, make_can

TIMEOUT_A, TIMEOUT_BS, WAIT_LIMIT = 1, 2, 7
CTS, WAIT = b"\x30\0\0", b"\x31\0\0"
FIRST_FRAME = 1


def reporting(interval_ms: int = 250, **arguments: Any) -> CanBench:
    """A unit that sends housekeeping."""
    bench = make_can(**arguments).boot()
    intervals = [{"structure_id": 1, "interval_ms": interval_ms}]
    bench.send("hk_set_interval", {"intervals": intervals}, ack=0)
    bench.send("hk_enable", {"structure_ids": [1]}, ack=0)
    bench.run_to(2000)
    assert len(bench.of("hk_report")) >= 3
    return bench


def last_count(bench: CanBench) -> int:
    return bench.packets[-1].decoded["sequence_count"]


def made_ns(packet: Packet) -> float:
    """When the unit made it; its clock was never set."""
    coarse, fine = packet.decoded["time"]
    return coarse * 1e9 + fine * 1e9 / 2**24


def missing(bench: CanBench, since: int) -> int:
    """Packets that never came, of those made after the one with the sequence count ``since``."""
    counts = [packet.decoded["sequence_count"] for packet in bench.packets]
    assert counts == sorted(counts)
    return counts[-1] - since - len(counts)


def asked(bench: CanBench) -> int:
    """First frames of the unit."""
    return sum(record[3] == 0x8A and record[8] >> 4 == FIRST_FRAME for _, record in bench.groups)


def deaf(bench: CanBench, value: bool) -> None:
    bench.peer.deaf = value


def refusing(bench: CanBench, value: bool) -> None:
    bench.refusing = value


GONE: dict[str, tuple[Callable[[CanBench, bool], None], int]] = {
    "no flow control": (deaf, TIMEOUT_BS),
    "a full link": (refusing, TIMEOUT_A),
}


@pytest.mark.parametrize("kind", GONE)
@pytest.mark.parametrize("timeout_ms", [1000, 150])
@pytest.mark.parametrize("gone_ms", [1700, 10_000])
def test_lost_packets_are_counted_and_no_old_one_comes(kind: str, timeout_ms: int, gone_ms: int) -> None:
    switch, reason = GONE[kind]
    bench = reporting(can_section={"timeout_ms": timeout_ms, "heartbeat_ms": 0})
    since = last_count(bench)
    bench.forget()
    switch(bench, True)
    bench.run(gone_ms)
    assert bench.packets == []
    attempts = gone_ms // timeout_ms if timeout_ms > 250 else gone_ms // 250
    assert abs(asked(bench) - (attempts if switch is deaf else 0)) <= 1
    switch(bench, False)
    back_ns = bench.emulator.now_ns
    bench.run(timeout_ms + 600)
    # None is begun that waited longer than the timeout; the link may have kept the first one as long again.
    ages_ns = [packet.t_ns - made_ns(packet) for packet in bench.packets]
    assert ages_ns[0] <= timeout_ms * MS * (1 if switch is deaf else 2) + 5 * MS
    assert max(ages_ns[1:]) <= timeout_ms * MS + 5 * MS
    assert bench.packets[0].t_ns <= back_ns + (timeout_ms + 250) * MS
    lost = missing(bench, since)
    assert lost >= (gone_ms - timeout_ms) // 250 - 1 > 0
    assert bench.events("CAN_PACKETS_LOST") == [{"reason": reason, "packets": lost}]
    structure = bench.can()
    name = "timeouts_bs" if reason == TIMEOUT_BS else "timeouts_a"
    assert structure[name] == structure["transmissions_failed"]
    assert 0 < structure["transmissions_failed"] <= lost
    assert structure["tx_refused"] == bench.refused
    bench.run(3000)
    assert missing(bench, since) == lost, "nothing more is lost"
    assert len(bench.events("CAN_PACKETS_LOST")) == 1


@pytest.mark.parametrize("pause_ms", [100, 700, 950])
@pytest.mark.parametrize("kind", GONE)
def test_a_pause_within_the_timeout_loses_nothing(kind: str, pause_ms: int) -> None:
    bench = reporting(can_section={"heartbeat_ms": 0})
    since = last_count(bench)
    bench.forget()
    bench.run_until(lambda: bool(bench.groups))
    switch, _ = GONE[kind]
    if switch is deaf:
        # The flow control for the next packet comes late.
        bench.run(100)
        deaf(bench, True)
        number = asked(bench)
        bench.run_until(lambda: asked(bench) > number)
        bench.run(pause_ms)
        deaf(bench, False)
        bench.peer.put(CTS)
    else:
        refusing(bench, True)
        bench.run(pause_ms)
        refusing(bench, False)
        assert bench.refused >= pause_ms - 260
    bench.run(1500)
    assert missing(bench, since) == 0
    assert bench.events("CAN_PACKETS_LOST") == []
    assert len(bench.of("hk_report")) >= 5


def test_lost_in_the_middle_of_a_packet() -> None:
    """Flow control between two blocks that never comes is as good as none at the start."""
    bench = make_can(can_section={"heartbeat_ms": 0}).boot()
    bench.peer.answers.append(b"\x30\x05\x00")
    bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 900}, ack=0)
    bench.run(1100)
    assert bench.packets == []
    bench.peer.broken = 0
    bench.send("ping", ack=0)
    bench.run(20)
    assert [packet.name for packet in bench.packets] == ["pong", "event_low"]
    assert bench.events("CAN_PACKETS_LOST") == [{"reason": TIMEOUT_BS, "packets": 1}]


def test_a_report_that_is_lost_itself_is_made_up_for() -> None:
    """The OBC is back for one packet only: the event behind it is lost, and the next one tells of all."""
    bench = reporting(can_section={"heartbeat_ms": 0})
    since = last_count(bench)
    bench.forget()
    deaf(bench, True)
    bench.run(5000)
    bench.peer.answers.append(CTS)
    bench.run(5000)
    assert len(bench.packets) == 1
    deaf(bench, False)
    bench.run(3000)
    lost = missing(bench, since)
    assert lost > 30
    assert bench.events("CAN_PACKETS_LOST") == [{"reason": TIMEOUT_BS, "packets": lost}]


def test_a_report_that_finds_the_queue_full_is_made_up_for() -> None:
    bench = reporting(can_section={"heartbeat_ms": 0})
    since = last_count(bench)
    bench.forget()
    deaf(bench, True)
    bench.run(3000)
    port = bench.emulator.dialect.port
    queue, full = port.queue, [True]

    def short_of_room(packet: bytes, limit_bytes: int) -> int:
        lost_report = packet[7:9] + packet[20:22] == b"\x05\x02\x00\x17"
        return queue(packet, 0 if full[0] and lost_report else limit_bytes)

    port.queue = short_of_room
    deaf(bench, False)
    bench.run(2000)
    assert bench.events("CAN_PACKETS_LOST") == []
    assert len(bench.of("hk_report")) > 3
    full[0] = False
    bench.run(1000)
    (event,) = bench.events("CAN_PACKETS_LOST")
    assert event["packets"] > 5
    overflowed = sum(item["packets"] for item in bench.events("TX_QUEUE_OVERFLOWED"))
    assert overflowed > 3, "reports that found no room"
    assert event["packets"] + overflowed == missing(bench, since)


def test_a_loss_is_not_told_while_the_event_is_disabled() -> None:
    bench = reporting()
    bench.send("event_disable", {"event_ids": [int(EventId.CAN_PACKETS_LOST)]}, ack=0)
    bench.run(50)
    deaf(bench, True)
    bench.run(3000)
    deaf(bench, False)
    bench.run(2500)
    assert bench.events("CAN_PACKETS_LOST") == []
    bench.send("event_enable", {"event_ids": [int(EventId.CAN_PACKETS_LOST)]}, ack=0)
    bench.run(2000)
    assert bench.events("CAN_PACKETS_LOST") == []


def test_short_packets_of_can_fd_do_not_show_a_receiver() -> None:
    """They need no flow control; the loss of long ones is told when one of these gets through."""
    bench = make_can(can=CanWiring(fd=True)).boot()
    bench.send("ping", ack=0)
    bench.run(20)
    dump = {"memory_id": 1, "start_address": 0, "length": 900}
    since = last_count(bench)
    bench.forget()
    deaf(bench, True)
    bench.send("memory_dump", dump, ack=0)
    bench.run(1100)
    for _ in range(5):
        bench.emulator.dialect.events.raise_event(EventId.SENSOR_BLINDED, frame_index=0, background_dn=0)
        bench.run(100)
    assert [packet.name for packet in bench.packets[-5:]] == ["event_medium"] * 5, "single frames"
    assert bench.events("CAN_PACKETS_LOST") == []
    deaf(bench, False)
    bench.send("memory_dump", dump, ack=0)
    bench.run(200)
    assert missing(bench, since) == 1
    assert bench.events("CAN_PACKETS_LOST") == [{"reason": TIMEOUT_BS, "packets": 1}]


def test_short_packets_of_can_fd_do_when_the_obc_is_heard() -> None:
    bench = make_can(can=CanWiring(fd=True)).boot()
    deaf(bench, True)
    bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 900}, ack=0)
    bench.run(1100)
    deaf(bench, False)
    assert bench.packets == []
    bench.send("ping", ack=0)
    bench.run(20)
    assert [packet.name for packet in bench.packets] == ["pong", "event_low"]


def test_cyclic_frames_need_no_receiver() -> None:
    bench = reporting(can_section={"heartbeat_ms": 100})
    deaf(bench, True)
    bench.forget()
    bench.run(10_000)
    beats = bench.frames("heartbeat")
    assert len(beats) == 100
    assert {later[0] - earlier[0] for earlier, later in pairwise(beats)} <= set(range(99 * MS, 101 * MS))
    assert bench.emulator.dialect.cyclic.housekeeping()["cyclic_overruns"] == 0


@pytest.mark.parametrize("kind", GONE)
def test_memory_stays_bounded(kind: str) -> None:
    """A minute without a receiver, the unit tracking, told to download its image and to dump its memory."""
    switch, _ = GONE[kind]
    bench = make_can().boot()
    bench.function("CAPTURE_IMAGE", ack=0)
    bench.run(400)
    bench.to_mode("TRACKING")
    emulator = bench.emulator
    port = emulator.dialect.port
    download = {"transaction_id": 1, "first_part": 0, "parts": 0}
    bench.function("DOWNLOAD_IMAGE", download, ack=0)
    bench.run(10)
    switch(bench, True)
    for second in range(60):
        # The unit hears the OBC though it is not heard itself.
        bench.peer._sending.clear()
        bench.peer._pieces.clear()
        bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 1024})
        bench.run(1000)
        assert port.queued_bytes <= 49_152
        assert port.bus.queued_frames <= 12, "one of each kind"
        assert len(emulator.clock._queue) < 200, second
    switch(bench, False)
    bench.peer._sending.clear()
    bench.peer._pieces.clear()
    bench.run(1300)
    bench.forget()
    count = bench.send("ping")
    bench.run(600)
    assert bench.stages(count) == ["acceptance_success", "completion_success"]


@pytest.mark.parametrize("function", ["SHUTDOWN", "RESET"])
@pytest.mark.parametrize("kind", GONE)
def test_shutdown_and_reset_still_end(kind: str, function: str) -> None:
    """Within two timeouts: one for what is under way, one for what had just been queued."""
    switch, _ = GONE[kind]
    bench = reporting()
    bench.forget()
    unit = bench.emulator.device
    switch(bench, True)
    bench.run(170)
    arguments = {"kind": 0} if function == "RESET" else {}
    packet = bench.packet("function", {"function_id": FUNCTION[function], "arguments": arguments})
    bench.emulator.dialect.packet_received(packet, bench.emulator.now_ns)
    count = bench.count
    target = MODE["OFF" if function == "SHUTDOWN" else "BOOT"]
    bench.run_until(lambda: unit.mode == target, 2100)
    assert bench.stages(count) == []
    bench.forget()
    switch(bench, False)
    if function == "SHUTDOWN":
        bench.run(2000)
        assert bench.groups == [], "nor does a heartbeat that waited leave now"
    else:
        bench.run(500)
        assert [event["boot_count"] for event in bench.events("BOOT_COMPLETED")] == [2]
        assert bench.events("CAN_PACKETS_LOST") == [], "another life"


def test_shutdown_ends_for_an_obc_that_says_wait_for_ever() -> None:
    bench = reporting()
    bench.forget()
    deaf(bench, True)
    bench.run(700)
    bench.function("SHUTDOWN")
    bench.run(20)
    for _ in range(26):  # two packets, eleven times each
        bench.peer.put(WAIT)
        bench.run(900)
        if bench.emulator.device.mode == MODE["OFF"]:
            break
    assert bench.emulator.device.mode == MODE["OFF"]
