"""Calling functions on the simulated processor: arguments, memory, and what is said of a bad program."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from unicorn import UC_ARCH_ARM, UC_HOOK_BLOCK, UC_MODE_ARM, Uc
from unicorn.arm_const import UC_ARM_REG_LR, UC_ARM_REG_R0, UC_ARM_REG_R1, UC_CPU_ARM_926

from hil_tests.arm.programs import CODE, EM_386, words_of, write_elf
from tools.arm_timing import callbacks
from tools.arm_timing.errors import ArmError
from tools.arm_timing.machine import EXIT_ADDRESS, ArmMachine

FUNCTIONS = {
    # The arguments as the callee finds them, for a test to look at: r0 to r3 and six words of the stack.
    "keep": """
        e59fc008  ldr ip, [pc, #8]
        e88c000f  stm ip, {r0, r1, r2, r3}
        e89d000f  ldm sp, {r0, r1, r2, r3}
        ea000000  b #0x14
        00f00000  .word 0xf00000
        e28cc010  add ip, ip, #0x10
        e8ac000f  stm ip!, {r0, r1, r2, r3}
        e59d0010  ldr r0, [sp, #0x10]
        e59d1014  ldr r1, [sp, #0x14]
        e88c0003  stm ip, {r0, r1}
        e12fff1e  bx lr
    """,
    "same": "e12fff1e  bx lr",
    "second_to_first": "e1a00002  mov r0, r2\n e1a01003  mov r1, r3\n e12fff1e  bx lr",
    "load": "e5900000  ldr r0, [r0]\n e12fff1e  bx lr",
    "load_half": "e1d000b0  ldrh r0, [r0]\n e12fff1e  bx lr",
    "store": "e5810000  str r0, [r1]\n e12fff1e  bx lr",
    "add_words": """
        e1a02000  mov r2, r0
        e3a00000  mov r0, #0
        e4923004  ldr r3, [r2], #4
        e0800003  add r0, r0, r3
        e2511001  subs r1, r1, #1
        1afffffb  bne #8
        e12fff1e  bx lr
    """,
    "forever": "eafffffe  b #0",
    "no_instruction": "e7f000f0  udf #0\n e12fff1e  bx lr",
    "vfp": "ee300a00  vadd.f32 s0, s0, s0\n e12fff1e  bx lr",
    "armv6": "e6bf0070  sxth r0, r0\n e12fff1e  bx lr",
    "armv7": "e3010234  movw r0, #0x1234\n e12fff1e  bx lr",
    "to_thumb": "e28f0001  add r0, pc, #1\n e12fff10  bx r0\n 46c046c0  nop; nop",
    "to_nowhere": "e3a00a0f  mov r0, #0xf000\n e12fff10  bx r0",
    "into_data": "e1a00001  mov r0, r1\n e12fff10  bx r0",
    "flags": "e128f000  msr apsr_nzcvq, r0\n e12fff1e  bx lr",
}
KEPT_ARGUMENTS = 0xF00000


@pytest.fixture(scope="module")
def elf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    functions = {name: words_of(listing) for name, listing in FUNCTIONS.items()}
    return write_elf(tmp_path_factory.mktemp("machine") / "machine.elf", functions)


@pytest.fixture(scope="module")
def machine_of_module(elf: Path) -> ArmMachine:
    return ArmMachine(elf, memory_bytes=32 << 20)


@pytest.fixture
def cpu(machine_of_module: ArmMachine) -> ArmMachine:
    machine_of_module.release()
    machine_of_module.max_instructions = 10_000
    return machine_of_module


def words_of_double(value: float) -> list[int]:
    return [int(word) for word in np.array([value], "<f8").view("<u4")]


def kept(machine: ArmMachine, *arguments: int | float) -> list[int]:
    machine.call("keep", *arguments)
    return [int(word) for word in machine.read(KEPT_ARGUMENTS, "<u4", 10)]


class TestArguments:
    """AAPCS (ARM IHI 0042), 6.5, worked through by hand."""

    def test_words_fill_the_registers_and_then_the_stack(self, cpu):
        assert kept(cpu, 1, -2, 0xFFFF_FFFF, 4, 5, 6)[:6] == [1, 0xFFFF_FFFE, 0xFFFF_FFFF, 4, 5, 6]

    def test_a_double_takes_an_even_pair(self, cpu):
        low, high = words_of_double(1.5)
        found = kept(cpu, 7, 1.5, 8)
        assert (found[0], found[2:4], found[4]) == (7, [low, high], 8)

    def test_a_double_that_does_not_fit_goes_to_the_stack_whole_and_no_register_is_filled_after(self, cpu):
        pair = words_of_double(-2.25)
        found = kept(cpu, 1, 2, 3, -2.25, 9)
        assert found[:3] == [1, 2, 3]
        assert found[4:7] == [*pair, 9]

    def test_a_double_on_the_stack_is_aligned_to_eight(self, cpu):
        pair = words_of_double(3.0)
        found = kept(cpu, 1, 2, 3, 4, 5, 3.0)
        assert found[4] == 5
        assert found[6:8] == pair

    def test_truth_values_and_numpy_scalars(self, cpu):
        pair = words_of_double(0.1)
        assert kept(cpu, True, np.int32(-1), np.float64(0.1))[:4] == [1, 0xFFFF_FFFF, *pair]

    @pytest.mark.parametrize("value", [1 << 32, -(1 << 31) - 1])
    def test_what_is_no_word(self, cpu, value):
        with pytest.raises(ValueError, match="32-bit"):
            cpu.call("same", value)

    @given(value=st.floats(allow_nan=False))
    def test_a_double_comes_back(self, machine_of_module, value):
        assert machine_of_module.call("same", value).result_pair == value
        assert machine_of_module.call("second_to_first", 0.0, value).result_pair == value

    def test_r0_comes_back_as_an_unsigned_word(self, cpu):
        assert cpu.call("same", -1).result == 0xFFFF_FFFF


class TestMemory:
    def test_arrays_come_back_as_they_were(self, cpu):
        generator = np.random.default_rng(1)
        for dtype in ("u1", "<i2", "<i4", "<f8"):
            array = (generator.random((3, 5, 2)) * 100).astype(dtype)
            address = cpu.place(array)
            assert address % 32 == 0
            found = cpu.read(address, dtype, array.shape)
            assert found.dtype == np.dtype(dtype)
            np.testing.assert_array_equal(found, array)

    def test_a_read_array_is_a_copy(self, cpu):
        address = cpu.place(np.arange(4))
        cpu.read(address, "<i8", 4)[:] = 9
        assert list(cpu.read(address, "<i8", 4)) == [0, 1, 2, 3]

    def test_another_order_of_memory_is_put_right(self, cpu):
        array = np.arange(12).reshape(3, 4).T
        np.testing.assert_array_equal(cpu.read(cpu.place(array), "<i8", (4, 3)), array)

    def test_what_was_placed_does_not_overlap(self, cpu):
        first, second = cpu.place(np.full(33, 1, np.uint8)), cpu.place(np.full(1, 2, np.uint8))
        assert second >= first + 64
        assert cpu.place(np.zeros(0)) != cpu.place(np.zeros(0))

    def test_reserved_memory_is_zero_again_after_release(self, cpu):
        address = cpu.reserve(64)
        cpu.write(address, np.full(64, 7, np.uint8))
        cpu.release()
        assert cpu.reserve(64) == address
        assert not cpu.read(address, "u1", 64).any()

    def test_a_kept_array_is_placed_once_and_stays(self, cpu):
        table = np.arange(1000, dtype=np.int32)
        address = cpu.place(table, keep=True)
        cpu.release()
        cpu.place(np.ones(5000))
        assert cpu.place(table, keep=True) == address
        np.testing.assert_array_equal(cpu.read(address, np.int32, 1000), table)
        # Equal values are another array: it may change on its own.
        assert cpu.place(table.copy(), keep=True) != address
        assert cpu.place(table[:500], keep=True) != address

    def test_a_kept_array_cannot_be_a_temporary_copy(self, cpu):
        with pytest.raises(ValueError, match="contiguous"):
            cpu.place(np.arange(10)[::2], keep=True)

    def test_too_much(self, cpu):
        with pytest.raises(ArmError, match="out of memory"):
            cpu.reserve(64 << 20)
        with pytest.raises(ArmError, match="out of memory"):
            cpu.place(np.zeros(5 << 20), keep=True)
        with pytest.raises(ArmError, match="no memory"):
            cpu.read(0xE000_0000, "u1", 4)
        with pytest.raises(ArmError, match="no memory"):
            cpu.read((32 << 20) - 4, "u1", 8)

    def test_the_program_sees_what_was_placed(self, cpu):
        array = np.random.default_rng(2).integers(0, 1 << 20, 100).astype("<u4")
        call = cpu.call("add_words", cpu.place(array), 100)
        assert call.result == array.sum()
        assert call.cost.data_accesses == 100

    def test_a_program_with_data_elsewhere(self, tmp_path):
        data = (0x2000_0000, np.arange(8, dtype="<u4").tobytes())
        elf = write_elf(tmp_path / "far.elf", {"load": words_of(FUNCTIONS["load"])}, data=data)
        assert ArmMachine(elf, memory_bytes=32 << 20).call("load", 0x2000_0014).result == 5

    def test_a_program_at_address_zero(self, tmp_path):
        elf = write_elf(tmp_path / "zero.elf", {"load": words_of(FUNCTIONS["load"])}, address=0)
        assert ArmMachine(elf, memory_bytes=32 << 20).call("load", 0).result == words_of(FUNCTIONS["load"])[0]

    def test_memory_too_small_for_the_program(self, tmp_path):
        elf = write_elf(tmp_path / "x.elf", {"same": words_of(FUNCTIONS["same"])})
        with pytest.raises(ArmError, match="too few"):
            ArmMachine(elf, memory_bytes=8 << 20)


class TestErrors:
    @pytest.mark.parametrize(
        ("symbol", "arguments", "text"),
        [
            ("nothing", (), "no symbol 'nothing'"),
            ("load", (0,), r"at 0x\w+ \(load\+0x0\): .*read"),
            ("load", (0xE000_0000,), r"at 0x\w+ \(load\+0x0\): .*read"),
            ("store", (1, 0), r"at 0x\w+ \(store\+0x0\): .*write"),
            ("load", (0x10002,), r"\(load\+0x0\): an access to 0x00010002.*aligned"),
            ("load_half", (0x10001,), r"\(load_half\+0x0\): an access to 0x00010001.*aligned"),
            ("forever", (), r"\(forever\+0x0\): still running after 10000"),
            (
                "no_instruction",
                (),
                r"\(no_instruction\+0x0\): 0xe7f000f0 .*, an instruction that ARM926EJ-S has not",
            ),
            (
                "vfp",
                (),
                r"\(vfp\+0x0\): 0xee300a00 \(vadd.f32 s0, s0, s0\), an instruction that ARM926EJ-S has",
            ),
            (
                "armv6",
                (),
                r"\(armv6\+0x0\): 0xe6bf0070 \(sxth r0, r0\), an instruction that ARM926EJ-S has not",
            ),
            (
                "armv7",
                (),
                r"\(armv7\+0x0\): 0xe3010234 \(movw r0, #0x1234\), an instruction that ARM926EJ-S has not",
            ),
            ("to_thumb", (), r"Thumb"),
            ("to_nowhere", (), r"at 0x0000f000: .*not in the program's executable"),
            ("into_data", (0, 0x0100_0000), r"at 0x01000000: .*not in the program's executable"),
        ],
    )
    def test_while_running(self, cpu, symbol, arguments, text):
        with pytest.raises(ArmError, match=text):
            cpu.call(symbol, *arguments)
        # And afterwards it works as before.
        assert cpu.call("same", 5).result == 5

    @pytest.mark.parametrize(
        ("options", "text"),
        [
            ({"machine": EM_386}, "this runs 32-bit ARM"),
            ({"flags": 0x0500_0400}, "hard float"),
            ({"kind": 3}, "not a linked executable"),
            ({"kind": 1}, "not a linked executable"),
        ],
    )
    def test_of_the_file(self, tmp_path, options, text):
        elf = write_elf(tmp_path / "bad.elf", {"same": words_of(FUNCTIONS["same"])}, **options)
        with pytest.raises(ArmError, match=text):
            ArmMachine(elf)

    def test_no_such_file_and_no_elf(self, tmp_path):
        with pytest.raises(ArmError, match="No such file"):
            ArmMachine(tmp_path / "nothing")
        (tmp_path / "text").write_text("hello")
        with pytest.raises(ArmError, match="not an ELF file"):
            ArmMachine(tmp_path / "text")
        (tmp_path / "cut").write_bytes(b"\x7fELF\x01\x01\x01")
        with pytest.raises(ArmError, match="not an ELF file"):
            ArmMachine(tmp_path / "cut")

    def test_thumb_functions(self, tmp_path):
        elf = write_elf(tmp_path / "thumb.elf", {"f": [0x46C04770]}, thumb=True)
        with pytest.raises(ArmError, match="Thumb"):
            ArmMachine(elf, memory_bytes=32 << 20).call("f")


class TestCounts:
    def test_instructions_are_those_of_the_loop(self, cpu):
        address = cpu.place(np.zeros(100, "<u4"))
        cost = cpu.call("add_words", address, 100).cost
        assert cost.instructions == 2 + 4 * 100 + 1
        # Per word: the load, the wait of the sum for it, the sum, the subtraction, the branch (3; at last 1).
        assert cost.core_cycles == 2 + 100 * (1 + 1 + 1 + 1 + 3) - 2 + 3
        assert cost.class_counts == {"alu": 202, "load_word": 100, "branch": 101}
        assert sum(cost.class_counts.values()) == cost.instructions
        assert cost.interlock_cycles == 100

    def test_a_run_by_blocks_alone_counts_the_same(self, cpu):
        """Another engine with no callback but one for each block, which sums their sizes."""
        address = cpu.place(np.zeros(1000, "<u4"))
        engine = Uc(UC_ARCH_ARM, UC_MODE_ARM, UC_CPU_ARM_926)
        engine.mem_map(0, 32 << 20)
        engine.mem_map(EXIT_ADDRESS, 4096)
        code = cpu.read(CODE, "u1", 4096).tobytes()
        engine.mem_write(CODE, code)
        engine.reg_write(UC_ARM_REG_LR, EXIT_ADDRESS)
        engine.reg_write(UC_ARM_REG_R0, address)
        engine.reg_write(UC_ARM_REG_R1, 1000)
        sizes: list[int] = []
        engine.hook_add(UC_HOOK_BLOCK, lambda _uc, _address, size, _data: sizes.append(size))
        engine.emu_start(cpu.symbols["add_words"], EXIT_ADDRESS)
        assert sum(sizes) // 4 == cpu.call("add_words", address, 1000).cost.instructions

    def test_both_counts_are_compared_in_every_call(self, cpu, monkeypatch):
        cpu.call("same")
        monkeypatch.setattr(type(cpu._state), "instructions_by_blocks", lambda *_: 2)
        with pytest.raises(ArmError, match="1 instructions counted one by one, 2 by blocks"):
            cpu.call("same")

    def test_costs_of_calls_are_apart(self, cpu):
        first, second = cpu.call("same").cost, cpu.call("same").cost
        assert first.instructions == second.instructions == 1
        assert first.core_cycles == second.core_cycles == 3

    def test_nothing_is_pending_from_the_call_before(self, cpu):
        """load ends with a value that the next call would have to wait for."""
        address = cpu.place(np.zeros(4, "<u4"))
        alone = cpu.call("same").cost.core_cycles
        cpu.call("load", address)
        assert cpu.call("same").cost.core_cycles == alone


CONDITIONS = ("eq", "ne", "cs", "cc", "mi", "pl", "vs", "vc", "hi", "ls", "ge", "lt", "gt", "le", "al")


def holds(condition: str, n: bool, z: bool, c: bool, v: bool) -> bool:
    """ARM DDI 0100, table A3-1."""
    table = {
        "eq": z,
        "cs": c,
        "mi": n,
        "vs": v,
        "hi": c and not z,
        "ge": n == v,
        "gt": not z and n == v,
        "al": True,
    }
    opposite = {"ne": "eq", "cc": "cs", "pl": "mi", "vc": "vs", "ls": "hi", "lt": "ge", "le": "gt"}
    return table[condition] if condition in table else not table[opposite[condition]]


@pytest.fixture(scope="module")
def conditional(tmp_path_factory: pytest.TempPathFactory) -> ArmMachine:
    """For each condition: flags set, then a multiplication, a scaled load, a branch on the condition."""
    functions = {}
    for number, condition in enumerate(CONDITIONS):
        top = number << 28
        set_flags, back = 0xE128F000, 0xE12FFF1E  # msr cpsr_f, r0; bx lr
        functions[f"multiply_{condition}"] = [set_flags, top | 0x00000392, back]
        functions[f"load_{condition}"] = [set_flags, top | 0x0791C102, back]
        functions[f"branch_{condition}"] = [set_flags, top | 0x0A000000, 0xE1A00000, back]
        functions[f"next_{condition}"] = [set_flags, top | 0x0AFFFFFF, back]
        functions[f"return_{condition}"] = [set_flags, top | 0x012FFF1E, back]
        functions[f"shift_{condition}"] = [set_flags, top | 0x00820213, back]
    elf = write_elf(tmp_path_factory.mktemp("conditions") / "conditions.elf", functions)
    return ArmMachine(elf, memory_bytes=32 << 20, caches_kib=())


@pytest.mark.parametrize("condition", CONDITIONS)
def test_whether_a_conditional_instruction_was_executed(conditional, condition):
    """All flags with all conditions, for each way in which it is found out."""
    scratch = conditional.reserve(64)
    for flags in range(16):
        executed = holds(condition, *(bool(flags >> bit & 1) for bit in (3, 2, 1, 0)))
        expected = {
            "multiply": 1 + (2 if executed else 1) + 3,
            "load": 1 + (2 if executed else 1) + 3,
            "branch": 1 + (3 if executed else 2) + 3,
            "next": 1 + (3 if executed else 1) + 3,
            "return": 1 + (3 if executed else 4),
            "shift": 1 + (2 if executed else 1) + 3,
        }
        for name, cycles in expected.items():
            call = conditional.call(f"{name}_{condition}", flags << 28, scratch, 4, 3)
            assert call.cost.core_cycles == cycles, (name, flags)


def test_the_callbacks_know_the_decoders_numbers():
    from tools.arm_timing import decoding, timing_table

    for name in ("PLAIN", "JUMP", "MAYBE_JUMP", "MAYBE_MEMORY", "MAYBE_OTHER", "MAYBE_ALU", "UNKNOWN"):
        assert getattr(callbacks, name) == getattr(decoding, name)
    assert callbacks._REFILL_FETCHES == timing_table.REFILL_FETCHES
    assert timing_table.CONDITION_FAILED_CYCLES == 1  # so the callback takes it
    assert len(timing_table.ROWS) <= callbacks.STATE_LENGTH - callbacks.ROW_COUNTS


@settings(max_examples=20, deadline=None)
@given(values=st.lists(st.integers(0, 0xFFFF_FFFF), min_size=1, max_size=50))
def test_results_are_right_with_all_callbacks(machine_of_module, values):
    machine_of_module.release()
    address = machine_of_module.place(np.array(values, "<u4"))
    call = machine_of_module.call("add_words", address, len(values))
    assert call.result == sum(values) & 0xFFFF_FFFF
