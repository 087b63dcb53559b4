"""The compiled timing against the slow one: random programs, and kernels of the firmware."""

from __future__ import annotations

from binascii import crc_hqx
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from capstone import CS_ARCH_ARM, CS_MODE_ARM, Cs
from elftools.elf.elffile import ELFFile

from hil_tests.arm.programs import write_elf
from hil_tests.arm.timing_oracle import Reader, record, total_of
from tools.arm_timing.decoding import decode
from tools.arm_timing.machine import ArmMachine
from tools.arm_timing.timing_table import ROWS

PROGRAMS = 120
LENGTH = 80
RETURN = 0xE12FFF1E
BASE = 11  # points to memory in random programs, and is never written
INDEX = 10  # a small multiple of four
FREE = [0, 1, 2, 3, 4, 12]  # few: so that they are used soon after they are loaded
PAIRS = [0, 2]


def random_word(generator: np.random.Generator, left: int) -> int:
    """An instruction that can be executed anywhere in such a program; left: instructions after it."""

    def one(choices=FREE) -> int:
        return int(generator.choice(choices))

    def bits(count: int) -> int:
        return int(generator.integers(0, 1 << count))

    rd, rn, rm, rs = (one() for _ in range(4))
    kind = generator.integers(0, 16)
    if kind <= 4:  # data processing, any operand but pc
        operation, flags = bits(4), bits(1)
        if 8 <= operation <= 11:
            flags, rd = 1, 0
        elif operation in (13, 15):  # moves
            rn = 0
        operand = (1 << 25 | bits(12)) if bits(1) else (bits(5) << 7 | bits(2) << 5 | rm)
        if not operand >> 25 and bits(1):
            operand = rs << 8 | bits(2) << 5 | 1 << 4 | rm
        word = operation << 21 | flags << 20 | rn << 16 | rd << 12 | operand
    elif kind <= 7:  # word or byte, offset or scaled index
        narrow, load = bits(1), bits(1)
        offset = bits(4) << 2 if bits(1) else (1 << 25 | int(generator.choice([0, 1])) << 7 | INDEX)
        word = 0x05800000 | narrow << 22 | load << 20 | BASE << 16 | rd << 12 | offset
    elif kind == 8:  # halfwords, signed bytes
        sort = int(generator.choice([0xB0, 0xD0, 0xF0]))
        load = 1 if sort != 0xB0 else bits(1)
        word = 0x01C00000 | load << 20 | BASE << 16 | rd << 12 | sort | bits(2) << 8
        word &= ~(0x100 if sort != 0xD0 else 0)
        word &= ~1
    elif kind == 9:  # double words, at multiples of eight
        word = 0x01C000D0 | bits(1) << 5 | BASE << 16 | one(PAIRS) << 12 | bits(1) << 3
    elif kind == 10:  # lists
        listed = sum(1 << register for register in {one() for _ in range(1 + bits(3))})
        word = 0x08800000 | bits(1) << 20 | BASE << 16 | listed
    elif kind <= 12:  # multiplications
        sort = bits(3)
        if sort < 4:
            # Two different results, or they overwrite each other.
            high = one([register for register in FREE if register != rd])
            word = int(generator.choice([0x90, 0x200090, 0x800090, 0xA00090, 0xC00090, 0xE00090]))
            word |= bits(1) << 20 | high << 16 | rd << 12 | rs << 8 | rm
            if not word >> 21 & 7:
                word &= ~0xF000
        else:
            high = one([register for register in FREE if register != rd])
            word = 0x01000080 | (sort & 3) << 21 | bits(2) << 5 | high << 16 | rd << 12 | rs << 8 | rm
            if sort & 3 == 3 or (sort & 3 == 1 and word >> 5 & 1):
                word &= ~0xF000
    elif kind == 13:
        word = int(
            generator.choice(
                [
                    0x01000050 | bits(2) << 21 | rn << 16 | rd << 12 | rm,  # saturating
                    0x016F0F10 | rd << 12 | rm,  # clz
                    0x010F0000 | rd << 12,  # mrs
                    0x01000090 | bits(1) << 22 | BASE << 16 | rd << 12 | rm,  # swap
                    0x0128F000 | rm,  # msr, flags
                ]
            )
        )
    else:  # a jump over what follows
        word = 0x0A000000 | min(bits(2), max(left - 2, 0)) if left > 1 else 0x01A00000
    condition = 14 if generator.random() < 0.6 else int(generator.integers(0, 14))
    return condition << 28 | word


def is_valid(word: int) -> bool:
    """Both decoders know it, and no two results fall on one register."""
    capstone = Cs(CS_ARCH_ARM, CS_MODE_ARM)
    return decode(word) is not None and bool(list(capstone.disasm(word.to_bytes(4, "little"), 0)))


def random_program(seed: int) -> list[int]:
    generator = np.random.default_rng(seed)
    words: list[int] = []
    while len(words) < LENGTH:
        word = random_word(generator, LENGTH - len(words))
        if is_valid(word):
            words.append(word)
    return words


@pytest.fixture(scope="module")
def random_machine(tmp_path_factory: pytest.TempPathFactory) -> ArmMachine:
    """Programs p0, p1 and so on: they set their registers, run, and give back what they may not change."""
    functions = {}
    for seed in range(PROGRAMS):
        start = [0xE92D4FF0, 0xE1A0B000, 0xE1A0A001]  # push {r4-fp, lr}; mov fp, r0; mov sl, r1
        end = [0xE8BD8FF0]  # pop {r4-fp, pc}
        functions[f"p{seed}"] = [*start, *random_program(seed), *end]
    elf = write_elf(tmp_path_factory.mktemp("random") / "random.elf", functions)
    return ArmMachine(elf, memory_bytes=32 << 20)


@pytest.mark.parametrize("seed", range(PROGRAMS))
def test_random_programs(random_machine, seed):
    random_machine.release()
    random_machine.flush_caches()
    memory = np.random.default_rng(seed).integers(0, 1 << 32, 64, dtype=np.uint64).astype("<u4")
    steps, cost = record(random_machine, f"p{seed}", random_machine.place(memory), 8)
    assert len(steps) == cost.instructions
    for name, value in asdict(total_of(random_machine, steps)).items():
        assert getattr(cost, name) == value, name


def test_the_random_programs_have_what_matters(random_machine):
    counts: dict[str, int] = {}
    waited = 0
    for seed in range(PROGRAMS):
        random_machine.release()
        address = random_machine.place(np.full(64, seed * 0x01010101, "<u4"))
        cost = random_machine.call(f"p{seed}", address, 8).cost
        waited += cost.interlock_cycles
        for name, count in cost.class_counts.items():
            counts[name] = counts.get(name, 0) + count
    ordinary = {row.name for row in ROWS if "_pc" not in row.name}
    assert ordinary - set(counts) <= {
        "msr_control",
        "preload",
        "coprocessor_read",
        "coprocessor_write",
        "software_interrupt",
    }
    assert waited > 300


def test_both_decoders_agree_on_every_instruction_of_the_firmware(arm_program: Path):
    """Cycles of whatever the compiler and its libraries made of the kernels, executed or not."""
    reader, machine = Reader(), ArmMachine(arm_program, caches_kib=())
    compared = 0
    for start, end in code_of(arm_program):
        for word in sorted(set(machine.read(start, "<u4", (end - start) // 4).tolist())):
            decoded = decode(word)
            if word >> 24 & 12 == 12 and word >> 8 & 15 in (10, 11):
                assert decoded is None, hex(word)  # VFP, which the C library uses where there is one
                continue
            assert decoded is not None, hex(word)
            _, reading = reader.read(word)
            masks = (reading.use, reading.store, reading.addend, reading.written)
            found = [sum(1 << register for register in set(mask)) for mask in masks]
            assert decoded.cycles == reading.cycles, hex(word)
            assert found == [decoded.reads, decoded.stores, decoded.accumulates, decoded.writes], hex(word)
            compared += 1
    assert compared > 2000


def code_of(program: Path) -> list[tuple[int, int]]:
    """(start, end) of what is code and no data, by the mapping symbols $a and $d (IHI 0044, 4.5.5)."""
    with open(program, "rb") as stream:
        elf = ELFFile(stream)
        marks = sorted(
            (symbol["st_value"], symbol.name[:2])
            for symbol in elf.get_section_by_name(".symtab").iter_symbols()
            if symbol.name.split(".")[0] in ("$a", "$d") and symbol["st_shndx"] != "SHN_ABS"
        )
        text = elf.get_section_by_name(".text")
        first, last = text["sh_addr"], text["sh_addr"] + text["sh_size"]
    marks = [mark for mark in marks if first <= mark[0] < last]
    ends = [address for address, _ in marks[1:]] + [last]
    return [(start, end) for (start, kind), end in zip(marks, ends, strict=True) if kind == "$a"]


def test_a_kernel_with_its_caches(machine):
    data = np.random.default_rng(3).integers(0, 256, 700).astype(np.uint8)
    address = machine.place(data)
    machine.flush_caches()
    steps, cost = record(machine, "st_crc16", address, data.size)
    for figure, value in asdict(total_of(machine, steps)).items():
        assert getattr(cost, figure) == value, figure
    assert machine.call("st_crc16", address, data.size).result == crc_hqx(data.tobytes(), 0xFFFF)


DOUBLES = [(1.5, 2.25), (-3.0, 0.1), (1e300, 1e-300), (2.0, 2.0), (-0.0, 5.0), (1e-310, 3.0)]


@pytest.mark.parametrize("pair", DOUBLES, ids=str)
@pytest.mark.parametrize("name", ["__aeabi_dadd", "__aeabi_dsub", "__aeabi_dmul", "__aeabi_ddiv"])
def test_soft_float(machine, name, pair):
    """Hand-written assembly with conditional instructions of all kinds; its results are right too."""
    steps, cost = record(machine, name, *pair)
    total = total_of(machine, steps)
    for figure, value in asdict(total).items():
        assert getattr(cost, figure) == value, figure
    operation = {"dadd": "__add__", "dsub": "__sub__", "dmul": "__mul__", "ddiv": "__truediv__"}[name[8:]]
    assert machine.call(name, *pair).result_pair == getattr(pair[0], operation)(pair[1])
