"""What a bare-metal program asks its host for: output, its time, its memory, to be ended.

ARM semihosting (ARM document 100863, "Semihosting for AArch32 and AArch64"; SVC 0x123456 in ARM state), as
newlib's rdimon start files use it, and of Linux (SVC 0, number in r7; arch/arm/tools/syscall.tbl) what a
program without a C library's start files needs. There are no files but the console.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import BinaryIO, Protocol

SEMIHOSTING, LINUX = 0x123456, 0
_APPLICATION_EXIT = 0x20026  # ADP_Stopped_ApplicationExit
_MISSING = 0xFFFF_FFFF  # -1
_NO_SYSTEM_CALL = -38 & 0xFFFF_FFFF  # -ENOSYS
_NOT_A_TERMINAL = -25 & 0xFFFF_FFFF  # -ENOTTY
_INPUT, _OUTPUT, _ERRORS = 1, 2, 3  # handles of the console, by the kind of mode it was opened with
_TEXT_BYTES = 1 << 20  # the longest text to look for an end in


class Machine(Protocol):
    """What of a machine the calls need: its memory by bytes."""

    def bytes_at(self, address: int, nbytes: int) -> bytes: ...

    def put_bytes(self, address: int, contents: bytes) -> None: ...


@dataclass(frozen=True)
class Surroundings:
    """Where a program runs: its name, the ends of its heap and stack, its clock, its consoles."""

    command_line: str
    heap: tuple[int, int]  # first address, address after the last
    stack: tuple[int, int]  # top, lowest
    clock_hz: int
    elapsed_cycles: Callable[[], int]
    output: BinaryIO
    errors: BinaryIO


class HostCalls:
    """Serves a program's calls until it ends itself."""

    def __init__(self, machine: Machine, surroundings: Surroundings) -> None:
        self._machine = machine
        self._around = surroundings
        self._break = surroundings.heap[0]
        self.exit_code: int | None = None  # once it ended itself

    def serve(self, number: int, registers: tuple[int, ...]) -> int | None:
        """r0 after the call of an SVC with this number and r0 to r7; None if there is no such SVC."""
        if number == SEMIHOSTING:
            return self._semihosting(registers[0], registers[1])
        if number == LINUX:
            return self._linux(registers[7], registers)
        return None

    def _words(self, address: int, count: int) -> tuple[int, ...]:
        return struct.unpack(f"<{count}I", self._machine.bytes_at(address, 4 * count))

    def _put_words(self, address: int, *words: int) -> None:
        self._machine.put_bytes(address, struct.pack(f"<{len(words)}I", *(w & 0xFFFF_FFFF for w in words)))

    def _text(self, address: int) -> bytes:
        contents = b""
        while b"\0" not in contents and len(contents) < _TEXT_BYTES:
            contents += self._machine.bytes_at(address + len(contents), 1)
        return contents.partition(b"\0")[0]

    def _write(self, handle: int, contents: bytes) -> None:
        stream = self._around.errors if handle == _ERRORS else self._around.output
        stream.write(contents)
        stream.flush()

    def _seconds(self) -> float:
        return self._around.elapsed_cycles() / self._around.clock_hz

    def _semihosting(self, operation: int, argument: int) -> int:
        served = {
            0x01: self._open,
            0x02: lambda _: 0,  # SYS_CLOSE
            0x03: self._write_character,
            0x04: self._write_text,
            0x05: self._write_handle,
            0x06: lambda block: self._words(block, 3)[2],  # SYS_READ: at the end, nothing was read
            0x07: lambda _: _MISSING,  # SYS_READC
            0x08: lambda block: int(self._words(block, 1)[0] >> 31),  # SYS_ISERROR
            0x09: lambda _: 1,  # SYS_ISTTY
            0x0A: lambda _: _MISSING,  # SYS_SEEK
            0x0C: lambda _: 0,  # SYS_FLEN
            0x10: lambda _: int(self._seconds() * 100) & 0xFFFF_FFFF,  # SYS_CLOCK
            0x11: lambda _: int(self._seconds()) & 0xFFFF_FFFF,  # SYS_TIME: the epoch is the start
            0x13: lambda _: 0,  # SYS_ERRNO
            0x15: self._command_line,
            0x16: self._heap_info,
            0x18: self._exit,
            0x20: self._exit_extended,
            0x30: self._elapsed,
            0x31: lambda _: self._around.clock_hz,  # SYS_TICKFREQ
        }
        call = served.get(operation)
        return _MISSING if call is None else call(argument)

    def _open(self, block: int) -> int:
        name, mode, _ = self._words(block, 3)
        if self._text(name) != b":tt":
            return _MISSING
        return (_INPUT, _OUTPUT, _ERRORS)[min(mode // 4, 2)]

    def _write_character(self, address: int) -> int:
        self._write(_OUTPUT, self._machine.bytes_at(address, 1))
        return 0

    def _write_text(self, address: int) -> int:
        self._write(_OUTPUT, self._text(address))
        return 0

    def _write_handle(self, block: int) -> int:
        handle, address, nbytes = self._words(block, 3)
        self._write(handle, self._machine.bytes_at(address, nbytes))
        return 0  # bytes that were not written

    def _command_line(self, block: int) -> int:
        address, room = self._words(block, 2)
        text = self._around.command_line.encode()
        if len(text) + 1 > room:
            return _MISSING
        self._machine.put_bytes(address, text + b"\0")
        self._put_words(block + 4, len(text))
        return 0

    def _heap_info(self, block: int) -> int:
        self._put_words(self._words(block, 1)[0], *self._around.heap, *self._around.stack)
        return 0

    def _exit(self, reason: int) -> int:
        self.exit_code = 0 if reason == _APPLICATION_EXIT else 1
        return 0

    def _exit_extended(self, block: int) -> int:
        reason, code = self._words(block, 2)
        self.exit_code = code if reason == _APPLICATION_EXIT else 1
        return 0

    def _elapsed(self, block: int) -> int:
        cycles = self._around.elapsed_cycles()
        self._put_words(block, cycles & 0xFFFF_FFFF, cycles >> 32)
        return 0

    def _linux(self, number: int, registers: tuple[int, ...]) -> int:
        first, second, third = registers[:3]
        if number in (1, 248):  # exit, exit_group
            self.exit_code = first & 0xFF
            return 0
        if number == 4:  # write
            self._write(_ERRORS if first == 2 else _OUTPUT, self._machine.bytes_at(second, third))
            return third
        if number == 45:  # brk
            if self._around.heap[0] <= first <= self._around.heap[1]:
                self._break = first
            return self._break
        if number in (78, 263):  # gettimeofday(time, zone), clock_gettime(clock, time)
            parts = 1_000_000 if number == 78 else 1_000_000_000
            whole, rest = divmod(self._around.elapsed_cycles(), self._around.clock_hz)
            self._put_words(first if number == 78 else second, whole, rest * parts // self._around.clock_hz)
            return 0
        if number == 54:  # ioctl
            return _NOT_A_TERMINAL
        return 0 if number in (3, 6) else _NO_SYSTEM_CALL  # read: at the end; close
