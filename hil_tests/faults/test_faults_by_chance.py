"""Any faults with any settings at any time: nothing is uncaught, the same run is the same."""

from __future__ import annotations

import gc
import io
import json
import random
import weakref
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil_tests.unit.conftest import MODE, Bench, make
from hil_tests.unit.test_life_at_random import TELECOMMANDS
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.journal import read_journal
from st_emulator.bench.scenario import Scenario
from st_emulator.commands.replaying import emulator_of, feed
from st_emulator.errors import ConfigurationError
from st_emulator.faults.catalogue import FAULTS
from st_emulator.faults.chance import kinds_of, settings_by_chance
from st_emulator.units.profile import load_unit
from st_emulator.wire.can.wiring import CanWiring

QUICK = {"timing": {"boot_ms": 30}}
OWN = ("memory", "clock", "power")


def run(
    seed: int, on_can: bool, seams: tuple[str, ...] = (), journal: io.StringIO | None = None, faults: int = 6
) -> Bench:
    """Some seconds with faults and telecommands by chance; they all end."""
    chance = random.Random(seed)
    wiring = {"can": CanWiring()} if on_can else {}
    scenario = Scenario(parameters={"autonomous_start": 1}, seed=seed)
    bench = make("roja1", scenario=scenario, journal=journal, **QUICK, **wiring)
    bench.broken = []
    kinds = kinds_of("can" if on_can else "serial", "pus", seams)
    bench.run(chance.choice([0, 10, 1500]))
    for _ in range(faults):
        table = settings_by_chance(chance.choice(kinds), chance)
        table["duration_s"] = round(chance.choice([0.05, 0.3, 1.0]) * chance.random(), 3) + 0.001
        if chance.random() < 0.3:
            table["start_s"] = bench.emulator.now_ns / 1e9 + round(chance.random(), 3)
        try:
            number = bench.emulator.faults.inject(table)
        except ConfigurationError:
            continue  # settings that may not stand together
        if chance.random() < 0.5:
            name, fields = chance.choice(TELECOMMANDS)
            bench.send(name, fields)
        bench.run(chance.choice([0, 7, 130, 700]))
        if chance.random() < 0.3:
            bench.emulator.faults.clear(number)
    bench.run(2200)
    assert bench.emulator.faults.active() == []
    return bench


def works(bench: Bench) -> None:
    """A start from the power supply, whatever was before: the unit does what it is there for."""
    device = bench.emulator.device
    device.power_off()
    device.parameters.restore_defaults()
    device.power_on()
    bench.run(2500)  # transfers that were cut have run out
    bench.function("START_ACQUISITION", ack=0)
    bench.run(1500)
    assert device.mode == MODE["TRACKING"]


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(seed=st.integers(0, 2**32), on_can=st.booleans())
def test_any_of_them_together(seed: int, on_can: bool) -> None:
    works(run(seed, on_can))


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(seed=st.integers(0, 2**32), on_can=st.booleans())
def test_memory_clock_and_power_together(seed: int, on_can: bool) -> None:
    works(run(seed, on_can, OWN, faults=12))


@pytest.mark.parametrize("kind", FAULTS)
def test_settings_drawn_by_chance_are_good_ones(kind: str) -> None:
    """Nearly always: some may not stand together."""
    from st_emulator.faults.faults import settings_of

    chance, refused = random.Random(1), 0
    for _ in range(100):
        table = settings_by_chance(FAULTS[kind], chance)
        try:
            settings_of(table, "fault")
        except ConfigurationError:
            refused += 1
    assert refused < 60


@pytest.mark.parametrize("on_can", [False, True])
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_the_same_run_again_and_its_replay(seed: int, on_can: bool, tmp_path: Path) -> None:
    first, second = io.StringIO(), io.StringIO()
    groups = []
    for journal in (first, second):
        bench = run(seed, on_can, journal=journal)
        bench.emulator.close()
        groups.append(bench.groups)
    assert first.getvalue() == second.getvalue()
    path = tmp_path / "journal.jsonl"
    path.write_text(first.getvalue())
    sent: list[tuple[int, bytes]] = []
    again = io.StringIO()
    emulator = emulator_of(
        read_journal(path), "j", transmit=lambda data, t_ns: sent.append((t_ns, data)), journal=again
    )
    feed(emulator, read_journal(path))
    emulator.close()
    assert sent == groups[0]
    assert _notes(again) == _notes(first)


def _notes(journal: io.StringIO) -> list[Any]:
    found = [json.loads(line) for line in journal.getvalue().splitlines()]
    return [line for line in found if "note" in line]


@pytest.mark.parametrize("kind", ["sensor.hot_pixels", "sensor.dust", "sensor.torn_frame", "line.babble"])
def test_of_a_fault_that_is_over_nothing_is_kept(kind: str) -> None:
    """Some hold whole images, and a run of days has thousands of them."""
    emulator = Emulator(load_unit("roja1"), Scenario(parameters={"autonomous_start": 1}))
    emulator.advance(2_000_000_000)
    emulator.faults.inject({"kind": kind, "duration_s": 1})
    (one,) = emulator.faults.active()
    fault = weakref.ref(one.fault)
    assert fault() is not None
    emulator.advance(4_000_000_000)
    gc.collect()
    assert fault() is None
    assert one.over


def test_what_comes_at_one_instant_replays_in_its_order(tmp_path: Path) -> None:
    """A fault that acts at once, and octets of the OBC at the same time, whether the driver lets the clock
    run between them or not."""
    path = tmp_path / "journal.jsonl"
    sent: list[tuple[int, bytes]] = []
    with path.open("w") as journal:
        bench = make(journal=journal)
        emulator = bench.emulator
        emulator.transmit_to(lambda data, t_ns: sent.append((t_ns, data)))
        emulator.advance(2_000_000_000)
        for seed in range(20):
            emulator.faults.inject(
                {"kind": "line.babble", "direction": "both", "duration_s": 0.02, "seed": seed}
            )
            if seed % 2:
                emulator.advance(emulator.now_ns)
            bench.send("ping")
            emulator.advance(emulator.now_ns + 100_000_000)
        emulator.close()
    assert path.read_text().count('"settle"') == 10
    again: list[tuple[int, bytes]] = []
    read = read_journal(path)
    feed(emulator_of(read, str(path), transmit=lambda data, t_ns: again.append((t_ns, data))), read)
    assert again == sent
