"""Anything at any time: telecommands good and bad, faults, power, a watchdog. What an OBC can rely on.

Everything is judged from the packets on the line, read by the reference decoder, and from what the test did.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil_tests.vectors import reference_decoder as wire
from hil_tests.vectors.received import EVENT
from st_emulator.firmware_model.causes import FaultCause, ResetCause

from .conftest import FUNCTION, MODE, Bench, Packet, make
from .test_faults_in_operation import Dead, with_sensor
from .test_life import damaged

BOOT_MS = 30
PERIOD_MS = 250
SELF_TEST_STEPS = 4
ENDS = ("completion_success", "completion_failure")


def function(name: str, **arguments: Any) -> tuple[str, dict[str, Any]]:
    return "function", {"function_id": FUNCTION[name], "arguments": arguments}


def load(data: bytes, *, memory: int, start: int, wrong: int = 0) -> tuple[str, dict[str, Any]]:
    checksum = wire.crc16(data) ^ wrong
    return "memory_load", {
        "memory_id": memory,
        "start_address": start,
        "data": data,
        "checksum": checksum,
    }


def parameter(number: int, value: float) -> tuple[str, dict[str, Any]]:
    return "parameter_set", {"settings": [{"parameter_id": number, "value": value}]}


WHOLE = {"transaction_id": 7, "first_part": 0, "parts": 0}
TELECOMMANDS = [
    function("GO_STANDBY"),
    function("START_ACQUISITION"),
    function("START_SELF_TEST"),
    function("RESET", kind=0),
    function("RESET", kind=1),
    function("CAPTURE_IMAGE"),
    function("DOWNLOAD_IMAGE", **WHOLE),
    function("DOWNLOAD_IMAGE", **WHOLE | {"first_part": 3, "parts": 5}),
    function("DOWNLOAD_IMAGE", **WHOLE | {"first_part": 60000}),
    function("ABORT_DOWNLOAD"),
    function("SHUTDOWN"),
    function("CLEAR_COUNTERS"),
    function("RESTORE_DEFAULT_PARAMETERS"),
    function("TRACK_FROM", q_x=0.0, q_y=0.0, q_z=0.0, q_w=1.0),
    function("TRACK_FROM", q_x=0.0, q_y=0.0, q_z=0.0, q_w=2.0),
    ("function", {"function_id": 99, "arguments": {}}),
    ("set_time", {"time": (2_000_000_000, 0)}),
    ("time_report_rate", {"rate_exponent": 1}),
    ("ping", {}),
    ("hk_enable", {"structure_ids": [1, 2, 3]}),
    ("hk_one_shot", {"structure_ids": [1, 3]}),
    ("hk_one_shot", {"structure_ids": [77]}),
    ("hk_set_interval", {"intervals": [{"structure_id": 1, "interval_ms": 100}]}),
    ("event_disable", {"event_ids": [4, 6, 17]}),
    ("event_report_disabled", {}),
    ("memory_dump", {"memory_id": 1, "start_address": 0, "length": 64}),
    ("memory_check", {"memory_id": 3, "start_address": 0, "length": 64}),
    load(b"octets", memory=1, start=100),
    load(bytes(8), memory=4, start=0),
    load(b"octets", memory=1, start=100, wrong=1),
    load(b"octets", memory=1, start=65535),
    parameter(18, 1),  # autonomous_start
    parameter(18, 0),
    parameter(19, 1),  # pipelined
    parameter(1, 10**9),  # exposure_us, too long
    parameter(20, 4_000_000),  # clock_hz: frames are late and dropped
]
WAITS_MS = (0, 1, 7, 29, 31, 90, 260, 700, 1300)
HAPPENINGS = [
    "power off", "power on", "power cycle", "watchdog", "warm start", "fault", "damage", "dead sensor",
    "mended sensor", "noise on the line", "crc",
]  # fmt: skip

TELECOMMAND = st.tuples(st.just("telecommand"), st.sampled_from(TELECOMMANDS))
#: What takes time and what cuts it short, over and over: most of what can go wrong is between these.
LASTING = st.tuples(
    st.just("telecommand"),
    st.sampled_from(
        [TELECOMMANDS[number] for number in (1, 2, 5, 6, 9, 16)]
        + [function("RESET", kind=0), function("SHUTDOWN"), function("GO_STANDBY")]
    ),
)
#: What is seldom come upon by chance: an image on its way, a self-test behind one that was given up.
PRELUDE = st.tuples(st.sampled_from(["download", "self-test anew"]), st.none())
HAPPENING = st.tuples(st.sampled_from(HAPPENINGS), st.none())
STEP = st.one_of(TELECOMMAND, LASTING, LASTING, PRELUDE, HAPPENING)
STEPS = st.lists(st.tuples(STEP, st.sampled_from(WAITS_MS)), min_size=1, max_size=30)


def event_of(packet: Packet) -> int | None:
    """The event that a packet reports, if it is an event report."""
    event: int | None = packet.fields.get("event_id")
    return event


class Watched:
    """A bench that knows what was done to the unit, and when its lives began."""

    def __init__(self, **arguments: Any) -> None:
        arguments = {"timing": {"boot_ms": BOOT_MS}, "wire": {"baud": 2_000_000}} | arguments
        self.bench: Bench = make(**arguments)
        self.bench.broken = []  # power goes in the middle of a packet
        self.sensor: Dead = with_sensor(self.bench, 1 << 30)
        self.sent: dict[int, tuple[str, dict[str, Any]]] = {}
        self.cuts_ns: list[int] = []  # when somebody ended a life without asking the unit
        self.power_ons_ns: list[int] = [0]
        self.on = True

    def telecommand(self, name: str, fields: dict[str, Any]) -> int:
        count = self.bench.send(name, fields)
        self.sent[count] = name, fields
        return count

    def do(self, what: str, telecommand: tuple[str, dict[str, Any]] | None) -> None:
        device, now_ns = self.bench.emulator.device, self.bench.emulator.now_ns
        match what:
            case "telecommand":
                assert telecommand is not None
                self.telecommand(*telecommand)
            case "download":
                self.telecommand(*function("CAPTURE_IMAGE"))
                self.bench.run(600)
                self.telecommand(*function("DOWNLOAD_IMAGE", **WHOLE))
            case "self-test anew":
                self.telecommand(*function("START_SELF_TEST"))
                self.bench.run(200)
                device.enter_fault(FaultCause.COMMANDED)
                self.telecommand(*function("START_SELF_TEST"))
            case "power off":
                self.cuts_ns.append(now_ns)
                self.on = False
                device.power_off()
            case "power on":
                if not self.on:
                    self.power_ons_ns.append(now_ns)
                self.on = True
                device.power_on()
            case "power cycle":
                self.do("power off", None)
                self.do("power on", None)
            case "watchdog" | "warm start":
                self.cuts_ns.append(now_ns)
                device.restart(ResetCause.WARM_RESET if what == "warm start" else ResetCause.WATCHDOG)
            case "fault":
                device.enter_fault(FaultCause.COMMANDED)
            case "damage":
                device.memories.overwrite_tables(damaged(device.memories.tables))
            case "dead sensor":
                self.sensor.left, self.sensor.mended = 0, False
            case "mended sensor":
                self.sensor.mended = True
            case "noise on the line":
                self.bench.put(b"\xc0noise\xdb\x00\xc0")
            case "crc":
                packet = bytearray(self.bench.packet("ping"))
                packet[-1] ^= 1
                self.bench.put_packet(bytes(packet))

    def lives(self) -> list[list[Packet]]:
        """The packets from each BOOT_COMPLETED to the next; nothing is sent before the first."""
        lives: list[list[Packet]] = []
        for packet in self.bench.packets:
            if event_of(packet) == EVENT["BOOT_COMPLETED"]:
                lives.append([])
            assert lives, f"{packet.name} before BOOT_COMPLETED"
            lives[-1].append(packet)
        return lives


def check_sequence(life: list[Packet]) -> None:
    """Sequence counts go on without a gap, and so do those of each message."""
    numbers = [packet.decoded["sequence_count"] for packet in life]
    assert numbers == list(range(len(life)))
    by_kind: dict[tuple[int, int], int] = {}
    for packet in life:
        kind = packet.decoded["service"], packet.decoded["subservice"]
        assert packet.decoded["message_count"] == by_kind.get(kind, 0)
        by_kind[kind] = by_kind.get(kind, 0) + 1


def check_modes(life: list[Packet]) -> None:
    """The mode that the events tell is the mode in housekeeping; each change begins where the last ended."""
    mode = MODE["STANDBY"]
    for packet in life:
        if event_of(packet) == EVENT["MODE_CHANGED"]:
            change = packet.fields["data"]
            assert change["from_mode"] == mode
            mode = change["to_mode"]
        elif packet.name == "hk_report" and packet.fields["structure_id"] == 1:
            assert packet.fields["values"]["mode"] == mode
        elif event_of(packet) == EVENT["FAULT_ENTERED"]:
            assert mode == MODE["FAULT"], "FAULT_ENTERED comes behind its change of mode"
        elif packet.name == "attitude_report":
            assert mode in (MODE["LOST_IN_SPACE"], MODE["TRACKING"])


def check_verification(watched: Watched, life: list[Packet], ended: bool) -> None:
    """Each accepted telecommand has one end, the last of its reports, unless its life was cut off.

    RESET has none: BOOT_COMPLETED takes its place.
    """
    stages: dict[int, list[str]] = {}
    for packet in life:
        if "request_id" in packet.fields:
            stages.setdefault(packet.fields["request_id"]["sequence_count"], []).append(packet.name)
    for count, told in stages.items():
        name, fields = watched.sent[count]
        if told == ["acceptance_failure"]:
            continue
        assert told[0] == "acceptance_success"
        assert "acceptance_failure" not in told
        assert told.count("acceptance_success") == 1
        assert told.count("start_success") <= 1
        if told.count("progress") and fields.get("function_id") == FUNCTION["START_SELF_TEST"]:
            assert told.count("progress") <= SELF_TEST_STEPS
        ends = [stage for stage in told if stage in ENDS]
        assert len(ends) <= 1
        if ends:
            assert told[-1] == ends[0], "nothing behind the end"
        reset = name == "function" and fields["function_id"] == FUNCTION["RESET"]
        if ended and not reset:
            assert ends, (name, fields, told)


def check_frames(watched: Watched) -> None:
    """Frame indices of attitude reports only grow while power is on, and lie on the frame grid."""
    beginnings = [*watched.power_ons_ns, 1 << 62]
    for began_ns, until_ns in pairwise(beginnings):
        reports = [
            packet
            for packet in watched.bench.packets
            if packet.name == "attitude_report" and began_ns <= packet.t_ns < until_ns
        ]
        indices = [packet.fields["frame_index"] for packet in reports]
        assert indices == sorted(set(indices))
        for packet in reports:
            assert began_ns + packet.fields["frame_index"] * PERIOD_MS * 1_000_000 < packet.t_ns


def check(watched: Watched) -> None:
    """All that can be read on the line."""
    lives = watched.lives()
    for number, life in enumerate(lives):
        check_sequence(life)
        check_modes(life)
        after_ns = lives[number + 1][0].t_ns if number + 1 < len(lives) else 1 << 62
        cut = any(life[0].t_ns - BOOT_MS * 1_000_000 < cut_ns < after_ns for cut_ns in watched.cuts_ns)
        check_verification(watched, life, ended=not cut)
    check_frames(watched)
    assert len(watched.bench.broken or []) <= len(watched.cuts_ns)


def back_to_standby(watched: Watched, cycle: bool) -> None:
    """Power away and back, or RESET where somebody listens: the unit is there as after any start."""
    bench = watched.bench
    watched.do("mended sensor", None)
    watched.do("power on", None)
    bench.run(BOOT_MS + 2)
    was_off = bench.emulator.device.mode == MODE["OFF"]
    bench.emulator.device.parameters.restore_defaults()
    number = len(bench.events("BOOT_COMPLETED"))
    if cycle or was_off:
        watched.do("power cycle", None)
    else:
        watched.telecommand(*function("RESET", kind=0))
    bench.run(BOOT_MS + 800)
    assert len(bench.events("BOOT_COMPLETED")) == number + 1
    ping = watched.telecommand("ping", {})
    bench.run(60)
    assert bench.stages(ping) == ["acceptance_success", "completion_success"]
    assert bench.housekeeping(1)["mode"] == MODE["STANDBY"]


def run(watched: Watched, steps: list[Any], cycle: bool) -> None:
    for (what, telecommand), wait_ms in steps:
        watched.do(what, telecommand)
        watched.bench.run(wait_ms)
    back_to_standby(watched, cycle)
    check(watched)


@settings(max_examples=90, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(steps=STEPS, cycle=st.booleans())
def test_whatever_happens_when(steps: list[Any], cycle: bool) -> None:
    run(Watched(), steps, cycle)


# -- the checks can fail


def lived() -> Watched:
    watched = Watched()
    watched.bench.run(BOOT_MS + 5)
    for telecommand in (
        function("START_ACQUISITION"),
        ("hk_one_shot", {"structure_ids": [1]}),
        function("GO_STANDBY"),
    ):
        watched.telecommand(*telecommand)
        watched.bench.run(1300)
    check(watched)
    return watched


def again(packet: Packet) -> Packet:
    return copy.deepcopy(packet)


def lose_an_end(watched: Watched) -> None:
    packets = watched.bench.packets
    last = next(packet for packet in reversed(packets) if packet.name == "completion_success")
    renumber_without(packets, last)


def end_twice(watched: Watched) -> None:
    packets = watched.bench.packets
    last = next(packet for packet in reversed(packets) if packet.name == "completion_success")
    twin = again(last)
    twin.decoded["sequence_count"] = packets[-1].decoded["sequence_count"] + 1
    twin.decoded["message_count"] += 1
    packets.append(twin)


def renumber_without(packets: list[Packet], gone: Packet) -> None:
    packets.remove(gone)
    kinds: dict[tuple[int, int], int] = {}
    for number, packet in enumerate(packets):
        kind = packet.decoded["service"], packet.decoded["subservice"]
        packet.decoded["sequence_count"] = number
        packet.decoded["message_count"] = kinds.get(kind, 0)
        kinds[kind] = kinds.get(kind, 0) + 1


def lose_a_packet(watched: Watched) -> None:
    del watched.bench.packets[3]


def lie_about_the_mode(watched: Watched) -> None:
    report = next(packet for packet in watched.bench.packets if packet.name == "hk_report")
    report.fields["values"]["mode"] = MODE["FAULT"]


def repeat_a_frame(watched: Watched) -> None:
    first, second = [packet for packet in watched.bench.packets if packet.name == "attitude_report"][:2]
    second.fields["frame_index"] = first.fields["frame_index"]


@pytest.mark.parametrize("spoil", [lose_an_end, end_twice, lose_a_packet, lie_about_the_mode, repeat_a_frame])
def test_what_is_wrong_is_seen(spoil: Callable[[Watched], None]) -> None:
    watched = lived()
    spoil(watched)
    with pytest.raises(AssertionError):
        check(watched)
