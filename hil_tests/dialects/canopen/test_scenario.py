"""Telecommands of a scenario, the demo's exchange, the settings, the document."""

from __future__ import annotations

from pathlib import Path

import pytest
from rich.console import Console

from hil_tests.dialects.canopen.bench import make, unit
from hil_tests.dialects.canopen.client import STATES
from hil_tests.dialects.demo_session import Session
from st_emulator.bench.journal import read_journal
from st_emulator.bench.scenario import Scenario, ScenarioTelecommand
from st_emulator.bench.scenario_inputs import check_inputs
from st_emulator.commands.replaying import replay_journal
from st_emulator.commands.running import RunOptions, run_unit
from st_emulator.commands.warm_up import warm_up
from st_emulator.dialects.canopen.definition import CANOPEN
from st_emulator.dialects.registry import SHIPPED, settings_of
from st_emulator.errors import ConfigurationError
from st_emulator.wire.can.wiring import CanWiring

SCENARIO = """schema = 1
name = "by the command line"

[[telecommands]]
at_s = 0.6
name = "status"
fields = { state = "STAR_TRACK" }
"""
DOCUMENT = Path(__file__).parents[3] / "docs" / "dialects" / "canopen.md"


def scenario(*telecommands: tuple[float, str, dict]) -> Scenario:
    return Scenario(
        telecommands=[
            ScenarioTelecommand(at_s=at_s, name=name, fields=fields) for at_s, name, fields in telecommands
        ]
    )


@pytest.mark.parametrize("node", [None, 9])
def test_a_scenario_by_names(node):
    found = scenario(
        (0.5, "nmt", {"command": "START"}),
        (0.6, "time", {"utc": "2026-01-15T00:00:00.600Z"}),
        (0.7, "write", {"object": "capture.delay", "value": 500}),
        (0.8, "write", {"object": "utc", "value": 20468}),  # 8 octets: segmented
        (1.0, "status", {"state": "STAR_TRACK"}),
        (2.9, "read", {"object": "status"}),
        (3.0, "sync", {}),
        (3.1, "frame", {"identifier": 0x62C if node is None else 0x609, "data_hex": "4017100000000000"}),
        (3.2, "status", {"state": 2}),
        (3.3, "nmt", {"command": "STOP"}),
    )
    bench = make(scenario=found, can=CanWiring(node=node))
    bench.run(4000)
    assert len(bench.attitudes) >= 3
    answers = [data for _, data in bench.of(0x580 + bench.node)]
    assert bytes.fromhex("4f 0040 00 04 000000") in answers
    assert bytes.fromhex("4b 1710 00 e803 0000") in answers
    assert [data[:1].hex() for data in answers[:4]] == ["60", "60", "20", "30"]  # delay; utc by two segments
    day_s = 20468 * 86400
    assert day_s <= bench.attitudes[-1].since_midnight <= day_s + 5
    assert bench.emulator.device.mode.name == "STANDBY"
    assert bench.exchange(bytes.fromhex("4000400000000000")) == []  # stopped


def test_raw_octets():
    raw = "0000062c08000000" + "2f00400004000000"
    found = Scenario(telecommands=[ScenarioTelecommand(at_s=0.5, raw_hex=raw)])
    bench = make(scenario=found)
    bench.run(1500)
    assert bench.attitudes


@pytest.mark.parametrize(
    ("name", "fields", "said"),
    [
        ("fly", {}, "nmt, sync, time"),
        ("nmt", {"command": "JUMP"}, "RESET_NODE"),
        ("nmt", {"command": "START", "node": 200}, "1 to 127"),
        ("nmt", {}, "missing"),
        ("sync", {"x": 1}, "no fields"),
        ("status", {"state": "FLYING"}, "STAR_TRACK"),
        ("status", {"state": 256}, "0 to 255"),
        ("write", {"object": "capture.delay", "value": -1}, "0 to 4294967295"),
        ("write", {"object": "system.reset", "value": 5}, "0 to 4"),
        ("write", {"object": "system.uptime", "value": 1}, "capture.delay"),
        ("read", {"object": "system.reset"}, "system.uptime"),
        ("time", {"utc": "yesterday"}, "2026-01-15T00:00:00Z"),
        ("time", {"utc": "2026-01-15T00:00:00"}, "with its zone"),
        ("frame", {"identifier": 1, "data_hex": "xx"}, "8 octets"),
    ],
)
def test_telecommands_that_cannot_be(name, fields, said):
    with pytest.raises(ConfigurationError, match=said):
        check_inputs(unit(), scenario((1.0, name, fields)))


@pytest.mark.parametrize(
    "wrong", [{"node": 0}, {"node": 128}, {"quirk": 1}, {"boresight": "y"}, {"sdo_timeout_ms": 1}]
)
def test_settings_that_cannot_be(wrong):
    with pytest.raises(ConfigurationError, match="canopen"):
        settings_of(unit(**wrong))


@pytest.mark.parametrize("name", ["roja1", "zy3"])
def test_the_exchange_of_the_demo(name):
    session = Session(unit(name), can=CanWiring())
    CANOPEN.exchange(session)
    assert len(session.checks) == 8
    assert all(session.checks.values()), session.checks
    assert len(session.said) > 10
    assert session.emulator.dialect.card.state == STATES["STANDBY"]


def test_the_exchange_notices_a_unit_that_says_nothing():
    session = Session(unit(), can=CanWiring())
    session.emulator.device.power_off()
    CANOPEN.exchange(session)
    assert not session.checks["boot-up messages"]
    assert not session.checks["image is a PNG"]


def test_the_document_is_fresh():
    assert DOCUMENT.read_text(encoding="utf-8") == CANOPEN.document()


def test_kernels_are_warmed_up_whatever_the_unit_speaks():
    warm_up(unit())


def test_a_run_without_an_obc_and_its_replay(tmp_path, capsys):
    found = tmp_path / "scenario.toml"
    found.write_text(SCENARIO)
    journal = tmp_path / "journal.jsonl"
    options = RunOptions(
        unit="roja1", dialect="canopen", scenario=found, speed="max", seconds=2.0, journal=journal
    )
    run_unit(options)
    entries = read_journal(journal).entries
    assert {entry.direction for entry in entries} == {"rx", "tx"}
    assert len(entries) > 12
    assert replay_journal(journal, None, None, Console()) == 0


def test_it_is_shipped():
    assert CANOPEN in SHIPPED
