"""Faults of the CAN bus: by chance, by direction, live, from a journal, and gone when they are over."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from hil_tests.faults.runs import kinds_of, replayed, run, started, within_chance
from hil_tests.unit.conftest import MS, make
from hil_tests.vectors.reference_can import record, records
from st_emulator.errors import ConfigurationError
from st_emulator.faults.catalogue import FAULTS
from st_emulator.faults.fault import DirectedSettings
from st_emulator.protocol.can.frames import CanFrame
from st_emulator.wire.can.controller import BusError
from st_emulator.wire.can.wiring import CanWiring

KINDS = kinds_of("bus", "can")
CERTAIN = ("bus.bus_off", "bus.stuck_dominant")
#: The unit has lost nothing by them, so that it goes on as without them.
HARMLESS = [
    {"kind": "bus.error_frames", "probability": 0.1},
    {"kind": "bus.babbling_node", "frames_per_s": 1000},
    {"kind": "bus.no_acknowledge", "probability": 0.05},
]
OWN = CanFrame(0x18A, bytes(8))


def fault(name: str, **settings: Any) -> dict[str, Any]:
    chance = {} if name in CERTAIN else {"probability": 0.4}
    return {"kind": name, "seed": 7} | chance | settings


@pytest.mark.parametrize("name", KINDS)
def test_the_same_seed_is_the_same_run_and_another_is_another(name: str) -> None:
    one = run(fault(name), on_can=True)
    assert run(fault(name), on_can=True).journal == one.journal
    assert one.during() != run(None, on_can=True).during()
    if name not in CERTAIN:
        assert any(run(fault(name, seed=seed), on_can=True).groups != one.groups for seed in (8, 9))


@pytest.mark.parametrize("name", KINDS)
def test_put_in_and_cleared_live_it_is_the_same_as_of_a_scenario(name: str, tmp_path: Path) -> None:
    scenario = run(fault(name), on_can=True)
    live = run(fault(name), on_can=True, live=True)
    assert live.groups == scenario.groups
    assert replayed(live.journal, tmp_path) == live.groups


@pytest.mark.parametrize("name", KINDS)
def test_a_journal_of_a_run_with_it_is_replayed(name: str, tmp_path: Path) -> None:
    settings = fault(name)
    if issubclass(FAULTS[name].settings, DirectedSettings):
        settings["direction"] = "both"
    recorded = run(settings, on_can=True, pings=True)
    assert replayed(recorded.journal, tmp_path) == recorded.groups


@pytest.mark.parametrize("settings", HARMLESS, ids=lambda one: one["kind"])
def test_nothing_is_left_behind(settings: dict[str, Any]) -> None:
    plain, faulty = run(None, on_can=True), run(settings | {"seed": 7}, on_can=True)
    assert faulty.before() == plain.before()
    assert faulty.during() != plain.during()
    assert len(plain.after(300)) > 20
    assert faulty.after(300) == plain.after(300)


@pytest.mark.parametrize("name", KINDS)
def test_when_it_is_over_everything_comes_again(name: str) -> None:
    """After what it destroyed: no error, no frame of another node, each frame of the sensor told."""
    faulty = run(fault(name), on_can=True).bench
    bus = faulty.emulator.dialect.port.bus
    errors, lost = bus.counters.error_frames, bus.counters.arbitration_lost
    faulty.forget()
    faulty.run(5000)
    assert len(faulty.of("attitude_report")) == 20
    assert (bus.counters.error_frames, bus.counters.arbitration_lost) == (errors, lost)
    counts = [packet.decoded["sequence_count"] for packet in faulty.packets]
    assert counts == list(range(counts[0], counts[0] + len(counts)))


@pytest.mark.parametrize("probability", [0.1, 0.5])
@pytest.mark.parametrize("own", [True, False])
def test_attempts_are_struck_as_often_as_is_said(own: bool, probability: float) -> None:
    bench = started(True)
    direction = "to_obc" if own else "to_unit"
    chance = {"probability": probability, "seed": 3}
    bench.emulator.faults.inject(
        {"kind": "bus.error_frames", "direction": direction, "error": "crc"} | chance
    )
    seams, number = bench.emulator._seams, 5000
    assert not any(seams.disturbance(OWN, not own, 0) for _ in range(100))
    found = [seams.disturbance(OWN, own, 0) for _ in range(number)]
    assert set(found) == {None, BusError.CRC}
    assert within_chance(number - found.count(None), number, probability)


@pytest.mark.parametrize("probability", [0.1, 0.5])
@pytest.mark.parametrize("to_obc", [True, False])
@pytest.mark.parametrize("name", ["bus.frames_lost", "bus.frames_delayed"])
def test_frames_are_struck_as_often_as_is_said(name: str, to_obc: bool, probability: float) -> None:
    bench = started(True)
    direction = "to_obc" if to_obc else "to_unit"
    bench.emulator.faults.inject(
        {"kind": name, "direction": direction, "probability": probability, "seed": 3}
    )
    seams, number, one = bench.emulator._seams, 4000, record(0x18A, b"12345678")
    got: list[bytes] = []
    seams.records(one * 10, not to_obc, got.append)
    assert got == [one] * 10
    got.clear()
    seams.records(one * number, to_obc, got.append)
    assert within_chance(number - len(got), number, probability)


def test_flow_control_alone_is_struck() -> None:
    bench = started(True)
    bench.emulator.faults.inject({"kind": "bus.no_flow_control", "probability": 0.5, "seed": 3})
    seams = bench.emulator._seams
    got: list[bytes] = []
    others = [
        record(0x60A, b"\x02\x11\x22"),
        record(0x60A, b""),
        record(0x60B, b"\x30\0\0"),
        record(0x080, b"\x30"),
        record(0x60A, b"\x30\0\0", extended=True),
    ]
    seams.records(b"".join(others), False, got.append)
    assert got == others
    got.clear()
    seams.records(record(0x60A, b"\x30\0\0"), True, got.append)
    assert len(got) == 1  # it is the OBC's that does not come
    got.clear()
    seams.records(record(0x60A, b"\x30\0\0") * 2000, False, got.append)
    assert within_chance(len(got), 2000, 0.5)


def test_bus_off_lasts_as_long_as_the_fault() -> None:
    bench = make("roja1", can=CanWiring())
    bench.run_to(1000)
    faults, bus = bench.emulator.faults, bench.emulator.dialect.port.bus
    number = faults.inject({"kind": "bus.bus_off"})
    for _ in range(50):
        bench.run(100)
        assert bus.state == 2
    assert bus.counters.bus_off_count == 1
    faults.clear(number)
    bench.run(3)  # 128 times eleven bits at 1 Mbit/s, counted anew at the most once
    assert bus.state == 0


def test_a_fault_shorter_than_the_restart_leaves_it_alone() -> None:
    bench = make("roja1", can=CanWiring())
    bench.run_to(1000)
    bench.emulator.faults.inject({"kind": "bus.bus_off", "duration_s": 0.01})
    bench.run(101)
    assert bench.emulator.dialect.port.bus.state == 2
    bench.run(1)  # 100 ms and 1408 bits
    assert bench.emulator.dialect.port.bus.state == 0


def test_a_unit_that_starts_while_the_bus_is_stuck() -> None:
    bench = make("roja1", can=CanWiring())
    number = bench.emulator.faults.inject({"kind": "bus.stuck_dominant"})
    bench.run_to(3000)
    assert not bench.groups
    assert bench.emulator.dialect.port.bus.state == 2
    bench.emulator.faults.clear(number)
    bench.run(1500)
    assert bench.frames("heartbeat")


def test_the_babbling_node_has_one_frame_at_a_time() -> None:
    """Far more than the bus carries: nothing of it is left when it is over."""
    bench = started(True)
    bench.run_to(2000)
    number = bench.emulator.faults.inject(
        {"kind": "bus.babbling_node", "frames_per_s": 20_000, "identifier": 0x7FF}
    )
    bench.forget()
    bench.run(1000)
    bench.emulator.faults.clear(number)
    end_ns = bench.emulator.now_ns
    bench.run(1000)
    times = [t_ns for t_ns, group in bench.groups for identifier, _ in records(group) if identifier == 0x7FF]
    assert 6000 < len(times) < 9100
    assert max(times) <= end_ns + 2 * 135_000
    assert len(bench.of("attitude_report")) == 8  # its identifier is the highest: it disturbs nobody


def test_a_bit_rate_of_the_wiring_is_that_of_the_babble() -> None:
    counts = {}
    for bitrate in (250_000, 500_000):
        bench = make("roja1", can=CanWiring(bitrate=bitrate))
        bench.run_to(1000)
        bench.emulator.faults.inject({"kind": "bus.babbling_node", "frames_per_s": 20_000})
        bench.forget()
        bench.run(1000)
        counts[bitrate] = len(bench.peer.frames) or len(bench.groups)
    assert 1.9 < counts[500_000] / counts[250_000] < 2.1


# -- settings


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"kind": "bus.error_frames", "error": "parity"}, "'bit', 'stuff', 'form', 'crc', 'ack'"),
        ({"kind": "bus.bus_off", "probability": 0.5}, "probability"),
        ({"kind": "bus.stuck_dominant", "probability": 0.5}, "probability"),
        ({"kind": "bus.babbling_node", "identifier": 0x800}, "allowed are 0 to 2047, or extended = true"),
        ({"kind": "bus.babbling_node", "identifier": 1 << 29, "extended": True}, "identifier"),
        ({"kind": "bus.babbling_node", "frames_per_s": 0}, "frames_per_s"),
        ({"kind": "bus.babbling_node", "octets": 9}, "octets"),
        ({"kind": "bus.frames_delayed", "delay_ms": -1}, "delay_ms"),
        ({"kind": "bus.no_acknowledge", "direction": "both"}, "direction"),
    ],
)
def test_a_bad_setting_is_told_in_one_line(settings: dict[str, Any], told: str) -> None:
    bench = started(True)
    with pytest.raises(ConfigurationError) as caught:
        bench.emulator.faults.inject(settings)
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not bench.emulator.faults.all


@pytest.mark.parametrize("name", KINDS)
def test_a_serial_line_has_no_such_fault(name: str) -> None:
    with pytest.raises(ConfigurationError, match="for a unit on a CAN bus, and this one is on a serial line"):
        started(False).emulator.faults.inject({"kind": name})


@pytest.mark.parametrize("name", KINDS)
def test_a_real_bus_takes_only_what_is_done_at_the_link(name: str) -> None:
    bench = make("roja1", can=CanWiring(hardware=True))
    if name in ("bus.frames_lost", "bus.frames_delayed", "bus.no_flow_control"):
        bench.emulator.faults.inject({"kind": name})
    else:
        with pytest.raises(ConfigurationError, match="only a modelled bus has such a fault"):
            bench.emulator.faults.inject({"kind": name})


def test_canopen_has_no_flow_control() -> None:
    from hil_tests.dialects.canopen.bench import make as make_canopen

    bench = make_canopen()
    with pytest.raises(ConfigurationError, match="for the dialects pus, and this unit speaks canopen"):
        bench.emulator.faults.inject({"kind": "bus.no_flow_control"})
    bench.emulator.faults.inject({"kind": "bus.bus_off", "start_s": 3, "duration_s": 2})
    bench.run(8000)
    off = [t_ns / MS for t_ns, _ in bench.heartbeats]
    assert not [t_ms for t_ms in off if 3010 < t_ms < 5000]
    assert [t_ms for t_ms in off if t_ms > 5000]
