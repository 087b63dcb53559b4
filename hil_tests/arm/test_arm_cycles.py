"""tools/arm_cycles from outside: programs, options, output, and what is said of bad input."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from hil_tests.arm.conftest import require_compiler
from hil_tests.arm.programs import EM_386, words_of, write_elf
from tools.arm_timing.__main__ import app
from tools.calibration.compiler import COMPILER_PROGRAM

ROOT = Path(__file__).parents[2]
FUNCTIONS = {
    "main": "e3a0002a  mov r0, #42\n e12fff1e  bx lr",
    "twice": "e0800001  add r0, r0, r1\n e12fff1e  bx lr",
    "hello": """
        e3a00004  mov r0, #4
        e28f100c  add r1, pc, #0xc
        ef123456  svc #0x123456
        e3a00018  mov r0, #0x18
        e59f1008  ldr r1, [pc, #8]
        ef123456  svc #0x123456
        6c6c6568  .ascii "hell"
        00000a6f  .asciz "o"
        00020026  .word 0x20026
    """,
    "exit_three": "e3a00003  mov r0, #3\n e3a07001  mov r7, #1\n ef000000  svc #0",
    # r0: the address of as many bytes as r1; each of a line.
    "lines": """
        e4902020  ldr r2, [r0], #0x20
        e2511020  subs r1, r1, #0x20
        1afffffc  bne #0xfffffff8
        e12fff1e  bx lr
    """,
    "forever": "eafffffe  b #0",
    "vfp": "ee300a00  vadd.f32 s0, s0, s0\n e12fff1e  bx lr",
    "null": "e3a00000  mov r0, #0\n e5900000  ldr r0, [r0]\n e12fff1e  bx lr",
}


@pytest.fixture(scope="module")
def elf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    functions = {name: words_of(listing) for name, listing in FUNCTIONS.items()}
    return write_elf(tmp_path_factory.mktemp("cycles") / "program.elf", functions)


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def figures(*arguments: object) -> dict:
    result = run(*arguments, "--json", "-")
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)


def test_it_starts_where_the_file_says_and_ends_with_the_return(elf):
    found = figures(elf)
    assert found["result"] == 42
    assert found["exit_code"] is None
    assert found["ended"] == "returned"
    assert (found["instructions"], found["core_cycles"], found["interlock_cycles"]) == (2, 4, 0)
    assert found["class_counts"] == {"alu": 1, "branch": 1}
    assert found["fetches"] == 2 + 2


def test_entry_and_arguments(elf):
    assert figures(elf, "--entry", "twice", "--argument", "0x10", "--argument", "-3")["result"] == 13


def test_times_by_clock_cache_and_memory(elf):
    lines = ("--entry", "lines", "--argument", 0x200000, "--argument", 100 * 32)
    found = figures(elf, *lines)
    assert found["data_fills"] == 100
    fills = found["data_fills"] + found["fetch_fills"]
    assert found["memory_access_cycles"] == {"low": 24.0, "nominal": 48.0, "high": 72.0}
    assert found["memory_cycles"] == {"low": 24 * fills, "nominal": 48 * fills, "high": 72 * fills}
    total = found["core_cycles"] + 48 * fills
    assert found["total_cycles"]["nominal"] == total
    assert found["time_s"]["nominal"] == pytest.approx(total / 400e6)

    slower = figures(elf, *lines, "--clock", "100e6")
    assert slower["core_cycles"] == found["core_cycles"]
    assert slower["memory_access_cycles"]["nominal"] == 12  # the memory keeps its clock
    without = figures(elf, *lines, "--cache", 0)
    accesses = without["fetches"] + without["data_accesses"]
    assert without["data_accesses"] == 100
    assert without["memory_cycles"]["nominal"] == 30 * accesses  # 75 ns at 400 MHz
    assert without["data_fills"] == 0


def test_the_programs_output_is_apart_from_the_report(elf):
    result = run(elf, "--entry", "hello")
    assert result.exit_code == 0
    assert result.stdout == "hello\n"
    assert "core cycles" in result.stderr
    found = run(elf, "--entry", "hello", "--json", "-")
    assert json.loads(found.stdout)["exit_code"] == 0
    assert "hello\n" in found.stderr


def test_the_report_says_how_sure_it_is(elf):
    said = " ".join(run(elf).stderr.split())
    assert "Instruction counts exact; core cycles about +-10 %; memory +-20 to 30 %; not validated on" in said
    assert "Not modelled: TLB" in said
    assert "42 (0x0000002a)" in said
    assert "core cycles about" in figures(elf)["uncertainty"]


def test_an_exit_code_of_the_program_is_a_figure_and_no_failure(elf):
    assert figures(elf, "--entry", "exit_three")["exit_code"] == 3
    assert "exit code 3" in run(elf, "--entry", "exit_three").stderr


def test_json_file(elf, tmp_path):
    target = tmp_path / "figures.json"
    assert run(elf, "--json", target).exit_code == 0
    assert json.loads(target.read_text())["result"] == 42


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("--entry", "nothing"), "no symbol 'nothing'"),
        (("--entry", "vfp"), "vadd.f32 s0, s0, s0), an instruction that ARM926EJ-S has not"),
        (("--entry", "null"), "(null+0x4)"),
        (("--entry", "forever", "--max-instructions", 1000), "still running after 1000 instructions"),
        (("--clock", "fast"), "--clock fast: must be whole Hz"),
        (("--clock", "nan"), "--clock nan"),
        (("--clock", "0"), "--clock 0"),
        (("--cache", 24), "--cache 24: must be one of 0, 4, 8"),
        (("--argument", "five"), "--argument five: must be a whole number"),
        (("--argument", 1 << 32), "must be a whole number of 32 bits"),
        (("--json", "/nowhere/at/all"), "there is no folder"),
        (("--line-fill", "middling"), "low"),
    ],
)
def test_bad_input(elf, arguments, text):
    result = run(elf, *arguments)
    assert result.exit_code == 2
    assert text in " ".join(result.stderr.split())
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(
    ("contents", "text"),
    [(b"MZ something else", "not an ELF file"), (b"", "not an ELF file"), (None, "No such file")],
)
def test_no_program(tmp_path, contents, text):
    path = tmp_path / "program"
    if contents is not None:
        path.write_bytes(contents)
    result = run(path)
    assert result.exit_code == 2
    assert text in result.stderr


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"machine": EM_386}, "this runs 32-bit ARM"),
        ({"flags": 0x0500_0400}, "hard float"),
        ({"thumb": True}, "Thumb"),
    ],
)
def test_a_program_for_something_else(tmp_path, options, text):
    elf = write_elf(tmp_path / "other.elf", {"main": words_of(FUNCTIONS["main"])}, **options)
    result = run(elf)
    assert result.exit_code == 2
    assert text in result.stderr


def test_help_tells_how_to_build_and_run():
    said = run("--help").stdout
    for text in ("-mcpu=arm926ej-s", "--entry", "--line-fill", "SYS_EXIT", "Exit status", "--cache 0"):
        assert text in said


def test_as_a_command_of_its_own(elf, tmp_path):
    """As the script starts it, from another folder."""
    done = subprocess.run(
        [sys.executable, "-m", "tools.arm_timing", elf, "--entry", "hello", "--json", "figures.json"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "hello\n"
    assert json.loads((tmp_path / "figures.json").read_text())["exit_code"] == 0


SIEVE = """
static unsigned char composite[5000];
__attribute__((noinline)) static int primes(int limit) {
    int found = 0;
    for (int i = 2; i < limit; ++i) {
        if (composite[i]) continue;
        ++found;
        for (int j = 2 * i; j < limit; j += i) composite[j] = 1;
    }
    return found;
}
int main(void) { return primes(5000); }
"""


def test_a_compiled_program(tmp_path):
    require_compiler()
    source, elf = tmp_path / "sieve.c", tmp_path / "sieve.elf"
    source.write_text(SIEVE)
    flags = ["-mcpu=arm926ej-s", "-marm", "-mfloat-abi=soft", "-O2", "-ffreestanding", "-nostdlib", "-static"]
    command = [
        COMPILER_PROGRAM,
        *flags,
        "-Wl,-Ttext=0x10000",
        "-Wl,-e,main",
        str(source),
        "-lgcc",
        "-o",
        str(elf),
    ]
    subprocess.run(command, check=True)
    found = figures(elf)
    assert found["result"] == 669  # primes below 5000
    # 5000 bytes lie in 157 or 158 lines; those that are only ever written are in no cache.
    assert 150 <= found["data_fills"] <= 160
    assert figures(elf, "--entry", "main") == found | {"entry": "main"}
