"""What a program asks its host for: semihosting, and a little of Linux."""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from hil_tests.arm.programs import words_of, write_elf
from tools.arm_timing.errors import ArmError
from tools.arm_timing.machine import ArmMachine, Run

FUNCTIONS = {
    # r0: operation, r1: its argument.
    "semihosting": "ef123456  svc #0x123456\n e12fff1e  bx lr",
    # r0 to r2: arguments, r3: number.
    "linux": "e1a07003  mov r7, r3\n ef000000  svc #0\n e12fff1e  bx lr",
    "unknown": "ef000042  svc #0x42\n e12fff1e  bx lr",
    # r0: turns of four cycles; then SYS_ELAPSED into r1.
    "wait_and_look": """
        e2500001  subs r0, r0, #1
        8afffffd  bhi #0xfffffffc
        e3a00030  mov r0, #0x30
        ef123456  svc #0x123456
        e12fff1e  bx lr
    """,
    # A failed condition makes no call.
    "maybe": "e3500000  cmp r0, #0\n 0f000042  svceq #0x42\n e12fff1e  bx lr",
    "pending": "e1500000  cmp r0, r0\n e3a00018  mov r0, #0x18\n 0f123456  svceq #0x123456\n e12fff1e  bx lr",
}
APPLICATION_EXIT = 0x20026
MINUS_ONE = 0xFFFF_FFFF


@dataclass
class Session:
    machine: ArmMachine
    output: io.BytesIO = field(default_factory=io.BytesIO)
    errors: io.BytesIO = field(default_factory=io.BytesIO)

    def run(self, symbol: str, *arguments: int, **options) -> Run:
        return self.machine.run(symbol, *arguments, output=self.output, errors=self.errors, **options)

    def semihosting(self, operation: int, argument: int = 0) -> int:
        run = self.run("semihosting", operation, argument)
        assert run.exit_code is None
        return run.result

    def block(self, *words: int) -> int:
        return self.machine.place(np.array(words, "<u4"))

    def text(self, text: bytes) -> int:
        return self.machine.place(np.frombuffer(text + b"\0", np.uint8))

    def words(self, address: int, count: int) -> list[int]:
        return self.machine.read(address, "<u4", count).tolist()


@pytest.fixture(scope="module")
def machine_of_module(tmp_path_factory: pytest.TempPathFactory) -> ArmMachine:
    functions = {name: words_of(listing) for name, listing in FUNCTIONS.items()}
    elf = write_elf(tmp_path_factory.mktemp("host") / "host.elf", functions)
    return ArmMachine(elf, memory_bytes=32 << 20)


@pytest.fixture
def session(machine_of_module: ArmMachine) -> Session:
    machine_of_module.release()
    return Session(machine_of_module)


class TestSemihosting:
    def test_console(self, session):
        assert session.semihosting(0x04, session.text(b"one ")) == 0  # SYS_WRITE0
        session.semihosting(0x03, session.text(b"2"))  # SYS_WRITEC: one character
        handle = session.semihosting(0x01, session.block(session.text(b":tt"), 4, 3))
        assert session.semihosting(0x05, session.block(handle, session.text(b" three"), 6)) == 0
        assert session.output.getvalue() == b"one 2 three"
        errors = session.semihosting(0x01, session.block(session.text(b":tt"), 8, 3))
        session.semihosting(0x05, session.block(errors, session.text(b"oh"), 2))
        assert session.errors.getvalue() == b"oh"
        assert session.semihosting(0x09, session.block(handle)) == 1  # SYS_ISTTY
        assert session.semihosting(0x02, session.block(handle)) == 0  # SYS_CLOSE

    def test_there_are_no_files_and_no_input(self, session):
        assert session.semihosting(0x01, session.block(session.text(b"data"), 0, 4)) == MINUS_ONE
        keyboard = session.semihosting(0x01, session.block(session.text(b":tt"), 0, 3))
        assert session.semihosting(0x06, session.block(keyboard, session.block(0), 4)) == 4  # none were read

    def test_exit(self, session):
        assert session.run("semihosting", 0x18, APPLICATION_EXIT).exit_code == 0
        assert session.run("semihosting", 0x18, 0x20023).exit_code == 1  # ADP_Stopped_RunTimeErrorUnknown
        assert session.run("semihosting", 0x20, session.block(APPLICATION_EXIT, 7)).exit_code == 7

    def test_what_is_counted_of_an_exit(self, session):
        run = session.run("semihosting", 0x18, APPLICATION_EXIT)
        assert run.cost.class_counts == {"software_interrupt": 1}
        assert run.cost.core_cycles == 3
        assert session.run("pending", 1, APPLICATION_EXIT).cost.core_cycles == 1 + 1 + 3

    def test_clock_shows_simulated_time(self, session):
        into = session.block(0, 0)
        run = session.run("wait_and_look", 1_000_000, into)
        assert run.result == 0
        # The loop's cycles, one for mov, three for the call itself.
        assert session.words(into, 2) == [4 * 1_000_000 - 2 + 1 + 3, 0]
        run = session.run("wait_and_look", 10, into, cycles=lambda cost: cost.core_cycles + (5 << 32))
        assert session.words(into, 2) == [4 * 10 - 2 + 1 + 3, 5]
        run = session.run("semihosting", 0x31, clock_hz=123_000_000)  # SYS_TICKFREQ
        assert run.result == 123_000_000
        run = session.run("semihosting", 0x10, clock_hz=1000, cycles=lambda _: 2345)  # SYS_CLOCK
        assert run.result == 234
        assert session.run("semihosting", 0x11, clock_hz=1000, cycles=lambda _: 2345).result == 2  # SYS_TIME

    def test_heap_and_stack(self, session):
        placed = session.block(0, 0, 0, 0)
        assert session.semihosting(0x16, session.block(placed)) == 0
        heap, heap_end, stack, stack_end = session.words(placed, 4)
        assert placed < heap < heap_end <= stack_end < stack <= 32 << 20

    def test_command_line(self, session):
        into = session.machine.reserve(32)
        block = session.block(into, 32)
        assert session.semihosting(0x15, block) == 0
        assert session.words(block, 2)[1] == len("host.elf")
        assert session.machine.read(into, "u1", 9).tobytes() == b"host.elf\0"
        assert session.semihosting(0x15, session.block(into, 8)) == MINUS_ONE

    @pytest.mark.parametrize(
        ("operation", "result"), [(0x07, MINUS_ONE), (0x0A, MINUS_ONE), (0x0E, MINUS_ONE)]
    )
    def test_the_rest_is_missing(self, session, operation, result):
        assert session.semihosting(operation, session.block(0, 0)) == result

    def test_is_error(self, session):
        assert session.semihosting(0x08, session.block(MINUS_ONE)) == 1
        assert session.semihosting(0x08, session.block(3)) == 0


class TestLinux:
    def linux(self, session: Session, number: int, *arguments: int, **options) -> Run:
        padded = [*arguments, 0, 0, 0][:3]
        return session.run("linux", *padded, number, **options)

    def test_write_and_exit(self, session):
        assert self.linux(session, 4, 1, session.text(b"out"), 3).result == 3
        assert self.linux(session, 4, 2, session.text(b"err"), 3).result == 3
        assert (session.output.getvalue(), session.errors.getvalue()) == (b"out", b"err")
        assert self.linux(session, 1, 0x103).exit_code == 3
        assert self.linux(session, 248, 0).exit_code == 0

    def test_time(self, session):
        into = session.block(0, 0)
        assert self.linux(session, 263, 0, into, clock_hz=1000, cycles=lambda _: 2345).result == 0
        assert session.words(into, 2) == [2, 345_000_000]
        assert self.linux(session, 78, into, 0, clock_hz=1000, cycles=lambda _: 1001).result == 0
        assert session.words(into, 2) == [1, 1000]

    def test_break(self, session):
        start = self.linux(session, 45, 0).result
        assert start >= 0x0100_0000
        assert self.linux(session, 45, start + 4096).result == start + 4096
        assert self.linux(session, 45, 0xE000_0000).result == start

    def test_others_are_missing(self, session):
        assert self.linux(session, 54, 1).result == -25 & MINUS_ONE
        assert self.linux(session, 20).result == -38 & MINUS_ONE


class TestErrors:
    def test_a_call_of_another_number(self, session):
        with pytest.raises(ArmError, match=r"\(unknown\+0x0\): SVC 0x42, which is not served"):
            session.run("unknown")
        assert session.run("maybe", 1).exit_code is None
        with pytest.raises(ArmError, match="not served"):
            session.run("maybe", 0)

    def test_a_function_that_is_called_has_no_host(self, session):
        with pytest.raises(ArmError, match=r"\(semihosting\+0x0\)"):
            session.machine.call("semihosting", 0x18, APPLICATION_EXIT)
        assert session.run("semihosting", 0x18, APPLICATION_EXIT).exit_code == 0

    def test_a_block_that_is_nowhere(self, session):
        with pytest.raises(ArmError, match="no memory at 0xe0000000"):
            session.run("semihosting", 0x04, 0xE000_0000)

    def test_a_symbol_that_is_nearly_right(self, session):
        with pytest.raises(ArmError, match="did you mean semihosting"):
            session.run("semihostin")


def test_a_program_starts_where_its_file_says(tmp_path: Path):
    elf = write_elf(tmp_path / "entry.elf", {"first": words_of("e3a00007  mov r0, #7\n e12fff1e  bx lr")})
    run = ArmMachine(elf, memory_bytes=32 << 20).run()
    assert (run.result, run.exit_code, run.cost.core_cycles) == (7, None, 4)
