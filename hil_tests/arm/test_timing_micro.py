"""Each row of the timing table and each interlock, in small programs whose cycles were added up by hand."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from capstone import CS_ARCH_ARM, CS_MODE_ARM, Cs

from hil_tests.arm.programs import RETURN, texts_of, words_of, write_elf
from hil_tests.arm.timing_oracle import record, total_of
from tools.arm_timing import timing_table
from tools.arm_timing.machine import ArmMachine

LISTING = Path(__file__).with_name("micro_programs.txt")
RETURN_CYCLES = 3
SCRATCH_WORDS = 64


@dataclass(frozen=True)
class Case:
    name: str
    cycles: int
    listing: str

    @property
    def symbol(self) -> str:
        return self.name.replace(" ", "_")


def read_cases() -> list[Case]:
    cases: list[Case] = []
    for line in LISTING.read_text(encoding="utf-8").splitlines():
        if line.startswith(" "):
            last = cases[-1]
            cases[-1] = dataclasses.replace(last, listing=f"{last.listing}{line}\n")
        elif line and not line.startswith(";"):
            name, cycles, source = line.split(" | ")
            assert source
            cases.append(Case(name, sum(map(int, cycles.split("+"))), ""))
    return cases


CASES = read_cases()


@pytest.fixture(scope="module")
def micro_machine(tmp_path_factory: pytest.TempPathFactory) -> ArmMachine:
    functions = {case.symbol: words_of(f"{case.listing}\n{RETURN}") for case in CASES}
    elf = write_elf(tmp_path_factory.mktemp("micro") / "micro.elf", functions)
    return ArmMachine(elf, memory_bytes=32 << 20)


def arguments(machine: ArmMachine) -> tuple[int, int, int, int]:
    machine.release()
    scratch = machine.reserve(4 * SCRATCH_WORDS)
    machine.write(scratch, np.arange(scratch, scratch + 4 * SCRATCH_WORDS, 4, dtype="<u4"))
    return 0, scratch, 8, 3


def measured(machine: ArmMachine, case: Case) -> int:
    return machine.call(case.symbol, *arguments(machine)).cost.core_cycles - RETURN_CYCLES


def test_names_are_different():
    assert len({case.name for case in CASES}) == len(CASES)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_cycles(micro_machine, case):
    assert measured(micro_machine, case) == case.cycles


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_slow_timing_agrees(micro_machine, case):
    micro_machine.flush_caches()
    steps, cost = record(micro_machine, case.symbol, *arguments(micro_machine))
    total = total_of(micro_machine, steps)
    assert len(steps) == cost.instructions
    for name, value in dataclasses.asdict(total).items():
        assert getattr(cost, name) == value, name


def test_the_words_are_the_assembly_beside_them():
    capstone = Cs(CS_ARCH_ARM, CS_MODE_ARM)
    for case in CASES:
        for index, (word, text) in enumerate(
            zip(words_of(case.listing), texts_of(case.listing), strict=True)
        ):
            (instruction,) = capstone.disasm(word.to_bytes(4, "little"), 4 * index)
            assert f"{instruction.mnemonic} {instruction.op_str}" == text


def test_every_row_of_the_table_is_met(micro_machine):
    met: set[str] = set()
    for case in CASES:
        met |= set(micro_machine.call(case.symbol, *arguments(micro_machine)).cost.class_counts)
    # The software interrupt ends a run: it is in the tests of tools/arm_cycles.
    assert met == {row.name for row in timing_table.ROWS} - {"software_interrupt"}


def test_every_number_of_the_table_matters(micro_machine, tmp_path, monkeypatch):
    """A changed number changes some case: no row is there without being tested."""
    from tools.arm_timing import decoding

    elf = micro_machine.program.path
    untested = []
    for number, row in enumerate(timing_table.ROWS):
        if row.name == "software_interrupt":
            continue
        for field in ("cycles", "use", "store", "accumulate"):
            value = getattr(row, field)
            # From 1 to 0, from 0 to 1, from 2 to 1; more cycles where there are some.
            changed = value + 1 if field == "cycles" or value == 0 else value - 1
            if field == "cycles" and row.per_register and row.least:
                changed = value + 2
            late_possible = field == "cycles" or row.use
            if not late_possible:
                continue  # nothing of it is ever late: the field is not looked at
            rows = list(timing_table.ROWS)
            rows[number] = dataclasses.replace(row, **{field: changed})
            with monkeypatch.context() as patch:
                patch.setattr(decoding, "ROWS", tuple(rows))
                decoding.packed.cache_clear()
                machine = ArmMachine(elf, memory_bytes=32 << 20, caches_kib=())
            decoding.packed.cache_clear()
            if all(measured(machine, case) == case.cycles for case in CASES):
                untested.append((row.name, field, value))
    assert not untested, untested
