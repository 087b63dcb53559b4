"""Two runs give the same octets at the same times; so does a replay of the journal; whatever the steps."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from hil_tests.dialects.nos3 import client
from hil_tests.dialects.nos3.bench import MS, make, unit
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.journal import JournalEntry, read_journal
from st_emulator.bench.scenario import parse_scenario
from st_emulator.bench.scenario_inputs import check_inputs
from st_emulator.commands.replaying import emulator_of, feed, first_difference
from st_emulator.errors import ConfigurationError

SCENARIO = """
schema = 1
name = "nos3"
[trajectory]
kind = "constant_rate"
ra_deg = 83.0
dec_deg = -3.0
rate_deg_s = [0.0, 0.1, 0.2]
[[telecommands]]
at_s = 0.1
name = "noop"
[[telecommands]]
at_s = 1.5
name = "data"
[[telecommands]]
at_s = 0.6
name = "housekeeping"
fields = { payload = "0x1F" }
[[telecommands]]
at_s = 1.5
raw_hex = "00dead0200000000beefdead"
[[telecommands]]
at_s = 1.6
name = "config"
fields = { payload = 3 }
[[telecommands]]
at_s = 2.0
name = "housekeeping"
"""
END_NS = 2300 * MS


def run(step_ns: int, **settings: object) -> tuple[str, bytes]:
    journal = io.StringIO()
    sent = bytearray()
    emulator = Emulator(
        unit("roja1", **settings),
        parse_scenario(SCENARIO, "nos3"),
        journal=journal,
        transmit=lambda data, t_ns: sent.extend(data),
    )
    while emulator.now_ns < END_NS:
        emulator.advance(min(emulator.now_ns + step_ns, END_NS))
    emulator.close()
    return journal.getvalue(), bytes(sent)


def test_a_scenarios_telecommands():
    _, sent = run(END_NS)
    commands = [
        ("housekeeping", client.command("housekeeping", 0x1F)),
        ("data", client.command("data")),
        ("data", client.command("data")),
        # config is unknown; noop came while the unit booted
        ("housekeeping", client.command("housekeeping")),
    ]
    decoder = client.Decoder(octets=bytearray(sent))
    answers = decoder.answers(commands)
    assert not decoder.octets
    counts = [answer.reply["count"] for answer in (answers[0], answers[3]) if answer.reply]
    assert counts == [1, 8]
    assert answers[1].reply is not None
    assert answers[1].reply["valid"] == 1


@pytest.mark.parametrize("step_ms", [0.37, 250])
def test_two_runs_give_the_same_journal_whatever_the_steps(step_ms):
    assert run(END_NS) == run(round(step_ms * MS))


@pytest.mark.parametrize("settings", [{}, {"reception": "callback", "reply_delay_us": 3000}])
def test_a_replay_gives_the_same(tmp_path: Path, settings):
    path = tmp_path / "journal.jsonl"
    path.write_text(run(END_NS, **settings)[0])
    journal = read_journal(path)
    recorded = [entry for entry in journal.entries if entry.direction == "tx"]
    assert len(recorded) > 5
    replayed: list[JournalEntry] = []
    emulator = emulator_of(
        journal, str(path), transmit=lambda data, t_ns: replayed.append(JournalEntry(t_ns, "tx", data))
    )
    feed(emulator, journal)
    assert first_difference(recorded, replayed) is None
    del replayed[-1]
    assert first_difference(recorded, replayed) is not None


@pytest.mark.parametrize(
    ("telecommand", "said"),
    [
        ('name = "datum"', "datum'; allowed: noop, housekeeping, data, config"),
        ('name = "config"\nfields = { value = 1 }', "config: value = 1; allowed: payload alone"),
        ('name = "config"\nfields = { payload = -1 }', "from 0 to 4294967295"),
        ('name = "config"\nfields = { payload = "ten" }', "payload = 'ten'; allowed: a whole number"),
    ],
)
def test_a_wrong_telecommand_is_told_before_the_run(telecommand, said):
    scenario = parse_scenario(f'schema = 1\nname = "wrong"\n[[telecommands]]\nat_s = 1\n{telecommand}\n', "x")
    with pytest.raises(ConfigurationError, match=r"telecommands\.0") as error:
        check_inputs(unit(), scenario)
    assert said in str(error.value)


def test_the_seed_decides_nothing_of_the_line_but_the_noise_of_the_attitude():
    groups = []
    for seed in (1, 2):
        bench = make(unit(autonomous=False), seed=seed).boot()
        bench.put(client.command("data"))
        bench.run(20)
        groups.append(bench.groups)
    assert groups[0] == groups[1]
