"""Faults of the line: by chance, by direction, live, from a journal, and gone when they are over."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from hil_tests.faults.runs import kinds_of, replayed, run, started, within_chance
from st_emulator.errors import ConfigurationError
from st_emulator.faults import uart

SERIAL, CAN = kinds_of("line", "serial"), kinds_of("line", "can")
BY_CHANCE = [name for name in SERIAL if name not in ("line.silence", "line.babble", "line.frames_doubled")]
#: What was held back comes at the end, and the work of flow control that came or did not come counts into the
#: frame behind it.
MARGIN_MS = 600
OCTETS = ["line.bits_flipped", "line.bytes_lost", "line.bytes_doubled", "line.bytes_inserted"]
ON_BOTH = [(name, False) for name in SERIAL] + [(name, True) for name in CAN]


def fault(name: str, **settings: Any) -> dict[str, Any]:
    """One of a kind, by chance where it has one."""
    chance = {} if name in ("line.silence", "line.babble") else {"probability": 0.4}
    if name in OCTETS or name == "line.break":
        chance = {"probability": 0.02}
    return {"kind": name, "seed": 7} | chance | settings


def counted(bench: Any) -> list[int]:
    return [packet.decoded["sequence_count"] for packet in bench.packets]


@pytest.mark.parametrize(("name", "on_can"), ON_BOTH)
def test_the_same_seed_is_the_same_run_and_another_is_another(name: str, on_can: bool) -> None:
    one = run(fault(name), on_can=on_can)
    assert run(fault(name), on_can=on_can).journal == one.journal
    plain = run(None, on_can=on_can)
    assert one.during() != plain.during()
    if name == "line.silence":
        return
    assert any(run(fault(name, seed=seed), on_can=on_can).groups != one.groups for seed in (8, 9))


@pytest.mark.parametrize(("name", "on_can"), ON_BOTH)
def test_nothing_is_left_behind(name: str, on_can: bool) -> None:
    direction = "to_obc" if name == "line.babble" else "both"  # the unit tells of what it gets
    plain, faulty = run(None, on_can=on_can), run(fault(name, direction=direction), on_can=on_can)
    assert faulty.before() == plain.before()
    assert len(plain.after(MARGIN_MS)) > 20
    assert faulty.after(MARGIN_MS) == plain.after(MARGIN_MS)


@pytest.mark.parametrize(("name", "on_can"), ON_BOTH)
def test_put_in_and_cleared_live_it_is_the_same_as_of_a_scenario(
    name: str, on_can: bool, tmp_path: Path
) -> None:
    scenario = run(fault(name), on_can=on_can)
    live = run(fault(name), on_can=on_can, live=True)
    assert live.groups == scenario.groups
    assert '"inject"' in live.journal
    assert '"clear": 0' in live.journal
    assert replayed(live.journal, tmp_path) == live.groups


@pytest.mark.parametrize("direction", ["to_obc", "to_unit", "both"])
@pytest.mark.parametrize(("name", "on_can"), ON_BOTH)
def test_a_journal_of_a_run_with_it_is_replayed(
    name: str, on_can: bool, direction: str, tmp_path: Path
) -> None:
    recorded = run(fault(name, direction=direction), on_can=on_can, pings=True)
    assert replayed(recorded.journal, tmp_path) == recorded.groups


@pytest.mark.parametrize(("name", "on_can"), ON_BOTH)
def test_a_direction_leaves_the_other_alone(name: str, on_can: bool) -> None:
    """Without a word of the OBC nothing goes to the unit but what the fault itself puts there."""
    plain = run(None, on_can=on_can)
    struck = run(fault(name, direction="to_unit"), on_can=on_can)
    if name in ("line.babble", "line.break"):  # octets to the unit that nobody sent: it tells of them
        assert struck.bench.broken == []
        assert len(struck.bench.of("attitude_report")) == len(plain.bench.of("attitude_report"))
    else:
        assert struck.groups == plain.groups


def test_what_goes_to_the_unit_is_struck_there() -> None:
    lost = run(fault("line.frames_lost", direction="to_unit", probability=1.0), on_can=False, pings=True)
    plain = run(None, on_can=False, pings=True)
    assert counted(lost.bench) == list(range(len(lost.bench.packets)))
    assert len(plain.bench.of("pong")) - len(lost.bench.of("pong")) == 15  # one each 100 ms
    assert lost.bench.broken == []


@pytest.mark.parametrize("probability", [0.01, 0.3, 0.9])
@pytest.mark.parametrize("to_obc", [True, False])
@pytest.mark.parametrize("name", OCTETS)
def test_octets_are_struck_as_often_as_is_said(name: str, to_obc: bool, probability: float) -> None:
    bench = started(False)
    bench.emulator.faults.inject(
        {
            "kind": name,
            "probability": probability,
            "seed": 3,
            "direction": "to_obc" if to_obc else "to_unit",
        }
    )
    seams, number = bench.emulator._seams, 20_000
    assert seams.octets(bytes(number), not to_obc) == bytes(number)
    found = b"".join(seams.octets(bytes(100), to_obc) for _ in range(number // 100))
    if name == "line.bits_flipped":
        struck = [octet for octet in found if octet]
        assert {octet.bit_count() for octet in struck} == {1}
        assert len(set(struck)) == 8
        count = len(struck)
    else:
        count = abs(len(found) - number)
    assert within_chance(count, number, probability)


@pytest.mark.parametrize("probability", [0.1, 0.5])
@pytest.mark.parametrize("on_can", [False, True])
@pytest.mark.parametrize("name", [name for name in CAN if name != "line.frames_reordered"])
def test_messages_are_struck_as_often_as_is_said(name: str, on_can: bool, probability: float) -> None:
    bench = started(on_can)
    bench.emulator.faults.inject({"kind": name, "probability": probability, "seed": 3})
    number = 4000
    message = bytes(range(40))
    whole = 0
    for _ in range(number):
        got: list[bytes] = []
        bench.emulator._seams.to_obc(message, got.append)
        whole += got == [message]
    assert within_chance(number - whole, number, probability)


def test_a_seed_of_the_run_gives_each_fault_its_own() -> None:
    bench = started(False)
    inject = bench.emulator.faults.inject
    for _ in range(2):
        inject({"kind": "line.bits_flipped", "probability": 0.5})
    one, other = (entry.fault for entry in bench.emulator.faults.all)
    assert one.seed != other.seed


def test_what_is_held_back_does_not_meet_a_fault_that_has_ended() -> None:
    bench = started(False)
    faults, seams = bench.emulator.faults, bench.emulator._seams
    delay = faults.inject({"kind": "line.frames_delayed", "delay_ms": 1000})
    lost = faults.inject({"kind": "line.frames_lost"})
    got: list[bytes] = []
    seams.to_obc(b"held", got.append)
    faults.clear(lost)
    faults.clear(delay)
    assert got == [b"held"]


def test_what_is_held_back_is_lost_with_a_reset_of_the_unit() -> None:
    bench = started(False)
    bench.run_to(2000)
    bench.emulator.faults.inject({"kind": "line.frames_delayed", "delay_ms": 10_000})
    bench.run(1000)
    number = len(bench.packets)
    bench.emulator.device.power_off()
    bench.run(20_000)
    assert len(bench.packets) == number
    assert not bench.groups[-1][0] > 3_000_000_000


# -- the UART


def test_a_uart_at_the_same_rate_reads_what_was_sent() -> None:
    octets = bytes(range(256))
    assert uart.read(octets, 1.0) == [(octet, False) for octet in octets]


@pytest.mark.parametrize("ratio", [0.948, 0.96, 1.04, 1.052])
def test_ten_bits_bear_five_percent(ratio: float) -> None:
    """The stop bit's middle is at 9.5 bits of the receiver: within the tenth bit from 9/9.5 to 10/9.5."""
    octets = bytes(range(256))
    assert uart.read(octets, ratio) == [(octet, False) for octet in octets]


def test_a_sender_of_twice_the_rate() -> None:
    """By hand. 55h is 0 10101010 1 on the line, least significant bit first: levels 0 1 0 1 0 1 0 1 0 1 in
    the bit times 0 to 9, then rest. A receiver of half the rate has its middles 1 + 2k bit times of the
    sender behind the edge at 0: 1 is high there, so the start bit is none. The next edge is at 2, its middle
    3, high; and so on: nothing is read. 00h is low from 0 to 9: middles 1 (start, low), 3, 5, 7 (three data
    bits 0), then 9, 11, 13, 15, 17 (five data bits 1), 19 (stop, high): F8h.
    """
    assert uart.read(b"\x55", 2.0) == []
    assert uart.read(b"\x00", 2.0) == [(0xF8, False)]


def test_a_sender_of_half_the_rate() -> None:
    """By hand. FFh is one low bit time, then high. Middles at 0.25 (start, low), 0.75 (bit 0, low still),
    1.25 and on (bits 1 to 7, high), stop at 4.75, high: FEh. 00h is low for nine bit times: start and all
    data bits low, stop at 4.75 low: 00h with a framing error, then no edge before the end of the octet.
    """
    assert uart.read(b"\xff", 0.5) == [(0xFE, False)]
    assert uart.read(b"\x00", 0.5) == [(0x00, True)]


def test_a_sender_six_percent_too_fast() -> None:
    """By hand. The stop's middle is at 9.5 * 1.06 = 10.07 bit times: in the start bit of the next octet, low.
    Its falling edge at 10 is missed. The last octet is followed by rest: no framing error. FFh FFh: the first
    with a framing error, and the second, which has no falling edge but its own start bit, is not read.
    """
    assert uart.read(b"\xff\xff", 1.06) == [(0xFF, True)]
    assert uart.read(b"\xff", 1.06) == [(0xFF, False)]


def test_octets_with_framing_errors_may_be_dropped() -> None:
    seen = {}
    for kept in ("kept", "dropped"):
        bench = started(False)
        bench.emulator.faults.inject({"kind": "line.baud_error", "percent": 6, "frame_errors": kept})
        seen[kept] = bench.emulator._seams.octets(b"\xff\xff", True)
    assert seen == {"kept": b"\xff", "dropped": b""}


def test_a_break_is_one_octet() -> None:
    bench = started(False)
    sent: list[bytes] = []
    bench.emulator._external_transmit = lambda data, t_ns: sent.append(data)
    number = bench.emulator.faults.inject({"kind": "line.break"})
    assert sent == [b"\0"]
    assert bench.emulator._seams.octets(b"abc", True) == b""
    assert bench.emulator._seams.octets(b"abc", False) == b"abc"
    bench.emulator.faults.clear(number)
    assert bench.emulator._seams.octets(b"abc", True) == b"abc"


# -- settings


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"kind": "line.nothing"}, "allowed"),
        ({"kind": "line.silence", "probability": 0.5}, "probability"),
        ({"kind": "line.bits_flipped", "probability": 0}, "probability"),
        ({"kind": "line.bits_flipped", "direction": "up"}, "'to_obc', 'to_unit', 'both'"),
        ({"kind": "line.frames_delayed", "delay_ms": -1}, "delay_ms"),
        ({"kind": "line.frames_cut", "keep": 0}, "keep"),
        ({"kind": "line.baud_error", "percent": -100}, "percent"),
        ({"kind": "line.baud_error", "frame_errors": "shown"}, "'kept', 'dropped'"),
        ({"kind": "line.babble", "octets_per_s": 1e9}, "octets_per_s"),
        ({"kind": "line.babble", "octets_per_s": 900_000}, "allowed are 0.001 to"),
        ({"kind": "line.silence", "dirction": "both"}, "dirction"),
        ({"kind": "line.silence", "end_s": 1, "duration_s": 1}, "not both"),
        ({"kind": "line.silence", "start_s": 2, "end_s": 1}, "comes before"),
    ],
)
def test_a_bad_setting_is_told_in_one_line(settings: dict[str, Any], told: str) -> None:
    bench = started(False)
    with pytest.raises(ConfigurationError) as caught:
        bench.emulator.faults.inject(settings)
    text = str(caught.value)
    assert told in text
    assert "\n" not in text
    assert not bench.emulator.faults.all


@pytest.mark.parametrize("name", [name for name in SERIAL if name not in CAN])
def test_octets_are_of_a_serial_line(name: str) -> None:
    bench = started(True)
    with pytest.raises(
        ConfigurationError, match=r"for a unit on a serial line.*allowed are line.frames_lost"
    ):
        bench.emulator.faults.inject({"kind": name})
