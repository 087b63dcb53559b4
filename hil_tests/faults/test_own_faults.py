"""A fault of one's own, put in from Python."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import pytest

from hil_tests.unit.conftest import make
from st_emulator.bench.journal import read_journal
from st_emulator.commands.replaying import emulator_of, feed
from st_emulator.errors import ConfigurationError
from st_emulator.faults.fault import AtMessages, FaultSettings


class LossSettings(FaultSettings):
    kind: str = "own.loss"
    octets: int = 30


class Loss(AtMessages[LossSettings]):
    def message(self, message: bytes, to_obc: bool, forward: Callable[[bytes], None]) -> None:
        if not to_obc or len(message) <= self.settings.octets or not self.strikes():
            forward(message)


def test_it_stands_and_ends() -> None:
    bench = make().boot()
    number = bench.emulator.faults.stand(Loss, LossSettings(duration_s=1.0))
    assert number == 0
    first = bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 100})
    bench.run(100)
    assert bench.stages(first) == ["acceptance_success", "completion_success"]
    assert bench.of("memory_dump_report") == []
    bench.run(1000)
    bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 100})
    bench.run(100)
    assert len(bench.of("memory_dump_report")) == 1
    assert bench.emulator.faults.active() == []


def test_its_chance_is_that_of_its_seed() -> None:
    lost = []
    for seed in (1, 1, 2):
        bench = make().boot()
        bench.emulator.faults.stand(Loss, LossSettings(octets=0, probability=0.5, seed=seed))
        for _ in range(30):
            bench.send("ping")
            bench.run(20)
        lost.append([packet.decoded["sequence_count"] for packet in bench.packets])
    assert lost[0] == lost[1] != lost[2]


def test_a_name_of_the_list_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"'clock.drift': the list has such a kind"):
        make().emulator.faults.stand(Loss, LossSettings(kind="clock.drift"))


def test_a_replay_says_that_it_cannot(tmp_path: Path) -> None:
    journal = io.StringIO()
    bench = make(journal=journal).boot()
    bench.emulator.faults.stand(Loss, LossSettings(duration_s=1.0))
    bench.run(100)
    bench.emulator.close()
    path = tmp_path / "journal.jsonl"
    path.write_text(journal.getvalue())
    emulator = emulator_of(read_journal(path), "journal")
    with pytest.raises(ConfigurationError, match=r"a fault of somebody's own was put in \(own.loss\)"):
        feed(emulator, read_journal(path))
