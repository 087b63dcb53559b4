"""An invented unit behind a dialect made by following docs/adding_a_dialect.md: icd.md, line by line."""

from __future__ import annotations

import itertools
import math
import random
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path

import pytest

from hil_tests.dialects.demo_session import Session
from hil_tests.dialects.own.client import Client, checksum, sentence
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.journal import read_journal
from st_emulator.bench.scenario import InertialTrajectory, Scenario, ScenarioTelecommand, load_scenario
from st_emulator.commands.replaying import emulator_of, feed
from st_emulator.dialects.registry import dialect_of
from st_emulator.errors import ConfigurationError
from st_emulator.firmware_model.causes import FaultCause
from st_emulator.units.profile import UnitProfile, load_unit

PROJECT = Path(__file__).with_name("kst9_project")
UNIT = load_unit(str(PROJECT / "kst9_unit.toml"))
MS = 1_000_000
BOOT_MS = 400
RA_HOURS, DEC_DEG, ROLL_DEG = 5.6, -1.5, 340.0
SCENARIO = Scenario(
    trajectory=InertialTrajectory(ra_deg=RA_HOURS * 15, dec_deg=DEC_DEG, roll_deg=ROLL_DEG - 360)
)
WEEK, SECOND = 2401, 345618  # 2026-01-15T00:00:00Z: a Thursday, 18 leap seconds behind GPS


def octets_ns(count: int) -> int:
    return count * 10 * 10**9 // 57600


@dataclass
class Obc(Client):
    """A unit in virtual time with the client on its line."""

    profile: UnitProfile = UNIT
    scenario: Scenario = SCENARIO
    journal: StringIO = field(default_factory=StringIO)

    def __post_init__(self) -> None:
        self.emulator = Emulator(self.profile, self.scenario, transmit=self.take, journal=self.journal)

    def run(self, ms: float) -> list[str]:
        """What the unit says meanwhile."""
        self.heard.clear()
        self.emulator.advance(self.emulator.now_ns + round(ms * MS))
        return self.said

    def ask(self, *command: object, ms: float = 30, **more: str) -> list[str]:
        return self.put(sentence(*command, **more), ms)

    def put(self, octets: bytes, ms: float = 30) -> list[str]:
        self.emulator.receive(octets)
        return self.run(ms)


def unit_with(**settings: object) -> UnitProfile:
    return UNIT.model_copy(update={"dialects": {"kst9": {"letter": "B", **settings}}})


@pytest.fixture
def loader() -> Obc:
    """In the loader, between two of its sentences."""
    obc = Obc()
    obc.run(BOOT_MS + 50)
    return obc


@pytest.fixture
def obc(loader: Obc) -> Obc:
    """The application, idle and without attitudes at its own pace."""
    loader.ask("RUN", ms=100)
    loader.ask("PSH", 0)
    assert loader.ask("IDL") == ["ACK,IDL"]
    return loader


def test_the_checksum_is_that_of_sentences_known_elsewhere():
    """A GGA sentence as the manuals of navigation receivers print it."""
    assert checksum("GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,") == "47"


def test_the_loader_waits_for_run():
    obc = Obc()
    assert obc.run(BOOT_MS + 760) == ["LDR,0", "LDR,1", "LDR,2", "LDR,3"]
    assert obc.times_ns("LDR") == [
        (BOOT_MS + 250 * number) * MS + octets_ns(len("$KSBLDR,0*hh\r\n")) for number in range(4)
    ]
    assert obc.ask("VER") == ["VER,KST9,1.2"]
    assert obc.ask("SRH") == ["NAK,LD,SRH"]
    assert obc.ask("XYZ") == ["NAK,UK,XYZ"]
    begin_ns = obc.emulator.now_ns
    assert obc.ask("RUN", ms=100) == ["ACK,RUN", "RDY,1"]
    thought_ns = begin_ns + octets_ns(len("$KSBRUN*hh\r\n")) + MS
    assert obc.times_ns("RDY") == [thought_ns + 80 * MS + octets_ns(len("$KSBRDY,1*hh\r\n"))]
    assert obc.ask("RUN") == ["NAK,ST,RUN"]


def test_nothing_is_heard_while_the_application_starts(loader):
    assert loader.put(sentence("RUN"), 10) == ["ACK,RUN"]
    assert loader.ask("VER", ms=60) == []


def test_without_run_the_application_starts_by_itself():
    obc = Obc()
    assert obc.run(BOOT_MS + 5000 + 80 + 5) == [*(f"LDR,{number}" for number in range(20)), "RDY,1"]
    assert obc.times_ns("RDY") == [(BOOT_MS + 5080) * MS + octets_ns(len("$KSBRDY,1*hh\r\n"))]
    assert obc.run(994) == []
    obc.run(20)
    ((_, _, state, ra, *_),) = obc.of("ATT")  # a second after RDY
    assert state == "T"  # it searches by itself
    assert float(ra) == pytest.approx(RA_HOURS, abs=0.001)


def test_a_unit_without_loader():
    obc = Obc(profile=unit_with(loader=False))
    assert obc.run(BOOT_MS + 5) == ["RDY,1"]
    obc.run(900)
    assert obc.ask("POL", "STA")[0].startswith("STA,T,")


def test_an_attitude_in_hours_and_degrees(obc):
    assert obc.ask("TIM", WEEK, f"{SECOND + 0.0:.3f}", ms=300) == ["ACK,TIM", "DNE,TIM,OK"]
    assert obc.ask("SRH", ms=1500) == ["ACK,SRH", "DNE,SRH,OK"]
    (poll,) = obc.ask("POL", "ATT")
    week, second, state, ra, dec, roll, stars = poll.split(",")[1:]
    assert (week, state) == (str(WEEK), "T")
    assert int(stars) >= 5
    assert [len(number.split(".")[1]) for number in (second, ra, dec, roll)] == [3, 7, 6, 6]
    assert dec[0] == "-"
    cross = math.cos(math.radians(DEC_DEG)) * (float(ra) - RA_HOURS) * 15 * 3600
    assert abs(cross) < 3  # arcsec
    assert abs(float(dec) - DEC_DEG) * 3600 < 3
    assert abs(float(roll) - ROLL_DEG) * 3600 < 90  # over the small field, 30 times worse
    assert 0 < float(second) - SECOND < 3


def test_the_time_is_that_of_the_last_octet(obc):
    begin_ns = obc.emulator.now_ns
    command = sentence("TIM", WEEK, "1000.000")
    obc.put(command, 1500)
    obc.ask("SRH", ms=1500)
    obc.ask("IDL")  # so that no frame comes between the question and the look at the device
    (poll,) = obc.ask("POL", "ATT")
    second = float(poll.split(",")[2])
    middle_ns = obc.emulator.device.last_frame.mid_exposure_ns
    assert second == pytest.approx(1000 + (middle_ns - begin_ns - octets_ns(len(command))) / 1e9, abs=6e-4)


def test_the_pace_is_the_units_own(obc):
    obc.ask("SRH", ms=1000)
    assert obc.put(sentence("PSH", 3), 10) == ["ACK,PSH"]
    begin_ns = obc.times_ns("ACK")[0] - octets_ns(len("$KSBACK,PSH*hh\r\n"))
    obc.run(2000)
    lengths = [octets_ns(len(f"$KSB{text}*hh\r\n")) for text in obc.said]
    begun_ns = [t_ns - length for t_ns, length in zip(obc.times_ns("ATT"), lengths, strict=True)]
    assert begun_ns == [begin_ns + number * 300 * MS for number in range(1, 7)]  # frames come every 250 ms
    obc.ask("PSH", 600)
    assert obc.run(3000) == []


def test_no_attitude(obc):
    assert obc.ask("POL", "ATT") == ["ATT,,,I,,,,"]
    obc.ask("SRH", ms=1000)
    assert obc.ask("IDL") == ["ACK,IDL"]
    ((*_, ra, dec, roll, _stars),) = [text.split(",") for text in obc.ask("POL", "ATT")]
    assert [ra, dec, roll] == ["", "", ""]  # not the last one once more


def test_how_searches_end(obc):
    assert obc.ask("SRH") == ["ACK,SRH"]
    assert obc.ask("SRH") == ["ACK,SRH", "DNE,SRH,SU"]
    assert obc.ask("IDL") == ["ACK,IDL", "DNE,SRH,AB"]


def test_self_test(obc):
    assert obc.ask("TST", ms=700) == ["ACK,TST", *(f"PRG,TST,{step}" for step in (1, 2, 3, 4)), "DNE,TST,OK"]
    obc.ask("SRH")
    assert obc.ask("TST") == ["NAK,ST,TST"]


def test_exposure(obc):
    assert obc.ask("EXP", "80.5") == ["ACK,EXP"]
    assert obc.emulator.device.parameters["exposure_us"] == 80_500
    assert obc.ask("EXP", "251") == ["NAK,RG,EXP"]
    assert obc.ask("EXP", "1e300") == ["NAK,RG,EXP"]
    assert obc.ask("EXP", "nan") == ["NAK,RG,EXP"]
    assert obc.ask("EXP", "x") == ["NAK,FD,EXP"]
    assert obc.ask("EXP") == ["NAK,FD,EXP"]


def test_ranges(obc):
    assert obc.ask("PSH", 601) == obc.ask("PSH", "0.5") == obc.ask("PSH", -1) == ["NAK,RG,PSH"]
    assert obc.ask("TIM", WEEK, 604800) == obc.ask("TIM", 10_000, 0) == ["NAK,RG,TIM"]
    assert obc.ask("POL", "XXX") == ["NAK,RG,POL"]


def test_state(obc):
    (state,) = obc.ask("POL", "STA")
    assert state.split(",")[:3] == ["STA", "I", "200"]
    obc.put(b"$KSBVER*00\n")
    obc.emulator.device.enter_fault(FaultCause.COMMANDED)
    (state,) = obc.ask("POL", "STA")
    assert (state.split(",")[1], state.split(",")[-1]) == ("F", "1")
    assert obc.ask("SRH") == ["NAK,ST,SRH"]


GOOD = sentence("VER")
SAYS = "VER,KST9,1.2"
LINES = {
    "LF alone": (sentence("VER", end="\n"), [SAYS]),
    "small letters": (b"$KSBEXP,x*" + checksum("KSBEXP,x").lower().encode() + b"\n", ["NAK,FD,EXP"]),
    "joined": (GOOD * 3, [SAYS] * 3),
    "around": (b"VER*00\r\n\xff\0" + GOOD + b"\r\n\r\nabc", [SAYS]),
    "checksum": (b"$KSBVER*00\r\n" + GOOD, ["NAK,CS", SAYS]),
    "no checksum": (b"$KSBVER\r\n" + GOOD, ["NAK,FM", SAYS]),
    "half a checksum": (b"$KSBVER*4\r\n" + GOOD, ["NAK,FM", SAYS]),
    "a sign in it": (b"$KSBVER*+4\r\n" + GOOD, ["NAK,FM", SAYS]),
    "head": (b"$GPB*" + checksum("GPB").encode() + b"\r\n" + GOOD, ["NAK,FM", SAYS]),
    "cut off": (GOOD[:6] + GOOD, ["NAK,FM", SAYS]),
    "not printable": (b"$KSB\x07VER*00\r\n" + GOOD, ["NAK,FM", SAYS]),
    "not ASCII": (b"$KSB\xe9VER*00\r\n" + GOOD, ["NAK,FM", SAYS]),
    "CR inside": (b"$KSB\rVER*00\r\n" + GOOD, ["NAK,FM", SAYS]),
    "two CR": (GOOD[:-1] + b"\r\n" + GOOD, ["NAK,FM", SAYS]),
    "too long": (b"$" + b"x" * 300 + b"\r\n" + GOOD, ["NAK,LN", SAYS]),
    "another's": (sentence("VER", unit="C") + GOOD, [SAYS]),
    "a field too many": (sentence("VER", 1), ["NAK,FD,VER"]),
}


@pytest.mark.parametrize("name", LINES)
def test_lines(name, obc):
    octets, says = LINES[name]
    assert obc.put(octets, 120) == says
    said = [text for octet in octets for text in obc.put(bytes([octet]), 0.2)]
    assert said + obc.run(120) == says


def test_the_longest_line(obc):
    body = "KSBXYZ," + "x" * 70
    assert obc.put(f"${body}*{checksum(body)}\n".encode()) == ["NAK,UK,XYZ"]
    assert obc.put(f"${body}x*{checksum(body + 'x')}\n".encode()) == ["NAK,LN"]


def test_reset(obc):
    obc.ask("TIM", WEEK, 0, ms=300)
    assert obc.put(GOOD * 5 + sentence("RST") + GOOD, 60) == [SAYS] * 5 + ["ACK,RST"]
    assert obc.run(BOOT_MS - 30)[:1] == ["LDR,0"]
    obc.ask("RUN", ms=100)
    assert "RDY,2" in obc.said
    obc.run(1500)
    assert obc.of("ATT")[-1][:3] == ["", "", "T"]  # the time is lost


def test_power_goes_while_it_searches(obc):
    obc.ask("PSH", 1)
    obc.ask("SRH", ms=5)
    obc.emulator.device.power_off()
    obc.run(20)
    assert obc.run(1000) == []
    obc.emulator.device.power_on()
    assert obc.run(BOOT_MS + 260) == ["LDR,0", "LDR,1"]


def test_scenario_and_replay(tmp_path):
    obc = Obc(scenario=load_scenario(PROJECT / "kst9_scenario.toml"))
    said = obc.run(3000)
    assert said[:5] == ["LDR,0", "ACK,RUN", "RDY,1", "ACK,PSH", said[4]]
    assert "NAK,CS" in said
    obc.emulator.close()
    path = tmp_path / "journal.jsonl"
    path.write_text(obc.journal.getvalue())
    again = StringIO()
    emulator = emulator_of(read_journal(path), str(PROJECT / "journal.jsonl"), journal=again)
    feed(emulator, read_journal(path))
    emulator.close()
    assert again.getvalue().splitlines()[1:] == obc.journal.getvalue().splitlines()[1:]


@pytest.mark.parametrize(
    ("name", "fields", "says"),
    [
        ("run", {}, "name = 'run'; allowed: RUN, VER, SRH"),
        ("PSH", {}, r"PSH: fields = \[\]; allowed: ds"),
        ("PSH", {"ds": "1*"}, r"PSH: ds = '1\*'; allowed: printable ASCII"),
    ],
)
def test_telecommands_of_a_scenario_that_are_wrong(name, fields, says):
    scenario = Scenario(telecommands=[ScenarioTelecommand(at_s=1, name=name, fields=fields)])
    with pytest.raises(ConfigurationError, match=says):
        Obc(scenario=scenario)


def test_the_exchange_of_the_demo():
    session = Session(UNIT)
    dialect_of(UNIT).exchange(session)
    assert list(session.checks) == ["ready", "attitudes", "declination"]
    assert all(session.checks.values()), session.said
    deaf = Session(UNIT, deaf=True)
    dialect_of(UNIT).exchange(deaf)
    assert list(deaf.checks.values()) == [False, False]


def mutate(count: int, seed: int) -> int:
    """Feed so many octets of damaged traffic; the unit goes on and answers the next good command. Returns how
    often that was looked at."""
    chance = random.Random(seed)
    obc = Obc()
    obc.run(BOOT_MS + 50)
    for command in (("RUN",), ("PSH", 0), ("IDL",)):
        obc.ask(*command, ms=100)
    commands = [("VER",), ("POL", "STA"), ("EXP", "99.5"), ("TIM", WEEK, 1), ("PSH", 0)]
    good = [sentence(*command) for command in commands]
    octets = looked = 0
    for number in itertools.count():
        traffic = bytearray(b"".join(chance.choices(good, k=chance.randint(1, 6))))
        for _ in range(chance.randint(0, 4)):
            place = chance.randrange(len(traffic) + 1)
            traffic[place : place + chance.randint(0, 3)] = chance.randbytes(chance.randint(0, 3))
        octets += len(traffic)
        obc.put(bytes(traffic), 50)
        if number % 20 == 0:
            looked += 1
            obc.put(b"\n", 100)
            assert obc.put(GOOD).count(SAYS) == 1  # and perhaps the end of a TIM
            if octets > count:
                return looked
    raise AssertionError


def test_mutated_traffic():
    assert mutate(20_000, seed=1) > 10
