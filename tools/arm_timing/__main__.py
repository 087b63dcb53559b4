"""Instructions and cycles of any program for ARM926EJ-S, run in a simulator."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from st_emulator.errors import ConfigurationError
from st_emulator.report import require_json_path, write_json

from .cost import Run
from .errors import ArmError
from .machine import ArmMachine
from .report import Conditions, document_of, show

BAD_INPUT = 2
MOST_INSTRUCTIONS = 10_000_000_000
CACHES_KIB = (0, 4, 8, 16, 32, 64, 128)

HELP = """
Runs a statically linked 32-bit ARM program with no operating system, and counts what it costs on an
ARM926EJ-S: instructions, core cycles by the timing table of its manual with all interlocks, and cache
line fills. What the program writes goes to standard output, the report to standard error.

\b
The program ends when
  - the function it was started at returns (the link register is set for that; r0 is the result), or
  - it makes an exit call: ARM semihosting (SVC 0x123456: SYS_EXIT, SYS_EXIT_EXTENDED) or Linux's
    (SVC 0, r7 = 1 or 248).
Of semihosting it may also use the console (SYS_WRITE0, SYS_WRITEC, SYS_WRITE, SYS_OPEN ":tt"), the clock
(SYS_CLOCK, SYS_ELAPSED, SYS_TICKFREQ: simulated time), SYS_HEAPINFO and SYS_GET_CMDLINE, as newlib's
rdimon.specs does; of Linux write, brk, gettimeofday and clock_gettime. There are no files.

\b
Build, for instance with Debian's gcc-arm-linux-gnueabi and libc6-dev-armel-cross:
  arm-linux-gnueabi-gcc -mcpu=arm926ej-s -marm -mfloat-abi=soft -O2 -ffreestanding -nostdlib -static \\
      -Wl,--build-id=none -Wl,-Ttext=0x10000 -Wl,-e,main program.c -lgcc -o program.elf
Run:
  tools/arm_cycles program.elf
  tools/arm_cycles program.elf --entry checksum --argument 0x20000 --argument 1000
  tools/arm_cycles program.elf --clock 200e6 --cache 8 --line-fill high --json figures.json
  tools/arm_cycles program.elf --cache 0        # caches off: each access goes to memory

Exit status: 0 when the program ended, whatever its own exit code (the report has it); 2 for a program that
cannot be run or does not end.
"""


class LineFill(StrEnum):
    """How fast the memory is."""

    low = "low"
    nominal = "nominal"
    high = "high"


def main(
    elf: Annotated[Path, typer.Argument(metavar="ELF", help="The linked program.")],
    entry: Annotated[
        str | None,
        typer.Option("--entry", metavar="SYMBOL", help="Function to start at. [the file's entry point]"),
    ] = None,
    argument: Annotated[
        list[str] | None,
        typer.Option("--argument", metavar="N", help="A word for r0, then r1 and so on; 0x for hexadecimal."),
    ] = None,
    clock: Annotated[str, typer.Option("--clock", metavar="HZ", help="Clock of the processor.")] = "400e6",
    cache: Annotated[
        int,
        typer.Option(
            "--cache",
            metavar="KIB",
            help="Size of the instruction and of the data cache: "
            f"{', '.join(map(str, CACHES_KIB))}; 0: caches off.",
        ),
    ] = 32,
    line_fill: Annotated[
        LineFill,
        typer.Option(
            "--line-fill", help="The memory's speed, for the program's clock; the report has all three."
        ),
    ] = LineFill.nominal,
    max_instructions: Annotated[
        int, typer.Option("--max-instructions", metavar="N", min=1, help="Give up after so many.")
    ] = MOST_INSTRUCTIONS,
    memory: Annotated[
        int, typer.Option("--memory", metavar="MIB", min=32, max=1024, help="Memory from address 0 up.")
    ] = 64,
    json_path: Annotated[
        str | None,
        typer.Option("--json", metavar="FILE", help="Write the figures there; - for standard output."),
    ] = None,
) -> None:
    """Run a program and print what it costs; see HELP."""
    console = Console(stderr=True, highlight=False)
    try:
        require_json_path(json_path)
        words = [_word(text) for text in argument or []]
        conditions = Conditions(_clock(clock), _cache(cache), line_fill.value)
        document = _figures(elf, entry, words, conditions, max_instructions, memory << 20, json_path == "-")
        show(console, document)
        write_json(json_path, document, [])
    except (ArmError, ConfigurationError) as error:
        console.print(f"arm_cycles: {error}", style="red", markup=False, soft_wrap=True)
        raise SystemExit(BAD_INPUT) from error


def _figures(
    elf: Path,
    entry: str | None,
    words: list[int],
    conditions: Conditions,
    max_instructions: int,
    memory_bytes: int,
    to_stderr: bool,
) -> dict[str, Any]:
    machine = ArmMachine(
        elf,
        memory_bytes=memory_bytes,
        caches_kib=conditions.simulated_kib,
        max_instructions=max_instructions,
    )
    run: Run = machine.run(
        entry,
        *words,
        clock_hz=conditions.clock_hz,
        cycles=lambda cost: conditions.total_cycles(cost, conditions.line_fill),
        output=sys.stderr.buffer if to_stderr else sys.stdout.buffer,
        errors=sys.stderr.buffer,
    )
    return document_of(elf, entry or "entry point", run, conditions)


def _word(text: str) -> int:
    try:
        value = int(text, 0)
    except ValueError:
        value = 1 << 40
    if not -(1 << 31) <= value < 1 << 32:
        raise ConfigurationError(f"--argument {text}: must be a whole number of 32 bits")
    return value


def _clock(text: str) -> int:
    try:
        clock_hz = float(text)
    except ValueError:
        clock_hz = 0.0
    if not 1e3 <= clock_hz <= 1e10 or clock_hz != int(clock_hz):
        raise ConfigurationError(f"--clock {text}: must be whole Hz from 1e3 to 1e10, such as 400e6")
    return int(clock_hz)


def _cache(kib: int) -> int:
    if kib not in CACHES_KIB:
        raise ConfigurationError(f"--cache {kib}: must be one of {', '.join(map(str, CACHES_KIB))}")
    return kib


app = typer.Typer(add_completion=False, rich_markup_mode=None)
app.command(help=HELP)(main)

if __name__ == "__main__":
    app(prog_name="tools/arm_cycles")
