"""The cache model: what can be counted by hand, and random accesses against lists of lines."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_tests.arm.programs import words_of, write_elf
from hil_tests.arm.timing_oracle import CacheList, record, total_of
from tools.arm_timing.machine import ArmMachine

SIZES = (32, 16, 8, 4)
LINE = 32
NOP = 0xE1A00000

# r0: address, r1: how many; a line each time.
READ = """
    e4903020  ldr r3, [r0], #0x20
    e2511001  subs r1, r1, #1
    1afffffc  bne #0xfffffff8
    e12fff1e  bx lr
"""
WRITE = """
    e4803020  str r3, [r0], #0x20
    e2511001  subs r1, r1, #1
    1afffffc  bne #0xfffffff8
    e12fff1e  bx lr
"""
# r0: list of addresses, those to write with bit 0 set; r1: how many.
FOLLOW = """
    e4903004  ldr r3, [r0], #4
    e3130001  tst r3, #1
    e3c33001  bic r3, r3, #1
    05932000  ldreq r2, [r3]
    15832000  strne r2, [r3]
    e2511001  subs r1, r1, #1
    1afffff8  bne #0xffffffe8
    e12fff1e  bx lr
"""
# As FOLLOW, but each address is read, and then written too if bit 0 is set.
CHANGE = """
    e4903004  ldr r3, [r0], #4
    e3130001  tst r3, #1
    e3c33001  bic r3, r3, #1
    e5932000  ldr r2, [r3]
    15832000  strne r2, [r3]
    e2511001  subs r1, r1, #1
    1afffff8  bne #0xffffffe8
    e12fff1e  bx lr
"""
# r0: how often the code before is run through: 1536 instructions, 6 KiB.
LOOP = [NOP] * 1533 + words_of(
    """
    e2500001  subs r0, r0, #1
    1afffa00  bne #0xffffe808
    e12fff1e  bx lr
"""
)
FUNCTIONS = {
    "read": words_of(READ),
    "write": words_of(WRITE),
    "follow": words_of(FOLLOW),
    "change": words_of(CHANGE),
    "loop": LOOP,
}


@pytest.fixture(scope="module")
def elf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_elf(tmp_path_factory.mktemp("caches") / "caches.elf", FUNCTIONS)


@pytest.fixture(scope="module")
def machine_of_module(elf: Path) -> ArmMachine:
    return ArmMachine(elf, memory_bytes=32 << 20, caches_kib=SIZES)


@pytest.fixture
def caches(machine_of_module: ArmMachine) -> ArmMachine:
    machine_of_module.release()
    machine_of_module.flush_caches()
    return machine_of_module


def follow(machine: ArmMachine, addresses: list[int], *, writes: bool = False):
    """Access addresses one after the other; the list itself lies in a region of its own."""
    array = np.array(addresses, "<u4") | writes
    return machine.call("follow", machine.place(array), len(addresses)).cost


def test_a_stream_fills_each_line_once(caches):
    address = caches.reserve(100 * LINE)
    cost = caches.call("read", address, 100).cost
    assert cost.data_fills == dict.fromkeys(SIZES, 100)
    assert cost.data_accesses == 100
    assert cost.write_backs == dict.fromkeys(SIZES, 0)


def test_what_fits_stays_and_what_does_not_goes_round(caches):
    lines = 160  # 5 KiB: five in each set of 4 KiB, which has four ways
    address = caches.reserve(lines * LINE)
    caches.call("read", address, lines)
    again = caches.call("read", address, lines).cost
    # Round-robin replaces in the order of filling: the line needed next is always the one just gone.
    assert again.data_fills == {32: 0, 16: 0, 8: 0, 4: lines}


def test_of_eight_words_in_a_line_one_is_filled(caches):
    address = caches.reserve(64)
    cost = follow(caches, [address + 4 * word for word in range(8)])
    own = 1  # the list of eight addresses
    assert cost.data_fills == dict.fromkeys(SIZES, 1 + own)


def test_replacement_is_round_robin_and_not_least_recently_used(caches):
    """A B C D A E A: of four ways E replaces A, the oldest, although it was used last."""
    step = 4 << 10  # the same set in a cache of 4 KiB, others in one of 32 KiB
    base = caches.reserve(64 << 10)
    a, b, c, d, e = (base + 512 + step * index for index in range(5))  # not in the set of the list
    cost = follow(caches, [a, b, c, d, a, e, a])
    list_lines = 1
    assert cost.data_fills[4] == 6 + list_lines
    assert cost.data_fills[32] == 5 + list_lines


def test_a_write_miss_fills_nothing(caches):
    address = caches.reserve(100 * LINE)
    cost = caches.call("write", address, 100).cost
    assert cost.data_fills == dict.fromkeys(SIZES, 0)
    assert cost.write_backs == dict.fromkeys(SIZES, 0)
    assert cost.data_accesses == 100
    # Nor is anything there to read afterwards.
    assert caches.call("read", address, 100).cost.data_fills == dict.fromkeys(SIZES, 100)


def test_written_lines_are_written_back_when_they_are_replaced(caches):
    lines = 128  # all of 4 KiB
    address, other = caches.reserve(lines * LINE), caches.reserve(lines * LINE)
    caches.call("read", address, lines)
    assert caches.call("write", address, lines).cost.write_backs == dict.fromkeys(SIZES, 0)
    cost = caches.call("read", other, lines).cost
    assert cost.write_backs == {32: 0, 16: 0, 8: 0, 4: lines}
    # Written back once: what replaced them is clean.
    assert caches.call("read", address, lines).cost.write_backs == dict.fromkeys(SIZES, 0)


def test_a_line_that_is_read_and_then_written_is_written_back(caches):
    """Twice the same line in a row, which the callback knows without looking."""
    lines = 128  # all of 4 KiB, with the list in lines of its own
    address, other = caches.reserve(lines * LINE), caches.reserve(lines * LINE)
    table = caches.place((np.arange(lines) * LINE + address | 1).astype("<u4"))
    first = caches.call("change", table, lines).cost
    second = caches.call("read", other, lines).cost
    assert first.write_backs[4] + second.write_backs[4] == lines
    assert first.write_backs[32] + second.write_backs[32] == 0


def test_what_a_device_wrote_is_not_in_the_cache(caches):
    array = np.zeros(50 * LINE, np.uint8)
    address = caches.place(array)
    caches.call("read", address, 50)
    assert caches.call("read", address, 50).cost.data_fills[32] == 0
    caches.write(address, array)  # from outside: the cache is left as it is
    assert caches.call("read", address, 50).cost.data_fills[32] == 0
    assert caches.dma(array[: 20 * LINE], address) == address
    assert caches.call("read", address, 50).cost.data_fills == dict.fromkeys(SIZES, 20)
    fresh = caches.dma(array)
    assert fresh != address
    assert caches.call("read", fresh, 50).cost.data_fills[32] == 50


def test_a_single_line_of_a_device_is_invalidated_too(caches):
    """Also the line that was accessed last, which the callback knows without looking."""
    array = np.zeros(LINE, np.uint8)
    address = caches.place(array)
    caches.call("read", address, 1)
    caches.dma(array, address)
    assert caches.call("read", address, 1).cost.data_fills == dict.fromkeys(SIZES, 1)


def test_emptied_caches_are_empty(caches):
    address = caches.reserve(LINE)
    first = caches.call("read", address, 1).cost
    assert caches.call("read", address, 1).cost.line_fills() == 0
    caches.flush_caches()
    assert caches.call("read", address, 1).cost == first


def test_code_that_does_not_fit_is_fetched_again(caches):
    lines = len(LOOP) * 4 // LINE
    start = caches.symbols["loop"]
    touched = (start + len(LOOP) * 4 - 1) // LINE - start // LINE + 1
    once = caches.call("loop", 1).cost
    assert once.fetch_fills == dict.fromkeys(SIZES, touched)
    assert once.core_cycles == len(LOOP) - 3 + 1 + 1 + 3
    caches.flush_caches()
    thrice = caches.call("loop", 3).cost
    assert thrice.fetch_fills[32] == thrice.fetch_fills[8] == touched
    assert touched + 2 * (lines - 64) <= thrice.fetch_fills[4] <= 3 * touched
    assert thrice.fetches == thrice.instructions + 2 * 3  # each change of pc fetches two words in vain


def test_memory_cycles():
    from tools.arm_timing.machine import Cost

    cost = Cost(10, 12, {32: 3, 4: 5}, {32: 2, 4: 7}, 6, 14, {32: 0, 4: 1})
    assert cost.memory_cycles(48, 32) == 48 * 5
    assert cost.memory_cycles(48, 4) == 48 * 12
    assert cost.memory_cycles(40, 0) == 40 * 20
    twice = cost + cost
    assert twice.instructions == 20
    assert twice.line_fills(4) == 24
    assert twice.write_backs == {32: 0, 4: 2}
    assert cost + Cost() == cost
    with pytest.raises(KeyError):
        cost.line_fills(64)


def test_each_size_alone_is_as_among_others(elf, caches):
    addresses = np.random.default_rng(5).integers(0, 1 << 14, 3000) * 4
    base = caches.reserve(1 << 16)
    together = follow(caches, list(base + addresses), writes=False)
    for kib in SIZES:
        alone = ArmMachine(elf, memory_bytes=32 << 20, caches_kib=(kib,))
        assert alone.reserve(1 << 16) == base
        cost = follow(alone, list(base + addresses))
        assert cost.data_fills == {kib: together.data_fills[kib]}
        assert cost.fetch_fills == {kib: together.fetch_fills[kib]}


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 1 << 30),
    reach=st.sampled_from((256, 6 << 10, 20 << 10, 100 << 10)),
    write_share=st.sampled_from((0.0, 0.3, 0.9)),
    read_first=st.booleans(),
)
def test_random_accesses_against_lists_of_lines(machine_of_module, seed, reach, write_share, read_first):
    machine = machine_of_module
    machine.release()
    machine.flush_caches()
    generator = np.random.default_rng(seed)
    count = 400
    base = machine.reserve(reach)
    addresses = base + generator.integers(0, reach // 4, count) * 4
    # Runs through neighbouring words too, as programs have them.
    addresses[: count // 2] = base + np.arange(count // 2) * 4 % reach
    writes = generator.random(count) < write_share
    table = machine.place((addresses | writes).astype("<u4"))
    cost = machine.call("change" if read_first else "follow", table, count).cost
    for kib in SIZES:
        cache = CacheList(kib)
        for index in range(count):
            cache.access(table + 4 * index)
            if read_first or not writes[index]:
                cache.access(int(addresses[index]))
            if writes[index]:
                cache.access(int(addresses[index]), write=True)
        assert cost.data_fills[kib] == cache.fills
        assert cost.write_backs[kib] == cache.write_backs


def test_the_slow_timing_agrees_with_all_of_it(caches):
    generator = np.random.default_rng(7)
    base = caches.reserve(64 << 10)
    addresses = (base + generator.integers(0, 16 << 10, 600) * 4) | (generator.random(600) < 0.4)
    table = caches.place(addresses.astype("<u4"))
    steps, cost = record(caches, "follow", table, 600)
    for name, value in asdict(total_of(caches, steps)).items():
        assert getattr(cost, name) == value, name


@pytest.mark.parametrize("sizes", [(3,), (0,), (1, 2, 4, 8, 16, 32, 64, 128, 256)])
def test_impossible_caches(elf, sizes):
    with pytest.raises(ValueError, match="cache"):
        ArmMachine(elf, memory_bytes=32 << 20, caches_kib=sizes)


def test_another_replacement_is_not_modelled(elf):
    with pytest.raises(ValueError, match="round-robin"):
        ArmMachine(elf, memory_bytes=32 << 20, replacement="pseudo-random")
