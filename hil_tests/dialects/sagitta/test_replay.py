"""The same run gives the same octets: twice, and from its journal."""

from __future__ import annotations

import io
from pathlib import Path

from hil_tests.dialects.sagitta import client
from hil_tests.dialects.sagitta.bench import Bench, unit
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.journal import read_journal
from st_emulator.bench.scenario import Scenario, ScenarioTelecommand
from st_emulator.commands.replaying import emulator_of, feed

SCENARIO = Scenario(telecommands=[ScenarioTelecommand(at_s=3.0, name="request_power")])


def run(journal: io.StringIO) -> list[tuple[int, bytes]]:
    bench = Bench(unit(), SCENARIO, journal=journal).boot()
    bench.set_time()
    bench.subscribe(24, 27, 37)
    for id_ in client.TELEMETRY_BODY_BYTES:
        bench.telemetry(id_)
    bench.status(client.SET, 9, client.camera(0.05))
    bench.run(1500)
    assert any(frame.id == client.POWER for frame in bench.frames)
    bench.emulator.close()
    return bench.groups


def test_two_runs_and_a_replay_are_the_same(tmp_path: Path) -> None:
    text, other = io.StringIO(), io.StringIO()
    groups = run(text)
    assert run(other) == groups
    assert other.getvalue() == text.getvalue()
    path = tmp_path / "journal.jsonl"
    path.write_text(text.getvalue(), encoding="utf-8")
    journal = read_journal(path)
    replayed: list[tuple[int, bytes]] = []
    emulator: Emulator = emulator_of(
        journal, str(path), transmit=lambda data, t_ns: replayed.append((t_ns, data))
    )
    feed(emulator, journal)
    assert replayed == groups
