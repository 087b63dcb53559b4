"""The template of a dialect of one's own works: every message, against octets made with struct alone."""

from __future__ import annotations

import binascii
import math
import random
import struct
from dataclasses import dataclass, field
from io import StringIO
from typing import Any

import pytest

from hil_tests.architecture.source_tree import ROOT, Source, module_of
from hil_tests.dialects.demo_session import Session
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.journal import read_journal
from st_emulator.bench.scenario import Scenario, ScenarioTelecommand, load_scenario
from st_emulator.commands.replaying import emulator_of, feed
from st_emulator.dialects.registry import dialect_of
from st_emulator.errors import ConfigurationError
from st_emulator.firmware_model.causes import FaultCause
from st_emulator.units.profile import UnitProfile, load_unit

TEMPLATE = ROOT / "examples/my_dialect"
UNIT = load_unit(str(TEMPLATE / "my_unit.toml"))
MS = 1_000_000
OCTET_NS = 10 * 10**9 // 115200
STATUS, FIND, STOP, RESTART, EVERY = 1, 2, 3, 4, 5
LATENCY_NS = 500_000  # telecommand_latency_us of the unit file


def frame(number: int, payload: bytes = b"", address: int = 7) -> bytes:
    body = struct.pack("<BBB", address, number, len(payload)) + payload
    return b"\xa5\x5a" + body + struct.pack("<H", binascii.crc_hqx(body, 0xFFFF))


def answer(command: int, refusal: int = 0) -> bytes:
    return frame(0x81, bytes([command, refusal]))


def done(command: int, failure: int = 0) -> bytes:
    return frame(0x82, bytes([command, failure]))


def status(mode: int, valid: int, boots: int, bad: int) -> bytes:
    return frame(0x83, struct.pack("<BBHH", mode, valid, boots, bad))


STARTED = frame(0x85, b"\x01\x00")


@dataclass
class Unit:
    """The unit in virtual time, and what it has sent."""

    profile: UnitProfile = UNIT
    scenario: Scenario | None = None
    journal: StringIO = field(default_factory=StringIO)
    sent: bytes = b""
    times_ns: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.emulator = Emulator(self.profile, self.scenario, transmit=self.transmitted, journal=self.journal)

    def transmitted(self, data: bytes, t_ns: int) -> None:
        self.sent += data
        self.times_ns.append(t_ns)

    def run(self, ms: float) -> bytes:
        """What it sends meanwhile."""
        self.sent = b""
        self.emulator.advance(self.emulator.now_ns + round(ms * MS))
        return self.sent

    def ask(self, octets: bytes, ms: float = 20) -> bytes:
        self.emulator.receive(octets)
        return self.run(ms)

    def attitudes(self) -> list[tuple[Any, ...]]:
        """The attitude messages in what it sent last."""
        size = 2 + 3 + 29 + 2
        starts = [n for n in range(len(self.sent)) if self.sent[n : n + 5] == b"\xa5\x5a\x07\x84\x1d"]
        whole = [self.sent[n : n + size] for n in starts]
        assert all(item == frame(0x84, item[5:-2]) for item in whole)
        return [struct.unpack("<IQB4f", item[5:-2]) for item in whole]


def settings(**values: int) -> UnitProfile:
    return UNIT.model_copy(update={"dialects": {"my_dialect": values}})


@pytest.fixture
def unit() -> Unit:
    """Started."""
    made = Unit()
    assert made.run(410) == STARTED
    return made


def angle_arcsec(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    x, y, z, w = one
    a, b, c, d = other
    # The vector part of conj(one) * other, which is exact for small angles whatever the rounding of a norm.
    vector = (w * a - x * d - y * c + z * b, w * b + x * c - y * d - z * a, w * c - x * b + y * a - z * d)
    return math.degrees(2 * math.asin(min(1.0, math.hypot(*vector)))) * 3600


def test_the_angle_of_this_test():
    half = math.radians(30 / 3600) / 2
    turned = (0.0, math.sin(half), 0.0, math.cos(half))
    assert angle_arcsec((0.0, 0.0, 0.0, 1.0), turned) == pytest.approx(30)
    assert angle_arcsec((0.0, 0.0, 0.0, -1.0), turned) == pytest.approx(30)
    assert angle_arcsec(turned, turned) < 1e-9
    assert angle_arcsec((0.5, 0.5, 0.5, 0.5), (0.5, -0.5, 0.5, 0.5)) == pytest.approx(432_000)


def test_a_command_its_completion_and_attitudes_that_are_true(unit):
    assert unit.ask(frame(FIND)) == answer(FIND)
    unit.run(2000)
    assert done(FIND) in unit.sent
    attitudes = unit.attitudes()
    valid = [values for values in attitudes if values[2] == 1]
    assert len(valid) >= 6
    assert [values[0] for values in valid] == list(range(valid[0][0], valid[-1][0] + 1))
    for _, time_us, _, *found in valid:
        truth = unit.emulator.scene.trajectory.q_icrs_to_sensor(time_us * 1000)
        assert angle_arcsec(tuple(found), tuple(truth)) < 40  # 20.5 of them aberration: the time is not set
    assert unit.ask(frame(STATUS)) == status(4, 1, 1, 0)
    assert unit.ask(frame(STOP)) == answer(STOP) + done(STOP)
    assert unit.ask(frame(STATUS)) == status(2, 0, 1, 0)


def test_a_command_that_another_one_ends(unit):
    unit.ask(frame(FIND))
    assert unit.ask(frame(FIND)) == answer(FIND) + done(FIND, 1)  # superseded
    assert unit.ask(frame(STOP)) == answer(STOP) + done(FIND, 2) + done(STOP)  # aborted


def test_refusals(unit):
    assert unit.ask(frame(0x44)) == answer(0x44, 1)
    assert unit.ask(frame(0x85, b"\x01\x00")) == answer(0x85, 1)  # telemetry is no command
    assert unit.ask(frame(FIND, b"\x00")) == answer(FIND, 2)
    unit.emulator.device.enter_fault(FaultCause.COMMANDED)
    assert unit.ask(frame(FIND)) == answer(FIND, 3)  # not in this mode
    assert unit.ask(frame(STATUS, address=8)) == b""  # another unit's
    assert unit.ask(frame(STATUS)) == status(5, 0, 1, 0)


def test_the_answer_leaves_after_the_latency(unit):
    begin_ns = unit.emulator.now_ns
    unit.times_ns.clear()
    unit.ask(frame(STATUS))
    first_group_ns = 16 * 10 * 10**9 // 115200
    assert unit.times_ns[-1] == begin_ns + 7 * 10 * 10**9 // 115200 + LATENCY_NS + 13 * 10**10 // 115200
    assert first_group_ns > 13 * OCTET_NS  # it is one group


def test_how_often(unit):
    assert unit.ask(frame(EVERY, b"\x03")) == answer(EVERY)
    unit.ask(frame(FIND))
    unit.run(2500)
    indices = [values[0] for values in unit.attitudes()]
    assert len(indices) >= 3
    assert all(index % 3 == 0 for index in indices)
    unit.ask(frame(EVERY, b"\x00"))
    assert unit.run(600) == b""


def test_settings():
    unit = Unit(settings(address=254, attitude_every=0))
    assert unit.run(410) == frame(0x85, b"\x01\x00", 254)
    assert unit.emulator.dialect.where() == "115200 baud, address 254"
    unit.ask(frame(FIND, address=254))
    assert unit.run(1000) == frame(0x82, bytes([FIND, 0]), 254)  # no attitudes


CUTS = (1, 2, 3, 5, 7, 8)


@pytest.mark.parametrize("cut", CUTS)
def test_frames_are_found_however_they_are_cut_and_joined(unit, cut):
    octets = b"\xa5" + frame(STATUS) + b"\x00\xa5\xa5" + frame(STATUS) * 2 + b"\xff"
    sent = b""
    for start in range(0, len(octets), cut):
        sent += unit.ask(octets[start : start + cut], ms=2)
    assert sent + unit.run(20) == status(2, 0, 1, 0) * 3


def test_bad_frames_are_counted_and_nothing_behind_them_is_lost(unit):
    wrong = bytearray(frame(STATUS))
    wrong[-1] ^= 1
    assert unit.ask(bytes(wrong) + frame(STATUS)) == status(2, 0, 1, 1)
    assert unit.ask(b"\xa5\x5a\x07\x01\x21" + frame(STATUS)) == status(2, 0, 1, 2)  # too long
    assert unit.ask(b"\xa5\x5a\x07\x01\x20" + frame(STATUS), ms=10) == b""  # waits for 32 octets and the CRC
    assert unit.run(10) == status(2, 0, 1, 3)  # given up 10 ms after the last octet


def test_a_restart_lets_the_line_run_empty_and_forgets(unit):
    unit.ask(frame(EVERY, b"\x00"))
    sent = unit.ask(frame(STATUS) * 4 + frame(RESTART) + frame(STATUS), ms=30)
    assert sent == status(2, 0, 1, 0) * 4 + answer(RESTART)  # and none behind it
    assert unit.run(300) == b""  # the boot takes 400 ms
    assert unit.ask(frame(STATUS), ms=90) == frame(0x85, b"\x02\x00")  # nobody listens yet
    assert unit.ask(frame(STATUS)) == status(2, 0, 2, 0)
    unit.ask(frame(FIND))
    unit.run(1000)
    assert unit.attitudes()  # as the settings say


def test_power_goes_and_comes(unit):
    unit.emulator.receive(frame(STATUS))
    unit.run(0.7)
    unit.emulator.device.power_off()
    assert unit.ask(frame(STATUS), ms=500) == b""
    unit.emulator.device.power_on()
    assert unit.run(410) == frame(0x85, b"\x02\x00")


def test_a_full_line_loses_telemetry_and_goes_on():
    slow = UNIT.model_copy(update={"wire": UNIT.wire.model_copy(update={"baud": 1200})})
    unit = Unit(slow)
    unit.run(500)
    for _ in range(300):
        unit.ask(frame(STATUS), ms=60)
    assert unit.emulator.dialect.messages_received == 300
    assert unit.emulator.dialect.messages_sent < 270
    assert unit.emulator.dialect.drain_ns() <= 1024 * 10**10 // 1200
    unit.run(10_000)
    assert unit.ask(frame(STATUS), ms=300) == status(2, 0, 1, 0)


def test_its_work_counts_into_a_frame(unit):
    unit.emulator.dialect.take_work()
    unit.emulator.receive(frame(STATUS))
    unit.emulator.advance(unit.emulator.now_ns + 5 * MS)
    counts = {name: count for name, count in unit.emulator.dialect.take_work().counts.items() if count}
    assert counts == {
        "telecommand_bytes": 7,
        "telecommands": 1,
        "crc_bytes": 5 + 13,
        "telemetry_bytes": 13,
        "sending_rounds": 1,
        "receiving_rounds": 1,
    }
    assert not any(unit.emulator.dialect.take_work().counts.values())


def test_the_scenario_and_its_replay(tmp_path):
    unit = Unit(scenario=load_scenario(TEMPLATE / "my_scenario.toml"))
    sent = unit.run(3000)
    assert sent.startswith(STARTED + answer(FIND))
    assert answer(EVERY) in sent
    assert unit.emulator.dialect.messages_received == 3
    unit.emulator.close()
    path = tmp_path / "journal.jsonl"
    path.write_text(unit.journal.getvalue())
    journal = read_journal(path)
    assert journal.bytes_of("rx") == frame(FIND) + frame(EVERY, b"\x02") + b"\xa5\x5a\x07\x01\0\0\0"
    again = StringIO()
    # The unit in a journal has no file of its own: the module lies beside the journal, or on the path.
    replayed = emulator_of(journal, str(TEMPLATE / "journal.jsonl"), journal=again)
    feed(replayed, journal)
    replayed.close()
    assert again.getvalue().split("\n", 1)[1] == unit.journal.getvalue().split("\n", 1)[1]


@pytest.mark.parametrize(
    ("name", "fields", "says"),
    [
        ("acquire", {}, "name = 'acquire'; allowed: get_status, find_attitude"),
        ("answer", {}, "name = 'answer'"),
        ("report_every", {}, r"report_every: fields = \[\]; allowed: frames"),
        ("stop", {"x": 1}, r"stop: fields = \['x'\]; allowed: none"),
        ("report_every", {"frames": 256}, "report_every: fields = {'frames': 256}; allowed: ubyte format"),
        ("report_every", {"frames": "x"}, "report_every: fields"),
    ],
)
def test_telecommands_of_a_scenario_that_are_wrong(name, fields, says):
    scenario = Scenario(telecommands=[ScenarioTelecommand(at_s=1, name=name, fields=fields)])
    with pytest.raises(ConfigurationError, match=says):
        Unit(scenario=scenario)


def test_the_exchange_of_the_demo():
    exchange = dialect_of(UNIT).exchange
    session = Session(UNIT)
    exchange(session)
    assert all(session.checks.values()), session.checks
    assert {"started", "completed", "attitude error"} <= set(session.checks)
    assert any("arcsec from the truth" in line for line in session.said)
    deaf = Session(UNIT, deaf=True)
    exchange(deaf)
    failed = [name for name, holds in deaf.checks.items() if not holds]
    assert failed == ["answered", "completed", "attitudes"]


def mutate(count: int, seed: int) -> int:
    """Feed so many octets of damaged traffic; the unit goes on and answers the next good command. Returns how
    often that was looked at."""
    chance = random.Random(seed)
    unit = Unit(settings(attitude_every=0))
    unit.run(410)
    good = [frame(STATUS), frame(STOP), frame(EVERY, b"\x00"), frame(0x44, b"\x01\x02"), frame(FIND, b"x")]
    octets = looked = 0
    while octets < count:
        traffic = bytearray(b"".join(chance.choices(good, k=chance.randint(1, 6))))
        for _ in range(chance.randint(0, 4)):
            place = chance.randrange(len(traffic) + 1)
            traffic[place : place + chance.randint(0, 3)] = chance.randbytes(chance.randint(0, 3))
        octets += len(traffic)
        unit.ask(bytes(traffic), ms=20)
        if chance.random() < 0.05:
            looked += 1
            unit.run(30)
            assert unit.ask(frame(STATUS)).startswith(b"\xa5\x5a\x07\x83\x06\x02\x00\x01\x00")
    return looked


def test_mutated_traffic():
    assert mutate(20_000, seed=1) > 20


def test_the_template_uses_public_names_of_few_modules():
    import ast

    allowed = {
        "st_emulator.clock",
        "st_emulator.device.commands",
        "st_emulator.device.reports",
        "st_emulator.device.star_tracker",
        "st_emulator.dialects.dialect",
        "st_emulator.firmware_model.link_work",
        "st_emulator.dialects.line_sender",
        "st_emulator.firmware_model.work",
        "st_emulator.protocol.errors",
        "st_emulator.units.profile",
        "st_emulator.units.validation",
        "st_emulator.wire.can.wiring",
        "st_emulator.wire.serial_line",
    }
    used = set()
    for path in sorted((TEMPLATE / "my_dialect").glob("*.py")):
        tree = ast.parse(path.read_text())
        source = Source(path.name, module_of(path), tree, 0)
        for name in source.imports():
            if name.startswith("st_emulator"):
                assert not any(part.startswith("_") for part in name.split(".")), name
                used.add(name)
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and node.attr.startswith("_"):
                assert ast.unparse(node.value) in ("self", "self._dialect"), ast.unparse(node)
    modules = {name for name in used if (ROOT / (name.replace(".", "/") + ".py")).exists()}
    assert modules == allowed


def test_the_unit_file_is_that_of_a_shipped_unit():
    shipped = load_unit("roja1").model_dump()
    mine = UNIT.model_dump()
    differs = {name for name in shipped if shipped[name] != mine[name]}
    assert differs - {"can"} == {"unit", "wire", "dialects"}
